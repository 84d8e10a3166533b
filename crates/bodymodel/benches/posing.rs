//! Posing 80 frames of a body of 10475 vertices and 55 joints, every joint turned, one thread; and loading its file.
//!
//! Aims on an AVX-512 machine: 25 ms without pose correctives, 50 ms with 486 of them, a third of that for 3500 vertices. The
//! baseline in the same run is one `forward` (f64) per frame.
//!
//! On Linux, what is measured is the time that the one thread is on a processor, so that other work on the machine counts as
//! little as possible; elsewhere wall time.

#[path = "../tests/all/smplx/generated.rs"]
#[allow(dead_code)]
mod generated;

use caphy_bodymodel::smplx::{BodySmplx, SmplxOptions, load};
use caphy_core::body::BodyModel;
use caphy_core::lanes::Frames;
use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use criterion::{BatchSize, Criterion, SamplingMode, criterion_group, criterion_main};
use generated::{Layout, frames};
use std::cell::LazyCell;
use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};
use zip::CompressionMethod::{Deflated, Stored};

/// Processor time of the calling thread.
struct ThreadTime;

impl ThreadTime {
    /// The kernel brings it up to date a few hundred times a second: samples of a tenth of a second are right to a few
    /// percent.
    fn now(start: Instant) -> Duration {
        let stat = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
        let on = stat.and_then(|s| s.split_whitespace().next().and_then(|t| t.parse().ok()));
        on.map_or_else(|| start.elapsed(), Duration::from_nanos)
    }
}

impl Measurement for ThreadTime {
    type Intermediate = (Instant, Duration);
    type Value = Duration;
    fn start(&self) -> (Instant, Duration) {
        let start = Instant::now();
        (start, Self::now(start))
    }
    fn end(&self, (start, before): (Instant, Duration)) -> Duration {
        Self::now(start).saturating_sub(before)
    }
    fn add(&self, a: &Duration, b: &Duration) -> Duration {
        *a + *b
    }
    fn zero(&self) -> Duration {
        Duration::ZERO
    }
    fn to_f64(&self, value: &Duration) -> f64 {
        value.as_nanos() as f64
    }
    fn formatter(&self) -> &dyn ValueFormatter {
        WallTime.formatter()
    }
}

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

fn posing(c: &mut Criterion<ThreadTime>) {
    let pool = one_thread();
    let frames = frames(55, FRAMES);
    // Runs of 35 in every 105: neither contiguous nor without any neighbours.
    let near: Vec<u32> = (0..VERTICES as u32).filter(|v| v % 105 < 35).chain(0..).take(NEAR).collect();
    for (name, correctives) in [("no correctives", false), ("486 correctives", true)] {
        let body = body(correctives);
        let mut group = c.benchmark_group(format!("posing 80 frames, {name}"));
        group.sample_size(20).sampling_mode(SamplingMode::Flat).measurement_time(Duration::from_secs(4));
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

fn loading(c: &mut Criterion<ThreadTime>) {
    let pool = one_thread();
    let file = Layout::smplx(VERTICES).file();
    let all =
        SmplxOptions { shape_coefficients: Some(300), expression_coefficients: Some(100), ..SmplxOptions::default() };
    let mut group = c.benchmark_group("loading 10475 vertices, 400 directions, 486 correctives");
    group.sample_size(10).sampling_mode(SamplingMode::Flat).measurement_time(Duration::from_secs(4));
    let few = SmplxOptions::default();
    for (what, method) in [("stored", Stored), ("deflated", Deflated)] {
        // Deflating takes seconds: only when a benchmark that is not filtered out asks for it.
        let bytes = LazyCell::new(|| file.bytes(method));
        for (kept, options) in [("10 + 10 kept", &few), ("300 + 100 kept", &all)] {
            group.bench_function(format!("{what}, {kept}"), |b| {
                let bytes: &Vec<u8> = &bytes;
                let file = || bytes.clone();
                let read = |bytes| load(Path::new("generated.npz"), bytes, options).expect("a sound file");
                pool.install(|| b.iter_batched(file, read, BatchSize::PerIteration));
            });
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().with_measurement(ThreadTime);
    targets = posing, loading
}
criterion_main!(benches);
