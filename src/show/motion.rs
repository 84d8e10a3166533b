//! What a clip is, and how a body moves by it.

use crate::dressed::Dressed;
use crate::moving::preview;
use caphy_core::Result;
use caphy_core::body::BodyModel;
use caphy_core::motion::{ClipFacts, PreparedClip};
use caphy_garment::skinning::WeightOptions;
use std::fmt::Write;

/// Frames on the contact sheet.
const FRAMES: usize = 16;
/// Joints that turn less than this are not listed [degrees].
const STILL: f64 = 1.0;
/// Findings that are listed.
const LISTED: usize = 12;

/// The facts for people.
pub fn text(f: &ClipFacts) -> String {
    let [low, high] = f.root_height_range_m;
    let mut out = format!(
        "{}\n  {:.2} s: {} frames at {:.4} 1/s in the file, {} at {} 1/s\n  pelvis: way {:.2} m, ends {:.2} m from its start, \
         {:.2} m/s on average, {:.2} at most, height {low:+.3} to {high:+.3} m\n  {} windows sound, {} dropped; {} frames \
         dropped\n",
        f.name,
        f.duration_s,
        f.source_frames,
        f.source_fps,
        f.frames,
        f.fps,
        f.root_path_m,
        f.root_displacement_m,
        f.root_mean_speed_m_per_s,
        f.root_fastest_m_per_s,
        f.windows,
        f.dropped_windows,
        f.dropped_frames,
    );
    // Writing to a String cannot fail.
    let _ = writeln!(
        out,
        "  joint                     x [°]           y [°]           z [°]     largest [°]  fastest [°/s]"
    );
    for j in f.joints.iter().filter(|j| j.largest_degrees >= STILL) {
        let range = |[a, b]: [f64; 2]| format!("{a:7.1} {b:7.1}");
        let _ = writeln!(
            out,
            "  {:20} {} {} {}  {:9.1}      {:9.0}",
            j.joint,
            range(j.x_degrees),
            range(j.y_degrees),
            range(j.z_degrees),
            j.largest_degrees,
            j.fastest_degrees_per_s
        );
    }
    for finding in f.findings.iter().take(LISTED) {
        let _ = writeln!(out, "  {finding}");
    }
    if f.findings.len() > LISTED {
        let _ = writeln!(out, "  and {} more findings", f.findings.len() - LISTED);
    }
    out
}

/// PNG of the naked body at times spread over the clip.
///
/// # Errors
/// A shape or clip that is not this body's.
pub fn sheet(body: &dyn BodyModel, shape: &[f64], clip: &PreparedClip) -> Result<Vec<u8>> {
    let naked = Dressed::new(body, shape, Vec::new(), &WeightOptions::default(), clip.clip.clone())?;
    preview(&naked, FRAMES)
}
