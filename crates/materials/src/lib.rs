//! Fabric models of caphy, chosen by `type = "…"` in the `[material]` table:
//!
//! | type | model | membrane | bending |
//! |---|---|---|---|
//! | `stvk` | [`MaterialStvk`] | plain Saint Venant-Kirchhoff, two constants (Eq. 5) | one constant (Eq. 7) |
//! | `neo_hookean` | [`MaterialNeoHookean`] | neo-Hookean, two constants, stiffens when squeezed | one constant |
//! | `measured` | [`MaterialMeasured`] | ten measured fabrics, four constants looked up by strain | looked up by fold direction and curvature |
//!
//! # Licence of the fabric data
//! The numbers in `fabrics.json` were measured by Wang, O'Brien and Ramamoorthi (*Data-driven elastic models for cloth:
//! modeling and measurement*, 2011) and are distributed with ARCSim **for educational, research and not-for-profit
//! use**. That restriction goes with the data (see `NOTICE`), not with this crate's source.
//!
//! # Pitfalls, and what is done about each
//! * **Factor 2 in shear.** ARCSim's energy routine has ½ k3 Guv², its force k3 Guv. Here ψ has k3 Guv², whose gradient
//!   *is* that force (dψ = Suu dGuu + Svv dGvv + 2 Suv dGuv).
//! * **Factor 2 in the table.** The stiffness is twice the interpolated raw entry; forgetting it halves the cloth.
//! * **Negative rows.** 20 of the 240 published numbers are negative. They stay as published; the interpolated stiffness
//!   is clamped to max(0, ·) at the table's nodes. Where the clamp is active, derivatives by those entries are zero.
//! * **Area, not volume.** Measured constants are N/m. Moduli in Pa enter only together with a thickness, by type.
//! * **Frozen stiffness.** The default stress ignores dk/dG, as ARCSim's force does: it is then not the gradient of the
//!   energy, and [`MaterialDescription::stiffness_frozen`](caphy_core::material::MaterialDescription) says so.
//! * **Rest stiffness.** G = 0 is the centre of a table cell whose other corners are stretched already: k(0) is their mean, not
//!   twice the unstretched row. It is what ARCSim simulates; `lookup = "direct"` gives the row itself. The two differ by 0.3 %
//!   in the median and by most of a constant at worst, so that a result must say which one it used.
//! * **Equal principal strains.** The direction of largest stretch, and with it the exact stiffness, jumps there. The table
//!   smears the jump over one cell; the direct lookup takes the u axis for it, so that nothing is NaN.
//! * **Tension is not monotone.** Stretched near 45°, navy-sparkle-sweat loses energy: with `stiffness_gradient = "full"` it
//!   pushes itself longer. With held stiffness tension stays positive, though it may sag.
//! * **Outside of the measurements** (stretch 7/6, curvature 20 1/m, the table's range) stiffness stays as at the border;
//!   under compression it is that of the unstretched row. Most real wrinkles lie at or beyond the last curvature.
//! * **Ridges.** The shipped lookup extends the first bending segment without end for folds away from the normal side: up to
//!   42 times the stiffest entry, or none at all. `bending = "repaired"`, the default, looks up |θ − θ_rest| inside the table, so
//!   that a curved rest shape is not looked up as bent; `"faithful"` is for comparison.
//! * **Seams.** Each side has its own edge direction; the softer one wins, as in ARCSim.
//! * **Kinks.** k is only continuous: its slope jumps on every table plane (1/30 in G) and at Guv = 0, where the slope
//!   by Guv is given as 0, the mean of both sides.
//! * **Overflow.** Strains larger than 1e14 (f32) or 1e100 (f64) are drawn back ([`caphy_core::strain_limit`]), so that the energy
//!   of any finite strain is finite and its gradient is its gradient.

mod angle;
mod bounds;
mod chunk;
mod exact;
mod lame;
pub mod measured;
pub mod neo_hookean;
pub mod stvk;

pub use measured::{MaterialMeasured, MaterialMeasuredSpec};
pub use neo_hookean::{MaterialNeoHookean, MaterialNeoHookeanSpec};
pub use stvk::{MaterialStvk, MaterialStvkSpec};
