//! SMPL-X `.npz` files: version 1.1 (300 + 100 directions), the older layout (10 + 10) and what is built like them.

use super::arrays::{is_off_one, tree_problem};
use super::hands::HAND_JOINTS;
use super::landmarks::{FaceContour, PICKED_VERTICES, SMPLX_VERTEX_COUNT, SmplxLandmarks};
use super::{BodySmplx, HandComponents, SmplxArrays, joint_names};
use caphy_core::body::{BlendWeights, Joint, SurfacePoint};
use caphy_core::{Error, Result, Vec3};
use caphy_formats::npz::{Array, Npz};
use std::collections::BTreeMap;
use std::path::Path;

/// How a file is read; [`SmplxSpec`](super::SmplxSpec) has the same as keys, and says why.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SmplxOptions {
    /// Number of shape coefficients to keep; `None`: up to ten.
    pub shape_coefficients: Option<usize>,
    /// Number of expression coefficients to keep; `None`: up to ten.
    pub expression_coefficients: Option<usize>,
    /// Number of leading columns of `shapedirs` that are shape; `None`: by the number of columns.
    pub shape_columns: Option<usize>,
    /// Whether the mean hand pose of the file is added to the rotations of the fingers.
    pub hand_mean: bool,
    /// Whether the landmarks have the contour of the face, which slides as the head turns.
    pub face_contour: bool,
    /// Vertices of [`PICKED_VERTICES`] by name, instead of those of SMPL-X.
    pub extra_joints: BTreeMap<String, u32>,
}

/// Coefficients kept unless told otherwise: scans of clothed people determine about ten; more only cost memory.
const DEFAULT_COEFFICIENTS: usize = 10;
/// Columns of `shapedirs` in version 1.1: shape, then expression.
const COLUMNS_V11: (usize, usize) = (300, 100);
/// Likewise in the older layout.
const COLUMNS_OLD: usize = 10;
/// Skinning weights below this are export noise: a metre away they move a vertex by a nanometre.
const WEIGHT_NOISE: f64 = 1e-9;
/// Negative skinning weights up to this size are rounding of single precision and count as zero.
const NEGATIVE_NOISE: f64 = 1e-6;

/// Reads a body in the SMPL-X layout; `path` serves messages and the body's name.
///
/// `shapedirs` is split as the official package does it: 300 shape and up to 100 expression columns where there are at least
/// 400, else 10 and up to 10 (unless `shape_columns` says otherwise). Rows of `weights` that sum to 1 within 1e-3 (half
/// precision) are divided by their sum, so that a translation moves every vertex alike; others are refused. Hands and
/// landmarks are read where the file has them; landmarks whose weights are all zero are placeholders and left out.
///
/// # Errors
/// [`Error::Format`] and [`Error::NonFinite`] that name array and element for missing arrays, wrong shapes and bad values;
/// pickles (`.pkl`) are refused with the line that converts them. [`Error::Config`] for options that the file cannot meet.
pub fn load(path: &Path, bytes: Vec<u8>, options: &SmplxOptions) -> Result<BodySmplx> {
    let npz = Npz::from_bytes(path, bytes)?;
    let stem = path.file_stem().map_or_else(String::new, |s| format!(" {}", s.to_string_lossy()));
    let file = File { npz: &npz, path };

    let template = file.f64s("v_template", &[None, Some(3)])?;
    let n = template.shape[0];
    let faces = file.faces(n)?;
    let joints = file.joints()?;
    // The large arrays are inflated at the same time.
    let (correctives, (directions, (regressor, weights))) = rayon::join(
        || file.pose_directions(n, joints.len()),
        || {
            rayon::join(
                || file.directions(n, options),
                || rayon::join(|| file.regressor(n, joints.len()), || file.weights(n, joints.len())),
            )
        },
    );
    let (shape_directions, expression_directions) = directions?;
    let landmarks = file.landmarks(n, &faces, options)?;
    let hands = file.hands(&joints)?;
    let body = BodySmplx::new(SmplxArrays {
        name: format!("smplx{stem}"),
        template: template.data.chunks_exact(3).map(Vec3::from_column_slice).collect(),
        faces,
        shape_directions,
        expression_directions,
        pose_directions: correctives?,
        joint_regressor: regressor?,
        weights: weights?,
        joints,
    })?
    .with_landmarks(landmarks)?;
    match hands {
        Some([left, right]) => body.with_hands(left, right, options.hand_mean),
        None if options.hand_mean => Err(Error::config(
            "body.hand_mean",
            format!("{} has no hand poses (`hands_meanl`, `hands_meanr`)", path.display()),
            "leave the key out",
        )),
        None => Ok(body),
    }
}

/// Entries whose size is above a threshold.
fn sparse(row: &[f64], threshold: f64) -> Vec<(u32, f64)> {
    row.iter().enumerate().filter(|(_, w)| w.abs() > threshold).map(|(i, w)| (i as u32, *w)).collect()
}

/// The number of coefficients to keep of those in the file.
fn kept(key: &str, wanted: Option<usize>, there: usize) -> Result<usize> {
    match wanted {
        None => Ok(there.min(DEFAULT_COEFFICIENTS)),
        Some(wanted) if wanted <= there => Ok(wanted),
        Some(wanted) => Err(Error::config(
            format!("body.{key}"),
            format!("{wanted} are wanted, the file has {there}"),
            format!("give at most {there}, or leave the key out"),
        )),
    }
}

struct File<'a> {
    npz: &'a Npz,
    path: &'a Path,
}

const DAMAGED: &str = "the file is damaged: get it again";
const NOT_THIS_LAYOUT: &str = "give a model file in the SMPL-X layout";

impl File<'_> {
    fn error(&self, name: &str, problem: String, remedy: &str) -> Error {
        Error::format(self.path, format!("array `{name}`"), problem, remedy)
    }
    /// `None` stands for any length of at least one.
    fn check_shape(&self, name: &str, shape: &[usize], wanted: &[Option<usize>]) -> Result<()> {
        let fits = shape.len() == wanted.len()
            && shape.iter().zip(wanted).all(|(got, want)| want.map_or(*got > 0, |want| want == *got));
        if fits {
            return Ok(());
        }
        let wanted: Vec<String> = wanted.iter().map(|w| w.map_or_else(|| "any".into(), |w| w.to_string())).collect();
        Err(self.error(name, format!("has shape {shape:?}, wanted [{}]", wanted.join(", ")), NOT_THIS_LAYOUT))
    }
    fn what(&self, name: &str) -> String {
        format!("{}, array `{name}`", self.path.display())
    }
    fn f64s(&self, name: &str, wanted: &[Option<usize>]) -> Result<Array<f64>> {
        let array = self.npz.f64s(name)?;
        self.check_shape(name, &array.shape, wanted)?;
        Error::check_finite(&self.what(name), &array.data)?;
        Ok(array)
    }
    fn faces(&self, vertex_count: usize) -> Result<Vec<[u32; 3]>> {
        let array = self.npz.i64s("f")?;
        self.check_shape("f", &array.shape, &[None, Some(3)])?;
        if let Some(i) = array.data.iter().position(|&id| id < 0 || id >= vertex_count as i64) {
            let problem = format!("face {} names vertex {}, there are {vertex_count}", i / 3, array.data[i]);
            return Err(self.error("f", problem, DAMAGED));
        }
        Ok(array.data.as_chunks::<3>().0.iter().map(|f| f.map(|id| id as u32)).collect())
    }
    /// The joint tree. The root's parent is no joint: -1, in whatever integer width and sign it was stored.
    fn joints(&self) -> Result<Vec<Joint>> {
        let name = "kintree_table";
        let array = self.npz.i64s(name)?;
        self.check_shape(name, &array.shape, &[Some(2), None])?;
        let (parents, ids) = array.data.split_at(array.shape[1]);
        if let Some(j) = ids.iter().enumerate().position(|(j, id)| *id != j as i64) {
            return Err(self.error(name, format!("names joint {j} {}", ids[j]), NOT_THIS_LAYOUT));
        }
        let exists = |parent: i64| (1..parents.len() as i64).contains(&parent);
        let parents: Vec<Option<usize>> = parents
            .iter()
            .enumerate()
            .map(|(j, &parent)| if j > 0 || exists(parent) { usize::try_from(parent).ok() } else { None })
            .collect();
        if let Some(problem) = tree_problem(&parents) {
            return Err(self.error(
                name,
                problem,
                "parents come before their children: give a model file in the SMPL-X layout",
            ));
        }
        let names = if self.npz.has("joint_names") {
            let names = self.npz.strings("joint_names")?;
            let mut sorted: Vec<&String> = names.iter().collect();
            sorted.sort_unstable();
            sorted.dedup();
            if names.len() != parents.len() || sorted.len() != names.len() || sorted[0].is_empty() {
                let problem =
                    format!("{} names, {} of them different, for {} joints", names.len(), sorted.len(), parents.len());
                return Err(self.error("joint_names", problem, "name each joint once, or leave the array out"));
            }
            names
        } else {
            joint_names::of_tree(&parents)
        };
        Ok(names.into_iter().zip(parents).map(|(name, parent)| Joint { name, parent }).collect())
    }
    /// Shape and expression directions; columns beyond the number to keep are never copied out.
    fn directions(&self, n: usize, options: &SmplxOptions) -> Result<(Vec<Vec<Vec3>>, Vec<Vec<Vec3>>)> {
        let name = "shapedirs";
        let array = self.f64s(name, &[Some(n), Some(3), None])?;
        let columns = array.shape[2];
        let (shape, expression) = match options.shape_columns {
            Some(shape) if shape > columns => {
                return Err(Error::config(
                    "body.shape_columns",
                    format!("{shape} columns of shape, `{name}` has {columns}"),
                    "leave the key out, or count the columns",
                ));
            }
            Some(shape) => (shape, columns - shape),
            None if columns >= COLUMNS_V11.0 + COLUMNS_V11.1 => COLUMNS_V11,
            None => (columns.min(COLUMNS_OLD), columns.saturating_sub(COLUMNS_OLD).min(COLUMNS_OLD)),
        };
        let take = |first: usize, count: usize| -> Vec<Vec<Vec3>> {
            let mut out: Vec<Vec<Vec3>> = (0..count).map(|_| Vec::with_capacity(n)).collect();
            for rows in array.data.chunks_exact(3 * columns) {
                for (k, direction) in out.iter_mut().enumerate() {
                    direction.push(Vec3::from_fn(|axis, _| rows[axis * columns + first + k]));
                }
            }
            out
        };
        Ok((
            take(0, kept("shape_coefficients", options.shape_coefficients, shape)?),
            take(shape, kept("expression_coefficients", options.expression_coefficients, expression)?),
        ))
    }
    /// Pose correctives; a file without them has none.
    fn pose_directions(&self, n: usize, joint_count: usize) -> Result<Vec<f32>> {
        let name = "posedirs";
        if !self.npz.has(name) || joint_count == 1 {
            return Ok(Vec::new());
        }
        let array = self.npz.f32s(name)?;
        self.check_shape(name, &array.shape, &[Some(n), Some(3), Some(9 * (joint_count - 1))])?;
        Error::check_finite(&self.what(name), &array.data)?;
        Ok(array.data)
    }
    fn regressor(&self, n: usize, joint_count: usize) -> Result<Vec<Vec<(u32, f64)>>> {
        let name = "J_regressor";
        let array = self.f64s(name, &[Some(joint_count), Some(n)])?;
        for (j, row) in array.data.chunks_exact(n).enumerate() {
            let sum: f64 = row.iter().sum();
            if is_off_one(sum) {
                let problem = format!("row {j} sums to {sum}, a joint is a weighted mean of vertices");
                return Err(self.error(name, problem, DAMAGED));
            }
        }
        Ok(array.data.chunks_exact(n).map(|row| sparse(row, 0.0)).collect())
    }
    fn weights(&self, n: usize, joint_count: usize) -> Result<BlendWeights> {
        let name = "weights";
        let array = self.f64s(name, &[Some(n), Some(joint_count)])?;
        let mut rows = Vec::with_capacity(n);
        for (v, row) in array.data.chunks_exact(joint_count).enumerate() {
            let sum: f64 = row.iter().sum();
            let negative = row.iter().position(|w| *w < -NEGATIVE_NOISE);
            if let Some(j) = negative {
                return Err(self.error(name, format!("row {v} (vertex), column {j} (joint) is {}", row[j]), DAMAGED));
            }
            if is_off_one(sum) {
                return Err(self.error(name, format!("row {v} (vertex) sums to {sum} instead of 1"), DAMAGED));
            }
            let mut kept = sparse(row, WEIGHT_NOISE);
            kept.retain(|(_, w)| *w > 0.0);
            let sum: f64 = kept.iter().map(|(_, w)| w).sum();
            rows.push(kept.into_iter().map(|(j, w)| (j as u16, w / sum)).collect());
        }
        Ok(BlendWeights::from_rows(rows))
    }
    /// Hand components and means, left and right, where the file and the joint tree have them.
    fn hands(&self, joints: &[Joint]) -> Result<Option<[HandComponents; 2]>> {
        let there =
            |side: &str| self.npz.has(&format!("hands_components{side}")) && self.npz.has(&format!("hands_mean{side}"));
        let joint = |name: String| joints.iter().position(|j| j.name == name);
        let ids = |side: &str| -> Option<Vec<usize>> {
            HAND_JOINTS.iter().map(|name| joint(format!("{side}_{name}"))).collect()
        };
        let (Some(left), Some(right), true) = (ids("left"), ids("right"), there("l") && there("r")) else {
            return Ok(None);
        };
        let hand = |side: &str, ids: Vec<usize>| {
            let width = Some(3 * ids.len());
            let components = self.f64s(&format!("hands_components{side}"), &[None, width])?;
            let mean = self.f64s(&format!("hands_mean{side}"), &[width])?;
            let vectors = |flat: &[f64]| flat.chunks_exact(3).map(Vec3::from_column_slice).collect::<Vec<_>>();
            HandComponents::new(
                ids,
                components.data.chunks_exact(3 * HAND_JOINTS.len()).map(vectors).collect(),
                vectors(&mean.data),
            )
        };
        Ok(Some([hand("l", left)?, hand("r", right)?]))
    }
    fn landmarks(&self, n: usize, faces: &[[u32; 3]], options: &SmplxOptions) -> Result<SmplxLandmarks> {
        for name in options.extra_joints.keys() {
            if !PICKED_VERTICES.iter().any(|(known, _)| known == name) {
                let known: Vec<&str> = PICKED_VERTICES.iter().map(|(name, _)| *name).collect();
                return Err(Error::config(
                    "body.extra_joints",
                    format!("there is no `{name}`"),
                    format!("the names are {}", known.join(", ")),
                ));
            }
        }
        // The ids of SMPL-X mean nothing on another surface.
        let is_smplx = n == SMPLX_VERTEX_COUNT;
        let picked = PICKED_VERTICES
            .iter()
            .filter_map(|(name, id)| {
                let id = options.extra_joints.get(*name).copied().or(is_smplx.then_some(*id))?;
                Some(((*name).to_string(), id))
            })
            .collect();
        let face = if self.npz.has("lmk_faces_idx") { self.surface_points("", &[None], faces)?.1 } else { Vec::new() };
        let contour = if options.face_contour {
            let (shape, points) = self.surface_points("dynamic_", &[Some(FaceContour::ROWS), None], faces)?;
            if points.is_empty() {
                let problem = "are all zero: placeholders";
                return Err(self.error("dynamic_lmk_bary_coords", problem.into(), "leave `face_contour` out"));
            }
            Some(FaceContour { rows: points.chunks_exact(shape[1]).map(<[_]>::to_vec).collect() })
        } else {
            None
        };
        Ok(SmplxLandmarks { picked, face, contour })
    }
    /// Points by face and barycentric weights; none when all weights are zero.
    fn surface_points(
        &self,
        prefix: &str,
        wanted: &[Option<usize>],
        faces: &[[u32; 3]],
    ) -> Result<(Vec<usize>, Vec<SurfacePoint>)> {
        let (ids_name, name) = (format!("{prefix}lmk_faces_idx"), format!("{prefix}lmk_bary_coords"));
        let ids = self.npz.i64s(&ids_name)?;
        self.check_shape(&ids_name, &ids.shape, wanted)?;
        let same: Vec<_> = ids.shape.iter().copied().chain([3]).map(Some).collect();
        let weights = self.f64s(&name, &same)?;
        if weights.data.iter().all(|w| *w == 0.0) {
            return Ok((ids.shape, Vec::new()));
        }
        let mut points = Vec::with_capacity(ids.data.len());
        for (i, (&id, &weights)) in ids.data.iter().zip(weights.data.as_chunks::<3>().0).enumerate() {
            let Some(&vertices) = usize::try_from(id).ok().and_then(|id| faces.get(id)) else {
                let problem = format!("element {i} names face {id}, there are {}", faces.len());
                return Err(self.error(&ids_name, problem, DAMAGED));
            };
            let sum: f64 = weights.iter().sum();
            if is_off_one(sum) {
                return Err(self.error(&name, format!("row {i} sums to {sum} instead of 1"), DAMAGED));
            }
            points.push(SurfacePoint { vertices, weights });
        }
        Ok((ids.shape, points))
    }
}
