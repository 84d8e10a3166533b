//! Generated models in the SMPL-X layout: all numbers are made here, only the layout is that of the files.

use caphy_core::Vec3;
use caphy_core::body::BodyParameters;
use caphy_core::pose::SMPLX_PARENTS;
use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use zip::write::{FileOptions, ZipWriter};

/// An array as it stands in a file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Npy {
    pub(crate) descr: &'static str,
    pub(crate) shape: Vec<usize>,
    pub(crate) data: Vec<u8>,
}

macro_rules! npy_from {
    ($($name:ident: $from:ty => $to:ty, $descr:literal;)*) => {
        impl Npy {
            $(#[doc = concat!("An array of type `", $descr, "`.")]
            pub(crate) fn $name(shape: &[usize], values: &[$from]) -> Self {
                assert_eq!(shape.iter().product::<usize>(), values.len());
                let data = values.iter().flat_map(|v| (*v as $to).to_le_bytes()).collect();
                Self { descr: $descr, shape: shape.to_vec(), data }
            })*
        }
    };
}
npy_from! {
    f4: f64 => f32, "<f4";
    f8: f64 => f64, "<f8";
    i4: i64 => i32, "<i4";
    i8: i64 => i64, "<i8";
    u4: i64 => u32, "<u4";
    u8: i64 => u64, "<u8";
    u2: i64 => u16, "<u2";
}

/// A model file, array by array, so that each can be changed.
#[derive(Debug, Clone, Default)]
pub(crate) struct ModelFile {
    pub(crate) arrays: BTreeMap<String, Npy>,
}

/// How the numbers of a generated file are stored, and how many there are.
#[derive(Debug, Clone)]
pub(crate) struct Layout {
    pub(crate) vertices: usize,
    pub(crate) parents: Vec<i64>,
    /// Columns of `shapedirs`.
    pub(crate) columns: usize,
    pub(crate) correctives: bool,
    /// How floating-point arrays are stored.
    pub(crate) float: fn(&[usize], &[f64]) -> Npy,
    /// How `kintree_table` is stored.
    pub(crate) integer: fn(&[usize], &[i64]) -> Npy,
}

impl Layout {
    /// Version 1.1: 55 joints, 300 + 100 directions, pose correctives.
    pub(crate) fn smplx(vertices: usize) -> Self {
        let parents = SMPLX_PARENTS.iter().map(|p| i64::try_from(*p).unwrap_or(-1)).collect();
        Self { vertices, parents, columns: 400, correctives: true, float: Npy::f4, integer: Npy::u4 }
    }

    /// The file.
    pub(crate) fn file(&self) -> ModelFile {
        let (n, joints) = (self.vertices, self.parents.len());
        let mut numbers = Numbers(0x9e37_79b9_7f4a_7c15);
        let mut centres: Vec<[f64; 3]> = Vec::new();
        for &parent in &self.parents {
            let step = [numbers.next(), numbers.next(), numbers.next()];
            let from = usize::try_from(parent).ok().and_then(|p| centres.get(p)).copied().unwrap_or([0.0; 3]);
            centres.push(std::array::from_fn(|k| from[k] + 0.15 * step[k]));
        }
        // Runs of vertices belong to a joint and share with its ancestors: four weights, as most of SMPL-X.
        let owner = |v: usize| v * joints / n;
        let mut template = Vec::with_capacity(3 * n);
        let mut weights = vec![0.0; n * joints];
        let mut regressor = vec![0.0; joints * n];
        for v in 0..n {
            let j = owner(v);
            template.extend(centres[j].map(|c| c + 0.06 * numbers.next()));
            let (mut at, mut row) = (j as i64, Vec::new());
            for _ in 0..4 {
                row.push((at as usize, 0.05 + numbers.next().abs()));
                at = self.parents[at as usize];
                if at < 0 || at as usize >= joints {
                    break;
                }
            }
            let sum: f64 = row.iter().map(|(_, w)| w).sum();
            for (j, w) in row {
                weights[v * joints + j] = w / sum;
            }
            regressor[j * n + v] = 1.0;
        }
        for row in regressor.chunks_exact_mut(n) {
            let sum: f64 = row.iter().sum();
            row.iter_mut().for_each(|w| *w /= sum);
        }
        let faces: Vec<i64> = (0..n as i64 - 3).flat_map(|v| [v, v + 1, v + 2, v, v + 2, v + 3]).collect();
        let parents: Vec<i64> = self.parents.iter().copied().chain(0..joints as i64).collect();
        let mut file = ModelFile::default();
        let mut set = |name: &str, npy: Npy| file.arrays.insert(name.into(), npy);
        set("v_template", (self.float)(&[n, 3], &template));
        set("f", Npy::u4(&[faces.len() / 3, 3], &faces));
        set("shapedirs", (self.float)(&[n, 3, self.columns], &numbers.take(3 * n * self.columns, 0.01)));
        if self.correctives {
            let width = 9 * (joints - 1);
            set("posedirs", (self.float)(&[n, 3, width], &numbers.take(3 * n * width, 0.002)));
        }
        set("J_regressor", (self.float)(&[joints, n], &regressor));
        set("weights", (self.float)(&[n, joints], &weights));
        set("kintree_table", (self.integer)(&[2, joints], &parents));
        if joints == SMPLX_PARENTS.len() {
            for side in ["l", "r"] {
                set(&format!("hands_components{side}"), (self.float)(&[45, 45], &numbers.take(45 * 45, 0.3)));
                set(&format!("hands_mean{side}"), (self.float)(&[45], &numbers.take(45, 0.2)));
            }
            let count = faces.len() / 3;
            for (prefix, rows, shape) in [("", 51, vec![51]), ("dynamic_", 79 * 17, vec![79, 17])] {
                let ids: Vec<i64> = (0..rows).map(|i| (i * 7919 % count) as i64).collect();
                let bary: Vec<f64> = (0..rows).flat_map(|_| numbers.barycentric()).collect();
                set(&format!("{prefix}lmk_faces_idx"), Npy::i8(&shape, &ids));
                let wide = [&shape[..], &[3]].concat();
                set(&format!("{prefix}lmk_bary_coords"), (self.float)(&wide, &bary));
            }
        }
        file
    }
}

impl ModelFile {
    /// The `.npz`: deflated as `numpy.savez_compressed` does, or stored as `numpy.savez` does.
    pub(crate) fn bytes(&self, method: zip::CompressionMethod) -> Vec<u8> {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, npy) in &self.arrays {
            let shape: String = npy.shape.iter().map(|n| format!("{n}, ")).collect();
            let header = format!("{{'descr': '{}', 'fortran_order': False, 'shape': ({shape}), }}\n", npy.descr);
            zip.start_file(format!("{name}.npy"), FileOptions::default().compression_method(method)).unwrap();
            zip.write_all(b"\x93NUMPY\x01\x00").unwrap();
            zip.write_all(&(header.len() as u16).to_le_bytes()).unwrap();
            zip.write_all(header.as_bytes()).unwrap();
            zip.write_all(&npy.data).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }
    /// The `.npz` as `numpy.savez` writes it.
    pub(crate) fn stored(&self) -> Vec<u8> {
        self.bytes(zip::CompressionMethod::Stored)
    }
    /// The array, to be changed.
    pub(crate) fn array(&mut self, name: &str) -> &mut Npy {
        self.arrays.get_mut(name).unwrap()
    }
}

/// SplitMix64: quick and the same everywhere.
struct Numbers(u64);

impl Numbers {
    /// The next number in [-1, 1).
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
    fn take(&mut self, count: usize, size: f64) -> Vec<f64> {
        (0..count).map(|_| size * self.next()).collect()
    }
    fn barycentric(&mut self) -> [f64; 3] {
        let raw = [0; 3].map(|_| 0.01 + self.next().abs());
        raw.map(|w| w / raw.iter().sum::<f64>())
    }
}

/// Frames of one body, every joint turned by up to about half a radian.
pub(crate) fn frames(joints: usize, count: usize) -> Vec<BodyParameters> {
    let mut numbers = Numbers(7);
    let shape = numbers.take(10, 1.0);
    let mut vector = |size: f64| Vec3::from_column_slice(&numbers.take(3, size));
    (0..count)
        .map(|_| BodyParameters {
            shape: shape.clone(),
            rotations: (0..joints).map(|_| vector(0.3)).collect(),
            translation: vector(1.0),
            ..BodyParameters::default()
        })
        .collect()
}
