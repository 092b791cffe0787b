//! One pass: every waiting sample is one step of its robot, and all steps share one batch.

use joulebus_predictor::Features;
use joulebus_wire::{Alarm, Freshness, InvalidReason, Quality, Sample, sample_flag};

use crate::Fleet;
use crate::fleet::TILE;
use crate::window::{Gap, missing_steps};

impl Fleet {
    /// Takes the waiting samples of a platform through residual, ledger, window and model.
    pub(crate) fn pass(&mut self, kind: usize) {
        if self.kinds[kind].waiting.is_empty() {
            return;
        }
        let waiting = std::mem::take(&mut self.kinds[kind].waiting);
        for tile in waiting.chunks(TILE) {
            self.pass_tile(kind, tile);
        }
        self.kinds[kind].waiting = waiting;
        self.kinds[kind].waiting.clear();
    }

    fn pass_tile(&mut self, kind: usize, waiting: &[u32]) {
        self.bridge(kind, waiting);
        self.batch.clear();
        for slot in waiting {
            if let Some(row) = self.absorb(kind, *slot as usize) {
                self.batch.push(*slot, row);
            }
        }
        for (slot, forecast_w) in self.batch.infer(&self.kinds[kind].model) {
            if forecast_w.is_finite() {
                self.windows[slot].forecast(forecast_w);
            } else {
                self.robots[slot].last.quality = Quality::Invalid(InvalidReason::ModelOutput);
            }
        }
        for slot in waiting {
            self.robots[*slot as usize].waiting = false;
            self.judge(*slot as usize);
        }
    }

    /// Runs robots with a gap before their waiting sample open loop up to it, a step per round.
    fn bridge(&mut self, kind: usize, waiting: &[u32]) {
        loop {
            self.batch.clear();
            for slot in waiting {
                let index = *slot as usize;
                if let Gap::Bridge(steps) = self.gap(kind, index)
                    && let Some(row) = self.windows[index].open_towards(steps)
                {
                    self.batch.push(*slot, row);
                }
            }
            if !self.infer_open(kind) {
                return;
            }
        }
    }

    /// Shows robots whose sample is overdue what the model expects: provisional, undone by the
    /// sample if it says otherwise.
    pub(crate) fn run_open(&mut self, kind: usize) {
        for start in (0..self.live.len()).step_by(TILE) {
            self.run_open_tile(kind, start);
        }
    }

    fn run_open_tile(&mut self, kind: usize, start: usize) {
        let end = self.live.len().min(start + TILE);
        loop {
            self.batch.clear();
            for slot in &self.live[start..end] {
                let index = *slot as usize;
                let robot = &self.robots[index];
                if usize::from(robot.platform) != kind {
                    continue;
                }
                let silent_ns = self.now_ns.saturating_sub(robot.taken_ns);
                let steps = missing_steps(silent_ns, self.kinds[kind].platform.period_ns);
                let window = &mut self.windows[index];
                let longest = self.kinds[kind]
                    .longest_steps
                    .saturating_sub(window.unread_steps);
                let steps = steps.min(longest.into()) as u16;
                if steps > 0
                    && let Some(row) = window.open_towards(steps)
                {
                    self.batch.push(*slot, row);
                }
            }
            if !self.infer_open(kind) {
                return;
            }
        }
    }

    fn infer_open(&mut self, kind: usize) -> bool {
        if self.batch.rows.is_empty() {
            return false;
        }
        for (slot, forecast_w) in self.batch.infer(&self.kinds[kind].model) {
            self.windows[slot].opened(forecast_w);
        }
        true
    }

    fn gap(&self, kind: usize, slot: usize) -> Gap {
        let pending = &self.pending[slot];
        if pending.flags & sample_flag::DISCONTINUITY != 0 {
            return Gap::Break;
        }
        let Self { kinds, windows, .. } = self;
        let kind = &kinds[kind];
        windows[slot].gap_before(
            pending.stamp_ns,
            kind.platform.period_ns,
            kind.longest_steps,
        )
    }

    /// Takes the waiting sample of a slot. Returns the row for its next forecast, if it gets one.
    fn absorb(&mut self, kind: usize, slot: usize) -> Option<Features> {
        let gap = self.gap(kind, slot);
        let forecast_w = self.windows[slot].close(gap);
        let sample = self.pending[slot].sample(self.robots[slot].id);
        let reading_w = sample.has(sample_flag::POWER).then_some(sample.power_w);
        // Only forecasts one step ahead are scored: the ones over a gap are of another kind.
        let one_step = gap == Gap::None && self.windows[slot].unread_steps == 0;
        let expected_w = (one_step && forecast_w.is_finite()).then_some(forecast_w);
        let longest_ns = match gap {
            // What lies between two recordings was never drawn.
            Gap::Break => 0,
            _ => self.kinds[kind].platform.period_ns * 3 / 2,
        };
        self.ledgers[slot].meter(sample.stamp_ns, reading_w, expected_w, longest_ns);
        if let (Some(reading_w), Some(expected_w)) = (reading_w, expected_w) {
            self.score(kind, slot, reading_w, reading_w - expected_w);
        }
        let last = &mut self.robots[slot].last;
        last.residual_w = reading_w.map_or(f32::NAN, |reading_w| reading_w - forecast_w);
        last.accept(&sample);
        self.step(kind, slot, &sample, reading_w)
    }

    fn score(&mut self, kind: usize, slot: usize, reading_w: f32, residual_w: f32) {
        let kind = &self.kinds[kind];
        let previous_w = self.windows[slot].last_w();
        self.scores[slot].observe(reading_w, residual_w, previous_w);
        let floor_w = kind.platform.power_resolution_w;
        self.intervals[slot].observe(residual_w, floor_w, &self.settings.interval);
        let change_w = reading_w - previous_w;
        self.detectors[slot].observe(residual_w, change_w, kind.sigma_w, &self.settings.alarms);
    }

    /// Moves the window on by the sample: corrected where there is a reading, open loop where not.
    fn step(
        &mut self,
        kind: usize,
        slot: usize,
        sample: &Sample,
        reading_w: Option<f32>,
    ) -> Option<Features> {
        let kind = &self.kinds[kind];
        let window = &mut self.windows[slot];
        match reading_w {
            Some(reading_w) => window.read(reading_w),
            None => window.miss(kind.longest_steps),
        }
        let known = sample.has(sample_flag::V | sample_flag::OMEGA);
        let command = known.then_some((sample.v_mps, sample.omega_radps));
        let row = window.next_row(sample.stamp_ns, command, kind.model.needs_command());
        let last = &mut self.robots[slot].last;
        last.quality = match (sample.freshness(), window.is_full()) {
            (Freshness::Missing, false) => Quality::Invalid(InvalidReason::NoReading),
            (_, false) => Quality::Warmup {
                have: window.have().into(),
            },
            (_, true) if row.is_none() => Quality::Invalid(InvalidReason::NoCommand),
            (Freshness::Missing, true) => Quality::OpenLoop {
                steps: window.unread_steps,
            },
            (Freshness::Held, true) => Quality::Held,
            (Freshness::Fresh, true) => Quality::Fresh,
        };
        let margin = self.settings.alarms.training_margin;
        let range = kind.model.training_range();
        last.outside_training = row
            .zip(range)
            .is_some_and(|(row, range)| range.outside(&row, margin).is_some());
        row
    }

    /// Raises and clears the robot's alarms.
    pub(crate) fn judge(&mut self, slot: usize) {
        let robot = &self.robots[slot];
        let (last, platform) = (
            &robot.last,
            &self.kinds[usize::from(robot.platform)].platform,
        );
        let mut conditions =
            self.detectors[slot].conditions(self.scores[slot].count, &self.settings.alarms);
        let age_ns = last.stamp_ns.saturating_sub(last.measured_ns);
        let equal_ns = last.measured_ns.saturating_sub(last.equal_since_ns);
        let read = last.measured_ns > 0;
        conditions.when(robot.refused_run > 0, Alarm::OutOfRange);
        conditions.when(read && age_ns > platform.hold_max_ns, Alarm::HeldTooLong);
        conditions.when(
            read && equal_ns > platform.stuck_after_ns,
            Alarm::StuckSensor,
        );
        conditions.when(last.outside_training, Alarm::OutOfTraining);
        conditions.when(last.charging, Alarm::OfflineCharging);
        conditions.when(self.deadline_missed, Alarm::DeadlineMissed);
        self.detectors[slot].decide(conditions, &self.settings.alarms);
    }
}
