//! Motion without a capture file: seeded clips and static capture poses in SMPL-X joint order.
//!
//! Everything starts in the A-pose, arms lowered: garments are worn with arms down, and a simulation needs a start that
//! is neither a T-pose nor a jump. Signs (T-pose facing +z, left is +x): the left arm lowers by a negative rotation about
//! z, a thigh lifts forward by a negative rotation about x, a knee bends by a positive one.

use caphy_core::motion::MotionClip;
use caphy_core::pose::{Pose, SMPLX_JOINTS};
use caphy_core::{Error, Result, Vec3};
use nalgebra::Rotation3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A kind of procedural motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionKind {
    /// Standing in the A-pose, swaying a little.
    APose,
    /// Walking forward (+z) with swinging arms.
    Walk,
    /// Squatting down and up, arms forward.
    Squat,
    /// Reaching up and forward with one hand, then the other.
    Reach,
    /// Turning around on the spot with small steps.
    Turn,
    /// Twisting the trunk left and right, arms half raised.
    Twist,
    /// Waving with the right hand.
    Wave,
    /// Raising both arms sideways over the head and lowering them.
    RaiseArms,
    /// Bending forward and straightening up.
    Bend,
}

impl MotionKind {
    /// All kinds.
    pub const ALL: [MotionKind; 9] = [
        Self::APose,
        Self::Walk,
        Self::Squat,
        Self::Reach,
        Self::Turn,
        Self::Twist,
        Self::Wave,
        Self::RaiseArms,
        Self::Bend,
    ];
    /// The name used in TOML.
    pub fn name(self) -> &'static str {
        match self {
            Self::APose => "a_pose",
            Self::Walk => "walk",
            Self::Squat => "squat",
            Self::Reach => "reach",
            Self::Turn => "turn",
            Self::Twist => "twist",
            Self::Wave => "wave",
            Self::RaiseArms => "raise_arms",
            Self::Bend => "bend",
        }
    }
}

/// Longest clip [s]: an hour; more is a slip of the unit.
const LONGEST: f64 = 3600.0;
/// Time over which a motion grows out of the A-pose [s].
const ONSET: f64 = 0.8;
/// Legs of an adult of 1.72 m [m]: the left hip from the pelvis, thigh, shank, heel and ball from the ankle. They say where the feet
/// are, and the feet where the pelvis is.
const HIP: [f64; 3] = [0.09, -0.09, 0.0];
const LEG: [f64; 2] = [0.41, 0.40];
const SOLE: [[f64; 3]; 2] = [[0.0, -0.08, -0.05], [0.0, -0.08, 0.13]];
/// Height over which the ground passes from one part of a sole to another [m]: a step instead would jolt.
const SOFT: f64 = 0.006;
/// Steps per second with which the feet are followed.
const FOLLOW: f64 = 240.0;
/// Arm angle of the A-pose below the horizontal [rad].
const ARM_DOWN: f64 = 1.05;

/// The angles that a person would name [rad]; pairs are left, right. All zero is the T-pose.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Posture {
    /// Below the horizontal; negative lifts.
    arm_down: [f64; 2],
    /// Swing forward about the left-right axis.
    arm_forward: [f64; 2],
    /// From the side to the front, in the horizontal plane.
    arm_across: [f64; 2],
    elbow: [f64; 2],
    hip_forward: [f64; 2],
    hip_out: [f64; 2],
    knee: [f64; 2],
    /// Toes down.
    ankle: [f64; 2],
    /// Forward.
    bend: f64,
    /// To the left.
    lean: f64,
    /// To the left.
    twist: f64,
    /// Head to the left, and down.
    head: [f64; 2],
    /// Heading, to the left.
    heading: f64,
}

impl Posture {
    fn a_pose() -> Self {
        Self { arm_down: [ARM_DOWN; 2], elbow: [0.15; 2], hip_out: [0.03; 2], ..Self::default() }
    }

    /// The pose, angles limited to what a healthy adult reaches.
    fn pose(&self) -> Pose {
        let mut pose = Pose::rest(SMPLX_JOINTS.len());
        let mut set = |joint: usize, turns: &[Rotation3<f64>]| {
            let all = turns.iter().fold(Rotation3::identity(), |a, b| a * b);
            pose.rotations[joint] = all.scaled_axis();
        };
        let [x, y, z] = [Vec3::x_axis(), Vec3::y_axis(), Vec3::z_axis()];
        let about = |axis: &nalgebra::Unit<Vec3>, angle: f64| Rotation3::from_axis_angle(axis, angle);
        let bend = self.bend.clamp(-0.4, 1.4) / 3.0;
        let twist = self.twist.clamp(-0.9, 0.9) / 3.0;
        let lean = self.lean.clamp(-0.5, 0.5) / 3.0;
        for spine in [3, 6, 9] {
            set(spine, &[about(&y, twist), about(&z, -lean), about(&x, bend)]);
        }
        let head = [self.head[0].clamp(-1.2, 1.2) / 2.0, self.head[1].clamp(-0.8, 0.8) / 2.0];
        for neck in [12, 15] {
            set(neck, &[about(&y, head[0]), about(&x, head[1])]);
        }
        for side in 0..2 {
            let sign = if side == 0 { 1.0 } else { -1.0 };
            let down = self.arm_down[side].clamp(-1.5, 1.35);
            // The shoulder blade takes a small part of lowering and a third of lifting above the horizontal.
            let blade = if down > 0.0 { 0.08 * down } else { 0.33 * down };
            set(13 + side, &[about(&z, -sign * blade)]);
            set(
                16 + side,
                &[
                    about(&x, -self.arm_forward[side].clamp(-0.9, 2.6)),
                    about(&y, -sign * self.arm_across[side].clamp(-0.5, 1.8)),
                    about(&z, -sign * (down - blade)),
                ],
            );
            set(18 + side, &[about(&y, -sign * self.elbow[side].clamp(0.0, 2.3))]);
            let (hip, knee) = (self.hip_forward[side].clamp(-0.5, 1.9), self.knee[side].clamp(0.0, 2.2));
            set(1 + side, &[about(&z, sign * self.hip_out[side].clamp(-0.2, 0.7)), about(&x, -hip)]);
            set(4 + side, &[about(&x, knee)]);
            let ankle = self.ankle[side].clamp(-0.68, 0.7);
            set(7 + side, &[about(&x, ankle)]);
            // Toes stay on the ground while the heel leaves it.
            set(10 + side, &[about(&x, -toes_up(knee + ankle - hip))]);
        }
        set(0, &[about(&y, self.heading)]);
        pose.translation.y = -above_ground(&soles(&pose));
        pose
    }

    /// Keeps the foot flat on the ground.
    fn flat_feet(mut self) -> Self {
        for side in 0..2 {
            self.ankle[side] = self.hip_forward[side] - self.knee[side];
        }
        self
    }
}

/// How far toes bend up [rad] when the sole points down by `pitch` [rad]: not at all while it is flat or points up.
fn toes_up(pitch: f64) -> f64 {
    0.5 * (1.0 - (-(pitch.max(0.0) / 0.8).powi(2)).exp())
}

/// Heels and balls of both feet relative to the pelvis's rest [m], translation left out.
fn soles(pose: &Pose) -> [Vec3; 4] {
    let turn = |joint: usize| Rotation3::from_scaled_axis(pose.rotations[joint]);
    std::array::from_fn(|i| {
        let (side, part) = (i / 2, i % 2);
        let sign = if side == 0 { 1.0 } else { -1.0 };
        let knee = -LEG[0] * Vec3::y();
        let ankle = -LEG[1] * Vec3::y();
        let foot = turn(7 + side) * Vec3::from(SOLE[part]);
        turn(0) * (Vec3::new(sign * HIP[0], HIP[1], HIP[2]) + turn(1 + side) * (knee + turn(4 + side) * (ankle + foot)))
    })
}

/// How far the lowest part of the soles is above its place in the T-pose [m]; a soft minimum.
fn above_ground(soles: &[Vec3; 4]) -> f64 {
    let rest = HIP[1] - LEG[0] - LEG[1] + SOLE[0][1];
    let lowest = soles.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
    let mean = soles.iter().map(|p| (-(p.y - lowest) / SOFT).exp()).sum::<f64>() / 4.0;
    lowest - SOFT * mean.ln() - rest
}

/// How far the pelvis goes [m], so that what stands on the ground stays there: the mean way of the soles against the pelvis, weighted
/// by how near they are to the ground.
fn step(before: &[Vec3; 4], after: &[Vec3; 4]) -> Vec3 {
    let heights: [f64; 4] = std::array::from_fn(|i| 0.5 * (before[i].y + after[i].y));
    let lowest = heights.iter().copied().fold(f64::INFINITY, f64::min);
    let weights = heights.map(|h| (-(h - lowest) / SOFT).exp());
    let way: Vec3 = (0..4).map(|i| (before[i] - after[i]) * weights[i]).sum();
    let way = way / weights.iter().sum::<f64>();
    Vec3::new(way.x, 0.0, way.z)
}

/// Slow, seeded sway: three sines without a common period.
struct Sway {
    phases: [[f64; 3]; 6],
}

impl Sway {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        Self { phases: std::array::from_fn(|_| std::array::from_fn(|_| TAU * rng.random::<f64>())) }
    }
    /// About ±1; zero at t = 0 with zero slope, so that clips start still.
    fn at(&self, channel: usize, t: f64) -> f64 {
        let wave = |t: f64| -> f64 {
            [0.23, 0.41, 0.67].iter().zip(&self.phases[channel]).map(|(f, p)| (TAU * f * t + p).sin()).sum()
        };
        0.5 * wave(t) * onset(t)
    }
}

/// 0 at the start, 1 after [`ONSET`], with continuous acceleration.
fn onset(t: f64) -> f64 {
    let s = (t / ONSET).clamp(0.0, 1.0);
    s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
}

/// A rise and fall once per unit of phase: 0 at whole numbers, 1 in between.
fn swell(phase: f64) -> f64 {
    0.5 - 0.5 * (TAU * phase).cos()
}

/// A clip of one kind, y up, in SMPL-X joint order, starting at rest in the A-pose; `seed` varies size, pace and sway.
///
/// # Errors
/// [`Error::Config`] for a length outside (0, 3600] s, [`Error::Numerics`] for a bad frame rate.
pub fn procedural_clip(kind: MotionKind, seed: u64, seconds: f64, fps: f64) -> Result<MotionClip> {
    if !(seconds > 0.0 && seconds <= LONGEST) {
        return Err(Error::config("seconds", format!("{seconds} s"), format!("give a length in (0, {LONGEST}] s")));
    }
    if !(fps > 0.0 && fps <= 1000.0) {
        return Err(Error::config("fps", format!("{fps} 1/s"), "give a frame rate in (0, 1000] 1/s"));
    }
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let size = 0.85 + 0.3 * rng.random::<f64>();
    let pace = 0.9 + 0.2 * rng.random::<f64>();
    let mirrored = rng.random::<f64>() < 0.5;
    let sway = Sway::new(rng);
    let count = (seconds * fps + 1e-6).floor() as usize + 1;
    let at = |t: f64| {
        let mut p = posture(kind, t, size, pace);
        if mirrored {
            p = p.mirrored();
        }
        p.bend += 0.02 * sway.at(0, t);
        p.lean += 0.02 * sway.at(1, t);
        p.twist += 0.03 * sway.at(2, t);
        p.head[0] += 0.08 * sway.at(3, t);
        for side in 0..2 {
            p.arm_down[side] += 0.03 * sway.at(4 + side, t);
        }
        p.pose()
    };
    let parts = (FOLLOW / fps).ceil() as usize;
    let mut place = Vec3::zeros();
    let mut standing = soles(&at(0.0));
    let mut poses = Vec::with_capacity(count);
    for i in 0..count {
        let mut pose = at(i as f64 / fps);
        if i > 0 {
            for part in 1..=parts {
                let next = match part {
                    part if part == parts => soles(&pose),
                    part => soles(&at((i as f64 - 1.0 + part as f64 / parts as f64) / fps)),
                };
                place += step(&standing, &next);
                standing = next;
            }
        }
        pose.translation += place;
        poses.push(pose);
    }
    MotionClip::new(kind.name(), fps, poses)
}

fn posture(kind: MotionKind, t: f64, size: f64, pace: f64) -> Posture {
    let mut p = Posture::a_pose();
    let on = onset(t) * size;
    match kind {
        MotionKind::APose => {}
        // Not below the natural size, where a swinging foot would graze the ground.
        MotionKind::Walk => walk(&mut p, t, onset(t) * (0.6 + 0.45 * size), 0.9 * pace),
        MotionKind::Squat => {
            let down = on * swell(0.33 * pace * t);
            p.knee = [1.75 * down; 2];
            p.hip_forward = [1.15 * down; 2];
            p.hip_out = [0.03 + 0.2 * down; 2];
            p.bend = 0.35 * down;
            p.arm_forward = [1.2 * down; 2];
            p = p.flat_feet();
        }
        MotionKind::Reach => {
            let phase = 0.25 * pace * t;
            for side in 0..2 {
                // Left hand in the first half of the phase, right hand in the second.
                let half = phase - 0.5 * side as f64;
                let up = on * if half.rem_euclid(1.0) < 0.5 && half > 0.0 { swell(2.0 * half) } else { 0.0 };
                p.arm_forward[side] += 1.9 * up;
                p.elbow[side] += 0.25 * up;
                p.lean += if side == 0 { -0.12 * up } else { 0.12 * up };
                p.twist += if side == 0 { -0.2 * up } else { 0.2 * up };
            }
            p.head[1] = -0.15 * on;
        }
        MotionKind::Turn => {
            walk(&mut p, t, 0.35 * on, 1.1 * pace);
            // Speeds up with the onset, then turns steadily.
            p.heading = 1.1 * pace * size * walked(t);
            p.twist += 0.12 * on;
            p.head[0] += 0.25 * on;
        }
        MotionKind::Twist => {
            let wave = on * (TAU * 0.4 * pace * t).sin();
            p.twist = 0.75 * wave;
            p.heading = 0.15 * wave;
            p.head[0] = 0.2 * wave;
            p.arm_down = [ARM_DOWN - 0.55 * on; 2];
            p.arm_across = [0.35 * on; 2];
            p.elbow = [0.15 + 0.8 * on; 2];
        }
        MotionKind::Wave => {
            // The upper arm goes out to the side and turns about itself, so that the elbow bends upward.
            p.arm_down[1] = ARM_DOWN * (1.0 - on.min(1.0)) + 0.1 * on;
            p.arm_forward[1] = 1.35 * on;
            p.elbow[1] = 0.15 + on * (1.2 + 0.35 * (TAU * 1.1 * pace * t).sin());
            p.lean = 0.05 * on;
        }
        MotionKind::RaiseArms => {
            let up = on * swell(0.3 * pace * t);
            p.arm_down = [ARM_DOWN - 2.3 * up; 2];
            p.bend = -0.06 * up;
        }
        MotionKind::Bend => {
            let down = on * swell(0.28 * pace * t);
            p.bend = 0.9 * down;
            p.hip_forward = [0.5 * down; 2];
            p.knee = [0.25 * down; 2];
            p.arm_forward = [0.9 * down; 2];
            p.head[1] = 0.2 * down;
            p = p.flat_feet();
        }
    }
    p
}

/// ∫ onset dt: how far something goes that speeds up with the onset to speed 1.
fn walked(t: f64) -> f64 {
    let s = (t / ONSET).clamp(0.0, 1.0);
    ONSET * (2.5 * s.powi(4) - 3.0 * s.powi(5) + s.powi(6)) + (t - ONSET).max(0.0)
}

/// Hip flexion, knee flexion and plantar flexion of the ankle over a stride from heel strike, every 5 % [degrees]: walking at a natural
/// pace as in textbooks of gait (after Winter, *Biomechanics and Motor Control of Human Gait*), rounded, toes a little higher in the swing.
const GAIT: [[f64; 20]; 3] = [
    [
        22.0, 21.0, 18.5, 15.0, 11.0, 7.0, 3.0, -1.0, -4.5, -8.0, -10.5, -11.0, -8.0, -2.0, 6.0, 13.0, 18.0, 21.5,
        23.0, 23.0,
    ],
    [4.0, 10.0, 16.0, 18.5, 18.0, 15.0, 12.0, 9.0, 7.0, 7.0, 10.0, 18.0, 33.0, 50.0, 61.0, 64.0, 58.0, 45.0, 26.0, 9.0],
    [0.0, 4.5, 4.0, 0.0, -3.0, -5.0, -6.5, -8.0, -9.0, -9.5, -8.0, -1.0, 11.0, 19.0, 14.0, 6.0, 1.0, -0.5, 0.0, -0.5],
];

/// A curve of [`GAIT`] at a phase in [0, 1) [rad]: a cubic B-spline, whose acceleration is continuous.
fn gait(curve: usize, phase: f64) -> f64 {
    let x = phase * 20.0;
    let (i, u) = (x.floor() as usize, x.fract());
    let weights = [
        (1.0 - u).powi(3) / 6.0,
        (3.0 * u.powi(3) - 6.0 * u * u + 4.0) / 6.0,
        (-3.0 * u.powi(3) + 3.0 * u * u + 3.0 * u + 1.0) / 6.0,
        u.powi(3) / 6.0,
    ];
    let value: f64 = weights.iter().enumerate().map(|(k, w)| w * GAIT[curve][(i + k + 19) % 20]).sum();
    value.to_radians()
}

/// Walking; where it leads follows from the feet.
fn walk(p: &mut Posture, t: f64, on: f64, strides_per_second: f64) {
    // Begins in mid-stance, where the legs are nearly together.
    let cycle = strides_per_second * t + 0.27;
    for side in 0..2 {
        let phase = (cycle + 0.5 * side as f64).rem_euclid(1.0);
        let swing = (TAU * phase).cos();
        p.hip_forward[side] = on * gait(0, phase);
        p.knee[side] = on * gait(1, phase);
        p.ankle[side] = on * gait(2, phase);
        // The pelvis goes over the foot that stands.
        p.hip_out[side] = 0.03 * (1.0 - on) - on * (0.01 + 0.025 * (TAU * phase).sin());
        // Arms go against their leg.
        p.arm_forward[side] = -on * (0.02 + 0.34 * swing);
        p.arm_down[side] = ARM_DOWN + 0.22 * on;
        p.elbow[side] = 0.15 + on * (0.22 - 0.13 * swing);
    }
    p.twist = 0.12 * on * (TAU * cycle).cos();
    p.bend = 0.04 * on;
}

impl Posture {
    fn mirrored(mut self) -> Self {
        for pair in [
            &mut self.arm_down,
            &mut self.arm_forward,
            &mut self.arm_across,
            &mut self.elbow,
            &mut self.hip_forward,
            &mut self.hip_out,
            &mut self.knee,
            &mut self.ankle,
        ] {
            pair.swap(0, 1);
        }
        for odd in [&mut self.lean, &mut self.twist, &mut self.head[0], &mut self.heading] {
            *odd = -*odd;
        }
        self
    }
    /// Small seeded changes, as no two people strike the same pose.
    fn varied(mut self, rng: &mut ChaCha8Rng, size: f64) -> Self {
        let mut noise = || size * (2.0 * rng.random::<f64>() - 1.0);
        for side in 0..2 {
            self.arm_down[side] += noise();
            self.arm_forward[side] += noise();
            self.elbow[side] += 0.5 * noise();
        }
        self.bend += 0.3 * noise();
        self.lean += 0.3 * noise();
        self.twist += 0.6 * noise();
        self.head[0] += noise();
        self.heading += 0.5 * noise();
        self
    }
}

/// Poses as a scan session takes them, in SMPL-X joint order: the A-pose first and exact, then star, arms forward, knee up,
/// twist, half squat, reaching up, walking phases, and so on; after the list is used up it repeats with other variations.
pub fn static_poses(seed: u64, count: usize) -> Vec<Pose> {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let base = capture_postures();
    (0..count)
        .map(|i| {
            let size = if i == 0 { 0.0 } else { 0.06 + 0.06 * (i / base.len()) as f64 };
            base[i % base.len()].varied(rng, size.min(0.25)).pose()
        })
        .collect()
}

fn capture_postures() -> Vec<Posture> {
    let a = Posture::a_pose();
    let gait = |t: f64| {
        let mut p = a;
        walk(&mut p, t, 1.0, 0.9);
        p
    };
    vec![
        a,
        Posture { arm_down: [0.1; 2], hip_out: [0.25; 2], ..a },
        Posture { arm_down: [0.15; 2], arm_across: [1.25; 2], ..a },
        Posture { hip_forward: [1.2, 0.0], knee: [1.35, 0.0], arm_forward: [-0.2, 0.5], ..a },
        Posture { twist: 0.6, arm_down: [0.7; 2], elbow: [0.7; 2], head: [0.2, 0.0], ..a },
        Posture { hip_forward: [0.75; 2], knee: [1.2; 2], arm_forward: [0.8; 2], bend: 0.25, hip_out: [0.12; 2], ..a }
            .flat_feet(),
        Posture { arm_down: [-0.9, 0.9], lean: -0.12, ..a },
        gait(0.0),
        gait(0.3),
        Posture { twist: -0.6, arm_down: [0.8; 2], elbow: [0.6; 2], head: [-0.2, 0.0], ..a },
        Posture { hip_forward: [0.0, 1.2], knee: [0.0, 1.35], arm_forward: [0.5, -0.2], ..a },
        Posture { arm_down: [-1.0; 2], bend: -0.08, ..a },
        Posture { bend: 0.7, hip_forward: [0.4; 2], knee: [0.2; 2], arm_forward: [0.8; 2], ..a }.flat_feet(),
        Posture { lean: 0.3, arm_down: [0.9, -0.3], ..a },
        Posture { hip_forward: [0.5, -0.3], knee: [0.6, 0.3], arm_forward: [-0.3, 0.5], ..a },
        gait(0.85),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BodyMannequin;
    use caphy_core::body::{BodyModel, BodyParameters};
    use caphy_core::motion::MotionLimits;
    use caphy_core::pose::smplx_joint;

    fn joint(name: &str) -> usize {
        smplx_joint(name).unwrap()
    }

    #[test]
    fn clips_are_smooth_seeded_and_start_with_arms_lowered() {
        for kind in MotionKind::ALL {
            let clip = procedural_clip(kind, 7, 4.0, 60.0).unwrap();
            assert_eq!(clip.poses.len(), 241, "{kind:?}");
            assert_eq!(clip, procedural_clip(kind, 7, 4.0, 60.0).unwrap());
            assert_ne!(clip, procedural_clip(kind, 8, 4.0, 60.0).unwrap());
            assert!(clip.poses[0].rotations[joint("left_shoulder")].z < -0.8, "{kind:?}");
            assert!(clip.poses[0].rotations[joint("right_shoulder")].z > 0.8, "{kind:?}");
            for pair in clip.poses.windows(3) {
                for j in 0..SMPLX_JOINTS.len() {
                    let [a, b, c] = [0, 1, 2].map(|k| Rotation3::from_scaled_axis(pair[k].rotations[j]));
                    let (v, w) = (a.inverse() * b, b.inverse() * c);
                    // 12 rad/s and 150 rad/s² are fast for people.
                    assert!(v.angle() * 60.0 < 12.0, "{kind:?} {}: {} rad/s", SMPLX_JOINTS[j], v.angle() * 60.0);
                    let acceleration = (v.scaled_axis() - w.scaled_axis()).norm() * 3600.0;
                    assert!(acceleration < 150.0, "{kind:?} {}: {acceleration} rad/s²", SMPLX_JOINTS[j]);
                }
                let jump = pair[0].translation - 2.0 * pair[1].translation + pair[2].translation;
                assert!(jump.norm() * 3600.0 < 30.0, "{kind:?}: {} m/s²", jump.norm() * 3600.0);
            }
        }
    }

    #[test]
    fn limbs_go_where_their_names_say() {
        let body = BodyMannequin { resolution: 0.026 }.generate().unwrap();
        let joints = |p: &Posture| {
            let rest = BodyParameters::rest(55, &[]);
            body.forward(&rest.posed(&p.pose())).unwrap().joints
        };
        let t = joints(&Posture::default());
        let a = joints(&Posture::a_pose());
        let moved = |p: Posture, name: &str| joints(&p)[joint(name)] - a[joint(name)];
        for (name, side) in [("left_wrist", 1.0), ("right_wrist", -1.0)] {
            assert!(a[joint(name)].y < t[joint(name)].y - 0.3, "{name} is lowered");
            assert!(a[joint(name)].x * side > 0.25, "{name} stays on its side");
        }
        let base = Posture::a_pose();
        assert!(moved(Posture { arm_forward: [1.0; 2], ..base }, "right_wrist").z > 0.2);
        assert!(moved(Posture { elbow: [1.2; 2], ..base }, "left_wrist").z > 0.1);
        assert!(moved(Posture { hip_forward: [0.8, 0.0], ..base }, "left_knee").z > 0.2);
        assert!(moved(Posture { knee: [0.0, 1.0], ..base }, "right_ankle").z < -0.2);
        assert!(moved(Posture { hip_out: [0.4; 2], ..base }, "left_ankle").x > 0.1);
        assert!(moved(Posture { bend: 0.8, ..base }, "head").z > 0.2);
        assert!(moved(Posture { lean: 0.4, ..base }, "head").x > 0.1);
        assert!(moved(Posture { twist: 0.6, ..base }, "left_shoulder").z < -0.05);
        let tiptoe = joints(&Posture { ankle: [0.4; 2], ..base });
        let foot = |all: &[Vec3]| all[joint("left_foot")].y - all[joint("left_ankle")].y;
        assert!(foot(&tiptoe) < foot(&a) - 0.03 && tiptoe[0].y > a[0].y + 0.03, "toes down, on tiptoe");
        let squat = joints(&Posture { knee: [1.2; 2], hip_forward: [0.7; 2], ..base }.flat_feet());
        assert!((squat[joint("left_ankle")].y - a[joint("left_ankle")].y).abs() < 0.02, "feet stay on the ground");
    }

    #[test]
    fn standing_feet_stay_where_they_are_and_joints_within_their_range() {
        let limits = MotionLimits { margin_degrees: 0.0, ..MotionLimits::default() };
        for kind in MotionKind::ALL {
            for seed in 0..6 {
                let clip = procedural_clip(kind, seed, 5.0, 30.0).unwrap();
                let found = limits.screen(&clip).unwrap().findings;
                assert!(found.is_empty(), "{kind:?}: {}", found[0]);
                let feet: Vec<[Vec3; 4]> = clip.poses.iter().map(|p| soles(p).map(|s| s + p.translation)).collect();
                let (mut worst, mut mean) = ([0.0f64; 2], 0.0);
                let floor = HIP[1] - LEG[0] - LEG[1] + SOLE[0][1];
                for (frame, pair) in feet.windows(2).enumerate() {
                    let lowest = (0..4).min_by(|&a, &b| pair[0][a].y.total_cmp(&pair[0][b].y)).unwrap();
                    // A soft minimum of four lies at most ln 4 of its width off.
                    assert!((pair[0][lowest].y - floor).abs() <= SOFT * 4f64.ln() + 1e-12, "{kind:?} {frame}");
                    if pair[1][lowest].y > floor || kind == MotionKind::Turn {
                        // Feet that leave the ground, and feet that turn on it.
                        continue;
                    }
                    let slide = (pair[1][lowest] - pair[0][lowest]).xz().norm() * 30.0;
                    let onset = usize::from((frame as f64) < ONSET * 30.0);
                    worst[onset] = worst[onset].max(slide);
                    mean += slide / feet.len() as f64;
                }
                // Fastest where the ground passes from foot to foot, and while steps grow out of standing. Toes of a captured
                // walk (CMU 35_01) show 0.08 m/s as their median while standing, 0.48 as their 90th percentile.
                assert!(worst[0] < 0.4 && worst[1] < 0.6 && mean < 0.08, "{kind:?} {seed}: {worst:?} {mean} m/s");
            }
        }
        let walk = procedural_clip(MotionKind::Walk, 1, 6.0, 30.0).unwrap();
        let speed = walk.poses[180].translation.z / 6.0;
        assert!((0.8..1.6).contains(&speed), "{speed} m/s");
        let fine = procedural_clip(MotionKind::Walk, 1, 6.0, 120.0).unwrap();
        let apart = (fine.poses[720].translation - walk.poses[180].translation).norm();
        assert!(apart < 0.01, "the way does not depend on the frame rate: {apart} m");
    }

    #[test]
    fn capture_poses_begin_with_the_a_pose() {
        let poses = static_poses(3, 40);
        assert_eq!(poses.len(), 40);
        assert_eq!(poses[0], Posture::a_pose().pose());
        assert_ne!(poses[1], poses[17]);
        assert_eq!(poses, static_poses(3, 40));
        assert!(static_poses(3, 0).is_empty());
    }

    #[test]
    fn bad_lengths_and_rates_are_refused() {
        for (seconds, fps) in [(0.0, 30.0), (f64::NAN, 30.0), (1e9, 30.0), (1.0, 0.0), (1.0, f64::INFINITY)] {
            assert!(procedural_clip(MotionKind::Walk, 0, seconds, fps).is_err(), "{seconds} {fps}");
        }
    }
}
