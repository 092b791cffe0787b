//! The simulated plant compared with every figure of the paper.
//!
//! Each figure is measured on the simulation as the paper describes it and listed with the paper's
//! value, the band within which it is held, and its role: *fitted* figures were targets of the fit,
//! *checked* ones were not, *given* ones were parameters, and *reported* ones are outside and not
//! tested.

use std::fmt;

use joulebus_predictor::{FeatureSet, Network};

use joulebus_dataset::rows::{Dataset, Row, RowOrigin, trial_rows};
use joulebus_dataset::trial::{Column, Trial};
use joulebus_plant::parts::Parts;
use joulebus_plant::protocol::{Protocol, SAMPLES};
use joulebus_sim::protocol::drive_with;
use joulebus_sim::scenario;
use joulebus_statistics::metrics::{Tally, quantile, sorted};
use joulebus_train::linear::{Linear, Terms};
use joulebus_train::{TrainError, TrainSettings, Training};

/// Target of a figure's mean over the seeds of the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Target {
    /// The figure's name.
    pub(crate) name: &'static str,
    /// The target value.
    pub(crate) value: f64,
    /// Deviation that counts as 1 in the misfit.
    pub(crate) scale: f64,
}

/// Targets of the fit. The paper gives the range of the six autocorrelations; their deviation is
/// that of six numbers evenly spread over it.
pub(crate) const TARGETS: [Target; 13] = [
    target("power, mean (mW)", 3652.0, 15.0),
    target("power, standard deviation (mW)", 375.0, 8.0),
    target("power, lowest (mW)", 3000.0, 40.0),
    target("lag-1 autocorrelation, mean", 0.95, 0.002),
    target("lag-1 autocorrelation, deviation between trials", 0.005, 0.004),
    target("R², velocities alone", 0.16, 0.01),
    target("R², velocities and one lag", 0.90, 0.004),
    target("network, R², trial 6", 0.92, 0.01),
    target("network, MAE, trial 6 (mW)", 31.5, 1.5),
    target("network, residual, 5 % below, all trials (mW)", -47.0, 6.0),
    target("network, residual, 95 % below, all trials (mW)", 50.0, 6.0),
    target("seven robots, R², mean", 0.87, 0.006),
    target("seven robots, MAE, mean (mW)", 70.7, 3.0),
];

const fn target(name: &'static str, value: f64, scale: f64) -> Target {
    Target { name, value, scale }
}

/// Every figure that the paper gives, in its order: name, the paper's value, the band of the mean
/// over the seeds, role in the fit.
const PAPER: &str = "
power, mean (mW) | 3,652 | 3580..3720 | fitted
power, standard deviation (mW) | 375 | 340..410 | fitted
power, lowest (mW) | 3,000 | 2900..3120 | fitted
power, highest (mW) | 8,450 | 7500..9400 | checked
lag-1 autocorrelation, trial 1 | .942 to .956 | 0.932..0.966 | checked
lag-1 autocorrelation, trial 2 | .942 to .956 | 0.932..0.966 | checked
lag-1 autocorrelation, trial 3 | .942 to .956 | 0.932..0.966 | checked
lag-1 autocorrelation, trial 4 | .942 to .956 | 0.932..0.966 | checked
lag-1 autocorrelation, trial 5 | .942 to .956 | 0.932..0.966 | checked
lag-1 autocorrelation, trial 6 | .942 to .956 | 0.932..0.966 | checked
lag-1 autocorrelation, mean | .95 | 0.944..0.956 | fitted
lag-1 autocorrelation, deviation between trials | about .005 | 0..0.012 | fitted
R², velocities alone | .16 | 0.12..0.2 | fitted
R², velocities and one lag | .90 | 0.885..0.92 | fitted
v, mean (m/s) | .0279 | 0.01..0.045 | given
v, standard deviation (m/s) | .0736 | 0.065..0.085 | given
ω, mean (rad/s) | .0479 | -0.05..0.15 | given
ω, standard deviation (rad/s) | 1.0187 | 0.9..1.15 | given
network, R², trial 1 | .89 to .92 | 0.875..0.935 | checked
network, R², trial 2 | .89 to .92 | 0.875..0.935 | checked
network, R², trial 3 | .89 to .92 | 0.875..0.935 | checked
network, R², trial 4 | .89 to .92 | 0.875..0.935 | checked
network, R², trial 5 | .89 to .92 | 0.875..0.935 | checked
network, R², mean of the trials | .90 | 0.89..0.915 | checked
network, R², trial 6 | .92 | 0.895..0.935 | fitted
network, MAE, trial 6 (mW) | 31.5 | 26..37 | fitted
network, mean residual, all trials (mW) | 1.3 | -7..7 | checked
network, residual, 5 % below, all trials (mW) | −47 | -65..-30 | fitted
network, residual, 95 % below, all trials (mW) | 50 | 33..70 | fitted
seven robots, R², mean | .87 | 0.85..0.89 | fitted
seven robots, R², standard deviation | .018 | 0.005..0.03 | checked
seven robots, MAE, mean (mW) | 70.7 | 60..82 | fitted
seven robots, least of 1, 2, 3, 6 above most of 4, 5, 7 (mW) | above 0 | 50..1000 | given
seven robots, largest energy error (%) | below 2.3 | 0..2.3 | checked
seven robots, median energy error (%) | below 0.1 | 0..1.3 | checked
seven robots, energy errors below 0.1 % | 4 | – | reported
";

/// One figure.
#[derive(Clone, Debug)]
pub(crate) struct Figure {
    /// The measured quantity, with its unit.
    pub(crate) name: String,
    /// The paper's value.
    pub(crate) paper: String,
    /// The plant's value.
    pub(crate) found: f64,
    /// The band of the mean over the seeds, both ends included; `None` for a figure that is only
    /// reported.
    pub(crate) held: Option<(f64, f64)>,
    /// Role in the fit.
    pub(crate) role: String,
}

impl Figure {
    /// The figure of a line of [`PAPER`].
    fn new(line: &str, found: f64) -> Self {
        let cells: Vec<&str> = line.split(" | ").collect();
        let number = |text: &str| text.parse::<f64>().expect("a number");
        let band = cells[2].split_once("..");
        Self {
            name: cells[0].to_owned(),
            paper: cells[1].to_owned(),
            found,
            held: band.map(|(low, high)| (number(low), number(high))),
            role: cells[3].to_owned(),
        }
    }

    /// True if the figure lies in its band, or has none.
    pub(crate) fn holds(&self) -> bool {
        self.held.is_none_or(|(low, high)| (low..=high).contains(&self.found))
    }
}

/// Statistics of six trials that need no network.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Basics {
    /// Mean power, W.
    pub(crate) mean_w: f64,
    /// Standard deviation of power, W.
    pub(crate) std_w: f64,
    /// Lowest reading, W.
    pub(crate) min_w: f64,
    /// Highest reading, W.
    pub(crate) max_w: f64,
    /// Lag-1 autocorrelation of power, per trial.
    pub(crate) rho1: Vec<f64>,
    /// R² of least squares on the six velocity features, fitted and scored on all trials.
    pub(crate) r2_velocities: f64,
    /// The same with the last reading as an additional feature.
    pub(crate) r2_one_lag: f64,
    /// 5 % and 95 % quantiles of the residuals of AR(5) with velocities over all trials, W.
    pub(crate) ar_q05_q95_w: (f64, f64),
    /// Mean absolute residual of persistence over all trials, W.
    pub(crate) persistence_mae_w: f64,
    /// Mean and standard deviation of v, m/s, and of ω, rad/s.
    pub(crate) commands: [(f64, f64); 2],
}

fn mean_and_std(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares = values.iter().map(|value| (value - mean) * (value - mean));
    (mean, libm::sqrt(squares.sum::<f64>() / count))
}

/// Autocorrelation at lag 1.
fn rho1(values: &[f64]) -> f64 {
    let (mean, std) = mean_and_std(values);
    let products = values.windows(2).map(|pair| (pair[0] - mean) * (pair[1] - mean));
    products.sum::<f64>() / (values.len() as f64 * std * std)
}

/// Readings of a trial; simulated trials have all columns.
fn column(trial: &Trial, column: Column) -> &[f64] {
    trial.column(column).unwrap_or_default()
}

impl Basics {
    /// Measures trials, and their rows in the same order.
    pub(crate) fn new(trials: &[Trial], rows: &[Vec<Row>]) -> Self {
        let all = |kind: Column| -> Vec<f64> {
            let values = trials.iter().flat_map(|trial| column(trial, kind));
            values.copied().collect()
        };
        let power_w = all(Column::Power);
        let (mean_w, std_w) = mean_and_std(&power_w);
        let flat: Vec<Row> = rows.iter().flatten().copied().collect();
        let linear = |terms| {
            let fitted = Linear::fit(&flat, terms).unwrap_or_else(|_| Linear::persistence());
            residuals(&flat, &fitted.predict_rows(&flat))
        };
        let r2 = |residuals_w: &[f64]| {
            let targets: Vec<f64> = flat.iter().map(|row| f64::from(row.target_w)).collect();
            let (_, std_w) = mean_and_std(&targets);
            let squares = residuals_w.iter().map(|residual| residual * residual);
            1.0 - squares.sum::<f64>() / (flat.len() as f64 * std_w * std_w)
        };
        let ar_w = sorted(linear(Terms::AR5_AND_VELOCITIES));
        let persistence_w = residuals(&flat, &Linear::persistence().predict_rows(&flat));
        Self {
            mean_w,
            std_w,
            min_w: power_w.iter().copied().fold(f64::INFINITY, f64::min),
            max_w: power_w.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            rho1: trials.iter().map(|trial| rho1(column(trial, Column::Power))).collect(),
            r2_velocities: r2(&linear(Terms::VELOCITIES)),
            r2_one_lag: r2(&linear(Terms::velocities_and_lags(1))),
            ar_q05_q95_w: (quantile(&ar_w, 0.05), quantile(&ar_w, 0.95)),
            persistence_mae_w: persistence_w.iter().map(|w| w.abs()).sum::<f64>()
                / persistence_w.len() as f64,
            commands: [Column::V, Column::Omega].map(|kind| mean_and_std(&all(kind))),
        }
    }
}

fn residuals(rows: &[Row], forecasts_w: &[f64]) -> Vec<f64> {
    let pairs = rows.iter().zip(forecasts_w);
    pairs.map(|(row, forecast_w)| f64::from(row.target_w) - forecast_w).collect()
}

/// The six trials of a seed and their rows.
pub(crate) fn six_trials(parts: Parts, seed: u64) -> (Vec<Trial>, Vec<Vec<Row>>) {
    let trials: Vec<Trial> =
        Protocol::ALL.iter().map(|&protocol| drive_with(protocol, parts, seed, SAMPLES)).collect();
    let rows = trials.iter().map(|trial| trial_rows(trial).rows).collect();
    (trials, rows)
}

/// The paper's split: trials 1 to 4 for training, 5 for validation, 6 held out.
///
/// `rows` are those of the six trials, in order; further trials are ignored.
pub(crate) fn papers_split(rows: &[Vec<Row>], description: &str) -> Dataset {
    let part = |range: std::ops::Range<usize>| -> Vec<Row> {
        let parts = rows.iter().enumerate().skip(range.start).take(range.len());
        let rows = parts.flat_map(|(number, rows)| {
            let origin = RowOrigin::recording(number);
            rows.iter().map(move |row| row.of(origin))
        });
        rows.collect()
    };
    Dataset {
        training: part(0..4),
        validation: part(4..5),
        held_out: part(5..6),
        description: description.to_owned(),
        period_s: 0.0,
    }
}

/// A network trained by the paper's recipe on the paper's split of six trials.
///
/// # Errors
/// [`TrainError`], which the plant's data does not cause.
pub(crate) fn trained(rows: &[Vec<Row>], seed: u64) -> Result<Network, TrainError> {
    let dataset = papers_split(rows, &format!("simulated trials 1-4 / 5 / 6, seed {seed}"));
    let settings = TrainSettings::new("gternal-trials", "simulation", FeatureSet::Full, seed);
    let mut training = Training::new(&dataset, &settings, 0)?;
    while !training.is_done() {
        training.epoch()?;
    }
    Ok(training.finish()?.network)
}

/// Score of a network on a trial's rows.
#[derive(Clone, Debug)]
pub(crate) struct Score {
    /// R², MAE, bias, energy.
    pub(crate) tally: Tally,
    /// Residuals, reading minus forecast, ascending, W.
    pub(crate) residuals_w: Vec<f64>,
}

/// Scores a network on rows that are `step_s` seconds apart.
pub(crate) fn score(network: &Network, rows: &[Row], step_s: f64) -> Score {
    let inputs: Vec<_> = rows.iter().map(|row| row.features).collect();
    let mut forecasts_w = vec![0.0; rows.len()];
    network.predict(&inputs, &mut forecasts_w);
    let mut tally = Tally::default();
    for (row, forecast_w) in rows.iter().zip(&forecasts_w) {
        tally.add(f64::from(row.target_w), f64::from(*forecast_w), step_s);
    }
    let forecasts_w: Vec<f64> = forecasts_w.iter().map(|w| f64::from(*w)).collect();
    Score { tally, residuals_w: sorted(residuals(rows, &forecasts_w)) }
}

/// Everything measured on one seed.
#[derive(Clone, Debug)]
pub(crate) struct Measured {
    /// Without a network.
    pub(crate) basics: Basics,
    /// The network on each of the six trials.
    pub(crate) trials: Vec<Score>,
    /// The network on each of the seven robots.
    pub(crate) robots: Vec<Score>,
    /// Mean power of each of the seven robots, W.
    pub(crate) robots_w: Vec<f64>,
}

/// Measures the plant: six trials, a network trained on them, seven robots. Takes some seconds.
///
/// # Errors
/// [`TrainError`], which the plant's data does not cause.
pub(crate) fn measure(
    parts: Parts,
    seed: u64,
    scenario_steps: usize,
) -> Result<Measured, TrainError> {
    let (trials, rows) = six_trials(parts, seed);
    let network = trained(&rows, seed)?;
    let step_s = joulebus_plant::arena::STEP_S;
    let run = scenario::run(parts, seed, scenario_steps);
    let robots = run.trials.iter().map(|trial| {
        let rows = trial_rows(trial).rows;
        score(&network, &rows, step_s)
    });
    Ok(Measured {
        basics: Basics::new(&trials, &rows),
        trials: rows.iter().map(|rows| score(&network, rows, step_s)).collect(),
        robots: robots.collect(),
        robots_w: run
            .trials
            .iter()
            .map(|trial| mean_and_std(column(trial, Column::Power)).0)
            .collect(),
    })
}

impl Measured {
    /// Every figure that the paper gives, in its order.
    pub(crate) fn figures(&self) -> Vec<Figure> {
        let found = [self.of_power(), self.of_the_network(), self.of_robots()].concat();
        let lines: Vec<&str> = PAPER.trim().lines().collect();
        assert_eq!(lines.len(), found.len(), "every figure is measured");
        let figures = lines.iter().zip(found);
        figures.map(|(line, found)| Figure::new(line, found)).collect()
    }

    fn of_power(&self) -> Vec<f64> {
        let basics = &self.basics;
        let power_w = [basics.mean_w, basics.std_w, basics.min_w, basics.max_w];
        let (mean, deviation) = mean_and_std(&basics.rho1);
        let [(v, v_std), (omega, omega_std)] = basics.commands;
        let mut found = power_w.map(|w| w * 1e3).to_vec();
        found.extend(&basics.rho1);
        found.extend([mean, deviation, basics.r2_velocities, basics.r2_one_lag]);
        found.extend([v, v_std, omega, omega_std]);
        found
    }

    fn of_the_network(&self) -> Vec<f64> {
        let all = self.trials.iter().flat_map(|score| &score.residuals_w);
        let residuals_w = sorted(all.copied());
        let bias_w = residuals_w.iter().sum::<f64>() / residuals_w.len() as f64;
        let mut found: Vec<f64> = self.trials.iter().map(|score| score.tally.r2()).collect();
        let mean = mean_and_std(&found).0;
        found.insert(found.len() - 1, mean);
        let held_out_w = self.trials.last().map_or(f64::NAN, |score| score.tally.mae_w());
        let (low_w, high_w) = (quantile(&residuals_w, 0.05), quantile(&residuals_w, 0.95));
        found.extend([held_out_w, bias_w, low_w, high_w].map(|w| w * 1e3));
        found
    }

    fn of_robots(&self) -> Vec<f64> {
        let of = |figure: fn(&Tally) -> f64| -> Vec<f64> {
            self.robots.iter().map(|robot| figure(&robot.tally)).collect()
        };
        let (r2_mean, r2_std) = mean_and_std(&of(Tally::r2));
        let (mae, _) = mean_and_std(&of(|tally| tally.mae_w() * 1e3));
        let energy = of(|tally| 100.0 * tally.energy_error().abs());
        let most = energy.iter().copied().fold(0.0, f64::max);
        let median = quantile(&sorted(energy.iter().copied()), 0.5);
        let small = energy.iter().filter(|error| **error < 0.1).count() as f64;
        let (more, rest): (Vec<f64>, Vec<f64>) = self.more_and_rest();
        let lead_w = more.iter().copied().fold(f64::INFINITY, f64::min)
            - rest.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        vec![r2_mean, r2_std, mae, lead_w * 1e3, most, median, small]
    }

    fn more_and_rest(&self) -> (Vec<f64>, Vec<f64>) {
        let robots = (1..).zip(&self.robots_w);
        let (more, rest): (Vec<_>, Vec<_>) =
            robots.partition(|(robot, _)| [1, 2, 3, 6].contains(robot));
        let powers = |robots: Vec<(i32, &f64)>| robots.iter().map(|(_, w)| **w).collect();
        (powers(more), powers(rest))
    }
}

/// A figure over several seeds.
#[derive(Clone, Debug)]
pub(crate) struct Averaged {
    /// The figure of one of the seeds, with the mean as its value.
    pub(crate) figure: Figure,
    /// Standard deviation over the seeds.
    pub(crate) std: f64,
}

impl Averaged {
    /// The figures of each seed, averaged.
    pub(crate) fn of(seeds: &[Vec<Figure>]) -> Vec<Self> {
        let count = seeds.first().map_or(0, Vec::len);
        let averaged = |place: usize| {
            let values: Vec<f64> = seeds.iter().map(|figures| figures[place].found).collect();
            let (found, std) = mean_and_std(&values);
            let figure = Figure { found, ..seeds[0][place].clone() };
            Self { figure, std }
        };
        (0..count).map(averaged).collect()
    }
}

impl fmt::Display for Averaged {
    /// A line of the table in the docs.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Figure { name, paper, found, held, role } = &self.figure;
        let places = self.figure.places();
        let band = match held {
            None => "–".to_owned(),
            Some((low, high)) => format!("{low:.places$} to {high:.places$}"),
        };
        let std = self.std;
        write!(out, "| {name} | {paper} | {found:.places$} ± {std:.places$} | {band} | {role} |")
    }
}

impl Figure {
    /// Significant decimal places.
    fn places(&self) -> usize {
        match self.held.map(|(low, high)| low.abs().max(high.abs())) {
            Some(most) if most < 2.0 => 3,
            Some(most) if most >= 100.0 => 0,
            _ => 1,
        }
    }
}
