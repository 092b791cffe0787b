//! One draw of the simulated experiments: what a seed determines.

use std::ops::{ControlFlow, Range};

use joulebus_dataset::rows::{Dataset, Row, RowOrigin};
use joulebus_eval::score::{Contents, Design, Options, Recording, Scored, Subject, score};
use joulebus_plant::parts::Parts;
use joulebus_plant::protocol::Protocol;
use joulebus_predictor::{Model, Network};
use joulebus_settings::FleetSettings;
use joulebus_sim::protocol::drive_with;
use joulebus_sim::scenario;
use joulebus_statistics::metrics::Tally;
use joulebus_train::{Epoch, TrainSettings, Trained, Training};

use super::experiment::Simulated;
use super::{ReportError, recorded::options};

/// Trials that train, of the six. The next one validates and the last is held out.
const TRAINING: usize = 4;

/// The recordings of a seed.
pub(super) struct Recordings {
    pub(super) seed: u64,
    pub(super) trials: Vec<Recording>,
    pub(super) robots: Vec<Recording>,
}

impl Recordings {
    pub(super) fn simulated(experiment: &Simulated, seed: u64) -> Self {
        let trial =
            |protocol: &Protocol| drive_with(*protocol, Parts::default(), seed, experiment.samples);
        let trials = (0..).zip(Protocol::ALL.iter().map(trial));
        let robots = (1..).zip(scenario::seven_robots(seed, experiment.robot_steps));
        let recording = |(id, trial)| Recording::new(id, trial);
        Self {
            seed,
            trials: trials.map(recording).collect(),
            robots: robots.map(recording).collect(),
        }
    }

    /// A network trained on trials 1 to 4, with 5 for validation.
    pub(super) fn train(
        &self,
        experiment: &Simulated,
        mut progress: impl FnMut(Epoch) -> ControlFlow<()>,
    ) -> Result<Trained, ReportError> {
        let rows = |trials: Range<usize>| -> Vec<Row> {
            let numbered = trials.filter_map(|number| Some((number, self.trials.get(number)?)));
            let contents =
                numbered.filter_map(|(number, trial)| Some((number, trial.in_memory()?)));
            let rows = contents.flat_map(|(number, contents)| {
                let origin = RowOrigin::recording(number);
                contents.rows.rows.iter().map(move |row| row.of(origin))
            });
            rows.collect()
        };
        let (seed, samples) = (self.seed, experiment.samples);
        let dataset = Dataset {
            training: rows(0..TRAINING),
            validation: rows(TRAINING..TRAINING + 1),
            held_out: rows(TRAINING + 1..self.trials.len()),
            description: format!(
                "simulated GTernal robot, seed {seed}, trials 1 to 4 of {samples} samples; 5 for \
                 validation, 6 held out"
            ),
            period_s: 1.0 / 30.0,
        };
        let recipe = TrainSettings { seed, ..experiment.recipe.clone() };
        let mut training = Training::new(&dataset, &recipe, experiment.threads)?;
        while !training.is_done() {
            if progress(training.epoch()?).is_break() {
                return Err(ReportError::Ended);
            }
        }
        Ok(training.finish()?)
    }

    /// Scores of a network, by the live path and alone.
    pub(super) fn score(
        self,
        network: &Network,
        settings: &FleetSettings,
        options: &Options,
    ) -> Result<Draw, ReportError> {
        let models = [Model::Network(network.clone())];
        let scored = |recordings: &[Recording]| {
            let subject = Subject {
                settings,
                platform: None,
                models: &models,
                recordings,
                design: &Design::fitted_on(recordings, self.trials[..TRAINING].to_vec()),
            };
            score(subject, options)
        };
        let (alone, together) = (scored(&self.trials)?, scored(&self.robots)?);
        let plain = |recordings: &[Recording]| -> Vec<Plain> {
            let contents = recordings.iter().filter_map(Recording::in_memory);
            contents.map(|one| Plain::new(network, one)).collect()
        };
        Ok(Draw {
            plain_alone: plain(&self.trials),
            plain_together: plain(&self.robots),
            recordings: self,
            alone,
            together,
        })
    }
}

/// The recordings of a seed and the scores of its network on them.
pub(super) struct Draw {
    pub(super) recordings: Recordings,
    /// The live path on the six trials.
    pub(super) alone: Scored,
    /// The live path on the seven robots.
    pub(super) together: Scored,
    /// The network alone, on each of the six trials and of the seven robots.
    pub(super) plain_alone: Vec<Plain>,
    pub(super) plain_together: Vec<Plain>,
}

/// The network alone on one recording, as the paper scores it: nothing learns online.
pub(super) struct Plain {
    pub(super) tally: Tally,
    /// Reading − forecast, W.
    pub(super) residuals_w: Vec<f64>,
}

impl Plain {
    fn new(network: &Network, contents: &Contents) -> Self {
        let rows = &contents.rows.rows;
        let inputs: Vec<_> = rows.iter().map(|row| row.features).collect();
        let mut forecasts_w = vec![0.0; rows.len()];
        network.predict(&inputs, &mut forecasts_w);
        let step_s = contents.trial.period_ns() as f64 * 1e-9;
        let mut tally = Tally::default();
        let mut residuals_w = Vec::with_capacity(rows.len());
        for (row, forecast_w) in rows.iter().zip(forecasts_w) {
            let (reading_w, forecast_w) = (f64::from(row.target_w), f64::from(forecast_w));
            tally.add(reading_w, forecast_w, step_s);
            residuals_w.push(reading_w - forecast_w);
        }
        Self { tally, residuals_w }
    }
}

/// Options of a draw of which only the scores are shown: no intervals.
pub(super) fn scores_only() -> Options {
    let mut options = options();
    options.bootstrap.resamples = 0;
    options
}
