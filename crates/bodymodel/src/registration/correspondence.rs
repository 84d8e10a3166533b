//! Nearest points whose normals agree, and evenly spread samples.

use super::solve::Level;
use caphy_core::Vec3;
use caphy_core::query::NearestGrid;

/// Directions of the cube's faces and corners: every direction is within 36° of one of them.
fn directions() -> [Vec3; 14] {
    let c = 1.0 / 3f64.sqrt();
    std::array::from_fn(|i| match i {
        0..6 => {
            let mut d = Vec3::zeros();
            d[i / 2] = if i % 2 == 0 { 1.0 } else { -1.0 };
            d
        }
        _ => {
            let sign = |bit: usize| if (i - 6) >> bit & 1 == 1 { c } else { -c };
            Vec3::new(sign(0), sign(1), sign(2))
        }
    })
}

/// Points with normals, searched for the nearest one whose normal is compatible: without that, an arm that hangs at the
/// side is drawn to the torso, and the front of a thigh to its back.
pub(super) struct NormalIndex<'a> {
    points: &'a [Vec3],
    normals: &'a [Vec3],
    /// Per direction the points whose normal is near it.
    buckets: Vec<(NearestGrid<f64>, Vec<u32>)>,
    cos_max: f64,
}

/// Largest angle between a bucket's direction and its points' normals [rad]: with queries at most 36° from the
/// direction, points within 21° of the query's normal are never missed, and none is off by more than 93°.
const BUCKET_ANGLE: f64 = 1.0;

impl<'a> NormalIndex<'a> {
    /// Over points [m] with unit normals; `angle_max` [rad] is the largest angle between compatible normals.
    pub(super) fn new(
        points: &'a [Vec3],
        normals: &'a [Vec3],
        angle_max: f64,
        use_point: impl Fn(usize) -> bool,
    ) -> Self {
        let limit = BUCKET_ANGLE.min(angle_max).cos();
        let buckets = directions()
            .iter()
            .map(|d| {
                let ids: Vec<u32> = (0..points.len())
                    .filter(|&i| use_point(i) && normals[i].dot(d) > limit)
                    .map(|i| i as u32)
                    .collect();
                let chosen: Vec<Vec3> = ids.iter().map(|&i| points[i as usize]).collect();
                (NearestGrid::from_points(&chosen), ids)
            })
            .collect();
        Self { points, normals, buckets, cos_max: angle_max.cos() }
    }
    /// Id and distance [m] of the nearest compatible point within `distance_max` [m].
    ///
    /// Points whose normal is near the limit angle may be missed; where the nearest of the bucket is not compatible
    /// there is no answer, rather than a farther one.
    pub(super) fn nearest(&self, point: &Vec3, normal: &Vec3, distance_max: f64) -> Option<(usize, f64)> {
        let bucket = directions()
            .iter()
            .enumerate()
            .map(|(i, d)| (i, d.dot(normal)))
            .fold((0, f64::NEG_INFINITY), |best, x| if x.1 > best.1 { x } else { best });
        let (grid, ids) = self.buckets.get(bucket.0)?;
        let (slot, squared) = grid.nearest_within(&[point.x, point.y, point.z], distance_max * distance_max)?;
        let id = ids[slot as usize] as usize;
        (self.normals[id].dot(normal) > self.cos_max).then(|| (id, squared.sqrt()))
    }
    pub(super) fn point(&self, id: usize) -> Vec3 {
        self.points[id]
    }
    pub(super) fn normal(&self, id: usize) -> Vec3 {
        self.normals[id]
    }
}

/// About `count` ids spread evenly over a surface given as points: one point per cube of a grid, the one with the
/// smallest id. Non-finite points are never chosen.
pub(super) fn spread(points: &[Vec3], count: usize) -> Vec<u32> {
    let finite: Vec<u32> =
        (0..points.len() as u32).filter(|&i| points[i as usize].iter().all(|c| c.is_finite())).collect();
    if finite.len() <= count {
        return finite;
    }
    let at_size = |size: f64| -> Vec<u32> {
        let mut keys: Vec<([i64; 3], u32)> = finite
            .iter()
            .map(|&i| {
                let p = points[i as usize] / size;
                ([p.x, p.y, p.z].map(|c| c.floor() as i64), i)
            })
            .collect();
        keys.sort_unstable();
        keys.dedup_by_key(|k| k.0);
        let mut ids: Vec<u32> = keys.into_iter().map(|k| k.1).collect();
        ids.sort_unstable();
        ids
    };
    // Bisection on the logarithm of the cube's side, from a micrometre to a kilometre.
    let (mut low, mut high) = (-6.0f64, 3.0f64);
    let mut best = Vec::new();
    for _ in 0..24 {
        let middle = 0.5 * (low + high);
        let ids = at_size(10f64.powf(middle));
        if ids.len() > count {
            low = middle;
        } else {
            high = middle;
            best = ids;
            if best.len() * 20 >= count * 19 {
                break;
            }
        }
    }
    best
}

/// Ids spread evenly over a surface: a few for the way, many for its end.
#[derive(Debug, Clone)]
pub(super) struct Samples {
    few: Vec<u32>,
    pub(super) many: Vec<u32>,
}

/// A third of the samples finds the way.
const FEW: usize = 3;

impl Samples {
    pub(super) fn new(points: &[Vec3], count: usize) -> Self {
        Self { few: spread(points, count.div_ceil(FEW)), many: spread(points, count) }
    }
    /// The same samples of a list whose entries are themselves ids.
    pub(super) fn of(self, ids: &[u32]) -> Self {
        let of = |list: Vec<u32>| list.into_iter().map(|i| ids[i as usize]).collect();
        Self { few: of(self.few), many: of(self.many) }
    }
    /// Those that carry residuals at a level.
    pub(super) fn at(&self, level: &Level) -> &[u32] {
        if level.fineness < 1.0 { &self.few } else { &self.many }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(n: usize, radius: f64) -> Vec<Vec3> {
        (0..n)
            .map(|i| {
                let z = 1.0 - 2.0 * (i as f64 + 0.5) / n as f64;
                let a = i as f64 * 2.399_963_229_728_653;
                let r = (1.0 - z * z).sqrt();
                Vec3::new(r * a.cos(), r * a.sin(), z) * radius
            })
            .collect()
    }

    #[test]
    fn nearest_compatible_equals_brute_force_on_two_sheets() {
        // Two concentric spheres whose normals point against each other.
        let mut points = sphere(800, 1.0);
        let mut normals = points.clone();
        points.extend(sphere(800, 1.02));
        normals.extend(sphere(800, 1.0).iter().map(|p| -p));
        let index = NormalIndex::new(&points, &normals, 1.2, |_| true);
        for (q, n) in sphere(300, 1.013).iter().zip(sphere(300, 1.0)) {
            for n in [n, -n] {
                let brute = (0..points.len())
                    .filter(|&i| normals[i].dot(&n) > 1.2f64.cos())
                    .min_by(|&a, &b| (points[a] - q).norm().total_cmp(&(points[b] - q).norm()))
                    .unwrap();
                assert_eq!(index.nearest(q, &n, 1.0).unwrap().0, brute);
            }
        }
        assert!(index.nearest(&Vec3::new(9.0, 0.0, 0.0), &Vec3::x(), 1.0).is_none());
    }

    #[test]
    fn samples_are_even_and_counted() {
        let mut points = sphere(5000, 1.0);
        points[17].x = f64::NAN;
        let ids = spread(&points, 500);
        assert!((450..=500).contains(&ids.len()), "{}", ids.len());
        assert!(!ids.contains(&17));
        let upper = ids.iter().filter(|&&i| points[i as usize].z > 0.0).count() as f64 / ids.len() as f64;
        assert!((upper - 0.5).abs() < 0.06, "{upper}");
        assert_eq!(spread(&points[..10], 500).len(), 10);
    }
}
