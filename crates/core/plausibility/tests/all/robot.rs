//! Simulated recordings of one robot, with planted faults.

use joulebus_plausibility::{Finding, Judge, Known, Observation};

/// Reproducible numbers of 0 to 1.
pub(crate) struct Numbers(u64);

impl Numbers {
    pub(crate) fn new(seed: u64) -> Self {
        let mut numbers = Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        numbers.uniform();
        numbers
    }

    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 ^ (self.0 >> 29)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Which robot, and what it does.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Recording {
    /// Power at rest, W.
    pub(crate) idle_w: f64,
    pub(crate) voltage_v: f64,
    pub(crate) rate_hz: f64,
    pub(crate) rows: usize,
    /// Share of the rows without motion.
    pub(crate) idle: f64,
    /// Share of the rows that are missing.
    pub(crate) gaps: f64,
    /// Share of the driving rows on which energy is fed back.
    pub(crate) regenerates: f64,
    /// The robot stands on a charger.
    pub(crate) charger: bool,
    pub(crate) velocities: bool,
    pub(crate) battery: bool,
    pub(crate) seed: u64,
}

impl Recording {
    pub(crate) const USUAL: Self = Self {
        idle_w: 20.0,
        voltage_v: 24.0,
        rate_hz: 30.0,
        rows: 1_000,
        idle: 0.3,
        gaps: 0.0,
        regenerates: 0.0,
        charger: false,
        velocities: true,
        battery: true,
        seed: 1,
    };

    /// Its rows.
    pub(crate) fn rows(&self) -> Vec<Observation> {
        let mut numbers = Numbers::new(self.seed);
        let mut rows = Vec::new();
        let (mut soc, mut drawn_j) = (0.8, 0.0);
        let (mut moves, mut brakes) = (false, false);
        let mut v_mps = 0.0;
        let resistance_ohm = 0.05 * self.voltage_v * self.voltage_v / (10.0 * self.idle_w);
        for row in 0..self.rows {
            let time_s = row as f64 / self.rate_hz;
            // A phase lasts a second or so.
            if numbers.uniform() * self.rate_hz < 1.0 || row == 0 {
                moves = !self.charger && numbers.uniform() >= self.idle;
                brakes = numbers.uniform() < self.regenerates;
                v_mps = 0.2 + 0.6 * numbers.uniform();
            }
            let v_mps = if moves { v_mps } else { 0.0 };
            let load_w = self.idle_w * (1.0 + 0.03 * numbers.normal());
            let power_w = match (self.charger, moves && brakes) {
                (true, _) => load_w - 4.0 * self.idle_w,
                (_, true) => load_w - 3.0 * self.idle_w * v_mps,
                (_, false) => load_w + 3.0 * self.idle_w * v_mps,
            };
            drawn_j += power_w / self.rate_hz;
            soc = (soc - power_w / self.rate_hz / (self.idle_w * 36_000.0)).clamp(0.01, 1.0);
            let rise_v = -drawn_j / (self.idle_w * 36_000.0) * self.voltage_v;
            let current_a = power_w / self.voltage_v;
            let noise_v = 2e-4 * self.voltage_v * numbers.normal();
            let voltage_v = self.voltage_v + rise_v - resistance_ohm * current_a + noise_v;
            if numbers.uniform() < self.gaps {
                continue;
            }
            let mut seen = Observation::at(time_s);
            if self.velocities {
                let measured = v_mps * (1.0 + 0.05 * numbers.normal());
                (seen.v_mps, seen.omega_radps) = (v_mps, 0.0);
                (seen.v_measured_mps, seen.omega_measured_radps) = (measured, 0.0);
            }
            seen.power_w = power_w;
            if self.battery {
                (seen.voltage_v, seen.current_a, seen.soc) = (voltage_v, power_w / voltage_v, soc);
            }
            rows.push(seen);
        }
        rows
    }
}

/// Findings in rows.
pub(crate) fn judged(known: Known, rows: &[Observation]) -> Vec<Finding> {
    let mut judge = Judge::new(known);
    rows.iter().for_each(|seen| judge.take(seen));
    judge.findings()
}

/// The current above which the other readings are: of so many, as a share.
pub(crate) fn current_above(rows: &[Observation], share: f64) -> f64 {
    let mut sorted: Vec<f64> = rows.iter().map(|seen| seen.current_a).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted[(sorted.len() as f64 * share) as usize]
}
