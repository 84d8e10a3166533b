//! Bodies in the SMPL-X layout.

/// Derivatives, batches and bad parameters on a small generated model.
mod derivatives;
/// Layouts of files, and damaged ones.
mod files;
#[allow(dead_code)]
mod generated;
/// Landmarks, hands and the gradients through them.
mod landmarks;
/// An independent, dense implementation.
mod oracle;
/// The numbers of the official package.
mod reference;
