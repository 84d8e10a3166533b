//! Smoothing of tracked motion: a Gaussian in the tangent space of each joint's rotation.

use super::MotionClip;
use crate::{Error, Result, Vec3};
use nalgebra::UnitQuaternion;
use std::f64::consts::TAU;

/// Widest Gaussian [s]: beyond it nothing of a motion is left, and a slip of the unit (frames for seconds) is likely.
const WIDEST: f64 = 2.0;
/// Standard deviations that the kernel reaches.
const REACH: f64 = 3.0;

impl MotionClip {
    /// The clip smoothed with a Gaussian of standard deviation `sigma` [s]; zero gives it unchanged.
    ///
    /// At each frame a straight line in time is fitted to the neighbours' rotations as seen from it (the logarithm of the
    /// relative rotation), weighted by the Gaussian, and read off at the frame. That has no phase: in the middle of a clip it
    /// is the plain weighted mean, and it leaves turns of constant speed and straight ways as they are up to both ends.
    /// Logarithms are continued past half a turn, so fast spins keep their sense.
    ///
    /// # Errors
    /// [`Error::Config`] for a width outside [0, 2] s.
    pub fn smoothed(&self, sigma: f64) -> Result<MotionClip> {
        if !(0.0..=WIDEST).contains(&sigma) {
            let remedy = format!("give a standard deviation in [0, {WIDEST}] s; 0 switches it off");
            return Err(Error::config("smoothing", format!("{sigma} s"), remedy));
        }
        let count = self.poses.len();
        let reach = ((reach(sigma) * self.fps).ceil() as usize).min(count - 1);
        if sigma == 0.0 || reach == 0 {
            return Ok(self.clone());
        }
        let frames: Vec<Kernel> = {
            let inside = Kernel::new(reach, reach, sigma * self.fps);
            (0..count)
                .map(|i| match (i.min(reach), (count - 1 - i).min(reach)) {
                    (before, after) if before == reach && after == reach => inside.clone(),
                    (before, after) => Kernel::new(before, after, sigma * self.fps),
                })
                .collect()
        };
        let mut out = self.clone();
        for (i, kernel) in frames.iter().enumerate() {
            let around = &self.poses[i - kernel.before..];
            let sum = kernel.weights.iter().zip(around).map(|(w, pose)| pose.translation * *w);
            out.poses[i].translation = sum.fold(Vec3::zeros(), |a, b| a + b);
        }
        for joint in 0..self.poses[0].rotations.len() {
            if self.poses.iter().all(|p| p.rotations[joint] == self.poses[0].rotations[joint]) {
                continue;
            }
            let turns: Vec<UnitQuaternion<f64>> =
                self.poses.iter().map(|p| UnitQuaternion::from_scaled_axis(p.rotations[joint])).collect();
            for (i, kernel) in frames.iter().enumerate() {
                let own = turns[i];
                // Outwards on both sides, so that each logarithm continues its inner neighbour's.
                let side = |frames: &mut dyn Iterator<Item = usize>| {
                    let mut last = Vec3::zeros();
                    frames.fold(Vec3::zeros(), |sum, k| {
                        last = continued((own.inverse() * turns[k]).scaled_axis(), &last);
                        sum + last * kernel.weights[k + kernel.before - i]
                    })
                };
                let after = side(&mut (i + 1..i + kernel.weights.len() - kernel.before));
                let before = side(&mut (i - kernel.before..i).rev());
                let change = UnitQuaternion::from_scaled_axis(after + before);
                out.poses[i].rotations[joint] = (own * change).scaled_axis();
            }
        }
        Ok(out)
    }
}

/// How far a Gaussian of width `sigma` mixes frames [s].
pub(super) fn reach(sigma: f64) -> f64 {
    REACH * sigma
}

/// Weights of the frames around one.
#[derive(Clone)]
struct Kernel {
    before: usize,
    weights: Vec<f64>,
}

impl Kernel {
    /// Value at 0 of the line that is fitted to values at -before..=after: linear in them, with weights that sum to 1.
    fn new(before: usize, after: usize, sigma: f64) -> Self {
        let place = |k: usize| k as f64 - before as f64;
        let gauss: Vec<f64> = (0..=before + after).map(|k| (-0.5 * (place(k) / sigma).powi(2)).exp()).collect();
        let moment = |n: i32| -> f64 { gauss.iter().enumerate().map(|(k, w)| w * place(k).powi(n)).sum() };
        let [s0, s1, s2] = [moment(0), moment(1), moment(2)];
        let determinant = s0 * s2 - s1 * s1;
        let weights = gauss
            .iter()
            .enumerate()
            // Underflow of a kernel much narrower than a frame leaves the frame alone.
            .map(|(k, w)| if determinant > 0.0 { w * (s2 - place(k) * s1) / determinant } else { w / s0 })
            .collect();
        Self { before, weights }
    }
}

/// The rotation vector of the same rotation that lies nearest to `last`.
fn continued(vector: Vec3, last: &Vec3) -> Vec3 {
    let angle = vector.norm();
    if angle == 0.0 {
        return vector;
    }
    let axis = vector / angle;
    axis * (angle + TAU * ((axis.dot(last) - angle) / TAU).round())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::Pose;

    fn clip(count: usize, fps: f64, at: impl Fn(f64) -> (Vec3, Vec3)) -> MotionClip {
        let poses = (0..count)
            .map(|i| {
                let (rotation, translation) = at(i as f64 / fps);
                Pose { rotations: vec![Vec3::zeros(), rotation], translation }
            })
            .collect();
        MotionClip::new("clip", fps, poses).unwrap()
    }

    /// Largest angle [rad] and distance [m] between two clips.
    fn difference(a: &MotionClip, b: &MotionClip) -> (f64, f64) {
        a.poses.iter().zip(&b.poses).fold((0.0, 0.0), |(angle, way), (p, q)| {
            let turn = |pose: &Pose| UnitQuaternion::from_scaled_axis(pose.rotations[1]);
            (turn(p).angle_to(&turn(q)).max(angle), (p.translation - q.translation).norm().max(way))
        })
    }

    #[test]
    fn constant_speed_is_left_alone_up_to_the_ends() {
        // 40 rad/s at 60 fps is 0.67 rad per frame: the window of ±0.3 s spans almost four turns.
        for speed in [0.5, 40.0] {
            let axis = Vec3::new(1.0, -2.0, 0.5).normalize();
            let start = UnitQuaternion::from_scaled_axis(Vec3::new(0.3, 0.2, -0.9));
            let spin = clip(90, 60.0, |t| {
                (
                    (start * UnitQuaternion::from_scaled_axis(axis * speed * t)).scaled_axis(),
                    Vec3::new(1.0, 2.0, 3.0) * t,
                )
            });
            let (angle, way) = difference(&spin, &spin.smoothed(0.1).unwrap());
            assert!(angle < 1e-12 && way < 1e-12, "{speed}: {angle:e} rad, {way:e} m");
        }
    }

    #[test]
    fn noise_goes_motion_stays_and_nothing_is_late() {
        let truth = |t: f64| (Vec3::new(0.8 * (3.0 * t).sin(), 0.0, 0.4), Vec3::new(t, 0.1 * (4.0 * t).cos(), 0.0));
        let noise = |t: f64, k: f64| 0.02 * (1e4 * (t + 0.01) * (1.0 + k)).sin();
        let (clean, noisy) = (
            clip(300, 60.0, truth),
            clip(300, 60.0, |t| {
                let (r, x) = truth(t);
                let n = |k: f64| Vec3::new(noise(t, k), noise(t, k + 0.1), noise(t, k + 0.2));
                (r + n(0.3), x + n(0.7))
            }),
        );
        let smooth = noisy.smoothed(0.05).unwrap();
        let rms = |a: &MotionClip, b: &MotionClip| {
            let squares = a.poses.iter().zip(&b.poses).map(|(p, q)| (p.rotations[1] - q.rotations[1]).norm_squared());
            (squares.sum::<f64>() / a.poses.len() as f64).sqrt()
        };
        let (before, after) = (rms(&clean, &noisy), rms(&clean, &smooth));
        // White noise through a Gaussian of s = 3 frames shrinks by 1/sqrt(2 s sqrt(pi)) = 0.31; the curve itself loses
        // ½σ²x'' = 0.009 rad at most.
        assert!(after < 0.45 * before, "{before} -> {after}");
        // Symmetric in time: reversing before or after smoothing is the same.
        let reversed = |c: &MotionClip| MotionClip { poses: c.poses.iter().rev().cloned().collect(), ..c.clone() };
        let (angle, way) = difference(&reversed(&smooth), &reversed(&noisy).smoothed(0.05).unwrap());
        assert!(angle < 1e-12 && way < 1e-12, "{angle:e} {way:e}");
    }

    #[test]
    fn smoothing_sees_rotations_not_their_numbers() {
        // The same turn written with vectors that jump from +pi to -pi.
        let about = |t: f64| UnitQuaternion::from_scaled_axis(Vec3::z() * (3.0 + 2.0 * t)).scaled_axis();
        let spin = clip(60, 30.0, |t| (about(t), Vec3::zeros()));
        assert!(spin.poses.iter().any(|p| p.rotations[1].z < 0.0) && spin.poses[0].rotations[1].z > 0.0);
        assert!(difference(&spin, &spin.smoothed(0.2).unwrap()).0 < 1e-12);
    }

    #[test]
    fn widths_at_the_extremes() {
        let short = clip(1, 30.0, |_| (Vec3::x(), Vec3::y()));
        assert_eq!(short.smoothed(1.0).unwrap(), short);
        let two = clip(2, 30.0, |t| (Vec3::x() * t, Vec3::y()));
        assert!(difference(&two, &two.smoothed(2.0).unwrap()).0 < 1e-12);
        let many = clip(20, 30.0, |t| (Vec3::x() * t.sin(), Vec3::y() * t));
        assert_eq!(many.smoothed(0.0).unwrap(), many);
        assert!(difference(&many, &many.smoothed(1e-9).unwrap()).0 < 1e-12, "much narrower than a frame");
        for bad in [-0.1, f64::NAN, f64::INFINITY, 30.0] {
            assert!(many.smoothed(bad).unwrap_err().to_string().contains("smoothing"), "{bad}");
        }
    }
}
