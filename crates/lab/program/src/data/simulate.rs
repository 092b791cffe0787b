//! `joulebus data simulate`: the simulated stand-in for the published dataset, as files.

use std::fmt;
use std::path::PathBuf;

use anyhow::Context as _;
use joulebus_dataset::trial::{MAX_ROWS, Trial};
use joulebus_files::WholeFolder;
use joulebus_plant::arena::STEP_S;
use joulebus_plant::parts::Parts;
use joulebus_plant::protocol::{Protocol, SAMPLES};
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use joulebus_sim::protocol::drive;
use joulebus_sim::scenario;
use serde::Serialize;

/// Write simulated trials in the published layout: six of one robot, and seven robots together
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus data simulate simulated\n  \
    joulebus data simulate simulated-2 --seed 2 --steps 30000\n  \
    joulebus data info simulated/*.npy\n\n\
    The files replace the GTernal dataset of arXiv 2603.13908 and support no claim about real \
    robots. The same seed gives the same bytes on every machine. Nothing is overwritten.")]
pub(crate) struct Args {
    /// Output directory, which is created if it does not exist
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// Seed of the robots, their motion and everything random
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Samples of each of the seven robots, 2 to 4,194,304 (the six trials have 8,000 each)
    #[arg(long, value_name = "N", default_value_t = SAMPLES as u64, value_parser = clap::value_parser!(u64).range(2..=MAX_ROWS as u64))]
    steps: u64,
}

#[derive(Debug, Serialize)]
struct SimulateReport {
    simulated: bool,
    directory: String,
    seed: u64,
    files: Vec<FileReport>,
    /// Minimum distance between two of the seven robots' centres, m.
    closest_m: f64,
    /// Share of steps in which the barriers changed a robot's desired motion.
    avoiding_share: f64,
    /// Steps in which all robots stopped because no motion was allowed.
    stopped_steps: usize,
}

#[derive(Debug, Serialize)]
struct FileReport {
    file: String,
    robot: String,
    rows: usize,
    duration_s: f64,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let failed = || format!("cannot write into {}", args.directory.display());
    let mut whole = WholeFolder::begin(&args.directory).with_context(failed)?;
    let mut files = Vec::new();
    let mut write = |trial: &Trial, stem: &str| -> anyhow::Result<()> {
        let name = format!("{stem}.npy");
        trial.to_table().write(&whole.path(&name).with_context(failed)?)?;
        files.push(FileReport {
            file: args.directory.join(name).display().to_string(),
            robot: trial.robot_name().unwrap_or_default().to_owned(),
            rows: trial.rows(),
            duration_s: trial.rows() as f64 * STEP_S,
        });
        Ok(())
    };
    for protocol in Protocol::ALL {
        write(&drive(protocol, args.seed), &protocol.file_stem())?;
    }
    let steps = args.steps as usize;
    let run = scenario::run(Parts::default(), args.seed, steps);
    for (trial, robot) in run.trials.iter().zip(1..) {
        write(trial, &scenario::file_stem(robot))?;
    }
    whole.keep_new().with_context(failed)?;
    output.report(&SimulateReport {
        simulated: true,
        directory: args.directory.display().to_string(),
        seed: args.seed,
        files,
        closest_m: run.closest_m,
        avoiding_share: run.changed_steps as f64 / steps as f64,
        stopped_steps: run.stopped_steps,
    })?;
    Ok(Outcome::Done)
}

impl fmt::Display for SimulateReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "simulated, seed {}:", self.seed)?;
        for file in &self.files {
            let FileReport { file, robot, rows, duration_s } = file;
            writeln!(out, "  {file}: robot {robot}, {rows} rows, {duration_s:.0} s")?;
        }
        writeln!(
            out,
            "the seven robots came no closer than {:.3} m. Barriers changed the motion in {:.0} % \
                of the steps, {} times all stopped",
            self.closest_m,
            100.0 * self.avoiding_share,
            self.stopped_steps
        )
    }
}
