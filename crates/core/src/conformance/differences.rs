//! Derivatives by differences, for functions that may have kinks.

/// Steps tried; one that stays on one side of a kink, and neither rounds nor curves too much, is enough.
const STEPS: [f64; 4] = [1e-4, 1e-5, 1e-6, 1e-7];

/// Whether a derivative is right: `f` at offsets along one variable, compared by central and both one-sided differences over
/// several steps. `scale` is the size of derivatives that would be wrong if confused with zero, `step` the variable's scale.
pub fn agrees(derivative: f64, scale: f64, step: f64, f: impl Fn(f64) -> f64) -> bool {
    agrees_within(derivative, scale, step, 0.0, f)
}

/// As [`agrees`], where values of `f` are rounded by `noise`.
pub fn agrees_within(derivative: f64, scale: f64, step: f64, noise: f64, f: impl Fn(f64) -> f64) -> bool {
    let here = f(0.0);
    STEPS.iter().any(|h| {
        let h = h * step;
        let (plus, minus) = (f(h), f(-h));
        // A one-sided difference of a smooth function errs by h/2 times the curvature; a central one by rounding at least.
        let near = |d: f64| (d - derivative).abs() <= 2e-5 * scale.max(derivative.abs()) + 2.0 * noise / h;
        near((plus - minus) / (2.0 * h)) || near((plus - here) / h) || near((here - minus) / h)
    })
}

/// Counts right derivatives among many: kinks may spoil a few points, a wrong formula spoils one component everywhere.
#[derive(Default)]
pub(super) struct Tally {
    right: usize,
    all: usize,
    first_wrong: Option<String>,
}

/// Share of points of one component that must be right.
const SHARE: f64 = 0.85;

impl Tally {
    pub(super) fn add(&mut self, right: bool, place: impl FnOnce() -> String) {
        self.all += 1;
        if right {
            self.right += 1;
        } else if self.first_wrong.is_none() {
            self.first_wrong = Some(place());
        }
    }
    pub(super) fn check(&self, what: &str) -> Result<(), String> {
        if self.right as f64 >= SHARE * self.all as f64 {
            return Ok(());
        }
        let place = self.first_wrong.as_deref().unwrap_or("nowhere");
        Err(format!("{what} is right at {} of {} points; first wrong at {place}", self.right, self.all))
    }
}

/// A low-discrepancy sequence in [-1, 1), the same for everybody: scattered points without a random generator.
pub(super) fn scattered(index: usize, dimension: usize) -> f64 {
    // Powers of the plastic number's generalisations (Roberts): evenly spread in many dimensions.
    const STEP: [f64; 12] = [
        0.754_877_666_246_692_8,
        0.569_840_290_998_053_3,
        0.430_159_709_001_946_7,
        0.324_717_957_244_746,
        0.245_122_333_753_307_2,
        0.185_037_411_125_319,
        0.139_680_581_996_106_1,
        0.105_441_428_866_387,
        0.079_594_904_865_866_5,
        0.060_084_922_259_452_6,
        0.045_356_376_257_386_5,
        0.034_238_528_608_479_9,
    ];
    let step = STEP[dimension % STEP.len()];
    ((index + 1) as f64 * step + 0.37 * (dimension / STEP.len()) as f64).fract() * 2.0 - 1.0
}
