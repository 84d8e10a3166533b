//! Quasi-static relaxation: many poses at once, each brought to rest in its own lane.
//!
//! A limited-memory BFGS iteration on *forces*. With a frozen stiffness the forces of a measured fabric are not the
//! gradient of any energy, so a line search on energy may refuse every step near rest; this one only asks that the force
//! along the step has not turned around. Where the forces are a gradient both find the same minimum.

use caphy_core::lanes::Frames;
use caphy_core::{Error, Real, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// When to stop and how far to go.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RelaxSettings {
    /// Most iterations. Default 600.
    pub iterations: usize,
    /// Pairs that are remembered. Default 12.
    pub history: usize,
    /// Longest move of a vertex in one iteration [m]. Default 5 mm: below the gap kept from the body, so that nothing jumps
    /// through a limb.
    pub max_move_m: f64,
    /// A frame is at rest when its root-mean-square force per vertex falls below this [N]. Default 2e-5, about one percent of
    /// the weight of one vertex of a shirt.
    pub rest_force_n: f64,
}

impl Default for RelaxSettings {
    fn default() -> Self {
        Self { iterations: 600, history: 12, max_move_m: 5e-3, rest_force_n: 2e-5 }
    }
}

/// How far relaxation came.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RelaxReport {
    /// Iterations made.
    pub iterations: usize,
    /// Root-mean-square force per vertex at the end [N], per frame.
    pub residual_n: Vec<f64>,
    /// Whether each frame is at rest by [`RelaxSettings::rest_force_n`].
    pub at_rest: Vec<bool>,
}

/// One scalar per (block, lane).
type PerLane<T> = Vec<T>;

fn dot<T: Real>(a: &Frames<T>, b: &Frames<T>) -> PerLane<T> {
    let n = a.block_len();
    a.data()
        .par_chunks(n)
        .zip(b.data().par_chunks(n))
        .flat_map_iter(|(a, b)| {
            let mut sums = vec![T::zero(); T::LANES];
            for (a, b) in a.chunks_exact(T::LANES).zip(b.chunks_exact(T::LANES)) {
                for lane in 0..T::LANES {
                    sums[lane] += a[lane] * b[lane];
                }
            }
            sums
        })
        .collect()
}

/// y += c·x with a factor per lane.
fn add_scaled<T: Real>(y: &mut Frames<T>, factors: &[T], x: &Frames<T>) {
    let n = y.block_len();
    y.data_mut().par_chunks_mut(n).zip(x.data().par_chunks(n)).zip(factors.par_chunks(T::LANES)).for_each(
        |((y, x), factors)| {
            for (y, x) in y.chunks_exact_mut(T::LANES).zip(x.chunks_exact(T::LANES)) {
                for lane in 0..T::LANES {
                    y[lane] += factors[lane] * x[lane];
                }
            }
        },
    );
}

fn scale<T: Real>(y: &mut Frames<T>, factors: &[T]) {
    let n = y.block_len();
    y.data_mut().par_chunks_mut(n).zip(factors.par_chunks(T::LANES)).for_each(|(y, factors)| {
        for y in y.chunks_exact_mut(T::LANES) {
            for lane in 0..T::LANES {
                y[lane] *= factors[lane];
            }
        }
    });
}

/// Longest vertex move per lane [m].
fn longest<T: Real>(d: &Frames<T>) -> PerLane<T> {
    let n = d.block_len();
    d.data()
        .par_chunks(n)
        .flat_map_iter(|d| {
            let mut most = vec![T::zero(); T::LANES];
            for v in d.chunks_exact(3 * T::LANES) {
                for lane in 0..T::LANES {
                    let (x, y, z) = (v[lane], v[T::LANES + lane], v[2 * T::LANES + lane]);
                    most[lane] = most[lane].max(x * x + y * y + z * z);
                }
            }
            most.into_iter().map(|m| m.sqrt()).collect::<Vec<_>>()
        })
        .collect()
}

struct Pair<T> {
    s: Frames<T>,
    y: Frames<T>,
    /// 1/(s·y) per lane; 0 where the pair has no positive curvature and is left out.
    rho: PerLane<T>,
}

/// Brings every frame to rest. `gradient(x, g)` overwrites `g` with minus the force [N]; `progress` hears the share done.
///
/// Errors: [`Error::NonFinite`] when the start has no finite force; errors of `gradient`.
pub fn relax<T: Real>(
    x: &mut Frames<T>,
    settings: &RelaxSettings,
    mut gradient: impl FnMut(&Frames<T>, &mut Frames<T>) -> Result<()>,
    progress: &dyn Fn(f64),
) -> Result<RelaxReport> {
    let lanes = x.blocks() * T::LANES;
    let vertices = T::of(x.vertices().max(1) as f64);
    let mut g = Frames::zeros(x.blocks(), x.vertices(), x.lanes_used());
    gradient(x, &mut g)?;
    Error::check_finite("force at the start of relaxation", g.data())?;
    let mut history: Vec<Pair<T>> = Vec::new();
    let max_move = T::of(settings.max_move_m);
    let rest = T::of(settings.rest_force_n);
    let residual = |g: &Frames<T>| -> PerLane<T> { dot(g, g).into_iter().map(|s| (s / vertices).sqrt()).collect() };
    let mut done = 0;
    for iteration in 0..settings.iterations {
        done = iteration;
        if residual(&g).iter().all(|&r| r <= rest) {
            break;
        }
        if iteration % 10 == 0 {
            progress(iteration as f64 / settings.iterations as f64);
        }
        let mut d = direction(&g, &history);
        // Start gently, and fall back to the force where the direction does not go with it.
        let along = dot(&d, &g);
        let force_only: Vec<bool> =
            along.iter().map(|&a| history.is_empty() || !a.is_finite() || a >= T::zero()).collect();
        if force_only.iter().any(|&f| f) {
            let reach = longest(&g);
            let keep: Vec<T> = force_only.iter().map(|&f| if f { T::zero() } else { T::one() }).collect();
            // A non-finite direction times zero would stay non-finite: overwrite instead.
            let n = d.block_len();
            for (block, chunk) in d.data_mut().chunks_mut(n).enumerate() {
                for values in chunk.chunks_exact_mut(T::LANES) {
                    for lane in 0..T::LANES {
                        if keep[block * T::LANES + lane] == T::zero() {
                            values[lane] = T::zero();
                        }
                    }
                }
            }
            let gentle: Vec<T> =
                (0..lanes)
                    .map(|l| {
                        if force_only[l] && reach[l] > T::zero() {
                            -max_move * T::of(0.05) / reach[l]
                        } else {
                            T::zero()
                        }
                    })
                    .collect();
            add_scaled(&mut d, &gentle, &g);
        }
        let shorten: Vec<T> =
            longest(&d).into_iter().map(|reach| if reach > max_move { max_move / reach } else { T::one() }).collect();
        scale(&mut d, &shorten);

        let slope = dot(&d, &g);
        let mut alpha = vec![T::one(); lanes];
        let mut next;
        let mut g_next = Frames::zeros(x.blocks(), x.vertices(), x.lanes_used());
        let mut tries = 0;
        loop {
            next = x.clone();
            add_scaled(&mut next, &alpha, &d);
            gradient(&next, &mut g_next)?;
            let ahead = dot(&d, &g_next);
            tries += 1;
            let mut again = false;
            for l in 0..lanes {
                // The force along the step may fall or gently reverse, but not push back harder than it pulled.
                let overshoot = !ahead[l].is_finite() || ahead[l] > -slope[l] * T::of(0.5);
                if overshoot && alpha[l] > T::zero() {
                    // A frame that cannot move finitely stays where it is.
                    alpha[l] = if tries >= 12 && !ahead[l].is_finite() { T::zero() } else { alpha[l] * T::of(0.4) };
                    again = true;
                }
            }
            if !again || tries >= 14 {
                break;
            }
        }
        let mut s = d;
        scale(&mut s, &alpha);
        let mut y = g_next.clone();
        add_scaled(&mut y, &vec![-T::one(); lanes], &g);
        let (sy, ss, yy) = (dot(&s, &y), dot(&s, &s), dot(&y, &y));
        let rho = (0..lanes)
            .map(|l| {
                let enough = T::of(1e-8) * (ss[l] * yy[l]).sqrt();
                if sy[l].is_finite() && sy[l] > enough && sy[l] > T::zero() { T::one() / sy[l] } else { T::zero() }
            })
            .collect();
        if history.len() == settings.history.max(1) {
            history.remove(0);
        }
        history.push(Pair { s, y, rho });
        *x = next;
        g = g_next;
        done = iteration + 1;
    }
    progress(1.0);
    let all = residual(&g);
    let per_frame = |f: usize| all[(f / x.lanes_used()) * T::LANES + f % x.lanes_used()];
    let residual_n: Vec<f64> = (0..x.frames()).map(|f| per_frame(f).to_f64()).collect();
    let at_rest = residual_n.iter().map(|&r| r <= settings.rest_force_n).collect();
    Ok(RelaxReport { iterations: done, residual_n, at_rest })
}

/// −H⁻¹g by the two-loop recursion, each lane with its own scalars.
fn direction<T: Real>(g: &Frames<T>, history: &[Pair<T>]) -> Frames<T> {
    let lanes = g.blocks() * T::LANES;
    let mut q = g.clone();
    let mut alphas: Vec<PerLane<T>> = Vec::with_capacity(history.len());
    for pair in history.iter().rev() {
        let sq = dot(&pair.s, &q);
        let alpha: Vec<T> = (0..lanes).map(|l| pair.rho[l] * sq[l]).collect();
        let minus: Vec<T> = alpha.iter().map(|&a| -a).collect();
        add_scaled(&mut q, &minus, &pair.y);
        alphas.push(alpha);
    }
    if let Some(last) = history.last() {
        let yy = dot(&last.y, &last.y);
        let gamma: Vec<T> =
            (0..lanes)
                .map(|l| {
                    if last.rho[l] > T::zero() && yy[l] > T::zero() {
                        T::one() / (last.rho[l] * yy[l])
                    } else {
                        T::one()
                    }
                })
                .collect();
        scale(&mut q, &gamma);
    }
    for (pair, alpha) in history.iter().zip(alphas.iter().rev()) {
        let yq = dot(&pair.y, &q);
        let factors: Vec<T> = (0..lanes)
            .map(|l| if pair.rho[l] > T::zero() { alpha[l] - pair.rho[l] * yq[l] } else { T::zero() })
            .collect();
        add_scaled(&mut q, &factors, &pair.s);
    }
    scale(&mut q, &vec![-T::one(); lanes]);
    q
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hanging chain of springs: vertex 0 is held, each link pulls with stiffness k, gravity pulls down.
    fn chain(k: f64) -> impl FnMut(&Frames<f64>, &mut Frames<f64>) -> Result<()> {
        move |x, g| {
            g.clear();
            for lane in 0..x.lanes_used() {
                let p = x.frame(0, lane);
                let mut force = vec![caphy_core::Vec3::new(0.0, 0.001 * 9.81, 0.0); p.len()];
                for i in 1..p.len() {
                    let d = p[i] - p[i - 1];
                    let pull = d * (k * (1.0 - 0.01 / d.norm()));
                    force[i] += pull;
                    force[i - 1] -= pull;
                }
                force[0] = caphy_core::Vec3::zeros();
                g.set_frame(0, lane, &force)?;
            }
            Ok(())
        }
    }

    #[test]
    fn a_chain_hangs_by_its_closed_form_in_every_lane() {
        let n = 6;
        let mut x = Frames::<f64>::zeros(1, n, 3);
        for lane in 0..3 {
            for v in 0..n {
                let sideways = 0.012 * v as f64;
                x.set(0, lane, v, &caphy_core::Vec3::new(sideways, 0.0, 0.002 * lane as f64 * v as f64));
            }
        }
        let settings = RelaxSettings { iterations: 3000, rest_force_n: 1e-9, ..Default::default() };
        let report = relax(&mut x, &settings, chain(50.0), &|_| {}).unwrap();
        assert!(report.at_rest.iter().all(|&r| r), "{report:?}");
        for lane in 0..3 {
            // Link i carries the weight of the vertices below it: stretch = (n - i) m g / k.
            let mut y = 0.0;
            for v in 1..n {
                y -= 0.01 + (n - v) as f64 * 0.001 * 9.81 / 50.0;
                assert!((x.get(0, lane, v).y - y).abs() < 1e-6, "lane {lane} vertex {v}");
            }
        }
    }

    #[test]
    fn a_start_without_finite_force_is_refused() {
        let mut x = Frames::<f64>::zeros(1, 2, 1);
        let nan = |_: &Frames<f64>, g: &mut Frames<f64>| {
            g.data_mut()[0] = f64::NAN;
            Ok(())
        };
        assert!(relax(&mut x, &RelaxSettings::default(), nan, &|_| {}).is_err());
    }
}
