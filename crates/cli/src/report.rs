//! `joulebus report`: an evaluation as one HTML file, pictures, text and JSON.

use std::fs;
use std::io::{IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use joulebus_dataset::trial::Trial;
use joulebus_eval::score::Recording;
use joulebus_predictor::Model;
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::Outcome;
use joulebus_program::model_source;
use joulebus_program::output::{Output, say};
use joulebus_report::{Document, Recorded, Simulated, SimulatedReport, files, recorded, simulated};
use joulebus_settings::Platform;
use joulebus_train::Epoch;

use crate::data::find_recordings;
use crate::eval::check_apart;
use crate::train::write;
use crate::trials::platform;

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
pub(crate) struct Args {
    /// Recordings to evaluate (.npy, .csv, .csv.gz), or directories of them
    #[arg(value_name = "PATH", required_unless_present = "simulated")]
    paths: Vec<PathBuf>,
    /// A model file; the first is shown in every picture, further ones stand beside it
    #[arg(long, value_name = "FILE", required_unless_present = "simulated")]
    model: Vec<PathBuf>,
    /// The directory to write into; it is made if it is not there
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Recordings that the linear baselines are fitted on [default: the evaluated ones, in turn]
    #[arg(long, value_name = "PATH", num_args = 1.., conflicts_with = "simulated")]
    train: Vec<PathBuf>,
    /// Platform of the config whose period and limits hold [default: as recorded]
    #[arg(long, value_name = "NAME", conflicts_with = "simulated")]
    platform: Option<String>,
    /// These are the recordings of arXiv 2603.13908: its numbers stand beside
    #[arg(long, conflicts_with = "simulated")]
    published: bool,
    /// Simulate the paper's trials and robots, train on them and report it; needs no data
    #[arg(long, conflicts_with_all = ["paths", "model"])]
    simulated: bool,
    /// With --simulated: seed of robots and training
    #[arg(long, value_name = "N", default_value_t = 7, requires = "simulated")]
    seed: u64,
    /// With --simulated: samples of each trial, at least 100
    #[arg(long, value_name = "N", default_value_t = 8000, requires = "simulated")]
    samples: usize,
    /// With --simulated: epochs of training at most
    #[arg(long, value_name = "N", default_value_t = 100, requires = "simulated")]
    max_epochs: u32,
    #[command(flatten)]
    config: ConfigFile,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    // Half a minute of work should not be lost to a directory that cannot be.
    let pictures = args.out.join("figures");
    fs::create_dir_all(&pictures)
        .with_context(|| format!("cannot make the directory {}", pictures.display()))?;
    let document = if args.simulated {
        args.simulate()?
    } else {
        args.evaluate()?
    };
    say("drawing and writing");
    for file in files(&document)? {
        write(&args.out.join(&file.path), &file.bytes)?;
    }
    say(&format!(
        "written: {}",
        args.out.join("report.html").display()
    ));
    output.report(&document)?;
    Ok(Outcome::Done)
}

impl Args {
    fn simulate(&self) -> anyhow::Result<Document> {
        let mut course = Simulated::new(self.seed);
        (course.samples, course.robot_steps) = (self.samples, self.samples);
        course.recipe.max_epochs = self.max_epochs;
        let config = self.config.load()?;
        say(&format!(
            "simulating six trials and seven robots of {} samples, training on trials 1 to 4",
            self.samples
        ));
        let report = simulated(&course, config.settings(), |epoch| {
            progress(epoch, self.max_epochs);
        });
        if std::io::stderr().is_terminal() {
            say("");
        }
        let SimulatedReport { document, network } = report?;
        write(
            &self.out.join("network.safetensors"),
            &network.to_safetensors()?,
        )?;
        Ok(document)
    }

    fn evaluate(&self) -> anyhow::Result<Document> {
        let config = self.config.load()?;
        let settings = config.settings();
        let kind: Option<&Platform> = match &self.platform {
            Some(name) => Some(platform(settings, name)?),
            None => None,
        };
        let models = self.model.iter().map(|path| model(path));
        let models = models.collect::<anyhow::Result<Vec<_>>>()?;
        // The live path asks which platform a robot belongs to: all of them to this one.
        let first = kind
            .and_then(|kind| kind.robots.first())
            .map_or(0, |ids| *ids.start());
        let evaluated = read(&self.paths, first)?;
        let learned_from = read(&self.train, first)?;
        check_apart(&evaluated, (&learned_from, "in --train"))?;
        say(&format!("evaluating {} recordings", evaluated.len()));
        Ok(recorded(&Recorded {
            settings,
            platform: kind,
            models: &models,
            recordings: &evaluated,
            learned_from,
            published: self.published,
        })?)
    }
}

fn model(path: &Path) -> anyhow::Result<Model> {
    Ok(Model::Network(model_source::load(path)?))
}

/// The recordings of files and directories, all of them of one robot id: each is run alone.
fn read(paths: &[PathBuf], robot: u32) -> anyhow::Result<Vec<Recording>> {
    if paths.is_empty() {
        return Ok(Vec::new());
    }
    let mut found = Vec::new();
    for file in find_recordings(paths)? {
        found.push(Recording::new(robot, Trial::read(file)?));
    }
    Ok(found)
}

/// In a terminal, the same line again; elsewhere a line for every tenth epoch.
fn progress(epoch: Epoch, max_epochs: u32) {
    let Epoch {
        number,
        validation_loss,
        ..
    } = epoch;
    let line = format!("epoch {number:3} of at most {max_epochs}: loss {validation_loss:.5}");
    let mut stderr = std::io::stderr();
    if stderr.is_terminal() {
        let _ = write!(stderr, "\r\x1b[K{line}");
    } else if number % 10 == 0 {
        say(&line);
    }
}
