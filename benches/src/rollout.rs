//! Rollouts: many candidate command sequences, many steps ahead, in one call.

use std::hint::black_box;
use std::ops::Range;
use std::time::Instant;

use crate::arguments::BenchOptions;
use joulebus_predictor::{
    FEATURE_NAMES, FeatureSet, Features, Model, Network, ReadingAge, RolloutStart, Rollouts,
};

use crate::figure::grouped;
use crate::rounds::{Measurement, interleave};
use crate::{Distribution, Figure, Report, input, kernel, threads};

/// Robots, candidates per robot, steps per candidate.
const CASES: [(usize, usize, usize); 5] =
    [(1, 16, 50), (1, 256, 50), (1, 1_024, 50), (100, 64, 50), (1_000, 16, 30)];
/// Time between two steps, s.
const STEP_S: f32 = 1.0 / 30.0;
/// Rows of the bare kernel: enough for its best tiling, few enough for the core's cache.
const KERNEL_ROWS: usize = 1_024;

/// Measures rollouts of each size, interleaved with the bare kernel.
///
/// # Errors
/// The model cannot be read, or a requested kernel is not supported here.
pub(crate) fn measure(options: &BenchOptions) -> anyhow::Result<Report> {
    let (name, network) = input::network(options.model.as_deref())?;
    let kernel = kernel::fastest(options.kernel.as_deref())?;
    let network = kernel::on(&network, kernel)?;
    let mut report = Report::new("rollout")
        .with_input("model", name)
        .with_input("kernel", kernel::name(kernel))
        .with_input("seed", options.seed)
        .with_input("step_s", STEP_S)
        .with_input("repetitions", options.repetitions());
    let cases = if options.quick { &CASES[..2] } else { &CASES };
    let mut works: Vec<Work> =
        cases.iter().map(|case| Work::new(&network, *case, options.seed)).collect();
    alone(&mut report, &network, &mut works, options);
    if options.threads > 1 {
        for case in cases.iter().filter(|(_, candidates, _)| *candidates >= 64) {
            shared(&mut report, &network, *case, options);
        }
    }
    report.notes.push(format!(
        "A step is one forecast of one candidate. The kernel for comparison: {KERNEL_ROWS} rows, hot."
    ));
    Ok(report)
}

fn title((robots, candidates, steps): (usize, usize, usize)) -> String {
    let plural = if robots == 1 { "" } else { "s" };
    let [robots, candidates] = [robots, candidates].map(|count| grouped(count as u64));
    format!("{robots} robot{plural} x {candidates} candidates x {steps} steps")
}

/// Candidates of a size, all or a part of them.
pub(crate) struct Work {
    model: Model,
    starts: Vec<RolloutStart>,
    candidates: usize,
    steps: usize,
    v_mps: Vec<f32>,
    omega_radps: Vec<f32>,
    lanes: Range<usize>,
    energy_j: Vec<f32>,
}

impl Work {
    pub(crate) fn new(
        network: &Network,
        (robots, candidates, steps): (usize, usize, usize),
        seed: u64,
    ) -> Self {
        let lanes = robots * candidates;
        let command = |rows: &[Features], name: &str| -> Vec<f32> {
            let feature = FEATURE_NAMES.iter().position(|other| *other == name);
            rows.iter().map(|row| feature.map_or(0.0, |feature| row[feature])).collect()
        };
        let commands = input::rows(network, seed, lanes * steps);
        let starts = input::rows(network, seed + 1, robots);
        let start = |row: &Features| RolloutStart {
            command: Some((row[0], row[1])),
            lag_w: std::array::from_fn(|lag| row[FeatureSet::PowerOnly.first() + lag]),
            reading_age: ReadingAge::UNKNOWN,
        };
        Self {
            model: Model::Network(network.clone()),
            starts: starts.iter().map(start).collect(),
            candidates,
            steps,
            v_mps: command(&commands, "v_mps"),
            omega_radps: command(&commands, "omega_radps"),
            lanes: 0..lanes,
            energy_j: vec![0.0; lanes],
        }
    }

    /// The same candidates, of which only a part is run.
    fn part(mut self, lanes: Range<usize>) -> Self {
        self.energy_j.truncate(lanes.len());
        self.lanes = lanes;
        self
    }

    fn forecasts(&self) -> usize {
        self.lanes.len() * self.steps
    }

    fn call(&mut self) {
        let rollouts = Rollouts {
            starts: black_box(&self.starts),
            candidates: self.candidates,
            steps: self.steps,
            step_s: STEP_S,
            v_mps: &self.v_mps,
            omega_radps: &self.omega_radps,
        };
        let done = self.model.rollout(&rollouts, self.lanes.clone(), &mut self.energy_j, None);
        assert!(done.is_ok(), "lengths agree by construction: {done:?}");
        black_box(&mut self.energy_j);
    }

    pub(crate) fn run(&mut self) -> f64 {
        let start = Instant::now();
        self.call();
        start.elapsed().as_nanos() as f64
    }
}

fn alone(report: &mut Report, network: &Network, works: &mut [Work], options: &BenchOptions) {
    let rows = input::rows(network, options.seed, KERNEL_ROWS);
    let mut forecasts_w = vec![0.0; KERNEL_ROWS];
    let bare = move || {
        let start = Instant::now();
        network.predict(black_box(&rows), black_box(&mut forecasts_w));
        start.elapsed().as_nanos() as f64 / KERNEL_ROWS as f64
    };
    let about: Vec<(String, f64)> = works
        .iter()
        .map(|work| {
            let case = (work.starts.len(), work.candidates, work.steps);
            (title(case), work.forecasts() as f64)
        })
        .collect();
    let mut measurements = vec![Measurement::new(bare)];
    measurements.extend(works.iter_mut().map(|work| Measurement::new(|| work.run())));
    interleave(&mut measurements, options.repetitions(), options.each());
    let Some(kernel_ns) = Distribution::new(measurements[0].values()) else {
        return;
    };
    let scaled = |measurement: &Measurement<'_>, scale: f64| -> Vec<f64> {
        measurement.values().iter().map(|ns| ns * scale).collect()
    };
    for ((case, _), measurement) in about.iter().zip(&measurements[1..]) {
        report.push(Figure::less, "rollout_us", case, "µs", &scaled(measurement, 1e-3));
    }
    for ((case, forecasts), measurement) in about.iter().zip(&measurements[1..]) {
        let each = scaled(measurement, 1.0 / forecasts);
        report.push(Figure::less, "ns_per_step", case, "ns", &each);
    }
    for ((case, forecasts), measurement) in about.iter().zip(&measurements[1..]) {
        let over = scaled(measurement, 1.0 / forecasts / kernel_ns.p50);
        report.push(Figure::less, "step_over_kernel", case, "1", &over);
    }
    let case = format!("{} rows", grouped(KERNEL_ROWS as u64));
    report.push(Figure::less, "kernel_ns_per_robot", &case, "ns", measurements[0].values());
}

/// One pinned thread and several on the same candidates, interleaved.
fn shared(
    report: &mut Report,
    network: &Network,
    case: (usize, usize, usize),
    options: &BenchOptions,
) {
    let new = || Work::new(network, case, options.seed);
    let lanes = case.0 * case.1;
    let each = lanes.div_ceil(options.threads);
    let part = |place: usize| (place * each).min(lanes)..((place + 1) * each).min(lanes);
    let mut whole = [new()];
    let mut parts: Vec<Work> = (0..options.threads).map(|place| new().part(part(place))).collect();
    let pinned = threads::compare(&mut whole, &mut parts, Work::call, options);
    let (name, case) = (options.threads, title(case));
    report.push(Figure::less, "pinned_1_us", &case, "µs", &pinned.one_us);
    report.push(Figure::less, &format!("pinned_{name}_us"), &case, "µs", &pinned.several_us);
    let title = format!("pinned_{name}_over_1_speed_up");
    report.push(Figure::more, &title, &case, "1", &pinned.speed_up);
}
