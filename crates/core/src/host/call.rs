//! One call across the border: status and text to a typed error.

use crate::plugin::abi::{CONFIG, LENGTH, NON_FINITE, OK, PANICKED, PARAMETER, Sink, UNSUPPORTED};
use crate::{Error, PluginProblem, Result};
use std::path::Path;

/// Who is called, for errors.
#[derive(Debug, Clone)]
pub(super) struct Callee {
    pub(super) library: std::path::PathBuf,
    pub(super) type_name: String,
}

impl Callee {
    pub(super) fn new(library: &Path, type_name: &str) -> Self {
        Self { library: library.into(), type_name: type_name.into() }
    }

    /// Makes a call; its status and text become the error that the same plugin would give when linked.
    pub(super) fn call(&self, call: &str, run: impl FnOnce(Sink) -> i32) -> Result<()> {
        let mut text = Vec::new();
        let status = run(Sink::to(&mut text));
        if status == OK {
            return Ok(());
        }
        let message = String::from_utf8_lossy(&text).into_owned();
        let (type_name, call) = (self.type_name.clone(), call.to_string());
        Err(match status {
            UNSUPPORTED => Error::unsupported(message, type_name),
            CONFIG => {
                let mut lines = message.lines();
                let key = lines.next().unwrap_or_default().to_string();
                let problem = lines.next().unwrap_or("cannot be used").to_string();
                Error::config(key, problem, lines.next().unwrap_or("correct it"))
            }
            LENGTH | NON_FINITE | PARAMETER => match numeric(status, &message) {
                Some(error) => error,
                None => self.malformed(&call, format!("status {status} with the text `{message}`")),
            },
            PANICKED => self.problem(PluginProblem::Panic { type_name, call, message }),
            _ if message.is_empty() => self.problem(PluginProblem::Failed {
                type_name,
                call,
                message: format!("status {status}, without a word"),
            }),
            _ => self.problem(PluginProblem::Failed { type_name, call, message }),
        })
    }

    /// A call that returns text through a sink.
    pub(super) fn text(&self, call: &str, run: impl FnOnce(Sink, Sink) -> i32) -> Result<String> {
        let mut out = Vec::new();
        let sink = Sink::to(&mut out);
        self.call(call, |error| run(sink, error))?;
        String::from_utf8(out).map_err(|_| self.malformed(call, "text that is not UTF-8"))
    }

    /// The error of an answer that contradicts the interface.
    pub(super) fn malformed(&self, call: &str, what: impl Into<String>) -> Error {
        let problem =
            PluginProblem::Malformed { type_name: self.type_name.clone(), call: call.into(), what: what.into() };
        self.problem(problem)
    }

    /// A function that must be there.
    pub(super) fn function<F>(&self, name: &str, function: Option<F>) -> Result<F> {
        function.ok_or_else(|| self.malformed(name, "its function is null"))
    }

    /// A yes or no.
    pub(super) fn flag(&self, name: &str, value: u8) -> Result<bool> {
        match value {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(self.malformed("describe", format!("{name} is {other}, not 0 or 1"))),
        }
    }

    fn problem(&self, problem: PluginProblem) -> Error {
        Error::plugin(&self.library, problem)
    }
}

/// The error of a status whose text holds numbers; `None` when the text is not as the interface says.
fn numeric(status: i32, text: &str) -> Option<Error> {
    let lines: Vec<&str> = text.split('\n').collect();
    let (&first, rest) = lines.split_first()?;
    let number = |line: &str| line.parse::<f64>().ok();
    match (status, rest) {
        (LENGTH, [expected, got]) => {
            Some(Error::Length { what: first.into(), expected: expected.parse().ok()?, got: got.parse().ok()? })
        }
        (NON_FINITE, [index, value]) => {
            Some(Error::NonFinite { what: first.into(), index: index.parse().ok()?, value: number(value)? })
        }
        (PARAMETER, [value, lower, upper, unit]) => Some(Error::Parameter {
            name: first.into(),
            value: number(value)?,
            lower: number(lower)?,
            upper: number(upper)?,
            unit: (*unit).into(),
        }),
        _ => None,
    }
}
