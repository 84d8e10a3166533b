//! Garments that were not cut here: sources, repairs, placement, penetrations.

use super::{body, shirt, trousers};
use caphy_core::files::Files;
use caphy_core::query::{NearestGrid, hinges};
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_formats::obj::write_obj;
use caphy_garment::template::{
    BodyRest, ChooseOptions, FitOptions, GarmentKind, GivenMesh, Seen, Style, Tailor, Template, TemplateSpec, Worn,
    WornAs, choose_template, ease, finish, read_garment, refine, templates,
};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Files in memory.
#[derive(Default)]
struct Memory(BTreeMap<PathBuf, Vec<u8>>);

impl Files for Memory {
    fn read(&self, path: &Path) -> Result<Vec<u8>> {
        self.0.get(path).cloned().ok_or_else(|| Error::io(path, "read", std::io::ErrorKind::NotFound.into()))
    }
    fn list(&self, folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>> {
        let fits = |p: &&PathBuf| {
            p.parent() == Some(folder) && p.extension().is_some_and(|e| endings.contains(&&*e.to_string_lossy()))
        };
        Ok(self.0.keys().filter(fits).cloned().collect())
    }
}

fn tailor() -> &'static Tailor {
    static TAILOR: OnceLock<Tailor> = OnceLock::new();
    TAILOR.get_or_init(|| Tailor::new(body::capsules()).unwrap())
}

fn cut(style: &Style, resolution: f64) -> Template {
    tailor().generate(style, resolution).unwrap()
}

fn given(name: &str, mesh: TriMesh) -> GivenMesh {
    GivenMesh { name: name.into(), mesh, uv: None }
}

fn fit(mesh: TriMesh) -> Result<Template> {
    tailor().fit(given("cloth", mesh), &[], 0.03, &FitOptions::default())
}

fn refused(mesh: TriMesh) -> String {
    fit(mesh).unwrap_err().to_string()
}

fn names(t: &Template) -> Vec<&str> {
    t.loops.iter().map(|l| l.name.as_str()).collect()
}

/// Whether the segment from `p` to `q` goes through a triangle.
fn pierces(p: &Vec3, q: &Vec3, [a, b, c]: &[Vec3; 3]) -> bool {
    let volume = |x: &Vec3, y: &Vec3, z: &Vec3, w: &Vec3| (y - x).cross(&(z - x)).dot(&(w - x));
    if volume(a, b, c, p) * volume(a, b, c, q) >= 0.0 {
        return false;
    }
    let (s, t, u) = (volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a));
    (s > 0.0 && t > 0.0 && u > 0.0) || (s < 0.0 && t < 0.0 && u < 0.0)
}

/// Pairs of triangles of two meshes that cut each other: exact, an oracle independent of distances.
fn cuts(cloth: &TriMesh, skin: &TriMesh) -> usize {
    let corners = |m: &TriMesh| (0..m.faces.len()).map(|f| m.corners(f)).collect::<Vec<_>>();
    let (cloth, skin) = (corners(cloth), corners(skin));
    let centre = |t: &[Vec3; 3]| (t[0] + t[1] + t[2]) / 3.0;
    let radius = |t: &[Vec3; 3]| t.iter().map(|p| (p - centre(t)).norm()).fold(0.0, f64::max);
    let largest = skin.iter().map(radius).fold(0.0, f64::max);
    // Skin triangles sorted by height: only those of about the same height can meet.
    let mut by_height: Vec<(f64, usize)> = skin.iter().enumerate().map(|(i, t)| (centre(t).y, i)).collect();
    by_height.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut count = 0;
    for t in &cloth {
        let (c, reach) = (centre(t), radius(t) + largest);
        let from = by_height.partition_point(|e| e.0 < c.y - reach);
        for (_, i) in by_height[from..].iter().take_while(|e| e.0 <= c.y + reach) {
            let s = &skin[*i];
            if (centre(s) - c).norm() > radius(t) + radius(s) {
                continue;
            }
            let sides = |x: &[Vec3; 3], y: &[Vec3; 3]| (0..3).any(|k| pierces(&x[k], &x[(k + 1) % 3], y));
            count += usize::from(sides(t, s) || sides(s, t));
        }
    }
    count
}

#[test]
fn a_cut_garment_comes_back_as_it_was() {
    for (style, kind) in
        [(shirt(0.4, 0.5, 0.02, 0.3), GarmentKind::Upper), (trousers(0.7, 0.02, 0.5), GarmentKind::Lower)]
    {
        let own = cut(&style, 0.03);
        let t = fit(own.mesh.clone()).unwrap();
        assert_eq!((t.kind, t.mesh.faces.len()), (kind, own.mesh.faces.len()));
        let sorted = |t: &Template| {
            let mut all: Vec<(String, Vec<u32>)> = t
                .loops
                .iter()
                .map(|l| {
                    let mut ids = l.vertices.clone();
                    ids.sort_unstable();
                    (l.name.clone(), ids)
                })
                .collect();
            all.sort();
            all
        };
        // The cuts know their names; the joints must find the same.
        assert_eq!(sorted(&t), sorted(&own));
        let facts = t.given.unwrap();
        assert_eq!(facts.repairs, Default::default());
        assert_eq!((facts.penetration.rounds, facts.penetration.moved_m, facts.splits), (0, [0.0; 2], 0));
        let most = own.mesh.vertices.iter().zip(&t.mesh.vertices).map(|(p, q)| (p - q).norm()).fold(0.0, f64::max);
        assert_eq!(most, 0.0);
        assert_eq!(t.weights_body_vertex, own.weights_body_vertex);
        assert_eq!(t.material_uv, own.material_uv);
    }
}

#[test]
fn loops_are_named_at_the_ends_of_the_style_space() {
    let styles = [
        shirt(0.0, 0.0, 0.0, 0.0),
        shirt(0.0, 1.0, 0.05, 1.0),
        shirt(1.0, 1.0, 0.0, 0.0),
        trousers(0.0, 0.0, 0.0),
        trousers(1.0, 0.05, 1.0),
    ];
    for style in styles {
        let own = cut(&style, 0.03);
        let t = fit(own.mesh.clone()).unwrap();
        for l in &own.loops {
            assert_eq!(t.boundary(&l.name).map(|m| m.vertices.len()), Some(l.vertices.len()), "{style:?}: {}", l.name);
        }
    }
}

#[test]
fn skirts_and_strapless_tops_are_named_by_height() {
    // A tube around the trunk of the capsules.
    let tube = |low: f64, high: f64, radius: f64| {
        let mut mesh = TriMesh::default();
        let rings = ((high - low) / 0.03).ceil() as u32 + 1;
        for i in 0..rings {
            for k in 0..40 {
                let (s, c) = (std::f64::consts::TAU * f64::from(k) / 40.0).sin_cos();
                let y = low + (high - low) * f64::from(i) / f64::from(rings - 1);
                mesh.vertices.push(Vec3::new(radius * c, y, radius * s));
            }
        }
        for i in 0..rings - 1 {
            for k in 0..40 {
                let (p, q) = (40 * i + k, 40 * i + (k + 1) % 40);
                mesh.faces.extend([[p, p + 40, q], [q, p + 40, q + 40]]);
            }
        }
        mesh
    };
    let skirt = fit(tube(-0.35, 0.05, 0.24)).unwrap();
    assert_eq!((skirt.kind, names(&skirt)), (GarmentKind::Lower, vec!["waist", "hem"]));
    assert_eq!(skirt.attachments().map(|l| l.name.as_str()).collect::<Vec<_>>(), ["waist"]);
    let top = fit(tube(0.14, 0.32, 0.2)).unwrap();
    assert_eq!((top.kind, names(&top)), (GarmentKind::Upper, vec!["bust", "hem"]));
    assert_eq!(top.attachments().map(|l| l.name.as_str()).collect::<Vec<_>>(), ["bust"]);
    // Told otherwise, it is a skirt.
    let options = FitOptions { kind: Some(GarmentKind::Lower), ..FitOptions::default() };
    let told = tailor().fit(given("skirt", tube(0.14, 0.32, 0.2)), &[], 0.03, &options).unwrap();
    assert_eq!((told.kind, told.given.unwrap().kind_given), (GarmentKind::Lower, true));
    // A slit is an opening of its own.
    let mut slit = tube(-0.35, 0.05, 0.24);
    slit.faces.drain(400..402);
    assert_eq!(names(&fit(slit).unwrap()), ["waist", "hem", "opening_1"]);
}

#[test]
fn an_inside_out_garment_is_turned() {
    let own = cut(&shirt(0.4, 0.5, 0.02, 0.3), 0.03);
    let mut mesh = own.mesh.clone();
    mesh.faces.iter_mut().for_each(|f| f.swap(1, 2));
    let t = fit(mesh).unwrap();
    let facts = t.given.as_ref().unwrap();
    assert!(facts.repairs.turned_inside_out && facts.repairs.flipped_faces == 0);
    assert_eq!(t.mesh.faces, own.mesh.faces);
}

#[test]
fn other_units_axes_and_places_are_refused_with_the_remedy() {
    let own = cut(&shirt(0.4, 0.5, 0.02, 0.3), 0.03).mesh;
    let placed =
        |of: &dyn Fn(&Vec3) -> Vec3| TriMesh { vertices: own.vertices.iter().map(of).collect(), ..own.clone() };
    for (unit, name) in [(0.001, "millimetres"), (0.01, "centimetres"), (0.0254, "inches")] {
        let mesh = placed(&|p| p / unit);
        let text = refused(mesh.clone());
        let key = format!("metres_per_unit = {unit}");
        assert!(text.contains("covers nothing") && text.contains(name) && text.contains(&key), "{text}");
        let options = FitOptions { metres_per_unit: unit, ..FitOptions::default() };
        let t = tailor().fit(given("shirt", mesh), &[], 0.03, &options).unwrap();
        assert!((t.area() / cut(&shirt(0.4, 0.5, 0.02, 0.3), 0.03).area() - 1.0).abs() < 1e-9);
    }
    let tall = refused(placed(&|p| Vec3::new(p.x, -p.z, p.y) * 100.0));
    assert!(tall.contains("centimetres with z up") || tall.contains("metres_per_unit = 0.01"), "{tall}");
    // Standing on the floor, a metre above the body's origin.
    let floor = refused(placed(&|p| p + Vec3::y() * 0.95));
    assert!(floor.contains("translation_m = [0.0, -0."), "{floor}");
    let options = FitOptions { translation_m: [0.0, -0.95, 0.0], ..FitOptions::default() };
    let shifted = placed(&|p| p + Vec3::y() * 0.95);
    assert!(tailor().fit(given("shirt", shifted), &[], 0.03, &options).is_ok());
    let far = refused(placed(&|p| p + Vec3::x() * 40.0));
    assert!(far.contains("covers nothing") && far.contains("place it on the T-posed body"), "{far}");
    for scale in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let options = FitOptions { metres_per_unit: scale, ..FitOptions::default() };
        let e = tailor().fit(given("shirt", own.clone()), &[], 0.03, &options).unwrap_err();
        assert!(e.to_string().contains("metres_per_unit"), "{e}");
    }
}

#[test]
fn bad_garments_are_refused_by_element() {
    let own = cut(&shirt(0.4, 0.5, 0.02, 0.3), 0.03).mesh;
    assert!(refused(TriMesh::default()).contains("no faces"));
    assert!(refused(TriMesh { faces: Vec::new(), ..own.clone() }).contains("no faces"));
    let mut mesh = own.clone();
    mesh.vertices[31].x = f64::NAN;
    assert!(refused(mesh).contains("vertex 31"));
    let mut mesh = own.clone();
    mesh.faces[5][0] = 1 << 30;
    assert!(refused(mesh).contains("face 5"));
    // A collar sewn on: three faces at an edge.
    let mut mesh = own.clone();
    let [a, b, _] = mesh.faces[100];
    mesh.vertices.push(own.vertices[a as usize] + Vec3::y() * 0.02);
    mesh.faces.push([a, b, own.vertices.len() as u32]);
    let text = refused(mesh);
    assert!(text.contains(&format!("edge {}-{}", a.min(b), a.max(b))) && text.contains("3 faces"), "{text}");
    // Collapsed to a line.
    let line = TriMesh { vertices: own.vertices.iter().map(|p| Vec3::new(p.x, 0.3, 0.0)).collect(), ..own.clone() };
    assert!(refused(line).contains("area"));
    let bad = tailor().fit(
        GivenMesh { name: "shirt".into(), mesh: own.clone(), uv: Some(vec![[[f64::NAN; 2]; 3]; own.faces.len()]) },
        &[],
        0.03,
        &FitOptions::default(),
    );
    assert!(matches!(bad, Err(Error::NonFinite { .. })));
    let short = tailor().fit(
        GivenMesh { name: "shirt".into(), mesh: own.clone(), uv: Some(Vec::new()) },
        &[],
        0.03,
        &FitOptions::default(),
    );
    assert!(matches!(short, Err(Error::Length { .. })));
    let coarse = tailor().fit(given("shirt", own), &[], f64::NAN, &FitOptions::default());
    assert!(coarse.unwrap_err().to_string().contains("resolution"));
}

#[test]
fn a_metric_layout_becomes_the_material_frame_and_survives_splits() {
    // The rest triangles of a template are a layout without seams; scaled to centimetres it is still one.
    let own = cut(&trousers(0.7, 0.02, 0.5), 0.04);
    let uv: Vec<[[f64; 2]; 3]> = own.material_uv.iter().map(|t| t.map(|c| c.map(|x| 100.0 * x))).collect();
    let given = GivenMesh { name: "trousers".into(), mesh: own.mesh.clone(), uv: Some(uv) };
    let whole = tailor().fit(given.clone(), &[], 0.04, &FitOptions::default()).unwrap();
    let facts = whole.given.unwrap().layout.unwrap();
    assert!(facts.metric && facts.metres_per_unit == 0.01, "{facts:?}");
    for (a, b) in whole.material_uv.as_flattened().iter().zip(own.material_uv.as_flattened()) {
        assert!((a[0] - b[0]).abs() < 1e-12 && (a[1] - b[1]).abs() < 1e-12);
    }
    assert!(whole.grain.contains("layout") && whole.grain.contains("0.01"), "{}", whole.grain);
    let fine = tailor().fit(given, &[], 0.02, &FitOptions::default()).unwrap();
    assert_eq!(fine.given.as_ref().unwrap().splits, 1);
    assert_eq!(fine.material_uv.len(), 4 * own.mesh.faces.len());
    let ratio = fine.facts().layout_area_ratio;
    // Curves are longer than their chords.
    assert!(ratio > 0.95 && ratio < 1.01, "{ratio}");
    // A texture is not a pattern: the grain follows the bones.
    let squeezed = own.material_uv.iter().map(|t| t.map(|c| [c[0], 0.3 * c[1]])).collect();
    let given = GivenMesh { name: "trousers".into(), mesh: own.mesh.clone(), uv: Some(squeezed) };
    let plain = tailor().fit(given, &[], 0.04, &FitOptions::default()).unwrap();
    assert!(!plain.given.unwrap().layout.unwrap().metric && plain.grain.contains("dominant bone"));
    assert_eq!(plain.material_uv, own.material_uv);
}

#[test]
fn a_sunken_garment_is_brought_out_smoothly() {
    let own = cut(&shirt(0.4, 0.5, 0.0, 0.3), 0.02);
    let body = tailor().body();
    // Pulled towards the axes of trunk and arms by a centimetre: most of a tight shirt sinks in.
    let normals = own.mesh.vertex_normals();
    let vertices = own.mesh.vertices.iter().zip(&normals).map(|(p, n)| p - n * 0.01).collect();
    let sunken = TriMesh { vertices, faces: own.mesh.faces.clone() };
    assert!(cuts(&sunken, &body.mesh) > 0);
    let strict = tailor().fit(given("shirt", sunken.clone()), &[], 0.02, &FitOptions::default());
    let text = strict.unwrap_err().to_string();
    assert!(text.contains("% of its vertices are inside") && text.contains("50.0 %"), "{text}");
    let mut options = FitOptions::default();
    options.penetration.share = 1.0;
    let t = tailor().fit(given("shirt", sunken.clone()), &[], 0.02, &options).unwrap();
    let p = t.given.as_ref().unwrap().penetration.clone();
    assert!(p.inside_share[0] > 0.3 && p.inside_share[1] == 0.0 && p.clearance_m > 0.0, "{p:?}");
    assert!(p.deepest_m[0] > 0.003 && p.deepest_m[1] == 0.0);
    assert_eq!(cuts(&t.mesh, &body.mesh), 0);
    assert!(hinges(&t.mesh.faces).1.is_empty());
    options.penetration.deepest_m = 0.001;
    let deep = tailor().fit(given("shirt", sunken), &[], 0.02, &options).unwrap_err().to_string();
    assert!(deep.contains("mm inside the body") && deep.contains("vertex"), "{deep}");
    for (name, change) in [
        ("clearance_m", (|o: &mut FitOptions| o.penetration.clearance_m = -1.0) as fn(&mut FitOptions)),
        ("deepest_m", |o| o.penetration.deepest_m = 0.2),
        ("share", |o| o.penetration.share = f64::NAN),
    ] {
        let mut wrong = FitOptions::default();
        change(&mut wrong);
        let e = tailor().fit(given("shirt", own.mesh.clone()), &[], 0.02, &wrong).unwrap_err();
        assert!(e.to_string().contains(name), "{e}");
    }
}

fn spec(text: &str) -> Box<dyn TemplateSpec> {
    toml::from_str(text).unwrap()
}

/// A folder with two shirts and trousers, as OBJ.
fn wardrobe() -> (Memory, Vec<Style>) {
    let styles = vec![shirt(0.2, 0.3, 0.01, 0.2), shirt(0.9, 0.7, 0.03, 0.5), trousers(0.8, 0.02, 0.5)];
    let mut files = Memory::default();
    for (name, style) in ["short", "long", "trousers"].iter().zip(&styles) {
        let bytes = write_obj(&cut(style, 0.03).mesh, None).unwrap();
        files.0.insert(format!("wardrobe/{name}.obj").into(), bytes);
    }
    files.0.insert("wardrobe/readme.txt".into(), b"no garment".to_vec());
    (files, styles)
}

#[test]
fn a_folder_offers_the_garments_of_a_kind_and_a_scan_chooses() {
    let (files, styles) = wardrobe();
    let source = spec("type = \"folder\"\npath = \"wardrobe\"").build(&files).unwrap();
    let uppers = source.styles(tailor(), GarmentKind::Upper, 300, 1).unwrap();
    let name = |s: &Style| match s {
        Style::Given(g) => g.name.clone(),
        other => panic!("{other:?}"),
    };
    assert_eq!(uppers.iter().map(name).collect::<Vec<_>>(), ["long", "short"]);
    assert_eq!(source.styles(tailor(), GarmentKind::Lower, 300, 1).unwrap().len(), 1);
    let candidates = templates(&*source, tailor(), &uppers, 0.03).unwrap();
    let posed: Vec<Vec<Vec3>> = candidates.iter().map(|t| t.mesh.vertices.clone()).collect();
    let scan = cut(&styles[0], 0.02).mesh.vertices;
    let choice = choose_template(&posed, &scan, &ChooseOptions::default()).unwrap();
    assert_eq!(name(&uppers[choice.index]), "short");
    let seen = Seen { points: &scan, edges: &[], rims: &[], joined: &[], covered_by: &[] };
    // Nothing lies between garments of a folder: refinement gives the choice back, and wears nothing.
    let again = |_: &Template, _: WornAs<'_>| -> Result<Vec<Vec3>> { panic!("worn again") };
    let start = Worn { template: candidates[1].clone(), vertices: posed[1].clone() };
    let refined = refine(&*source, tailor(), start, 0.03, seen, again).unwrap();
    assert_eq!((&refined.style, &refined.worn[0], refined.evaluations), (&uppers[1], &posed[1], 0));
    let vertices = |t: &Template, _: usize, _: WornAs<'_>| Ok(t.mesh.vertices.clone());
    let finished = finish(&*source, tailor(), &refined, [0.03; 2], &[seen], vertices).unwrap();
    assert_eq!((&finished.style, finished.evaluations), (&uppers[1], 1));
    // It keeps its shape, and is put on in all scans: another garment is worn over it.
    let eased = ease(tailor(), finished.clone(), &[seen, seen], vertices).unwrap();
    assert_eq!((&eased.template, eased.worn.len()), (&finished.template, 2));
    assert!(source.template(tailor(), &styles[0], 0.03).is_err());
    // The style goes into artifacts and comes back.
    let text = serde_json::to_string(&refined.style).unwrap();
    assert_eq!(serde_json::from_str::<Style>(&text).unwrap(), refined.style);
    let empty = spec("type = \"folder\"\npath = \"nowhere\"").build(&files).unwrap();
    let text = empty.styles(tailor(), GarmentKind::Upper, 1, 0).unwrap_err().to_string();
    assert!(text.contains("no upper one"), "{text}");
}

#[test]
fn one_mesh_is_its_own_choice() {
    let (files, _) = wardrobe();
    let source = spec("type = \"mesh\"\npath = \"wardrobe/trousers.obj\"").build(&files).unwrap();
    let styles = source.styles(tailor(), GarmentKind::Lower, 300, 1).unwrap();
    assert_eq!(styles.len(), 1);
    let t = source.template(tailor(), &styles[0], 0.03).unwrap();
    assert_eq!(names(&t), ["waist", "cuff_left", "cuff_right"]);
    let text = source.styles(tailor(), GarmentKind::Upper, 300, 1).unwrap_err().to_string();
    assert!(text.contains("no upper garment") && text.contains("lower"), "{text}");
    assert!(spec("type = \"mesh\"\npath = \"wardrobe/none.obj\"").build(&files).is_err());
    let ending = spec("type = \"mesh\"\npath = \"wardrobe/readme.txt\"").build(&files);
    assert!(ending.err().unwrap().to_string().contains("`txt`"));
    let text = toml::from_str::<Box<dyn TemplateSpec>>("type = \"knitting\"").unwrap_err().to_string();
    for name in ["parametric", "folder", "mesh", "linear"] {
        assert!(text.contains(name), "{text}");
    }
    let unknown = toml::from_str::<Box<dyn TemplateSpec>>("type = \"mesh\"\npath = \"a\"\nfit = { unit = 1 }");
    assert!(unknown.unwrap_err().to_string().contains("unit"));
}

/// An array for the archive.
struct Entry<'a>(&'a str, Vec<u64>, Vec<f64>);

fn archive(entries: &[Entry<'_>], faces: Option<(Vec<u64>, Vec<i32>)>) -> Vec<u8> {
    use npyz::WriterBuilder;
    use std::io::Write;
    fn array<T: npyz::AutoSerialize>(shape: &[u64], data: impl IntoIterator<Item = T>) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut writer = npyz::WriteOptions::new().default_dtype().shape(shape).writer(&mut bytes).begin_nd().unwrap();
        writer.extend(data).unwrap();
        writer.finish().unwrap();
        bytes
    }
    let numbers = entries.iter().map(|Entry(name, shape, data)| (*name, array(shape, data.iter().copied())));
    let faces = faces.map(|(shape, data)| ("faces", array(&shape, data)));
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, bytes) in numbers.chain(faces) {
        zip.start_file(format!("{name}.npy"), zip::write::FileOptions::default()).unwrap();
        zip.write_all(&bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[test]
fn a_linear_space_makes_garments_from_coefficients() {
    let own = cut(&shirt(0.4, 0.5, 0.02, 0.3), 0.03).mesh;
    let n = own.vertices.len() as u64;
    let flat = |points: &[Vec3]| points.iter().flat_map(|p| [p.x, p.y, p.z]).collect::<Vec<f64>>();
    let faces: Vec<i32> = own.faces.iter().flatten().map(|&v| v as i32).collect();
    let faces = || Some((vec![own.faces.len() as u64, 3], faces.clone()));
    // Wider, and longer.
    let normals = own.vertex_normals();
    let wider: Vec<Vec3> = normals.iter().map(|m| m * 0.01).collect();
    let longer: Vec<Vec3> = own.vertices.iter().map(|p| Vec3::y() * (0.2 * (p.y - 0.4).min(0.0))).collect();
    let components = || [flat(&wider), flat(&longer)].concat();
    let mean = || Entry("mean", vec![n, 3], flat(&own.vertices));
    let full = archive(
        &[
            mean(),
            Entry("components", vec![2, n, 3], components()),
            Entry("std", vec![2], vec![1.0, 0.5]),
            Entry("mean_betas", vec![3], vec![0.5, 0.0, -1.0]),
        ],
        faces(),
    );
    let mut files = Memory::default();
    files.0.insert("space.npz".into(), full);
    let text = "type = \"linear\"\npath = \"space.npz\"\nspread = 1.0";
    let source = spec(text).build(&files).unwrap();
    let styles = source.styles(tailor(), GarmentKind::Upper, 9, 4).unwrap();
    assert_eq!(styles.len(), 9);
    assert_eq!(styles[..5], source.styles(tailor(), GarmentKind::Upper, 5, 4).unwrap()[..]);
    assert_eq!(styles[0].values(), [0.0, 0.0]);
    assert!(styles.iter().flat_map(Style::values).all(|c| c.abs() <= 1.0));
    let at = |c: Vec<f64>| match &styles[0] {
        Style::Given(s) => Style::Given(caphy_garment::template::GivenStyle { coefficients: c, ..s.clone() }),
        other => panic!("{other:?}"),
    };
    let make = |c: Vec<f64>| source.template(tailor(), &at(c), 0.03).unwrap();
    assert_eq!(make(vec![0.0, 0.0]).mesh.vertices, own.vertices);
    assert_eq!(make(vec![0.0, 0.0]).given.unwrap().made_for_shape, [0.5, 0.0, -1.0]);
    // The standard deviation scales the component.
    let long = make(vec![0.0, 1.0]);
    for ((p, q), d) in own.vertices.iter().zip(&long.mesh.vertices).zip(&longer) {
        assert!((p + d * 0.5 - q).norm() < 1e-12);
    }
    // A scan of a wide, long garment is found by refinement.
    let scanned = make(vec![0.8, 0.7]);
    let scan = scanned.mesh.subdivided().vertices;
    let edges: Vec<Vec3> =
        scanned.loops.iter().flat_map(|l| &l.vertices).map(|&v| scanned.mesh.vertices[v as usize]).collect();
    let vertices = |t: &Template, _: WornAs<'_>| Ok(t.mesh.vertices.clone());
    let seen = Seen { points: &scan, edges: &edges, rims: &[], joined: &[], covered_by: &[] };
    let template = source.template(tailor(), &styles[0], 0.03).unwrap();
    let start = Worn { vertices: template.mesh.vertices.clone(), template };
    let found = refine(&*source, tailor(), start, 0.03, seen, vertices).unwrap();
    let c = found.style.values();
    assert!((c[0] - 0.8).abs() < 0.15 && (c[1] - 0.7).abs() < 0.15, "{c:?}");
    assert!(source.template(tailor(), &at(vec![0.0; 3]), 0.03).is_err());
    assert!(matches!(source.template(tailor(), &at(vec![f64::NAN]), 0.03), Err(Error::NonFinite { .. })));

    let refuse = |bytes: Vec<u8>, keys: &str| {
        let mut files = Memory::default();
        files.0.insert("space.npz".into(), bytes);
        let text = format!("type = \"linear\"\npath = \"space.npz\"\n{keys}");
        spec(&text).build(&files).err().map(|e| e.to_string()).unwrap_or_default()
    };
    let with = |entries: &[Entry<'_>]| archive(entries, faces());
    let good = || Entry("components", vec![2, n, 3], components());
    let text = refuse(with(&[Entry("mean", vec![3 * n], flat(&own.vertices)), good()]), "");
    assert!(text.contains("`mean`") && text.contains("(V, 3)"), "{text}");
    let text = refuse(with(&[mean(), Entry("components", vec![n, 3], flat(&wider))]), "");
    assert!(text.contains("`components`") && text.contains(&format!("(K, {n}, 3)")), "{text}");
    let text = refuse(
        with(&[mean(), Entry("components", vec![2, n - 1, 3], components()[..6 * (n as usize - 1)].to_vec())]),
        "",
    );
    assert!(text.contains("`components`"), "{text}");
    let text = refuse(with(&[mean(), good(), Entry("std", vec![3], vec![1.0; 3])]), "");
    assert!(text.contains("`std`") && text.contains("(2)"), "{text}");
    let mut bad = flat(&own.vertices);
    bad[5] = f64::INFINITY;
    assert!(refuse(with(&[Entry("mean", vec![n, 3], bad), good()]), "").contains("not finite"));
    let text = refuse(archive(&[mean(), good()], Some((vec![1, 3], vec![0, 1, n as i32]))), "");
    assert!(text.contains("`faces`, row 0"), "{text}");
    assert!(refuse(archive(&[mean(), good()], None), "").contains("`faces`"));
    assert!(refuse(archive(&[mean(), good()], Some((vec![1, 4], vec![0, 1, 2, 3]))), "").contains("(F, 3)"));
    assert!(refuse(b"no zip".to_vec(), "").contains("zip"));
    assert!(refuse(with(&[mean(), good()]), "coefficients = 9").contains("at most 8"));
    assert!(refuse(with(&[mean(), good()]), "spread = 0.0").contains("spread"));
}

/// The free garments of the shared data on the body that they were made for.
fn shared_garments() -> Option<(BodyRest, Vec<GivenMesh>)> {
    let body = body::anny_mid()?;
    let folder = body::shared().join("data/garments");
    let Ok(paths) = caphy_core::files::Disk.list(&folder, &["obj"]) else {
        println!("SKIPPED: {} is not there (set CAPHY_SHARED)", folder.display());
        return None;
    };
    let read = |p: &PathBuf| read_garment(p, &std::fs::read(p).unwrap()).unwrap();
    Some((body, paths.iter().map(read).collect()))
}

#[test]
fn free_garments_come_out_of_the_body() {
    let Some((body, garments)) = shared_garments() else { return };
    assert_eq!(garments.len(), 6);
    let tailor = Tailor::new(body.clone()).unwrap();
    for given in garments {
        let upper = given.name.ends_with("_upper");
        let before = cuts(&given.mesh, &body.mesh);
        for split in [false, true] {
            let options = FitOptions { split, ..FitOptions::default() };
            let t = tailor.fit(given.clone(), &[], 0.02, &options).unwrap();
            let facts = t.given.clone().unwrap();
            let p = &facts.penetration;
            assert!(before > 0 && p.inside_share[0] > 0.0, "{}", given.name);
            let list = names(&t);
            if upper {
                assert_eq!(t.kind, GarmentKind::Upper);
                assert_eq!(list, ["neck", "hem", "cuff_left", "cuff_right"], "{}", given.name);
            } else {
                assert_eq!(t.kind, GarmentKind::Lower);
                assert_eq!(list, ["waist", "cuff_left", "cuff_right"], "{}", given.name);
            }
            assert_eq!(cuts(&t.mesh, &body.mesh), 0, "{} split {split}", given.name);
            assert!(p.inside_share[1] == 0.0 && p.clearance_m > 0.0, "{}: {p:?}", given.name);
            // What the documentation of the options states, and a little for other compilers.
            assert!(
                (p.area_ratio - 1.0).abs() < 0.015 && p.edge_ratio[1] > 0.95 && p.edge_ratio[2] < 1.06,
                "{}: {p:?}",
                given.name
            );
            assert_eq!(facts.repairs, Default::default(), "{}", given.name);
            assert!(facts.splits <= usize::from(split), "{}", given.name);
            assert!(hinges(&t.mesh.faces).1.is_empty());
            let far = NearestGrid::from_points(&given.mesh.vertices);
            let moved = t.mesh.vertices.iter().map(|q| far.nearest_point(q).unwrap().1.sqrt()).fold(0.0, f64::max);
            assert!(moved < 0.05, "{}: a vertex is {moved} m from all of the given", given.name);
        }
    }
}
