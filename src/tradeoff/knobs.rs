//! The knobs: everything of an experiment that trades speed for accuracy. One more is one line in [`KNOBS`].

use crate::config::{Config, ContactWith, GarmentConfig, Setting, SubjectConfig};
use caphy_core::extension::{Hinge, MaterialModelExt};
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result};
use caphy_garment::template::RESOLUTION_RANGE;
use std::path::PathBuf;
use toml::{Table, Value};

/// What a knob acts on, and so what a point of it costs and is measured by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Acts {
    /// Labels, bodies, templates: measured by wrong labels and by the body's distance.
    Preprocess,
    /// The same of each scan alone: measured with the fewest scans that are swept, and against the answer with these.
    Views,
    /// The trained net.
    Net,
    /// What the net is trained to: the fabric, which a budget never chooses.
    Fabric,
}

/// A knob.
pub struct Knob {
    /// Its name in tables and in `tradeoff.knobs`.
    pub name: &'static str,
    /// What it acts on.
    pub acts: Acts,
    levels: fn(&Base<'_>) -> Result<Vec<Level>>,
}

/// Another value of a knob.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    /// For people.
    pub name: String,
    /// What it sets.
    pub set: Vec<Setting>,
}

/// What levels are made from.
pub struct Base<'a> {
    /// The experiment, with few rounds unless `--full` is given.
    pub config: &'a Config,
    /// Rounds that the experiment's file asks for.
    pub own_rounds: usize,
    /// Folder and names of the scans that are learnt from, once they are there.
    pub scans: Option<(PathBuf, Vec<String>)>,
}

/// All knobs.
pub const KNOBS: &[Knob] = &[
    Knob { name: SCANS, acts: Acts::Preprocess, levels: scans },
    Knob { name: "views", acts: Acts::Views, levels: views },
    Knob { name: "view size", acts: Acts::Views, levels: view_size },
    Knob { name: "rounds", acts: Acts::Net, levels: rounds },
    Knob { name: "net", acts: Acts::Net, levels: net },
    Knob { name: "hidden", acts: Acts::Net, levels: hidden },
    Knob { name: "depth", acts: Acts::Net, levels: depth },
    Knob { name: "window", acts: Acts::Net, levels: window },
    Knob { name: "contact", acts: Acts::Net, levels: contact },
    Knob { name: "resolution", acts: Acts::Net, levels: resolution },
    Knob { name: "fabric", acts: Acts::Fabric, levels: plain_fabric },
    Knob { name: "stiffness gradient", acts: Acts::Fabric, levels: stiffness_gradient },
    Knob { name: "stretch lookup", acts: Acts::Fabric, levels: stretch_lookup },
];

/// Keys that a point of a front fixes: those of all knobs that act on the net.
const FIXED: [&str; 6] =
    ["net", "train.rounds", "train.window", "train.contact_with", "upper.resolution_m", "lower.resolution_m"];

/// Whether a setting changes the subject, not only how its nets are trained.
pub(super) fn is_of_subject(setting: &Setting) -> bool {
    setting.key().ends_with(".resolution_m")
}

impl Acts {
    /// Whether it is measured by preprocessing, without a training.
    pub fn preprocesses(self) -> bool {
        matches!(self, Self::Preprocess | Self::Views)
    }
}

/// The fewest scans that are swept; none where there are no fewer.
pub(super) fn fewest_scans(base: &Base<'_>) -> Result<Option<Level>> {
    Ok(scans(base)?.into_iter().next())
}

impl Knob {
    /// Its levels besides the experiment's own value; none where the experiment does not have it.
    ///
    /// # Errors
    /// What a fabric is refused for.
    pub fn levels(&self, base: &Base<'_>) -> Result<Vec<Level>> {
        (self.levels)(base)
    }
}

/// The knobs that are wanted.
///
/// # Errors
/// [`Error::Config`] for a name that there is not, with those that there are.
pub(super) fn chosen(names: &[String]) -> Result<Vec<&'static Knob>> {
    for name in names {
        if !KNOBS.iter().any(|k| k.name == name) {
            let all: Vec<&str> = KNOBS.iter().map(|k| k.name).collect();
            let remedy = format!("there are: {}", all.join(", "));
            return Err(Error::config("tradeoff.knobs", format!("there is no knob `{name}`"), remedy));
        }
    }
    Ok(KNOBS.iter().filter(|k| names.is_empty() || names.iter().any(|n| n == k.name)).collect())
}

/// The values of a configuration that a point of a front fixes.
///
/// # Errors
/// [`Error::Config`] for a configuration that cannot be written.
pub(super) fn fixed(config: &Config) -> Result<Vec<Setting>> {
    let table =
        Table::try_from(config).map_err(|e| Error::config("(whole file)", e.to_string(), "report this as a defect"))?;
    let found = |key: &&str| {
        let mut parts = key.split('.');
        let first = table.get(parts.next()?)?;
        parts.try_fold(first, |value, part| value.get(part)).map(|value| (key.to_string(), value.clone()))
    };
    FIXED.iter().filter_map(found).map(|(key, value)| Setting::new(&key, value)).collect()
}

fn level(name: String, settings: Vec<(&str, Value)>) -> Result<Level> {
    let set = settings.into_iter().map(|(key, value)| Setting::new(key, value)).collect::<Result<_>>()?;
    Ok(Level { name, set })
}

fn integer(value: usize) -> Value {
    Value::Integer(value as i64)
}

/// Levels of one key with whole numbers; the experiment's own is left out.
fn counts(key: &str, own: usize, values: impl IntoIterator<Item = usize>) -> Result<Vec<Level>> {
    let mut seen = vec![own];
    let mut out = Vec::new();
    for value in values {
        if !seen.contains(&value) {
            seen.push(value);
            out.push(level(value.to_string(), vec![(key, integer(value))])?);
        }
    }
    Ok(out)
}

fn views(base: &Base<'_>) -> Result<Vec<Level>> {
    let own = base.config.views.count;
    if base.scans.is_none() { Ok(Vec::new()) } else { counts("views.count", own, [own.div_ceil(4), own.div_ceil(2)]) }
}

fn view_size(base: &Base<'_>) -> Result<Vec<Level>> {
    let own = base.config.views.size;
    if base.scans.is_none() {
        Ok(Vec::new())
    } else {
        counts("views.size", own, [(own / 4).max(16), (own / 2).max(16)])
    }
}

/// Name of the knob by whose cheapest level knobs of views are measured.
pub(super) const SCANS: &str = "scans";

/// Half and a quarter of the scans that are learnt from, without the others and without those held out.
fn scans(base: &Base<'_>) -> Result<Vec<Level>> {
    let Some((folder, learnt)) = &base.scans else { return Ok(Vec::new()) };
    let mut out: Vec<Level> = Vec::new();
    for count in [learnt.len().div_ceil(4), learnt.len().div_ceil(2)] {
        let name = format!("{count} of {}", learnt.len());
        if count == learnt.len() || out.iter().any(|level| level.name == name) {
            continue;
        }
        let only: Vec<Value> = learnt[..count].iter().map(|name| Value::from(name.as_str())).collect();
        let none = Value::Array(Vec::new());
        if matches!(base.config.subject, SubjectConfig::Scans(_)) {
            out.push(level(name, vec![("subject.only", only.into()), ("subject.held_out", none)])?);
            continue;
        }
        // The generated scans as files: no other person, and nothing to search for but bodies.
        let folder = folder.display().to_string();
        let keys = [
            ("type", Value::from("scans")),
            ("folder", folder.into()),
            ("only", only.into()),
            ("held_out", none),
            ("units", "m".into()),
            ("up", "y".into()),
        ];
        let subject: Table = keys.map(|(key, value)| (key.to_string(), value)).into_iter().collect();
        out.push(level(name, vec![("subject", subject.into())])?);
    }
    Ok(out)
}

fn rounds(base: &Base<'_>) -> Result<Vec<Level>> {
    let few = base.config.train.rounds;
    counts("train.rounds", few, [1, few.div_ceil(2), 2 * few, base.own_rounds])
}

fn net_type<'a>(base: &Base<'a>) -> &'a str {
    base.config.net.table().get("type").and_then(Value::as_str).unwrap_or_default()
}

/// Layers of the net that the experiment has, from the first on; none for a type of a library.
fn widths(base: &Base<'_>) -> Vec<usize> {
    let table = base.config.net.table();
    let number = |value: &Value| value.as_integer().and_then(|v| usize::try_from(v).ok());
    match (net_type(base), table.get("hidden")) {
        ("gru", Some(hidden)) => {
            let layers = table.get("layers").and_then(number).unwrap_or(1);
            number(hidden).map_or(Vec::new(), |width| vec![width; layers])
        }
        ("mlp", Some(Value::Array(list))) => list.iter().filter_map(number).collect(),
        _ => Vec::new(),
    }
}

/// A net of these layers, of the experiment's own type: what differs, so that width and depth can be turned together.
fn net_of(base: &Base<'_>, wanted: &[usize]) -> Vec<(&'static str, Value)> {
    let own = widths(base);
    match net_type(base) {
        "gru" => {
            let changed = [
                (wanted.len() != own.len(), "net.layers", wanted.len()),
                (wanted.first() != own.first(), "net.hidden", wanted.first().copied().unwrap_or(1)),
            ];
            changed.into_iter().filter(|c| c.0).map(|(_, key, value)| (key, integer(value))).collect()
        }
        _ => vec![("net.hidden", wanted.iter().map(|&w| integer(w)).collect::<Vec<_>>().into())],
    }
}

fn net(base: &Base<'_>) -> Result<Vec<Level>> {
    let width = widths(base).first().copied().unwrap_or(256);
    let mut table = Table::new();
    let name = match net_type(base) {
        "gru" => {
            table.insert("hidden".into(), vec![integer(width); 2].into());
            "mlp"
        }
        "mlp" => {
            table.insert("hidden".into(), integer(width));
            "gru"
        }
        _ => return Ok(Vec::new()),
    };
    table.insert("type".into(), name.into());
    Ok(vec![level(name.into(), vec![("net", table.into())])?])
}

fn hidden(base: &Base<'_>) -> Result<Vec<Level>> {
    let own = widths(base);
    let scaled =
        |divide: usize, times: usize| -> Vec<usize> { own.iter().map(|w| (w * times / divide).max(1)).collect() };
    let all = [scaled(4, 1), scaled(2, 1), scaled(1, 2)];
    let name = |list: &[usize]| list.first().map_or(String::new(), usize::to_string);
    all.iter().filter(|list| !list.is_empty() && **list != own).map(|l| level(name(l), net_of(base, l))).collect()
}

fn depth(base: &Base<'_>) -> Result<Vec<Level>> {
    let own = widths(base);
    let Some(&width) = own.first() else { return Ok(Vec::new()) };
    let mut out = Vec::new();
    for count in [own.len().div_ceil(2), own.len() + own.len().div_ceil(2)] {
        if count != own.len() {
            out.push(level(count.to_string(), net_of(base, &vec![width; count]))?);
        }
    }
    Ok(out)
}

fn window(base: &Base<'_>) -> Result<Vec<Level>> {
    let own = base.config.train.window;
    counts("train.window", own, [3.min(own), 2 * own])
}

fn contact(base: &Base<'_>) -> Result<Vec<Level>> {
    let other = match base.config.train.contact_with {
        ContactWith::Vertex => "triangle",
        ContactWith::Triangle => "vertex",
    };
    Ok(vec![level(other.into(), vec![("train.contact_with", other.into())])?])
}

/// Edge lengths of the coarse and of the fine template over the experiment's own: half the vertices, and 1.6 times as many.
const COARSE: f64 = 1.4;
const FINE: f64 = 0.8;

fn resolution(base: &Base<'_>) -> Result<Vec<Level>> {
    let both = [COARSE, FINE].map(|factor| resolved(base, factor));
    both.into_iter().filter_map(Result::transpose).collect()
}

/// Templates whose edges are as long as the experiment's own times a factor; none where they cannot be.
fn resolved(base: &Base<'_>, factor: f64) -> Result<Option<Level>> {
    let (mut settings, mut names) = (Vec::new(), Vec::new());
    for (key, own) in [("upper.resolution_m", &base.config.upper), ("lower.resolution_m", &base.config.lower)] {
        let Some(GarmentConfig { resolution_m, .. }) = own else { continue };
        let value = (1e4 * resolution_m * factor).round() * 1e-4;
        let value = value.clamp(RESOLUTION_RANGE.lower, RESOLUTION_RANGE.upper);
        if value != *resolution_m {
            settings.push((key, Value::from(value)));
            names.push(format!("{:.1} mm", 1e3 * value));
        }
    }
    names.dedup();
    if settings.is_empty() { Ok(None) } else { level(names.join(", "), settings).map(Some) }
}

/// The finest template of the sweep, the yardstick's.
pub(super) fn finest(base: &Base<'_>) -> Result<Vec<Setting>> {
    Ok(resolved(base, FINE)?.map_or(Vec::new(), |level| level.set))
}

/// The coarsest template of the sweep.
pub(super) fn coarsest(base: &Base<'_>) -> Result<Vec<Setting>> {
    Ok(resolved(base, COARSE)?.map_or(Vec::new(), |level| level.set))
}

/// Garments whose fabric is measured, with their tables' keys.
fn measured<'a>(base: &'a Base<'_>) -> impl Iterator<Item = (&'static str, &'a GarmentConfig)> {
    base.config.garments().filter(|g| g.2.material.is_measured()).map(|(_, key, garment)| (key, garment))
}

/// λ and μ [N/m] of the rotational mean of a fabric's tangent at rest, and the mean of its bending stiffness [N·m] over directions
/// of a flat edge of this length [m].
fn plain(fabric: &dyn MaterialModel, edge: f64) -> Result<[f64; 3]> {
    let [[c11, c12, _], [_, c22, _], [.., c33]] = fabric.tangent_held_at([0.0; 3])?;
    // dSuv/dGuv is twice the shear modulus.
    let lambda = (c11 + c22 + 6.0 * c12 - 2.0 * c33) / 8.0;
    let mu = (c11 + c22 - 2.0 * c12 + 2.0 * c33) / 8.0;
    const DIRECTIONS: u32 = 8;
    let mut bending = 0.0;
    for i in 0..DIRECTIONS {
        let (s, c) = (std::f64::consts::PI * f64::from(i) / f64::from(DIRECTIONS)).sin_cos();
        let area = 3f64.sqrt() / 2.0 * edge * edge;
        let hinge = Hinge { angle: 0.0, angle_rest: 0.0, length: edge, area, directions: [[c, s]; 2] };
        bending += fabric.bending_stiffness(&hinge)? / f64::from(DIRECTIONS);
    }
    Ok([lambda, mu, bending])
}

/// Plain StVK of the same stiffness at rest.
fn plain_fabric(base: &Base<'_>) -> Result<Vec<Level>> {
    let mut set = Vec::new();
    for (key, garment) in measured(base) {
        let key = format!("{key}.material");
        let fabric = garment.material.material(&key)?;
        let [lambda, mu, bending] = plain(&*fabric, garment.resolution_m)?;
        let mut table: Table = [
            ("type", Value::from("stvk")),
            ("lambda_n_per_m", lambda.into()),
            ("mu_n_per_m", mu.into()),
            ("bending_nm", bending.into()),
        ]
        .map(|(k, v)| (k.to_string(), v))
        .into_iter()
        .collect();
        if let Some(density) = fabric.describe().density {
            table.insert("density_kg_per_m2".into(), density.0.into());
        }
        set.push(Setting::new(&key, table.into())?);
    }
    Ok(if set.is_empty() { Vec::new() } else { vec![Level { name: "stvk".into(), set }] })
}

/// A switch of measured fabrics.
fn switch(base: &Base<'_>, key: &str, values: [&str; 2]) -> Result<Vec<Level>> {
    let mut out = Vec::new();
    for value in values {
        let mut set = Vec::new();
        for (garment, config) in measured(base) {
            let own = config.material.table().get(key).and_then(Value::as_str).unwrap_or(values[0]);
            if own != value {
                set.push(Setting::new(&format!("{garment}.material.{key}"), value.into())?);
            }
        }
        if !set.is_empty() {
            out.push(Level { name: value.into(), set });
        }
    }
    Ok(out)
}

fn stiffness_gradient(base: &Base<'_>) -> Result<Vec<Level>> {
    switch(base, "stiffness_gradient", ["frozen", "full"])
}

fn stretch_lookup(base: &Base<'_>) -> Result<Vec<Level>> {
    switch(base, "lookup", ["table", "direct"])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn tiny() -> Config {
        Config::parse(Path::new("tiny.toml"), include_str!("../../tests/all/tiny.toml")).unwrap()
    }

    #[test]
    fn every_level_is_a_configuration_and_another_one() {
        let text = include_str!("../../tests/all/tiny.toml");
        let config = tiny();
        let names = (0..8).map(|i| format!("scan-{i:02}")).collect();
        let base = Base { config: &config, own_rounds: 9, scans: Some(("scans".into(), names)) };
        let own = toml::to_string(&config).unwrap();
        for knob in KNOBS {
            let levels = knob.levels(&base).unwrap();
            assert!(!levels.is_empty(), "{}", knob.name);
            for level in &levels {
                let read = Config::parse_set(
                    Path::new("tiny.toml"),
                    text,
                    &level.set,
                    &mut crate::plugins::Plugins::new().unwrap(),
                );
                let read = read.unwrap_or_else(|e| panic!("{} {}: {e}", knob.name, level.name));
                assert_ne!(toml::to_string(&read).unwrap(), own, "{} {}", knob.name, level.name);
            }
        }
        let said = |name: &str| {
            let knob = KNOBS.iter().find(|k| k.name == name).unwrap();
            knob.levels(&base).unwrap().into_iter().map(|l| l.name).collect::<Vec<_>>()
        };
        assert_eq!(said("rounds"), ["1", "2", "6", "9"]);
        assert_eq!(said("hidden"), ["8", "16", "64"]);
        assert_eq!(said("depth"), ["1", "3"]);
        assert_eq!(said("scans"), ["2 of 8", "4 of 8"]);
        assert_eq!(said("contact"), ["triangle"]);
        // Both garments are as coarse as can be.
        assert_eq!(said("resolution"), ["40.0 mm"]);
        let unknown = chosen(&["hiden".into()]).err().unwrap().to_string();
        assert!(unknown.contains("hiden") && unknown.contains("hidden"), "{unknown}");
    }

    #[test]
    fn a_plain_fabric_of_the_same_stiffness() {
        // Of a fabric that is one already nothing is lost.
        let text = "type = \"stvk\"\nlambda_n_per_m = 30.0\nmu_n_per_m = 12.0\nbending_nm = 2e-6";
        let plugins = crate::plugins::Plugins::new().unwrap();
        let kind = crate::plugins::Kind::Material;
        let table = crate::plugins::PluginTable::parse(&plugins, kind, Path::new("knit.toml"), text).unwrap();
        let found = plain(&*table.material("material").unwrap(), 0.02).unwrap();
        for (found, own) in found.into_iter().zip([30.0, 12.0, 2e-6]) {
            assert!((found / own - 1.0).abs() < 1e-12, "{found} {own}");
        }
        let config = tiny();
        let base = Base { config: &config, own_rounds: 3, scans: None };
        let level = plain_fabric(&base).unwrap().remove(0);
        let text = level.set[0].to_string();
        assert!(text.starts_with("upper.material={") && text.contains("type = \"stvk\""), "{text}");
        let fixed: Vec<String> = fixed(&config).unwrap().iter().map(Setting::to_string).collect();
        assert!(fixed.contains(&"train.window=5".to_string()) && fixed[0].starts_with("net={"), "{fixed:?}");
    }
}
