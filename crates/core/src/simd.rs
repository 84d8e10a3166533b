//! The scalar of hot kernels, and run-time dispatch to the processor's vector units.

use num_traits::{Float, NumAssign};
use std::fmt::{Debug, Display};

/// `f32` or `f64`: the precision of a kernel.
pub trait Real: Float + NumAssign + Debug + Display + Default + Send + Sync + std::iter::Sum + 'static {
    /// Values in one vector register: the number of frames that travel together (AVX-512 width).
    const LANES: usize;
    /// Nearest value of this precision.
    fn of(value: f64) -> Self;
    /// Exact widening.
    fn to_f64(self) -> f64;
}

impl Real for f32 {
    const LANES: usize = 16;
    #[inline(always)]
    fn of(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    const LANES: usize = 8;
    #[inline(always)]
    fn of(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
}

/// Whether kernels may use AVX-512. A build with `RUSTFLAGS="--cfg caphy_no_avx512"` never does: for measuring what slower
/// machines will see.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub fn has_avx512() -> bool {
    !cfg!(any(caphy_no_avx512, caphy_no_simd))
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512bw")
}

/// Whether kernels may use AVX2; never in a build with `RUSTFLAGS="--cfg caphy_no_simd"`.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub fn has_avx2() -> bool {
    !cfg!(caphy_no_simd) && is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
}

/// Defines a generic kernel that runs with AVX-512 or AVX2 when the processor has them, without build flags.
///
/// The body is plain scalar code in a loop over lanes, compiled three times; results are the same bits on all three
/// as long as the body calls no fused multiply-add. Called functions must be `#[inline(always)]`.
///
/// ```
/// use caphy_core::{simd_kernel, Real};
/// simd_kernel! {
///     /// y += a x
///     pub fn axpy<T>(a: T, x: &[T], y: &mut [T]) {
///         for (y, x) in y.iter_mut().zip(x) { *y += a * *x; }
///     }
/// }
/// let mut y = [1.0f32, 2.0];
/// axpy(2.0, &[1.0, 1.0], &mut y);
/// assert_eq!(y, [3.0, 4.0]);
/// ```
#[macro_export]
macro_rules! simd_kernel {
    (
        $(#[$meta:meta])*
        $vis:vis fn $name:ident<$T:ident $(: $extra:path)? $(, $G:ident : $bound:path)*>($($arg:ident : $ty:ty),* $(,)?) $(-> $ret:ty)?
        $body:block
    ) => {
        $(#[$meta])*
        $vis fn $name<$T: $crate::Real $(+ $extra)? $(, $G: $bound)*>($($arg: $ty),*) $(-> $ret)? {
            #[inline(always)]
            fn plain<$T: $crate::Real $(+ $extra)? $(, $G: $bound)*>($($arg: $ty),*) $(-> $ret)? $body
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma")]
                fn avx512<$T: $crate::Real $(+ $extra)? $(, $G: $bound)*>($($arg: $ty),*) $(-> $ret)? { plain($($arg),*) }
                #[target_feature(enable = "avx2,fma")]
                fn avx2<$T: $crate::Real $(+ $extra)? $(, $G: $bound)*>($($arg: $ty),*) $(-> $ret)? { plain($($arg),*) }
                if $crate::simd::has_avx512() {
                    // SAFETY: the features that the callee enables were detected just above.
                    return unsafe { avx512($($arg),*) };
                }
                if $crate::simd::has_avx2() {
                    // SAFETY: the features that the callee enables were detected just above.
                    return unsafe { avx2($($arg),*) };
                }
            }
            plain($($arg),*)
        }
    };
}
