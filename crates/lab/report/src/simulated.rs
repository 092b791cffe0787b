//! The paper's experiments on simulated robots: trials, training, evaluation, seven robots.

use std::ops::ControlFlow;

use joulebus_predictor::Network;
use joulebus_settings::FleetSettings;

use super::comparison::{self, Numbers};
use super::document::{Document, Part, Section};
use super::draw::{Draw, Recordings, scores_only};
use super::experiment::Simulated;
use super::material::Material;
use super::recorded::{all_scores, options};
use super::robots::Grouping;
use super::unit::Unit;
use super::{ReportError, ablation, forecast, power, robots, scores};
use joulebus_eval::score::Cell as Scores;
use joulebus_train::Epoch;

/// The note on every figure of simulated robots.
pub const NOTE: &str = "simulated robots";

/// Result of the simulated experiments.
#[derive(Debug, Clone)]
pub struct SimulatedReport {
    /// The report.
    pub document: Document,
    /// The network of the draw that the figures show.
    pub network: Network,
    /// The seed of that draw.
    pub shown_seed: u64,
}

/// Simulates, for each seed, the six trials, trains on 1 to 4 with 5 for validation, evaluates on
/// all six and on seven robots. Reports mean and deviation of the results with the paper's numbers,
/// and the figures of the draw nearest to the means. `progress` is called with the seed after each
/// epoch, and may end the experiments.
///
/// # Errors
/// [`ReportError`]. [`ReportError::Ended`] when `progress` has ended them.
pub fn simulated(
    experiment: &Simulated,
    settings: &FleetSettings,
    mut progress: impl FnMut(u64, Epoch) -> ControlFlow<()>,
) -> Result<SimulatedReport, ReportError> {
    for (what, found, least) in [
        ("samples", experiment.samples, 100),
        ("robot steps", experiment.robot_steps, 100),
        ("draws", experiment.draws as usize, 2),
    ] {
        if found < least {
            return Err(ReportError::TooShort { what, found, least });
        }
    }
    let mut draws = Vec::new();
    let mut networks = Vec::new();
    for seed in (experiment.seed..).take(experiment.draws as usize) {
        let recordings = Recordings::simulated(experiment, seed);
        let trained = recordings.train(experiment, |epoch| progress(seed, epoch))?;
        let draw = recordings.score(&trained.network, settings, &scores_only())?;
        draws.push(Numbers::new(&draw));
        networks.push(trained);
    }
    let shown = comparison::most_typical(&draws);
    let (trained, seed) = (networks.swap_remove(shown), draws[shown].seed);
    let recordings = Recordings::simulated(experiment, seed);
    let draw = recordings.score(&trained.network, settings, &options())?;
    Ok(SimulatedReport {
        document: document(experiment, &draws, &draw),
        network: trained.network,
        shown_seed: seed,
    })
}

fn document(experiment: &Simulated, draws: &[Numbers], shown: &Draw) -> Document {
    let Recordings { seed, trials, robots } = &shown.recordings;
    let note = format!("{NOTE}, seed {seed}");
    let single = Material {
        recordings: trials,
        scored: &shown.alone,
        unit: Unit::Milliwatt,
        note: Some(&note),
        beside_paper: true,
    };
    let fleet = Material { recordings: robots, scored: &shown.together, ..single };
    let sixth = trials.last().map(|trial| trial.name.clone()).unwrap_or_default();
    let together = &shown.together.report.robots;
    let mut sections = vec![
        comparison::product(draws),
        comparison::section(draws),
        power::section(&single),
        ablation::section(&single),
        per_trial(&single),
    ];
    sections.extend(forecast::section(&single, &sixth));
    sections.push(robots::section(&fleet, Grouping::Robots, together));
    sections.push(all_scores(&fleet, Some(Grouping::Robots)));
    let (count, samples) = (experiment.draws, experiment.samples);
    let (from, to) = (experiment.seed, experiment.seed + u64::from(count) - 1);
    let mut summary = comparison::summary(draws);
    summary.push(format!(
        "Seeds {from} to {to}: for each, six simulated trials of {samples} samples, a network trained on \
         trials 1 to 4 with the paper's recipe, trial 5 for validation, and seven other robots. \
         Numbers of several draws are mean ± standard deviation over them. The figures, and the \
         tables that name no draws, show seed {seed}: of all draws the one nearest to the means."
    ));
    Document {
        title: "The paper's experiments on simulated robots".to_owned(),
        warning: Some(
            "Every number here is of simulated robots. They stand in for the dataset of arXiv \
             2603.13908. Nothing here is a claim about real robots."
                .to_owned(),
        ),
        summary,
        sections,
    }
}

/// The network on each of the six trials.
fn per_trial(material: &Material<'_>) -> Section {
    let sets: Vec<&Scores> = material.scored.report.trials.iter().collect();
    let caption = "Corrected mode, one tick ahead. The network has learned from trials 1 to 4, and \
                   trial 5 is the validation trial. Only trial 6 is held out.";
    Section {
        id: "trials".to_owned(),
        title: "The six trials".to_owned(),
        parts: vec![Part::Table(scores::table(material, "table-trials", caption, &sets))],
    }
}
