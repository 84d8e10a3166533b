//! MS-SSIM: how alike two grey images look (Wang, Simoncelli, Bovik 2003).

/// Weights of the scales, from the finest on (their Sec. 3.2).
const WEIGHTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];
/// Standard deviation of the window [pixels], and how far it reaches: 11 × 11.
const SIGMA: f64 = 1.5;
const REACH: usize = 5;
/// (K L)² for brightness in [0, 1].
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Smallest width and height: the window fits into the coarsest scale.
pub(super) const SMALLEST: usize = (2 * REACH + 1) << (WEIGHTS.len() - 1);

/// MS-SSIM of two images of brightness in [0, 1], row by row, shape [height · width]: 1 for the same.
///
/// Negative similarities of a scale count as 0. `None` for images that are smaller than 176 pixels or have other sizes.
pub fn ms_ssim(a: &[f32], b: &[f32], width: usize, height: usize) -> Option<f64> {
    if width < SMALLEST || height < SMALLEST || a.len() != width * height || b.len() != a.len() {
        return None;
    }
    let (mut a, mut b): (Vec<f64>, Vec<f64>) =
        (a.iter().map(|v| f64::from(*v)).collect(), b.iter().map(|v| f64::from(*v)).collect());
    let (mut width, mut height) = (width, height);
    let mut product = 1.0;
    for (scale, weight) in WEIGHTS.iter().enumerate() {
        let [luminance, structure] = similarity(&a, &b, width, height);
        let last = scale + 1 == WEIGHTS.len();
        let value = if last { luminance } else { structure };
        product *= value.max(0.0).powf(*weight);
        if !last {
            (a, b) = (halved(&a, width, height), halved(&b, width, height));
            (width, height) = (width / 2, height / 2);
        }
    }
    Some(product)
}

/// Means over the image of SSIM, and of its part without luminance.
fn similarity(a: &[f64], b: &[f64], width: usize, height: usize) -> [f64; 2] {
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).collect::<Vec<f64>>();
    let [ma, mb] = [smooth(a, width, height), smooth(b, width, height)];
    let [aa, bb, ab] = [(a, a), (b, b), (a, b)].map(|(x, y)| smooth(&product(x, y), width, height));
    let (mut whole, mut structure) = (0.0, 0.0);
    for i in 0..ma.len() {
        let (va, vb, cov) = (aa[i] - ma[i] * ma[i], bb[i] - mb[i] * mb[i], ab[i] - ma[i] * mb[i]);
        let cs = (2.0 * cov + C2) / (va + vb + C2);
        structure += cs;
        whole += cs * (2.0 * ma[i] * mb[i] + C1) / (ma[i] * ma[i] + mb[i] * mb[i] + C1);
    }
    let n = ma.len() as f64;
    [whole / n, structure / n]
}

/// Weighted means over the window, where it fits in whole.
fn smooth(image: &[f64], width: usize, height: usize) -> Vec<f64> {
    let kernel: [f64; 2 * REACH + 1] =
        std::array::from_fn(|i| (-0.5 * ((i as f64 - REACH as f64) / SIGMA).powi(2)).exp());
    let sum: f64 = kernel.iter().sum();
    let (w, h) = (width - 2 * REACH, height - 2 * REACH);
    let mut rows = vec![0.0; w * height];
    for y in 0..height {
        for x in 0..w {
            let start = y * width + x;
            rows[y * w + x] = kernel.iter().zip(&image[start..]).map(|(k, v)| k / sum * v).sum();
        }
    }
    let mut out = vec![0.0; w * h];
    for y in 0..h {
        for x in 0..w {
            out[y * w + x] = kernel.iter().enumerate().map(|(i, k)| k / sum * rows[(y + i) * w + x]).sum();
        }
    }
    out
}

/// Means of 2 × 2 pixels.
fn halved(image: &[f64], width: usize, height: usize) -> Vec<f64> {
    let (w, h) = (width / 2, height / 2);
    let pixel = |i: usize| {
        let at = 2 * (i / w) * width + 2 * (i % w);
        0.25 * (image[at] + image[at + 1] + image[at + width] + image[at + width + 1])
    };
    (0..w * h).map(pixel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: usize = 192;

    fn image(at: impl Fn(f64, f64) -> f64) -> Vec<f32> {
        (0..SIZE * SIZE).map(|i| at((i % SIZE) as f64, (i / SIZE) as f64) as f32).collect()
    }

    #[test]
    fn the_same_is_one_and_differences_count() {
        let waves = |shift: f64| image(move |x, y| 0.5 + 0.3 * ((x + shift) / 9.0).sin() * (y / 14.0).cos());
        let of = |b: &[f32]| ms_ssim(&waves(0.0), b, SIZE, SIZE).unwrap();
        assert!((of(&waves(0.0)) - 1.0).abs() < 1e-12);
        let (near, far) = (of(&waves(2.0)), of(&waves(9.0)));
        assert!(far < near && near < 1.0, "{near} {far}");
        // Waves turned upside down are not alike in any scale that shows them.
        assert!(of(&image(|x, y| 0.5 - 0.3 * (x / 9.0).sin() * (y / 14.0).cos())) < 0.2);
        assert_eq!(ms_ssim(&[0.0; 100], &[0.0; 100], 10, 10), None);
    }

    #[test]
    fn flat_images_differ_by_their_luminance_alone() {
        // Then every structure is 1, and only the coarsest scale's luminance is left, to its weight.
        let (a, b) = (0.2, 0.7);
        let got = ms_ssim(&image(|_, _| a), &image(|_, _| b), SIZE, SIZE).unwrap();
        let luminance: f64 = (2.0 * a * b + C1) / (a * a + b * b + C1);
        assert!((got - luminance.powf(WEIGHTS[4])).abs() < 1e-6, "{got}");
        assert!((WEIGHTS.iter().sum::<f64>() - 1.0).abs() < 2e-4);
    }
}
