//! Writes the page that says how well bodies, labels and templates are found, on generated people whose truth is known:
//!
//! ```text
//! cargo run --release --example registration -- docs/registration.md [SEEDS] [FIRST_SEED] [KEY=VALUE …]
//! ```
//!
//! Runs stay in `runs/registration` and are reused; settings change `subject.toml` beside this file.

use caphy::artifact::{self, write_atomically};
use caphy::config::Setting;
use caphy::files::ProjectFiles;
use caphy::markdown::table;
use caphy::plot::number;
use caphy::plugins::Plugins;
use caphy::registered::{BodyError, LabelError, area_below, body_error, joint_error, label_error, true_body};
use caphy::runner::Run;
use caphy::stage::Scans;
use caphy::stage::preprocess::Subject;
use caphy::stage::scans::read_framed;
use caphy_core::body::BodyModel;
use caphy_garment::template::{GarmentKind, MeasureErrors};
use std::path::{Path, PathBuf};
use std::time::Instant;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

const EXPERIMENT: &str = "examples/registration/subject.toml";
const RUNS: &str = "runs/registration";
/// Joints that a clothed body shows: without fingers, jaw and eyes.
const BODY_JOINTS: usize = 22;

/// What was measured of one person.
struct Person {
    seed: u64,
    labels: Vec<LabelError>,
    bodies: Vec<BodyError>,
    /// Median and largest per scan [mm].
    joints: Vec<[f64; 2]>,
    templates: Vec<Found>,
    seconds: f64,
}

/// How a template differs from the true one.
struct Found {
    kind: GarmentKind,
    errors: MeasureErrors,
    /// Difference of the area that scans show, as a share [1]: of trousers what lies below the shirt's hem.
    shown_area: f64,
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let page = PathBuf::from(arguments.first().ok_or("name the page, such as docs/registration.md")?);
    let (settings, numbers): (Vec<&String>, Vec<&String>) = arguments[1..].iter().partition(|a| a.contains('='));
    let seeds: u64 = numbers.first().map_or(Ok(10), |s| s.parse())?;
    let first: u64 = numbers.get(1).map_or(Ok(1), |s| s.parse())?;
    let mut people = Vec::new();
    for seed in first..first + seeds {
        let person = measure(seed, &settings)?;
        person.tell();
        people.push(person);
    }
    write_atomically(&page, report(&people).as_bytes())?;
    println!("{}", page.display());
    Ok(())
}

fn measure(seed: u64, settings: &[&String]) -> Outcome<Person> {
    let texts = std::iter::once(format!("run.seed={seed}")).chain(settings.iter().map(|s| s.to_string()));
    let settings = texts.map(|t| Setting::parse(&t)).collect::<caphy_core::Result<Vec<_>>>()?;
    let out = Path::new(RUNS).join(format!("seed-{seed}"));
    let mut plugins = Plugins::new()?;
    let run = Run::open_set(Path::new(EXPERIMENT), Some(out.clone()), &settings, &mut plugins)?;
    let body = run.config().body.body(&ProjectFiles::new(Path::new(".")))?;
    let started = Instant::now();
    run.until("preprocess")?.all()?;
    let seconds = started.elapsed().as_secs_f64();
    let scans: Scans = artifact::open(&out.join("synth.caphy"), "synth")?;
    let subject: Subject = artifact::open(&out.join("preprocess.caphy"), "preprocess")?;
    compare(seed, &*body, (&scans, &ProjectFiles::new(&out)), &subject, seconds)
}

fn compare(
    seed: u64,
    body: &dyn BodyModel,
    (scans, files): (&Scans, &ProjectFiles),
    subject: &Subject,
    seconds: f64,
) -> Outcome<Person> {
    let truth = scans.truth.as_ref().ok_or("the truth of a generated person is known")?;
    let mut fitted = body.rest(&subject.shape);
    fitted.displacement.clone_from(&subject.displacement);
    let mut person = Person { seed, labels: vec![], bodies: vec![], joints: vec![], templates: vec![], seconds };
    for scan in &subject.scans {
        let index = scans.list.iter().position(|file| file.name == scan.name).ok_or("a scan without its file")?;
        let posed = body.forward(&fitted.posed(&scan.pose))?;
        let real = true_body(body, truth, index)?;
        person.bodies.push(body_error(&posed.vertices, &real, &body.describe().faces, &scan.points)?);
        person.joints.push(joint_error(&posed.joints[..BODY_JOINTS], &truth.joints[index][..BODY_JOINTS]));
        let mesh = read_framed(files, &scans.list[index], &scan.frame)?.mesh;
        person.labels.push(label_error(&mesh, &scan.points.labels, &truth.labels[index])?);
    }
    let of = |kind| truth.garments.iter().find(|g| g.kind == kind);
    for (choice, garment) in subject.choices.iter().zip(&subject.garments) {
        let kind = choice.kind;
        let (real, shirt) = of(kind).zip(of(GarmentKind::Upper)).ok_or("a true garment is missing")?;
        let hem = shirt.template.vertices.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
        let below = if kind == GarmentKind::Lower { hem } else { f64::INFINITY };
        let shown_area = area_below(&garment.mesh, below) / area_below(&real.template, below) - 1.0;
        person.templates.push(Found { kind, errors: choice.measures.against(&real.measures), shown_area });
    }
    Ok(person)
}

/// Median and largest of some values.
fn spread(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let mut all: Vec<f64> = values.collect();
    all.sort_by(f64::total_cmp);
    [all.get(all.len() / 2).copied().unwrap_or(f64::NAN), all.last().copied().unwrap_or(f64::NAN)]
}

impl Person {
    fn row(&self) -> Vec<String> {
        let both = |values: &mut dyn Iterator<Item = f64>| {
            let [median, most] = spread(values);
            format!("{} / {}", number(median), number(most))
        };
        let least = self.labels.iter().map(|l| l.right).fold(1.0, f64::min);
        vec![
            self.seed.to_string(),
            format!("{:.2}", 100.0 * least),
            both(&mut self.labels.iter().map(|l| l.border_mm[0])),
            both(&mut self.labels.iter().map(|l| l.border_mm[1])),
            both(&mut self.labels.iter().map(|l| l.wrong_mm[0])),
            both(&mut self.bodies.iter().map(|b| b.skin_mm[0])),
            both(&mut self.bodies.iter().map(|b| b.skin_mm[1])),
            both(&mut self.bodies.iter().map(|b| b.covered_mm[0])),
            both(&mut self.bodies.iter().map(|b| b.covered_mm[1])),
            both(&mut self.bodies.iter().map(|b| b.outward_mm[1])),
            both(&mut self.joints.iter().map(|j| j[0])),
            both(&mut self.joints.iter().map(|j| j[1])),
        ]
    }
    /// Girths and lengths that scans show [mm]: none of the waist, which a shirt hides. From cuff to cuff of trousers is twice a leg.
    fn visible(&self) -> Vec<f64> {
        let shown = |found: &Found| -> Vec<f64> {
            let legs = found.kind == GarmentKind::Lower;
            let half = |name: &str| if legs && name.contains(" to ") { 0.5 } else { 1.0 };
            let seen = found.errors.lengths_m.iter().filter(|(name, _)| !name.contains("waist"));
            seen.map(|(name, d)| 1e3 * d * half(name)).collect()
        };
        self.templates.iter().flat_map(shown).collect()
    }
    fn template_rows(&self) -> Vec<Vec<String>> {
        let row = |found: &Found| {
            let lengths = found.errors.lengths_m.iter().map(|(name, d)| format!("{name} {:+.0}", 1e3 * d));
            let lengths = lengths.collect::<Vec<_>>().join(", ");
            let [area, shown] = [found.errors.area, found.shown_area].map(|a| format!("{:+.1}", 100.0 * a));
            vec![self.seed.to_string(), found.kind.to_string(), area, shown, lengths]
        };
        self.templates.iter().map(row).collect()
    }
    fn tell(&self) {
        eprintln!("seed {}: {:.0} s", self.seed, self.seconds);
        for (i, (body, joints)) in self.bodies.iter().zip(&self.joints).enumerate() {
            let label = &self.labels[i];
            eprintln!(
                "  scan {i:2}: skin {:5.1} {:5.1}  cloth {:5.1} {:5.1}  outward {:+5.1} {:+5.1}  joints {:5.1} {:5.1}  labels {:.2} % {:.1} {:.1} mm",
                body.skin_mm[0],
                body.skin_mm[1],
                body.covered_mm[0],
                body.covered_mm[1],
                body.outward_mm[0],
                body.outward_mm[1],
                joints[0],
                joints[1],
                100.0 * label.right,
                label.border_mm[0],
                label.wrong_mm[0]
            );
        }
        eprintln!("  {}", self.row().join("  "));
        self.template_rows().iter().for_each(|r| eprintln!("  {}", r.join("  ")));
    }
}

fn report(people: &[Person]) -> String {
    let mut text = format!(
        "# Bodies, labels and templates from scans\n\n\
         Made by `cargo run --release --example registration -- docs/registration.md {} {}` from `{EXPERIMENT}`: generated people whose body \
         lies 3 mm (root mean square) outside of the fitted shape space, in a knit shirt and denim trousers of a cut that is none of the \
         samples, patterned and shaded, 20 scans each of about 100 000 triangles with 0.5 mm of noise, labelled by their colours. \
         Garments are worn in their true fabrics: in a wrong one taut edges stretch by another amount. Distances are between vertices of one triangulation, so that sliding along the skin counts. Cells are median / worst of the \
         scans; of the 95 % and 99 % columns, of each scan's 95th and 99th percentile. Borders are where labels meet: how far the found ones lie \
         from the true ones and these from them. Of wrong vertices, how far they are from one that truly has their label: mostly specks in \
         slits that no view looks into.\n",
        people.len(),
        people.first().map_or(1, |p| p.seed)
    );
    let head = [
        "seed",
        "labels right, worst scan, %",
        "borders, 95 %, mm",
        "borders, 99 %, mm",
        "wrong vertices, 99 %, mm",
        "skin, mm",
        "skin, 95 %, mm",
        "under cloth, mm",
        "under cloth, 95 %, mm",
        "outward under cloth, mm",
        "joints, mm",
        "farthest joint, mm",
    ];
    text += &table(&head, &people.iter().map(Person::row).collect::<Vec<_>>());
    let rows: Vec<_> = people.iter().flat_map(Person::template_rows).collect();
    text += "\nTemplates less the true ones. A waist is hidden by the shirt in all scans: how high trousers sit is then the middle of the style \
             space, and area, lengths and girths of the waist are as far off as that. Scans show what lies below the shirt's hem.\n";
    text += &table(&["seed", "garment", "area, %", "area that scans show, %", "girths and lengths, mm"], &rows);
    let visible: Vec<f64> = people.iter().flat_map(Person::visible).map(f64::abs).collect();
    let areas = people.iter().flat_map(|p| &p.templates).map(|t| 100.0 * t.shown_area.abs());
    let [typical, largest] = spread(visible.iter().copied());
    text += &format!(
        "\nWhat scans show (all but the waist; of trousers' cuff to cuff, twice a leg, half): {} of {} girths and lengths are within 10 mm \
         ({} of {} people have all of theirs so), median {} mm, worst {}; the areas of what scans show are off by {} % (median) and {} % (worst).\n",
        visible.iter().filter(|d| **d <= 10.0).count(),
        visible.len(),
        people.iter().filter(|p| p.visible().iter().all(|d| d.abs() <= 10.0)).count(),
        people.len(),
        number(typical),
        number(largest),
        number(spread(areas.clone())[0]),
        number(spread(areas)[1]),
    );
    let [skin, cloth, joints] = [
        (|b: &Person| spread(b.bodies.iter().map(|b| b.skin_mm[0]))[0]) as fn(&Person) -> f64,
        |b| spread(b.bodies.iter().map(|b| b.covered_mm[0]))[0],
        |b| spread(b.joints.iter().map(|j| j[0]))[0],
    ]
    .map(|of| spread(people.iter().map(of)));
    text += &format!(
        "\nOver all people, median and worst of their medians: skin {} and {} mm, under cloth {} and {} mm, joints {} and {} mm.\n",
        number(skin[0]),
        number(skin[1]),
        number(cloth[0]),
        number(cloth[1]),
        number(joints[0]),
        number(joints[1])
    );
    text
}
