//! Deformation nets of caphy: GRU and MLP with their vector-Jacobian products, and the optimiser that trains them.
//!
//! | `type` | net | memory |
//! |---|---|---|
//! | `gru` | [`NetGru`]: GRU layers and a linear head, as in SNUG | yes |
//! | `mlp` | [`NetMlp`]: fully connected, one frame at a time | no |
//!
//! Forward and backward passes are written by hand on matrix products, in `f32` and `f64`. Names, shapes and gate order
//! are those of PyTorch's `nn.GRU` and `nn.Linear`, so that weights move both ways as safetensors without reordering.
//! [`Adam`](adam::Adam) works on the same flat vectors. A net knows no energy, no body and no file.

pub mod adam;

mod dense;
mod gru;
mod initial;
mod layout;
mod mlp;
mod product;
mod squash;

pub use gru::{NetGru, NetGruSpec};
pub use mlp::{Activation, NetMlp, NetMlpSpec};
