//! Bodies in the SMPL-X layout.

/// Derivatives, batches and bad parameters on a small generated model.
mod derivatives;
#[allow(dead_code)]
mod generated;
/// The numbers of the official package.
mod reference;
