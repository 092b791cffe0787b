//! Random numbers that are the same on every machine.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng;

/// A seeded stream. Each robot and purpose has its own, so adding a robot changes no other stream.
#[derive(Clone, Debug)]
pub struct Noise(Pcg64);

impl Noise {
    /// Stream number `stream` of `seed`.
    pub fn new(seed: u64, stream: u64) -> Noise {
        Noise(Pcg64::new(u128::from(seed), u128::from(stream)))
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Uniform on [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform on [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Standard normal (Box-Muller; the second number is discarded).
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.uniform()));
        radius * libm::cos(std::f64::consts::TAU * self.uniform())
    }

    /// Time in seconds until the next event of a Poisson process.
    pub fn waiting_s(&mut self, mean_s: f64) -> f64 {
        -mean_s * libm::log(1.0 - self.uniform())
    }

    /// Uniform on 0..bound. The bias of the multiplication is below 2⁻³² for bounds below 2³².
    pub fn below(&mut self, bound: usize) -> usize {
        ((u128::from(self.0.next_u64()) * bound as u128) >> 64) as usize
    }
}
