//! Time per triangle-frame and per hinge-frame in blocks as the garment's energies call them (16 elements in every lane: 256
//! values in f32, 128 in f64), energy and stress wanted (stiffness for hinges).
//!
//! Aims on an AVX-512 machine, f32: stvk 1.2 ns, measured table 8 ns, hinge 3 ns; twice that with
//! `RUSTFLAGS="--cfg caphy_no_avx512"`. The baseline of each is the same code with `RUSTFLAGS="--cfg caphy_no_simd"`.

use caphy_core::Real;
use caphy_core::material::{HingeBlock, MaterialModel, MaterialReal, MaterialSpec, MembraneBlock};
use caphy_materials::measured::{MaterialMeasuredSpec, StiffnessGradient, StretchLookup};
use caphy_materials::{MaterialMeasured, MaterialNeoHookeanSpec, MaterialStvk};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

/// Elements of a call in the garment's energies, times the lanes.
fn count<T: Real>() -> usize {
    16 * T::LANES
}

/// A low-discrepancy sequence in [-1, 1): strains without a pattern that a cache or branch could learn.
fn scattered<T: Real>(count: usize, scale: f64) -> Vec<T> {
    (0..count).map(|i| T::of(scale * ((i as f64 * 0.754_877_666_246_692_8).fract() * 2.0 - 1.0))).collect()
}

fn membrane<T: MaterialReal>(c: &mut Criterion, name: &str, model: &dyn MaterialModel, scale: f64) {
    let count = count::<T>();
    let green = scattered::<T>(3 * count, scale);
    let (mut energy, mut stress) = (vec![T::zero(); count], vec![T::zero(); 3 * count]);
    let mut group = c.benchmark_group("membrane");
    group.throughput(Throughput::Elements(count as u64));
    group.bench_function(name, |b| {
        b.iter(|| {
            let mut block = MembraneBlock::new(count, &green);
            block.energy = (&mut energy[..]).into();
            block.stress = (&mut stress[..]).into();
            T::membrane(model, &mut block)
        });
    });
}

fn hinge<T: MaterialReal>(c: &mut Criterion, name: &str, model: &dyn MaterialModel) {
    let count = count::<T>();
    let angle = scattered::<T>(count, 1.0);
    let (rest, length, area) = (vec![T::of(0.1); count], vec![T::of(0.01); count], vec![T::of(1e-4); count]);
    let direction = scattered::<T>(2 * count, 0.01);
    let mut stiffness = vec![T::zero(); count];
    let mut group = c.benchmark_group("hinge");
    group.throughput(Throughput::Elements(count as u64));
    group.bench_function(name, |b| {
        b.iter(|| {
            let mut block = HingeBlock::new(count, [&angle, &rest, &length, &area], [&direction, &direction]);
            block.stiffness = (&mut stiffness[..]).into();
            T::hinge(model, &mut block)
        });
    });
}

fn gray(change: impl Fn(&mut MaterialMeasuredSpec)) -> MaterialMeasured {
    let mut spec = MaterialMeasuredSpec::new("gray-interlock");
    change(&mut spec);
    spec.build_measured().expect("a shipped fabric builds")
}

fn neo_hookean() -> Box<dyn MaterialModel> {
    let text = "lambda_n_per_m = 20.9\nmu_n_per_m = 11.1";
    let spec: MaterialNeoHookeanSpec = toml::from_str(text).expect("a table");
    MaterialSpec::build(&spec).expect("valid constants")
}

fn blocks(c: &mut Criterion) {
    let stvk = MaterialStvk::snug().expect("valid constants");
    let table = gray(|_| ());
    let direct = gray(|s| s.lookup = Some(StretchLookup::Direct));
    let full = gray(|s| s.stiffness_gradient = Some(StiffnessGradient::Full));
    let neo = neo_hookean();
    membrane::<f32>(c, "neo_hookean (derived) f32", &*neo, 0.1);
    membrane::<f64>(c, "neo_hookean (derived) f64", &*neo, 0.1);
    membrane::<f32>(c, "stvk f32", &stvk, 0.1);
    membrane::<f64>(c, "stvk f64", &stvk, 0.1);
    membrane::<f32>(c, "table f32, strain 0.1", &table, 0.1);
    membrane::<f32>(c, "table f32, strain 1", &table, 1.0);
    membrane::<f64>(c, "table f64, strain 0.1", &table, 0.1);
    membrane::<f32>(c, "table full f32, strain 0.1", &full, 0.1);
    membrane::<f32>(c, "direct f32, strain 0.1", &direct, 0.1);
    hinge::<f32>(c, "measured f32", &table);
    hinge::<f64>(c, "measured f64", &table);
    let values: Vec<f64> = table.parameters().iter().map(|p| p.value * 1.01).collect();
    c.bench_function("table rebuild", |b| b.iter(|| table.with_parameters(&values)));
}

criterion_group!(benches, blocks);
criterion_main!(benches);
