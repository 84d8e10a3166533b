//! Writes the page that says what extremes are survived and where single precision is enough, with its figures beside it:
//!
//! ```text
//! cargo run --release --example extremes -- docs/extremes.md
//! ```

mod precision;

use caphy::artifact::write_atomically;
use caphy::markdown::table;
use caphy::plot::{Axes, Curve, lines, standalone};
use caphy::plugins::Plugins;
use caphy::stress::{self, Atlas, ROUNDINGS};
use std::path::{Path, PathBuf};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// What stands before the numbers.
const INTRODUCTION: &str = include_str!("introduction.md");
/// Random strains and folds per fabric.
const STATES: usize = 1_000_000;

/// Where figures go, and how the page names the folder.
struct Figures {
    folder: PathBuf,
    named: String,
}

impl Figures {
    /// Writes a plot over log10 of x; returns the line that shows it.
    fn plot(&self, name: &str, title: &str, x: &str, y: &str, curves: Vec<Curve>) -> Outcome<String> {
        let axes = Axes { title, x, y, log_y: true };
        write_atomically(&self.folder.join(format!("{name}.svg")), standalone(&lines(&axes, &curves)).as_bytes())?;
        Ok(format!("\n![{title}]({}/{name}.svg)\n", self.named))
    }
}

fn main() -> Outcome<()> {
    let mut arguments = std::env::args().skip(1);
    let page = PathBuf::from(arguments.next().ok_or("name the page, such as docs/extremes.md")?);
    let stem = page.file_stem().ok_or("name a file")?.to_string_lossy().into_owned();
    let figures = Figures { folder: page.parent().unwrap_or(Path::new(".")).join(&stem), named: stem };

    eprintln!("stability atlas");
    let (mut atlases, mut random) = (Vec::new(), Vec::new());
    for (name, material) in stress::materials("all", &Plugins::new()?)? {
        atlases.push(Atlas::new(&name, &*material)?);
        random.push(stress::random_states(&*material, STATES, 1)?);
    }
    let shown = ["gray-interlock", "navy-sparkle-sweat", "stvk", "neo_hookean"];
    let mut pictures = String::new();
    for name in shown {
        if let Some(atlas) = atlases.iter().find(|a| a.material == name) {
            let svg = stress::strain_map(atlas);
            write_atomically(&figures.folder.join(format!("{name}.svg")), standalone(&svg).as_bytes())?;
            pictures += &format!("![{name}]({}/{name}.svg)\n", figures.named);
        }
    }
    let text = format!(
        "{INTRODUCTION}\n## The stability atlas\n\n\
         `caphy stress --out FOLDER` maps every fabric, or those of a plugin; here with {STATES} random strains and folds each.\n\n\
         ```text\n{}```\n\n{pictures}\n\
         Yellow gives way: the tangent ∂S/∂G is not positive there. Measured tables do so under tension by themselves, neo-Hookean cloth \
         where it is stretched far one way and crushed the other; StVK cloth never does in strain. (Any compressed cloth buckles \
         nevertheless: that is geometry.) Red in neo-Hookean f32 is a bound that stays: where det C is below a hundredth while one stretch is \
         large, it is a difference of large numbers, and the stress is off by more than {ROUNDINGS:.0} roundings of its tangent. There, use f64.\n\n{}",
        stress::table(&atlases, &random),
        precision::section(&figures)?,
    );
    write_atomically(&page, text.as_bytes())?;
    println!("{}", page.display());
    Ok(())
}
