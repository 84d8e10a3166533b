//! Choosing a template by Chamfer distance, posing it, and refining its style.

use super::{body, shirt, trousers};
use caphy_core::{Error, Vec3};
use caphy_garment::template::{
    ChooseOptions, GarmentKind, Seen, Tailor, Template, TemplateParametric, Worn, WornAs, choose_template, ease,
    finish, hung_like, pose_by_nearest_vertex, pose_by_weights, refine, sample_styles,
};
use nalgebra::{Matrix3x4, Rotation3};

fn vertices(t: &Template) -> Vec<Vec3> {
    t.mesh.vertices.clone()
}

#[test]
fn the_garment_itself_is_found_among_samples() {
    let tailor = Tailor::new(body::capsules()).unwrap();
    let styles = sample_styles(GarmentKind::Upper, 12, 5);
    let candidates: Vec<Vec<Vec3>> = tailor.generate_all(&styles, 0.03).unwrap().iter().map(vertices).collect();
    // The scan is the same garment at another resolution.
    let scan = vertices(&tailor.generate(&styles[7], 0.02).unwrap());
    let choice = choose_template(&candidates, &scan, &ChooseOptions::default()).unwrap();
    assert_eq!(choice.index, 7);
    assert_eq!(choice.report.len(), 12);
    let best = choice.report[7];
    // Nearest vertices of a 3 cm mesh are within its edge length; all others differ by more.
    assert!(best.scan_to_garment < 0.02 && best.garment_to_scan < 0.02 && best.counted == 1.0, "{best:?}");
    assert!(choice.report.iter().enumerate().all(|(i, r)| i == 7 || r.squared > 1.2 * best.squared));
}

#[test]
fn what_the_other_garment_hides_does_not_count() {
    let tailor = Tailor::new(body::capsules()).unwrap();
    let styles = [0.0, 0.5, 1.0].map(|rise| trousers(0.8, 0.02, rise));
    let candidates: Vec<Vec<Vec3>> = styles.iter().map(|s| vertices(&tailor.generate(s, 0.03).unwrap())).collect();
    // Trousers of full rise, seen only below the shirt's hem.
    let over = vertices(&tailor.generate(&shirt(0.3, 0.6, 0.03, 0.2), 0.02).unwrap());
    let hem = over.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
    let seen: Vec<Vec3> =
        vertices(&tailor.generate(&styles[2], 0.02).unwrap()).into_iter().filter(|p| p.y < hem).collect();
    let plain = choose_template(&candidates, &seen, &ChooseOptions::default()).unwrap();
    let covered = choose_template(&candidates, &seen, &ChooseOptions { covered_by: &over }).unwrap();
    // Without the option the hidden waist counts against the high rise.
    assert_eq!(plain.index, 0);
    assert!(plain.report[2].squared > 2.0 * plain.report[0].squared);
    assert!(covered.report[2].counted < 0.95);
    assert!(covered.report[2].squared < 0.5 * plain.report[2].squared);
}

#[test]
fn refinement_comes_nearer_to_the_style() {
    let tailor = Tailor::new(body::capsules()).unwrap();
    let truth = shirt(0.42, 0.55, 0.012, 0.3);
    let scanned = tailor.generate(&truth, 0.02).unwrap();
    let scan = vertices(&scanned);
    let edges: Vec<Vec3> = scanned.loops.iter().flat_map(|l| &l.vertices).map(|&v| scan[v as usize]).collect();
    let start = shirt(0.55, 0.45, 0.02, 0.4);
    let worn = || {
        let template = tailor.generate(&start, 0.03).unwrap();
        Worn { vertices: vertices(&template), template }
    };
    let seen = Seen { points: &scan, edges: &edges, rims: &[], joined: &[], covered_by: &[] };
    let found = refine(&TemplateParametric {}, &tailor, worn(), 0.03, seen, |t, _| Ok(vertices(t))).unwrap();
    assert_eq!(found.template.style, found.style);
    assert_eq!(found.worn, [vertices(&found.template)]);
    let off = |s: &caphy_garment::template::Style| {
        let (a, b) = (s.to_unit(), truth.to_unit());
        (a[0] - b[0]).abs().max((a[1] - b[1]).abs())
    };
    // Where nothing but the triangles differs, edges show lengths to a tenth of a triangle: 3 mm of ranges of 0.45 and 0.4 m.
    assert!(off(&found.style) < 0.01 && off(&start) > 0.09, "{:?}", found.style);
    // Polygons of 3 and 2 cm edges around a neck differ by less than a quarter of an edge.
    assert!(found.edges_off_m < 0.03 / 4.0, "{}", found.edges_off_m);
    let error = found.template.measures().against(&scanned.measures());
    assert!(error.largest_m() < 0.01 && error.area.abs() < 0.01, "{error:?}");
    // A sleeve that nobody sees the end of stays in the middle of what there is.
    let trunk: Vec<Vec3> = scan.iter().filter(|p| p.x.abs() < 0.15).copied().collect();
    let hem: Vec<Vec3> = edges.iter().filter(|p| p.x.abs() < 0.15).copied().collect();
    let seen = Seen { points: &trunk, edges: &hem, rims: &[], joined: &[], covered_by: &[] };
    let found = refine(&TemplateParametric {}, &tailor, worn(), 0.03, seen, |t, _| Ok(vertices(t))).unwrap();
    assert_eq!(found.style.to_unit()[0], 0.5);
    assert!((found.style.to_unit()[1] - truth.to_unit()[1]).abs() < 0.01, "{:?}", found.style);
}

#[test]
fn a_waist_under_a_shirt_is_not_guessed_from_folds() {
    let tailor = Tailor::new(body::capsules()).unwrap();
    let over = vertices(&tailor.generate(&shirt(0.3, 0.6, 0.03, 0.2), 0.02).unwrap());
    let hem = over.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
    let scanned = tailor.generate(&trousers(0.7, 0.02, 0.9), 0.02).unwrap();
    let scan: Vec<Vec3> = vertices(&scanned).into_iter().filter(|p| p.y < hem).collect();
    let ends = scanned.loops.iter().flat_map(|l| &l.vertices).map(|&v| scanned.mesh.vertices[v as usize]);
    let edges: Vec<Vec3> = ends.filter(|p| p.y < hem).collect();
    // Legs fold in another way with every rise, as simulated ones do.
    let wear = |t: &Template| {
        let rise = t.style.values()[2];
        Ok(t.mesh.vertices.iter().map(|p| p + Vec3::x() * (0.012 * (40.0 * p.y + 15.0 * rise).sin())).collect())
    };
    let rise = |covered_by: &[Vec3]| {
        let template = tailor.generate(&trousers(0.6, 0.015, 0.3), 0.03).unwrap();
        let start = Worn { vertices: wear(&template).unwrap(), template };
        let seen = Seen { points: &scan, edges: &edges, rims: &[], joined: &[], covered_by };
        refine(&TemplateParametric {}, &tailor, start, 0.03, seen, |t, _| wear(t)).unwrap().style.to_unit()[2]
    };
    assert_eq!(rise(&over), 0.5);
    assert_ne!(rise(&[]), 0.5, "the folds answer");
}

#[test]
fn coarse_cloth_that_stands_off_does_not_make_the_fine_template_narrower() {
    let tailor = Tailor::new(body::capsules()).unwrap();
    let truth = shirt(0.42, 0.55, 0.02, 0.3);
    let scanned = tailor.generate(&truth, 0.02).unwrap();
    let scan = vertices(&scanned);
    let edges: Vec<Vec3> = scanned.loops.iter().flat_map(|l| &l.vertices).map(|&v| scan[v as usize]).collect();
    let seen = Seen { points: &scan, edges: &edges, rims: &[], joined: &[], covered_by: &[] };
    // Coarse cloth stands off by 4 mm, as it does where it cannot fold.
    let wear = |t: &Template| {
        let off = if t.mesh.mean_edge_length() > 0.03 { 0.004 } else { 0.0 };
        Ok(t.mesh.vertices.iter().zip(t.mesh.vertex_normals()).map(|(p, n)| p + n * off).collect())
    };
    let template = tailor.generate(&shirt(0.5, 0.5, 0.02, 0.4), 0.035).unwrap();
    let start = Worn { vertices: wear(&template).unwrap(), template };
    let coarse = refine(&TemplateParametric {}, &tailor, start, 0.035, seen, |t, _| wear(t)).unwrap();
    let fine = finish(&TemplateParametric {}, &tailor, &coarse, [0.035, 0.02], &[seen; 2], |t, _, _| wear(t)).unwrap();
    let [wide, before, after] = [&truth, &coarse.style, &fine.style].map(|s| s.values()[2]);
    assert!(wide - before > 0.002, "{before}");
    // A tenth of a fine triangle, as in `refinement_comes_nearer_to_the_style`; where shirts touch the skin, ease does not show.
    assert!((after - wide).abs() < 0.002, "{before} {after}");
    let error = fine.template.measures().against(&scanned.measures());
    assert!(error.largest_m() < 0.01 && error.area.abs() < 0.01, "{error:?}");
    assert!(fine.worn.len() == 2 && fine.worn.iter().all(|w| w.len() == fine.template.mesh.vertices.len()));
}

#[test]
fn a_shirt_that_is_wider_in_places_is_cut_wider_there() {
    let tailor = Tailor::new(body::capsules()).unwrap();
    let style = shirt(0.42, 0.55, 0.02, 0.3);
    let start = tailor.generate(&style, 0.022).unwrap();
    // Front and back of the scan's trunk lie 6 mm farther out, with folds of 4 mm; its sleeves are not.
    let scanned = tailor.generate(&style, 0.02).unwrap();
    let wider = |p: &Vec3| if p.x.abs() < 0.16 { 0.006 } else { 0.0 };
    let out = |mesh: &caphy_core::TriMesh, by: &dyn Fn(&Vec3) -> f64| -> Vec<Vec3> {
        mesh.vertices.iter().zip(mesh.vertex_normals()).map(|(p, n)| p + n * by(p)).collect()
    };
    let truth = Template {
        mesh: caphy_core::TriMesh { vertices: out(&scanned.mesh, &wider), faces: scanned.mesh.faces.clone() },
        ..scanned.clone()
    };
    let folded = |p: &Vec3| wider(p) + 0.004 * (90.0 * p.x).sin();
    let scan = out(&scanned.mesh, &folded);
    let seen = Seen { points: &scan, edges: &[], rims: &[], joined: &[], covered_by: &[] };
    let wear = |t: &Template, _: usize, _: WornAs<'_>| Ok(vertices(t));
    let worn = Worn { vertices: vertices(&start), template: start.clone() };
    let mut as_cut = refine(&TemplateParametric {}, &tailor, worn, 0.022, seen, |t, like| wear(t, 0, like)).unwrap();
    (as_cut.template, as_cut.worn) = (start.clone(), vec![vertices(&start)]);
    let eased = ease(&tailor, as_cut, &[seen], wear).unwrap();
    let errors = |t: &Template| t.measures().against(&truth.measures());
    let girth =
        |t: &Template, name: &str| errors(t).lengths_m.iter().find(|(n, _)| n == name).map_or(f64::NAN, |(_, d)| *d);
    // Front and back of the hem lie 6 mm farther out; what is beside them does not.
    let [before, after] = [&start, &eased.template].map(|t| girth(t, "hem").abs());
    assert!(before > 0.01 && after < 0.005, "{before} {after}");
    assert!(girth(&eased.template, "cuff_left").abs() < 0.01 && girth(&eased.template, "cuff_right").abs() < 0.01);
    let [before, after] = [&start, &eased.template].map(|t| errors(t).area.abs());
    assert!(before > 0.01 && after < 0.005, "{before} {after}");
    // Folds of 4 mm, 2.8 mm root mean square, are not in it by half.
    let surface = caphy_core::query::NearestSurface::from_mesh(&truth.mesh).unwrap();
    let off: Vec<f64> =
        eased.template.mesh.vertices.iter().filter_map(|p| surface.nearest(p)).map(|n| n.squared_distance).collect();
    let square = off.iter().sum::<f64>() / off.len() as f64;
    assert!(square.sqrt() < 0.0014, "{}", square.sqrt());
}

#[test]
fn a_shirt_that_ends_elsewhere_is_cut_there() {
    let tailor = Tailor::new(body::capsules()).unwrap();
    let start = tailor.generate(&shirt(0.42, 0.55, 0.02, 0.3), 0.022).unwrap();
    // The hem lies 12 mm lower, the cuffs elsewhere by as much.
    let scanned = tailor.generate(&shirt(0.4467, 0.58, 0.02, 0.3), 0.02).unwrap();
    let scan = vertices(&scanned);
    // As close to each other as those of a scan with triangles of 7 mm.
    let between = |ring: &[u32]| -> Vec<Vec3> {
        let ends = ring.iter().zip(ring.iter().cycle().skip(1)).map(|(&a, &b)| [a, b].map(|v| scan[v as usize]));
        ends.flat_map(|[a, b]| [0.0, 1.0 / 3.0, 2.0 / 3.0].map(|t| a.lerp(&b, t))).collect()
    };
    let mut edges: Vec<Vec3> = scanned.loops.iter().flat_map(|l| between(&l.vertices)).collect();
    // What lies far from any edge is no edge: wrong labels in the middle of the trunk.
    let hem = scan.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
    edges.extend(scan.iter().filter(|p| (p.y - hem - 0.08).abs() < 0.02 && p.z > 0.0));
    let seen = Seen { points: &scan, edges: &edges, rims: &[], joined: &[], covered_by: &[] };
    let wear = |t: &Template, _: usize, _: WornAs<'_>| Ok(vertices(t));
    let worn = Worn { vertices: vertices(&start), template: start.clone() };
    let mut as_cut = refine(&TemplateParametric {}, &tailor, worn, 0.022, seen, |t, like| wear(t, 0, like)).unwrap();
    (as_cut.template, as_cut.worn) = (start.clone(), vec![vertices(&start)]);
    // A scan more than it was put on in.
    let eased = ease(&tailor, as_cut, &[seen, seen], wear).unwrap();
    assert_eq!(eased.worn.len(), 2);
    let off = |t: &Template| t.measures().against(&scanned.measures());
    let [before, after] = [&start, &eased.template].map(off);
    // Between polygons of 2 cm an edge is known to a tenth of that; lengths are between two edges.
    assert!(before.largest_m() > 0.02 && after.largest_m() < 0.005, "{before:?} {after:?}");
    assert!(before.area.abs() > 0.02 && after.area.abs() < 0.005, "{before:?} {after:?}");
    let [cut, moved] = [&start, &eased.template].map(|t| t.mesh.face_areas().into_iter().fold(f64::INFINITY, f64::min));
    assert!(moved > 0.5 * cut, "{cut} {moved}");
}

#[test]
fn posing_moves_vertices_with_the_body() {
    let body = body::capsules();
    let tailor = Tailor::new(body.clone()).unwrap();
    let t = tailor.generate(&shirt(0.3, 0.4, 0.01, 0.2), 0.03).unwrap();
    let turn = Rotation3::from_scaled_axis(Vec3::new(0.1, 0.7, -0.2));
    let shift = Vec3::new(0.3, -0.1, 2.0);
    let mut rigid = Matrix3x4::zeros();
    rigid.fixed_view_mut::<3, 3>(0, 0).copy_from(turn.matrix());
    rigid.set_column(3, &shift);
    let posed = pose_by_nearest_vertex(&t, &body.weights, &[rigid; 55]).unwrap();
    for (p, q) in t.mesh.vertices.iter().zip(&posed) {
        assert!((turn * p + shift - q).norm() < 1e-12);
    }
    let rows =
        t.weights_body_vertex.iter().map(|&v| body.weights.row(v as usize).map(|(j, w)| (j as u16, w)).collect());
    let own = caphy_core::body::BlendWeights::from_rows(rows);
    assert_eq!(pose_by_weights(&t.mesh.vertices, &own, &[rigid; 55]).unwrap(), posed);
    assert!(pose_by_nearest_vertex(&t, &body.weights, &[rigid; 3]).is_err());
    assert!(pose_by_weights(&t.mesh.vertices[1..], &own, &[rigid; 55]).is_err());
}

#[test]
fn a_garment_hangs_like_another_one() {
    let body = body::capsules();
    let tailor = Tailor::new(body.clone()).unwrap();
    let short = tailor.generate(&shirt(0.3, 0.4, 0.01, 0.2), 0.03).unwrap();
    let long = tailor.generate(&shirt(0.5, 0.4, 0.01, 0.2), 0.03).unwrap();
    let turn = Rotation3::from_scaled_axis(Vec3::new(0.1, 0.7, -0.2));
    let mut rigid = Matrix3x4::zeros();
    rigid.fixed_view_mut::<3, 3>(0, 0).copy_from(turn.matrix());
    // Turned with the body, and 3 cm lower than skinning has it.
    let drop = Vec3::new(0.0, -0.03, 0.0);
    let worn: Vec<Vec3> = short.mesh.vertices.iter().map(|p| turn * p + drop).collect();
    let like = WornAs { template: &short, vertices: &worn, scan: 0 };
    for template in [&short, &long] {
        let hung = hung_like(template, like, &body.weights, &[rigid; 55]).unwrap();
        // Sleeves that are longer go on as the arm turns.
        assert!(template.mesh.vertices.iter().zip(&hung).all(|(p, q)| (turn * p + drop - q).norm() < 1e-9));
    }
    let few = WornAs { template: &short, vertices: &worn[1..], scan: 0 };
    assert!(matches!(hung_like(&long, few, &body.weights, &[rigid; 55]), Err(Error::Length { .. })));
    assert!(hung_like(&long, like, &body.weights, &[rigid; 3]).is_err());
}

#[test]
fn a_choice_without_points_or_candidates_is_refused() {
    let options = ChooseOptions::default();
    let points = vec![Vec3::zeros()];
    assert!(choose_template(&[], &points, &options).unwrap_err().to_string().contains("no candidates"));
    let text = choose_template(std::slice::from_ref(&points), &[], &options).unwrap_err().to_string();
    assert!(text.contains("segmentation"), "{text}");
    let nan = vec![Vec3::repeat(f64::NAN)];
    assert!(matches!(choose_template(std::slice::from_ref(&nan), &points, &options), Err(Error::NonFinite { .. })));
    assert!(matches!(choose_template(std::slice::from_ref(&points), &nan, &options), Err(Error::NonFinite { .. })));
    let empty = choose_template(&[Vec::new(), points.clone()], &points, &options).unwrap();
    assert_eq!(empty.index, 1);
    assert!(empty.report[0].squared.is_infinite());
}
