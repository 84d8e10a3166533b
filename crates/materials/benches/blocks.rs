//! Time per triangle-frame and per hinge-frame, blocks of 512, energy and stress wanted (stiffness for hinges).
//! Aims on an AVX-512 machine, f32: stvk 1.2 ns, measured table 8 ns, hinge 3 ns.

use caphy_core::Real;
use caphy_core::material::{HingeBlock, MaterialModel, MaterialReal, MembraneBlock};
use caphy_materials::measured::{MaterialMeasuredSpec, StiffnessGradient, StretchLookup};
use caphy_materials::{MaterialMeasured, MaterialStvk};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

const COUNT: usize = 512;

/// A low-discrepancy sequence in [-1, 1): strains without a pattern that a cache or branch could learn.
fn scattered<T: Real>(count: usize, scale: f64) -> Vec<T> {
    (0..count).map(|i| T::of(scale * ((i as f64 * 0.754_877_666_246_692_8).fract() * 2.0 - 1.0))).collect()
}

fn membrane<T: MaterialReal>(c: &mut Criterion, name: &str, model: &dyn MaterialModel, scale: f64) {
    let green = scattered::<T>(3 * COUNT, scale);
    let (mut energy, mut stress) = (vec![T::zero(); COUNT], vec![T::zero(); 3 * COUNT]);
    let mut group = c.benchmark_group("membrane");
    group.throughput(Throughput::Elements(COUNT as u64));
    group.bench_function(name, |b| {
        b.iter(|| {
            let mut block = MembraneBlock::new(COUNT, &green);
            block.energy = (&mut energy[..]).into();
            block.stress = (&mut stress[..]).into();
            T::membrane(model, &mut block)
        });
    });
}

fn hinge<T: MaterialReal>(c: &mut Criterion, name: &str, model: &dyn MaterialModel) {
    let angle = scattered::<T>(COUNT, 1.0);
    let rest = [T::of(0.1); COUNT];
    let length = [T::of(0.01); COUNT];
    let area = [T::of(1e-4); COUNT];
    let direction = scattered::<T>(2 * COUNT, 0.01);
    let mut stiffness = [T::zero(); COUNT];
    let mut group = c.benchmark_group("hinge");
    group.throughput(Throughput::Elements(COUNT as u64));
    group.bench_function(name, |b| {
        b.iter(|| {
            let mut block = HingeBlock {
                count: COUNT,
                angle: (&angle[..]).into(),
                angle_rest: (&rest[..]).into(),
                length: (&length[..]).into(),
                area: (&area[..]).into(),
                direction0: (&direction[..]).into(),
                direction1: (&direction[..]).into(),
                stiffness: (&mut stiffness[..]).into(),
                stiffness_by_angle: Default::default(),
                stiffness_by_length: Default::default(),
                stiffness_by_parameter: Default::default(),
            };
            T::hinge(model, &mut block)
        });
    });
}

fn gray(change: impl Fn(&mut MaterialMeasuredSpec)) -> MaterialMeasured {
    let mut spec = MaterialMeasuredSpec::new("gray-interlock");
    change(&mut spec);
    spec.build_measured().expect("a shipped fabric builds")
}

fn blocks(c: &mut Criterion) {
    let stvk = MaterialStvk::snug().expect("valid constants");
    let table = gray(|_| ());
    let direct = gray(|s| s.lookup = Some(StretchLookup::Direct));
    let full = gray(|s| s.stiffness_gradient = Some(StiffnessGradient::Full));
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
