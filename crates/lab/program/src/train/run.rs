//! A training run: progress, Ctrl-C, resuming.

use std::io::{IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use joulebus_dataset::rows::Dataset;
use joulebus_files::{check_kind, disk};
use joulebus_program::exit::UsageError;
use joulebus_program::file::write;
use joulebus_program::output::log_line;
use joulebus_program::stop::Stop;
use joulebus_train::{Epoch, TrainSettings, Trained, Training};

use super::checkpoint_path;

/// Interval between checkpoints: the most that a power failure can lose.
const SAVE_EVERY: Duration = Duration::from_secs(10);

/// Maximum size of a checkpoint, bytes: a network, its optimizer and an entry per epoch are
/// smaller.
const MAX_SAVED_BYTES: u64 = 64 << 20;

/// The beginning of a model file: the length of its header, which is less than 2⁴⁸ bytes, and the
/// header.
const MODEL_BEGINS: &[u8] = b"\0\0\0\0\0\0\0\0{";

/// Output file and options of a training run.
#[derive(Debug, clap::Args)]
pub(super) struct RunArguments {
    /// The model file to write
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,
    /// Continue the interrupted run from its checkpoint, FILE.training beside the model
    #[arg(long)]
    resume: bool,
}

impl RunArguments {
    /// A run that writes this model.
    pub(super) fn new(out: &Path) -> Self {
        Self { out: out.to_owned(), resume: false }
    }

    /// Checks the paths of the model and its checkpoint before the training, not after minutes of
    /// it. A file at the checkpoint's path is the work of another run or somebody's file. Only
    /// `--resume`, which reads it, may replace and remove it.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        let saved_at = checkpoint_path(&self.out);
        if !self.resume && disk::exists(&saved_at) {
            let at = saved_at.display();
            let what = format!("{at} exists, where this run would keep its checkpoint");
            let remedy = "Continue an interrupted run with --resume, or move it away";
            return Err(UsageError(format!("{what}. {remedy}")).into());
        }
        check_kind(&self.out, MODEL_BEGINS).with_context(|| self.out.display().to_string())?;
        let folder = self.out.parent();
        if let Some(folder) = folder.filter(|folder| !folder.as_os_str().is_empty()) {
            let name = folder.display();
            anyhow::ensure!(folder.is_dir(), "directory {name} does not exist");
        }
        Ok(())
    }

    /// Trains and writes the model. None if the run was interrupted and its checkpoint saved.
    pub(super) fn train(
        &self,
        dataset: &Dataset,
        settings: &TrainSettings,
    ) -> anyhow::Result<Option<Trained>> {
        let saved_at = checkpoint_path(&self.out);
        let Some(trained) = self.compute(dataset, settings, Some(&saved_at))? else {
            return Ok(None);
        };
        write(&self.out, &trained.network.to_safetensors()?)?;
        // The checkpoint of a finished run is not needed.
        let _ = std::fs::remove_file(&saved_at);
        Ok(Some(trained))
    }

    /// Trains, with checkpoints in this file. None if the run was interrupted.
    pub(super) fn compute(
        &self,
        dataset: &Dataset,
        settings: &TrainSettings,
        saved_at: Option<&Path>,
    ) -> anyhow::Result<Option<Trained>> {
        let stop = Stop::on_signals()?;
        let mut training = self.begin(dataset, settings, saved_at)?;
        let (start, before) = (Instant::now(), training.epochs().len());
        let mut saved = Instant::now();
        while !training.is_done() {
            let epoch = training.epoch()?;
            progress(epoch, settings.max_epochs, start, before);
            let Some(saved_at) = saved_at else {
                if stop.is_asked() {
                    return Ok(None);
                }
                continue;
            };
            if stop.is_asked() {
                write(saved_at, &training.saved())?;
                let (at, made) = (saved_at.display(), epoch.number);
                log_line(&format!(
                    "interrupted after {made} epochs, checkpoint saved in {at}. Continue with \
                        --resume"
                ));
                return Ok(None);
            }
            if saved.elapsed() >= SAVE_EVERY {
                write(saved_at, &training.saved())?;
                saved = Instant::now();
            }
        }
        if std::io::stderr().is_terminal() {
            log_line("");
        }
        Ok(Some(training.finish()?))
    }

    fn begin(
        &self,
        dataset: &Dataset,
        settings: &TrainSettings,
        saved_at: Option<&Path>,
    ) -> anyhow::Result<Training> {
        let Some(saved_at) = saved_at.filter(|_| self.resume) else {
            return Ok(Training::new(dataset, settings, 0)?);
        };
        let at = saved_at.display();
        let saved = match joulebus_files::read(saved_at, MAX_SAVED_BYTES) {
            Ok(saved) => saved,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                let what = format!("there is no checkpoint {at}");
                return Err(UsageError(format!("{what}. Leave out --resume")).into());
            }
            Err(error) => return Err(error).with_context(|| format!("cannot read {at}")),
        };
        let training = Training::resume(dataset, settings, 0, &saved)
            .with_context(|| format!("cannot continue from {at}"))?;
        log_line(&format!("continuing after epoch {}", training.epochs().len()));
        Ok(training)
    }
}

/// Prints one line per epoch. A terminal shows one line that is overwritten.
fn progress(epoch: Epoch, max_epochs: u32, start: Instant, before: usize) {
    let Epoch { number, training_loss, validation_loss, best } = epoch;
    let left = max_epochs.saturating_sub(number);
    let made = f64::from(number) - before as f64;
    let left_s = start.elapsed().as_secs_f64() / made * f64::from(left);
    let star = if best { " (best)" } else { "       " };
    let line = format!(
        "epoch {number:3} of at most {max_epochs}: loss {training_loss:.5}, on validation \
         {validation_loss:.5}{star}, at most {left_s:.0} s left"
    );
    let mut stderr = std::io::stderr();
    if stderr.is_terminal() {
        let _ = write!(stderr, "\r\x1b[K{line}");
    } else {
        log_line(&line);
    }
}
