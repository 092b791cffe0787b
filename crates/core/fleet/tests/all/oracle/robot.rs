//! Reference of one robot, as simple as possible: every step and every score is kept, and sums are
//! recomputed.

use joulebus_energy::{
    Calibration, EnergyModel, EnergySample, EnergyState, ErrorCounts, PlatformErrors, Shown,
    group_of,
};
use joulebus_predictor::{Features, Model};
use joulebus_settings::Platform;
use joulebus_testkit_fleets::random::Noise;
use joulebus_wire::{Freshness, InvalidReason, Quality, Sample, sample_flag};

use super::experts::{Experts, Forecasts, possible};

/// Every sample period of a membership: whether a measurement was made, and whether by a sample or
/// only by the schedule.
#[derive(Debug, Clone, Default)]
pub(crate) struct History {
    periods: Vec<(bool, bool)>,
}

impl History {
    fn sample(&mut self, new: bool) {
        self.periods.push((new, true));
    }

    /// A period without a reading: a due measurement is assumed to be made.
    fn pass(&mut self) {
        let due = self.interval().is_some_and(|interval| self.age() + 1 >= interval);
        self.periods.push((due, false));
    }

    /// Periods since the last measurement; `None` before the first.
    pub(crate) fn known_age(&self) -> Option<u64> {
        let any = self.periods.iter().any(|(new, _)| *new);
        any.then(|| self.age())
    }

    /// Periods since the last measurement; periods before the first do not count.
    fn age(&self) -> u64 {
        let since = self.periods.iter().rev().take_while(|(new, _)| !new);
        (since.count() as u64).min(254)
    }

    /// Recomputed from the beginning.
    pub(crate) fn interval(&self) -> Option<u64> {
        let (mut before, mut interval) = (None::<usize>, None);
        for (at, (new, sampled)) in self.periods.iter().enumerate() {
            if let (Some(before), true) = (before, *new && *sampled) {
                let found = (at - before).min(255) as u64;
                interval = Some(interval.map_or(found, |known: u64| found.min(known + 1)));
            }
            before = if *new { Some(at) } else { before };
        }
        interval
    }

    fn features(&self) -> [f32; 2] {
        match self.interval() {
            Some(interval) => {
                let due = self.age() + 1 >= interval;
                [self.age().min(30) as f32, if due { 1.0 } else { 0.0 }]
            }
            None => [f32::NAN; 2],
        }
    }
}

/// Inputs of forecasts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct By<'a> {
    pub platform: &'a Platform,
    pub model: &'a Model,
    pub experts: &'a Experts,
}

/// The window and its forecast: readings (or forecasts in their place), oldest first.
#[derive(Debug, Clone, Default)]
pub(crate) struct Run {
    pub powers_w: Vec<f32>,
    pub forecast_w: Option<f32>,
    /// The forecasts, if a sample led to them.
    pub forecasts: Option<Forecasts>,
    pub command: Option<(f32, f32)>,
    /// Steps at the end without a reading.
    pub unread: u64,
    /// History of the newest reading; it survives an emptied window.
    pub history: History,
}

impl Run {
    pub(crate) fn is_full(&self) -> bool {
        self.powers_w.len() >= 5
    }

    /// One period without a sample: the forecast replaces the reading. Returns whether that was
    /// possible.
    fn advance(&mut self, by: By<'_>) -> bool {
        let Some(forecast_w) = self.forecast_w else {
            return false;
        };
        self.powers_w.push(forecast_w);
        self.unread += 1;
        self.history.pass();
        let forecasts = self.predict(by, self.command, 0.0, 0.0);
        let forecasts = forecasts.filter(|one| one.learns || !one.is_absurd);
        let forecast_w = forecasts.map(|forecasts| possible(by.platform, forecasts.forecast_w));
        (self.forecast_w, self.forecasts) = (forecast_w, None);
        self.forecast_w.is_some()
    }

    /// Empties the window, without the state that is independent of forecasts.
    fn empty(&mut self) {
        *self = Self { history: std::mem::take(&mut self.history), ..Self::default() };
    }

    /// The window after this many periods without a sample.
    pub(crate) fn ahead(&self, by: By<'_>, steps: u64) -> Option<Self> {
        let mut run = self.clone();
        (0..steps).all(|_| run.advance(by)).then_some(run)
    }

    fn predict(
        &self,
        by: By<'_>,
        command: Option<(f32, f32)>,
        dv: f32,
        domega: f32,
    ) -> Option<Forecasts> {
        let row = self.row(command, dv, domega);
        let network_w = predict(by.model, &row)?;
        // If unknown, one is due.
        let due = row[12] != 0.0;
        Some(by.experts.forecast(by.platform, by.model, &row, network_w, due))
    }

    fn row(&self, command: Option<(f32, f32)>, dv: f32, domega: f32) -> Features {
        let (v, omega) = command.unwrap_or((f32::NAN, f32::NAN));
        let lag = |back: usize| self.powers_w[self.powers_w.len() - back];
        let [age, due] = self.history.features();
        [
            v,
            omega,
            dv,
            domega,
            v.abs(),
            omega.abs(),
            lag(1),
            lag(2),
            lag(3),
            lag(4),
            lag(5),
            age,
            due,
        ]
    }
}

fn predict(model: &Model, row: &Features) -> Option<f32> {
    let forecast_w = match model {
        Model::Network(network) => network.predict_reference_f32(row),
        Model::Persistence(_) => row[6],
    };
    forecast_w.is_finite().then_some(forecast_w)
}

/// Number of missing samples between two samples.
pub(crate) fn missing(elapsed_ns: u64, period_ns: u64) -> u64 {
    if elapsed_ns <= period_ns + period_ns / 2 {
        return 0;
    }
    // Rounded to the nearest number of periods, minus one.
    let (elapsed_ns, period_ns) = (u128::from(elapsed_ns), u128::from(period_ns));
    let periods = (2 * elapsed_ns + period_ns) / (2 * period_ns);
    (periods - 1) as u64
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Scored {
    pub reading_w: f32,
    pub residual_w: f32,
    pub previous_w: f32,
}

/// The account of a robot; it outlives the robot's membership.
#[derive(Debug, Clone, Default)]
pub(crate) struct Account {
    /// Twice the integral of the power, µW · ns.
    pub drawn: i128,
    pub expected: i128,
    pub metered_ns: u64,
    pub unmetered_ns: u64,
    /// Time between all samples, ns; a clock that goes back adds none.
    pub elapsed_ns: u64,
    pub last: Option<(u64, Option<f32>)>,
}

fn microwatts(power_w: f32) -> i128 {
    (f64::from(power_w) * 1e6).round() as i128
}

impl Account {
    /// The next sample does not continue the last reading.
    fn forget_reading(&mut self) {
        if let Some((_, power_w)) = &mut self.last {
            *power_w = None;
        }
    }

    fn meter(
        &mut self,
        stamp_ns: u64,
        power_w: Option<f32>,
        forecast_w: Option<f32>,
        period_ns: u64,
    ) {
        if let Some((last_ns, before_w)) = self.last {
            let elapsed_ns = stamp_ns.saturating_sub(last_ns);
            self.elapsed_ns = self.elapsed_ns.saturating_add(elapsed_ns);
            match (before_w, power_w) {
                (Some(a), Some(b)) if missing(elapsed_ns, period_ns) == 0 => {
                    let both = microwatts(a) + microwatts(b);
                    self.drawn += both * i128::from(elapsed_ns);
                    self.expected += forecast_w.map_or(both, |watts| 2 * microwatts(watts))
                        * i128::from(elapsed_ns);
                    self.metered_ns += elapsed_ns;
                }
                _ => self.unmetered_ns = self.unmetered_ns.saturating_add(elapsed_ns),
            }
        }
        let last_ns = self.last.map_or(stamp_ns, |(last_ns, _)| last_ns.max(stamp_ns));
        self.last = Some((last_ns, power_w));
    }
}

/// Errors of the energy of a platform's robots.
#[derive(Debug)]
pub(crate) struct Errors {
    pub model: EnergyModel,
    pub calibration: Calibration,
    /// Since the last tick.
    pub counts: ErrorCounts,
}

impl Errors {
    pub(crate) fn new(model: &Model, platform: &Platform) -> Self {
        let model = model.energy_or_untrained(platform.power_max_w);
        Self { calibration: Calibration::new(&model), model, counts: Default::default() }
    }

    fn show(&mut self, robot: u32, shown: Shown) {
        for (quantity, shown) in shown.into_iter().enumerate() {
            for (place, number) in shown.into_iter().enumerate() {
                self.counts.groups[group_of(robot)][quantity][place] += number;
            }
        }
    }
}

/// One robot during one membership in the fleet.
#[derive(Debug, Clone)]
pub(crate) struct Robot {
    pub id: u32,
    pub platform: Platform,
    pub experts: Experts,
    pub run: Run,
    pub account: Account,
    pub scored: Vec<Scored>,
    pub energy: EnergyState,
    /// The newest sample: the energy state takes it before the next one, or in the tick.
    pub waiting: Option<EnergySample>,
    /// True if the newest sample is of its charger.
    pub charging: bool,
    /// What its newest reading has shown, which the platform learns with it.
    pub waiting_start: Option<Shown>,
    pub last: Option<Sample>,
    pub residual_w: Option<f32>,
    pub quality: Quality,
}

impl Robot {
    pub(crate) fn new(
        id: u32,
        platform: Platform,
        account: Account,
        shown: &PlatformErrors,
    ) -> Self {
        Self {
            id,
            platform,
            experts: Experts::new(shown.memory.starts_from_last()),
            run: Run::default(),
            account,
            scored: Vec::new(),
            energy: EnergyState::among(id, shown),
            waiting: None,
            charging: false,
            waiting_start: None,
            last: None,
            residual_w: None,
            quality: Quality::Warmup { have: 0 },
        }
    }

    fn by<'a>(&'a self, model: &'a Model) -> By<'a> {
        By { platform: &self.platform, model, experts: &self.experts }
    }

    fn longest(&self) -> u64 {
        self.platform.stale_after_ns / self.platform.period_ns
    }

    pub(crate) fn accept(&mut self, sample: &Sample, model: &Model, errors: &mut Errors) {
        self.absorb(errors);
        let gap = self.bridge(sample, model);
        let forecast_w = self.run.forecast_w;
        let reading_w = sample.has(sample_flag::POWER).then_some(sample.power_w);
        let one_step = !gap && self.run.unread == 0;
        let scorable_w = forecast_w.filter(|_| one_step);
        let period_ns = self.platform.period_ns;
        if sample.has(sample_flag::DISCONTINUITY) {
            self.account.forget_reading();
        }
        self.account.meter(sample.stamp_ns, reading_w, scorable_w, period_ns);
        let learned = self.run.forecasts.filter(|forecasts| forecasts.learns);
        let network_w = learned.map(|forecasts| forecasts.network_w);
        let judged_w = forecast_w.map(|forecast_w| network_w.unwrap_or(forecast_w));
        self.residual_w = reading_w.zip(judged_w).map(|(y, f)| y - f);
        // If it is unknown, a measurement counts as due.
        let due = self.run.history.features()[1] != 0.0;
        let last_w = self.run.powers_w.last().copied().filter(|_| self.run.unread == 0);
        if let (Some(reading_w), Some(forecast_w)) = (reading_w, scorable_w) {
            self.scored.push(Scored {
                reading_w,
                residual_w: reading_w - forecast_w,
                previous_w: *self.run.powers_w.last().expect("it made a forecast"),
            });
        }
        if let Some(reading_w) = reading_w {
            let forecasts = self.run.forecasts.filter(|_| scorable_w.is_some());
            self.experts.learn(forecasts.as_ref(), last_w, due, reading_w);
            self.waiting_start = self.experts.start(&self.platform, model);
        }
        self.read(sample);
        self.forecast(sample, model);
        self.observe(sample);
        self.last = Some(*sample);
    }

    /// A reading represents the power since the last sample unless that was a gap.
    fn observe(&mut self, sample: &Sample) {
        let last_ns = self.last.map_or(0, |last| last.stamp_ns);
        let elapsed_ns = sample.stamp_ns.saturating_sub(last_ns);
        let counted =
            sample.has(sample_flag::POWER) && missing(elapsed_ns, self.platform.period_ns) == 0;
        let known = sample.has(sample_flag::V) && sample.has(sample_flag::OMEGA);
        let (v_mps, omega_radps) = match known {
            true => (sample.v_mps, sample.omega_radps),
            false => (f32::NAN, f32::NAN),
        };
        let broken = sample.has(sample_flag::DISCONTINUITY);
        // On the charger a robot that is known does not work.
        let known_s = self.energy.metered.time_s[3];
        self.charging = sample.has(sample_flag::CHARGING);
        let idle = self.charging && known_s >= 30.0;
        self.waiting = Some(EnergySample {
            power_w: if counted { sample.power_w } else { f32::NAN },
            elapsed_s: if broken || idle { 0.0 } else { (elapsed_ns as f64 * 1e-9) as f32 },
            v_mps,
            omega_radps,
        });
    }

    /// Takes the waiting sample into the energy state.
    pub(crate) fn absorb(&mut self, errors: &mut Errors) {
        let Some(sample) = self.waiting.take() else { return };
        if let Some(shown) = self.waiting_start.take() {
            errors.show(self.id, shown);
        }
        if !self.platform.energy_online {
            self.energy.metered.advance(&errors.model.command, &sample);
            return;
        }
        let platform = errors.calibration.platform();
        let new = self.energy.observe_among(&errors.model, platform, &sample);
        for (shadow, class) in new.classes.into_iter().enumerate() {
            if let Some(class) = class {
                errors.counts.classes[shadow][usize::from(class)] += 1;
            }
        }
        for (shadow, pulls) in new.pulls.into_iter().enumerate() {
            for (place, pull) in pulls.into_iter().enumerate() {
                errors.counts.pulls[shadow][place] += pull;
            }
        }
        if !self.charging {
            errors.show(self.id, new.shown);
        }
    }

    /// Fills the periods between the last sample and this one. Returns whether there were any.
    fn bridge(&mut self, sample: &Sample, model: &Model) -> bool {
        if sample.has(sample_flag::DISCONTINUITY) {
            self.run = Run::default();
            return true;
        }
        let Some(last) = self.last else { return false };
        let steps = missing(sample.stamp_ns - last.stamp_ns, self.platform.period_ns);
        if steps == 0 {
            return false;
        }
        let short = self.run.unread + steps <= self.longest();
        let ahead = Some(steps)
            .filter(|_| short && self.run.is_full())
            .and_then(|steps| self.run.ahead(self.by(model), steps));
        if let Some(run) = ahead {
            self.run = run;
            return true;
        }
        // The last sample may be older than the account: of an earlier stamp, of another source.
        self.account.forget_reading();
        (0..steps).for_each(|_| self.run.history.pass());
        if self.run.powers_w.is_empty() {
            return false;
        }
        self.run.empty();
        true
    }

    fn read(&mut self, sample: &Sample) {
        let reading_w = sample.has(sample_flag::POWER).then_some(sample.power_w);
        match (reading_w, self.run.forecast_w) {
            (Some(reading_w), _) => {
                self.run.powers_w.push(reading_w);
                self.run.unread = 0;
                self.run.history.sample(!sample.has(sample_flag::HELD));
            }
            (None, Some(forecast_w)) if self.run.unread < self.longest() => {
                self.run.powers_w.push(forecast_w);
                self.run.unread += 1;
                self.run.history.pass();
            }
            (None, _) => {
                self.run.history.pass();
                self.run.empty();
            }
        }
    }

    fn forecast(&mut self, sample: &Sample, model: &Model) {
        let known = sample.has(sample_flag::V) && sample.has(sample_flag::OMEGA);
        let command = known.then_some((sample.v_mps, sample.omega_radps));
        let (mut dv, mut domega) = (0.0, 0.0);
        if let (Some(last), Some(before), Some(now)) = (self.last, self.run.command, command) {
            let dt_s = ((sample.stamp_ns - last.stamp_ns) as f64 * 1e-9) as f32;
            (dv, domega) = ((now.0 - before.0) / dt_s, (now.1 - before.1) / dt_s);
        }
        self.run.command = command;
        (self.run.forecast_w, self.run.forecasts) = (None, None);
        let full = self.run.is_full();
        let fresh = self.run.history.interval().is_some() || !model.needs_freshness();
        let runs = full && fresh && (known || !model.needs_command());
        if runs {
            let forecasts = self.run.predict(self.by(model), command, dv, domega);
            self.run.forecasts = forecasts.filter(|one| one.learns || !one.is_absurd);
            self.run.forecast_w = self.run.forecasts.map(|forecasts| forecasts.forecast_w);
        }
        self.quality = match sample.freshness() {
            Freshness::Missing if !full => Quality::Invalid(InvalidReason::NoReading),
            _ if !full => Quality::Warmup { have: self.run.powers_w.len() as u16 },
            _ if !known && model.needs_command() => Quality::Invalid(InvalidReason::NoCommand),
            _ if !runs => Quality::Invalid(InvalidReason::NoFreshness),
            _ if self.run.forecast_w.is_none() => Quality::Invalid(InvalidReason::ModelOutput),
            Freshness::Missing => Quality::OpenLoop { steps: self.run.unread as u16 },
            Freshness::Held => Quality::Held,
            Freshness::Fresh => Quality::Fresh,
        };
    }

    /// The start of a plan after `silent_ns` without a sample by the worker's clock, if there is a
    /// forecast.
    pub(crate) fn plan_start(&self, model: &Model, silent_ns: u64) -> Option<Run> {
        self.shown(model, silent_ns).1?;
        let steps = missing(silent_ns, self.platform.period_ns)
            .min(self.longest().saturating_sub(self.run.unread));
        self.run.ahead(self.by(model), steps)
    }

    /// Output after `silent_ns` without a sample by the worker's clock.
    pub(crate) fn shown(&self, model: &Model, silent_ns: u64) -> (Quality, Option<f32>) {
        if silent_ns > self.platform.stale_after_ns {
            return (Quality::Invalid(InvalidReason::Stale), None);
        }
        let fine =
            matches!(self.quality, Quality::Fresh | Quality::Held | Quality::OpenLoop { .. });
        if !fine {
            return (self.quality, None);
        }
        let steps = missing(silent_ns, self.platform.period_ns)
            .min(self.longest().saturating_sub(self.run.unread));
        match self.run.ahead(self.by(model), steps) {
            Some(run) if steps > 0 => {
                let steps = run.unread as u16;
                (Quality::OpenLoop { steps }, run.forecast_w)
            }
            Some(run) => (self.quality, run.forecast_w),
            None => (Quality::Invalid(InvalidReason::ModelOutput), None),
        }
    }
}

/// One chance in `of`.
pub(crate) fn rarely(noise: &mut Noise, of: u64) -> bool {
    noise.next_u64().is_multiple_of(of)
}
