//! What one robot differs in from those that its model has learned from: a level and a gain.
//!
//! The adapted forecast is the network's times a gain, plus a level. Both are learned from the
//! robot's own readings by recursive least squares with forgetting (Ljung, "System identification",
//! 2nd edition, 1999, section 11.2), and start where the adapted forecast is the network's.
//!
//! Memory is bounded in every sense: 20 bytes a robot; a reading's weight falls by a factor with
//! every further one; and the doubt about level and gain never exceeds that of the start, so that a
//! robot that stands still for hours does not wind it up (a covariance that grows without bound is
//! the known fault of forgetting).

use serde::{Deserialize, Serialize};

/// Variance of the gain at the start, and the most that it may become.
const GAIN_DOUBT: f32 = 0.002;
/// The same of the level.
const LEVEL_DOUBT: f32 = 0.07;
/// What is left of a reading's weight after one more: half of it after 346.
const FORGETTING: f32 = 0.998;
/// What the gain may be.
const GAIN: (f32, f32) = (-2.0, 4.0);
/// Greatest power, level and error that are believed, standard deviations.
const MOST: f32 = 1e4;
/// Largest correlation of gain and level that is kept: past it single precision cannot tell a
/// covariance from none.
const CORRELATION_MAX: f32 = 0.9999;

/// One robot's level and gain, and what is not known of them. Powers are in standard deviations of
/// the residuals in training.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Adaptation {
    pub gain: f32,
    pub level: f32,
    gain_doubt: f32,
    level_doubt: f32,
    /// Covariance of the two.
    both_doubt: f32,
}

impl Adaptation {
    pub(crate) const START: Self = Self {
        gain: 1.0,
        level: 0.0,
        gain_doubt: GAIN_DOUBT,
        level_doubt: LEVEL_DOUBT,
        both_doubt: 0.0,
    };

    /// The forecast, where the network's is `network`.
    pub(crate) fn forecast(&self, network: f32) -> f32 {
        self.gain * network.clamp(-MOST, MOST) + self.level
    }

    /// Learns that the reading was `reading` where the network's forecast was `network`, both
    /// finite.
    pub(crate) fn learn(&mut self, network: f32, reading: f32) {
        let network = network.clamp(-MOST, MOST);
        let error = (reading - self.forecast(network)).clamp(-MOST, MOST);
        let of_gain = self.gain_doubt * network + self.both_doubt;
        let of_level = self.both_doubt * network + self.level_doubt;
        // Not below 0 but for rounding: the doubt is a covariance.
        let doubt = (network * of_gain + of_level).max(0.0);
        let scale = 1.0 / (FORGETTING + doubt);
        self.gain = (self.gain + scale * of_gain * error).clamp(GAIN.0, GAIN.1);
        self.level = (self.level + scale * of_level * error).clamp(-MOST, MOST);
        let after = |before: f32, known: f32| (before - scale * known) / FORGETTING;
        self.gain_doubt = after(self.gain_doubt, of_gain * of_gain).max(0.0);
        self.level_doubt = after(self.level_doubt, of_level * of_level).max(0.0);
        self.both_doubt = after(self.both_doubt, of_gain * of_level);
        self.bound_doubt();
    }

    /// Scales rows and columns alike, which keeps a covariance a covariance.
    fn bound_doubt(&mut self) {
        let excess = |doubt: f32, most: f32| {
            if doubt > most {
                (most / doubt).sqrt()
            } else {
                1.0
            }
        };
        let gain = excess(self.gain_doubt, GAIN_DOUBT);
        let level = excess(self.level_doubt, LEVEL_DOUBT);
        self.gain_doubt *= gain * gain;
        self.level_doubt *= level * level;
        let most = CORRELATION_MAX * (self.gain_doubt * self.level_doubt).sqrt();
        self.both_doubt = (self.both_doubt * gain * level).clamp(-most, most);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_level_and_a_gain_are_found_and_followed_when_they_change() {
        let mut adaptation = Adaptation::START;
        for (gain, level) in [(1.0, 0.0), (1.3, -4.0), (0.8, 6.0)] {
            for step in 0..4_000u32 {
                let network = 30.0 + 8.0 * (step as f32 * 0.37).sin();
                adaptation.learn(network, gain * network + level);
            }
            let (found, expected) = (adaptation.forecast(35.0), gain * 35.0 + level);
            assert!(
                (found - expected).abs() < 0.05,
                "{found}, expected {expected}"
            );
            assert!((adaptation.gain - gain).abs() < 0.01, "{adaptation:?}");
        }
    }

    #[test]
    fn standing_still_for_a_day_winds_nothing_up() {
        let mut adaptation = Adaptation::START;
        for _ in 0..30 * 3600 * 24 {
            adaptation.learn(30.0, 30.5);
        }
        assert!(
            (adaptation.forecast(30.0) - 30.5).abs() < 0.01,
            "{adaptation:?}"
        );
        assert!(adaptation.gain_doubt <= GAIN_DOUBT && adaptation.level_doubt <= LEVEL_DOUBT);
        // What it says of what it has not seen for so long is still near the network.
        assert!(
            (adaptation.forecast(60.0) - 60.0).abs() < 2.0,
            "{adaptation:?}"
        );
    }

    proptest! {
        #[test]
        fn whatever_comes_level_gain_and_doubt_stay_bounded(
            rows in prop::collection::vec((-1e6f32..1e6, -1e6f32..1e6, 0u8..4), 1..400),
        ) {
            let mut adaptation = Adaptation::START;
            for (network, reading, kind) in rows {
                let (network, reading) = match kind {
                    0 => (network, reading),
                    1 => (network * 1e-4, reading * 1e-4),
                    2 => (40.0, reading * 1e-5),
                    _ => (network * 1e30, -network * 1e30),
                };
                adaptation.learn(network, reading);
                let Adaptation { gain, level, gain_doubt, level_doubt, both_doubt } = adaptation;
                prop_assert!((GAIN.0..=GAIN.1).contains(&gain), "{:?}", adaptation);
                prop_assert!(level.abs() <= MOST, "{:?}", adaptation);
                prop_assert!((0.0..=GAIN_DOUBT * 1.001).contains(&gain_doubt), "{:?}", adaptation);
                prop_assert!((0.0..=LEVEL_DOUBT * 1.001).contains(&level_doubt), "{:?}", adaptation);
                prop_assert!(both_doubt * both_doubt <= gain_doubt * level_doubt, "{:?}", adaptation);
            }
        }
    }
}
