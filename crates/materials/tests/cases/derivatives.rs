//! Tangents, curvature slopes and parameter derivatives against differences, in double precision.

use crate::asking::{FABRICS, folds, hinges, measured, membrane, strains};
use caphy_core::material::MaterialModel;
use caphy_materials::MaterialStvk;
use caphy_materials::measured::{BendingLookup, Form, StiffnessGradient, StretchLookup};

/// Every combination of membrane knobs that can be built.
fn variants(fabric: &str) -> Vec<(String, Box<dyn MaterialModel>)> {
    let mut all = Vec::new();
    for form in [Form::Orthotropic, Form::Isotropic] {
        for (lookup, gradient) in [
            (StretchLookup::Table, StiffnessGradient::Frozen),
            (StretchLookup::Table, StiffnessGradient::Full),
            (StretchLookup::Direct, StiffnessGradient::Frozen),
        ] {
            let model = measured(fabric, |s| {
                s.form = Some(form);
                s.lookup = Some(lookup);
                s.stiffness_gradient = Some(gradient);
            });
            all.push((format!("{fabric} {form:?} {lookup:?} {gradient:?}"), model));
        }
    }
    all
}

/// Strains at least a tenth of a cell away from every table plane and from Guv = 0, so that no stencil meets a kink.
fn inside_cells(count: usize, scale: f64) -> Vec<[f64; 3]> {
    let centred = |x: f64| (0.1..0.9).contains(&(30.0 * x + 30.0).fract());
    let off_plane = |g: &[f64; 3]| centred(g[0] + 0.25) && centred(g[1] + 0.25) && centred(g[2].abs());
    strains(4 * count, scale).into_iter().filter(off_plane).take(count).collect()
}

#[test]
fn held_tangent_is_the_slope_of_the_held_stress() {
    for (name, model) in variants("white-swim-solid") {
        for (g, a) in strains(60, 0.6).iter().zip(membrane::<f64>(model.as_ref(), &strains(60, 0.6))) {
            let [k0, k1, k2, k3] = a.stiffness;
            let held_stress = |g: &[f64; 3]| [k0 * g[0] + k1 * g[1], k1 * g[0] + k2 * g[1], k3 * g[2]];
            for d in 0..3 {
                let h = 1e-3;
                let (mut plus, mut minus) = (*g, *g);
                plus[d] += h;
                minus[d] -= h;
                let (plus, minus) = (held_stress(&plus), held_stress(&minus));
                for c in 0..3 {
                    // Linear in G: the difference is exact but for rounding, 1e-16 k / h.
                    let slope = (plus[c] - minus[c]) / (2.0 * h);
                    assert!((slope - a.held[c][d]).abs() < 1e-10 * (k0 + k1.abs() + k2 + k3), "{name} {g:?}");
                }
            }
        }
    }
}

#[test]
fn total_tangent_is_the_slope_of_the_stress() {
    let h = 1e-6;
    for fabric in ["gray-interlock", "royal-target", "ivory-rib-knit"] {
        for (name, model) in variants(fabric) {
            let mut grid = inside_cells(80, 0.3);
            // The direct lookup has kinks of its own: keep its stencil away from the angle rows and stretch ends.
            if name.contains("Direct") {
                grid.retain(smooth_for_direct);
                assert!(grid.len() > 15, "{}", grid.len());
            }
            for (g, a) in grid.iter().zip(membrane::<f64>(model.as_ref(), &grid)) {
                let size = a.total.as_flattened().iter().fold(1.0f64, |m, t| m.max(t.abs()));
                for d in 0..3 {
                    let moved = [h, -h].map(|step| {
                        let mut moved = *g;
                        moved[d] += step;
                        moved
                    });
                    let s = membrane::<f64>(model.as_ref(), &moved);
                    for c in 0..3 {
                        let slope = (s[0].stress[c] - s[1].stress[c]) / (2.0 * h);
                        // h² S''' (S''' up to 30² k) + 1e-16 S / h: below 1e-7 of the tangent; ten times that.
                        let error = (slope - a.total[c][d]).abs();
                        assert!(error < 1e-6 * size, "{name} {g:?} [{c}][{d}]: {slope} {}", a.total[c][d]);
                    }
                }
            }
        }
    }
}

fn smooth_for_direct(g: &[f64; 3]) -> bool {
    let d = g[0] - g[1];
    let r = d.hypot(2.0 * g[2]);
    let t = 6.0 * ((1.0 + g[0] + g[1] + r).max(0.0).sqrt() - 1.0);
    let p = 4.0 / std::f64::consts::PI * (2.0 * g[2].abs()).atan2(d);
    r > 0.05 && t.abs() > 0.01 && (t - 1.0).abs() > 0.01 && (p - p.round()).abs() > 0.01
}

#[test]
fn full_stress_is_the_slope_of_the_energy_and_frozen_is_declared() {
    let h = 1e-6;
    for (name, model) in variants("tango-red-jet-set") {
        let full = name.contains("Full");
        assert_eq!(model.describe().stiffness_frozen, !full, "{name}");
        let grid = inside_cells(60, 0.3);
        let mut worst = 0.0f64;
        for (g, a) in grid.iter().zip(membrane::<f64>(model.as_ref(), &grid)) {
            let size = a.stress.iter().fold(1e-3f64, |m, s| m.max(s.abs()));
            for c in 0..3 {
                let moved = [h, -h].map(|step| {
                    let mut moved = *g;
                    moved[c] += step;
                    moved
                });
                let w = membrane::<f64>(model.as_ref(), &moved);
                // dψ = … + 2 Suv dGuv
                let slope = (w[0].energy - w[1].energy) / (2.0 * h) / if c == 2 { 2.0 } else { 1.0 };
                worst = worst.max((slope - a.stress[c]).abs() / size);
            }
        }
        if full {
            assert!(worst < 1e-6, "{name}: {worst}");
        } else {
            assert!(worst > 1e-2, "{name}: a frozen stress must differ from the gradient, {worst}");
        }
    }
}

/// Membrane derivatives by parameters: against differences, and against Euler's theorem (S is homogeneous in Θ).
fn parameters_agree(name: &str, model: &dyn MaterialModel, grid: &[[f64; 3]]) {
    let answers = membrane::<f64>(model, grid);
    let values: Vec<f64> = model.parameters().iter().map(|p| p.value).collect();
    for a in &answers {
        for c in 0..3 {
            let sum: f64 = values.iter().zip(&a.by_parameter).map(|(v, d)| v * d[c]).sum();
            let size: f64 = values.iter().zip(&a.by_parameter).map(|(v, d)| (v * d[c]).abs()).sum();
            assert!((sum - a.stress[c]).abs() <= 1e-12 * size + 1e-15, "{name}: {sum} {}", a.stress[c]);
        }
    }
    for q in 0..values.len() {
        // The stress is piecewise linear in Θ: any step is exact unless it moves a node across the clamp, so small.
        let step = 1e-6 * values[q].abs();
        let moved = [step, -step].map(|step| {
            let mut moved = values.clone();
            moved[q] += step;
            membrane::<f64>(model.with_parameters(&moved).unwrap().as_ref(), grid)
        });
        for (i, a) in answers.iter().enumerate() {
            for c in 0..3 {
                let slope = (moved[0][i].stress[c] - moved[1][i].stress[c]) / (2.0 * step);
                // Rounding: 1e-16 S / step.
                let rounding = 1e-15 * a.stiffness.iter().fold(1.0f64, |m, k| m.max(*k)) / step;
                let error = (slope - a.by_parameter[q][c]).abs();
                assert!(error <= 1e-8 + rounding, "{name} parameter {q}: {slope} {}", a.by_parameter[q][c]);
            }
        }
    }
}

#[test]
fn stress_by_parameter_of_every_variant() {
    let grid: Vec<[f64; 3]> = strains(12, 0.25).into_iter().chain([[0.0; 3], [2.0, -3.0, 1.5]]).collect();
    for (name, model) in variants("camel-ponte-roma") {
        parameters_agree(&name, model.as_ref(), &grid);
    }
    parameters_agree("stvk", &MaterialStvk::snug().unwrap(), &grid);
}

#[test]
fn a_negative_entry_has_no_influence_where_the_clamp_is_active() {
    // ivory-rib-knit: c33 is negative at 0° and 67.5°; along u, far inside the table, only row 1 counts.
    let model = measured("ivory-rib-knit", |_| ());
    let a = &membrane::<f64>(model.as_ref(), &[[0.6, 0.0, 0.01]])[0];
    let names: Vec<String> = model.parameters().iter().map(|p| p.name.clone()).collect();
    let place = |name: &str| names.iter().position(|n| n == name).unwrap();
    assert_eq!(a.by_parameter[place("c33[row 1]")], [0.0; 3]);
    assert!(a.by_parameter[place("c11[row 1]")][0] > 0.0);
}

#[test]
fn bending_slopes_and_parameters() {
    for fabric in FABRICS {
        for bending in [BendingLookup::Repaired, BendingLookup::Faithful] {
            let model = measured(fabric, |s| s.bending = Some(bending));
            let repaired = bending == BendingLookup::Repaired;
            // Away from columns, from the clamps and from the fold of |θ − θ_rest|: the slope jumps there.
            let smooth = |h: &crate::asking::Hinge| {
                let turn = if repaired { (h.angle - h.rest).abs() } else { h.angle };
                let s = turn * h.length / (10.0 * h.area);
                let limited = s > 3.99 && s < 4.01;
                !limited && (s > 4.0 || (s - s.round()).abs() > 1e-3 || (!repaired && s < -0.1))
            };
            let grid: Vec<_> = folds(120).into_iter().filter(smooth).collect();
            assert!(grid.len() > 80);
            let values: Vec<f64> = model.parameters().iter().map(|p| p.value).collect();
            for (h, a) in grid.iter().zip(hinges::<f64>(model.as_ref(), &grid)) {
                let step = 1e-7;
                let at = |angle: f64, length: f64| {
                    let moved = crate::asking::Hinge { angle: h.angle + angle, length: h.length + length, ..*h };
                    hinges::<f64>(model.as_ref(), &[moved])[0].stiffness
                };
                let by_angle = (at(step, 0.0) - at(-step, 0.0)) / (2.0 * step);
                let by_length = (at(0.0, step * 0.01) - at(0.0, -step * 0.01)) / (0.02 * step);
                // k is piecewise linear in θ and l: rounding only, 1e-16 k / step.
                assert!((by_angle - a.by_angle).abs() < 1e-6 * by_angle.abs() + 1e-11, "{fabric} {by_angle:e}");
                assert!((by_length - a.by_length).abs() < 1e-6 * by_length.abs() + 1e-9, "{fabric} {by_length:e}");
                // Linear in the entries: Euler's theorem holds to rounding, clamp included.
                let sum: f64 = values.iter().zip(&a.by_parameter).map(|(v, d)| v * d).sum();
                let size: f64 = values.iter().zip(&a.by_parameter).map(|(v, d)| (v * d).abs()).sum();
                assert!((sum - a.stiffness).abs() <= 1e-13 * size, "{fabric}: {sum:e} {:e}", a.stiffness);
                assert!(a.by_parameter[..24].iter().all(|d| *d == 0.0));
            }
        }
    }
    let model = measured("gray-interlock", |_| ());
    let grid = folds(20);
    let values: Vec<f64> = model.parameters().iter().map(|p| p.value).collect();
    let answers = hinges::<f64>(model.as_ref(), &grid);
    for q in 24..values.len() {
        let step = 1e-3 * values[q];
        let mut moved = values.clone();
        moved[q] += step;
        let changed = hinges::<f64>(model.with_parameters(&moved).unwrap().as_ref(), &grid);
        for ((a, b), h) in answers.iter().zip(&changed).zip(&grid) {
            let slope = (b.stiffness - a.stiffness) / step;
            // Exact unless the other side of a seam becomes the smaller one, which folds() excludes for two thirds.
            if h.direction0 == h.direction1 {
                assert!((slope - a.by_parameter[q]).abs() < 1e-9, "{slope} {}", a.by_parameter[q]);
            }
        }
    }
}
