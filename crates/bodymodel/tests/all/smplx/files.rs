//! Files of the family load whatever their widths and counts; damaged ones are refused by array and element.

use crate::smplx::generated::{Layout, ModelFile, Npy, frames};
use crate::smplx::oracle;
use caphy_bodymodel::smplx::{BodySmplx, PICKED_VERTICES, SmplxOptions, load};
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::lanes::Frames;
use caphy_core::pose::SMPLX_PARENTS;
use caphy_core::{Error, Result, Vec3};
use std::path::Path;

const VERTICES: usize = 600; // more than one chunk

fn small() -> Layout {
    Layout { columns: 20, ..Layout::smplx(VERTICES) }
}

fn read(file: &ModelFile, options: &SmplxOptions) -> Result<BodySmplx> {
    load(Path::new("generated.npz"), file.stored(), options)
}

fn read_plainly(file: &ModelFile) -> Result<BodySmplx> {
    read(file, &SmplxOptions::default())
}

/// Two frames with everything in them.
fn busy_frames(body: &BodySmplx) -> Vec<BodyParameters> {
    let d = body.describe();
    let mut frames = frames(d.joints.len(), 2);
    for (i, p) in frames.iter_mut().enumerate() {
        p.shape.truncate(d.shape_count);
        p.expression = (0..d.expression_count).map(|k| 0.2 * k as f64 - 0.5 * i as f64).collect();
        p.displacement = (0..d.vertex_count).map(|v| Vec3::new(0.0, 0.01, -0.02) * (v % 3) as f64).collect();
    }
    frames
}

fn largest_distance(a: &[Vec3], b: &[Vec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

/// The body of a file against the oracle, in f64 and in lanes.
fn check(name: &str, file: &ModelFile, shape_columns: usize, body: &BodySmplx) {
    for p in busy_frames(body) {
        let (vertices, joints) = oracle::pose(file, shape_columns, &p);
        let posed = body.forward(&p).unwrap();
        // Correctives are kept in single precision: 486 entries of at most 0.002 m, each rounded by 2⁻²⁵ of its size and
        // times at most 2, could add up to 6e-8 m. Weights stored in single precision are off 1 by as much.
        let off = largest_distance(&posed.vertices, &vertices);
        assert!(off < 2e-7, "{name}: vertices off by {off:e} m");
        let off = largest_distance(&posed.joints, &joints);
        assert!(off < 1e-12, "{name}: joints off by {off:e} m");
        let mut out = Frames::<f32>::zeros(1, vertices.len(), 1);
        body.forward_frames(&[p], None, &mut out).unwrap();
        let off = largest_distance(&out.frame(0, 0), &vertices);
        assert!(off < 1e-5, "{name}: vertices in lanes off by {off:e} m");
    }
}

#[test]
fn every_width_and_count_of_the_family_loads() {
    let smplh: Vec<i64> = (0..55)
        .filter(|j| !(22..25).contains(j))
        .map(|j| SMPLX_PARENTS[j])
        .map(|p| {
            if p == usize::MAX {
                -1
            } else if p >= 25 {
                p as i64 - 3
            } else {
                p as i64
            }
        })
        .collect();
    let smpl: Vec<i64> = smplh[..22].iter().copied().chain([20, 21]).collect();
    let base = small;
    let variants = [
        ("v1.0", base(), (10, 10), 10),
        ("v1.0, f64, int64", Layout { float: Npy::f8, integer: Npy::i8, ..base() }, (10, 10), 10),
        ("int32", Layout { integer: Npy::i4, ..base() }, (10, 10), 10),
        ("uint64", Layout { integer: Npy::u8, ..base() }, (10, 10), 10),
        ("uint16", Layout { integer: Npy::u2, ..base() }, (10, 10), 10),
        ("v1.1", Layout { columns: 400, ..base() }, (10, 10), 300),
        ("more columns than v1.1", Layout { columns: 410, ..base() }, (10, 10), 300),
        ("shape alone", Layout { columns: 10, ..base() }, (10, 0), 10),
        ("few columns", Layout { columns: 6, ..base() }, (6, 0), 6),
        ("some expression", Layout { columns: 13, ..base() }, (10, 3), 10),
        ("no correctives", Layout { correctives: false, ..base() }, (10, 10), 10),
        ("SMPL-H tree", Layout { parents: smplh, ..base() }, (10, 10), 10),
        ("SMPL tree", Layout { parents: smpl, ..base() }, (10, 10), 10),
        ("a tree of its own", Layout { parents: vec![-1, 0, 0, 2, 1, 4, 0], ..base() }, (10, 10), 10),
        ("one joint", Layout { parents: vec![-1], ..base() }, (10, 10), 10),
    ];
    for (name, layout, counts, shape_columns) in variants {
        let file = layout.file();
        let body = read_plainly(&file).unwrap_or_else(|e| panic!("{name}: {e}"));
        let d = body.describe();
        assert_eq!((d.shape_count, d.expression_count), counts, "{name}");
        assert_eq!(d.joints.len(), layout.parents.len(), "{name}");
        assert_eq!(body.has_pose_correctives(), layout.correctives && layout.parents.len() > 1, "{name}");
        check(name, &file, shape_columns, &body);
    }
}

#[test]
fn any_number_of_coefficients_can_be_kept() {
    let file = Layout { columns: 400, ..small() }.file();
    let options = |shape, expression, columns| SmplxOptions {
        shape_coefficients: shape,
        expression_coefficients: expression,
        shape_columns: columns,
        ..SmplxOptions::default()
    };
    for (given, shape_columns, counts) in [
        (options(Some(300), Some(100), None), 300, (300, 100)),
        (options(Some(0), Some(37), None), 300, (0, 37)),
        (options(None, Some(3), Some(396)), 396, (10, 3)),
        (options(Some(400), None, Some(400)), 400, (400, 0)),
    ] {
        let body = read(&file, &given).unwrap();
        assert_eq!((body.describe().shape_count, body.describe().expression_count), counts);
        check(&format!("{given:?}"), &file, shape_columns, &body);
    }
    for (given, key) in [
        (options(Some(301), None, None), "shape_coefficients"),
        (options(None, Some(101), None), "expression_coefficients"),
        (options(None, None, Some(401)), "shape_columns"),
    ] {
        let error = read(&file, &given).unwrap_err();
        assert!(matches!(&error, Error::Config { key: k, .. } if k.ends_with(key)), "{error}");
    }
}

/// Any vertices, in any order, in any number of blocks: the same bits as when all are posed.
#[test]
fn a_subset_has_the_bits_of_the_whole() {
    for correctives in [true, false] {
        let body = read_plainly(&Layout { correctives, ..small() }.file()).unwrap();
        let ids: Vec<u32> = (0..VERTICES as u32).rev().filter(|v| v % 7 < 3).chain([5, 5]).collect();
        for (blocks, lanes) in [(1, 1), (1, 16), (2, 3), (3, 16), (4, 2), (5, 16), (6, 1), (11, 1)] {
            for shared in [true, false] {
                let mut frames = frames(55, blocks * lanes);
                if !shared {
                    frames.iter_mut().enumerate().for_each(|(i, p)| p.shape[0] += i as f64 * 0.1);
                }
                let mut all = Frames::<f32>::zeros(blocks, VERTICES, lanes);
                let mut some = Frames::<f32>::zeros(blocks, ids.len(), lanes);
                body.forward_frames(&frames, None, &mut all).unwrap();
                body.forward_frames(&frames, Some(&ids), &mut some).unwrap();
                for frame in 0..blocks * lanes {
                    let (all, some) =
                        (all.frame(frame / lanes, frame % lanes), some.frame(frame / lanes, frame % lanes));
                    let picked: Vec<Vec3> = ids.iter().map(|id| all[*id as usize]).collect();
                    assert_eq!(picked, some, "{blocks} blocks of {lanes}, frame {frame}, shared {shared}");
                    let posed = body.forward(&frames[frame]).unwrap();
                    assert!(largest_distance(&all, &posed.vertices) < 1e-5);
                }
            }
        }
        let mut out = Frames::<f32>::zeros(1, 1, 1);
        let error = body.forward_frames(&frames(55, 1), Some(&[VERTICES as u32]), &mut out).unwrap_err();
        assert!(error.to_string().contains("vertex 600"), "{error}");
    }
}

/// Displacements elsewhere are no business of a subset; those asked for are checked.
#[test]
fn a_subset_looks_at_its_own_displacements_alone() {
    let body = read_plainly(&small().file()).unwrap();
    let mut p = frames(55, 1).remove(0);
    p.displacement = vec![Vec3::zeros(); VERTICES];
    p.displacement[7].y = f64::NAN;
    let mut out = Frames::<f32>::zeros(1, 2, 1);
    body.forward_frames(std::slice::from_ref(&p), Some(&[3, 8]), &mut out).unwrap();
    let error = body.forward_frames(&[p], Some(&[3, 7]), &mut out).unwrap_err();
    assert!(matches!(error, Error::NonFinite { .. }) && error.to_string().contains("vertex 7"), "{error}");
}

/// The error's text after `change`, which must name all of `parts`.
fn refused(change: impl Fn(&mut ModelFile), parts: &[&str]) {
    let mut file = small().file();
    change(&mut file);
    let error = read(&file, &SmplxOptions::default()).map(|_| ()).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, Error::Format { .. } | Error::NonFinite { .. } | Error::Mesh { .. }), "{error:?}");
    for part in parts.iter().chain(&["generated.npz"]) {
        assert!(text.contains(part), "`{part}` is not in: {text}");
    }
}

#[test]
fn missing_arrays_are_named() {
    for name in ["v_template", "f", "shapedirs", "J_regressor", "weights", "kintree_table", "lmk_bary_coords"] {
        refused(|f| drop(f.arrays.remove(name)), &[&format!("`{name}`"), "missing"]);
    }
}

#[test]
fn wrong_shapes_are_named() {
    for (name, shape) in [
        ("v_template", vec![VERTICES * 3]),
        ("v_template", vec![VERTICES * 3 / 4, 4]),
        ("shapedirs", vec![3, VERTICES, 20]),
        ("posedirs", vec![VERTICES, 486, 3]),
        ("weights", vec![55, VERTICES]),
        ("J_regressor", vec![VERTICES, 55]),
        ("kintree_table", vec![55, 2]),
        ("f", vec![597 * 3, 2]),
        ("lmk_faces_idx", vec![3, 17]),
        ("hands_componentsl", vec![25, 81]),
    ] {
        refused(|f| f.array(name).shape = shape.clone(), &[&format!("`{name}`"), "shape"]);
    }
    // One joint less than the tree has.
    for (name, shape) in
        [("weights", vec![VERTICES, 54]), ("J_regressor", vec![54, VERTICES]), ("posedirs", vec![VERTICES, 3, 477])]
    {
        refused(
            |f| {
                let npy = f.array(name);
                npy.data.truncate(4 * shape.iter().product::<usize>());
                npy.shape.clone_from(&shape);
            },
            &[&format!("`{name}`"), "shape"],
        );
    }
    refused(|f| *f.array("v_template") = Npy::f4(&[0, 3], &[]), &["`v_template`"]);
    refused(|f| *f.array("kintree_table") = Npy::f8(&[2, 55], &[0.0; 110]), &["`kintree_table`", "integers"]);
}

/// Puts `value` into element `index` of an f4 array.
fn put(file: &mut ModelFile, name: &str, index: usize, value: f32) {
    file.array(name).data[4 * index..4 * index + 4].copy_from_slice(&value.to_le_bytes());
}

#[test]
fn values_that_are_not_finite_are_named_with_their_place() {
    for name in [
        "v_template",
        "shapedirs",
        "posedirs",
        "J_regressor",
        "weights",
        "hands_meanr",
        "hands_componentsl",
        "lmk_bary_coords",
    ] {
        for bad in [f32::NAN, f32::INFINITY] {
            refused(|f| put(f, name, 17, bad), &[&format!("`{name}`"), "index 17"]);
        }
    }
}

#[test]
fn sums_of_weights_are_held_to_one() {
    // Vertex 3 belongs to joint 0 alone, whose regressor row is the mean of its vertices.
    refused(|f| put(f, "weights", 3 * 55, 1.5), &["`weights`", "row 3 ", "1.5"]);
    refused(|f| put(f, "weights", 3 * 55, 0.0), &["`weights`", "row 3 ", "sums to 0"]);
    refused(|f| put(f, "weights", 3 * 55 + 9, -0.2), &["`weights`", "row 3 ", "column 9 ", "-0.2"]);
    refused(|f| put(f, "J_regressor", 599, 0.5), &["`J_regressor`", "row 0 "]);
    let mut file = small().file();
    put(&mut file, "weights", 3 * 55 + 9, -1e-7);
    assert_eq!(read_plainly(&file).unwrap().describe().weights.row(3).count(), 1, "rounding is no weight");
    // What half precision leaves is divided out: a translation still moves every vertex alike.
    let mut file = small().file();
    put(&mut file, "weights", 3 * 55, 0.9996);
    let body = read_plainly(&file).unwrap();
    let sum: f64 = body.describe().weights.row(3).map(|(_, w)| w).sum();
    assert!((sum - 1.0).abs() < 1e-15, "{sum}");
}

#[test]
fn joint_trees_are_checked() {
    let change = |at: usize, parent: i64| {
        move |f: &mut ModelFile| {
            let mut table: Vec<i64> = Layout::smplx(1).parents.into_iter().chain(0..55).collect();
            table[at] = parent;
            *f.array("kintree_table") = Npy::i8(&[2, 55], &table);
        }
    };
    // A child before its parent, itself, a parent that does not exist, a second root, a cycle through the root.
    for (j, parent) in [(5, 7), (5, 5), (5, 99), (5, -1), (0, 3)] {
        refused(change(j, parent), &["`kintree_table`", &format!("joint {j} ")]);
    }
    refused(change(55 + 4, 9), &["`kintree_table`", "joint 4 9"]);
    // Any number that is no other joint marks the root.
    for root in [-1, 0, 55, 4_294_967_295, i64::MAX] {
        let mut file = small().file();
        change(0, root)(&mut file);
        assert!(read_plainly(&file).is_ok(), "{root}");
    }
}

#[test]
fn faces_and_landmarks_must_exist() {
    refused(
        |f| f.array("f").data[4 * 8..4 * 9].copy_from_slice(&600u32.to_le_bytes()),
        &["`f`", "face 2", "vertex 600"],
    );
    refused(
        |f| f.array("lmk_faces_idx").data[8..16].copy_from_slice(&(-1i64).to_le_bytes()),
        &["`lmk_faces_idx`", "element 1", "-1"],
    );
    refused(|f| put(f, "lmk_bary_coords", 6, 5.0), &["`lmk_bary_coords`", "row 2"]);
    // Placeholders of zeros are left out.
    let mut file = small().file();
    file.array("lmk_bary_coords").data.fill(0);
    assert!(read_plainly(&file).unwrap().landmark_names().is_empty());
}

#[test]
fn options_that_the_file_cannot_meet_are_refused() {
    let refuse = |change: &dyn Fn(&mut ModelFile, &mut SmplxOptions), parts: &[&str]| {
        let (mut file, mut options) = (small().file(), SmplxOptions::default());
        change(&mut file, &mut options);
        let text = read(&file, &options).map(|_| ()).unwrap_err().to_string();
        parts.iter().for_each(|part| assert!(text.contains(part), "`{part}` is not in: {text}"));
    };
    refuse(
        &|f, o| {
            o.hand_mean = true;
            f.arrays.remove("hands_meanl");
        },
        &["body.hand_mean", "hands_meanl"],
    );
    refuse(
        &|f, o| {
            o.face_contour = true;
            f.arrays.remove("dynamic_lmk_faces_idx");
        },
        &["`dynamic_lmk_faces_idx`", "missing"],
    );
    refuse(
        &|f, o| {
            o.face_contour = true;
            f.array("dynamic_lmk_faces_idx").shape = vec![17, 79];
        },
        &["`dynamic_lmk_faces_idx`", "shape"],
    );
    refuse(
        &|f, o| {
            o.face_contour = true;
            *f.array("kintree_table") = {
                let mut layout = Layout::smplx(1).parents;
                layout[12] = 6;
                Npy::i8(&[2, 55], &layout.into_iter().chain(0..55).collect::<Vec<_>>())
            };
        },
        &["contour_1", "neck"],
    );
    refuse(&|_, o| o.extra_joints = [("knows".into(), 3)].into(), &["body.extra_joints", "knows", "nose, right_eye"]);
    refuse(&|_, o| o.extra_joints = [("nose".into(), 600)].into(), &["nose", "vertex 600"]);
}

#[test]
fn picked_vertices_are_those_of_smplx_or_of_the_configuration() {
    let body = read_plainly(&small().file()).unwrap();
    assert_eq!(body.landmark_names()[..2], ["face_1", "face_2"], "another surface has no ids of SMPL-X");
    let options = SmplxOptions {
        extra_joints: [("nose".to_string(), 11), ("left_heel".into(), 9)].into(),
        ..SmplxOptions::default()
    };
    let body = read(&small().file(), &options).unwrap();
    assert_eq!(body.landmark_names()[..3], ["nose", "left_heel", "face_1"]);
    let points = body.landmarks(&[Vec3::zeros(); 55]).unwrap();
    assert_eq!((points[0].vertices[0], points[1].vertices[0]), (11, 9));
    let whole = Layout { correctives: false, columns: 2, ..Layout::smplx(10475) };
    let body = read_plainly(&whole.file()).unwrap();
    assert_eq!(body.landmark_names().len(), 21 + 51);
    let points = body.landmarks(&[Vec3::zeros(); 55]).unwrap();
    for ((name, id), (placed, point)) in PICKED_VERTICES.iter().zip(body.landmark_names().iter().zip(&points)) {
        assert_eq!((*name, *id), (placed.as_str(), point.vertices[0]));
    }
}

#[test]
fn names_of_joints_may_come_with_the_file() {
    let file = |names: &[&str]| {
        let mut file = Layout { parents: vec![-1, 0, 1], ..small() }.file();
        let data = names.iter().flat_map(|n| format!("{n:\0<4}").into_bytes()).collect();
        file.arrays.insert("joint_names".into(), Npy { descr: "|S4", shape: vec![names.len()], data });
        file
    };
    let body = read_plainly(&file(&["hip", "knee", "foot"])).unwrap();
    assert_eq!(body.describe().joint("knee"), Some(1));
    for bad in [&["hip", "knee"][..], &["hip", "knee", "hip"], &["hip", "", "foot"]] {
        let text = read_plainly(&file(bad)).map(|_| ()).unwrap_err().to_string();
        assert!(text.contains("`joint_names`"), "{text}");
    }
}

#[test]
fn files_that_are_no_archives_are_refused() {
    let options = SmplxOptions::default();
    let pickle = load(Path::new("SMPLX_MALE.pkl"), vec![0x80, 2], &options).unwrap_err().to_string();
    assert!(
        pickle.contains("SMPLX_MALE.pkl") && pickle.contains("pickle.load") && pickle.contains("SMPLX_MALE.npz"),
        "{pickle}"
    );
    // By its content, whatever its name.
    assert!(load(Path::new("x.npz"), vec![0x80, 4, 0], &options).unwrap_err().to_string().contains("pickle"));
    assert!(matches!(load(Path::new("x.npz"), b"no zip".to_vec(), &options), Err(Error::Format { .. })));
}

/// Cut off anywhere: an error, never a body. With a byte changed anywhere: never a panic, and no body that is not finite.
#[test]
fn damaged_archives_are_refused_and_never_panic() {
    let bytes = Layout { vertices: 70, columns: 4, ..small() }.file().bytes(zip::CompressionMethod::Deflated);
    let options = SmplxOptions { face_contour: true, ..SmplxOptions::default() };
    let read = |bytes: Vec<u8>| load(Path::new("damaged.npz"), bytes, &options);
    assert!(read(bytes.clone()).is_ok());
    for k in 0..60 {
        let mut cut = bytes.clone();
        cut.truncate(bytes.len() * k / 60);
        assert!(matches!(read(cut), Err(Error::Format { .. })), "cut at {k}/60");
    }
    for k in 0..400 {
        let mut changed = bytes.clone();
        // Three quarters anywhere, the rest in the directory at the end.
        let at = if k % 4 == 0 { bytes.len() - 1 - k * 3 } else { k * 7919 % bytes.len() };
        changed[at] ^= 1 << (k % 8);
        if let Ok(body) = read(changed) {
            let posed = body.forward(&body.rest(&[])).unwrap();
            assert!(posed.vertices.iter().all(|v| v.iter().all(|x| x.is_finite())), "byte {at}");
        }
    }
}

/// Changes behind the archive's check sums: bytes of values, types, axes, whole arrays. Whatever loads can be posed.
#[test]
fn arrays_that_were_tampered_with_never_panic() {
    let mut state = 1u64;
    let mut below = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % n.max(1)
    };
    let original = Layout { vertices: 70, columns: 4, ..small() }.file();
    let names: Vec<String> = original.arrays.keys().cloned().collect();
    let options = SmplxOptions { face_contour: true, hand_mean: true, ..SmplxOptions::default() };
    let (mut loaded, mut refused) = (0, 0);
    for _ in 0..TAMPERED {
        let mut file = original.clone();
        for _ in 0..=below(3) {
            let Some(npy) = file.arrays.get_mut(&names[below(names.len())]) else { continue };
            match below(6) {
                0 | 1 if !npy.data.is_empty() => {
                    let at = below(npy.data.len());
                    npy.data[at] = [0, 0x7f, 0x80, 0xff, 0x3f, 1][below(6)];
                }
                2 => {
                    let axis = below(npy.shape.len());
                    npy.shape[axis] = [0, 1, npy.shape[axis].saturating_add(1), usize::MAX][below(4)];
                }
                3 => npy.shape.reverse(),
                4 => npy.descr = ["<f4", "<i4", "<u4", "<f8", "<i8", "<u8"][below(6)],
                _ => drop(file.arrays.remove(&names[below(names.len())])),
            }
        }
        match load(Path::new("tampered.npz"), file.stored(), &options) {
            Ok(body) => {
                loaded += 1;
                let rest = body.rest(&[1.0][..body.describe().shape_count.min(1)]);
                body.forward(&rest).unwrap();
                body.landmarks(&rest.rotations).unwrap();
                let mut out = Frames::<f32>::zeros(1, body.describe().vertex_count, 1);
                body.forward_frames(&[rest], None, &mut out).unwrap();
            }
            Err(_) => refused += 1,
        }
    }
    assert!(loaded > TAMPERED / 20 && refused > TAMPERED / 5, "{loaded} loaded, {refused} refused");
}

const TAMPERED: usize = 400;
