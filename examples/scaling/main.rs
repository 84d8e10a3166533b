//! Writes the page that says how training grows with garments, windows and threads, with its figures beside it:
//!
//! ```text
//! cargo run --release --example scaling -- docs/scaling.md [LARGEST_VERTICES]
//! ```
//!
//! Each size is measured in a process of its own, so that its memory is its own: this program calls itself with `--one`.

mod one;

use caphy::artifact::write_atomically;
use caphy::markdown::table;
use caphy::memory::readable;
use caphy::plot::{Axes, Curve, lines, number, standalone};
use one::{Case, Measured};
use std::path::{Path, PathBuf};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Wanted vertices of shirts.
const SIZES: [usize; 8] = [1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 200_000];
/// The size at which windows, their length and threads are varied.
const MIDDLE: usize = 5_000;

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.first().is_some_and(|a| a == "--one") {
        let case: Case = serde_json::from_str(arguments.get(1).ok_or("a case is missing")?)?;
        println!("{}", serde_json::to_string(&one::measure(&case)?)?);
        return Ok(());
    }
    let page = PathBuf::from(arguments.first().ok_or("name the page, such as docs/scaling.md")?);
    let largest: usize = arguments.get(1).map_or(Ok(200_000), |s| s.parse())?;
    let (mut sizes, mut others) = (Vec::new(), Vec::new());
    for vertices in SIZES.into_iter().filter(|v| *v <= largest) {
        sizes.push(child(&Case { vertices, ..Case::default() })?);
    }
    for (windows, window) in [(1, 5), (4, 5), (8, 5), (16, 2), (16, 5), (16, 10), (16, 20)] {
        others.push(child(&Case { vertices: MIDDLE, windows, window, ..Case::default() })?);
    }
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let threaded = [1, threads].map(|threads| child(&Case { vertices: MIDDLE, threads, ..Case::default() }));
    let [alone, together] = threaded;
    let mut scanned = Vec::new();
    for scans in [1, 4, 16, 64, 256] {
        scanned.push(child(&Case { vertices: MIDDLE, scans, ..Case::default() })?);
    }
    let text = report(&page, largest, &sizes, &others, &scanned, &[alone?, together?])?;
    write_atomically(&page, text.as_bytes())?;
    println!("{}", page.display());
    Ok(())
}

/// Measures a case in a process of its own.
fn child(case: &Case) -> Outcome<Measured> {
    eprintln!("{case:?}");
    let output = std::process::Command::new(std::env::current_exe()?)
        .args(["--one", &serde_json::to_string(case)?])
        .stderr(std::process::Stdio::inherit())
        .output()?;
    if !output.status.success() {
        return Err(format!("{case:?} failed").into());
    }
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// Exponent of a power law by least squares of logarithms.
fn exponent(points: &[(f64, f64)]) -> f64 {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let mean = |f: fn(&(f64, f64)) -> f64| logs.iter().map(f).sum::<f64>() / n;
    let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
    let (xy, xx) = logs.iter().fold((0.0, 0.0), |s, p| (s.0 + (p.0 - mx) * (p.1 - my), s.1 + (p.0 - mx) * (p.0 - mx)));
    xy / xx
}

fn report(
    page: &Path,
    largest: usize,
    sizes: &[Measured],
    others: &[Measured],
    scans: &[Measured],
    threads: &[Measured],
) -> Outcome<String> {
    let stem = page.file_stem().ok_or("name a file")?.to_string_lossy().into_owned();
    let folder = page.parent().unwrap_or(Path::new(".")).join(&stem);
    let points = |of: &dyn Fn(&Measured) -> f64| -> Vec<(f64, f64)> {
        sizes.iter().map(|m| (m.vertices as f64, of(m))).collect()
    };
    let step = points(&|m| m.step_ms);
    let memory = points(&|m| m.peak_bytes as f64);
    let log = |p: &[(f64, f64)]| p.iter().map(|(x, y)| (x.log10(), *y)).collect::<Vec<_>>();
    let mut curves = vec![Curve { name: "step".into(), points: log(&step) }];
    let stages = ["net forward", "contact search", "strain", "bending", "net backward", "Adam"];
    for stage in stages {
        curves.push(Curve { name: stage.into(), points: log(&points(&|m| m.stage(stage))) });
    }
    let axes = Axes { title: "a training step", x: "log10 of garment vertices", y: "time [ms]", log_y: true };
    write_atomically(&folder.join("time.svg"), standalone(&lines(&axes, &curves)).as_bytes())?;
    let gib = |b: f64| b / (1u64 << 30) as f64;
    let curves = [
        ("measured", points(&|m| gib(m.peak_bytes as f64))),
        ("estimated by the plan", points(&|m| gib(m.estimated_bytes as f64))),
    ];
    let curves = curves.map(|(name, p)| Curve { name: name.into(), points: log(&p) });
    let axes = Axes { title: "memory of training", x: "log10 of garment vertices", y: "GiB", log_y: true };
    write_atomically(&folder.join("memory.svg"), standalone(&lines(&axes, &curves)).as_bytes())?;

    let exponents: Vec<String> = ["step"]
        .into_iter()
        .chain(stages)
        .map(|stage| {
            let of = |m: &Measured| if stage == "step" { m.step_ms } else { m.stage(stage) };
            format!("{stage} {:.2}", exponent(&points(&of)))
        })
        .collect();
    let rows: Vec<Vec<String>> = sizes
        .iter()
        .map(|m| {
            let mut row = vec![m.vertices.to_string(), number(m.setup_s), number(m.step_ms)];
            row.extend(stages.iter().map(|s| number(m.stage(s))));
            row.extend([readable(m.peak_bytes), readable(m.estimated_bytes)]);
            row
        })
        .collect();
    let head = [
        "vertices",
        "set-up, s",
        "step, ms",
        "net forward",
        "contact search",
        "strain",
        "bending",
        "net backward",
        "Adam",
        "peak memory",
        "the plan's estimate",
    ];
    let of = |windows: usize| others.iter().find(|m| m.case.windows == windows && m.case.window == 5);
    let [one, many] = [1, 16].map(|windows| of(windows).map_or(f64::NAN, |m| m.step_ms));
    let case = |m: &Measured| {
        vec![m.case.windows.to_string(), m.case.window.to_string(), number(m.step_ms), readable(m.peak_bytes)]
    };
    let by_scan = |m: &Measured| {
        let steps = m.case.scans.div_ceil(m.case.windows);
        let epoch = steps as f64 * m.step_ms;
        vec![m.case.scans.to_string(), number(m.setup_s), number(m.step_ms), number(epoch), readable(m.peak_bytes)]
    };
    let by_thread = |m: &Measured| vec![m.case.threads.to_string(), number(m.step_ms)];
    let load: Vec<String> = sizes.iter().map(|m| format!("{:.1}", m.load)).collect();
    Ok(format!(
        "# How training grows\n\n\
         Made by `cargo run --release --example scaling -- docs/scaling.md {largest}`; every number is measured there, each size in a process of its own. \
         A shirt of a measured fabric on a mannequin of about 10 500 vertices, the paper's net (GRU of 4 times 256, its head as wide as the \
         garment), 16 windows of 5 frames with 8 that lead in, one thread; beyond 29 000 vertices the triangles of a coarser shirt are split in four; the fastest of {} steps, since other work on the machine only ever adds (its \
         load average at each size: {}).\n\n\
         Over vertices, time per step grows with the power {:.2}, memory with {:.2}. By part: {}.\n{}\n\
         ![Time of a step]({stem}/time.svg)\n\n![Memory]({stem}/memory.svg)\n\n\
         The net's head has 256 weights for each of its outputs, three per vertex, and Adam holds each four times: 12 kB per vertex, most \
         of the memory and of the time of large garments. What does not fit is said by `caphy run CONFIG.toml --plan`.\n\n\
         ## Windows and frames\n\nAt {} vertices. Frames are lanes: 16 windows cost {:.1} times one.\n{}\n\
         ## Scans\n\nPoses of so many scans, each with three points for each garment vertex, at most {} in a step.\n{}\n\
         ## Threads\n{}",
        one::STEPS,
        load.join(", "),
        exponent(&step),
        exponent(&memory),
        exponents.join(", "),
        table(&head, &rows),
        others.first().map_or(0, |m| m.vertices),
        many / one,
        table(&["windows", "frames each", "step, ms", "peak memory"], &others.iter().map(case).collect::<Vec<_>>()),
        scans.first().map_or(0, |m| m.case.windows),
        table(
            &["scans", "set-up, s", "step, ms", "epoch, ms", "peak memory"],
            &scans.iter().map(by_scan).collect::<Vec<_>>(),
        ),
        table(&["threads", "step, ms"], &threads.iter().map(by_thread).collect::<Vec<_>>()),
    ))
}
