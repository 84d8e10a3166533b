//! Lines and numbers of text formats, with their place for messages.

use caphy_core::{Error, Result, Vec3};
use std::borrow::Cow;
use std::path::Path;

/// Most joints of a skeleton: people have about 60 with fingers, rigs with helpers 200.
pub(super) const MOST_JOINTS: usize = 1024;
/// Most frames of a clip, 4.6 hours at 120 frames per second: a pose takes 1.3 kB whatever its file spends on it.
pub(super) const MOST_FRAMES: usize = 2_000_000;

/// A text file.
pub(super) struct Lines<'a> {
    path: &'a Path,
    text: Cow<'a, str>,
    comment: Option<char>,
}

impl<'a> Lines<'a> {
    /// What follows `comment` on a line is left out.
    pub(super) fn new(path: &'a Path, bytes: &'a [u8], comment: Option<char>) -> Self {
        Self { path, text: String::from_utf8_lossy(bytes), comment }
    }
    /// Where the text comes from.
    pub(super) fn path(&self) -> &'a Path {
        self.path
    }
    /// Line number and words of every line that has any.
    pub(super) fn iter(&self) -> impl Iterator<Item = (usize, Vec<&str>)> {
        self.text.lines().enumerate().filter_map(|(i, line)| {
            let line = self.comment.map_or(line, |c| line.split(c).next().unwrap_or_default());
            let words: Vec<&str> = line.split_whitespace().collect();
            (!words.is_empty()).then_some((i + 1, words))
        })
    }
    /// Size of the text [bytes].
    pub(super) fn len(&self) -> usize {
        self.text.len()
    }
    /// Damage at a place in the file.
    pub(super) fn bad_at(&self, at: String, problem: impl Into<String>) -> Error {
        Error::format(self.path, at, problem, "the file is damaged or cut off: get it again")
    }
    /// Damage in a line.
    pub(super) fn bad(&self, line: usize, problem: impl Into<String>) -> Error {
        self.bad_at(format!("line {line}"), problem)
    }
    /// A finite number.
    pub(super) fn number(&self, line: usize, word: &str) -> Result<f64> {
        match word.parse::<f64>() {
            Ok(x) if x.is_finite() => Ok(x),
            _ => Err(self.bad(line, format!("`{word:.40}` is no finite number"))),
        }
    }
    /// The three numbers behind a keyword.
    pub(super) fn three(&self, line: usize, words: &[&str]) -> Result<Vec3> {
        let &[_, x, y, z, ..] = words else {
            return Err(self.bad(line, format!("`{:.60}` needs three numbers", words.join(" "))));
        };
        Ok(Vec3::new(self.number(line, x)?, self.number(line, y)?, self.number(line, z)?))
    }
}
