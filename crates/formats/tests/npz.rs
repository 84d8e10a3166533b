//! NPZ: every width, both orders, damage, and the archives this field really uses.

mod support;

use caphy_formats::npz::Npz;
use std::path::Path;
use support::npy;

fn open(entries: &[(&str, Vec<u8>)]) -> Npz {
    Npz::from_bytes(Path::new("body.npz"), support::archive(entries, false)).unwrap()
}

fn le<const N: usize, T>(values: &[T], f: impl Fn(&T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|v| f(v).to_vec()).collect()
}

#[test]
fn every_number_width_is_read() {
    let npz = open(&[
        ("f2", npy("<f2", false, "(4,)", &le(&[0x3c00u16, 0xc000, 0x0001, 0x7c00], |v| v.to_le_bytes()))),
        ("f4", npy("<f4", false, "(2,)", &le(&[1.5f32, f32::NAN], |v| v.to_le_bytes()))),
        ("f8be", npy(">f8", false, "(2,)", &le(&[1.5f64, -2.0], |v| v.to_be_bytes()))),
        ("i1", npy("|i1", false, "(2,)", &[255, 7])),
        ("i2", npy("<i2", false, "(1,)", &(-300i16).to_le_bytes())),
        ("i4be", npy(">i4", false, "(1,)", &(-70000i32).to_be_bytes())),
        ("i8", npy("<i8", false, "(1,)", &(-1i64).to_le_bytes())),
        ("u2", npy("<u2", false, "(1,)", &65535u16.to_le_bytes())),
        ("u4", npy("<u4", false, "(2,)", &le(&[u32::MAX, 0], |v| v.to_le_bytes()))),
        ("u8", npy("<u8", false, "(1,)", &u64::MAX.to_le_bytes())),
        ("b1", npy("|b1", false, "(2,)", &[1, 0])),
        ("scalar", npy("<f8", false, "()", &59.99999f64.to_le_bytes())),
        ("empty", npy("<f4", false, "(0, 3)", &[])),
    ]);
    let f2 = npz.f64s("f2").unwrap().data;
    assert_eq!(f2, [1.0, -2.0, 2f64.powi(-24), f64::INFINITY]);
    let f4 = npz.f64s("f4").unwrap();
    assert_eq!((f4.shape.as_slice(), f4.data[0]), ([2].as_slice(), 1.5));
    assert!(f4.data[1].is_nan(), "NaN is the caller's to judge");
    assert_eq!(npz.f32s("f8be").unwrap().data, [1.5, -2.0]);
    assert_eq!(npz.i64s("i1").unwrap().data, [-1, 7]);
    assert_eq!(npz.i64s("i2").unwrap().data, [-300]);
    assert_eq!(npz.i64s("i4be").unwrap().data, [-70000]);
    assert_eq!(npz.i64s("i8").unwrap().data, [-1]);
    assert_eq!(npz.i64s("u2").unwrap().data, [65535]);
    assert_eq!(npz.i64s("u4").unwrap().data, [4294967295, 0]);
    assert_eq!(npz.i64s("u8").unwrap().data, [i64::MAX]);
    assert_eq!(npz.i64s("b1").unwrap().data, [1, 0]);
    assert_eq!(npz.f64s("b1").unwrap().data, [1.0, 0.0]);
    assert_eq!(npz.f64_scalar("scalar").unwrap(), 59.99999);
    assert_eq!(npz.f64s("scalar").unwrap().shape, [0usize; 0]);
    assert_eq!(npz.f64s("empty").unwrap().shape, [0, 3]);
}

#[test]
fn fortran_order_comes_out_in_c_order() {
    // Column-major bytes of [[[0,1],[2,3],[4,5]],[[6,7],[8,9],[10,11]]].
    let stored = [0u8, 6, 2, 8, 4, 10, 1, 7, 3, 9, 5, 11];
    let npz = open(&[("a", npy("|u1", true, "(2, 3, 2)", &stored))]);
    let a = npz.i64s("a").unwrap();
    assert_eq!(a.shape, [2, 3, 2]);
    assert_eq!(a.data, (0..12).collect::<Vec<_>>());
}

#[test]
fn texts_are_read() {
    let utf32 = |t: &str, n: usize| {
        let mut v: Vec<u8> = t.chars().flat_map(|c| (c as u32).to_le_bytes()).collect();
        v.resize(4 * n, 0);
        v
    };
    let both = [utf32("pelvis", 8), utf32("größe", 8)].concat();
    let npz = open(&[
        ("u", npy("<U8", false, "(2,)", &both)),
        ("s", npy("|S3", false, "(2,)", b"ab\0xyz")),
        ("bad", npy("<U1", false, "(1,)", &u32::MAX.to_le_bytes())),
        ("none", npy("<U0", false, "(2,)", &[])),
    ]);
    assert_eq!(npz.strings("u").unwrap(), ["pelvis", "größe"]);
    assert_eq!(npz.strings("s").unwrap(), ["ab", "xyz"]);
    assert_eq!(npz.strings("none").unwrap(), ["", ""]);
    assert!(npz.strings("bad").unwrap_err().to_string().contains("element 0"));
    assert!(npz.f64s("u").unwrap_err().to_string().contains("<U8"));
}

#[test]
fn a_missing_array_lists_those_that_exist() {
    let npz = open(&[("poses", npy("|u1", false, "(1,)", &[1])), ("trans", npy("|u1", false, "(1,)", &[1]))]);
    assert_eq!(npz.names(), ["poses", "trans"]);
    assert!(npz.has("poses") && !npz.has("pose"));
    let text = npz.f64s("root_orient").unwrap_err().to_string();
    assert!(text.contains("body.npz") && text.contains("root_orient") && text.contains("poses, trans"), "{text}");
}

#[test]
fn pickles_are_refused_with_the_way_out() {
    for (name, bytes) in [("SMPLX_NEUTRAL.pkl", b"x".to_vec()), ("renamed.npz", vec![0x80, 2, 0, 0])] {
        let text = Npz::from_bytes(Path::new(name), bytes).err().unwrap().to_string();
        assert!(text.contains("python3 -c") && text.contains("numpy.savez"), "{text}");
    }
}

#[test]
fn headers_that_lie_are_refused_before_memory_is_taken() {
    for (descr, shape) in [
        ("<f8", "(99999999999, 3)"),
        ("<f8", "(18446744073709551615, 2)"),
        ("<f8", "(99999999999999999999999,)"),
        ("<f8", "(3,)"),
        ("<f8", "(-1,)"),
        ("<U0", "(99999999999,)"),
        ("<U4294967295", "(4294967295,)"),
        ("|O", "(1,)"),
        ("<c16", "(1,)"),
        ("<f", "(1,)"),
        ("", "(1,)"),
    ] {
        let npz = open(&[("a", npy(descr, false, shape, &[0; 16]))]);
        let text = npz.f64s("a").unwrap_err().to_string();
        assert!(text.contains("array `a`"), "{text}");
    }
    let long = [b"\x93NUMPY\x02\x00".as_slice(), &u32::MAX.to_le_bytes()].concat();
    let wrong = b"something else, long enough".to_vec();
    let nothing = Vec::new();
    let hidden = npy("<f8", false, "(0, 18446744073709551615, 2)", &[]);
    let npz = open(&[("long", long), ("wrong", wrong), ("nothing", nothing), ("hidden", hidden)]);
    for name in ["long", "wrong", "nothing", "hidden"] {
        assert!(npz.f64s(name).is_err(), "{name}");
    }
}

#[test]
fn the_stand_in_body_is_read() {
    let Some(bytes) = support::shared("data/body/anny_smplx_layout.npz") else { return };
    let npz = Npz::from_bytes(Path::new("anny.npz"), bytes).unwrap();
    assert_eq!(npz.f32s("posedirs").unwrap().shape, [13718, 3, 486]);
    let tree = npz.i64s("kintree_table").unwrap();
    assert_eq!((tree.shape.as_slice(), tree.data[0], tree.data[1]), ([2, 55].as_slice(), i64::from(u32::MAX), 0));
    assert_eq!(npz.strings("joint_names").unwrap()[20], "left_wrist");
    let Some(bytes) = support::shared("data/scans/ground_truth.npz") else { return };
    let npz = Npz::from_bytes(Path::new("ground_truth.npz"), bytes).unwrap();
    assert!(npz.f64s("p1_apose__joints55").unwrap().data.iter().any(|x| x.is_nan()));
}
