//! Where in a TOML file a mistake stands.
//!
//! Tables that choose their type by a key are buffered by serde and typetag, which forget line and column. The mistake is
//! found again by trying: the key without which the parser's complaint changes is the one it complained about, and a
//! missing key belongs where adding it changes the complaint.

use caphy_core::Error;
use std::ops::Range;
use std::path::Path;
use toml::de::{DeTable, DeValue};

/// What the parser says of a table; `None` when nothing.
pub(crate) type Complaint<'a> = &'a dyn Fn(&toml::Table) -> Option<String>;

/// A step into a document.
#[derive(Debug, Clone, PartialEq)]
enum Step {
    Key(String),
    Index(usize),
}

/// An [`Error::Format`] with line and column of the key that `complaint` is about; `message` is what it says of `table`,
/// which stands in `text` under the dotted path `at_key` (empty for the whole file).
pub(crate) fn error(
    path: &Path,
    text: &str,
    at_key: &str,
    table: &toml::Table,
    message: &str,
    complaint: Complaint<'_>,
) -> Error {
    let missing = message.strip_prefix("missing field `").and_then(|rest| rest.split('`').next());
    let mut steps = Vec::new();
    match missing {
        Some(key) => steps = lacking(table, key, message, complaint).unwrap_or_default(),
        None => narrow(table, message, complaint, &mut steps),
    }
    let prefix = at_key.split('.').filter(|key| !key.is_empty()).map(|key| Step::Key(key.into()));
    let steps: Vec<Step> = prefix.chain(steps).collect();
    let span = DeTable::parse(text).ok().and_then(|document| span(document.get_ref(), &steps)).unwrap_or(0..0);
    let remedy = if missing.is_some() {
        "add it"
    } else if message.starts_with("unknown field") {
        "correct or remove it"
    } else {
        "correct the line"
    };
    at(path, text, span.start, message, remedy)
}

/// An [`Error::Format`] at a byte of a text.
pub(crate) fn at(path: &Path, text: &str, byte: usize, message: &str, remedy: &str) -> Error {
    let before = text.get(..byte).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().map_or(0, |l| l.chars().count()) + 1;
    Error::format(path, format!("line {line}, column {column}"), message, remedy)
}

/// The value at the end of some steps.
fn follow<'v>(root: &'v mut toml::Table, steps: &[Step]) -> Option<&'v mut toml::Value> {
    let (Step::Key(first), rest) = steps.split_first()? else { return None };
    rest.iter().try_fold(root.get_mut(first)?, |value, step| match step {
        Step::Key(key) => value.as_table_mut()?.get_mut(key),
        Step::Index(index) => value.as_array_mut()?.get_mut(*index),
    })
}

/// Children of the table or array at the end of some steps. `type` comes last: without it a table means nothing, which
/// changes every complaint about the rest.
fn children(root: &toml::Table, steps: &[Step]) -> Vec<Step> {
    let keys = |table: &toml::Table| {
        let (tag, rest): (Vec<String>, Vec<String>) = table.keys().cloned().partition(|key| key == "type");
        rest.into_iter().chain(tag).map(Step::Key).collect()
    };
    let mut root = root.clone();
    if steps.is_empty() {
        return keys(&root);
    }
    match follow(&mut root, steps) {
        Some(toml::Value::Table(table)) => keys(table),
        Some(toml::Value::Array(array)) => (0..array.len()).map(Step::Index).collect(),
        _ => Vec::new(),
    }
}

/// The document without one of its values.
fn without(root: &toml::Table, steps: &[Step]) -> toml::Table {
    let mut root = root.clone();
    if let Some((last, before)) = steps.split_last() {
        match (last, before.is_empty()) {
            (Step::Key(key), true) => drop(root.remove(key)),
            _ => match (last, follow(&mut root, before)) {
                (Step::Key(key), Some(toml::Value::Table(table))) => drop(table.remove(key)),
                (Step::Index(index), Some(toml::Value::Array(array))) if *index < array.len() => {
                    array.remove(*index);
                }
                _ => {}
            },
        }
    }
    root
}

/// Goes down to the innermost value without which the complaint changes.
fn narrow(root: &toml::Table, message: &str, complaint: Complaint<'_>, steps: &mut Vec<Step>) {
    for child in children(root, steps) {
        steps.push(child);
        if complaint(&without(root, steps)).as_deref() != Some(message) {
            return narrow(root, message, complaint, steps);
        }
        steps.pop();
    }
}

/// The innermost table that lacks a key: with it, whatever its value, the complaint is another one.
fn lacking(root: &toml::Table, key: &str, message: &str, complaint: Complaint<'_>) -> Option<Vec<Step>> {
    let mut open = vec![Vec::new()];
    let mut found = None;
    while let Some(steps) = open.pop() {
        open.extend(children(root, &steps).into_iter().map(|child| [&steps[..], &[child]].concat()));
        let mut with = root.clone();
        let table =
            if steps.is_empty() { Some(&mut with) } else { follow(&mut with, &steps).and_then(|v| v.as_table_mut()) };
        if let Some(table) = table
            && !table.contains_key(key)
        {
            table.insert(key.to_string(), toml::Value::Boolean(true));
            let unknown = format!("unknown field `{key}`");
            if complaint(&with).is_some_and(|m| m != message && !m.starts_with(&unknown)) {
                found = Some(steps);
            }
        }
    }
    found
}

/// Bytes of the key (or array element) at the end of some steps.
fn span(root: &DeTable<'_>, steps: &[Step]) -> Option<Range<usize>> {
    let (first, rest) = steps.split_first()?;
    let Step::Key(first) = first else { return None };
    let (key, mut value) = root.iter().find(|(k, _)| k.get_ref() == first)?;
    let mut span = key.span();
    for step in rest {
        match (step, value.get_ref()) {
            (Step::Key(name), DeValue::Table(table)) => {
                let (key, next) = table.iter().find(|(k, _)| k.get_ref() == name)?;
                span = key.span();
                value = next;
            }
            (Step::Index(index), DeValue::Array(array)) => {
                value = array.get(*index)?;
                span = value.span();
            }
            _ => return None,
        }
    }
    Some(span)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Outer {
        #[serde(rename = "list")]
        _list: Vec<Inner>,
        #[serde(rename = "one")]
        _one: Inner,
    }
    /// Buffered because of its tag, so that serde forgets places.
    #[derive(Deserialize)]
    #[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
    enum Inner {
        A {
            #[serde(rename = "x")]
            _x: f64,
        },
    }

    fn place(text: &str) -> String {
        let complaint = |t: &toml::Table| t.clone().try_into::<Outer>().err().map(|e| e.message().to_string());
        let table: toml::Table = toml::from_str(text).unwrap();
        let message = complaint(&table).expect("a mistake");
        match error(Path::new("f.toml"), text, "", &table, &message, &complaint) {
            Error::Format { at, .. } => at,
            other => panic!("{other}"),
        }
    }

    #[test]
    fn mistakes_in_buffered_tables_are_found() {
        let good = "list = [{ type = \"a\", x = 1.0 }]\n[one]\ntype = \"a\"\nx = 2.0\n";
        assert_eq!(place(&good.replace("x = 1.0", "y = 3, x = 1.0")), "line 1, column 23");
        assert_eq!(place(&good.replace("x = 2.0", "x = \"two\"")), "line 4, column 1");
        assert_eq!(place(&good.replace("x = 2.0", "y = 2.0")), "line 4, column 1");
        assert_eq!(place(&good.replace("x = 1.0", "x = [1]")), "line 1, column 23");
        assert_eq!(place(&good.replace("type = \"a\", x", "x")), "line 1, column 9");
        assert_eq!(place(&good.replace("\nx = 2.0", "")), "line 2, column 2");
        assert_eq!(place(&good.replace("[one]\ntype = \"a\"", "[one]\ntype = \"b\"")), "line 3, column 1");
    }
}
