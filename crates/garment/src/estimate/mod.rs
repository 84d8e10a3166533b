//! Fabric parameters from garments at rest (Sec. 3.4).

pub mod bounded;
pub mod force_balance;
pub mod reduction;

pub use force_balance::{FabricEstimate, ForceBalanceSettings, GroupEstimate, force_balance};
