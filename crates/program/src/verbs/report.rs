//! `joulebus report`.

use std::path::PathBuf;

use crate::config_file::ConfigFile;

/// Report how well a model forecasts, with figures and tables, beside what it has to beat
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus report --simulated -o report/\n  \
    joulebus report recordings/ --model my.safetensors -o report/\n  \
    joulebus report test/ --train training/ --model new.safetensors --model old.safetensors -o report/\n  \
    joulebus report energy_data_trial*.npy --published --model gternal.safetensors -o report/\n\n\
    DIR/report.html is one file that needs no other; beside it lie report.json, report.txt and \
    figures/*.svg, *.png. --simulated runs the paper's whole course on simulated robots: six trials, \
    training on 1 to 4, evaluation on all six and on seven robots; everything says that it is \
    simulated.\n\
    Every model stands beside persistence and AR(5) + velocities, on the same rows, with 95 % \
    intervals.")]
pub struct ReportArguments {
    /// Recordings to evaluate (.npy, .csv, .csv.gz), or directories of them
    #[arg(value_name = "PATH", required_unless_present = "simulated")]
    pub paths: Vec<PathBuf>,
    /// A model file; the first is shown in every picture, further ones stand beside it
    #[arg(long, value_name = "FILE", required_unless_present = "simulated")]
    pub model: Vec<PathBuf>,
    /// The directory to write into; it is made if it is not there
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Recordings that the linear baselines are fitted on [default: the evaluated ones, in turn]
    #[arg(long, value_name = "PATH", num_args = 1.., conflicts_with = "simulated")]
    pub train: Vec<PathBuf>,
    /// Platform of the config whose period and limits hold [default: as recorded]
    #[arg(long, value_name = "NAME", conflicts_with = "simulated")]
    pub platform: Option<String>,
    /// These are the recordings of arXiv 2603.13908: its numbers stand beside
    #[arg(long, conflicts_with = "simulated")]
    pub published: bool,
    /// Simulate the paper's trials and robots, train on them and report it; needs no data
    #[arg(long, conflicts_with_all = ["paths", "model"])]
    pub simulated: bool,
    /// With --simulated: seed of robots and training
    #[arg(long, value_name = "N", default_value_t = 7, requires = "simulated")]
    pub seed: u64,
    /// With --simulated: samples of each trial, at least 100
    #[arg(long, value_name = "N", default_value_t = 8000, requires = "simulated")]
    pub samples: usize,
    /// With --simulated: epochs of training at most
    #[arg(long, value_name = "N", default_value_t = 100, requires = "simulated")]
    pub max_epochs: u32,
    /// The fleet's config.
    #[command(flatten)]
    pub config: ConfigFile,
}
