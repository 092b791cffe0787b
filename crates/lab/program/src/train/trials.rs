//! `joulebus train trials`: trains on recordings.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use joulebus_dataset::rows::Dataset;
use joulebus_dataset::split::{SourceInfo, Split, SplitSummary, left_out};
use joulebus_dataset::trial::ColumnMap;
use joulebus_eval::score::Recording;
use joulebus_eval::training_data::{MAX_ROWS, Parts, TrainingDataError, training_data};
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::{Output, log_line};
use joulebus_program::shell::word;
use joulebus_train::{Recipe, TrainReport, TrainSettings, recorded_features};

use super::FeatureChoice;
use super::run::RunArguments;
use crate::judgement::{self, AcceptArguments, Judged};
use crate::next_command::{free_lab, recordings};
use crate::recordings::{ColumnArguments, find_recordings, open};
use crate::split_unit::SplitUnit;

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus train trials recordings/ --out robot.safetensors\n  \
    joulebus train trials husky/ --leave-out ICE --out without-ice.safetensors\n  \
    joulebus train trials t1.npy t2.npy t3.npy t4.npy --validate t5.npy --hold-out t6.npy \\\n      \
    --out gternal.safetensors\n\n\
    Rows need five gapless readings before them. Those with a missing number are omitted \
    and counted. configs/recipes/paper.toml explains every setting of a recipe.")]
pub(super) struct Args {
    /// Recordings (.npy, .csv, .csv.gz), captures (.mcap), directories (searched recursively), or
    /// patterns in quotes
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Recordings for early stopping, with --hold-out, instead of a split
    #[arg(long, value_name = "PATH", num_args = 1.., requires = "hold_out")]
    validate: Vec<PathBuf>,
    /// Recordings for the final scores only
    #[arg(long, value_name = "PATH", num_args = 1.., requires = "validate")]
    hold_out: Vec<PathBuf>,
    /// Unit of the split: what is not divided between its parts [default: that of the recipe, or
    /// trial]
    #[arg(long, value_enum, value_name = "BY", conflicts_with = "validate")]
    split: Option<SplitUnit>,
    /// A shift: groups, folders, robots or trials that the model never sees, not even in its
    /// scores. `joulebus eval` with the same recordings and --leave-out evaluates it on them
    #[arg(long, value_name = "NAME,…", value_delimiter = ',', conflicts_with = "validate")]
    leave_out: Vec<String>,
    /// The recipe, a TOML file [default: the paper's]
    #[arg(long, value_name = "FILE")]
    recipe: Option<PathBuf>,
    /// Seed of the split, the initial weights and the order of the rows [default: that of the
    /// recipe]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Input features of the network [default: those of the recipe. If it states none: full, or
    /// power if most rows have no velocities]
    #[arg(long, value_enum)]
    features: Option<FeatureChoice>,
    /// Maximum number of rows to train, validate and score on. If there are more, stretches are
    /// taken that are spread evenly over all recordings
    #[arg(long, value_name = "N", default_value_t = MAX_ROWS)]
    most_rows: NonZeroUsize,
    #[command(flatten)]
    columns: ColumnArguments,
    #[command(flatten)]
    accept: AcceptArguments,
    #[command(flatten)]
    run: RunArguments,
}

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    args.run.check()?;
    let (dataset, summary, implausible, recipe) = args.prepare()?;
    let start = Instant::now();
    let Some(trained) = args.run.train(&dataset, &recipe.training)? else {
        return Ok(Outcome::Failed);
    };
    let mut report =
        TrainReport::new(Some(&args.run.out), &trained, start.elapsed(), Some(summary));
    report.next = args.next();
    judgement::report(output, &report, implausible)?;
    Ok(Outcome::Done)
}

/// Minimum number of trials for holding out whole ones.
const WHOLE_FROM: usize = 4;

impl Args {
    /// Arguments for the default recipe, and recordings that were judged before.
    pub(super) fn new(
        paths: &[PathBuf],
        columns: &ColumnArguments,
        out: &Path,
        trials: usize,
    ) -> Self {
        Self {
            paths: paths.to_vec(),
            validate: Vec::new(),
            hold_out: Vec::new(),
            split: Some(match trials {
                WHOLE_FROM.. => SplitUnit::Trial,
                _ => SplitUnit::Time,
            }),
            leave_out: Vec::new(),
            recipe: None,
            seed: None,
            features: None,
            most_rows: MAX_ROWS,
            columns: columns.clone(),
            accept: AcceptArguments::settled(),
            run: RunArguments::new(out),
        }
    }

    /// Commands for the trained model.
    fn next(&self) -> Vec<String> {
        let (recordings, model) = (recordings(&self.paths), word(&self.run.out));
        let reading = self.columns.options() + &self.accept.option();
        let lab = free_lab();
        vec![
            format!("joulebus eval {recordings} --model {model}{reading}"),
            format!(
                "joulebus config init --from {recordings} --model {model} --out {lab}{reading}"
            ),
        ]
    }

    /// Trains without a report or a file. Returns the split and the bytes of the model, or none if
    /// the run was interrupted.
    pub(super) fn train(&self) -> anyhow::Result<Option<(Split, Vec<u8>)>> {
        let (dataset, .., recipe) = self.prepare()?;
        let Some(trained) = self.run.compute(&dataset, &recipe.training, None)? else {
            return Ok(None);
        };
        Ok(Some((recipe.split, trained.network.to_safetensors()?)))
    }

    /// The rows, how they are split, what is implausible, and the recipe with the features that the
    /// rows have, unless they are stated.
    fn prepare(&self) -> anyhow::Result<(Dataset, SplitSummary, Vec<Judged>, Recipe)> {
        let (mut recipe, states_features) = self.recipe()?;
        let (dataset, summary, implausible) = self.dataset(&recipe)?;
        if !states_features {
            recipe.training.feature_set = recorded_features(&dataset);
            log_line(&format!(
                "features: {}, as the recordings have them",
                recipe.training.feature_set.name()
            ));
        }
        Ok((dataset, summary, implausible, recipe))
    }

    /// The recipe, and whether it or an option states the features.
    fn recipe(&self) -> anyhow::Result<(Recipe, bool)> {
        let (mut recipe, mut states_features) = match &self.recipe {
            None => (Recipe::default(), false),
            Some(path) => read_recipe(path)?,
        };
        let settings = &mut recipe.training;
        if let Some(seed) = self.seed {
            (settings.seed, recipe.split.seed) = (seed, seed);
        }
        if let Some(features) = self.features {
            settings.feature_set = features.into();
            states_features = true;
        }
        if settings.name == TrainSettings::default().name
            && let Some(stem) = self.run.out.file_stem().and_then(|stem| stem.to_str())
        {
            stem.clone_into(&mut settings.name);
        }
        if let Some(together) = self.split {
            recipe.split.by = together.into();
        }
        Ok((recipe, states_features))
    }

    fn dataset(&self, recipe: &Recipe) -> anyhow::Result<(Dataset, SplitSummary, Vec<Judged>)> {
        let map = self.columns.map();
        let [paths, validation, held_out] =
            [&self.paths, &self.validate, &self.hold_out].map(|paths| read(paths, &map));
        let (mut paths, validation, held_out) = (paths?, validation?, held_out?);
        if !self.leave_out.is_empty() {
            let infos: Vec<SourceInfo> = paths.iter().map(Recording::info).collect();
            let is_out = left_out(&infos, &self.leave_out);
            let is_out = is_out.map_err(|error| UsageError(error.to_string()))?;
            let mut is_out = is_out.into_iter();
            paths.retain(|_| is_out.next() == Some(false));
        }
        let all = [&paths, &validation, &held_out].into_iter().flatten();
        let implausible = self.accept.recordings(all)?;
        let parts = match held_out.is_empty() {
            true => Parts::Split(&paths, recipe.split),
            false => Parts::Given([&paths, &validation, &held_out]),
        };
        let made = training_data(parts, self.most_rows.get());
        let (dataset, summary) = made.map_err(|error| match error {
            TrainingDataError::Split(error) => UsageError(error.to_string()).into(),
            error => anyhow::Error::from(error),
        })?;
        Ok((dataset, summary, implausible))
    }
}

/// Maximum size of a recipe, bytes.
const MAX_RECIPE_BYTES: u64 = 4 << 20;

/// The recipe, and whether it states the features.
fn read_recipe(path: &Path) -> anyhow::Result<(Recipe, bool)> {
    let name = path.display();
    let text = joulebus_files::read_to_string(path, MAX_RECIPE_BYTES)
        .with_context(|| format!("cannot read {name}"))?;
    let recipe = Recipe::parse(&text);
    let recipe = recipe.map_err(|error| UsageError(format!("the recipe {name}: {error}")))?;
    Ok((recipe, Recipe::states_features(&text)))
}

fn read(paths: &[PathBuf], map: &ColumnMap) -> anyhow::Result<Vec<Recording>> {
    if paths.is_empty() {
        return Ok(Vec::new());
    }
    let recordings = open(find_recordings(paths)?, map)?;
    for recording in &recordings {
        log_line(&format!("{}: {}", recording.file(), recording.notes()));
    }
    Ok(recordings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_recipe_equals_the_default() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../configs/recipes/paper.toml");
        let (recipe, states_features) = read_recipe(Path::new(path)).expect("valid recipe");
        assert!(states_features);
        assert_eq!(recipe, Recipe::default());
        let text = std::fs::read_to_string(path).expect("readable file");
        let keys = |name: &str| text.contains(&format!("\n{name} = "));
        let settings = serde_json::to_value(&recipe.training).expect("numbers and strings");
        for name in settings.as_object().expect("a table").keys() {
            assert!(keys(name), "no comment for `{name}`");
        }
    }

    #[test]
    fn a_recipe_with_an_unknown_setting_or_an_invalid_value_is_refused_with_its_position() {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let path = folder.path().join("recipe.toml");
        for (text, named) in [
            ("[training]\nlearning_speed = 1.0\n", "learning_speed"),
            ("[training]\nfeature_set = \"most\"\n", "power-only"),
            ("[split]\nby = \"row\"\n", "row"),
            ("[training\n", "line 1"),
        ] {
            std::fs::write(&path, text).expect("writable file");
            let error = read_recipe(&path).expect_err("refused").to_string();
            assert!(error.contains(named), "{text}: {error}");
        }
    }
}
