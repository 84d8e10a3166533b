//! Writes the page that says how near trained nets come to the reference solver on captured motion, with its figures beside it:
//!
//! ```text
//! cargo run --release --example nets -- docs/nets.md [KEY=VALUE …]
//! ```
//!
//! It needs `CAPHY_SHARED`, as `configs/cmu.toml` does. Runs stay in `runs/nets` and are reused; settings change the experiment.

use caphy::artifact::{self, write_atomically};
use caphy::config::{Config, Setting};
use caphy::markdown::table;
use caphy::plot::{Axes, Curve, lines, standalone};
use caphy::plugins::Plugins;
use caphy::quality::WAVELENGTHS;
use caphy::runner::Run;
use caphy::stage::compare::{Comparison, GarmentComparison};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

const EXPERIMENT: &str = "configs/cmu.toml";
const RUNS: &str = "runs/nets";
/// The body of the experiment, and the one that needs no file.
const BODIES: [(&str, &str); 2] = [("Anny", ""), ("mannequin", r#"body={type="mannequin"}"#)];
/// The fabric of the experiment, and a light knit, a heavy one and a stiff woven.
const FABRICS: [&str; 4] = ["stvk", "gray-interlock", "navy-sparkle-sweat", "11oz-black-denim"];
/// Shares of the experiment's rounds that the first case is trained for, each a training of its own: the learning rate falls to its end.
const SHARES: [f64; 5] = [0.03, 0.1, 0.25, 0.5, 1.0];

/// A shirt of one fabric on one body.
#[derive(Clone, Copy)]
struct Case {
    body: usize,
    fabric: usize,
    rounds: usize,
}

/// What became of it.
struct Measured {
    case: Case,
    /// Seconds of training and of the solver.
    seconds: [f64; 2],
    garment: GarmentComparison,
    picture: PathBuf,
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let page = PathBuf::from(arguments.first().ok_or("name the page, such as docs/nets.md")?);
    let given = &arguments[1..];
    let config = Config::read_set(Path::new(EXPERIMENT), &settings(&[], given)?, &mut Plugins::new()?)?;
    let rounds = config.train.rounds;
    let some = |share: &f64| ((rounds as f64 * share).round() as usize).max(1);
    let mut cases: Vec<Case> = SHARES.iter().map(|s| Case { body: 0, fabric: 0, rounds: some(s) }).collect();
    let dressed = (0..BODIES.len()).flat_map(|body| (0..FABRICS.len()).map(move |fabric| (body, fabric)));
    cases.extend(dressed.skip(1).map(|(body, fabric)| Case { body, fabric, rounds }));
    let all = measured(&cases, given)?;
    let text = report(&page, given, &all)?;
    write_atomically(&page, text.as_bytes())?;
    println!("{}", page.display());
    Ok(())
}

fn settings(own: &[String], given: &[String]) -> Outcome<Vec<Setting>> {
    Ok(own.iter().chain(given).map(|t| Setting::parse(t)).collect::<caphy_core::Result<_>>()?)
}

/// Measures all cases, one on each thread at a time.
fn measured(cases: &[Case], given: &[String]) -> Outcome<Vec<Measured>> {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let work = || -> Result<(), String> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(|e| e.to_string())?;
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(case) = cases.get(index) else { return Ok(()) };
            let found = pool.install(|| measure(*case, given).map_err(|e| e.to_string()))?;
            done.lock().map_err(|e| e.to_string())?.push((index, found));
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..rayon::current_num_threads()).map(|_| scope.spawn(work)).collect();
        workers.into_iter().try_for_each(|w| w.join().map_err(|_| "a worker ended early".to_string())?)
    })?;
    let mut done = done.into_inner().map_err(|e| e.to_string())?;
    done.sort_by_key(|d| d.0);
    Ok(done.into_iter().map(|d| d.1).collect())
}

fn measure(case: Case, given: &[String]) -> Outcome<Measured> {
    let ((body, setting), fabric) = (BODIES[case.body], FABRICS[case.fabric]);
    let mut own = vec![format!("train.rounds={}", case.rounds)];
    own.extend((!setting.is_empty()).then(|| setting.to_string()));
    own.extend((case.fabric > 0).then(|| format!(r#"upper.material={{type="measured",fabric="{fabric}"}}"#)));
    let out = Path::new(RUNS).join(format!("{}-{fabric}-{}", body.to_lowercase(), case.rounds));
    eprintln!("{}", out.display());
    let run = Run::open_set(Path::new(EXPERIMENT), Some(out.clone()), &settings(&own, given)?, &mut Plugins::new()?)?;
    let table = run.until("compare")?.all()?.table;
    eprintln!("{table}");
    let times: BTreeMap<String, f64> = serde_json::from_slice(&std::fs::read(out.join("timings.json"))?)?;
    let time = |stage: &str| times.get(stage).copied().unwrap_or(f64::NAN);
    let comparison: Comparison = artifact::open(&out.join("compare.caphy"), "compare")?;
    let picture = out.join(comparison.pictures.first().ok_or("no picture was drawn")?);
    let garment = comparison.garments.into_iter().next().ok_or("nothing was compared")?;
    Ok(Measured { case, seconds: [time("train"), time("reference")], garment, picture })
}

/// What is asked of a net, in the order of the table.
const HEAD: [&str; 13] = [
    "body",
    "fabric",
    "rounds",
    "training, s",
    "excess energy, %",
    "strain and bending over the solver's, single poses",
    "the same in motion",
    "hem's swing over the solver's",
    "mass too high or low, mm",
    "inside the body, %",
    "deepest, mm",
    "normals over the solver's, folds below 8 cm / to 16 cm / to 32 cm",
    "solver, s",
];

impl Measured {
    fn row(&self) -> Vec<String> {
        let g = &self.garment;
        let [rest, moving] = g.elastic_ratios();
        let bands: Vec<String> =
            (0..WAVELENGTHS.len()).map(|i| format!("{:.2}", g.spectrum.net.0[i] / g.spectrum.solver.0[i])).collect();
        vec![
            BODIES[self.case.body].0.into(),
            FABRICS[self.case.fabric].into(),
            self.case.rounds.to_string(),
            format!("{:.0}", self.seconds[0]),
            format!("{:.1}", 100.0 * g.excess()),
            format!("{rest:.2}"),
            format!("{moving:.2}"),
            format!("{:.2}", g.swing_ratio()),
            format!("{:.1}", 1e3 * g.height_m[0]),
            format!("{:.2}", 100.0 * g.penetrating.net),
            format!("{:.1}", 1e3 * g.deepest_m.net),
            bands.join(" / "),
            format!("{:.0}", self.seconds[1]),
        ]
    }
}

fn report(page: &Path, given: &[String], all: &[Measured]) -> Outcome<String> {
    let stem = page.file_stem().ok_or("name a file")?.to_string_lossy().into_owned();
    let folder = page.parent().unwrap_or(Path::new(".")).join(&stem);
    let (curve, others) = all.split_at(SHARES.len());
    let along = |name: &str, of: &dyn Fn(&Measured) -> f64| Curve {
        name: name.into(),
        points: curve.iter().map(|m| (m.seconds[0], of(m))).collect(),
    };
    let curves = [
        along("excess energy, of 10 %", &|m| 10.0 * m.garment.excess()),
        along("strain + bending, poses", &|m| m.garment.elastic_ratios()[0]),
        along("the same in motion", &|m| m.garment.elastic_ratios()[1]),
        along("hem's swing", &|m| m.garment.swing_ratio()),
    ];
    let axes = Axes { title: "quality by training time", x: "training [s]", y: "over the solver's", log_y: true };
    write_atomically(&folder.join("curves.svg"), standalone(&lines(&axes, &curves)).as_bytes())?;
    let settings = given.iter().map(|s| format!(" {s}")).collect::<String>();
    let mut text = format!(
        "# Nets against the solver on captured motion\n\n\
         Made by `cargo run --release --example nets -- docs/{stem}.md{settings}` from `{EXPERIMENT}`: a shirt learns from four captured \
         clips, half a minute, with copies that differ, and is compared with the reference solver on two seconds of another clip, in \
         motion and, every tenth frame, at rest. Energies are over all frames; excess energy is what a net has more than the solver \
         in single poses, as a share of what the skinned template has more. Vertices inside the body are counted before anything is \
         pushed out. Everything ran on one thread, {} side by side.\n\n## By training time\n\n\
         Each row is a training of its own, whose learning rate falls to its end.\n",
        rayon::current_num_threads(),
    );
    text += &table(&HEAD, &curve.iter().map(Measured::row).collect::<Vec<_>>());
    text += &format!("![Quality by training time]({stem}/curves.svg)\n\n## By body and fabric\n");
    let longest = curve.last().into_iter().chain(others);
    text += &table(&HEAD, &longest.clone().map(Measured::row).collect::<Vec<_>>());
    text += "Frames of the unseen clip, each skinned, by the net, by the solver:\n";
    for m in longest.filter(|m| m.case.fabric == 0 || m.case.fabric + 1 == FABRICS.len()) {
        let (body, fabric) = (BODIES[m.case.body].0, FABRICS[m.case.fabric]);
        let name = format!("{}-{fabric}.png", body.to_lowercase());
        write_atomically(&folder.join(&name), &std::fs::read(&m.picture)?)?;
        text += &format!("\n![{body}, {fabric}]({stem}/{name})\n");
    }
    Ok(text)
}
