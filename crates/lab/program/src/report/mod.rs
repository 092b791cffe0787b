//! `joulebus report`: recordings and forecasts of them as one HTML file, text and JSON.

mod arguments;

use std::io::{IsTerminal as _, Write as _};
use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::Context as _;
use joulebus_dataset::trial::ColumnMap;
use joulebus_eval::score::{Recording, read_recordings};
use joulebus_files::{WholeFolder, replace, replace_shared};
use joulebus_program::exit::Outcome;
use joulebus_program::output::{Output, log_line};
use joulebus_program::platform::platform;
use joulebus_report::{Document, Recorded, Simulated, SimulatedReport, files, recorded, simulated};
use joulebus_settings::Platform;
use joulebus_train::Epoch;

use crate::eval::load;
use crate::judgement::{self, Judged};
use crate::recordings::find_recordings;
pub(crate) use arguments::Args;

/// The first seed of simulated experiments.
const SIMULATED_SEED: u64 = 1;

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    // Begun first, so that an invalid directory fails before the evaluation.
    let failed = || format!("cannot write into {}", args.out.display());
    let mut whole = WholeFolder::begin(&args.out).with_context(failed)?;
    let (document, implausible) =
        if args.simulated { (simulate(args, &mut whole)?, Vec::new()) } else { evaluate(args)? };
    log_line("rendering the report");
    for file in files(&document)? {
        replace(&whole.path(file.name)?, |mut out| out.write_all(file.text.as_bytes()))
            .with_context(failed)?;
    }
    whole.keep().with_context(failed)?;
    log_line(&format!("written: {}", args.out.join("report.html").display()));
    judgement::report(output, &document, implausible)?;
    Ok(Outcome::Done)
}

fn simulate(args: &Args, whole: &mut WholeFolder) -> anyhow::Result<Document> {
    let mut experiment = Simulated::new(args.seed.unwrap_or(SIMULATED_SEED));
    (experiment.samples, experiment.robot_steps) = (args.samples, args.samples);
    experiment.draws = args.draws;
    experiment.recipe.max_epochs = args.max_epochs;
    let config = args.config.load()?;
    log_line(&format!(
        "{} draws of six trials and seven robots of {} samples, training on trials 1 to 4",
        args.draws, args.samples
    ));
    let report = simulated(&experiment, config.settings(), |seed, epoch| {
        progress(seed, epoch, args.max_epochs);
        ControlFlow::Continue(())
    });
    if std::io::stderr().is_terminal() {
        log_line("");
    }
    let SimulatedReport { document, network, .. } = report?;
    let bytes = network.to_safetensors()?;
    replace_shared(&whole.path("network.safetensors")?, |mut out| out.write_all(&bytes))?;
    Ok(document)
}

fn evaluate(args: &Args) -> anyhow::Result<(Document, Vec<Judged>)> {
    let config = args.config.load()?;
    let settings = config.settings();
    let kind: Option<&Platform> = match &args.platform {
        Some(name) => Some(platform(settings, name)?),
        None => None,
    };
    let models = args.model.iter().map(|path| load(path));
    let models = models.collect::<anyhow::Result<Vec<_>>>()?;
    // The live path needs the platform of each robot: all of them belong to this one.
    let first = kind.and_then(|kind| kind.robots.first()).map_or(0, |ids| *ids.start());
    let place = kind.and_then(|kind| settings.platforms.iter().position(|one| one == kind));
    let map = match place {
        Some(place) => args.columns.or_configured(&config, place)?,
        None => args.columns.map(),
    };
    let accept = args.accept.or_configured(&config, place)?;
    let recordings = read(&args.paths, first, &map)?;
    let implausible = accept.recordings(&recordings)?;
    let seed = args.seed.unwrap_or_default();
    let design = args.held_out.design(&recordings, seed, |fit| {
        let training = read(fit, first, &map)?;
        accept.recordings(&training)?;
        Ok(training)
    })?;
    log_line(&format!("evaluating {} of {} recordings", design.report().trials, recordings.len()));
    let document = recorded(&Recorded {
        settings,
        platform: kind,
        models: &models,
        recordings: &recordings,
        design: &design,
        references: args.references.read()?,
        battery_wh: args.battery_wh,
    })?;
    if let Some(warning) = &document.warning {
        log_line(&format!("warning: {warning}"));
    }
    Ok((document, implausible))
}

/// The recordings of files and directories, all with the same robot id, since each is run alone.
fn read(paths: &[PathBuf], robot: u32, map: &ColumnMap) -> anyhow::Result<Vec<Recording>> {
    if paths.is_empty() {
        return Ok(Vec::new());
    }
    let files = find_recordings(paths)?;
    let files: Vec<(u32, PathBuf)> = files.into_iter().map(|file| (robot, file)).collect();
    Ok(read_recordings(&files, map)?)
}

/// In a terminal one line is overwritten. Elsewhere every tenth epoch prints a line.
fn progress(seed: u64, epoch: Epoch, max_epochs: u32) {
    let Epoch { number, validation_loss, .. } = epoch;
    let line =
        format!("seed {seed}, epoch {number:3} of at most {max_epochs}: loss {validation_loss:.5}");
    let mut stderr = std::io::stderr();
    if stderr.is_terminal() {
        let _ = write!(stderr, "\r\x1b[K{line}");
    } else if number % 10 == 0 {
        log_line(&line);
    }
}
