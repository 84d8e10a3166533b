//! Writes the page that says how far fabric estimates can be trusted, with its figures beside it:
//!
//! ```text
//! cargo run --release --example trust -- docs/trust.md [SEEDS]
//! cargo run --release --example trust -- --section "Worn shirts" [SEEDS]
//! ```
//!
//! The second prints one section.
//!
//! Every number on the page is computed here, on cloth in the laboratory: known fabrics, simulated, scanned with noise, estimated.

mod balance;
mod bending;
mod disturbed;
mod drapes;
mod fits;
mod scans;
#[path = "../../crates/garment/tests/all/estimate/study.rs"]
#[allow(dead_code, reason = "shared with the tests, which use all of it")]
mod study;
mod worn;

use caphy::artifact::write_atomically;
use caphy::markdown::table;
use caphy::plot;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A fallible section: the page's text.
type Section = Result<String, Box<dyn std::error::Error>>;

/// Where figures go.
struct Figures {
    folder: PathBuf,
    /// The folder as the page names it.
    named: String,
}

impl Figures {
    /// Writes a plot; returns the line that shows it.
    fn plot(&self, name: &str, title: &str, svg: &str) -> Section {
        self.write(&format!("{name}.svg"), title, plot::standalone(svg).as_bytes())
    }
    /// Writes a file; returns the line that shows it.
    fn write(&self, name: &str, title: &str, bytes: &[u8]) -> Section {
        write_atomically(&self.folder.join(name), bytes)?;
        Ok(format!("\n![{title}]({}/{name})\n", self.named))
    }
}

/// The usual pair: a soft knit and a stiff denim.
const PAIR: [&str; 2] = ["gray-interlock", "11oz-black-denim"];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let first = arguments.next().ok_or("name the page, such as docs/trust.md")?;
    let only = if first == "--section" { Some(arguments.next().ok_or("say how its title begins")?) } else { None };
    let page = PathBuf::from(first);
    let seeds: u64 = arguments.next().map_or(Ok(8), |s| s.parse())?;
    let stem = page.file_stem().ok_or("name a file")?.to_string_lossy().into_owned();
    let figures = Figures { folder: page.parent().unwrap_or(Path::new(".")).join(&stem), named: stem };
    let mut text = format!(
        "# How far a fabric estimate can be trusted\n\n\
         Made by `cargo run --release --example trust -- docs/trust.md {seeds}`; every number is computed there. The cloth of most tables \
         is a 0.3 m square of 441 vertices in five poses (two hangs, three that stick out), simulated with a known fabric, scanned with \
         0.5 mm of noise on every coordinate where nothing else is said, and estimated by its seven factors. Ratios are estimate \
         over truth. Worn garments are harder: see the end.\n"
    );
    let sections: [(&str, &dyn Fn() -> Section); 9] = [
        ("Eq. 10 alone", &|| balance::noise(&PAIR)),
        ("The paper's alternation", &|| balance::drift(PAIR[0], &figures)),
        ("The equilibrium fit, started near", &|| {
            fits::near(&["gray-interlock", "11oz-black-denim", "royal-target"], seeds)
        }),
        ("The equilibrium fit, started from another fabric", &|| fits::confusion()),
        ("What is not known: cut, friction, density, noise, mesh", &|| disturbed::section(PAIR[0], &figures)),
        ("Bending: a strip against the elastica", &|| bending::section()),
        ("Ten fabrics over a table (an illustration)", &|| drapes::section(&figures)),
        ("Worn shirts, the body known", &|| worn::section()),
        ("From scans", &|| scans::section()),
    ];
    for (title, section) in sections {
        if only.as_ref().is_some_and(|wanted| !title.starts_with(wanted.as_str())) {
            continue;
        }
        let started = Instant::now();
        eprintln!("{title}");
        text += &format!("\n## {title}\n\n{}", section()?);
        eprintln!("{title}: {:.0} s", started.elapsed().as_secs_f64());
    }
    if only.is_some() {
        println!("{text}");
        return Ok(());
    }
    write_atomically(&page, text.as_bytes())?;
    println!("{}", page.display());
    Ok(())
}
