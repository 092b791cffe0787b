//! Gain of online learning on recordings and simulated robots: the table of
//! `docs/measured/online.md`.
//!
//! `cargo bench -p joulebus-eval --bench online_learning` computes all of it (some minutes: 18
//! networks are trained); names after `--`, such as `husky rover robotino simulated elsewhere`,
//! select cases. Recordings are looked for in `../shared/data`, beside the repository.

#[path = "../tests/all/live.rs"]
mod live;

use std::path::{Path, PathBuf};

use joulebus_dataset::rows::{Dataset, RowOrigin, trial_rows};
use joulebus_dataset::split::{
    Assignment, By, Source, Split, assign, assign_leaving_out, group_of,
};
use joulebus_dataset::trial::{Column, Row, Trial};
use joulebus_eval::online_learning::{Judged, VARIANTS, judge, judge_from};
use joulebus_eval::score::recorded_platform;
use joulebus_predictor::{FeatureSet, ModelCard, Network};
use joulebus_settings::Platform;
use joulebus_sim::{protocol, scenario};
use joulebus_statistics::metrics::Tally;
use joulebus_train::{TrainSettings, scored, train};
use live::settings;

/// Seed of splits and networks.
const SEED: u64 = 1;
/// Rows of the first part of a joined run: seven seconds of Robotino, thirty of Husky.
const CUT: usize = 200;

fn main() {
    let wanted: Vec<String> =
        std::env::args().skip(1).filter(|arg| !arg.starts_with('-')).collect();
    let want = |name: &str| wanted.is_empty() || wanted.iter().any(|word| word == name);
    heading();
    if want("husky") {
        husky();
    }
    if want("robotino") {
        robotino();
    }
    if want("rover") {
        rover();
    }
    if want("simulated") {
        simulated();
    }
    if want("elsewhere") {
        elsewhere();
    }
}

fn heading() {
    println!(
        "| trained on | tested on | trials · readings | persistence | linear | {} | best member | \
         online, MAE in W | squared error over persistence's: first 100 readings · later | \
         first 30 readings, % of online's squared error: persistence · online · squared error over persistence's of the worst trial | coverage: all · least and most of a trial · trials within 2 % · where a new measurement was due | \
         the same, network alone |",
        VARIANTS.map(|(name, _)| name).join(" | ")
    );
    println!("|{}", "---|".repeat(13));
}

fn line(trained_on: &str, tested_on: &str, judged: &Judged) {
    let r2 = |tally: &Tally| match tally.r2() {
        r2 if r2.is_finite() => format!("{r2:.4}"),
        _ => "–".to_owned(),
    };
    let [network, .., last] = &judged.variants;
    let coverage = |of: usize| {
        let variant = &judged.variants[of];
        let ends =
            |fold: fn(f64, f64) -> f64, start| variant.coverage.iter().copied().fold(start, fold);
        format!(
            "{:.3} · {:.3}–{:.3} · {:.0} % · {:.3}",
            variant.intervals.coverage(),
            ends(f64::min, f64::INFINITY),
            ends(f64::max, f64::NEG_INFINITY),
            100.0 * variant.held(0.9),
            variant.due.coverage()
        )
    };
    let [of_persistence, of_online] = judged.start_shares(VARIANTS.len() - 1);
    let start = format!(
        "{:.2} · {:.2} · {:.1}",
        100.0 * of_persistence,
        100.0 * of_online,
        last.squares.worst_start(&judged.allowed)
    );
    println!(
        "| {trained_on} | {tested_on} | {} · {} | {} | {} | {} | {:+.4} | {:.4} | {:.2} · {:.2} | {} | {} | {} |",
        judged.trials,
        network.forecasts.count(),
        r2(&judged.persistence),
        judged.linear.as_ref().map_or("–".to_owned(), r2),
        judged.variants.each_ref().map(|variant| r2(&variant.forecasts)).join(" | "),
        last.forecasts.r2() - judged.best_member_r2(),
        last.forecasts.mae_w(),
        last.squares.first / judged.allowed.first,
        last.squares.later / judged.allowed.later,
        start,
        coverage(VARIANTS.len() - 1),
        coverage(0),
    );
}

/// Recordings of one platform.
struct Recordings {
    trials: Vec<Trial>,
    sources: Vec<Source>,
    recipe: TrainSettings,
    resolution_w: f32,
}

impl Recordings {
    fn read(folder: &str, recipe: TrainSettings, resolution_w: f32) -> Option<Self> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/data");
        let Ok(files) = std::fs::read_dir(root.join(folder)) else {
            println!("no recordings in ../shared/data/{folder}: left out");
            return None;
        };
        let mut paths: Vec<PathBuf> = files.flatten().map(|file| file.path()).collect();
        paths.retain(|path| path.to_string_lossy().ends_with(".csv.gz"));
        paths.sort();
        let trials: Vec<Trial> = paths
            .iter()
            .map(|path| Trial::read(path).unwrap_or_else(|error| panic!("{error}")))
            .collect();
        Some(Self::new(trials, recipe, resolution_w))
    }

    fn new(trials: Vec<Trial>, recipe: TrainSettings, resolution_w: f32) -> Self {
        let sources = trials
            .iter()
            .map(|trial| {
                let name = trial.path().file_name().unwrap_or_default().to_string_lossy();
                Source {
                    trial: name.to_string(),
                    robot: trial.robot_name().unwrap_or_default().to_owned(),
                    group: group_of(&name),
                    rows: trial_rows(trial),
                }
            })
            .collect();
        Self { trials, sources, recipe, resolution_w }
    }

    fn platform(&self) -> Platform {
        Platform { power_resolution_w: self.resolution_w, ..recorded_platform(0, &self.trials[0]) }
    }

    fn network(&self, dataset: &Dataset) -> Network {
        let trained = train(dataset, &self.recipe, |_| ());
        trained.unwrap_or_else(|error| panic!("{error}")).network
    }

    fn judge(&self, network: &Network, is_tested: impl Fn(&Source) -> bool) -> Judged {
        let tested: Vec<&Trial> = self
            .trials
            .iter()
            .zip(&self.sources)
            .filter_map(|(trial, source)| is_tested(source).then_some(trial))
            .collect();
        let judged = judge(network, &self.platform(), &settings(), &tested);
        judged.unwrap_or_else(|error| panic!("{error}"))
    }

    /// Three of ten trials are held out; a network of the others.
    fn split(&self, name: &str) -> (Assignment, Network) {
        let split = Split { by: By::Trial, held_out: 0.3, seed: SEED, ..Split::default() };
        let assignment = assign(&self.sources, split).unwrap_or_else(|error| panic!("{error}"));
        let network = self.network(&assignment.dataset(&self.sources, name.to_owned()));
        (assignment, network)
    }

    /// The trials held out, by a network of the others.
    fn by_trial(&self, name: &str) {
        let (assignment, network) = self.split(name);
        let judged =
            self.judge(&network, |source| assignment.summary.held_out.contains(&source.trial));
        line(name, "other trials of the same", &judged);
    }

    /// Trains on all trials except those left out, and tests on each group of those.
    fn without(
        &self,
        trained_on: &str,
        is_left_out: impl Fn(&str) -> bool,
        tests: &[(&str, &str)],
    ) {
        let split = Split { by: By::Trial, seed: SEED, ..Split::default() };
        let left_out: Vec<String> = self
            .sources
            .iter()
            .filter(|source| is_left_out(&source.group))
            .map(|source| source.trial.clone())
            .collect();
        let assignment = assign_leaving_out(&self.sources, split, &left_out)
            .unwrap_or_else(|error| panic!("{error}"));
        let dataset = assignment.dataset(&self.sources, trained_on.to_owned());
        let network = self.network(&dataset);
        // The scores in a model file must be of its training population: the other trials are not
        // available when the model is made.
        let (scores, residual) = scored(&network, &dataset.validation);
        let card = ModelCard { scores, residual, ..network.card().clone() };
        let network = Network::new(network.parameters().clone(), card);
        let network = network.unwrap_or_else(|error| panic!("{error}"));
        for (tested_on, group) in tests {
            let judged = self.judge(&network, |source| source.group == *group);
            line(trained_on, tested_on, &judged);
            let judged = self.judge_joined(&network, &is_left_out, group);
            line(trained_on, &format!("{tested_on}, joined"), &judged);
        }
    }

    /// Runs that continue on `group` after the first [`CUT`] rows of a trial of the training.
    fn judge_joined(
        &self,
        network: &Network,
        is_left_out: impl Fn(&str) -> bool,
        group: &str,
    ) -> Judged {
        let all = || self.trials.iter().zip(&self.sources);
        let known =
            all().filter(|(trial, source)| trial.rows() > CUT && !is_left_out(&source.group));
        let left_out = all().filter(|(_, source)| source.group == group);
        let joined: Vec<Trial> = known.cycle().zip(left_out).map(|(a, b)| join(a.0, b.0)).collect();
        let from: Vec<(&Trial, usize)> = joined.iter().map(|trial| (trial, CUT)).collect();
        let judged = judge_from(network, &self.platform(), &settings(), &from);
        judged.unwrap_or_else(|error| panic!("{error}"))
    }
}

/// The first [`CUT`] rows of `known`, and all of `next`, as one run.
fn join(known: &Trial, next: &Trial) -> Trial {
    let row = |trial: &Trial, at: usize, shift_s: f64| Row {
        timestamp_s: trial.timestamp_s()[at] + shift_s,
        values: Column::ALL.map(|column| trial.column(column).map_or(f64::NAN, |all| all[at])),
    };
    let end_s = known.timestamp_s()[CUT - 1] + 1e-9 * next.period_ns() as f64;
    let shift_s = end_s - next.timestamp_s()[0];
    let before = (0..CUT).map(|at| row(known, at, 0.0));
    let rows = before.chain((0..next.rows()).map(|at| row(next, at, shift_s)));
    let name = next.robot_name().unwrap_or_default();
    Trial::from_rows(next.path(), name, rows).unwrap_or_else(|error| panic!("{error}"))
}

fn read_husky() -> Option<Recordings> {
    let recipe = TrainSettings::new("husky", "recordings", FeatureSet::Full, SEED);
    Recordings::read("borealtc_husky", recipe, 0.24)
}

fn read_robotino() -> Option<Recordings> {
    let recipe = TrainSettings {
        max_epochs: 20,
        ..TrainSettings::new("robotino", "recordings", FeatureSet::Full, SEED)
    };
    Recordings::read("robotino", recipe, 0.6)
}

fn read_rover() -> Option<Recordings> {
    let recipe = TrainSettings::new("rover", "recordings", FeatureSet::PowerOnly, SEED);
    Recordings::read("ase_rover", recipe, 0.01)
}

/// Models of one kind of robot on all trials of the others.
fn elsewhere() {
    let recipe = TrainSettings::new("simulated", "simulation", FeatureSet::Full, SEED);
    let seven = Recordings::new(scenario::seven_robots(SEED, 8_000), recipe, 0.01);
    let all = [
        ("Husky", read_husky()),
        ("Robotino", read_robotino()),
        ("rover", read_rover()),
        ("simulated robots", Some(seven)),
    ];
    for (name, of) in &all[..3] {
        let Some(of) = of else { continue };
        let (_, network) = of.split(name);
        // The rover has no velocities, so that only its own model reads it.
        let needs_command = network.feature_set().needs_command();
        for (other, on) in &all {
            let Some(on) = on.as_ref().filter(|_| other != name) else {
                continue;
            };
            if !(needs_command && *other == "rover") {
                line(name, other, &on.judge(&network, |_| true));
            }
        }
    }
}

fn husky() {
    let Some(husky) = read_husky() else {
        return;
    };
    husky.by_trial("Husky");
    husky.without("Husky but ice", |group| group == "ICE", &[("ice", "ICE")]);
    for (name, group) in [
        ("asphalt", "ASPHALT"),
        ("flooring", "FLOORING"),
        ("mixed ground", "MIXED"),
        ("sandy loam", "SANDY_LOAM"),
        ("snow", "SNOW"),
    ] {
        husky.without(
            &format!("Husky but {name} and ice"),
            |other| other == group || other == "ICE",
            &[(name, group), ("ice", "ICE")],
        );
    }
}

fn robotino() {
    let Some(robotino) = read_robotino() else {
        return;
    };
    robotino.by_trial("Robotino");
    const LOAD: &str = "wheel_load_distribution_gray_surface_exp";
    for surface in ["brown", "gray", "green", "table"] {
        let group = format!("one_surface_type_{surface}_surface_exp");
        robotino.without(
            &format!("Robotino's surfaces but {surface}"),
            |other| other == group || other == LOAD,
            &[(surface, &group)],
        );
    }
    robotino.without("Robotino's surfaces", |other| other == LOAD, &[("unseen wheel load", LOAD)]);
}

fn rover() {
    let Some(rover) = read_rover() else {
        return;
    };
    rover.by_trial("Rover");
    let (before, after) = ("baseline_on_track", "final_intervention_on_track");
    rover.without(
        "Rover, changed software",
        |group| group == before,
        &[("before the change", before)],
    );
    rover.without(
        "Rover, before the change",
        |group| group == after,
        &[("changed software", after)],
    );
}

/// The paper's setting: trials 1 to 4 for training, 5 for validation, 6 and the seven robots for
/// testing.
fn simulated() {
    let trials = protocol::trials(SEED);
    let seven = scenario::seven_robots(SEED, 8_000);
    for (name, features) in [
        ("simulated trials 1–4", FeatureSet::Full),
        ("the same, freshness read", FeatureSet::Freshness),
    ] {
        let recipe = TrainSettings::new("simulated", "simulation", features, SEED);
        let learned = Recordings::new(trials.clone(), recipe.clone(), 0.01);
        let rows = |range: std::ops::Range<usize>| {
            let numbered = range.map(|number| (RowOrigin::recording(number), number));
            let rows = numbered.flat_map(|(origin, number)| {
                learned.sources[number].rows.rows.iter().map(move |row| row.of(origin))
            });
            rows.collect()
        };
        let dataset = Dataset {
            training: rows(0..4),
            validation: rows(4..5),
            held_out: rows(5..6),
            description: name.to_owned(),
            period_s: 0.0,
        };
        let network = learned.network(&dataset);
        let sixth = learned.sources[5].trial.clone();
        line(name, "trial 6", &learned.judge(&network, |source| source.trial == sixth));
        let tested = Recordings::new(seven.clone(), recipe, 0.01);
        line(name, "seven robots", &tested.judge(&network, |_| true));
    }
}
