//! The lag window of one robot, the input of the model.

mod lanes;

use joulebus_predictor::{FeatureSet, Features, LAGS, ReadingAge, features};
use serde::{Deserialize, Serialize};

use crate::layout::lanes::block;

pub(crate) use lanes::{ClosedLanes, WindowLanes};

block! {
    /// The last readings, newest first, and the forecast made from them.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub(crate) struct Lags: EMPTY;

    /// [`Lags`] of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    struct LagLanes {
        pub lag_w: [f32; LAGS] = [f32::NAN; LAGS],
        /// NaN if there is none.
        pub forecast_w: f32 = f32::NAN,
    }
}

impl Lags {
    /// Advances the window by one sample period.
    #[inline(always)]
    fn push(&mut self, power_w: f32) {
        let [first, second, third, fourth, _] = self.lag_w;
        self.lag_w = [power_w, first, second, third, fourth];
        self.forecast_w = f32::NAN;
    }
}

/// The gap between the last sample and this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Gap {
    None,
    /// This many sample periods are missing. The model bridges them with its own forecasts.
    Bridge(u16),
    /// Too many are missing, or there was no forecast to bridge them: the window starts empty.
    Break,
}

/// The lag window. It advances by the robot's *samples*. Advances by the worker's clock in between
/// (`open`) are provisional and never change the result of a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Window {
    /// After the last sample.
    closed: Lags,
    /// After `open_steps` further periods without a sample.
    open: Lags,
    open_steps: u16,
    /// Sample periods since the last valid reading, as of the last sample.
    pub unread_steps: u16,
    /// Readings in the window.
    have: u8,
    /// True if there is a last command. The energy state has it.
    commanded: bool,
    /// Age of the newest reading, after the last sample. It survives an emptied window, because it
    /// depends on samples only, not on forecasts.
    reading_age: ReadingAge,
}

impl Window {
    pub(crate) const EMPTY: Self = Self {
        closed: Lags::EMPTY,
        open: Lags::EMPTY,
        open_steps: 0,
        unread_steps: 0,
        have: 0,
        commanded: false,
        reading_age: ReadingAge::UNKNOWN,
    };

    #[inline(always)]
    pub(crate) fn have(&self) -> u8 {
        self.have
    }

    /// The readings after the last sample, newest first.
    #[inline(always)]
    pub(crate) fn lags_w(&self) -> [f32; LAGS] {
        self.closed.lag_w
    }

    /// The last reading, if the next sample's follows on it, else NaN.
    #[inline(always)]
    pub(crate) fn last_w(&self) -> f32 {
        if self.unread_steps == 0 { self.closed.lag_w[0] } else { f32::NAN }
    }

    /// True if the next sample's reading is scored if no gap precedes it. Only forecasts one step
    /// ahead are.
    #[inline(always)]
    pub(crate) fn is_scored(&self) -> bool {
        (self.unread_steps == 0) & self.closed.forecast_w.is_finite()
    }

    /// [`Window::lags_w`] after the periods that were run open loop.
    pub(crate) fn open_lags_w(&self) -> [f32; LAGS] {
        self.open.lag_w
    }

    #[inline(always)]
    pub(crate) fn is_full(&self) -> bool {
        usize::from(self.have) == LAGS
    }

    /// The forecast to publish now, W, and the number of open-loop steps it is based on.
    #[inline(always)]
    pub(crate) fn shown(&self) -> (f32, u16) {
        let steps = self.unread_steps.saturating_add(self.open_steps);
        (if self.open_steps > 0 { self.open.forecast_w } else { self.closed.forecast_w }, steps)
    }

    /// The start of a plan made now.
    #[inline(always)]
    pub(crate) fn plan_start(&self) -> PlanStart {
        let (power_w, steps) = self.shown();
        let is_open = self.open_steps > 0;
        let lag_w = if is_open { self.open.lag_w } else { self.closed.lag_w };
        PlanStart {
            lag_w,
            power_w,
            steps,
            is_full: self.is_full(),
            commanded: self.commanded,
            reading_age: if is_open {
                self.reading_age.after(self.open_steps.into())
            } else {
                self.reading_age
            },
        }
    }

    /// The gap between the last sample and one stamped `elapsed_ns` later.
    pub(crate) fn gap_before(&self, elapsed_ns: u64, period_ns: u64, longest_steps: u16) -> Gap {
        let missing = ReadingAge::missing_steps(elapsed_ns, period_ns);
        if missing == 0 || self.have == 0 {
            return Gap::None;
        }
        let within = u64::from(longest_steps) >= missing + u64::from(self.unread_steps);
        if within && self.is_full() && self.closed.forecast_w.is_finite() {
            return Gap::Bridge(missing as u16);
        }
        Gap::Break
    }

    /// Starts open-loop steps towards `steps` periods after the last sample, under its command, m/s
    /// and rad/s. Returns the row to infer next, or `None` when that is reached or there is nothing
    /// to continue from. Steps beyond `steps` that the worker's clock had caused are undone.
    pub(crate) fn open_towards(&mut self, steps: u16, command: (f32, f32)) -> Option<Features> {
        if self.open_steps > steps {
            self.open_steps = 0;
        }
        if self.open_steps == steps {
            return None;
        }
        if self.open_steps == 0 {
            self.open = self.closed;
        }
        let forecast_w = self.open.forecast_w;
        if !forecast_w.is_finite() {
            return None;
        }
        self.open.push(forecast_w);
        self.open_steps += 1;
        let mut row = row(&self.open, command, None);
        self.reading_age.after(self.open_steps.into()).fill(&mut row);
        Some(row)
    }

    /// True if [`Window::close`] needs no further steps open loop.
    #[inline(always)]
    pub(crate) fn can_close(&self, gap: Gap) -> bool {
        match gap {
            Gap::Bridge(steps) => self.open_steps == steps,
            Gap::None | Gap::Break => true,
        }
    }

    /// Makes the open-loop steps up to the arriving sample part of the window. Returns the forecast
    /// for that sample, W, or NaN.
    #[inline(always)]
    pub(crate) fn close(&mut self, gap: Gap) -> f32 {
        match gap {
            Gap::None => {}
            Gap::Bridge(steps) if self.open_steps == steps && self.open.forecast_w.is_finite() => {
                self.closed = self.open;
                self.unread_steps += steps;
            }
            Gap::Bridge(_) | Gap::Break => self.restart(),
        }
        self.open_steps = 0;
        self.closed.forecast_w
    }

    fn restart(&mut self) {
        *self = Self { reading_age: self.reading_age, ..Self::EMPTY };
    }

    /// Resets the age: earlier measurements do not continue.
    pub(crate) fn reset_reading_age(&mut self) {
        self.reading_age = ReadingAge::UNKNOWN;
    }

    /// Advances the age by the sample periods missing before the arriving sample.
    pub(crate) fn skip_periods(&mut self, missing_steps: u64) {
        self.reading_age.pass(missing_steps);
    }

    /// True if a new measurement is due at the next sample. Also true if unknown.
    #[inline(always)]
    pub(crate) fn due(&self) -> bool {
        self.reading_age.is_due().unwrap_or(true)
    }

    /// Same as [`Window::due`], for the forecast that [`Window::shown`] returns.
    pub(crate) fn shown_due(&self) -> bool {
        let reading_age = self.reading_age.after(self.open_steps.into());
        reading_age.is_due().unwrap_or(true)
    }

    /// Takes a sample's reading, W, new or held: corrected mode.
    #[inline(always)]
    pub(crate) fn read(&mut self, power_w: f32, new: bool) {
        self.reading_age.read(new);
        self.closed.push(power_w);
        self.have = (self.have + 1).min(LAGS as u8);
        self.unread_steps = 0;
    }

    /// Takes a sample without a reading: an open-loop step, if there is a forecast to continue from
    /// and no more than `longest_steps` have passed. Otherwise the window is emptied.
    pub(crate) fn miss(&mut self, longest_steps: u16) {
        self.reading_age.pass(1);
        let forecast_w = self.closed.forecast_w;
        if !forecast_w.is_finite() || self.unread_steps >= longest_steps {
            self.restart();
            return;
        }
        self.closed.push(forecast_w);
        self.unread_steps += 1;
    }

    /// Takes a sample's command, `elapsed_s` after the one `before`, which is NaN if unknown. Returns
    /// the row for the forecast of the next reading, and whether the forecast can be made: the window
    /// is full, and command and reading age are known if they are `required`.
    #[inline(always)]
    pub(crate) fn next_row(
        &mut self,
        (before, elapsed_s): ((f32, f32), f32),
        command: Option<(f32, f32)>,
        required: RequiredInputs,
    ) -> (Features, bool) {
        let previous =
            (self.commanded & (elapsed_s > 0.0)).then_some((before.0, before.1, elapsed_s));
        self.commanded = command.is_some();
        let command = command.unwrap_or((f32::NAN, f32::NAN));
        let mut row = row(&self.closed, command, previous);
        self.reading_age.fill(&mut row);
        let ready = self.is_full()
            & (self.commanded | !required.command)
            & (self.reading_age.is_known() | !required.freshness);
        (row, ready)
    }
}

#[inline(always)]
fn row(
    lags: &Lags,
    (v_mps, omega_radps): (f32, f32),
    previous: Option<(f32, f32, f32)>,
) -> Features {
    features(v_mps, omega_radps, previous, &lags.lag_w)
}

/// The start of a plan made now, open-loop steps included.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlanStart {
    pub lag_w: [f32; LAGS],
    /// The forecast published now, W. NaN if there is none.
    pub power_w: f32,
    /// Sample periods since the last reading.
    pub steps: u16,
    pub is_full: bool,
    pub commanded: bool,
    pub reading_age: ReadingAge,
}

/// Inputs that a model requires in addition to the lags.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RequiredInputs {
    pub command: bool,
    pub freshness: bool,
}

impl RequiredInputs {
    pub(crate) fn new(set: FeatureSet) -> Self {
        Self { command: set.needs_command(), freshness: set.needs_freshness() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn full() -> Window {
        let mut window = Window::EMPTY;
        for step in 0..5u8 {
            window.read(f32::from(step), step % 3 == 0);
            let after = ((0.1, 0.0), 10e-9);
            window.next_row(after, Some((0.1, 0.0)), RequiredInputs::new(FeatureSet::Freshness));
        }
        window.closed.forecast_w = 4.5;
        window
    }

    /// A stand-in for the model: any function of the row.
    fn infer(row: &Features) -> f32 {
        row[6] * 0.5 + row[7] * 0.25 + 1.0 + row[12] * 0.125
    }

    fn open(window: &mut Window, steps: u16) {
        while let Some(row) = window.open_towards(steps, (0.1, 0.0)) {
            window.open.forecast_w = infer(&row);
        }
    }

    #[test]
    fn provisional_open_loop_steps_never_change_the_result_of_a_sample() {
        for missing in 1..6 {
            let mut reference = full();
            open(&mut reference, missing);
            let forecast = reference.close(Gap::Bridge(missing));
            for ahead in 0..8 {
                let mut window = full();
                open(&mut window, ahead);
                open(&mut window, missing);
                let again = window.close(Gap::Bridge(missing));
                assert_eq!(again.to_bits(), forecast.to_bits(), "{missing} missing, {ahead} ahead");
                assert_eq!(window.closed, reference.closed);
            }
        }
    }

    #[test]
    fn the_window_is_newest_first_and_starts_empty_after_a_break() {
        let mut window = full();
        assert_eq!(window.closed.lag_w, [4.0, 3.0, 2.0, 1.0, 0.0]);
        assert_eq!(window.gap_before(10 * 31, 10, 30), Gap::Bridge(30));
        assert_eq!(window.gap_before(10 * 32, 10, 30), Gap::Break);
        assert!(window.close(Gap::Break).is_nan());
        assert_eq!(window.have(), 0);
        assert_eq!(window.gap_before(1_000_000, 10, 30), Gap::None);
    }

    #[test]
    fn open_loop_ends_after_the_longest_gap() {
        let mut window = full();
        for step in 1..=30 {
            window.miss(30);
            assert_eq!(window.unread_steps, step);
            window.closed.forecast_w = 3.0;
        }
        window.miss(30);
        assert_eq!((window.have(), window.unread_steps), (0, 0));
    }
}
