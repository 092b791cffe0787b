//! Residual monitoring (noise, model mismatch), and hysteresis for all alarms.

use joulebus_settings::AlarmSettings;
use joulebus_wire::{Alarm, AlarmSet};
use serde::{Deserialize, Deserializer, Serialize};

use crate::layout::lanes::{Lanes, block, put};
use crate::layout::versions::{self, NARROW, Narrow, before};

/// Serial correlation above which whitening would only amplify noise.
const MAX_CORRELATION: f32 = 0.9;

/// Limit of residuals, W, and of standardised residuals. Without it, one absurd forecast would turn
/// the means into NaN, and no alarm would ever be raised again.
const MAX_RESIDUAL: f32 = 1e6;

/// Largest squared residual that the noise ratio believes: one step of the load is not noise.
const MAX_NOISE_SQUARE: f32 = 300.0;
/// The model is judged over this many times as many readings as the noise: few of them carry the
/// changes that it is there for.
const MISMATCH_MEMORY: f32 = 10.0;
/// Limits of an error and of a change in that judgement, and its minimum squared error, in standard
/// deviations of the training's residuals. A model that errs as in training is not worse for a
/// robot that stands still, where the last reading is nearly exact.
const MAX_MISMATCH_ERROR: f32 = 20.0;
const MIN_MISMATCH_SQUARE: f32 = 3.0;

/// Number of alarms up to the last one that is decided here. Those of the battery follow.
const ALARMS: usize = Alarm::WatchdogStop.code() as usize;

/// For each alarm that is decided here, the number of consecutive samples for which its condition has
/// required a change.
type Agreeing = [u16; DECIDED];

/// Number of alarms that are decided here: none of `NoData` and of the retired biases.
const DECIDED: usize = ALARMS - 3;

/// The place of an alarm's bit in [`Agreeing`], if it is decided here.
const fn place_of(bit: usize) -> Option<usize> {
    const STUCK: usize = Alarm::StuckSensor.code() as usize - 1;
    const HELD: usize = Alarm::HeldTooLong.code() as usize - 1;
    const NOISE: usize = Alarm::NoiseHigh.code() as usize - 1;
    const RANGE: usize = Alarm::OutOfRange.code() as usize - 1;
    const { assert!(RANGE == 1 && STUCK == 2 && HELD == 3 && NOISE == 6) };
    match bit {
        RANGE..=HELD => Some(bit - RANGE),
        NOISE..ALARMS => Some(bit - NOISE + HELD),
        _ => None,
    }
}

block! {
    /// Residual statistics of one robot.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    pub(crate) struct Detector: NONE;

    /// The detectors of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    #[repr(align(32))]
    pub(crate) struct DetectorLanes {
        pub bias_w: f32 = 0.0,
        // Older states have two cumulative sums before it.
        pub noise_ratio: f32 = 1.0,
        z_last: f32 = 0.0,
        z_square: f32 = 1.0,
        z_product: f32 = 0.0,
        /// Recent squared errors of the model and of persistence, in squared standard deviations.
        /// Equal, until there are readings.
        error_square: f32 = 1.0,
        persistence_square: f32 = 1.0,
        /// Low bits of an [`AlarmSet`]: alarms for which `agreeing` is not zero.
        #[serde(deserialize_with = "versions::read_narrow")]
        changing: u32 as u16 = 0,
        /// Low bits of an [`AlarmSet`].
        #[serde(deserialize_with = "versions::read_narrow")]
        raised: u32 as u16 = 0,
        /// Rarely accessed: robot by robot.
        #[serde(deserialize_with = "versions::read_narrow")]
        agreeing: Agreeing = [0; DECIDED],
    }
}

/// No state has it but in columns.
impl Narrow for Agreeing {}

impl Narrow for Lanes<Agreeing> {
    fn read<'de, D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        // Versions before have a number for each alarm up to the last one.
        before(NARROW, from, |all: Lanes<[u16; ALARMS]>| {
            all.map(|of_all| {
                let mut agreeing = Agreeing::default();
                for (bit, count) in of_all.into_iter().enumerate() {
                    if let Some(place) = place_of(bit) {
                        agreeing[place] = count;
                    }
                }
                agreeing
            })
        })
    }
}

/// Alarms whose condition holds, and alarms that stay raised if they are raised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Conditions {
    pub raise: AlarmSet,
    pub stay: AlarmSet,
}

impl Conditions {
    /// A condition without hysteresis band.
    #[inline(always)]
    pub(crate) fn when(&mut self, holds: bool, alarm: Alarm) {
        self.between(holds, holds, alarm);
    }

    #[inline(always)]
    fn between(&mut self, raise: bool, stay: bool, alarm: Alarm) {
        let bit = AlarmSet(0).with(alarm).0;
        self.raise.0 |= if raise { bit } else { 0 };
        self.stay.0 |= if raise | stay { bit } else { 0 };
    }
}

impl Detector {
    /// Records a residual and the change of the reading, W, both finite. `per_sigma` is 1
    /// over the residual standard deviation in training, 1/W, above 0.
    #[inline(always)]
    pub(crate) fn observe(
        &mut self,
        residual_w: f32,
        change_w: f32,
        per_sigma: f32,
        settings: &AlarmSettings,
    ) {
        let residual_w = residual_w.clamp(-MAX_RESIDUAL, MAX_RESIDUAL);
        self.bias_w += settings.bias_weight * (residual_w - self.bias_w);
        let z = (residual_w * per_sigma).clamp(-MAX_RESIDUAL, MAX_RESIDUAL);
        let white = self.whiten(z, settings.bias_weight);
        let square = (white * white).min(MAX_NOISE_SQUARE);
        self.noise_ratio += settings.noise_weight * (square - self.noise_ratio);
        let weight = settings.noise_weight / MISMATCH_MEMORY;
        let bounded = |z: f32| z.clamp(-MAX_MISMATCH_ERROR, MAX_MISMATCH_ERROR);
        let (error, step) = (bounded(z), bounded(change_w * per_sigma));
        self.error_square += weight * (error * error - self.error_square);
        self.persistence_square += weight * (step * step - self.persistence_square);
    }

    /// Removes the serial correlation from `z`: a slow wave is not noise.
    #[inline(always)]
    fn whiten(&mut self, z: f32, weight: f32) -> f32 {
        let correlation =
            (self.z_product / self.z_square.max(f32::MIN_POSITIVE)).clamp(0.0, MAX_CORRELATION);
        let white = (z - correlation * self.z_last) / (1.0 - correlation * correlation).sqrt();
        self.z_square += weight * (z * z - self.z_square);
        self.z_product += weight * (z * self.z_last - self.z_product);
        self.z_last = z;
        white
    }

    /// The conditions of the residual alarms, after enough residuals were `observed`.
    #[inline(always)]
    pub(crate) fn conditions(&self, observed: u64, settings: &AlarmSettings) -> Conditions {
        let settled = observed >= settings.settle_samples.into();
        let mut conditions = Conditions::default();
        let (ratio, noise) = (self.noise_ratio, settings.noise_limit);
        conditions.between(ratio > noise, ratio > 0.5 * noise, Alarm::NoiseHigh);
        let expected = self.persistence_square.max(MIN_MISMATCH_SQUARE);
        let worst = settings.mismatch_limit * expected;
        let (error, floor) = (self.error_square, 0.9 * worst);
        conditions.between(error > worst, error > floor, Alarm::ModelMismatch);
        Conditions {
            raise: AlarmSet(if settled { conditions.raise.0 } else { 0 }),
            stay: AlarmSet(if settled { conditions.stay.0 } else { 0 }),
        }
    }

    /// Alarms that the conditions require to change.
    #[inline(always)]
    fn change(&self, conditions: Conditions) -> u32 {
        (self.raised & !conditions.stay.0) | (!self.raised & conditions.raise.0)
    }

    /// True if [`Detector::decide`] would change anything, which is rare.
    #[inline(always)]
    pub(crate) fn is_moved_by(&self, conditions: Conditions) -> bool {
        self.change(conditions) | self.changing != 0
    }

    /// Raises and clears with hysteresis: an alarm changes only after its condition has required it
    /// for the configured number of consecutive samples.
    pub(crate) fn decide(&mut self, conditions: Conditions, settings: &AlarmSettings) {
        let change = self.change(conditions);
        let mut look = change | self.changing;
        self.changing = change;
        while look != 0 {
            let (bit, place) = (look & look.wrapping_neg(), look.trailing_zeros() as usize);
            look &= !bit;
            let agreeing = place_of(place).and_then(|place| self.agreeing.get_mut(place));
            let Some(agreeing) = agreeing else {
                // A state of an earlier version has alarms that are retired.
                self.raised &= !bit;
                self.changing &= !bit;
                continue;
            };
            if change & bit == 0 {
                *agreeing = 0;
                continue;
            }
            *agreeing = agreeing.saturating_add(1);
            let raised = self.raised & bit != 0;
            let needed = if raised { settings.clear_samples } else { settings.raise_samples };
            if *agreeing >= needed {
                self.raised ^= bit;
                self.changing &= !bit;
                *agreeing = 0;
            }
        }
    }
}

impl DetectorLanes {
    #[inline(always)]
    pub(crate) fn raised(&self, lane: usize) -> AlarmSet {
        AlarmSet(self.raised[lane].into())
    }

    /// Same as [`Block::set`], for the fields that [`Detector::observe`] changes.
    #[inline(always)]
    pub(crate) fn set_observed(&mut self, lane: usize, mask: bool, robot: &Detector) {
        put(&mut self.bias_w[lane], mask, robot.bias_w);
        put(&mut self.noise_ratio[lane], mask, robot.noise_ratio);
        put(&mut self.z_last[lane], mask, robot.z_last);
        put(&mut self.z_square[lane], mask, robot.z_square);
        put(&mut self.z_product[lane], mask, robot.z_product);
        put(&mut self.error_square[lane], mask, robot.error_square);
        let persistence = robot.persistence_square;
        put(&mut self.persistence_square[lane], mask, persistence);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: AlarmSettings = AlarmSettings {
        bias_weight: 0.01,
        noise_weight: 0.01,
        noise_limit: 4.0,
        mismatch_limit: 2.0,
        level_limit: 11.0,
        settle_samples: 50,
        raise_samples: 5,
        clear_samples: 30,
        ..AlarmSettings::DEFAULT
    };

    /// A sum of uniforms: approximately normal, variance 1.
    fn noise(state: &mut u64) -> f32 {
        (0..12)
            .map(|_| {
                *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (*state >> 40) as f32 / (1 << 24) as f32
            })
            .sum::<f32>()
            - 6.0
    }

    fn run(
        detector: &mut Detector,
        steps: usize,
        mut residual: impl FnMut(f32) -> f32,
        state: &mut u64,
    ) {
        for step in 0..steps {
            let unit = noise(state);
            detector.observe(residual(unit), 1.0, 1.0, &SETTINGS);
            detector.decide(detector.conditions(step as u64, &SETTINGS), &SETTINGS);
        }
    }

    #[test]
    fn noise_raises_its_alarm_and_clears_when_it_ends() {
        let (mut detector, mut state) = (Detector::NONE, 1);
        run(&mut detector, 5_000, |unit| unit, &mut state);
        assert_eq!(detector.raised, 0);
        run(&mut detector, 300, |unit| 4.0 * unit, &mut state);
        assert_eq!(detector.raised, AlarmSet(0).with(Alarm::NoiseHigh).0, "{detector:?}");
        run(&mut detector, 5_000, |unit| unit, &mut state);
        assert_eq!(detector.raised, 0);
    }

    #[test]
    fn one_absurd_residual_does_not_disable_the_detector() {
        for absurd in [f32::MAX, -f32::MAX] {
            let (mut detector, mut state) = (Detector::NONE, 1);
            detector.observe(absurd, 1.0, 1e6, &SETTINGS);
            assert!(detector.error_square.is_finite(), "{detector:?}");
            run(&mut detector, 10_000, |unit| unit, &mut state);
            assert_eq!(detector.raised, 0, "{detector:?}");
            run(&mut detector, 300, |unit| 4.0 * unit, &mut state);
            assert!(AlarmSet(detector.raised).has(Alarm::NoiseHigh), "{detector:?}");
        }
    }

    #[test]
    fn a_flickering_condition_neither_raises_nor_clears_an_alarm() {
        let mut detector = Detector::NONE;
        let mut on = Conditions::default();
        on.when(true, Alarm::StuckSensor);
        for step in 0..100 {
            let now = if step % 5 == 4 { Conditions::default() } else { on };
            detector.decide(now, &SETTINGS);
            assert!(!AlarmSet(detector.raised).has(Alarm::StuckSensor));
        }
        for _ in 0..5 {
            detector.decide(on, &SETTINGS);
        }
        for step in 0..100 {
            let now = if step % 29 == 28 { on } else { Conditions::default() };
            detector.decide(now, &SETTINGS);
            assert!(AlarmSet(detector.raised).has(Alarm::StuckSensor));
        }
    }
}
