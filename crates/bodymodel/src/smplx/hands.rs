//! [`HandComponents`]: hand poses as coefficients of principal components, as files and fits of SMPL-X give them.

use super::BodySmplx;
use caphy_core::{Error, Result, Vec3};

/// Joints of a hand behind `left_` and `right_`, in the order of the components.
pub(super) const HAND_JOINTS: [&str; 15] = [
    "index1", "index2", "index3", "middle1", "middle2", "middle3", "pinky1", "pinky2", "pinky3", "ring1", "ring2",
    "ring3", "thumb1", "thumb2", "thumb3",
];

/// What hand coefficients are measured from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HandMean {
    /// The mean pose of the file is added (`flat_hand_mean = False` of the official package): zero is a relaxed hand.
    Added,
    /// Nothing is added (`flat_hand_mean = True`): zero is a flat hand.
    Flat,
}

/// A pose of one hand as it is given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HandPose<'a> {
    /// Coefficients of the first components (`use_pca = True`).
    Coefficients(&'a [f64]),
    /// Axis-angle rotations [rad], shape [joint_count] of the hand (`use_pca = False`).
    Rotations(&'a [Vec3]),
}

/// Principal components of the pose of one hand.
#[derive(Debug, Clone, PartialEq)]
pub struct HandComponents {
    joints: Vec<usize>,
    components: Vec<Vec<Vec3>>,
    mean: Vec<Vec3>,
}

impl HandComponents {
    /// From the hand's joints in the body, components of shape [component_count][joint_count] and the mean pose [rad], shape
    /// [joint_count].
    ///
    /// # Errors
    /// [`Error::Length`] and [`Error::NonFinite`].
    pub fn new(joints: Vec<usize>, components: Vec<Vec<Vec3>>, mean: Vec<Vec3>) -> Result<Self> {
        for (what, field) in components.iter().map(|c| ("hand component", c)).chain([("mean hand pose", &mean)]) {
            Error::check_length(what, joints.len(), field.len())?;
            for r in field {
                Error::check_finite(what, r.as_slice())?;
            }
        }
        Ok(Self { joints, components, mean })
    }
    /// Joints of the hand in the body: index, middle, pinky, ring, thumb, three each.
    pub fn joints(&self) -> &[usize] {
        &self.joints
    }
    /// Number of components; any number of coefficients up to it can be given.
    pub fn count(&self) -> usize {
        self.components.len()
    }
    /// Mean pose [rad], axis-angle, shape [joint_count].
    pub fn mean(&self) -> &[Vec3] {
        &self.mean
    }
    /// Axis-angle rotations [rad] of a hand pose, shape [joint_count]: Σ c_k component_k for coefficients, plus the mean when
    /// it is `Added`.
    ///
    /// # Errors
    /// [`Error::Length`] for more coefficients than components and another number of rotations, [`Error::NonFinite`].
    pub fn rotations(&self, pose: HandPose<'_>, mean: HandMean) -> Result<Vec<Vec3>> {
        let mut out = match mean {
            HandMean::Added => self.mean.clone(),
            HandMean::Flat => vec![Vec3::zeros(); self.joints.len()],
        };
        match pose {
            HandPose::Coefficients(coefficients) => {
                if coefficients.len() > self.count() {
                    let what = "hand coefficients".into();
                    return Err(Error::Length { what, expected: self.count(), got: coefficients.len() });
                }
                Error::check_finite("hand coefficients", coefficients)?;
                for (c, component) in coefficients.iter().zip(&self.components) {
                    out.iter_mut().zip(component).for_each(|(r, d)| *r += d * *c);
                }
            }
            HandPose::Rotations(rotations) => {
                Error::check_length("hand rotations", self.joints.len(), rotations.len())?;
                for (r, given) in out.iter_mut().zip(rotations) {
                    Error::check_finite("hand rotation", given.as_slice())?;
                    *r += given;
                }
            }
        }
        Ok(out)
    }
    /// Gradient by the first `count` coefficients, from the gradient by all of the body's rotations [1/rad], shape
    /// [body joint_count] (see [`BodyGradient`](caphy_core::body::BodyGradient)).
    ///
    /// # Errors
    /// [`Error::Length`] when there are fewer components, or no such joints.
    pub fn pull_back(&self, rotations: &[Vec3], count: usize) -> Result<Vec<f64>> {
        if count > self.count() {
            return Err(Error::Length { what: "hand coefficients".into(), expected: self.count(), got: count });
        }
        let last = self.joints.iter().max().map_or(0, |j| j + 1);
        if rotations.len() < last {
            return Err(Error::Length { what: "rotations".into(), expected: last, got: rotations.len() });
        }
        let along = |component: &Vec<Vec3>| self.joints.iter().zip(component).map(|(&j, d)| d.dot(&rotations[j])).sum();
        Ok(self.components[..count].iter().map(along).collect())
    }
}

impl BodySmplx {
    /// The body with hand components. With `add_mean`, the mean poses are added to the rotations of the fingers, so that zero
    /// rotations are relaxed hands; without, they are flat.
    ///
    /// # Errors
    /// [`Error::Length`] when a hand names a joint that does not exist.
    pub fn with_hands(mut self, left: HandComponents, right: HandComponents, add_mean: bool) -> Result<Self> {
        let count = self.joint_template.len();
        let mut relaxed = vec![Vec3::zeros(); count];
        for hand in [&left, &right] {
            for (&j, mean) in hand.joints.iter().zip(&hand.mean) {
                let Some(r) = relaxed.get_mut(j) else {
                    return Err(Error::Length { what: "joints of a hand".into(), expected: count, got: j + 1 });
                };
                *r += mean;
            }
        }
        self.relaxed = if add_mean { relaxed } else { Vec::new() };
        self.hands = Some(Box::new([left, right]));
        Ok(self)
    }
    /// Components of the left and the right hand, where the file has them.
    pub fn hands(&self) -> Option<&[HandComponents; 2]> {
        self.hands.as_deref()
    }
    /// Sets the fingers in the rotations of a pose, shape [joint_count], to poses of the left and the right hand. On a body
    /// that adds the mean itself, what it will add is left out, so that the pose is the same on both.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a body without hand components; [`Error::Length`] and [`Error::NonFinite`] as
    /// [`HandComponents::rotations`].
    pub fn set_hands(&self, poses: [HandPose<'_>; 2], mean: HandMean, rotations: &mut [Vec3]) -> Result<()> {
        let Some(hands) = self.hands() else {
            return Err(Error::unsupported("hand components", &self.description.name));
        };
        Error::check_length("rotations", self.joint_template.len(), rotations.len())?;
        for (hand, pose) in hands.iter().zip(poses) {
            for (&j, r) in hand.joints.iter().zip(hand.rotations(pose, mean)?) {
                rotations[j] = r - self.relaxed.get(j).copied().unwrap_or_default();
            }
        }
        Ok(())
    }
}
