//! Rollouts: many candidate command sequences, many steps ahead, in one call.

use std::hint::black_box;
use std::time::Instant;

use crate::arguments::BenchOptions;
use joulebus_predictor::{
    FEATURE_NAMES, FeatureSet, Features, Model, Network, ReadingAge, RolloutStart, Rollouts,
};

use crate::report::{grouped, quantile, robots};
use crate::rounds::{Run, interleave};
use crate::{Report, input, kernel};

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
/// A requested kernel is not supported here.
pub(crate) fn measure(options: &BenchOptions) -> anyhow::Result<Report> {
    let (network, report) = kernel::chosen("rollout", options)?;
    let mut report = report.with_input("step_s", STEP_S);
    let cases = if options.quick { &CASES[..2] } else { &CASES };
    let mut works: Vec<Work> = cases.iter().map(|case| Work::new(&network, *case)).collect();
    interleaved(&mut report, &network, &mut works, options);
    report.notes.push(format!(
        "A step is one forecast of one candidate. The kernel for comparison: {KERNEL_ROWS} rows, hot."
    ));
    Ok(report)
}

/// The case of candidates.
pub(crate) fn title((of, candidates, steps): (usize, usize, usize)) -> String {
    format!("{} x {} candidates x {steps} steps", robots(of), grouped(candidates))
}

/// Candidates of a size.
pub(crate) struct Work {
    model: Model,
    starts: Vec<RolloutStart>,
    candidates: usize,
    steps: usize,
    v_mps: Vec<f32>,
    omega_radps: Vec<f32>,
    energy_j: Vec<f32>,
}

impl Work {
    pub(crate) fn new(
        network: &Network,
        (robots, candidates, steps): (usize, usize, usize),
    ) -> Self {
        let lanes = robots * candidates;
        let command = |rows: &[Features], name: &str| -> Vec<f32> {
            let feature = FEATURE_NAMES.iter().position(|other| *other == name);
            rows.iter().map(|row| feature.map_or(0.0, |feature| row[feature])).collect()
        };
        let commands = input::rows(network, input::SEED, lanes * steps);
        let starts = input::rows(network, input::SEED + 1, robots);
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
            energy_j: vec![0.0; lanes],
        }
    }

    fn forecasts(&self) -> usize {
        self.energy_j.len() * self.steps
    }

    /// ns of one call.
    pub(crate) fn run(&mut self) -> f64 {
        let start = Instant::now();
        let rollouts = Rollouts {
            starts: black_box(&self.starts),
            candidates: self.candidates,
            steps: self.steps,
            step_s: STEP_S,
            v_mps: &self.v_mps,
            omega_radps: &self.omega_radps,
        };
        let lanes = 0..self.energy_j.len();
        let done = self.model.rollout(&rollouts, lanes, &mut self.energy_j, None);
        assert!(done.is_ok(), "lengths agree by construction: {done:?}");
        black_box(&mut self.energy_j);
        start.elapsed().as_nanos() as f64
    }
}

/// Each beside the bare kernel.
fn interleaved(report: &mut Report, network: &Network, works: &mut [Work], options: &BenchOptions) {
    let rows = input::rows(network, input::SEED, KERNEL_ROWS);
    let mut forecasts_w = vec![0.0; KERNEL_ROWS];
    let bare = move || {
        let start = Instant::now();
        network.predict(black_box(&rows), black_box(&mut forecasts_w));
        start.elapsed().as_nanos() as f64 / KERNEL_ROWS as f64
    };
    let about = works.iter().map(|work| {
        let case = (work.starts.len(), work.candidates, work.steps);
        (title(case), work.forecasts() as f64)
    });
    let about: Vec<(String, f64)> = about.collect();
    let mut runs: Vec<Run<'_>> = vec![Box::new(bare)];
    runs.extend(works.iter_mut().map(|work| Box::new(|| work.run()) as Run<'_>));
    let measured = interleave(runs, options.rounds(kernel::ROUNDS), options.each());
    let kernel_ns = quantile(&measured[0], 0.5);
    for ((case, forecasts), all_ns) in about.iter().zip(&measured[1..]) {
        let scaled = |scale: f64| -> Vec<f64> { all_ns.iter().map(|ns| ns * scale).collect() };
        report.less("rollout_us", case, "µs", &scaled(1e-3));
        report.less("ns_per_step", case, "ns", &scaled(1.0 / forecasts));
        report.less("step_over_kernel", case, "1", &scaled(1.0 / forecasts / kernel_ns));
    }
    let case = format!("{} rows", grouped(KERNEL_ROWS));
    report.less("kernel_ns_per_robot", &case, "ns", &measured[0]);
}
