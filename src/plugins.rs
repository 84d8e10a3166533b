//! Links the plugin crates, so that their types are found by name.
//!
//! A static crate that nobody mentions is dropped by the linker, and with it its entries in typetag's registry.

use caphy_bodymodel as _;
use caphy_materials as _;
use caphy_nets as _;
use caphy_segmentation as _;
