//! The tables of docs/measured/energy.md: energy forecasts of recordings and of simulated robots
//! that neither the energy model nor the network was trained on.
//!
//! ```text
//! cargo run --release -p joulebus-eval --example energy -- \
//!     [--quick] [--every=ROWS] [--from=ROW] [SIMULATED]
//! ```
//!
//! It does cross-validation on two halves of each set of recordings. It also scores each surface,
//! terrain and platform with training on all others. Robots come one after the other, in the order
//! of their files, and learn the errors of the energy together. The intervals of the first and of
//! the second half of the recordings are scored apart, too. With `--quick` the networks train for
//! two epochs only. `--every=1` forecasts at every row instead of every tenth, `--from=15` at none
//! before that row.

use std::error::Error;
use std::path::{Path, PathBuf};

use joulebus_dataset::rows::{Dataset, RowOrigin, trial_rows};
use joulebus_dataset::trial::Trial;
use joulebus_energy::Calibration;
use joulebus_eval::energy::EnergyScores;
use joulebus_predictor::{FeatureSet, Model};
use joulebus_train::{TrainSettings, train};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

fn main() -> Result<()> {
    let quick = std::env::args().any(|argument| argument == "--quick");
    let number = |option: &str| {
        std::env::args().find_map(|argument| argument.strip_prefix(option)?.parse().ok())
    };
    let origins = (number("--every=").unwrap_or(10), number("--from=").unwrap_or(0));
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/data");
    let simulated = std::env::args().skip(1).find(|argument| !argument.starts_with("--"));
    let sets = [
        ("robotino", FeatureSet::Full, data.join("robotino")),
        ("borealtc_husky", FeatureSet::Full, data.join("borealtc_husky")),
        ("ase_rover", FeatureSet::PowerOnly, data.join("ase_rover")),
    ];
    let simulated = simulated.map(|folder| ("simulated", FeatureSet::Full, PathBuf::from(folder)));
    for (name, features, folder) in sets.into_iter().chain(simulated) {
        let trials = read(&folder)?;
        let settings = TrainSettings {
            max_epochs: if quick { 2 } else { 20 },
            ..TrainSettings::new(name, "recordings", features, 1)
        };
        let half = |half: usize| move |place: usize, _: &Trial| place % 2 == half;
        let mut scores = Halves::default();
        for own in 0..2 {
            evaluate(&trials, &settings, half(own), half(1 - own), (origins, &mut scores))?;
        }
        scores.print(&format!("{name}, each half by the other"));
        let groups = groups(&trials);
        for group in groups.iter().filter(|_| groups.len() > 1) {
            let inside = |trial: &Trial| group_of(trial) == *group;
            let mut scores = Halves::default();
            let others = |_: usize, trial: &Trial| !inside(trial);
            let own = |_: usize, trial: &Trial| inside(trial);
            evaluate(&trials, &settings, others, own, (origins, &mut scores))?;
            scores.print(&format!("{name}, {group} by all others"));
        }
    }
    Ok(())
}

/// Scores of the first and of the second half of the recordings.
#[derive(Default)]
struct Halves([EnergyScores; 2]);

impl Halves {
    fn print(self, title: &str) {
        let Self([first, second]) = self;
        let mut all = first.clone();
        all.append(second.clone());
        println!("\n{title}\n\n{}", all.errors());
        println!(
            "| horizon s | coverage %, first half | score | coverage %, second half | score |"
        );
        println!("|{}", "---|".repeat(5));
        for (first, second) in first.errors().horizons.iter().zip(second.errors().horizons) {
            let of = |coverage: f64, score: f64| format!("{:.1} | {score:.2}", 100.0 * coverage);
            let (one, other) = (of(first.coverage, first.score), of(second.coverage, second.score));
            println!("| {} | {one} | {other} |", first.horizon_s);
        }
    }
}

/// Trains on some trials and scores others, at every n-th row from a row on.
fn evaluate(
    trials: &[Trial],
    settings: &TrainSettings,
    trains: impl Fn(usize, &Trial) -> bool,
    scored: impl Fn(usize, &Trial) -> bool,
    ((every, from), scores): ((usize, usize), &mut Halves),
) -> Result<()> {
    let all = || trials.iter().enumerate();
    let own: Vec<&Trial> =
        all().filter(|(place, trial)| trains(*place, trial)).map(|(_, trial)| trial).collect();
    let scored: Vec<&Trial> =
        all().filter(|(place, trial)| scored(*place, trial)).map(|(_, trial)| trial).collect();
    let rows = |trials: &[&Trial], first: usize, keep: fn(usize) -> bool| {
        let kept = trials.iter().enumerate().filter(|(place, _)| keep(*place));
        let rows = kept.flat_map(|(place, trial)| {
            let origin = RowOrigin::recording(first + place);
            trial_rows(trial).rows.into_iter().map(move |row| row.of(origin))
        });
        rows.collect::<Vec<_>>()
    };
    let dataset = Dataset {
        training: rows(&own, 0, |place| place % 5 != 4),
        validation: rows(&own, 0, |place| place % 5 == 4),
        // For the scores in the model's card alone.
        held_out: rows(&scored, own.len(), |_| true),
        description: settings.name.clone(),
        period_s: (trials[0].period_ns() as f64 * 1e-9) as f32,
    };
    let model = Model::Network(train(&dataset, settings, |_| ())?.network);
    let energy = model.energy().ok_or("the recordings are too short for an energy model")?;
    let mut platform = Calibration::new(energy);
    for (number, trial) in scored.iter().enumerate() {
        // A forecast made at a row is of the rows after it.
        let follows: Vec<bool> = (0..trial.rows()).map(|row| row > from).collect();
        let scores = &mut scores.0[2 * number / scored.len()];
        scores.add_among(every, &model, trial, &follows, (number as u32, &mut platform));
    }
    Ok(())
}

fn read(folder: &Path) -> Result<Vec<Trial>> {
    let files =
        std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut files: Vec<PathBuf> = files.map(|file| Ok(file?.path())).collect::<Result<_>>()?;
    files.retain(|file| {
        file.to_string_lossy().ends_with(".gz") || file.extension().is_some_and(|end| end == "npy")
    });
    files.sort();
    files.iter().map(|file| Ok(Trial::read(file)?)).collect()
}

/// Surface, terrain or protocol: the file's name up to its number.
fn group_of(trial: &Trial) -> String {
    joulebus_dataset::split::group_of(
        &trial.path().file_name().unwrap_or_default().to_string_lossy(),
    )
}

fn groups(trials: &[Trial]) -> Vec<String> {
    let mut groups: Vec<String> = trials.iter().map(group_of).collect();
    groups.sort();
    groups.dedup();
    groups
}
