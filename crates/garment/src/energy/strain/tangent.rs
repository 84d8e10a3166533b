//! Second derivatives of the strain energy, its lagged form, and its derivatives by the fabric's parameters.

use super::{Held, Strain, Triangle};
use crate::energy::tangent::{EnergyTangent, Stencil, Tangent, clamp_2x2, only_frame};
use crate::energy::{EnergyTerm, State};
use caphy_core::material::{MaterialModel, MembraneBlock};
use caphy_core::{Error, Result, Vec3};
use nalgebra::{Matrix3, Matrix4, SymmetricEigen, Vector4};
use rayon::prelude::*;

/// Triangles that travel through the material in one call.
const BATCH: usize = 256;
/// Step in G of differenced stresses, for materials that offer no tangent: the error of a central difference is then about
/// 1e-10 of the stress's scale.
const GREEN_STEP: f64 = 1e-5;

/// See [`convex`].
const LEAST_RESISTANCE: f64 = 0.3;

/// Deformed columns F = [fu, fv] of a triangle (Eq. 3).
fn deformation(t: &Triangle<f64>, x: &[[f64; 3]]) -> [Vec3; 2] {
    let [a, b, c] = t.vertices.map(|v| Vec3::from(x[v as usize]));
    let (d1, d2) = (b - a, c - a);
    let [m00, m01, m10, m11] = t.dm_inverse;
    [d1 * m00 + d2 * m10, d1 * m01 + d2 * m11]
}

/// G = ½(FᵀF − I) as [Guu, Gvv, Guv] (Eq. 4).
fn green([fu, fv]: &[Vec3; 2]) -> [f64; 3] {
    [0.5 * (fu.norm_squared() - 1.0), 0.5 * (fv.norm_squared() - 1.0), 0.5 * fu.dot(fv)]
}

/// Weights of the corners in fu and in fv: fu = Σ wu_i x_i.
fn corner_weights(t: &Triangle<f64>) -> [[f64; 2]; 3] {
    let [m00, m01, m10, m11] = t.dm_inverse;
    [[-(m00 + m10), -(m01 + m11)], [m00, m01], [m10, m11]]
}

/// What the material says at a list of triangles, structure of arrays.
struct Answer {
    stress: Vec<f64>,
    slope: Vec<f64>,
}

/// Stress and its derivative by G, `total` or with held stiffness; differenced where the material offers none.
fn answer(material: &dyn MaterialModel, green: &[f64], total: bool) -> Result<Answer> {
    let n = green.len() / 3;
    let facts = material.describe();
    let mut out = Answer { stress: vec![0.0; 3 * n], slope: vec![0.0; 9 * n] };
    let offered = if total { facts.offers.tangent_total } else { facts.offers.tangent_held };
    let mut block = MembraneBlock::new(n, green);
    block.stress = (&mut out.stress[..]).into();
    if offered {
        let slope = (&mut out.slope[..]).into();
        if total {
            block.tangent_total = slope;
        } else {
            block.tangent_held = slope;
        }
    } else if !total && facts.stiffness_frozen {
        return Err(Error::unsupported("the tangent with held stiffness, which frozen stiffness needs", facts.name));
    }
    material.membrane((&mut block).into())?;
    if !offered {
        let mut moved = green.to_vec();
        let mut side = |k: usize, h: f64| -> Result<Vec<f64>> {
            moved.copy_from_slice(green);
            moved[k * n..][..n].iter_mut().for_each(|g| *g += h);
            let mut stress = vec![0.0; 3 * n];
            let mut block = MembraneBlock::new(n, &moved);
            block.stress = (&mut stress[..]).into();
            material.membrane((&mut block).into())?;
            Ok(stress)
        };
        for k in 0..3 {
            let (ahead, behind) = (side(k, GREEN_STEP)?, side(k, -GREEN_STEP)?);
            for row in 0..3 {
                for i in 0..n {
                    out.slope[(3 * row + k) * n + i] = (ahead[row * n + i] - behind[row * n + i]) / (2.0 * GREEN_STEP);
                }
            }
        }
    }
    Ok(out)
}

/// Second derivative of one triangle's A ψ(G) by its corners to `out` `[9][9]`.
///
/// With b_k = dG_k/d(fu, fv): d²ψ = Σ b_i (W C)_ij b_jᵀ + S ⊗ I, W = diag(1, 1, 2) because Guv counts twice.
fn block(
    t: &Triangle<f64>,
    f: &[Vec3; 2],
    stress: [f64; 3],
    slope: &[f64; 9],
    area: f64,
    kind: Tangent,
    out: &mut [f64],
) {
    let d = Matrix3::from_fn(|i, j| if i == 2 { 2.0 } else { 1.0 } * slope[3 * i + j]);
    let h = match kind {
        Tangent::Exact => assemble(f, stress, &d),
        Tangent::Projected => projected(f, stress, &((d + d.transpose()) * 0.5)),
    };
    let w = corner_weights(t);
    for i in 0..3 {
        for j in 0..3 {
            let mut b = Matrix3::zeros();
            for p in 0..2 {
                for q in 0..2 {
                    b += h[p][q] * (area * w[i][p] * w[j][q]);
                }
            }
            for r in 0..3 {
                for c in 0..3 {
                    out[(3 * i + r) * 9 + 3 * j + c] = b[(r, c)];
                }
            }
        }
    }
}

/// Blocks [u, v][u, v] of the second derivative by F's columns.
fn assemble([fu, fv]: &[Vec3; 2], [suu, svv, suv]: [f64; 3], d: &Matrix3<f64>) -> [[Matrix3<f64>; 2]; 2] {
    let b = [[*fu, Vec3::zeros()], [Vec3::zeros(), *fv], [fv * 0.5, fu * 0.5]];
    let s = [[suu, suv], [suv, svv]];
    std::array::from_fn(|p| {
        std::array::from_fn(|q| {
            let mut out = Matrix3::identity() * s[p][q];
            for i in 0..3 {
                // One weighted row, then one outer product per i.
                let row = (0..3).fold(Vec3::zeros(), |sum, j| sum + b[j][q] * d[(i, j)]);
                out += b[i][p] * row.transpose();
            }
            out
        })
    })
}

/// The same without negative eigenvalues. Out of the plane the matrix is S alone (2 × 2, closed form), in the plane 4 × 4;
/// the two do not couple because both columns of F lie in the plane.
fn projected(f: &[Vec3; 2], stress: [f64; 3], d: &Matrix3<f64>) -> [[Matrix3<f64>; 2]; 2] {
    let [suu, svv, suv] = stress;
    let tension = suu >= 0.0 && svv >= 0.0 && suu * svv >= suv * suv;
    if tension && semidefinite(d) {
        return assemble(f, stress, d);
    }
    let [t1, t2, n] = plane(f);
    let column = |c: &Vec3| [t1.dot(c), t2.dot(c)];
    let (u, v) = (column(&f[0]), column(&f[1]));
    let b = [
        Vector4::new(u[0], u[1], 0.0, 0.0),
        Vector4::new(0.0, 0.0, v[0], v[1]),
        Vector4::new(0.5 * v[0], 0.5 * v[1], 0.5 * u[0], 0.5 * u[1]),
    ];
    let mut inside = Matrix4::from_fn(|i, j| {
        let s = [[suu, suv], [suv, svv]][i / 2][j / 2];
        if i % 2 == j % 2 { s } else { 0.0 }
    });
    for i in 0..3 {
        for j in 0..3 {
            inside += b[i] * b[j].transpose() * d[(i, j)];
        }
    }
    let inside = clamp_4x4(inside);
    let [a, off, c] = clamp_2x2([suu, suv, svv]);
    let outside = [[a, off], [off, c]];
    let basis = [t1, t2];
    std::array::from_fn(|p| {
        std::array::from_fn(|q| {
            let mut out = n * n.transpose() * outside[p][q];
            for i in 0..2 {
                for j in 0..2 {
                    out += basis[i] * basis[j].transpose() * inside[(2 * p + i, 2 * q + j)];
                }
            }
            out
        })
    })
}

/// Which tangent to hold: the symmetric part of the whole one where that resists every strain at least as much as
/// [`LEAST_RESISTANCE`] of the one with held stiffness, else the latter. (W C is what must be symmetric, W = diag(1, 1, 2),
/// because Guv counts twice.)
fn convex(whole: [f64; 9], held: [f64; 9]) -> [f64; 9] {
    let weighted = |c: &[f64; 9]| Matrix3::from_fn(|i, j| if i == 2 { 2.0 } else { 1.0 } * c[3 * i + j]);
    let (w, h) = (weighted(&whole), weighted(&held));
    let symmetric = (w + w.transpose()) * 0.5;
    if !semidefinite(&(symmetric - (h + h.transpose()) * (0.5 * LEAST_RESISTANCE))) {
        return held;
    }
    std::array::from_fn(|k| symmetric[(k / 3, k % 3)] / if k / 3 == 2 { 2.0 } else { 1.0 })
}

/// All principal minors of a symmetric matrix are non-negative up to rounding.
fn semidefinite(d: &Matrix3<f64>) -> bool {
    let scale = d.amax();
    let least = -1e-14 * scale;
    (0..3).all(|i| d[(i, i)] >= least)
        && [(0, 1), (0, 2), (1, 2)].iter().all(|&(i, j)| d[(i, i)] * d[(j, j)] - d[(i, j)] * d[(i, j)] >= least * scale)
        && d.determinant() >= least * scale * scale
}

fn clamp_4x4(m: Matrix4<f64>) -> Matrix4<f64> {
    // No convergence is needed for safety: what comes back is checked by the factorisation.
    let Some(eigen) = SymmetricEigen::try_new(m, f64::EPSILON, 200) else { return Matrix4::zeros() };
    let mut out = Matrix4::zeros();
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > 0.0 {
            out += vector * vector.transpose() * *value;
        }
    }
    out
}

/// Two directions that span F's columns (any two for a collapsed triangle) and the normal.
fn plane([fu, fv]: &[Vec3; 2]) -> [Vec3; 3] {
    let (long, short) = if fu.norm_squared() >= fv.norm_squared() { (fu, fv) } else { (fv, fu) };
    let t1 = long.try_normalize(0.0).unwrap_or_else(Vec3::x);
    let least = if t1.x.abs() <= t1.y.abs() && t1.x.abs() <= t1.z.abs() {
        Vec3::x()
    } else if t1.y.abs() <= t1.z.abs() {
        Vec3::y()
    } else {
        Vec3::z()
    };
    let rest = short - t1 * t1.dot(short);
    let rest = if rest.norm() > 1e-12 * long.norm() { rest } else { least - t1 * t1.dot(&least) };
    // Twice, because the first difference cancels for nearly parallel columns.
    let rest = rest - t1 * t1.dot(&rest);
    let t2 = rest.try_normalize(0.0).unwrap_or(least);
    [t1, t2, t1.cross(&t2)]
}

impl Strain<f64> {
    fn real(&self) -> &[Triangle<f64>] {
        &self.triangles[..self.count]
    }

    /// Green strain of a batch, `[3][batch]`, and F.
    fn measured(batch: &[Triangle<f64>], x: &[[f64; 3]]) -> (Vec<f64>, Vec<[Vec3; 2]>) {
        let n = batch.len();
        let mut g = vec![0.0; 3 * n];
        let f: Vec<[Vec3; 2]> = batch.iter().map(|t| deformation(t, x)).collect();
        for (i, f) in f.iter().enumerate() {
            for (k, value) in green(f).into_iter().enumerate() {
                g[k * n + i] = value;
            }
        }
        (g, f)
    }
    fn locate_in(batch: usize, size: usize) -> impl Fn(Error) -> Error {
        move |error| {
            let Error::NonFinite { what, index, value } = error else { return error };
            let triangle = batch * BATCH + index % size.max(1);
            Error::numerics(
                "energy `strain`",
                format!("{what} is {value} at triangle {triangle}"),
                "go back to the last good state with a smaller step, and check that the template is in metres",
            )
        }
    }

    /// Holds the stiffness of every triangle as it is at these positions: from now on S(G) = S₀ + C₀ (G − G₀) and ψ its integral, a
    /// true gradient, until [`Strain::release`]. At these positions the force is the material's own. C₀ is the
    /// tangent with held stiffness, or the symmetric part of the whole one where that is nearly as stiff: what frozen
    /// stiffness leaves out of the energy its forces still feel, and steps that know it need not be told again and again.
    ///
    /// # Errors
    /// As [`EnergyTangent::tangents`].
    pub fn hold(&mut self, state: &State<'_, f64>) -> Result<()> {
        let x = only_frame("strain", state.positions)?;
        let mut held = Vec::with_capacity(self.triangles.len());
        let frozen = self.material.describe().stiffness_frozen;
        for (b, batch) in self.triangles.chunks(BATCH).enumerate() {
            let n = batch.len();
            let (g, _) = Self::measured(batch, &x);
            let mut density = vec![0.0; n];
            let mut block = MembraneBlock::new(n, &g);
            block.energy = (&mut density[..]).into();
            self.material.membrane((&mut block).into()).map_err(Self::locate_in(b, n))?;
            let answer_of = |total| answer(&*self.material, &g, total).map_err(Self::locate_in(b, n));
            let whole = answer_of(true)?;
            // Without it, all of the tangent is the derivative of an energy already.
            let part = if frozen { Some(answer_of(false)?) } else { None };
            held.extend((0..n).map(|i| Held {
                green: [0, 1, 2].map(|k| g[k * n + i]),
                energy: density[i],
                stress: [0, 1, 2].map(|k| whole.stress[k * n + i]),
                slope: {
                    let of = |answer: &Answer| std::array::from_fn(|k| answer.slope[k * n + i]);
                    part.as_ref().map_or_else(|| of(&whole), |part| convex(of(&whole), of(part)))
                },
            }));
        }
        self.held = Some(held);
        Ok(())
    }
    /// Asks the material again.
    pub fn release(&mut self) {
        self.held = None;
    }

    /// vᵀ ∂(gradient)/∂Θ_j for every native parameter j: the adjoint of [`Strain::add_by_direction`]. `v` [m], shape [vertex][3].
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a material without parameter derivatives, [`Error::Length`].
    pub fn by_parameter(&self, state: &State<'_, f64>, weight: f64, v: &[f64]) -> Result<Vec<f64>> {
        let x = only_frame("strain", state.positions)?;
        Error::check_length("vector of the strain's parameter derivative", 3 * self.vertex_count, v.len())?;
        let p = self.material.parameters().len();
        let mut out = vec![0.0; p];
        for (b, batch) in self.real().chunks(BATCH).enumerate() {
            let n = batch.len();
            let (f, slopes) = self.stress_by_parameter(b, batch, &x, p)?;
            for (i, t) in batch.iter().enumerate() {
                let [gu, gv] = directional(t, v);
                let [fu, fv] = &f[i];
                let along = [fu.dot(&gu), fv.dot(&gv), fu.dot(&gv) + fv.dot(&gu)];
                for (j, out) in out.iter_mut().enumerate() {
                    let s = |k: usize| slopes[(3 * j + k) * n + i];
                    *out += weight * t.area * (s(0) * along[0] + s(1) * along[1] + s(2) * along[2]);
                }
            }
        }
        Ok(out)
    }
    /// Adds ∂(gradient)/∂Θ · direction [N] to `out`, shape [vertex][3]; `direction` in the parameters' units.
    ///
    /// # Errors
    /// As [`Strain::by_parameter`].
    pub fn add_by_direction(
        &self,
        state: &State<'_, f64>,
        weight: f64,
        direction: &[f64],
        out: &mut [f64],
    ) -> Result<()> {
        let x = only_frame("strain", state.positions)?;
        let p = self.material.parameters().len();
        Error::check_length("parameter direction", p, direction.len())?;
        Error::check_length("parameter derivative of the strain's gradient", 3 * self.vertex_count, out.len())?;
        for (b, batch) in self.real().chunks(BATCH).enumerate() {
            let n = batch.len();
            let (f, slopes) = self.stress_by_parameter(b, batch, &x, p)?;
            for (i, t) in batch.iter().enumerate() {
                let s = |k: usize| (0..p).map(|j| direction[j] * slopes[(3 * j + k) * n + i]).sum::<f64>();
                let [suu, svv, suv] = [s(0), s(1), s(2)];
                let [fu, fv] = &f[i];
                let columns = [fu * suu + fv * suv, fu * suv + fv * svv];
                for (vertex, w) in t.vertices.iter().zip(corner_weights(t)) {
                    let g = (columns[0] * w[0] + columns[1] * w[1]) * (weight * t.area);
                    out[3 * *vertex as usize..][..3].iter_mut().zip(g.iter()).for_each(|(o, g)| *o += g);
                }
            }
        }
        Ok(())
    }
    fn stress_by_parameter(
        &self,
        b: usize,
        batch: &[Triangle<f64>],
        x: &[[f64; 3]],
        p: usize,
    ) -> Result<(Vec<[Vec3; 2]>, Vec<f64>)> {
        let n = batch.len();
        let (g, f) = Self::measured(batch, x);
        let mut slopes = vec![0.0; 3 * p * n];
        let mut block = MembraneBlock::new(n, &g);
        block.stress_by_parameter = (&mut slopes[..]).into();
        self.material.membrane((&mut block).into()).map_err(Self::locate_in(b, n))?;
        Ok((f, slopes))
    }
}

/// Change of F's columns when the vertices move along `v`.
fn directional(t: &Triangle<f64>, v: &[f64]) -> [Vec3; 2] {
    let w = corner_weights(t);
    [0, 1].map(|p| {
        (0..3).fold(Vec3::zeros(), |sum, i| {
            let at = 3 * t.vertices[i] as usize;
            sum + Vec3::new(v[at], v[at + 1], v[at + 2]) * w[i][p]
        })
    })
}

impl EnergyTangent for Strain<f64> {
    fn stencil(&self) -> Stencil {
        Stencil { width: 3, vertices: self.real().iter().flat_map(|t| t.vertices).collect() }
    }
    fn tangents(&self, state: &State<'_, f64>, weight: f64, kind: Tangent, blocks: &mut [f64]) -> Result<()> {
        let x = only_frame(self.name(), state.positions)?;
        Error::check_length("vertices of the garment in strain", self.vertex_count, x.len())?;
        Error::check_length("second derivatives of strain", 81 * self.count, blocks.len())?;
        // Frozen stiffness steps as if it were constant; its true derivative has the stiffness's own.
        let total = kind == Tangent::Exact || !self.material.describe().stiffness_frozen;
        let results: Vec<Result<()>> = self
            .real()
            .par_chunks(BATCH)
            .zip(blocks.par_chunks_mut(81 * BATCH))
            .enumerate()
            .map(|(b, (batch, out))| {
                let n = batch.len();
                let (g, f) = Self::measured(batch, &x);
                let held = self.held.as_ref().map(|held| &held[b * BATCH..][..n]);
                let answer = match held {
                    Some(_) => None,
                    None => Some(answer(&*self.material, &g, total).map_err(Self::locate_in(b, n))?),
                };
                for (i, (t, out)) in batch.iter().zip(out.chunks_exact_mut(81)).enumerate() {
                    let (stress, slope) = match (&answer, held) {
                        (Some(answer), _) => (
                            [0, 1, 2].map(|k| answer.stress[k * n + i]),
                            std::array::from_fn(|k| answer.slope[k * n + i]),
                        ),
                        (None, Some(held)) => (held[i].at([0, 1, 2].map(|k| g[k * n + i])).1, held[i].slope),
                        (None, None) => return Ok(()),
                    };
                    block(t, &f[i], stress, &slope, weight * t.area, kind, out);
                }
                Ok(())
            })
            .collect();
        results.into_iter().collect()
    }
}
