//! Selection of the kernel by CPU feature detection, and its tile sizes.

#[cfg(target_arch = "x86_64")]
use super::avx2::Avx2;
#[cfg(target_arch = "x86_64")]
use super::avx512::Avx512;
use super::batch::{Batch, BatchInput, Columns, Rows, Tiling};
use super::lanes::Lanes;
#[cfg(target_arch = "aarch64")]
use super::neon::Neon;
use super::packed::Packed;
use super::rollout::Roll;
use super::scalar::Scalar;
use crate::card::TrainingRange;
use crate::features::{Features, INPUTS};
use crate::rollout::Rollouts;

/// Implementation of the kernel. All give the same bits.
///
/// ```
/// use joulebus_predictor::Kernel;
///
/// assert!(Kernel::Scalar.is_available() && Kernel::best().is_available());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Kernel {
    /// One value at a time, on every CPU. On x86-64 without FMA the fused multiply-adds are
    /// computed in software: exact and slow.
    Scalar,
    /// NEON of aarch64.
    Neon,
    /// AVX2 and FMA of x86-64.
    Avx2,
    /// AVX-512 (F, BW, DQ, VL) of x86-64, available on all AVX-512 CPUs except Xeon Phi.
    Avx512,
}

impl Kernel {
    /// All kernels, slowest first.
    pub const ALL: [Kernel; 4] = [Kernel::Scalar, Kernel::Neon, Kernel::Avx2, Kernel::Avx512];

    /// True if this CPU supports it.
    pub fn is_available(self) -> bool {
        Engine::new(self).is_some()
    }

    /// The fastest that this CPU supports.
    pub fn best() -> Kernel {
        let available = Kernel::ALL.into_iter().rev().find(|kernel| kernel.is_available());
        available.unwrap_or(Kernel::Scalar)
    }
}

/// A kernel whose CPU features were detected.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Engine {
    Scalar(Scalar),
    #[cfg(target_arch = "aarch64")]
    Neon(Neon),
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2),
    #[cfg(target_arch = "x86_64")]
    Avx512(Avx512),
}

impl Engine {
    /// `None` if this CPU does not support the kernel.
    pub(crate) fn new(kernel: Kernel) -> Option<Engine> {
        match kernel {
            Kernel::Scalar => Some(Engine::Scalar(Scalar)),
            #[cfg(target_arch = "aarch64")]
            Kernel::Neon => Some(Engine::Neon(Neon)),
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2 => Avx2::detect().map(Engine::Avx2),
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx512 => Avx512::detect().map(Engine::Avx512),
            _ => None,
        }
    }

    /// The fastest that this CPU supports.
    pub(crate) fn best() -> Engine {
        Engine::new(Kernel::best()).unwrap_or(Engine::Scalar(Scalar))
    }

    pub(crate) fn kernel(self) -> Kernel {
        match self {
            Engine::Scalar(_) => Kernel::Scalar,
            #[cfg(target_arch = "aarch64")]
            Engine::Neon(_) => Kernel::Neon,
            #[cfg(target_arch = "x86_64")]
            Engine::Avx2(_) => Kernel::Avx2,
            #[cfg(target_arch = "x86_64")]
            Engine::Avx512(_) => Kernel::Avx512,
        }
    }

    /// Forecasts in watt, for as many rows as the shorter slice has.
    pub(crate) fn rows(
        self,
        packed: &Packed,
        tiling: Tiling,
        rows: &[Features],
        out_w: &mut [f32],
    ) {
        let count = rows.len().min(out_w.len());
        self.batch(packed, tiling, Rows(&rows[..count]), &mut out_w[..count]);
    }

    /// Forecasts in watt. Columns that are read have the length of `out_w`.
    pub(crate) fn columns(
        self,
        packed: &Packed,
        tiling: Tiling,
        columns: &[&[f32]; INPUTS],
        out_w: &mut [f32],
    ) {
        self.batch(packed, tiling, Columns(columns), out_w);
    }

    fn batch<S: BatchInput>(self, packed: &Packed, tiling: Tiling, source: S, out_w: &mut [f32]) {
        match self {
            Engine::Scalar(lanes) => tiles::<_, _, 4, 2, 4>(lanes, packed, tiling, source, out_w),
            #[cfg(target_arch = "aarch64")]
            Engine::Neon(lanes) => tiles::<_, _, 4, 4, 4>(lanes, packed, tiling, source, out_w),
            #[cfg(target_arch = "x86_64")]
            Engine::Avx2(lanes) => tiles::<_, _, 2, 4, 3>(lanes, packed, tiling, source, out_w),
            #[cfg(target_arch = "x86_64")]
            Engine::Avx512(lanes) => tiles::<_, _, 1, 16, 4>(lanes, packed, tiling, source, out_w),
        }
    }

    /// Lanes of checked rollouts from `first`, as many as `energy_j` has elements.
    pub(crate) fn rollout(
        self,
        network: (&Packed, &TrainingRange),
        rollouts: &Rollouts<'_>,
        first: usize,
        energy_j: &mut [f32],
        power_w: Option<&mut [f32]>,
    ) {
        let request = (network, rollouts, first);
        match self {
            Engine::Scalar(lanes) => roll::<_, 4, 2>(lanes, request, energy_j, power_w),
            #[cfg(target_arch = "aarch64")]
            Engine::Neon(lanes) => roll::<_, 4, 4>(lanes, request, energy_j, power_w),
            #[cfg(target_arch = "x86_64")]
            Engine::Avx2(lanes) => roll::<_, 2, 4>(lanes, request, energy_j, power_w),
            #[cfg(target_arch = "x86_64")]
            Engine::Avx512(lanes) => roll::<_, 1, 16>(lanes, request, energy_j, power_w),
        }
    }
}

fn roll<L: Lanes, const R: usize, const C: usize>(
    lanes: L,
    ((packed, range), rollouts, first): ((&Packed, &TrainingRange), &Rollouts<'_>, usize),
    energy_j: &mut [f32],
    power_w: Option<&mut [f32]>,
) {
    lanes.run(Roll::<R, C> { packed, range, rollouts, first, energy_j, power_w });
}

fn tiles<L: Lanes, S: BatchInput, const R: usize, const C: usize, const N: usize>(
    lanes: L,
    packed: &Packed,
    tiling: Tiling,
    source: S,
    out_w: &mut [f32],
) {
    lanes.run(Batch::<S, R, C, N> { packed, tiling, source, out_w });
}
