//! The TOML file of an estimation.

use crate::config::place;
use crate::plugins::{Kind, PluginTable, Plugins};
use caphy_core::scan::Label;
use caphy_core::{Error, Result};
use caphy_garment::energy::ContactOptions;
use caphy_garment::estimate::{AlternationSettings, EquilibriumSettings};
use caphy_garment::solver::SolverSettings;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A whole estimation.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EstimateConfig {
    /// Folder of the results, relative to the file's folder unless absolute.
    pub out: PathBuf,
    /// Which estimator. Default `equilibrium`.
    #[serde(default)]
    pub method: Method,
    /// What is turned of the fabric's numbers. Default `multipliers`.
    #[serde(default)]
    pub reduction: ReductionChoice,
    /// The cloth at rest.
    pub cloth: ClothConfig,
    /// The fabric to start from, around which the prior lies.
    pub material: PluginTable,
    /// The equilibrium fit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub equilibrium: Option<EquilibriumSettings>,
    /// The paper's alternation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alternation: Option<AlternationSettings>,
    /// The reference solver, with the friction that is believed.
    #[serde(default)]
    pub solver: SolverSettings,
    /// Contact with bodies and tables.
    #[serde(default)]
    pub contact: ContactOptions,
    /// The scanned poses.
    pub pose: Vec<PoseConfig>,
}

/// Which estimator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Simulated equilibria are fitted to the scans.
    #[default]
    Equilibrium,
    /// Shapes between physics and scan, then Eq. 10, repeated.
    Alternation,
}

/// What is turned of the fabric's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReductionChoice {
    /// One factor per group: seven for a measured fabric.
    #[default]
    Multipliers,
    /// The factors first, then the whole table along combinations that the poses determine.
    Combinations,
    /// A blend of the ten measured fabrics.
    Blend,
}

/// `[cloth]`: what it is at rest, cut flat unless it is a mesh with a layout.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum ClothConfig {
    /// A rectangle, u along its width.
    Rectangle {
        /// Width and height [m].
        size_m: [f64; 2],
        /// Edge length of its triangles [m].
        edge_m: f64,
        /// Its mass [g]; without it the answer is stiffness over density.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        mass_g: Option<f64>,
    },
    /// A disc, as for Cusick's drape test.
    Disc {
        /// Diameter [m]; Cusick's specimen has 0.3.
        diameter_m: f64,
        /// Edge length of its triangles [m].
        edge_m: f64,
        /// Its mass [g].
        #[serde(default, skip_serializing_if = "Option::is_none")]
        mass_g: Option<f64>,
    },
    /// An OBJ: texture coordinates are its layout along the yarns in metres; without them it must lie flat in the x-y plane.
    Mesh {
        /// The file.
        path: PathBuf,
        /// Its mass [g].
        #[serde(default, skip_serializing_if = "Option::is_none")]
        mass_g: Option<f64>,
        /// Vertices that the body holds (a waistband), carried by each pose's start. Default none.
        #[serde(default)]
        held: Vec<u32>,
    },
}

/// `[[pose]]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseConfig {
    /// Name in the report.
    pub name: String,
    /// PLY or OBJ in metres, y up.
    pub scan: PathBuf,
    /// Whether the scan's vertices are the cloth's, in its order. Default false: a surface of any topology.
    #[serde(default)]
    pub registered: bool,
    /// Only vertices of this label belong to the cloth. Default all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<Label>,
    /// The cloth's shape to start from, an OBJ or PLY with the cloth's vertices in their order. Default: the scan where it is
    /// registered; else the cloth laid flat over the table, or as it is at rest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<PathBuf>,
    /// Clamped vertices: they stay where the start has them.
    #[serde(default)]
    pub clamps: Vec<Clamp>,
    /// What the cloth lies on or is worn by.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub on: Option<SurroundingsConfig>,
    /// Standard deviation of the scan's noise per coordinate [m]. Default: from the scan's own roughness.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_m: Option<f64>,
}

/// Vertices that do not move.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Clamp {
    /// By number.
    Vertices {
        /// Vertices of the cloth.
        vertices: Vec<u32>,
    },
    /// Those of the cloth at rest with normal · x ≥ offset.
    Plane {
        /// Normal of the plane.
        normal: [f64; 3],
        /// Its offset along the normal [m].
        offset_m: f64,
    },
    /// Those of the cloth at rest within a distance of a place: a pin.
    Pin {
        /// The place [m].
        at: [f64; 3],
        /// The distance [m].
        within_m: f64,
    },
}

/// What the cloth may touch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum SurroundingsConfig {
    /// A closed mesh, such as the posed body.
    Mesh {
        /// OBJ or PLY in metres.
        path: PathBuf,
    },
    /// Cusick's drapemeter: a round table about the y axis with its top at y = 0; the cloth is held between it and a plate of the
    /// same size. Its drape coefficient is reported.
    Cusick {
        /// Diameter of table and plate [m]. Default 0.18.
        #[serde(default = "eighteen_centimetres")]
        table_m: f64,
    },
    /// A ball.
    Sphere {
        /// Its centre [m].
        centre: [f64; 3],
        /// Its radius [m].
        radius_m: f64,
    },
}

fn eighteen_centimetres() -> f64 {
    0.18
}

/// Whether a file describes a whole experiment rather than an estimation.
///
/// # Errors
/// [`Error::Io`]; [`Error::Format`] with line and column.
pub fn is_experiment(path: &Path) -> Result<bool> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
    Ok(crate::config::parse_table(path, &text)?.contains_key("run"))
}

impl EstimateConfig {
    /// Reads a file and resolves its material.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Format`] with line and column; [`Error::Config`] for options that cannot act together.
    pub fn read(path: &Path, plugins: &Plugins) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        let mut config: Self = toml::from_str(&text).map_err(|e| {
            let start = e.span().map_or(0, |s| s.start);
            place::at(path, &text, start, e.message(), "correct the line")
        })?;
        config.material.resolve_in(plugins, Kind::Material, path, &text, "material")?;
        plugins.settle(path);
        config.check()?;
        Ok(config)
    }
    fn check(&self) -> Result<()> {
        let silent = |key: &str, because: &str| {
            Err(Error::config(key, format!("has no effect, because {because}"), "remove it"))
        };
        match self.method {
            Method::Equilibrium if self.alternation.is_some() => silent("alternation", "method = \"equilibrium\""),
            Method::Alternation if self.equilibrium.is_some() => silent("equilibrium", "method = \"alternation\""),
            Method::Alternation if self.reduction == ReductionChoice::Combinations => Err(Error::config(
                "reduction",
                "combinations are found by the equilibrium fit",
                "choose multipliers or blend, or method = \"equilibrium\"",
            )),
            _ => Ok(()),
        }?;
        for (i, pose) in self.pose.iter().enumerate() {
            if self.pose[..i].iter().any(|p| p.name == pose.name) {
                return Err(Error::config("pose.name", format!("`{}` appears twice", pose.name), "give other names"));
            }
            if pose.registered && pose.label.is_some() {
                let key = format!("pose `{}`, label", pose.name);
                return silent(&key, "registered = true: every vertex is the cloth's");
            }
        }
        Ok(())
    }
}
