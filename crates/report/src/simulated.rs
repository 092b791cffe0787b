//! The paper's experiments on simulated robots: trials, training, evaluation, seven robots.

use joulebus_predictor::{Model, Network};
use joulebus_settings::FleetSettings;

use super::document::{Cell, Column, Document, Part, Section, Table};
use super::material::Material;
use super::recorded::{all_scores, options, verdict};
use super::robots::Grouping;
use super::unit::Unit;
use super::{ReportError, ablation, calibration, forecast, horizons, paper, power, robots, scores};
use crate::figure::{Axis, Colour, Direction, Figure, Layer, Mark, Panel};
use joulebus_dataset::rows::{Dataset, Row};
use joulebus_eval::score::{Cell as Scores, Design, Recording, Scored, Subject, score};
use joulebus_sim::parts::Parts;
use joulebus_sim::protocol::{Protocol, SAMPLES};
use joulebus_sim::scenario;
use joulebus_train::{Epoch, TrainSettings, Trained, Training};

/// The note on every figure of simulated robots.
pub const NOTE: &str = "simulated robots";

/// Configuration of the simulated experiments.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// Seed of the simulation.
    pub seed: u64,
    /// Samples of each of the six trials, at least 100.
    pub samples: usize,
    /// Steps of the seven robots, at least 100.
    pub robot_steps: usize,
    /// Training settings.
    pub recipe: TrainSettings,
    /// Number of training threads, 0 for one per core; the result does not depend on it.
    pub threads: usize,
}

impl Simulated {
    /// The paper's sizes and recipe.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            samples: SAMPLES,
            robot_steps: SAMPLES,
            recipe: TrainSettings {
                name: "network".to_owned(),
                source: "simulation".to_owned(),
                seed,
                ..TrainSettings::default()
            },
            threads: 0,
        }
    }
}

/// Result of the simulated experiments.
#[derive(Debug, Clone)]
pub struct SimulatedReport {
    /// The report.
    pub document: Document,
    /// The trained network.
    pub network: Network,
}

/// Simulates the six trials, trains on 1 to 4 with 5 for validation, evaluates on all six and on
/// seven robots, and reports the results with the paper's numbers. `progress` is called after each
/// epoch.
///
/// # Errors
/// [`ReportError`].
pub fn simulated(
    experiment: &Simulated,
    settings: &FleetSettings,
    mut progress: impl FnMut(Epoch),
) -> Result<SimulatedReport, ReportError> {
    for (what, found) in [
        ("samples", experiment.samples),
        ("robot steps", experiment.robot_steps),
    ] {
        if found < 100 {
            return Err(ReportError::TooShort { what, found });
        }
    }
    let simulate = |protocol: &Protocol| {
        protocol.trial_with(Parts::default(), experiment.seed, experiment.samples)
    };
    let trials = (0..).zip(Protocol::ALL.iter().map(simulate));
    let trials: Vec<Recording> = trials
        .map(|(id, trial)| Recording::new(id, trial))
        .collect();
    let robots = scenario::seven_robots(experiment.seed, experiment.robot_steps);
    let robots = (1..)
        .zip(robots)
        .map(|(id, trial)| Recording::new(id, trial));
    let robots: Vec<Recording> = robots.collect();

    let trained = trained(experiment, &trials, &mut progress)?;
    let models = [Model::Network(trained.network.clone())];
    let evaluated = |recordings: &[Recording]| {
        let subject = Subject {
            settings,
            platform: None,
            models: &models,
            recordings,
            design: &Design::fitted_on(recordings, trials[..4].to_vec()),
        };
        score(subject, &options())
    };
    let (alone, together) = (evaluated(&trials)?, evaluated(&robots)?);
    let everything: Vec<Recording> = trials.iter().skip(5).chain(&robots).cloned().collect();
    let levels = calibration::levels(settings, None, &models[0], &everything)?;
    let document = document(
        experiment,
        &trained,
        [(&trials, &alone), (&robots, &together)],
        &levels,
    );
    Ok(SimulatedReport {
        document,
        network: trained.network,
    })
}

fn trained(
    experiment: &Simulated,
    trials: &[Recording],
    progress: &mut impl FnMut(Epoch),
) -> Result<Trained, ReportError> {
    let rows = |trials: &[Recording]| -> Vec<Row> {
        let rows = trials.iter().flat_map(|trial| &trial.rows.rows);
        rows.copied().collect()
    };
    let dataset = Dataset {
        training: rows(&trials[..4]),
        validation: rows(&trials[4..5]),
        held_out: rows(&trials[5..]),
        description: format!(
            "simulated GTernal robot, seed {}, trials 1 to 4 of {} samples; 5 for validation, 6 held \
             out",
            experiment.seed, experiment.samples
        ),
    };
    let mut training = Training::new(&dataset, &experiment.recipe, experiment.threads)?;
    while !training.is_done() {
        progress(training.epoch()?);
    }
    Ok(training.finish()?)
}

fn document(
    experiment: &Simulated,
    trained: &Trained,
    [(trials, alone), (robots, together)]: [(&[Recording], &Scored); 2],
    levels: &[calibration::Level],
) -> Document {
    let single = Material {
        recordings: trials,
        scored: alone,
        unit: Unit::Milliwatt,
        note: Some(NOTE),
        beside_paper: true,
    };
    let fleet = Material {
        recordings: robots,
        scored: together,
        ..single
    };
    let sixth = trials
        .last()
        .map(|trial| trial.name.clone())
        .unwrap_or_default();
    let first = robots
        .first()
        .map(|trial| trial.name.clone())
        .unwrap_or_default();
    let mut sections = vec![
        comparison(trials, alone, together),
        power::section(&single),
        ablation::section(&single),
        training(trained),
        per_trial(&single),
    ];
    sections.extend(forecast::section(&single, &sixth));
    sections.push(robots::section(
        &fleet,
        Grouping::Robots,
        &together.report.robots,
    ));
    sections.extend(horizons::section(&fleet));
    sections.push(calibration::section(
        &fleet,
        levels,
        &together.report.robots,
        &first,
    ));
    sections.push(all_scores(&fleet, Some(Grouping::Robots)));
    Document {
        title: "The paper's experiments on simulated robots".to_owned(),
        warning: Some(
            "Every number here is of simulated robots. They stand in for the dataset of arXiv \
             2603.13908; nothing here is a claim about real robots."
                .to_owned(),
        ),
        summary: vec![
            format!(
                "Six simulated trials of {} samples (seed {}); a network trained on trials 1 to 4 \
                 with the paper's recipe, trial 5 for validation; evaluated on all six and on \
                 seven simulated robots that are not in its training data.",
                experiment.samples, experiment.seed
            ),
            format!("Seven robots: {}", verdict(together)),
            "The paper's own figures and tables could not be read for this work beyond the numbers \
             that its abstract, its repository and quotations of it give. The figures here show the \
             same quantities; no further similarity is claimed."
                .to_owned(),
        ],
        sections,
    }
}

/// The paper's numbers, one by one.
fn comparison(trials: &[Recording], alone: &Scored, together: &Scored) -> Section {
    let mut rows = Rows(Vec::new());
    power_rows(&mut rows, trials);
    network_rows(&mut rows, alone);
    robot_rows(&mut rows, together);
    Section {
        id: "paper".to_owned(),
        title: "Compared with the paper".to_owned(),
        parts: vec![
            Part::Words(
                "The paper's figures for its real robots, and the same figures for the simulated ones. \
                 The plant was fitted to some of these numbers (docs/plant.md says which). The \
                 linear models are fitted on trials 1 to 4 and scored on all six."
                    .to_owned(),
            ),
            Part::Table(Table {
                id: "table-paper".to_owned(),
                caption: "The paper's numbers (real robots) and those of simulated robots."
                    .to_owned(),
                columns: vec![
                    Column::new("quantity", "quantity"),
                    Column::new("paper", "paper (real)"),
                    Column::new("here", "here (simulated)"),
                ],
                rows: rows.0,
                folded: false,
            }),
        ],
    }
}

struct Rows(Vec<Vec<Cell>>);

impl Rows {
    fn add(&mut self, quantity: &str, paper: Cell, here: Cell) {
        self.0.push(vec![Cell::words(quantity), paper, here]);
    }
}

const MW: Unit = Unit::Milliwatt;

fn power_rows(rows: &mut Rows, trials: &[Recording]) {
    let found = power::pooled(trials);
    rows.add(
        "mean power (mW)",
        MW.cell(paper::POWER_MEAN_W, false),
        MW.cell(found.mean_w, false),
    );
    rows.add(
        "standard deviation of power (mW)",
        MW.cell(paper::POWER_STD_W, false),
        MW.cell(found.std_w, false),
    );
    rows.add(
        "least to greatest power (mW)",
        MW.range(paper::POWER_RANGE_W, false),
        MW.range(found.ends_w, false),
    );
    rows.add(
        "lag-1 autocorrelation, least to greatest of the trials",
        Cell::Range(paper::LAG1, 3),
        Cell::Range(found.lag1, 3),
    );
}

fn network_rows(rows: &mut Rows, alone: &Scored) {
    let all = &alone.report.all;
    let line = |name: &str| {
        let found = all.forecasters.iter().find(|score| score.name == name);
        found.map_or(f64::NAN, |score| score.r2.value)
    };
    for (quantity, papers, name) in [
        ("velocities alone", paper::R2_VELOCITIES, "velocities"),
        (
            "velocities and one past reading",
            paper::R2_ONE_LAG,
            "velocities + 1 lag",
        ),
    ] {
        rows.add(
            &format!("R² of {quantity}"),
            Cell::Number(papers, 2),
            Cell::Number(line(name), 2),
        );
    }
    let of = |cell: &Scores| cell.forecasters.first().map(|score| score.r2.value);
    let r2 = alone.report.trials.iter().filter_map(of);
    rows.add(
        "R² of the network, least to greatest of the trials",
        Cell::Range(paper::R2_TRIALS, 2),
        Cell::Range(power::ends(r2), 3),
    );
    let first = |trial: usize| {
        let cell = alone.report.trials.get(trial);
        cell.and_then(|cell| cell.forecasters.first())
    };
    for (trial, papers_r2, papers_mae_w) in [
        (5, paper::R2_VALIDATION, paper::MAE_VALIDATION_W),
        (6, paper::R2_TRIAL_6, paper::MAE_TRIAL_6_W),
    ] {
        let (r2, mae_w) = first(trial - 1).map_or((f64::NAN, f64::NAN), |score| {
            (score.r2.value, score.mae_w.value)
        });
        rows.add(
            &format!("R² on trial {trial}"),
            Cell::Number(papers_r2, 2),
            Cell::Number(r2, 3),
        );
        rows.add(
            &format!("MAE on trial {trial} (mW)"),
            MW.cell(papers_mae_w, true),
            MW.cell(mae_w, true),
        );
    }
    let sixth = first(5);
    rows.add(
        "mean of reading − forecast on trial 6 (mW)",
        MW.cell(paper::RESIDUAL_MEAN_W, true),
        MW.cell(sixth.map_or(f64::NAN, |score| score.bias_w.value), true),
    );
    let middle = sixth.map_or([f64::NAN; 2], |score| {
        [score.residual.q05_w, score.residual.q95_w]
    });
    rows.add(
        "90 % of the residuals on trial 6 (mW)",
        MW.range(paper::RESIDUAL_90_W, false),
        MW.range(middle, false),
    );
}

fn robot_rows(rows: &mut Rows, together: &Scored) {
    let robots = &together.report.robots;
    let first = || robots.iter().filter_map(|cell| cell.forecasters.first());
    let count = first().count() as f64;
    let mean = first().map(|score| score.r2.value).sum::<f64>() / count;
    let scatter: f64 = first().map(|score| (score.r2.value - mean).powi(2)).sum();
    let [papers_mean, papers_std] = paper::R2_ROBOTS;
    let with_std = |mean: f64, std: f64| Cell::words(format!("{mean:.3} ± {std:.3}"));
    rows.add(
        "R² over seven robots, mean ± standard deviation",
        with_std(papers_mean, papers_std),
        with_std(mean, (scatter / (count - 1.0)).sqrt()),
    );
    rows.add(
        "MAE over seven robots (mW)",
        MW.cell(paper::MAE_ROBOTS_W, true),
        MW.cell(
            first().map(|score| score.mae_w.value).sum::<f64>() / count,
            true,
        ),
    );
    let mut by_power: Vec<(&str, f64)> = robots
        .iter()
        .map(|cell| (cell.name.as_str(), cell.reading_mean_w))
        .collect();
    by_power.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut hungry: Vec<&str> = by_power.iter().take(4).map(|(name, _)| *name).collect();
    hungry.sort_unstable();
    let papers: Vec<String> = paper::HUNGRY_ROBOTS
        .iter()
        .map(ToString::to_string)
        .collect();
    rows.add(
        "the four robots with the highest consumption",
        Cell::words(papers.join(", ")),
        Cell::words(hungry.join(", ")),
    );
    let errors: Vec<f64> = first()
        .map(|score| score.energy_error.value.abs())
        .collect();
    rows.add(
        "largest energy error of a robot (%)",
        Cell::words(format!("below {:.1}", 100.0 * paper::ENERGY_ERROR_ALL)),
        Cell::Number(100.0 * errors.iter().copied().fold(f64::NAN, f64::max), 3),
    );
    let exact = errors
        .iter()
        .filter(|error| **error < paper::ENERGY_ERROR_FOUR)
        .count();
    rows.add(
        "robots with an energy error below 0.1 %",
        Cell::Count(4),
        Cell::Count(exact as u64),
    );
}

/// The training history.
fn training(trained: &Trained) -> Section {
    let curve = |of: fn(&Epoch) -> f64| Mark::Line {
        points: trained
            .epochs
            .iter()
            .map(|epoch| [f64::from(epoch.number), of(epoch)])
            .collect(),
        dashed: false,
    };
    let best = trained.epochs.iter().rev().find(|epoch| epoch.best);
    let number = best.map_or(0, |epoch| epoch.number);
    let panel = Panel {
        title: String::new(),
        x: Axis::new("epoch"),
        y: Axis::log("loss (share of the training variance)"),
        layers: vec![
            Layer::named(
                "training, with dropout",
                Colour::Grey,
                curve(|epoch| epoch.training_loss),
            ),
            Layer::named(
                "validation, trial 5",
                Colour::Blue,
                curve(|epoch| epoch.validation_loss),
            ),
            Layer::named(
                "selected epoch",
                Colour::Vermilion,
                Mark::Rule {
                    at: number.into(),
                    direction: Direction::Up,
                },
            ),
        ],
    };
    let mut figure = Figure::new(
        "figure-training",
        "Training.",
        "Mean squared error of the normalised power by epoch.",
        vec![panel],
    );
    figure.note = Some(NOTE.to_owned());
    Section {
        id: "training".to_owned(),
        title: "Training".to_owned(),
        parts: vec![
            Part::Words(format!(
                "{} rows of trials 1 to 4, {} epochs; selected: epoch {number}.",
                trained.findings.training_rows,
                trained.epochs.len()
            )),
            Part::Figure(figure),
        ],
    }
}

/// The network on each of the six trials.
fn per_trial(material: &Material<'_>) -> Section {
    let sets: Vec<&Scores> = material.scored.report.trials.iter().collect();
    let caption = "Corrected mode, one tick ahead. The network has learned from trials 1 to 4, and \
                   trial 5 is the validation trial; only trial 6 is held out.";
    Section {
        id: "trials".to_owned(),
        title: "The six trials".to_owned(),
        parts: vec![Part::Table(scores::table(
            material,
            "table-trials",
            caption,
            &sets,
        ))],
    }
}
