//! `joulebus record`: records a fleet's shared memory to a file.

mod choice;
mod others;
mod recorder_process;
mod report;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context as _;
use joulebus_bus::{NoWorker, check_threads, clock};
use joulebus_capture_format::{CaptureSettings, MessageKind, Preset};
use joulebus_capture_recorder::{
    Options, Recorder, Snapshot, Suits, Summary, Target, attach, host_clock,
};
use joulebus_config::Config;
use joulebus_models::load_models;
use joulebus_plan::PlanFleet;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::{Format, Output, Stdout, log_line};
use joulebus_program::stop::Stop;
use signal_hook::consts::SIGUSR1;

use crate::configs;
use choice::TopicChoice;
use others::Others;
pub(crate) use recorder_process::RecorderProcess;
use report::RecordReport;

/// Interval of checking whether to stop.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Interval of progress lines, ns.
const PROGRESS_EVERY_NS: u64 = 5_000_000_000;
/// Maximum memory of a snapshot, bytes.
const MAX_SNAPSHOT_BYTES: usize = 512 << 20;
/// The file name that means stdout.
const STDOUT: &str = "-";

fn topics_help() -> String {
    let services: Vec<&str> = MessageKind::of_fleet().map(|kind| kind.name()).collect();
    let services = services.join(", ");
    format!("Record only these topics: names of services ({services}) or complete topics")
}

/// Record a fleet's shared memory to an MCAP file for Foxglove and PlotJuggler
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus record -o run.mcap\n  \
    joulebus record -o run.mcap --topics samples ticks --preset zstd_small\n  \
    joulebus record -o plots.mcap -e '/robot/(3|4)/' --per-robot --duration 60\n  \
    joulebus record -o alarm.mcap --snapshot 30\n  \
    joulebus record --config a.toml --config b.toml -o both.mcap\n\n\
    Ends with SIGINT, SIGTERM or SIGHUP. Config, models and build are attached. A slow disk costs \
    messages, which are counted. It never costs a tick. A recorder that is killed loses less than \
    100 ms of data (zstd_small: about 1 s). `joulebus recover` makes such a file whole.\n\
    Exit code 1: the rest could not be written (what was written can be recovered). Exit code 3: \
    messages were lost, or the capture cannot be verified, because the worker runs with other \
    settings or models than those attached.")]
pub(crate) struct Args {
    /// The fleet's config. Repeat it to record several fleets into one file [default:
    /// the one that other verbs find]
    #[arg(long, value_name = "FILE")]
    config: Vec<PathBuf>,
    /// The file, or - for stdout. Further parts are run_1.mcap, run_2.mcap …, without names that
    /// are taken
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Start with the next part instead of refusing when the file exists
    #[arg(long)]
    resume: bool,
    #[arg(long, value_name = "TOPIC", num_args = 1.., help = topics_help())]
    topics: Vec<String>,
    /// Record topics that match, in addition to --topics
    #[arg(short = 'e', long, value_name = "REGEX")]
    regex: Option<String>,
    /// Also a channel for each robot's sample, forecast, diagnostics and budget, for plots
    #[arg(long)]
    per_robot: bool,
    /// Trade-off between work and file size: fastwrite, lz4, zstd_fast or zstd_small
    #[arg(long, value_name = "PRESET", default_value = Preset::default().name(), value_parser = preset)]
    preset: Preset,
    /// Maximum file size, after which the next file begins, bytes (0: unlimited)
    #[arg(long, value_name = "BYTES", default_value_t = 0)]
    max_bag_size: u64,
    /// Maximum time span of a file, after which the next file begins, s (0: unlimited). The index
    /// of a file is kept in memory until its end, about 30 MB per hour
    #[arg(long, value_name = "SECONDS", default_value_t = 3_600.0, value_parser = seconds)]
    max_bag_duration: f64,
    /// Keep the last seconds in memory, and save them when a robot raises an alarm or on SIGUSR1.
    /// Each time a new file gets the data since the last one
    #[arg(long, value_name = "SECONDS", value_parser = in_memory)]
    snapshot: Option<f64>,
    /// With --snapshot: save on SIGUSR1 only
    #[arg(long, requires = "snapshot")]
    no_alarm: bool,
    /// End after this time, s
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    duration: Option<f64>,
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("{text:?} is not a number (s)"))?;
    if (0.0..=1e9).contains(&seconds) {
        Ok(seconds)
    } else {
        Err(format!("{seconds} s: allowed are 0 to 1000000000 s"))
    }
}

/// A time of which the memory is bounded anyway: more than a day is a mistake.
fn in_memory(text: &str) -> Result<f64, String> {
    let found = seconds(text)?;
    let is_allowed = found <= 86_400.0;
    is_allowed.then_some(found).ok_or_else(|| {
        format!("{found} s: allowed are 0 to 86400 s. Without --snapshot all is recorded")
    })
}

fn preset(text: &str) -> Result<Preset, String> {
    let found = Preset::ALL.into_iter().find(|preset| preset.name() == text);
    let names = Preset::ALL.map(Preset::name).join(", ");
    found.ok_or_else(|| format!("{text:?} is not one of {names}"))
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    // Before anything is created, so that a stop request during the start finishes the file as
    // well.
    let stop = Stop::on_signals()?;
    let write_down = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(SIGUSR1, Arc::clone(&write_down))
        .context("cannot handle SIGUSR1")?;
    check_threads()?;
    let configs = configs::load(&args.config)?;
    let clock = host_clock();
    let names: Vec<&str> = configs.iter().map(Config::fleet).collect();
    let attachments = attach(&configs, clock)?;
    let options = Options { suits: Some(suits(&configs[0])), ..args.options(&names)? };
    let began_ns = clock::monotonic_ns();
    let mut others = Others::start(&args.config, &args.out)?;
    let recorder = Recorder::start(
        &configs[0],
        others.streams(),
        clock,
        attachments,
        args.target(),
        &options,
    )?;
    for config in &configs {
        if let Some(no_worker) = NoWorker::look(&config.domain()?) {
            log_line(&format!("{no_worker}. Waiting for one"));
        }
    }
    let file = args.out.display();
    log_line(&format!("recording {} into {file}", names.join(", ")));
    let end_ns = args.duration.map(|seconds| began_ns.saturating_add(ns(seconds)));
    wait(&recorder, &stop, &write_down, end_ns);
    // Requested together with the end.
    if write_down.swap(false, Ordering::Relaxed) {
        recorder.write_down();
    }
    // Their captures end before ours.
    others.end();
    let summary = recorder.finish();
    let duration_s = (clock::monotonic_ns() - began_ns) as f64 * 1e-9;
    let lost =
        summary.messages_lost() > 0 || !summary.taken.is_empty() || summary.differs.is_some();
    let failed = summary.failure.is_some();
    args.report(&RecordReport::new(&summary, duration_s), output)?;
    if failed {
        return Ok(Outcome::Failed);
    }
    Ok(Outcome::unless_lost(lost))
}

/// Checks that a worker runs with this config and the models that it names now. Those on disk may
/// be newer: they count from the worker's next start on.
fn suits(config: &Config) -> Suits {
    let fleet = load_models(config).map(|models| PlanFleet::new(config.settings(), &models));
    let fleet = fleet.map_err(|error| error.to_string());
    Arc::new(move |header| {
        let fleet = fleet.as_ref().map_err(Clone::clone)?;
        fleet.check(header).map_err(|differs| differs.to_string())
    })
}

/// Waits for a signal, the end of the duration, or a failure.
fn wait(recorder: &Recorder, stop: &Stop, write_down: &AtomicBool, end_ns: Option<u64>) {
    let begin_ns = clock::monotonic_ns();
    let mut progress_ns = begin_ns.saturating_add(PROGRESS_EVERY_NS);
    loop {
        let now_ns = clock::monotonic_ns();
        if recorder.is_over() || end_ns.is_some_and(|end_ns| now_ns >= end_ns) {
            return;
        }
        if write_down.swap(false, Ordering::Relaxed) {
            recorder.write_down();
        }
        if now_ns >= progress_ns {
            progress_ns = now_ns.saturating_add(PROGRESS_EVERY_NS);
            log_line(&progress(&recorder.summary(), now_ns - begin_ns));
        }
        if !stop.sleep_until(now_ns + POLL_INTERVAL.as_nanos() as u64) {
            return;
        }
    }
}

fn progress(summary: &Summary, for_ns: u64) -> String {
    let (messages, bytes) = (summary.messages(), summary.bytes());
    let lost = summary.messages_lost();
    let (seconds, megabytes) = (for_ns as f64 * 1e-9, bytes as f64 * 1e-6);
    let Some(kept) = summary.kept else {
        return format!("{seconds:.0} s: {messages} messages, {megabytes:.1} MB, {lost} lost");
    };
    let (files, waiting, span_s) = (summary.files.len(), kept.messages, kept.span_ns as f64 * 1e-9);
    let kept_mb = kept.bytes as f64 * 1e-6;
    format!(
        "{seconds:.0} s: {waiting} messages of the last {span_s:.1} s in memory ({kept_mb:.1} MB), \
         {files} files written ({messages} messages, {megabytes:.1} MB), {lost} lost"
    )
}

impl Args {
    fn options(&self, fleets: &[&str]) -> anyhow::Result<Options> {
        let choice = TopicChoice::new(&self.topics, self.regex.as_deref())?;
        // Robots may join at any time, and have topics of their own with --per-robot.
        if !self.per_robot {
            choice.check(fleets)?;
        }
        let or_never = |limit: u64| if limit == 0 { u64::MAX } else { limit };
        if self.snapshot == Some(0.0) {
            return Err(UsageError("--snapshot 0 keeps nothing".to_owned()).into());
        }
        Ok(Options {
            settings: CaptureSettings::new(self.preset),
            per_robot: self.per_robot,
            choose: Arc::new(move |topic| choice.has(topic)),
            max_file_bytes: or_never(self.max_bag_size),
            max_file_ns: or_never(ns(self.max_bag_duration)),
            resume: self.resume,
            snapshot: self.snapshot.map(|seconds| Snapshot {
                keep_ns: ns(seconds),
                max_bytes: MAX_SNAPSHOT_BYTES,
                on_alarm: !self.no_alarm,
            }),
            ..Options::default()
        })
    }

    fn target(&self) -> Target {
        if self.out == Path::new(STDOUT) {
            Target::Stream(Box::new(Stdout))
        } else {
            Target::File(self.out.clone())
        }
    }

    /// Writes the report to stdout, unless the capture goes there.
    fn report(&self, report: &RecordReport, output: Output) -> anyhow::Result<()> {
        if self.out != Path::new(STDOUT) {
            return output.report(report);
        }
        match output.format() {
            Format::Text => log_line(report.to_string().trim_end()),
            Format::Json => log_line(&serde_json::to_string(report)?),
        }
        Ok(())
    }
}

fn ns(seconds: f64) -> u64 {
    (seconds * 1e9) as u64
}
