//! Region of the readings in the training data: a coarse map of level and spread of the lags.

use crate::features::{FeatureSet, Features, LAGS};

/// Bins of the mean of the lags: four per octave, eight octaves below the largest power.
const LEVELS: usize = 32;
/// Bins of their spread, largest minus smallest: two per octave, eight octaves.
const SPREADS: usize = 16;

/// The bins of (mean, spread) of five successive readings that the training data visited, with
/// their neighbours. A robot whose first readings lie elsewhere is of another kind, or measured
/// otherwise: nothing is known of the network's errors there.
///
/// ```
/// use joulebus_predictor::{FeatureSet, INPUTS, LAGS, TrainingRange};
///
/// let rows = [[3.0; INPUTS]];
/// let seen = TrainingRange::of(FeatureSet::PowerOnly, rows.iter()).seen.ok_or("power above 0")?;
/// assert!(seen.has(&[3.0; LAGS]) && !seen.has(&[0.1; LAGS]));
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SeenPower {
    /// The newest reading's maximum in training, W, above 0. It scales both axes.
    top_w: u32,
    bits: [u64; LEVELS * SPREADS / 64],
}

/// Bin of a share of the top: by exponent and first bits of the mantissa, so that no logarithm is
/// needed and every machine agrees. What is not above 0 is in the first one.
#[inline(always)]
fn bin(share: f32, mantissa_bits: u32, bins: usize) -> usize {
    let shift = f32::MANTISSA_DIGITS - 1 - mantissa_bits;
    let top = (1.0f32.to_bits() >> shift) as i32;
    let at = (share.max(0.0).to_bits() >> shift) as i32 - top + bins as i32 - 1;
    at.clamp(0, bins as i32 - 1) as usize
}

impl SeenPower {
    /// Hexadecimal digits of [`SeenPower::to_text`].
    const DIGITS: usize = LEVELS * SPREADS / 4;

    /// The map of some rows. `None` if their largest newest reading, `top_w`, is not above 0 W.
    #[must_use]
    pub fn of<'a>(top_w: f32, rows: impl Iterator<Item = &'a Features>) -> Option<Self> {
        let mut seen = Self::empty(top_w)?;
        for row in rows {
            let lags = FeatureSet::PowerOnly.first();
            let lag_w = std::array::from_fn(|lag| row[lags + lag]);
            let (level, spread) = seen.bins(&lag_w);
            for level in level.saturating_sub(1)..=(level + 1).min(LEVELS - 1) {
                for spread in spread.saturating_sub(1)..=(spread + 1).min(SPREADS - 1) {
                    let at = level * SPREADS + spread;
                    seen.bits[at / 64] |= 1 << (at % 64);
                }
            }
        }
        Some(seen)
    }

    fn empty(top_w: f32) -> Option<Self> {
        (top_w > 0.0 && top_w.is_finite())
            .then(|| Self { top_w: top_w.to_bits(), bits: [0; LEVELS * SPREADS / 64] })
    }

    #[inline(always)]
    fn bins(&self, lag_w: &[f32; LAGS]) -> (usize, usize) {
        let [mut least_w, mut most_w, mut sum_w] = [lag_w[0]; 3];
        for watts in &lag_w[1..] {
            least_w = least_w.min(*watts);
            most_w = most_w.max(*watts);
            sum_w += watts;
        }
        let per_w = 1.0 / f32::from_bits(self.top_w);
        let level = bin(sum_w * (per_w / LAGS as f32), 2, LEVELS);
        (level, bin((most_w - least_w) * per_w, 1, SPREADS))
    }

    /// True if the training data had readings like these, newest first, W.
    #[must_use]
    pub fn has(&self, lag_w: &[f32; LAGS]) -> bool {
        let (level, spread) = self.bins(lag_w);
        let at = level * SPREADS + spread;
        self.bits[at / 64] >> (at % 64) & 1 == 1
    }

    /// Formats it as model files do: 128 hexadecimal digits.
    #[must_use]
    pub fn to_text(&self) -> String {
        self.bits.iter().map(|bits| format!("{bits:016x}")).collect()
    }

    /// Reverses [`SeenPower::to_text`]. `None` for anything else.
    #[must_use]
    pub fn from_text(top_w: f32, text: &str) -> Option<Self> {
        let is_hex = text.bytes().all(|digit| digit.is_ascii_hexdigit());
        let mut seen = Self::empty(top_w).filter(|_| is_hex && text.len() == Self::DIGITS)?;
        for (bits, digits) in seen.bits.iter_mut().zip(text.as_bytes().as_chunks::<16>().0) {
            *bits = u64::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok()?;
        }
        Some(seen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_of_other_levels_or_other_noise_were_not_seen_and_the_text_keeps_the_map() {
        let row = |lag_w: [f32; LAGS]| {
            let mut row = Features::default();
            row[FeatureSet::PowerOnly.range()].copy_from_slice(&lag_w);
            row
        };
        let rows = [row([100.0; LAGS]), row([40.0, 42.0, 38.0, 41.0, 40.0])];
        let seen = SeenPower::of(100.0, rows.iter()).unwrap();
        for (lag_w, expected) in [
            ([100.0; LAGS], true),
            ([95.0, 98.0, 95.0, 95.0, 95.5], false),
            ([41.0, 38.0, 42.0, 40.0, 40.0], true),
            ([44.0, 42.0, 46.0, 45.0, 44.0], true),
            ([40.0; LAGS], false),
            ([10.0, 12.0, 8.0, 11.0, 10.0], false),
            ([3.0; LAGS], false),
            ([-40.0; LAGS], false),
        ] {
            assert_eq!(seen.has(&lag_w), expected, "{lag_w:?}");
        }
        let text = seen.to_text();
        assert_eq!(SeenPower::from_text(100.0, &text), Some(seen));
        for wrong in [&text[1..], "", &text.replace('0', "g")] {
            assert_eq!(SeenPower::from_text(100.0, wrong), None);
        }
        for top_w in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert_eq!(SeenPower::of(top_w, rows.iter()), None);
        }
    }
}
