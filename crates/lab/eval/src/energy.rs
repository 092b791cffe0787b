//! Energy over the next seconds to minutes, given the commands that were really driven. Compares
//! errors and intervals of the energy model with simpler forecasts and with the network in open
//! loop. The outlook does not know the commands, as the last reading and the means do not.

use std::fmt;

use joulebus_dataset::trial::Trial;
use joulebus_energy::{
    Calibration, Commands, EnergyModel, EnergySample, EnergyState, HORIZONS_S, PlatformErrors,
};
use joulebus_predictor::{
    Features, INPUTS, LAGS, Linear, Model, ReadingAge, RolloutStart, Rollouts,
};
use joulebus_wire::{Sample, sample_flag};
use serde::Serialize;
use serde::ser::{SerializeMap as _, Serializer};

/// Readings before the first forecast.
const FIRST: usize = LAGS;
/// Rows between the origins of forecasts in an evaluation.
pub const EVERY: usize = 10;
/// Coverage of the intervals.
const COVERAGE: f32 = 0.9;

/// The forecasts, in the order of [`HorizonErrors::errors`]. The last one is that of
/// [`EnergyModel::outlook`].
pub const FORECASTS: [&str; 8] = [
    "energy model",
    "last reading",
    "mean 1 s",
    "mean 5 s",
    "mean of all",
    "AR(5)",
    "network",
    "outlook",
];

/// Errors at one horizon.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HorizonErrors {
    /// Horizon, s.
    pub horizon_s: f32,
    /// Forecasts scored, each with the commands that followed.
    pub origins: usize,
    /// Sum of the absolute errors through the sum of the energies, of each of [`FORECASTS`]. NaN
    /// for one that the model does not have.
    #[serde(serialize_with = "by_name")]
    pub errors: [f64; FORECASTS.len()],
    /// Share of measured energies inside the energy model's 90 % interval. NaN without intervals.
    pub coverage: f64,
    /// Share of verdicts "yes" that are right, if each plan is asked with a spare energy just above
    /// the interval: measured energies below its upper end. NaN without intervals.
    pub right_yes: f64,
    /// Mean width of the interval through the mean energy. NaN without intervals.
    pub width: f64,
    /// Width of the narrowest interval that adds the same two numbers to every forecast and, in
    /// hindsight, contains 90 % of the energies, through the mean energy.
    pub narrowest: f64,
    /// Interval score through the mean energy: the width, and twenty times the distance of a
    /// measured energy outside. Less is better. NaN without intervals.
    pub score: f64,
    /// Share of measured energies inside the outlook's 90 % interval. NaN without intervals.
    pub outlook_coverage: f64,
    /// Interval score of the outlook through the mean energy: the mean of its interval's width and
    /// of 20 times the distance of the energies outside. NaN without intervals.
    pub outlook_interval_score: f64,
}

fn by_name<S: Serializer>(errors: &[f64; FORECASTS.len()], to: S) -> Result<S::Ok, S::Error> {
    let mut map = to.serialize_map(Some(FORECASTS.len()))?;
    for (name, error) in FORECASTS.iter().zip(errors) {
        map.serialize_entry(name, error)?;
    }
    map.end()
}

/// Errors at each horizon that the recordings are long enough for.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EnergyErrors {
    /// In ascending order.
    pub horizons: Vec<HorizonErrors>,
}

/// One forecast of each kind, and the measured energy.
#[derive(Clone, Copy, Debug)]
struct Scored {
    energy_j: f64,
    forecasts_j: [f64; FORECASTS.len()],
    /// Lower and upper end.
    interval_j: Option<[f64; 2]>,
    /// The ends of the outlook's interval, J.
    outlook_interval_j: Option<[f64; 2]>,
}

/// Forecasts of several recordings, to be [summed up](EnergyScores::errors).
#[derive(Clone, Debug, Default)]
pub struct EnergyScores {
    scored: [Vec<Scored>; HORIZONS_S.len()],
}

impl EnergyScores {
    /// Adds the forecasts of a recording, at every n-th row, n at least 1, by `model` and its energy
    /// model. Its robot is a new one, the one of this number on a platform whose robots' errors so
    /// far are given, and extended by its own. Only readings with `true` in `scored` are forecast.
    /// Those beyond its end are not.
    pub fn add_among(
        &mut self,
        rows: usize,
        model: &Model,
        trial: &Trial,
        scored: &[bool],
        (number, platform): (u32, &mut Calibration),
    ) {
        let every = rows.max(1);
        let untrained = EnergyModel::untrained(1.0);
        let mut recorded = Recorded::new(model, model.energy().unwrap_or(&untrained), trial);
        recorded.leave_out(scored);
        let (mut state, mut age) =
            (EnergyState::among(number, platform.platform()), ReadingAge::UNKNOWN);
        for row in 0..recorded.samples.len() {
            observe(&mut state, (number, &mut *platform), recorded.energy, &recorded.steps[row]);
            let sample = &recorded.samples[row];
            if sample.has(sample_flag::POWER) {
                age.read(!sample.has(sample_flag::HELD));
            }
            if row >= FIRST && row % every == every / 2 {
                for (scored, horizon_s) in self.scored.iter_mut().zip(HORIZONS_S) {
                    let known = (&state, platform.platform());
                    scored.extend(recorded.forecast(known, age, row, horizon_s));
                }
            }
        }
    }

    /// Adds the forecasts of another.
    pub fn append(&mut self, other: Self) {
        for (own, other) in self.scored.iter_mut().zip(other.scored) {
            own.extend(other);
        }
    }

    /// Errors at each horizon with a forecast.
    pub fn errors(&self) -> EnergyErrors {
        let horizons = self.scored.iter().zip(HORIZONS_S);
        let horizons = horizons.filter(|(scored, _)| !scored.is_empty());
        EnergyErrors {
            horizons: horizons.map(|(scored, horizon_s)| errors(scored, horizon_s)).collect(),
        }
    }
}

/// The errors of a platform without robots.
pub fn untried(model: &Model) -> Calibration {
    match model.energy() {
        Some(energy) => Calibration::new(energy),
        None => Calibration::new(&EnergyModel::untrained(1.0)),
    }
}

/// Extends a platform's errors by those of a recording's robot, as
/// [`add_among`](EnergyScores::add_among) does, without a forecast.
pub fn observe_all(model: &Model, trial: &Trial, (number, platform): (u32, &mut Calibration)) {
    let untrained = EnergyModel::untrained(1.0);
    let energy = model.energy().unwrap_or(&untrained);
    let mut state = EnergyState::among(number, platform.platform());
    for step in Recorded::new(model, energy, trial).steps {
        observe(&mut state, (number, &mut *platform), energy, &step);
    }
}

/// Takes a sample as the fleet does.
fn observe(
    state: &mut EnergyState,
    (number, platform): (u32, &mut Calibration),
    model: &EnergyModel,
    sample: &EnergySample,
) {
    let errors = state.observe_among(model, platform.platform(), sample);
    platform.add(&errors.counted(number));
    state.bounds = platform.platform().plans;
}

/// Fit of intervals to the measured energies: means over the forecasts that have one, NaN without.
struct Intervals {
    coverage: f64,
    /// Share below the upper end.
    below: f64,
    width_j: f64,
    score_j: f64,
}

impl Intervals {
    fn new(scored: &[Scored], interval_j: impl Fn(&Scored) -> Option<[f64; 2]>) -> Self {
        let (mut count, mut inside, mut below) = (0.0, 0.0, 0.0);
        let (mut width_j, mut missed_j) = (0.0, 0.0);
        for one in scored {
            let Some([lo_j, hi_j]) = interval_j(one) else { continue };
            count += 1.0;
            inside += if (lo_j..=hi_j).contains(&one.energy_j) { 1.0 } else { 0.0 };
            below += if one.energy_j <= hi_j { 1.0 } else { 0.0 };
            width_j += hi_j - lo_j;
            missed_j += (lo_j - one.energy_j).max(one.energy_j - hi_j).max(0.0);
        }
        let misses = f64::from(1.0 - COVERAGE);
        let score_j = (width_j + 2.0 / misses * missed_j) / count;
        Self { coverage: inside / count, below: below / count, width_j: width_j / count, score_j }
    }
}

fn errors(scored: &[Scored], horizon_s: f32) -> HorizonErrors {
    let count = scored.len() as f64;
    let energy_j: f64 = scored.iter().map(|one| one.energy_j.abs()).sum();
    let mean_j = energy_j / count;
    let plans = Intervals::new(scored, |one| one.interval_j);
    let outlooks = Intervals::new(scored, |one| one.outlook_interval_j);
    let mut residuals: Vec<f64> =
        scored.iter().map(|one| one.energy_j - one.forecasts_j[0]).collect();
    residuals.sort_by(f64::total_cmp);
    let within = (f64::from(COVERAGE) * count).ceil() as usize;
    let widths = residuals.windows(within.max(1)).map(|part| part[part.len() - 1] - part[0]);
    HorizonErrors {
        horizon_s,
        origins: scored.len(),
        errors: std::array::from_fn(|place| {
            let error = |one: &Scored| (one.forecasts_j[place] - one.energy_j).abs();
            scored.iter().map(error).sum::<f64>() / energy_j
        }),
        coverage: plans.coverage,
        right_yes: plans.below,
        width: plans.width_j / mean_j,
        narrowest: widths.fold(f64::INFINITY, f64::min) / mean_j,
        score: plans.score_j / mean_j,
        outlook_coverage: outlooks.coverage,
        outlook_interval_score: outlooks.score_j / mean_j,
    }
}

/// A recording, prepared.
struct Recorded<'a> {
    model: &'a Model,
    energy: &'a EnergyModel,
    samples: Vec<Sample>,
    steps: Vec<EnergySample>,
    /// Number of readings up to each row that are not to be forecast, that row's included.
    left_out: Vec<usize>,
    /// Energy and time up to each row.
    sums: Vec<[f64; 2]>,
    period_s: f64,
    longest_s: f64,
}

impl<'a> Recorded<'a> {
    fn new(model: &'a Model, energy: &'a EnergyModel, trial: &Trial) -> Self {
        // 0 means "never measured".
        let samples = trial.to_samples(0, 1_000_000_000);
        let period_s = trial.period_ns() as f64 * 1e-9;
        let longest_s = 1.5 * period_s;
        let (mut steps, mut sums) = (Vec::new(), Vec::new());
        let (mut before_ns, mut sum) = (None::<u64>, [0.0; 2]);
        for sample in &samples {
            let elapsed_ns = before_ns.map_or(0, |before| sample.stamp_ns.saturating_sub(before));
            before_ns = Some(sample.stamp_ns);
            let elapsed_s = elapsed_ns as f64 * 1e-9;
            let (v_mps, omega_radps) = command(sample);
            let counted = sample.has(sample_flag::POWER) && elapsed_s <= longest_s;
            steps.push(EnergySample {
                power_w: if counted { sample.power_w } else { f32::NAN },
                elapsed_s: elapsed_s as f32,
                v_mps,
                omega_radps,
            });
            sum = [sum[0] + f64::from(sample.power_w) * elapsed_s, sum[1] + elapsed_s];
            sums.push(sum);
        }
        Self {
            model,
            energy,
            samples,
            left_out: vec![0; steps.len()],
            steps,
            sums,
            period_s,
            longest_s,
        }
    }

    fn leave_out(&mut self, scored: &[bool]) {
        let mut count = 0;
        for (row, left_out) in self.left_out.iter_mut().enumerate() {
            count += usize::from(!scored.get(row).is_some_and(|scored| *scored));
            *left_out = count;
        }
    }

    /// The forecasts of the rows after `row`. `None` if there are too few, or they have a gap.
    fn forecast(
        &self,
        (state, platform): (&EnergyState, &PlatformErrors),
        age: ReadingAge,
        row: usize,
        horizon_s: f32,
    ) -> Option<Scored> {
        let steps = (f64::from(horizon_s) / self.period_s).round().max(1.0) as usize;
        let (first, last) = (row + 1 - FIRST, row + steps);
        let all = self.steps.get(first..=last)?;
        let sound = |step: &EnergySample| step.power_w.is_finite() && step.elapsed_s > 0.0;
        if !all[1..].iter().all(sound) || self.left_out[last] > self.left_out[row] {
            return None;
        }
        let duration_s = self.sums[last][1] - self.sums[row][1];
        let (v_mps, omega_radps): (Vec<f32>, Vec<f32>) =
            self.steps[row..last].iter().map(|step| (step.v_mps, step.omega_radps)).unzip();
        let period_s = (duration_s / steps as f64) as f32;
        let plan = Commands { period_s, v_mps: &v_mps, omega_radps: &omega_radps };
        let forecast = self.energy.forecast(state, plan);
        let end = |p: f32| forecast.quantile_j(p).map(f64::from);
        let lo_j = end((1.0 - COVERAGE) / 2.0);
        let trained = self.model.energy().is_some();
        let ahead = self.energy.outlook([duration_s as f32]);
        let outlook = ahead.of(state, platform, self.samples[row].power_w);
        let ([ahead_j], [ahead_lo_j], [ahead_hi_j]) =
            (outlook.energy_j, outlook.lo_j, outlook.hi_j);
        let mean = |window_s: f64| self.mean_w(row, window_s) * duration_s;
        let lag_w = std::array::from_fn(|lag| self.samples[row - lag].power_w);
        Some(Scored {
            energy_j: self.sums[last][0] - self.sums[row][0],
            forecasts_j: [
                if trained { forecast.energy_j.into() } else { f64::NAN },
                f64::from(lag_w[0]) * duration_s,
                mean(1.0),
                mean(5.0),
                mean(f64::INFINITY),
                self.model.linear().map_or(f64::NAN, |linear| {
                    autoregression(linear, lag_w, steps) * f64::from(period_s)
                }),
                self.network(plan, row, lag_w, age).unwrap_or(f64::NAN),
                if trained { ahead_j.into() } else { f64::NAN },
            ],
            outlook_interval_j: (ahead.bounded() > 0)
                .then(|| [ahead_lo_j, ahead_hi_j].map(f64::from)),
            interval_j: lo_j.zip(end((1.0 + COVERAGE) / 2.0)).map(|(lo_j, hi_j)| [lo_j, hi_j]),
        })
    }

    /// Mean power over a window up to a row, W.
    fn mean_w(&self, row: usize, window_s: f64) -> f64 {
        let [energy_j, time_s] = self.sums[row];
        let within = |sum: &[f64; 2]| time_s - sum[1] > window_s + 0.5 * self.longest_s;
        let before = self.sums[..row].partition_point(within).min(row - 1);
        let [before_j, before_s] = self.sums[before];
        (energy_j - before_j) / (time_s - before_s)
    }

    /// The network in open loop, J.
    fn network(
        &self,
        plan: Commands<'_>,
        row: usize,
        lag_w: [f32; LAGS],
        age: ReadingAge,
    ) -> Option<f64> {
        let before = row.checked_sub(1).map(|before| &self.steps[before])?;
        let command = (before.v_mps, before.omega_radps);
        let start = RolloutStart {
            command: command.0.is_finite().then_some(command),
            lag_w,
            reading_age: age,
        };
        let rollouts = Rollouts {
            starts: &[start],
            candidates: 1,
            steps: plan.steps(),
            step_s: plan.period_s,
            v_mps: plan.v_mps,
            omega_radps: plan.omega_radps,
        };
        let mut energy_j = [f32::NAN];
        self.model.rollout(&rollouts, 0..1, &mut energy_j, None).ok()?;
        Some(energy_j[0].into())
    }
}

fn command(sample: &Sample) -> (f32, f32) {
    if sample.has(sample_flag::V | sample_flag::OMEGA) {
        (sample.v_mps, sample.omega_radps)
    } else {
        (f32::NAN, f32::NAN)
    }
}

/// Sum of the powers of an autoregression in open loop, W.
fn autoregression(linear: &Linear, mut lag_w: [f32; LAGS], steps: usize) -> f64 {
    const NEWEST: usize = INPUTS - 2 - LAGS;
    let mut row: Features = [0.0; INPUTS];
    let mut sum_w = 0.0;
    for _ in 0..steps {
        row[NEWEST..NEWEST + LAGS].copy_from_slice(&lag_w);
        let power_w = linear.predict(&row);
        lag_w.copy_within(..LAGS - 1, 1);
        lag_w[0] = power_w;
        sum_w += f64::from(power_w);
    }
    sum_w
}

impl fmt::Display for EnergyErrors {
    /// A table in Markdown.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "| horizon s | forecasts |")?;
        for name in FORECASTS {
            write!(out, " {name} |")?;
        }
        writeln!(
            out,
            " coverage % | score | outlook's coverage % | its score | right yes % | width | narrowest |"
        )?;
        writeln!(out, "|{}", "---|".repeat(FORECASTS.len() + 9))?;
        for row in &self.horizons {
            write!(out, "| {:>9} | {:>9} |", row.horizon_s, row.origins)?;
            for (name, error) in FORECASTS.iter().zip(row.errors) {
                write!(out, " {:>width$} |", share(error, 3), width = name.len())?;
            }
            let [width, narrowest, score] =
                [row.width, row.narrowest, row.score].map(|value| share(value, 2));
            writeln!(
                out,
                " {:>10} | {score:>5} | {:>20} | {:>9} | {:>11} | {width:>5} | {narrowest:>9} |",
                share(100.0 * row.coverage, 1),
                share(100.0 * row.outlook_coverage, 1),
                share(row.outlook_interval_score, 2),
                share(100.0 * row.right_yes, 1),
            )?;
        }
        Ok(())
    }
}

fn share(value: f64, digits: usize) -> String {
    if value.is_finite() { format!("{value:.digits$}") } else { "–".to_owned() }
}
