//! Motion clips from files, as poses of the 55 SMPL-X joints, y up.
//!
//! Files say where the pelvis is; a [`Pose`](caphy_core::pose::Pose) says what is added to a body whose pelvis is where
//! its shape puts it. Readers therefore take the rest pelvis of the body that will be moved.

mod asf_amc;
mod axes;
mod bvh;
mod mapping;
mod retarget;
mod smpl_npz;
mod text;

pub use asf_amc::read_asf_amc;
pub use axes::UpAxis;
pub use bvh::read_bvh;
pub use mapping::{SkeletonMapping, SkeletonRest};
pub use smpl_npz::{SmplNpzOptions, TranslationMeaning, read_smpl_npz};

/// The file's stem: the clip's name.
fn clip_name(path: &std::path::Path) -> String {
    path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}
