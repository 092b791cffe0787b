//! `joulebus model import`: converts another program's network to a joulebus model.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow};
use joulebus_dataset::trial::{ColumnMap, Trial};
use joulebus_files::foreign;
use joulebus_model_files::{Imported, MAX_FILE_BYTES, Plain, Ranked};
use joulebus_predictor::Network;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::file::write;
use joulebus_program::output::Output;
use serde::Serialize;

use super::info::ScoreReport;
use crate::trials::recordings;

/// Number of other conventions shown in the report.
const SHOWN: usize = 4;

/// Import a network that `joulebus.models.convert` wrote, and check on recordings how its features
/// are said to be computed
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus model import plain.safetensors --data recordings/ --out mine.safetensors\n  \
    joulebus model import plain.safetensors --data a.npy b.csv.gz --out lab.safetensors\n\n\
    FILE has one to three hidden layers of at most 64, 64 and 32 units with gelu_erf, gelu_tanh or \
    relu, and states how its features were computed. The recordings should be of the robots that the \
    network was trained for. If another convention has a squared error smaller by 5 %, nothing is \
    written, and the error names that one. Range, residuals and scores of the model are those on the \
    recordings.")]
pub(crate) struct Args {
    /// A network that `joulebus.models.convert` of the Python package wrote (.safetensors)
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The model file to write
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Recordings with power, and with commands if the network reads them (.npy, .csv,
    /// .csv.gz, .mcap), or directories of them
    #[arg(long, value_name = "PATH", num_args = 1.., required = true)]
    data: Vec<PathBuf>,
}

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let plain = read(&args.file)?;
    let trials = trials(&args.data, &ColumnMap::default())?;
    let shown = args.file.display().to_string();
    let name = args.out.file_stem().unwrap_or_default().to_string_lossy();
    let file = args.file.file_name().unwrap_or_default().to_string_lossy();
    let imported = plain.import(&trials, &name, &file).with_context(|| shown.clone())?;
    write(&args.out, &imported.network.to_safetensors()?)?;
    output.report(&ImportReport::new(shown, &args.out, &plain, &imported))?;
    Ok(Outcome::Done)
}

/// The network in a file. Of a file of another kind, the error says how to convert it.
fn read(path: &Path) -> anyhow::Result<Plain> {
    let shown = path.display();
    let bytes = joulebus_files::read(path, MAX_FILE_BYTES as u64)
        .with_context(|| format!("cannot read {shown}"))?;
    Plain::read(&bytes).map_err(|error| match foreign::of_model(path, &bytes) {
        _ if Network::from_safetensors(&bytes).is_ok() => {
            let remedy = "Use it as it is, such as in `model = …` of a platform";
            UsageError(format!("{shown} is a joulebus model already. {remedy}")).into()
        }
        // The reader says what is wrong with a converted one.
        Some(kind) if !kind.starts_with("a converted network") => anyhow!("{shown} is {kind}"),
        _ => anyhow!(error).context(shown.to_string()),
    })
}

fn trials(paths: &[PathBuf], map: &ColumnMap) -> anyhow::Result<Vec<Trial>> {
    let mut trials = Vec::new();
    for path in paths {
        let files = if path.is_dir() { recordings(path)? } else { vec![path.clone()] };
        for file in files {
            trials.extend(Trial::read_mapped(file, map)?);
        }
    }
    Ok(trials)
}

/// The imported network, and how well its convention fits.
#[derive(Debug, Serialize)]
struct ImportReport {
    file: String,
    out: String,
    model_hash: String,
    /// Widths of the network, inputs first.
    widths: Vec<usize>,
    convention: String,
    /// The step of per-step derivatives.
    step_s: f64,
    scores: ScoreReport,
    /// Other conventions, best first.
    others: Vec<RankedReport>,
}

#[derive(Debug, Serialize)]
struct RankedReport {
    convention: String,
    r2: f64,
    mae_w: f64,
}

impl ImportReport {
    fn new(file: String, out: &Path, plain: &Plain, imported: &Imported) -> Self {
        let ranked = |ranked: &Ranked| RankedReport {
            convention: ranked.convention.to_string(),
            r2: ranked.r2,
            mae_w: ranked.mae_w,
        };
        Self {
            file,
            out: out.display().to_string(),
            model_hash: format!("{:016x}", imported.network.hash()),
            widths: plain.widths(),
            convention: imported.stated.convention.to_string(),
            step_s: imported.step_s,
            scores: ScoreReport::new(&imported.network),
            others: imported.others.iter().map(ranked).collect(),
        }
    }
}

impl fmt::Display for ImportReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{}, written to {} as {}", self.file, self.out, self.model_hash)?;
        let widths: Vec<String> = self.widths.iter().map(usize::to_string).collect();
        writeln!(out, "layers        {}", widths.join("→"))?;
        writeln!(out, "convention    {}, as stated", self.convention)?;
        writeln!(out, "on            {}", self.scores)?;
        writeln!(out, "\n{:>9} {:>9}  of {} other conventions", "R²", "MAE W", self.others.len())?;
        for RankedReport { convention, r2, mae_w } in self.others.iter().take(SHOWN) {
            writeln!(out, "{r2:9.5} {mae_w:9.5}  {convention}")?;
        }
        Ok(())
    }
}
