//! What a training leaves behind for people: a line of JSON per step, and the same for TensorBoard.
//!
//! Both files grow while training runs. A checkpoint holds how long they were; going on from it, or back to it, cuts them
//! there, so that a killed run leaves the same lines as an uninterrupted one. Times are in the event file alone.

use super::measures::{Measures, Spread};
use crate::trainer::{Batch, BatchKind};
use caphy_core::{Error, Result};
use caphy_formats::tensorboard::{Value, first_record, step_record};
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// How long the files are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Position {
    lines: u64,
    events: u64,
}

/// The files of one garment in one stage.
pub struct Record {
    lines: Growing,
    events: Growing,
}

/// One line.
#[derive(Debug, Clone, Serialize)]
pub struct Line<'a> {
    /// Steps done before this one.
    pub step: usize,
    /// `windows` or `scans`.
    pub kind: &'static str,
    /// Round that the step belongs to.
    pub round: usize,
    /// Adam's.
    pub learning_rate: f64,
    /// Mean energies [J per frame]; `scan` holds its weight.
    #[serde(serialize_with = "as_map")]
    pub energies: &'a [(&'static str, f64)],
    /// Norm of the gradient by the net's parameters, before it was shortened.
    pub gradient_norm: f64,
    /// Weights that are on a schedule.
    #[serde(serialize_with = "as_map", skip_serializing_if = "<[_]>::is_empty")]
    pub weights: &'a [(&'static str, f64)],
    /// Every so many steps.
    #[serde(flatten)]
    pub measures: Option<Measures>,
}

/// The kind of a batch in lines and names.
pub fn kind(batch: &Batch) -> &'static str {
    match batch.kind {
        BatchKind::Windows => "windows",
        BatchKind::Still => "poses",
        BatchKind::Scans => "scans",
    }
}

fn as_map<S: Serializer>(values: &&[(&'static str, f64)], serializer: S) -> std::result::Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(values.len()))?;
    for (name, value) in *values {
        map.serialize_entry(name, value)?;
    }
    map.end()
}

impl Record {
    /// Files `metrics-NAME.jsonl` and `tensorboard/NAME/events.out.tfevents.0.caphy` of a run folder, cut at `at`. The second
    /// value says so when they are shorter than that.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn open(folder: &Path, name: &str, at: Position) -> Result<(Record, Option<String>)> {
        let mut lines = Growing::open(folder.join(format!("metrics-{name}.jsonl")))?;
        // TensorBoard knows its files by a part of their names.
        let mut events = Growing::open(folder.join("tensorboard").join(name).join("events.out.tfevents.0.caphy"))?;
        let mut lost = Vec::new();
        if lines.length < at.lines {
            lost.push(lines.path.display().to_string());
            lines.end_at_line()?;
        }
        if events.length < at.events {
            // Records cannot be found without reading them all: what is left of them is given up.
            lost.push(events.path.display().to_string());
            events.cut(0)?;
        }
        let mut record = Record { lines, events };
        record.cut(at)?;
        if record.events.length == 0 {
            record.events.add(&first_record(now()))?;
        }
        let warning = (!lost.is_empty()).then(|| format!("{} lost what was recorded before", lost.join(" and ")));
        Ok((record, warning))
    }
    /// How long the files are.
    pub fn position(&self) -> Position {
        Position { lines: self.lines.length, events: self.events.length }
    }
    /// Goes back to an earlier position.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn cut(&mut self, at: Position) -> Result<()> {
        self.lines.cut(at.lines)?;
        self.events.cut(at.events)
    }
    /// Adds a step.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn step(&mut self, line: &Line<'_>) -> Result<()> {
        self.lines.add_json(line)?;
        let mut values: Vec<(String, f64)> = Vec::new();
        values.extend(line.energies.iter().map(|(name, value)| (format!("{}/{name}", line.kind), *value)));
        values.push((format!("{}/gradient norm", line.kind), line.gradient_norm));
        values.push(("schedule/learning rate".into(), line.learning_rate));
        values.extend(line.weights.iter().map(|(name, value)| (format!("schedule/{name}"), *value)));
        if let Some(Measures { major_stretch, minor_stretch, body }) = &line.measures {
            for (name, Spread { least, p1, p50, p99, most }) in [("major", major_stretch), ("minor", minor_stretch)] {
                let parts = [("least", least), ("1 %", p1), ("50 %", p50), ("99 %", p99), ("most", most)];
                let tag = |part: &str| format!("{} {name} stretch/{part}", line.kind);
                values.extend(parts.map(|(part, value)| (tag(part), f64::from(*value))));
            }
            let parts = [("inside", body.inside), ("deepest mm", body.deepest_mm), ("mean mm", body.mean_mm)];
            values.extend(parts.map(|(part, value)| (format!("{} in body/{part}", line.kind), value)));
        }
        let values: Vec<(&str, Value<'_>)> =
            values.iter().map(|(tag, value)| (tag.as_str(), Value::Scalar(*value as f32))).collect();
        self.events.add(&step_record(now(), line.step as u64, &values))
    }
    /// Adds that training went back from a step to an earlier one, and why.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn rollback(&mut self, step: usize, from: usize, because: &str) -> Result<()> {
        #[derive(Serialize)]
        struct Rollback<'a> {
            step: usize,
            kind: &'static str,
            from: usize,
            because: &'a str,
        }
        self.lines.add_json(&Rollback { step, kind: "rollback", from, because })
    }
    /// Adds a picture (PNG bytes) that was drawn after so many steps.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn picture(&mut self, steps: usize, [width, height]: [usize; 2], png: &[u8]) -> Result<()> {
        let picture = Value::Picture { width, height, png };
        self.events.add(&step_record(now(), steps as u64, &[("preview", picture)]))
    }
    /// Makes sure that what was added outlasts a loss of power: before a checkpoint that counts on it.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn sync(&self) -> Result<()> {
        for growing in [&self.lines, &self.events] {
            growing.file.sync_data().map_err(|e| Error::io(&growing.path, "write", e))?;
        }
        Ok(())
    }
}

/// Seconds since 1970, for people's eyes only.
fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64())
}

/// A file that grows at its end and can be cut.
struct Growing {
    path: PathBuf,
    file: File,
    length: u64,
}

impl Growing {
    fn open(path: PathBuf) -> Result<Growing> {
        let folder = path.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create", e))?;
        let opened = File::options().read(true).write(true).create(true).truncate(false).open(&path);
        let open = |file: File| Ok((file.metadata()?.len(), file));
        let (length, file) = opened.and_then(open).map_err(|e| Error::io(&path, "open", e))?;
        Ok(Growing { path, file, length })
    }
    /// Whole or not at all, as far as a killed process goes: it is one write.
    fn add(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(|e| Error::io(&self.path, "write", e))?;
        self.length += bytes.len() as u64;
        Ok(())
    }
    fn add_json(&mut self, value: &impl Serialize) -> Result<()> {
        let mut bytes = serde_json::to_vec(value)
            .map_err(|e| Error::numerics("training metrics", e.to_string(), "report this as a defect"))?;
        bytes.push(b'\n');
        self.add(&bytes)
    }
    fn cut(&mut self, length: u64) -> Result<()> {
        let length = length.min(self.length);
        let cut = self.file.set_len(length).and_then(|()| self.file.seek(SeekFrom::Start(length)));
        self.length = cut.map_err(|e| Error::io(&self.path, "write", e))?;
        Ok(())
    }
    /// Cuts off a line that is not whole.
    fn end_at_line(&mut self) -> Result<()> {
        let mut bytes = Vec::new();
        let read = self.file.seek(SeekFrom::Start(0)).and_then(|_| self.file.read_to_end(&mut bytes));
        read.map_err(|e| Error::io(&self.path, "read", e))?;
        let whole = bytes.iter().rposition(|&b| b == b'\n').map_or(0, |at| at + 1);
        self.cut(whole as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::measures::Depth;

    fn line(step: usize) -> Line<'static> {
        Line {
            step,
            kind: "windows",
            round: 0,
            learning_rate: 5e-4,
            energies: &[("strain", 0.25), ("gravity", -3.0)],
            gradient_norm: 0.125,
            weights: &[],
            measures: None,
        }
    }

    fn read(folder: &Path) -> String {
        std::fs::read_to_string(folder.join("metrics-train-upper.jsonl")).unwrap()
    }

    #[test]
    fn a_line_holds_what_the_step_did() {
        let folder = tempfile::tempdir().unwrap();
        let (mut record, warning) = Record::open(folder.path(), "train-upper", Position::default()).unwrap();
        assert_eq!(warning, None);
        record.step(&line(7)).unwrap();
        let plain = "{\"step\":7,\"kind\":\"windows\",\"round\":0,\"learning_rate\":0.0005,\
                     \"energies\":{\"strain\":0.25,\"gravity\":-3.0},\"gradient_norm\":0.125}\n";
        assert_eq!(read(folder.path()), plain);
        let spread = Spread { least: 0.5, p1: 0.75, p50: 1.0, p99: 1.25, most: 1.5 };
        let body = Depth { inside: 0.01, deepest_mm: 2.0, mean_mm: 0.5 };
        let measures = Some(Measures { major_stretch: spread, minor_stretch: spread, body });
        record.step(&Line { weights: &[("strain", 0.1)], measures, ..line(8) }).unwrap();
        let text = read(folder.path());
        let value: serde_json::Value = serde_json::from_str(text.lines().nth(1).unwrap()).unwrap();
        assert_eq!((&value["weights"]["strain"], &value["major_stretch"]["p99"]), (&0.1.into(), &1.25.into()));
        assert_eq!(value["body"]["deepest_mm"], 2.0);
    }

    #[test]
    fn files_are_cut_where_a_checkpoint_stood() {
        let folder = tempfile::tempdir().unwrap();
        let (mut record, _) = Record::open(folder.path(), "train-upper", Position::default()).unwrap();
        (0..3).for_each(|step| record.step(&line(step)).unwrap());
        let at = record.position();
        (3..6).for_each(|step| record.step(&line(step)).unwrap());
        let whole = read(folder.path());
        // Killed while it wrote.
        record.lines.add(b"{\"step\":6,\"ki").unwrap();
        drop(record);
        let (mut record, warning) = Record::open(folder.path(), "train-upper", at).unwrap();
        assert_eq!((warning, record.position()), (None, at));
        (3..6).for_each(|step| record.step(&line(step)).unwrap());
        assert_eq!(read(folder.path()), whole);
        // Back without a new process.
        record.cut(at).unwrap();
        record.rollback(3, 6, "a reason").unwrap();
        assert_eq!(
            read(folder.path()).lines().last().unwrap(),
            "{\"step\":3,\"kind\":\"rollback\",\"from\":6,\"because\":\"a reason\"}"
        );
        assert_eq!(read(folder.path()).lines().count(), 4);
    }

    #[test]
    fn lost_files_are_said_and_gone_on_with() {
        let folder = tempfile::tempdir().unwrap();
        let (mut record, _) = Record::open(folder.path(), "train-upper", Position::default()).unwrap();
        (0..3).for_each(|step| record.step(&line(step)).unwrap());
        let at = record.position();
        drop(record);
        std::fs::remove_dir_all(folder.path().join("tensorboard")).unwrap();
        let path = folder.path().join("metrics-train-upper.jsonl");
        std::fs::write(&path, &std::fs::read(&path).unwrap()[..200]).unwrap();
        let (mut record, warning) = Record::open(folder.path(), "train-upper", at).unwrap();
        let warning = warning.unwrap();
        assert!(warning.contains("metrics-train-upper.jsonl") && warning.contains("tfevents"), "{warning}");
        record.step(&line(3)).unwrap();
        let steps: Vec<String> = read(folder.path()).lines().map(|l| l[..9].to_string()).collect();
        assert_eq!(steps, ["{\"step\":0", "{\"step\":3"]);
    }
}
