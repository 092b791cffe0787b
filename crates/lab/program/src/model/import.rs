//! `joulebus model import`: converts another program's model to a joulebus model.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::ValueEnum;
use joulebus_dataset::trial::{ColumnMap, Trial};
use joulebus_model_files::{Choice, Convention, Origin, Ranked, StatisticsFrom};
use joulebus_predictor::Activation;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::Output;
use serde::Serialize;

use super::info::{FoundReport, ScoreReport};
use crate::recordings::ColumnArguments;
use crate::trials::recordings;
use joulebus_program::file::write;

/// Number of conventions shown in the report.
const SHOWN: usize = 5;

/// Import a model of NumPy or PyTorch: find its network, and identify the feature convention by
/// statistics and recordings
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus model import energy_predictor_full.npy --data recordings/ --out published.safetensors\n  \
    joulebus model import checkpoint.pt --part model_state_dict --data a.npy b.csv.gz \
    --out mine.safetensors\n  \
    joulebus model import exported.npz --out again.safetensors    a joulebus model needs no data\n\n\
    No code in the file is executed. Networks of one to three hidden layers of at most 64, 64 and 32 \
    units run, with gelu_erf, gelu_tanh or relu. The recordings should be of the robots that the \
    model was trained for. Range, residuals and scores of the imported model are those on them. \
    If they do not clearly distinguish the best convention from the second, nothing is written. \
    Then name one with --convention.")]
pub(crate) struct Args {
    /// A model file (.npy, .npz, .pt, .pth, .safetensors, our .onnx) or a directory of .npy files
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The model file to write
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Recordings with power, and with commands if the network reads them (.npy, .csv,
    /// .csv.gz, .mcap), or directories of them
    #[arg(long, value_name = "PATH", num_args = 1..)]
    data: Vec<PathBuf>,
    #[command(flatten)]
    columns: ColumnArguments,
    /// Name of the model [default: that of the file]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// The part of the file with the network, if there are several
    #[arg(long, value_name = "PATH")]
    part: Option<String>,
    /// Activation of the hidden layers, whatever the file states
    /// [default: as stated, else gelu_erf]
    #[arg(long, value_name = "NAME", value_parser = super::activation)]
    activation: Option<Activation>,
    /// Normalisation constants, for a file that has none [default: published, if the recordings
    /// agree with it]
    #[arg(long, value_enum, value_name = "FROM")]
    normalisation: Option<Constants>,
    /// Use this convention, in the notation of a report, instead of the one that forecasts best
    #[arg(long, value_name = "CONVENTION")]
    convention: Option<Convention>,
}

/// Normalisation constants for a file that has none.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Constants {
    /// Those of the published GTernal model
    Published,
    /// Those of the recordings: right if the network was trained on them
    Recordings,
}

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let checkpoint = super::read(&args.file)?;
    let file = args.file.display().to_string();
    if let Some(network) = &checkpoint.network {
        write(&args.out, &network.to_safetensors()?)?;
        output.report(&OwnReport {
            file,
            out: args.out.display().to_string(),
            kind: checkpoint.container.to_string(),
            model_hash: format!("{:016x}", network.hash()),
        })?;
        return Ok(Outcome::Done);
    }
    let mut found =
        checkpoint.find(args.part.as_deref(), args.activation).with_context(|| file.clone())?;
    match (args.normalisation, found.normalisation.from) {
        (None, _) => {}
        (Some(_), StatisticsFrom::File) => {
            let what = format!("{file} has normalisation constants of its own");
            return Err(UsageError(format!("{what}. Leave out --normalisation")).into());
        }
        (Some(Constants::Published), _) => found.normalisation.from = StatisticsFrom::Published,
        (Some(Constants::Recordings), _) => found.normalisation.from = StatisticsFrom::Recordings,
    }
    let trials = trials(&args.data, &args.columns.map())?;
    let usual = args.file.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let origin = Origin {
        name: args.name.as_deref().or(usual.as_deref()).unwrap_or("imported"),
        file: &args.file.file_name().unwrap_or_default().to_string_lossy(),
        sha256: &checkpoint.sha256,
    };
    let choice = found.choose(&trials, args.convention, &origin).with_context(|| file.clone())?;
    write(&args.out, &choice.network().to_safetensors()?)?;
    let kind = checkpoint.container.to_string();
    output.report(&ImportReport::new(file, &args.out, kind, FoundReport::new(&found), &choice))?;
    Ok(Outcome::Done)
}

fn trials(paths: &[PathBuf], map: &ColumnMap) -> anyhow::Result<Vec<Trial>> {
    if paths.is_empty() {
        let what = "the file does not state how its features were computed";
        let remedy = "Give recordings with --data, on which every convention is evaluated";
        return Err(UsageError(format!("{what}. {remedy}")).into());
    }
    let mut trials = Vec::new();
    for path in paths {
        let files = if path.is_dir() { recordings(path)? } else { vec![path.clone()] };
        for file in files {
            trials.extend(Trial::read_mapped(file, map)?);
        }
    }
    Ok(trials)
}

/// A joulebus model, written unchanged.
#[derive(Debug, Serialize)]
struct OwnReport {
    file: String,
    out: String,
    kind: String,
    model_hash: String,
}

impl fmt::Display for OwnReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, out: written, kind, model_hash } = self;
        writeln!(out, "{file} ({kind}): a joulebus model, hash {model_hash}, written to {written}")
    }
}

/// The network found, and the reasons for its interpretation.
#[derive(Debug, Serialize)]
struct ImportReport {
    file: String,
    out: String,
    kind: String,
    model_hash: String,
    found: FoundReport,
    convention: String,
    /// True if it was requested.
    forced: bool,
    margin_r2: f64,
    /// Share by which the second's squared error is larger.
    excess: f64,
    blocks: usize,
    blocks_won: usize,
    /// Conventions under which the file's statistics are far from the recordings'.
    ruled_out_by_statistics: Vec<String>,
    /// The step of per-step derivatives.
    step_s: f64,
    conventions_tried: usize,
    ranking: Vec<RankedReport>,
    scores: ScoreReport,
}

#[derive(Debug, Serialize)]
struct RankedReport {
    convention: String,
    r2: f64,
    mae_w: f64,
}

impl ImportReport {
    fn new(file: String, out: &Path, kind: String, found: FoundReport, choice: &Choice) -> Self {
        let ranked = |ranked: &Ranked| RankedReport {
            convention: ranked.convention.to_string(),
            r2: ranked.r2,
            mae_w: ranked.mae_w,
        };
        Self {
            file,
            out: out.display().to_string(),
            kind,
            model_hash: format!("{:016x}", choice.network().hash()),
            found,
            convention: choice.convention.to_string(),
            forced: choice.forced,
            margin_r2: choice.margin_r2,
            excess: choice.excess,
            ruled_out_by_statistics: choice.ruled_out.iter().map(ToString::to_string).collect(),
            blocks: choice.blocks,
            blocks_won: choice.blocks_won,
            step_s: choice.step_s,
            conventions_tried: choice.ranking.len(),
            ranking: choice.ranking.iter().map(ranked).collect(),
            scores: ScoreReport::new(choice.network()),
        }
    }
}

impl fmt::Display for ImportReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (file, kind, hash) = (&self.file, &self.kind, &self.model_hash);
        writeln!(out, "{file} ({kind}), written to {} as {hash}", self.out)?;
        write!(out, "{}", self.found)?;
        let how = match (self.forced, self.ruled_out_by_statistics.len(), self.ranking.len()) {
            (true, ..) => "as requested",
            (false, 0, _) => "found on the recordings",
            (false, _, 1) => "the only one that fits the file's statistics",
            (false, ..) => "found by the file's statistics and on the recordings",
        };
        writeln!(out, "convention    {}, {how}", self.convention)?;
        if !self.ruled_out_by_statistics.is_empty() {
            let count = self.ruled_out_by_statistics.len();
            writeln!(out, "statistics    rule out {count} other conventions")?;
        }
        if self.ranking.len() > 1 {
            writeln!(
                out,
                "margin        best over second by R² {:.5}, {:.0} % less than its squared error, smaller in {} \
                 of {} blocks",
                self.margin_r2,
                100.0 * self.excess / (1.0 + self.excess),
                self.blocks_won,
                self.blocks
            )?;
        }
        writeln!(out, "on            {}", self.scores)?;
        writeln!(out, "\n{:>9} {:>9}  of {} conventions", "R²", "MAE W", self.conventions_tried)?;
        for RankedReport { convention, r2, mae_w } in self.ranking.iter().take(SHOWN) {
            writeln!(out, "{r2:9.5} {mae_w:9.5}  {convention}")?;
        }
        Ok(())
    }
}
