//! `joulebus run`: runs the predictor worker.

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use anyhow::Context as _;
use joulebus_bus::check_threads;
use joulebus_config::{Config, ModelSource};
use joulebus_models::load_models;
use joulebus_plan_server::{PlanServer, QueryReport, Statements};
use joulebus_predictor_worker::{Report, Worker};
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::Outcome;
use joulebus_program::model_range;
use joulebus_program::output::{Output, log_line};
use joulebus_program::stop::Stop;
use serde::Serialize;

use crate::alarms::{AlarmLog, AlarmReport};
use crate::record::RecorderProcess;
use crate::service_manager::ServiceManager;

/// Run the predictor-worker of a fleet until SIGINT, SIGTERM or SIGHUP, then report
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus run --config configs/fleet.toml\n  \
    joulebus run --format json > report.json &\n  \
    joulebus run --record run.mcap\n  \
    joulebus run --standby        serves when the link of this host permits it: docs/how-to/standby.md\n\n\
    A fleet has one worker. A second one exits and reports the pid of the first. Each raise and \
    each end of a robot's alarm is one line of the log on stderr. More than eight robots at once \
    share a line. --log-format json makes each line an object. Under \
    systemd (Type=notify) it says when it is ready, and with WatchdogSec= that it works. Times in the \
    report are in µs. Exit code 3 if a recording lost messages or stopped.")]
pub(crate) struct Args {
    #[command(flatten)]
    config: ConfigFile,
    /// Also record all topics into this file, in a separate process
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Serve only while the link of this host permits it. Several hosts can have a worker for the
    /// same robots, and one serves at a time. Continues from the state of the worker before, and
    /// ends with exit code 1 when its permit ends
    #[arg(long)]
    standby: bool,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    // Before anything is created: a signal during the start must clean up as well.
    let stop = Stop::on_signals()?;
    check_threads()?;
    let config = args.config.load()?;
    warn_of_models(&config);
    // Robots are forecast whatever becomes of the recording.
    let recorder = args.record.as_ref().map(|file| {
        let started = RecorderProcess::start(&args.config, file);
        started.inspect_err(|error| log_line(&format!("nothing is recorded: {error:#}")))
    });
    let (stated, statements, taken) = Statements::channel();
    let questions = PlanServer::start(&config, Some(stated))?;
    let turns = Arc::new(AtomicU64::new(0));
    let service = ServiceManager::start(Arc::clone(&turns))?;
    let alarms = AlarmLog::start(&config).context("alarms cannot be logged")?;
    let mut worker =
        if args.standby { Worker::open_standby(&config)? } else { Worker::open(&config)? };
    worker.count_turns_in(turns);
    worker.take_statements_from(statements, taken);
    worker.tell_refusals_to(alarms.refusals());
    worker.needs(alarms.watch());
    if let Some(thread) = questions.watch() {
        worker.needs(thread);
    }
    if args.standby {
        let waits = format!(
            "standing by: {}. It serves when the link of this host permits it",
            described(&config)
        );
        service.ready(&waits);
        log_line(&waits);
    }
    let ran = worker.stand_by(stop.flag()).and_then(|serves| {
        if !serves {
            return Ok(());
        }
        alarms.open();
        questions.serve();
        questions.wait_until_open();
        let ready = format!("ready: {}", described(&config));
        service.ready(&ready);
        log_line(&ready);
        worker.run(stop.flag())
    });
    service.stopping();
    // While this process holds the fleet's lock: clients take refusals, too, from no other.
    let queries = questions.finish();
    let alarms = alarms.finish();
    ran?;
    let worker = worker.finish();
    let is_recorded = recorder.is_none_or(|started| started.is_ok_and(RecorderProcess::finish));
    let is_lossy = !is_recorded || worker.ledger_unsaved;
    output.report(&RunReport { worker, queries, alarms })?;
    Ok(Outcome::unless_lost(is_lossy))
}

fn warn_of_models(config: &Config) {
    // The worker refuses a model that cannot be loaded.
    let models = load_models(config).unwrap_or_default();
    for warning in model_range::warnings(config, &models) {
        log_line(&format!("warning: {warning}"));
    }
}

fn described(config: &Config) -> String {
    let platforms = config.settings().platforms.iter().zip(config.models());
    let models: Vec<String> = platforms
        .map(|(platform, model)| format!("{} by {}", platform.name, model_name(model)))
        .collect();
    let (fleet, capacity) = (config.fleet(), config.settings().capacity);
    let (models, pid) = (models.join(", "), std::process::id());
    format!("fleet {fleet}, {capacity} robots capacity, model {models}, pid {pid}")
}

fn model_name(model: &ModelSource) -> String {
    match model {
        ModelSource::File(path) => path.display().to_string(),
        ModelSource::Attached(name, _) => name.to_string(),
        ModelSource::Builtin(name, _) => (*name).to_owned(),
        ModelSource::Persistence { .. } => "persistence".to_owned(),
    }
}

/// The worker's report as text.
#[derive(Debug, Serialize)]
struct RunReport {
    #[serde(flatten)]
    worker: Report,
    /// Questions about plans.
    queries: QueryReport,
    alarms: AlarmReport,
}

impl fmt::Display for RunReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let report = &self.worker;
        let (done, skipped, late) = (report.ticks, report.ticks_skipped, report.ticks_late);
        writeln!(out, "fleet {}: {} robots", report.fleet, report.robots)?;
        writeln!(out, "ticks: {done} done, {skipped} skipped, {late} late")?;
        let shed = report.ticks_without_diagnostics;
        if shed > 0 {
            writeln!(out, "ticks without diagnostics, for lack of time: {shed}")?;
        }
        let tick = &report.tick;
        writeln!(
            out,
            "tick time: p50 {:.1} µs, p99 {:.1} µs, p99.9 {:.1} µs, max {:.1} µs",
            tick.p50_us, tick.p99_us, tick.p999_us, tick.max_us
        )?;
        let parts = &report.parts;
        writeln!(
            out,
            "of it on average: intake {:.1} µs (before the tick), features {:.1}, network {:.1}, \
             bookkeeping {:.1}, writing {:.1}",
            parts.intake_us,
            parts.features_us,
            parts.network_us,
            parts.bookkeeping_us,
            parts.writing_us
        )?;
        let dropped: u64 = report.samples_dropped.values().sum();
        writeln!(out, "samples: {} accepted, {dropped} dropped", report.samples_accepted)?;
        for (reason, count) in &report.samples_dropped {
            writeln!(out, "  {reason}: {count}")?;
        }
        let queries = &self.queries;
        let refused: u64 = queries.refused.values().sum();
        if queries.answered + refused > 0 {
            let answered = queries.answered;
            writeln!(out, "questions: {answered} answered, {refused} refused")?;
        }
        for (reason, count) in &queries.refused {
            writeln!(out, "  {reason}: {count}")?;
        }
        let alarms = &self.alarms;
        if alarms.raised > 0 {
            let (raised, ended) = (alarms.raised, alarms.ended);
            write!(out, "alarms: {raised} raised, {ended} ended")?;
            match alarms.acknowledged {
                0 => writeln!(out)?,
                acknowledged => writeln!(out, ", {acknowledged} acknowledged")?,
            }
        }
        if alarms.ticks_missed > 0 {
            let missed = alarms.ticks_missed;
            writeln!(out, "ticks whose alarms were not logged: {missed}")?;
        }
        if report.frames_unsent > 0 || report.receive_errors > 0 {
            let (unsent, receive) = (report.frames_unsent, report.receive_errors);
            writeln!(out, "errors: {unsent} frames not sent, {receive} receive errors")?;
        }
        if report.ledger_unsaved {
            writeln!(
                out,
                "the ledger could not be saved: the energy metered since the previous save is lost"
            )?;
        }
        Ok(())
    }
}
