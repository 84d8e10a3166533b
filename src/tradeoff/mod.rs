//! `caphy tradeoff`: what every knob of an experiment costs and buys, measured against the reference solver on motion that training
//! does not see.
//!
//! Knobs are turned one by one around the experiment's own point ([`knobs`]), then together ([`search`]). Every point is a run in a
//! folder of its own, trained from nothing, so that its time is that of a whole training; what is measured of it is an artifact, and
//! a sweep that was interrupted goes on at the first point without one.

mod cost;
mod docs;
mod error;
mod front;
mod knobs;
mod page;
mod point;
mod precision;
mod preprocessed;
mod search;
mod table;
mod yardstick;

pub use cost::Spent;
pub use error::Errors;
pub use front::{Bounds, Candidate, Front, Pick, Preset};
pub use knobs::{Acts, Base, KNOBS, Knob, Level};
pub use point::Measured;
pub use precision::Precision;
pub use preprocessed::Preprocessed;
pub use table::{PreprocessRow, Results, Row, SolverRow};

use crate::artifact;
use crate::config::{Config, Setting, SubjectConfig};
use crate::files::ProjectFiles;
use crate::plugins::Plugins;
use crate::progress::{Pace, Work, words};
use crate::runner::Run;
use crate::stage::Scans;
use crate::stage::preprocess::Subject;
use crate::variants::{anew, share};
use caphy_core::{Error, Result};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;
use yardstick::Yardstick;

/// A sweep that can be run.
pub struct Tradeoff {
    path: PathBuf,
    config: Config,
    files: ProjectFiles,
    folder: PathBuf,
    /// Settings of all points: few rounds, nothing that only looks at training.
    common: Vec<Setting>,
    own_rounds: usize,
    full: bool,
    chosen: Vec<&'static Knob>,
}

/// What came of it.
#[derive(Debug)]
pub struct Ended {
    /// The results.
    pub results: Results,
    /// Where they are.
    pub folder: PathBuf,
    /// Points that were computed now; the others were done.
    pub computed: usize,
}

/// Says how far the sweep is.
struct Teller<'a> {
    say: &'a (dyn Fn(&str) + Sync),
    pace: Mutex<Pace>,
    started: Mutex<Instant>,
    computed: Mutex<usize>,
}

/// Kinds of work, with sizes relative to each other until they are measured.
const YARDSTICK: usize = 0;
const POINT: usize = 1;
const SOLVER: usize = 2;
const PREPROCESS: usize = 3;

impl Teller<'_> {
    fn say(&self, what: &str) {
        let left = self.pace.lock().ok().and_then(|pace| pace.left());
        if let Ok(mut started) = self.started.lock() {
            *started = Instant::now();
        }
        (self.say)(&format!("{what} ({})", words(left)));
    }
    fn expect(&self, kind: usize, left: usize) {
        if let Ok(mut pace) = self.pace.lock() {
            pace.set_left(kind, left);
        }
    }
    /// Something of a kind ended: computed now, or known from before.
    fn done(&self, kind: usize, now: bool) {
        let (Ok(mut pace), Ok(mut started)) = (self.pace.lock(), self.started.lock()) else { return };
        if now {
            pace.step(kind, started.elapsed().as_secs_f64());
            if let Ok(mut computed) = self.computed.lock() {
                *computed += 1;
            }
        } else {
            pace.skip(kind);
        }
        *started = Instant::now();
    }
}

impl Tradeoff {
    /// Reads the experiment and checks every level of every knob before anything runs; `out` replaces the folder, by default
    /// the run's with `-tradeoff` behind it.
    ///
    /// # Errors
    /// As [`Config::read_set`]; [`Error::Config`] for knobs that there are not.
    pub fn open(path: &Path, out: Option<PathBuf>, full: bool, plugins: &Plugins) -> Result<Self> {
        // The experiment without what a budget would pick: that is what is measured here.
        let bare = Setting::parse("budget=")?;
        let written = Config::read_set(path, std::slice::from_ref(&bare), &mut anew(plugins)?)?;
        let own_rounds = written.train.rounds;
        let few = if full { own_rounds } else { written.tradeoff().rounds.min(own_rounds) };
        let mut common = vec![bare, Setting::new("train.rounds", (few as i64).into())?];
        for key in ["train.preview_every", "train.measure_every"] {
            common.push(Setting::new(key, 0.into())?);
        }
        // All points share templates: the knob of the fabric changes what is trained, not what was cut.
        if !matches!(written.subject, SubjectConfig::Dressed(_)) {
            for (_, key, garment) in written.garments() {
                common.push(Setting::new(&format!("{key}.worn_in"), garment.worn_in().table().clone().into())?);
            }
        }
        let files = ProjectFiles::new(path.parent().unwrap_or(Path::new(".")));
        let folder = match out {
            Some(out) => out,
            None => {
                let own = files.resolve(&written.run.out)?;
                let mut name = own.file_name().unwrap_or_default().to_os_string();
                name.push("-tradeoff");
                own.with_file_name(name)
            }
        };
        let chosen = knobs::chosen(&written.tradeoff().knobs)?;
        let config = Config::read_set(path, &common, &mut anew(plugins)?)?;
        let opened = Self { path: path.into(), config, files, folder, common, own_rounds, full, chosen };
        let base = Base { config: &opened.config, own_rounds, scans: None };
        for knob in &opened.chosen {
            for level in knob.levels(&base)? {
                let settings = [&opened.common[..], &level.set].concat();
                Config::read_set(path, &settings, &mut anew(plugins)?)?;
            }
        }
        Ok(opened)
    }

    /// Measures what is not measured yet and writes `tradeoff.json`, `tradeoff.txt` and `report.html` after every point, so that they
    /// can be looked at before all is done; `say` hears what begins.
    ///
    /// # Errors
    /// What runs and the solver give.
    pub fn run(&self, plugins: &Plugins, say: &(dyn Fn(&str) + Sync)) -> Result<Ended> {
        let machine = cost::machine();
        let sizes = [4.0, 1.0, 2.0, 1.0];
        let teller = Teller {
            say,
            pace: Mutex::new(Pace::new(sizes.map(|size| Work { size, left: 0 }).to_vec())),
            started: Mutex::new(Instant::now()),
            computed: Mutex::new(0),
        };
        let bench = point::Bench { sweep: self, plugins };
        let preprocessed = self.subject(&bench, &teller)?;
        let scans = self.scans()?;
        let base = Base { config: &self.config, own_rounds: self.own_rounds, scans };
        let settings = self.config.tradeoff();

        // How much there is to do.
        let mut levels = Vec::new();
        for &knob in &self.chosen {
            for level in knob.levels(&base)? {
                levels.push((knob, level));
            }
        }
        let (of_subject, of_nets): (Vec<_>, Vec<_>) = levels.iter().partition(|(knob, _)| knob.acts.preprocesses());
        let of_views = of_subject.iter().any(|(knob, _)| knob.acts == Acts::Views);
        // What is measured with the fewest scans needs the answer that they give.
        let few = if of_views { knobs::fewest_scans(&base)? } else { None };
        let few_is_a_level = of_subject.iter().any(|(knob, _)| knob.name == knobs::SCANS);
        let combinations = 2 * settings.combinations;
        teller.expect(POINT, settings.seeds + of_nets.len() + combinations);
        teller.expect(PREPROCESS, of_subject.len() + usize::from(few.is_some() && !few_is_a_level));
        teller.expect(SOLVER, search::SOLVERS.len());

        let yardstick = self.yardstick(&bench, &teller)?;
        let mut results = Results::new(self, machine, &yardstick);
        let mut steps: Vec<(&str, String, Vec<Setting>, Option<&Level>)> = Vec::new();
        if let (Some(few), false) = (&few, few_is_a_level) {
            steps.push((knobs::SCANS, few.name.clone(), few.set.clone(), None));
        }
        for (knob, level) in of_subject {
            steps.push(match (&few, knob.acts) {
                (Some(few), Acts::Views) => {
                    let name = format!("{}, {} {}", level.name, knobs::SCANS, few.name);
                    (knob.name, name, [&few.set[..], &level.set].concat(), Some(few))
                }
                _ => (knob.name, level.name.clone(), level.set.clone(), None),
            });
        }
        for (knob, name, set, against) in steps {
            teller.say(&format!("{knob} {name}"));
            let (measured, now) = bench.preprocess(&set, against.map(|few| &few.set[..]))?;
            teller.done(PREPROCESS, now);
            results.preprocess.push(PreprocessRow::new(knob, &name, measured));
        }
        if base.scans.is_some() {
            results.preprocess.insert(0, PreprocessRow::new("", "as configured", preprocessed));
        }
        results.precision = precision::measure(&self.config, &self.files, &bench.own_subject()?, &yardstick)?;
        for repeat in 0..settings.seeds {
            teller.say(&format!("the experiment's own point, seed {} of {}", repeat + 1, settings.seeds));
            let row = bench.row("", "as configured", Acts::Net, &[], repeat, &yardstick)?;
            teller.done(POINT, row.1);
            results.add(row.0);
            results.write(&self.folder)?;
        }
        for (knob, level) in of_nets {
            teller.say(&format!("{} {}", knob.name, level.name));
            let row = bench.row(knob.name, &level.name, knob.acts, &level.set, 0, &yardstick)?;
            teller.done(POINT, row.1);
            results.add(row.0);
            results.write(&self.folder)?;
        }
        for method in search::SOLVERS {
            teller.say(&format!("the solver, {}", method.name));
            let (row, now) = bench.solver(method, &yardstick)?;
            teller.done(SOLVER, now);
            results.solver.push(row);
            results.write(&self.folder)?;
        }
        let mut left = combinations;
        for direction in search::Direction::ALL {
            let mut walk = search::Walk::new(direction, &results, &levels, settings.combinations);
            while let Some((name, set)) = walk.next(&results) {
                teller.expect(POINT, left);
                teller.say(&format!("together: {name}"));
                let row = bench.row("together", &name, Acts::Net, &set, 0, &yardstick)?;
                teller.done(POINT, row.1);
                left = left.saturating_sub(1);
                results.add(row.0);
                results.write(&self.folder)?;
            }
        }
        results.complete = true;
        results.write(&self.folder)?;
        let computed = teller.computed.lock().map_or(0, |n| *n);
        Ok(Ended { results, folder: self.folder.clone(), computed })
    }

    /// Writes the page of the documentation, its figures and the front that becomes part of the program.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn document(results: &Results, page: &Path) -> Result<()> {
        docs::write(results, page)
    }

    /// The stage that makes the subject.
    fn subject_stage(&self) -> &'static str {
        if matches!(self.config.subject, SubjectConfig::Dressed(_)) { "dress" } else { "preprocess" }
    }

    /// Makes scans, bodies and templates of the experiment's own point, and says what preprocessing took.
    fn subject(&self, bench: &point::Bench<'_>, teller: &Teller<'_>) -> Result<Preprocessed> {
        if matches!(self.config.subject, SubjectConfig::Synthetic(_)) {
            teller.say("scans");
            self.open_run("subject", &[], bench.plugins)?.until("synth")?.all()?;
        }
        teller.say(if self.subject_stage() == "dress" { "templates" } else { "labels, bodies and templates" });
        bench.first_subject()
    }

    /// A run folder of the sweep with settings beside those of all points.
    fn open_run(&self, name: &str, settings: &[Setting], plugins: &Plugins) -> Result<Run> {
        let all = [&self.common[..], settings].concat();
        Run::open_set(&self.path, Some(self.folder.join(name)), &all, &mut anew(plugins)?)
    }

    /// Folder of the scans and names of those that are learnt from, once they are there.
    fn scans(&self) -> Result<Option<(PathBuf, Vec<String>)>> {
        let subject = self.folder.join("subject");
        let (folder, list) = match &self.config.subject {
            SubjectConfig::Dressed(_) => return Ok(None),
            SubjectConfig::Synthetic(_) => {
                let scans: Scans = artifact::open(&subject.join("synth.caphy"), "synth")?;
                let first = scans.list.first().and_then(|scan| scan.path.parent()).unwrap_or(Path::new(""));
                (subject.join(first), scans.list)
            }
            SubjectConfig::Scans(scans) => {
                let list = crate::stage::scans::scan_list(&self.files, scans, self.config.run.seed)?.list;
                (self.files.resolve(&scans.folder)?, list)
            }
        };
        let folder = std::path::absolute(&folder).map_err(|e| Error::io(&folder, "find", e))?;
        let names = list.iter().filter(|s| !s.held_out).map(|s| s.name.clone()).collect();
        Ok(Some((folder, names)))
    }

    fn yardstick(&self, bench: &point::Bench<'_>, teller: &Teller<'_>) -> Result<Yardstick> {
        let base = Base { config: &self.config, own_rounds: self.own_rounds, scans: None };
        // The finest template that the knob knows, or the experiment's own.
        let finest = knobs::finest(&base)?;
        let (subject, hash): (Subject, String) = bench.subject_of(&finest)?;
        let garments = subject.garments.len();
        let jobs = 2 * garments * (1 + self.config.tradeoff().restarts);
        teller.expect(YARDSTICK, jobs);
        teller.say("the solver at its finest");
        let started = Instant::now();
        let done = |ended: usize, of: usize, now: bool| {
            teller.done(YARDSTICK, now);
            if ended < of && now {
                teller.say(&format!("the solver at its finest: {ended} of {of}"));
            }
        };
        let folder = self.folder.join("yardstick");
        let made = Yardstick::new(&folder, &self.files, &self.config, &subject, &hash, &done)?;
        (teller.say)(&format!("the solver at its finest: done in {:.0} s", started.elapsed().as_secs_f64()));
        Ok(made)
    }
}

/// Takes over what another folder of the sweep has, unless this one has been begun already.
fn begin(from: &Path, to: &Path) -> Result<()> {
    if to.join("run.json").exists() { Ok(()) } else { share(from, to) }
}
