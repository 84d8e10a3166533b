//! Posing 80 frames of a body of 10475 vertices and 55 joints, every joint turned, one thread; and loading its file.
//!
//! Aims on an AVX-512 machine: 25 ms without pose correctives, 50 ms with 486 of them, a third of that for 3500 vertices. The
//! baseline in the same run is one `forward` (f64) per frame.

#[path = "../tests/smplx/generated.rs"]
mod generated;

use caphy_bodymodel::smplx::{BodySmplx, SmplxOptions, load};
use caphy_core::body::BodyModel;
use caphy_core::lanes::Frames;
use criterion::{Criterion, criterion_group, criterion_main};
use generated::{Layout, frames};
use std::hint::black_box;
use std::path::Path;

const VERTICES: usize = 10475;
const FRAMES: usize = 80;
/// Vertices near a T-shirt.
const NEAR: usize = 3500;

fn one_thread() -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread")
}

fn body(correctives: bool) -> BodySmplx {
    let layout = Layout { correctives, columns: 20, ..Layout::smplx(VERTICES) };
    load(Path::new("generated.npz"), layout.file().stored(), &SmplxOptions::default()).expect("a sound file")
}

fn posing(c: &mut Criterion) {
    let pool = one_thread();
    let frames = frames(55, FRAMES);
    // Runs of 35 in every 105: neither contiguous nor without any neighbours.
    let near: Vec<u32> = (0..VERTICES as u32).filter(|v| v % 105 < 35).chain(0..).take(NEAR).collect();
    for (name, correctives) in [("no correctives", false), ("486 correctives", true)] {
        let body = body(correctives);
        let mut group = c.benchmark_group(format!("posing 80 frames, {name}"));
        group.sample_size(20);
        for (what, subset) in [("lanes, all vertices", None), ("lanes, 3500 vertices", Some(&near[..]))] {
            let mut out = Frames::<f32>::zeros(FRAMES / 16, subset.map_or(VERTICES, <[u32]>::len), 16);
            group.bench_function(what, |b| {
                pool.install(|| b.iter(|| body.forward_frames(&frames, subset, &mut out).expect("sound parameters")));
            });
        }
        group.bench_function("baseline: forward per frame, all vertices", |b| {
            pool.install(|| {
                b.iter(|| frames.iter().for_each(|p| drop(black_box(body.forward(p).expect("sound parameters")))))
            });
        });
    }
}

criterion_group!(benches, posing);
criterion_main!(benches);
