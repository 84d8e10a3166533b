//! Values that cannot be used are refused before anything runs.

use super::{ClipConfig, Config, HeldOut, PerceptualConfig, SubjectConfig};
use crate::files::ProjectFiles;
use caphy_core::{Error, Result};
use caphy_formats::onnx;
use caphy_garment::energy::ContactOptions;
use caphy_garment::template::{RESOLUTION_RANGE, StyleRange};
use std::path::Path;

impl Config {
    /// Refuses paths that lead to no file, and networks that this program cannot run, before hours are spent on the way to the stage
    /// that reads them.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key and the path.
    pub fn check_files(&self, files: &ProjectFiles) -> Result<()> {
        let mut named: Vec<(&str, &Path)> = Vec::new();
        if let Some(parser) = self
            .segmenter
            .as_ref()
            .map(|s| s.table())
            .filter(|t| t.get("type").and_then(|t| t.as_str()) == Some("onnx"))
        {
            onnx::available("segmenter.type")?;
            named.extend(parser.get("path").and_then(|p| p.as_str()).map(|path| ("segmenter.path", Path::new(path))));
        }
        if let Some(network) = &self.evaluate.perceptual_network {
            onnx::available(PerceptualConfig::KEY)?;
            named.push((PerceptualConfig::KEY, &network.path));
        }
        let clips = self.motion.clips.iter().map(|clip| ("motion.clips", clip));
        for (key, clip) in clips.chain(self.played()) {
            match clip {
                ClipConfig::Procedural { .. } => {}
                ClipConfig::Amass { path, .. } | ClipConfig::Tracked { path, .. } => named.push((key, path)),
                ClipConfig::Bvh { path, mapping, .. } => {
                    named.push((key, path));
                    named.extend(mapping.as_deref().map(|m| (key, m)));
                }
                ClipConfig::AsfAmc { skeleton, path, mapping, .. } => {
                    named.extend([(key, &**skeleton), (key, &**path)]);
                    named.extend(mapping.as_deref().map(|m| (key, m)));
                }
                ClipConfig::Folder { path, mapping, .. } => {
                    let resolved = files.resolve(path)?;
                    if !resolved.is_dir() {
                        let problem = format!("{} is not a folder", resolved.display());
                        return Err(Error::config(key, problem, "correct the path"));
                    }
                    named.extend(mapping.as_deref().map(|m| (key, m)));
                }
            }
        }
        if let SubjectConfig::Scans(scans) = &self.subject {
            named.extend(scans.starts.as_deref().map(|path| ("subject.starts", path)));
        }
        named.extend(self.evaluate.ground_truth.as_deref().map(|path| ("evaluate.ground_truth", path)));
        for (key, path) in named {
            let resolved = files.resolve(path)?;
            if !resolved.is_file() {
                return Err(Error::config(key, format!("{} is not a file", resolved.display()), "correct the path"));
            }
        }
        Ok(())
    }
    /// Refuses values that no stage could use.
    pub(super) fn check(&self) -> Result<()> {
        let positive = |key: &str, value: f64| {
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                Err(Error::config(key, format!("{value}"), "give a positive number"))
            }
        };
        let count = |key: &str, value: usize, least: usize, most: usize| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(Error::config(key, format!("{value}"), format!("give {least} to {most}")))
            }
        };
        let not_negative = |key: &str, value: f64| {
            if value.is_finite() && value >= 0.0 {
                Ok(())
            } else {
                Err(Error::config(key, format!("{value}"), "give 0 or a positive number"))
            }
        };
        let resolution = |key: &str, value: f64| {
            let StyleRange { lower, upper, .. } = RESOLUTION_RANGE;
            if (lower..=upper).contains(&value) {
                Ok(())
            } else {
                Err(Error::config(key, format!("{value}"), format!("give {lower} to {upper} m")))
            }
        };
        for (key, material) in self.materials() {
            material.material(key)?;
        }
        if self.garments().next().is_none() {
            return Err(Error::config("upper", "there is no garment", "add [upper], [lower] or both"));
        }
        if self.segmenter.is_none() && !matches!(self.subject, SubjectConfig::Dressed(_)) {
            let remedy = "add [segmenter]: scans must be labelled before anything is fitted to them";
            return Err(Error::config("segmenter", "there is no such table", remedy));
        }
        for (_, name, garment) in self.garments() {
            count(&format!("{name}.styles"), garment.styles, 1, 100_000)?;
            resolution(&format!("{name}.resolution_m"), garment.resolution_m)?;
            garment.mass_g.map_or(Ok(()), |mass| positive(&format!("{name}.mass_g"), mass))?;
        }
        for (key, clip) in self.motion.clips.iter().map(|c| ("motion.clips", c)).chain(self.played()) {
            match clip {
                ClipConfig::Procedural { seconds, .. } => positive(&format!("{key}.seconds"), *seconds)?,
                ClipConfig::Amass { .. } => {}
                ClipConfig::Tracked { up, gravity, fps, smoothing_s, .. } => {
                    let down = gravity.is_none_or(|g| g.iter().all(|x| x.is_finite()) && g.iter().any(|x| *x != 0.0));
                    if up.is_some() == gravity.is_some() || !down {
                        let problem = match (up, gravity) {
                            (Some(_), Some(_)) => "is given beside `up`".into(),
                            (None, None) => "is missing, and `up`, too".into(),
                            _ => format!("{gravity:?} is no direction"),
                        };
                        let remedy = "give the axis that points up (`up`) or the direction of falling (`gravity`)";
                        return Err(Error::config(format!("{key}.gravity"), problem, remedy));
                    }
                    fps.map_or(Ok(()), |fps| positive(&format!("{key}.fps"), fps))?;
                    not_negative(&format!("{key}.smoothing_s"), *smoothing_s)?;
                }
                ClipConfig::Bvh { metres_per_unit, .. } => {
                    metres_per_unit.map_or(Ok(()), |m| positive(&format!("{key}.metres_per_unit"), m))?;
                }
                ClipConfig::AsfAmc { fps, .. } => positive(&format!("{key}.fps"), *fps)?,
                ClipConfig::Folder { amc_fps, .. } => positive(&format!("{key}.amc_fps"), *amc_fps)?,
            }
        }
        for (key, clip) in self.played() {
            if matches!(clip, ClipConfig::Folder { .. }) {
                return Err(Error::config(key, "is a folder", "name one clip"));
            }
        }
        if let Some(compare) = &self.compare {
            positive("compare.seconds", compare.seconds)?;
            count("compare.rest_every", compare.rest_every, 1, usize::MAX)?;
            positive("compare.solver.tolerance_n", compare.solver.tolerance_n)?;
        }
        if let Some(solver) = self.animate.as_ref().and_then(|a| a.solver) {
            positive("animate.solver.tolerance_n", solver.tolerance_n)?;
        }
        self.tradeoff().check()?;
        self.motion.variation.check()?;
        self.motion.limits.check().map_err(|e| match e {
            Error::Config { key, problem, remedy } => Error::config(format!("motion.limits.{key}"), problem, remedy),
            other => other,
        })?;
        self.registration.check()?;
        count("templates.scans", self.templates.scans, 1, 100)?;
        // Sizes that no net has; the real numbers of inputs and outputs follow from body and garment.
        self.net.net(1, 3)?;
        let held_out = match &self.subject {
            SubjectConfig::Synthetic(s) => Some(&s.held_out),
            SubjectConfig::Scans(s) => Some(&s.held_out),
            SubjectConfig::Dressed(_) => None,
        };
        if let Some(HeldOut::Share(share)) = held_out
            && !(0.0..1.0).contains(share)
        {
            let remedy = "give a share below 1, as 0.2, or a list of names";
            return Err(Error::config("subject.held_out", share.to_string(), remedy));
        }
        if let SubjectConfig::Synthetic(s) = &self.subject {
            count("subject.scans", s.scans, 2, 1000)?;
            resolution("subject.resolution_m", s.resolution_m)?;
            s.check()?;
            let reads = self.segmenter.as_ref().and_then(|table| table.table().get("type")).and_then(|t| t.as_str());
            if !s.rig.labels && reads == Some("vertex") {
                let problem = "false, but the segmenter `vertex` reads the labels that scans carry";
                return Err(Error::config("subject.rig.labels", problem, "give true, or choose another segmenter"));
            }
        }
        count("views.count", self.views.count, 1, 10_000)?;
        count("views.size", self.views.size, 16, 16_384)?;
        count("motion.clips", self.motion.clips.len(), 1, 1_000_000)?;
        positive("motion.fps", self.motion.fps)?;
        let train = &self.train;
        count("train.batch", train.batch, 1, 16)?;
        count("train.window", train.window, 1, 1000)?;
        count("train.lead_in", train.lead_in, 0, 1000)?;
        if train.lead_in == 1 {
            return Err(Error::config("train.lead_in", "1", "give 0, or at least 2: a velocity takes two frames"));
        }
        count("train.windows", train.windows, 1, usize::MAX)?;
        count("train.checkpoint_every", train.checkpoint_every, 1, usize::MAX)?;
        count("train.metrics_every", train.metrics_every, 1, usize::MAX)?;
        count("optimise.alternations", self.optimise.alternations, 0, 8)?;
        positive("train.learning_rate", train.learning_rate)?;
        positive("train.final_rate", train.final_rate)?;
        positive("train.clip_norm", train.clip_norm)?;
        if train.final_rate > 1.0 {
            return Err(Error::config("train.final_rate", format!("{}", train.final_rate), "give a share, at most 1"));
        }
        positive("train.output_scale_m", train.output_scale_m)?;
        count("train.scan_points", train.scan_points, 1, usize::MAX)?;
        for (name, schedule) in train.weights.named() {
            schedule.check(&format!("train.weights.{name}"))?;
        }
        let ContactOptions { margin, allowed_depth, load } = train.contact;
        not_negative("train.contact.margin", margin)?;
        positive("train.contact.allowed_depth", allowed_depth)?;
        not_negative("train.contact.load", load)?;
        let layering = &self.finetune.layering;
        not_negative("finetune.layering.margin", layering.margin)?;
        not_negative("finetune.layering.reach", layering.reach)?;
        not_negative("finetune.layering.weight", layering.weight)?;
        not_negative("evaluate.penetration_m", self.evaluate.penetration_m)?;
        self.evaluate.perceptual_network.as_ref().map_or(Ok(()), PerceptualConfig::check)?;
        positive("finetune.learning_rate", self.finetune.learning_rate)?;
        self.optimise.check()?;
        if let Some(animate) = &self.animate {
            not_negative("animate.push_out_m", animate.push_out_m)?;
            count("animate.obj_every", animate.obj_every, 1, usize::MAX)?;
            positive("animate.seconds", animate.seconds)?;
        }
        Ok(())
    }
    /// Single clips, with their keys.
    fn played(&self) -> impl Iterator<Item = (&'static str, &ClipConfig)> {
        let posed = match &self.subject {
            SubjectConfig::Synthetic(s) => s.clip.as_ref().map(|clip| ("subject.clip", clip)),
            _ => None,
        };
        let animate = self.animate.iter().map(|a| ("animate.clip", &a.clip));
        let swept = self.tradeoff.iter().flat_map(|t| {
            let clip = t.clip.iter().map(|clip| ("tradeoff.clip", clip));
            clip.chain([("tradeoff.check", &t.check)])
        });
        let compare = self.compare.iter().map(|c| ("compare.clip", &c.clip));
        posed.into_iter().chain(animate).chain(compare).chain(swept)
    }
}
