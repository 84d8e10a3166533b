//! `type = "colour"`: garments known by their colours.

use crate::seeds::{self, Seed};
use crate::view;
use caphy_core::files::Files;
use caphy_core::scan::Label;
use caphy_core::segmenter::{NO_TRIANGLE, Segmenter, SegmenterSpec, View};
use caphy_core::{Error, Result};
use caphy_render::colours::srgb_to_linear;
use serde::{Deserialize, Serialize};

/// One colour of the palette.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaletteEntry {
    /// What has this colour.
    pub label: Label,
    /// sRGB.
    pub colour: [u8; 3],
}

/// `[segmenter]` with `type = "colour"`.
///
/// ```toml
/// type = "colour"
/// max_distance = 30.0
/// far = "body"
/// [[palette]]
/// label = "upper"
/// colour = [57, 80, 161]
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SegmenterColourSpec {
    /// Colours and what they mean; a label may have several. None by default: `seeds` say them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub palette: Vec<PaletteEntry>,
    /// Places on scans whose colours join the palette.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub seeds: Vec<Seed>,
    /// Largest distance in CIELAB (ΔE*ab, 2.3 is just noticeable) to the nearest palette colour; none by default: the
    /// nearest decides however far it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_distance: Option<f64>,
    /// Label of a pixel farther than `max_distance` from the whole palette. Not known, by default: other views or the
    /// neighbours decide.
    #[serde(default = "unknown")]
    pub far: Label,
    /// Pixels this close to nothing (the background or the image's border) are not labelled [pixels]: photographic
    /// scans bleed there. 0 by default: the renderer does not.
    #[serde(default)]
    pub outline: usize,
}

fn unknown() -> Label {
    Label::Ignore
}

#[typetag::serde(name = "colour")]
impl SegmenterSpec for SegmenterColourSpec {
    fn build(&self, files: &dyn Files) -> Result<Box<dyn Segmenter>> {
        let mut palette = self.palette.clone();
        palette.extend(seeds::colours_of(&self.seeds, files)?);
        Ok(Box::new(SegmenterColour::new(&Self { palette, seeds: Vec::new(), ..self.clone() })?))
    }
}

/// Gives each pixel the label of the palette colour nearest in CIELAB (D65), where equal distances look about equally
/// different. Equal distances go to the earlier palette entry.
///
/// # Errors
/// [`Error::Mesh`] naming a scan without vertex colours, [`Error::Length`] for images of the wrong size.
#[derive(Debug, Clone)]
pub struct SegmenterColour {
    /// CIELAB and label.
    palette: Vec<([f32; 3], Label)>,
    /// Squared; infinite when not limited.
    max_distance_squared: f32,
    far: Label,
    outline: usize,
    lab: LabTable,
}

impl SegmenterColour {
    /// Checks the values; `seeds` are already in the palette.
    ///
    /// # Errors
    /// [`Error::Config`] for an empty palette, one colour with two meanings, a distance that is not positive.
    pub fn new(spec: &SegmenterColourSpec) -> Result<Self> {
        if spec.palette.is_empty() {
            let remedy =
                "add [[segmenter.palette]] entries with `label` and `colour = [r, g, b]`, or [[segmenter.seeds]]";
            return Err(Error::config("segmenter.palette", "has no colours", remedy));
        }
        for (i, entry) in spec.palette.iter().enumerate() {
            let twin = spec.palette[..i].iter().position(|e| e.colour == entry.colour && e.label != entry.label);
            if let Some(j) = twin {
                let problem = format!("entries {j} and {i} give the colour {:?} two labels", entry.colour);
                return Err(Error::config("segmenter.palette", problem, "keep one of them"));
            }
        }
        let limit = spec.max_distance.unwrap_or(f64::INFINITY);
        if limit.is_nan() || limit <= 0.0 {
            let remedy = "give a CIELAB distance above 0 (20 to 40 is usual), or leave the key out";
            return Err(Error::config("segmenter.max_distance", format!("is {limit}"), remedy));
        }
        let lab = LabTable::new();
        let palette = spec.palette.iter().map(|e| (lab.lab(e.colour), e.label)).collect();
        let max_distance_squared = (limit * limit) as f32;
        Ok(Self { palette, max_distance_squared, far: spec.far, outline: spec.outline, lab })
    }

    /// The label of one sRGB colour.
    pub fn label_of(&self, colour: [u8; 3]) -> Label {
        let lab = self.lab.lab(colour);
        let mut best = (self.max_distance_squared, self.far);
        for (entry, label) in &self.palette {
            let distance: f32 = (0..3).map(|k| (entry[k] - lab[k]).powi(2)).sum();
            if distance < best.0 {
                best = (distance, *label);
            }
        }
        best.1
    }
}

impl Segmenter for SegmenterColour {
    fn segment(&self, view: &View<'_>, labels: &mut [Label]) -> Result<()> {
        view::check(view, labels)?;
        view::check_colours(view, "colour")?;
        // Neighbouring pixels of a plain cloth are often exactly equal.
        let mut last = ([0; 3], self.label_of([0; 3]));
        for ((&id, &colour), label) in view.triangle.iter().zip(view.colour).zip(labels.iter_mut()) {
            if id == NO_TRIANGLE {
                *label = Label::Ignore;
                continue;
            }
            if colour != last.0 {
                last = (colour, self.label_of(colour));
            }
            *label = last.1;
        }
        if self.outline > 0 {
            ignore_outline(view, self.outline, labels);
        }
        Ok(())
    }
}

/// Takes the label from pixels within `width` pixels (along rows and columns) of one that shows nothing.
fn ignore_outline(view: &View<'_>, width: usize, labels: &mut [Label]) {
    let (columns, rows) = (view.camera.width, view.camera.height);
    let mut near = vec![false; labels.len()];
    // Along each line, the distance to the last empty pixel seen; outside of the image is empty.
    let mut sweep = |count: usize, place: &dyn Fn(usize) -> usize| {
        for backwards in [false, true] {
            let mut distance = 0;
            for i in 0..count {
                let pixel = place(if backwards { count - 1 - i } else { i });
                distance = if view.triangle[pixel] == NO_TRIANGLE { 0 } else { distance + 1 };
                near[pixel] |= distance <= width;
            }
        }
    };
    for y in 0..rows {
        sweep(columns, &|x| y * columns + x);
    }
    for x in 0..columns {
        sweep(rows, &|y| y * columns + x);
    }
    for (label, near) in labels.iter_mut().zip(near) {
        if near {
            *label = Label::Ignore;
        }
    }
}

/// sRGB to CIELAB under D65 (CIE 15:2004); the bytes' linear light is looked up.
#[derive(Debug, Clone)]
struct LabTable {
    linear: Vec<f32>,
}

impl LabTable {
    fn new() -> Self {
        Self { linear: (0..=255).map(srgb_to_linear).collect() }
    }

    /// L* in [0, 100], a*, b*.
    fn lab(&self, colour: [u8; 3]) -> [f32; 3] {
        let [r, g, b] = colour.map(|c| self.linear[usize::from(c)]);
        // The white point D65 is divided out of the rows.
        let x = (0.412_456_4 * r + 0.357_576_1 * g + 0.180_437_5 * b) / 0.950_47;
        let y = 0.212_672_9 * r + 0.715_152_2 * g + 0.072_175 * b;
        let z = (0.019_333_9 * r + 0.119_192 * g + 0.950_304_1 * b) / 1.088_83;
        let f = |t: f32| if t > 0.008_856_452 { t.cbrt() } else { t * 7.787_037 + 4.0 / 29.0 };
        let (fx, fy, fz) = (f(x), f(y), f(z));
        [116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::files::Disk;
    use caphy_core::scan::Scan;
    use caphy_core::{TriMesh, Vec3};
    use caphy_render::{Projection, frame, render};

    const TABLE: &str = "type = \"colour\"\nmax_distance = 25.0\nfar = \"body\"\noutline = 1\n\
        [[palette]]\nlabel = \"upper\"\ncolour = [57, 80, 161]\n[[palette]]\nlabel = \"lower\"\ncolour = [60, 60, 64]\n";

    fn spec() -> SegmenterColourSpec {
        let entry = |label, colour| PaletteEntry { label, colour };
        let palette = vec![entry(Label::Upper, [57, 80, 161]), entry(Label::Lower, [60, 60, 64])];
        SegmenterColourSpec { palette, seeds: vec![], max_distance: None, far: Label::Ignore, outline: 0 }
    }

    #[test]
    fn lab_of_known_colours() {
        // L*, a*, b* of the sRGB primaries under D65 (Lindbloom's calculator, two decimals).
        let table = LabTable::new();
        for (colour, expected) in [
            ([255, 0, 0], [53.24, 80.09, 67.20]),
            ([0, 255, 0], [87.73, -86.18, 83.18]),
            ([0, 0, 255], [32.30, 79.19, -107.86]),
            ([255, 255, 255], [100.0, 0.0, 0.0]),
            ([0, 0, 0], [0.0, 0.0, 0.0]),
        ] {
            let lab = table.lab(colour);
            assert!((0..3).all(|k| (lab[k] - expected[k]).abs() < 0.02f32), "{colour:?}: {lab:?}");
        }
    }

    #[test]
    fn the_nearest_colour_decides_unless_all_are_far() {
        let mut spec = spec();
        let free = SegmenterColour::new(&spec).unwrap();
        assert_eq!(free.label_of([50, 70, 150]), Label::Upper);
        assert_eq!(free.label_of([70, 66, 66]), Label::Lower);
        assert_ne!(free.label_of([200, 155, 124]), Label::Ignore);
        spec.max_distance = Some(25.0);
        assert_eq!(SegmenterColour::new(&spec).unwrap().label_of([200, 155, 124]), Label::Ignore);
        spec.far = Label::Body;
        let limited = SegmenterColour::new(&spec).unwrap();
        assert_eq!(limited.label_of([200, 155, 124]), Label::Body);
        assert_eq!(limited.label_of([50, 70, 150]), Label::Upper);
    }

    #[test]
    fn outline_and_background_are_ignored_and_scans_without_colours_are_named() {
        let vertices = vec![Vec3::zeros(), Vec3::x(), Vec3::new(1.0, 1.0, 0.0), Vec3::y()];
        let mesh = TriMesh { vertices, faces: vec![[0, 1, 2], [0, 2, 3]] };
        let mut scan = Scan { name: "sq".into(), mesh, colours: Some(vec![[57, 80, 161]; 4]), labels: None };
        let camera = frame(scan.mesh.bounds().unwrap(), &Vec3::z(), Projection::Orthographic, 32, 32);
        let image = render(&scan.mesh, scan.colours.as_deref(), &camera);
        let run = |scan: &Scan, outline: usize| {
            let view = View {
                scan,
                index: 0,
                count: 1,
                camera: &camera,
                colour: &image.colour,
                depth: &image.depth,
                triangle: &image.triangle,
            };
            let mut labels = vec![Label::Body; 32 * 32];
            SegmenterColour::new(&SegmenterColourSpec { outline, ..spec() }).unwrap().segment(&view, &mut labels)?;
            Ok::<_, Error>(labels.iter().filter(|l| **l == Label::Upper).count())
        };
        assert_eq!(run(&scan, 0).unwrap(), 30 * 30);
        assert_eq!(run(&scan, 2).unwrap(), 26 * 26);
        scan.colours = None;
        let text = run(&scan, 0).unwrap_err().to_string();
        assert!(text.contains("`sq`") && text.contains("vertex"), "{text}");
    }

    #[test]
    fn the_table_parses_and_refuses_what_it_does_not_know() {
        let boxed: Box<dyn SegmenterSpec> = toml::from_str(TABLE).unwrap();
        assert!(boxed.build(&Disk).is_ok());
        let text = toml::to_string(&boxed).unwrap();
        let again: Box<dyn SegmenterSpec> = toml::from_str(&text).unwrap();
        assert_eq!((again.typetag_name(), toml::to_string(&again).unwrap()), ("colour", text));
        let refused = |text: &str| toml::from_str::<Box<dyn SegmenterSpec>>(text).unwrap_err().to_string();
        assert!(refused(&TABLE.replace("outline", "outlin")).contains("outlin"));
        assert!(refused(&TABLE.replace("colour = [60", "color = [60")).contains("color"));
        assert!(refused(&TABLE.replace("\"lower\"", "\"hat\"")).contains("hat"));
        assert!(refused(&TABLE.replace("161]", "300]")).contains("300"));
    }

    #[test]
    fn values_that_cannot_work_are_refused() {
        let refused = |change: fn(&mut SegmenterColourSpec)| {
            let mut spec = spec();
            change(&mut spec);
            SegmenterColour::new(&spec).unwrap_err().to_string()
        };
        assert!(refused(|s| s.palette.clear()).contains("palette"));
        assert!(refused(|s| s.palette.push(PaletteEntry { label: Label::Body, ..s.palette[0] })).contains("0 and 2"));
        assert!(refused(|s| s.max_distance = Some(f64::NAN)).contains("NaN"));
        assert!(refused(|s| s.max_distance = Some(-1.0)).contains("-1"));
    }
}
