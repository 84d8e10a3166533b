//! Materials and nets in libraries of their own: the C interface, and the macro that speaks it for Rust authors.
//!
//! # In Rust
//! Implement [`MaterialSpec`](crate::material::MaterialSpec) or [`NetSpec`](crate::net::NetSpec) as for a linked plugin, build
//! the crate as a `cdylib`, and name the types:
//!
//! ```
//! use caphy_core::material::{MaterialModel, MaterialSpec};
//! # use caphy_core::{Error, Result};
//!
//! /// `type = "jelly"`
//! #[derive(Debug, serde::Serialize, serde::Deserialize)]
//! #[serde(deny_unknown_fields)]
//! struct MaterialJellySpec {
//!     wobble: f64,
//! }
//!
//! #[typetag::serde(name = "jelly")]
//! impl MaterialSpec for MaterialJellySpec {
//!     fn build(&self) -> Result<Box<dyn MaterialModel>> {
//!         Err(Error::unsupported("wobbling", "jelly")) // a real one builds its model here
//!     }
//! }
//!
//! caphy_core::export_plugin! { materials: ["jelly"], nets: [] }
//! # fn main() {}
//! ```
//!
//! `examples/plugin-material` and `examples/plugin-net` are complete. A panic inside is stopped at the border and becomes an
//! error that carries its message.
//!
//! # In C or C++
//! Include `crates/core/include/caphy_plugin.h`, which is written from this module, and see `examples/plugin-material-c`.
//!
//! # Contract
//! * `caphy_plugin_abi_version` is called before anything else; a library of another version is not touched further.
//! * Tables and names that `caphy_plugin` returns live as long as the library, which is never unloaded.
//! * Handles are used from several threads at once; calls on a handle do not change it. `destroy` is called once.
//! * Texts are UTF-8, not ended by a zero, and borrowed for the call alone. A callee hands text back through a [`Sink`],
//!   which copies it.
//! * The host has checked every block: lengths fit, inputs are finite, outputs that were declared as not offered are absent.
//! * A status other than [`OK`] leaves outputs undefined; its text says why, in lines where [`abi`] says so, and becomes the
//!   error that the same plugin would give when linked.

pub mod abi;
pub mod export;
pub mod header;

pub use abi::{ABI_VERSION, OK, Sink};
pub use export::WHOLE_TABLE;
