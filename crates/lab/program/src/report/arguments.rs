//! The options of `joulebus report`.

use std::path::PathBuf;

use joulebus_program::config_file::ConfigFile;

use crate::design::DesignArguments;
use crate::judgement::AcceptArguments;
use crate::recordings::ColumnArguments;
use crate::references::ReferenceArguments;

/// Report what recordings say of energy and battery, and the accuracy of models
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus report recordings/ --battery-wh 20 -o report/\n  \
    joulebus report --simulated -o report/\n  \
    joulebus report recordings/ --model my.safetensors -o report/\n  \
    joulebus report test/ --fit training/ --model new.safetensors --model old.safetensors -o report/\n  \
    joulebus report recordings/ --split trial --model my.safetensors -o report/\n\n\
    DIR/report.html is a self-contained file. DIR also gets report.json and report.txt. `python3 -m \
    joulebus.figures DIR/report.json` draws its figures as SVG and PDF.\n\
    First comes what recordings say by themselves: energy per metre, power by speed, how long a \
    battery lasts, and the worst run. Only plausible readings count. --simulated runs the paper's experiments on simulated robots, ten \
    times. It trains on trials 1 to 4 and evaluates on all six trials and on seven robots. Mean \
    and deviation stand beside the paper's figures, and everything says that it is simulated.\n\
    Rows that a model was trained on, as its file states, are scored apart from the others. The \
    page warns of them, and of models whose files do not state theirs. --split evaluates what \
    `joulebus train trials` \
    with the same recordings, split and seed holds out.\n\
    Every model is compared with persistence, AR(5) + velocities, the mean so far, the season \
    before, ridge regression, and the forecasts of --forecasts. All are scored on the same rows, \
    with 95 % intervals.")]
pub(crate) struct Args {
    /// Recordings to evaluate (.npy, .csv, .csv.gz), captures (.mcap), or directories of them
    #[arg(value_name = "PATH", required_unless_present = "simulated")]
    pub(super) paths: Vec<PathBuf>,
    #[command(flatten)]
    pub(super) columns: ColumnArguments,
    #[command(flatten)]
    pub(super) accept: AcceptArguments,
    /// A model file. The first is shown in every figure, further ones are compared with it
    /// [default: none, and no forecasts are scored]
    #[arg(long, value_name = "FILE")]
    pub(super) model: Vec<PathBuf>,
    /// The output directory, which is created if it does not exist
    #[arg(short, long, value_name = "DIR")]
    pub(super) out: PathBuf,
    /// Energy of the battery from full to empty, Wh [default: that of the platform]
    #[arg(long, value_name = "WH", conflicts_with = "simulated", value_parser = crate::config_init::capacity_wh)]
    pub(super) battery_wh: Option<f64>,
    /// Platform of the config with the period, limits and battery [default: as recorded]
    #[arg(long, value_name = "NAME", conflicts_with = "simulated")]
    pub(super) platform: Option<String>,
    /// Simulate the paper's trials and robots, train on them and report, without data
    #[arg(long, conflicts_with_all = ["paths", "model", "split", "leave_out", "fit"])]
    pub(super) simulated: bool,
    #[command(flatten)]
    pub(super) held_out: DesignArguments,
    #[command(flatten)]
    pub(super) references: ReferenceArguments,
    /// Seed of the split, as in training [default: 0]. With --simulated: of robots and training of
    /// the first draw, each draw has the next [default: 1]
    #[arg(long, value_name = "N")]
    pub(super) seed: Option<u64>,
    /// With --simulated: draws over which mean and deviation are taken, 2 to 1000
    #[arg(long, value_name = "N", default_value_t = 10, requires = "simulated",
          value_parser = clap::value_parser!(u32).range(2..=1000))]
    pub(super) draws: u32,
    /// With --simulated: samples of each trial, at least 100
    #[arg(long, value_name = "N", default_value_t = 8000, requires = "simulated")]
    pub(super) samples: usize,
    /// With --simulated: maximum number of training epochs
    #[arg(long, value_name = "N", default_value_t = 100, requires = "simulated")]
    pub(super) max_epochs: u32,
    /// The fleet's config.
    #[command(flatten)]
    pub(super) config: ConfigFile,
}
