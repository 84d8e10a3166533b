//! The host's side of the plugin border (feature `host`): loads libraries and wraps their types as ordinary trait objects.
//!
//! The interface and its contract stand in [`crate::plugin`].

mod call;
mod library;
mod material;
mod net;

pub use library::{Library, PluginKind, PluginType};
