//! Fabric parameters from garments at rest (Sec. 3.4).
//!
//! * [`equilibrium`]: the default; fits simulated equilibria to scans.
//! * [`alternation`]: the paper's loop of shapes between physics and scan and Eq. 10.
//! * [`ShapeBalance`]: Eq. 10 alone, exact on exact equilibria and only there.
//!
//! All say which combinations of the fabric's numbers the poses determine, and what holds the others. [`cloth`] has the
//! laboratory's specimens.

pub mod alternation;
mod balance_system;
pub mod bounded;
pub mod capture;
pub mod cloth;
mod cut;
pub mod equilibrium;
pub mod force_balance;
pub mod reduction;
pub mod roughness;
mod rows;
pub mod settings;
pub mod shapes;

pub use alternation::{AlternationEstimate, AlternationSettings, alternation};
pub use capture::{Capture, ContactSearch, ScanPoints, Surroundings};
pub use cut::CutPart;
pub use equilibrium::{EquilibriumEstimate, FitProgress, FitState, NativeEvidence, Problem, equilibrium};
pub use force_balance::{FabricEstimate, ForceBalanceSettings, GroupEstimate};
pub use reduction::Reduction;
pub use settings::EquilibriumSettings;
pub use shapes::{GradientBy, ShapeBalance};
