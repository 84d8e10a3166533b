//! Settings that another setting switches off: a value that somebody chose and that changes nothing is refused.

use super::{
    Config, EvaluateConfig, FinetuneConfig, GarmentConfig, OptimiseConfig, RigConfig, SubjectConfig, TemplatesConfig,
    TrainConfig, ViewsConfig, thirty,
};
use caphy_bodymodel::registration::RegistrationSettings;
use caphy_core::{Error, Result};
use serde::Serialize;

/// One reason why keys have no effect.
struct Rule {
    /// Whether it holds.
    holds: bool,
    /// The setting behind it, as it would stand in the file.
    because: &'static str,
    /// Dotted paths of keys, or of whole tables, that are then never read.
    silent: &'static [&'static str],
}

/// Refuses keys of `table` that were changed from their defaults and have no effect in `config`.
///
/// # Errors
/// [`Error::Config`] naming the key and the setting that switches it off.
pub(super) fn check(table: &toml::Table, config: &Config) -> Result<()> {
    let one_garment = config.garments().count() < 2;
    let no_finetuning = config.finetune.epochs == 0 || one_garment;
    let dressed = matches!(config.subject, SubjectConfig::Dressed(_));
    let rules = [
        Rule { holds: one_garment, because: "there is one garment", silent: &["finetune", "train.weights.layering"] },
        Rule {
            holds: dressed,
            because: "subject.type = \"dressed\", which has no scans",
            silent: &[
                "segmenter",
                "views",
                "registration",
                "templates",
                "evaluate.ground_truth",
                "evaluate.perceptual_network",
                "optimise",
                "train.scan_epochs",
                "train.scan_points",
                "train.weights.scan",
                "upper.styles",
                "lower.styles",
            ],
        },
        Rule { holds: !dressed, because: "styles are found from the scans", silent: &["upper.style", "lower.style"] },
        Rule {
            holds: no_finetuning,
            because: "finetune.epochs = 0",
            silent: &["finetune.windows", "finetune.learning_rate", "finetune.layering", "train.weights.layering"],
        },
        Rule {
            holds: config.optimise.alternations == 0,
            because: "optimise.alternations = 0",
            silent: &["optimise.estimator", "optimise.rounds"],
        },
        Rule {
            holds: config.train.scan_epochs == 0 && no_finetuning,
            because: "train.scan_epochs = 0 and finetune.epochs = 0",
            silent: &["train.scan_points", "train.weights.scan"],
        },
        Rule {
            holds: config.train.weights.scan.is_zero(),
            because: "train.weights.scan = 0",
            silent: &["train.scan_points"],
        },
        // A transition counts once its velocity is known, from the third frame on.
        Rule {
            holds: config.train.window < 3 && config.train.lead_in == 0,
            because: "train.window < 3 and train.lead_in = 0",
            silent: &["train.weights.inertia"],
        },
        Rule {
            holds: is_collection(config.upper.as_ref()),
            because: "upper.template names garments that are all tried",
            silent: &["upper.styles"],
        },
        Rule {
            holds: is_collection(config.lower.as_ref()),
            because: "lower.template names garments that are all tried",
            silent: &["lower.styles"],
        },
        Rule {
            holds: matches!(&config.subject, SubjectConfig::Synthetic(s) if s.rig.holes == 0),
            because: "subject.rig.holes = 0",
            silent: &["subject.rig.hole_radius_m"],
        },
        Rule {
            holds: matches!(config.subject, SubjectConfig::Synthetic(_)),
            because: "subject.type = \"synthetic\", whose truth is known",
            silent: &["evaluate.ground_truth"],
        },
        Rule {
            holds: !matches!(config.subject, SubjectConfig::Synthetic(_)),
            because: "only a synthetic subject's fabric is known",
            silent: &["evaluate.solver_floor"],
        },
    ];
    for rule in rules.iter().filter(|rule| rule.holds) {
        for key in rule.silent {
            let Some(chosen) = find(table, key) else { continue };
            if default_of(key).is_none_or(|default| differs(chosen, &default)) {
                return Err(Error::config(
                    *key,
                    format!("has no effect, because {}", rule.because),
                    "remove it, or change the setting that switches it off",
                ));
            }
        }
    }
    Ok(())
}

/// Whether a garment's templates are files rather than samples of a space.
fn is_collection(garment: Option<&GarmentConfig>) -> bool {
    let source = garment.and_then(|g| g.template.table().get("type")).and_then(|t| t.as_str());
    matches!(source, Some("mesh" | "folder"))
}

fn find<'t>(table: &'t toml::Table, path: &str) -> Option<&'t toml::Value> {
    let (first, rest) = path.split_once('.').map_or((path, None), |(first, rest)| (first, Some(rest)));
    let value = table.get(first)?;
    match rest {
        None => Some(value),
        Some(rest) => find(value.as_table()?, rest),
    }
}

/// The default behind a dotted path; `None` for keys without one.
fn default_of(path: &str) -> Option<toml::Value> {
    fn table(value: impl Serialize) -> Option<toml::Table> {
        toml::Table::try_from(value).ok()
    }
    let (section, rest) = path.split_once('.').map_or((path, None), |(section, rest)| (section, Some(rest)));
    let section = match section {
        "train" => table(TrainConfig::default()),
        "optimise" => table(OptimiseConfig::default()),
        "finetune" => table(FinetuneConfig::default()),
        "evaluate" => table(EvaluateConfig::default()),
        "views" => table(ViewsConfig::default()),
        "subject" => Some(toml::Table::from_iter([("rig".to_string(), table(RigConfig::default())?.into())])),
        "registration" => table(RegistrationSettings::default()),
        "templates" => table(TemplatesConfig::default()),
        "upper" | "lower" => {
            Some(toml::Table::from_iter([("styles".to_string(), toml::Value::Integer(thirty() as i64))]))
        }
        _ => None,
    }?;
    match rest {
        None => Some(toml::Value::Table(section)),
        Some(rest) => find(&section, rest).cloned(),
    }
}

/// Whether a chosen value changes anything of a default; tables may leave keys out, integers may stand for floats.
fn differs(chosen: &toml::Value, default: &toml::Value) -> bool {
    let number = |v: &toml::Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
    match (chosen, default) {
        (toml::Value::Table(chosen), toml::Value::Table(default)) => {
            chosen.iter().any(|(key, value)| default.get(key).is_none_or(|d| differs(value, d)))
        }
        _ => match (number(chosen), number(default)) {
            (Some(a), Some(b)) => a != b,
            _ => chosen != default,
        },
    }
}
