//! The noise of a scan, from how far its points lie off smooth surfaces through their neighbours.

use caphy_core::Vec3;
use caphy_core::query::Adjacency;
use nalgebra::{DMatrix, DVector, Matrix3};

/// Neighbours that a surface is fitted to.
const NEIGHBOURS: usize = 18;
/// Coefficients of a quadric height field.
const COEFFICIENTS: usize = 6;
/// Points that are looked at, spread over the scan: their median is known to a few per cent.
const SAMPLES: usize = 2000;
/// Median of |x| of a standard normal number.
const MEDIAN_NORMAL: f64 = 0.674_489_750_196_082;

/// Standard deviation of the noise along the surface's normal [m], the median over points; `None` for fewer points than a surface
/// needs. `faces` may be empty: neighbours are then the nearest points.
///
/// A quadric through 18 neighbours takes away curvature; what it takes of the noise is put back. Folds sharper than that, in
/// less than half of the places, do not count.
pub fn of_points(points: &[Vec3], faces: &[[u32; 3]]) -> Option<f64> {
    if points.len() <= NEIGHBOURS {
        return None;
    }
    let around: Box<dyn Fn(usize) -> Vec<u32>> = if faces.is_empty() {
        Box::new(|i| nearest_points(points, i))
    } else {
        let adjacency = Adjacency::new(points.len(), faces);
        Box::new(move |i| rings(&adjacency, i))
    };
    let step = points.len().div_ceil(SAMPLES);
    let mut off: Vec<f64> = (0..points.len()).step_by(step).filter_map(|i| residual(points, i, &around(i))).collect();
    if off.is_empty() {
        return None;
    }
    let middle = off.len() / 2;
    let (_, median, _) = off.select_nth_unstable_by(middle, f64::total_cmp);
    Some(*median / MEDIAN_NORMAL)
}

fn rings(adjacency: &Adjacency, i: usize) -> Vec<u32> {
    let mut found = vec![i as u32];
    let mut at = 0;
    while found.len() <= NEIGHBOURS && at < found.len() {
        for &v in adjacency.of(found[at] as usize) {
            if !found.contains(&v) {
                found.push(v);
            }
        }
        at += 1;
    }
    found
}

fn nearest_points(points: &[Vec3], i: usize) -> Vec<u32> {
    let mut order: Vec<(f64, u32)> =
        points.iter().enumerate().map(|(k, p)| ((p - points[i]).norm_squared(), k as u32)).collect();
    order.select_nth_unstable_by(NEIGHBOURS, |a, b| a.0.total_cmp(&b.0));
    order.truncate(NEIGHBOURS + 1);
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    order.into_iter().map(|o| o.1).collect()
}

/// |distance| of a point to the quadric through it and its neighbours, over the share of the noise that it keeps.
fn residual(points: &[Vec3], i: usize, around: &[u32]) -> Option<f64> {
    if around.len() < 2 * COEFFICIENTS {
        return None;
    }
    let centre = around.iter().map(|&k| points[k as usize]).sum::<Vec3>() / around.len() as f64;
    let spread = around.iter().fold(Matrix3::zeros(), |sum, &k| {
        let d = points[k as usize] - centre;
        sum + d * d.transpose()
    });
    let eigen = spread.symmetric_eigen();
    let normal_at = eigen.eigenvalues.imin();
    let axes: Vec<Vec3> = (0..3).filter(|&k| k != normal_at).map(|k| eigen.eigenvectors.column(k).into()).collect();
    let normal: Vec3 = eigen.eigenvectors.column(normal_at).into();
    let scale = spread.trace().sqrt() / (around.len() as f64).sqrt();
    let row = |k: u32| -> [f64; COEFFICIENTS] {
        let d = (points[k as usize] - points[i]) / scale.max(f64::MIN_POSITIVE);
        let (u, v) = (axes[0].dot(&d), axes[1].dot(&d));
        [1.0, u, v, u * u, u * v, v * v]
    };
    let a = DMatrix::from_fn(around.len(), COEFFICIENTS, |r, c| row(around[r])[c]);
    let h = DVector::from_iterator(around.len(), around.iter().map(|&k| normal.dot(&(points[k as usize] - points[i]))));
    let normal_matrix = (a.transpose() * &a).cholesky()?;
    let fit = normal_matrix.solve(&(a.transpose() * &h));
    // The point itself is at the origin: row (1, 0, …), height 0.
    let own = around.iter().position(|&k| k as usize == i)?;
    let e = DVector::from_fn(COEFFICIENTS, |r, _| a[(own, r)]);
    let leverage = e.dot(&normal_matrix.solve(&e));
    let kept = (1.0 - leverage).max(0.05).sqrt();
    Some((e.dot(&fit) - h[own]).abs() / kept)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A wavy sheet with wrinkles of 8 cm and 1 cm high, points 8 mm apart.
    fn wavy(noise: f64) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let n = 40;
        // The sum of twelve uniform numbers has variance one.
        let mut normal = || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
        let points = (0..n * n)
            .map(|k| {
                let (x, y) = (8e-3 * (k % n) as f64, 8e-3 * (k / n) as f64);
                let z = 0.005 * (std::f64::consts::TAU * x / 0.08).sin();
                Vec3::new(x, y, z) + noise * Vec3::new(normal(), normal(), normal())
            })
            .collect();
        let id = |i: usize, j: usize| (j * n + i) as u32;
        let faces = (0..n - 1)
            .flat_map(|j| (0..n - 1).map(move |i| (i, j)))
            .flat_map(|(i, j)| [[id(i, j), id(i + 1, j), id(i + 1, j + 1)], [id(i, j), id(i + 1, j + 1), id(i, j + 1)]])
            .collect();
        (points, faces)
    }

    #[test]
    fn noise_is_told_from_wrinkles() {
        for noise in [2e-4, 5e-4, 1e-3] {
            let (points, faces) = wavy(noise);
            for faces in [&faces[..], &[]] {
                let sigma = of_points(&points, faces).unwrap();
                // The median of 1600 numbers scatters by 3 %; a quadric follows these wrinkles to 0.1 mm.
                assert!((sigma - noise).abs() < 0.12 * noise + 1e-4, "{sigma:e} for {noise:e}");
            }
        }
        assert!(of_points(&wavy(1e-3).0[..10], &[]).is_none());
    }
}
