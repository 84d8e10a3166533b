//! Values from outside of the file: `--set train.rounds=3`, variants of an ablation.

use caphy_core::{Error, Result};

/// A value that takes the place of one of a configuration.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// Keys from the outermost on; numbers count elements of lists from 0.
    steps: Vec<String>,
    /// None takes the key out, so that its default holds.
    value: Option<toml::Value>,
}

impl Setting {
    /// From `key=value`: a dotted TOML path, and a TOML value or a bare word for a text; nothing takes the key out of the file.
    ///
    /// # Errors
    /// [`Error::Config`] naming the text.
    pub fn parse(text: &str) -> Result<Self> {
        let wrong = |problem: String| {
            Error::config(format!("--set {text}"), problem, "write it as `train.rounds=3` or `net={ type = \"mlp\" }`")
        };
        let (key, value) = text.split_once('=').ok_or_else(|| wrong("has no `=`".into()))?;
        let (key, value) = (key.trim(), value.trim());
        let named = |error: Error| match error {
            Error::Config { problem, .. } => wrong(problem),
            other => other,
        };
        if value.is_empty() {
            return Self::of(key, None).map_err(named);
        }
        let parsed: std::result::Result<toml::Table, _> = format!("value = {value}").parse();
        let value = match parsed {
            Ok(table) if table.len() == 1 => table["value"].clone(),
            // A bare word: quotes are easily lost in a shell.
            _ if value.chars().all(|c| c.is_alphanumeric() || "_-./$".contains(c)) => value.into(),
            Ok(_) => return Err(wrong("holds more than one value".into())),
            Err(error) => return Err(wrong(format!("`{value}` is no TOML value: {}", error.message().trim()))),
        };
        Self::new(key, value).map_err(named)
    }

    /// From a dotted TOML path and a value.
    ///
    /// # Errors
    /// [`Error::Config`] for what is no path.
    pub fn new(key: &str, value: toml::Value) -> Result<Self> {
        Self::of(key, Some(value))
    }

    fn of(key: &str, value: Option<toml::Value>) -> Result<Self> {
        let wrong = || Error::config(key, "is no dotted TOML path", "write it like `train.rounds`");
        let nested: toml::Table = format!("{key} = 0").parse().map_err(|_| wrong())?;
        let mut steps = Vec::new();
        let mut inner = toml::Value::Table(nested);
        while let toml::Value::Table(table) = inner {
            let mut entries = table.into_iter();
            let (Some((step, next)), None) = (entries.next(), entries.next()) else { return Err(wrong()) };
            steps.push(step);
            inner = next;
        }
        Ok(Self { steps, value })
    }

    /// The dotted path.
    pub fn key(&self) -> String {
        self.steps.join(".")
    }

    /// The value; none takes the key out.
    pub fn value(&self) -> Option<&toml::Value> {
        self.value.as_ref()
    }

    /// Puts the value into a table; tables on the way that are not there are made.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key where something else than a table or a list stands on the way.
    pub fn apply(&self, table: &mut toml::Table) -> Result<()> {
        let wrong = |at: usize, problem: String, remedy: &str| {
            Error::config(format!("--set {self}"), format!("`{}` {problem}", self.steps[..at].join(".")), remedy)
        };
        let (last, before) = self.steps.split_last().ok_or_else(|| wrong(0, "is empty".into(), "name a key"))?;
        let no_element = |at: usize, list: &[toml::Value]| {
            wrong(at, format!("is a list of {}", list.len()), "name an element by its number, from 0 on")
        };
        let mut root = toml::Value::Table(std::mem::take(table));
        let mut here = &mut root;
        let walk = || -> Result<()> {
            for (i, step) in before.iter().enumerate() {
                here = match here {
                    toml::Value::Table(table) => {
                        table.entry(step.clone()).or_insert_with(|| toml::Value::Table(toml::Table::new()))
                    }
                    toml::Value::Array(list) => match step.parse::<usize>() {
                        Ok(index) if index < list.len() => &mut list[index],
                        _ => return Err(no_element(i, list)),
                    },
                    other => {
                        let problem = format!("is a value of type {}, which has no `{step}`", other.type_str());
                        return Err(wrong(i, problem, "name a key of a table"));
                    }
                };
            }
            match (here, &self.value) {
                (toml::Value::Table(table), Some(value)) => drop(table.insert(last.clone(), value.clone())),
                (toml::Value::Table(table), None) => drop(table.remove(last)),
                (toml::Value::Array(list), value) => match (last.parse::<usize>(), value) {
                    (Ok(index), Some(value)) if index < list.len() => list[index] = value.clone(),
                    (Ok(index), None) if index < list.len() => drop(list.remove(index)),
                    _ => return Err(no_element(before.len(), list)),
                },
                (other, _) => {
                    let problem = format!("is a value of type {}, which has no `{last}`", other.type_str());
                    return Err(wrong(before.len(), problem, "name a key of a table"));
                }
            }
            Ok(())
        };
        let walked = walk();
        if let toml::Value::Table(changed) = root {
            *table = changed;
        }
        walked
    }
}

impl std::fmt::Display for Setting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}=", self.key())?;
        self.value.as_ref().map_or(Ok(()), |value| write!(f, "{value}"))
    }
}

/// A table with all settings applied, in their order.
///
/// # Errors
/// As [`Setting::apply`].
pub(super) fn applied<'s>(table: &toml::Table, settings: impl IntoIterator<Item = &'s Setting>) -> Result<toml::Table> {
    let mut table = table.clone();
    settings.into_iter().try_for_each(|setting| setting.apply(&mut table))?;
    Ok(table)
}

/// What is wrong with a configuration, said of the setting that made it so; `read` answers what is wrong with others of the settings.
pub(super) fn blame(
    error: Error,
    settings: &[Setting],
    read: impl Fn(&mut dyn Iterator<Item = &Setting>) -> Result<()>,
) -> Error {
    let said = error.to_string();
    let same = |outcome: Result<()>| outcome.err().is_some_and(|e| e.to_string() == said);
    let culprit = (0..settings.len()).find(|&i| {
        let others = settings.iter().enumerate().filter(|(k, _)| *k != i).map(|(_, s)| s);
        !same(read(&mut { others }))
    });
    let Some(culprit) = culprit else { return error };
    let key = format!("--set {}", settings[culprit]);
    match error {
        // Lines and columns are those of the file, where it is not.
        Error::Format { problem, .. } => Error::config(key, problem, "correct or remove it"),
        Error::Config { key: named, problem, remedy } => Error::config(key, format!("`{named}`: {problem}"), remedy),
        other => Error::config(key, other.to_string(), "correct or remove it"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(text: &str, settings: &[&str]) -> Result<toml::Table> {
        let settings = settings.iter().map(|s| Setting::parse(s)).collect::<Result<Vec<_>>>()?;
        applied(&text.parse().unwrap(), &settings)
    }

    #[test]
    fn values_of_every_kind_find_their_place() {
        let text = "[train]\nrounds = 1\n[[clips]]\ns = 1\n[[clips]]\ns = 2\n";
        let expected: toml::Table = "clips = [{ s = 1 }, { s = 2.5 }]\nnet = { type = \"mlp\" }\n[train]\nrounds = 3\n\
                                     weights = { scan = 0 }\n"
            .parse()
            .unwrap();
        let got = set(text, &["train.rounds=3", "train.weights.scan = 0", "clips.1.s=2.5", "net={ type = \"mlp\" }"])
            .unwrap();
        assert_eq!(got, expected);
        // Quotes are lost in shells; a later setting wins; keys with dots are quoted.
        assert_eq!(set("", &["net.type=gru", "net.type=mlp"]).unwrap(), "net = { type = \"mlp\" }".parse().unwrap());
        assert_eq!(set("", &["a.\"b.c\"=1"]).unwrap(), "a = { \"b.c\" = 1 }".parse().unwrap());
        assert_eq!(set("", &["a=-1.5e-3"]).unwrap()["a"].as_float(), Some(-1.5e-3));
        // Nothing takes a key out, whether it is there or not.
        let less = set(text, &["clips.0=", "train.rounds=", "train.batch="]).unwrap();
        assert_eq!(less, "clips = [{ s = 2 }]\ntrain = {}\n".parse().unwrap());
        assert_eq!(Setting::parse("train.rounds=").unwrap().to_string(), "train.rounds=");
    }

    #[test]
    fn what_cannot_be_set_is_named() {
        for (settings, words) in [
            (["train.rounds"], ["--set train.rounds", "no `=`"]),
            (["a..b=1"], ["a..b", "dotted TOML path"]),
            (["a=[1,"], ["--set a=[1,", "no TOML value"]),
            (["x.y.z=1"], ["`x.y`", "has no `z`"]),
            (["list.7=1"], ["`list`", "a list of 2"]),
            (["a=1\nb=2"], ["--set a=1", "more than one"]),
        ] {
            let said = set("list = [1, 2]\n[x]\ny = 1\n", &settings).unwrap_err().to_string();
            assert!(words.iter().all(|w| said.contains(w)), "{settings:?}: {said}");
        }
    }
}
