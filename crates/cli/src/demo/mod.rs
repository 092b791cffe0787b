//! `joulebus demo`: a simulated fleet, a worker, a planner and a recorder as separate processes.

mod account;
mod capture;
mod directory;
mod show;
mod summary;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use joulebus_board::{Board, Feed};
use joulebus_bus::clock;
use joulebus_program::exit::Outcome;
use joulebus_program::installed::find_program;
use joulebus_program::output::{Format, Output, log_line};
use joulebus_program::stop::Stop;

use crate::supervisor::{Event, Supervisor, Task};
use crate::watch::PlannerReport;

use account::DemoCounts;
use capture::Captured;
use directory::DemoDirectory;
use summary::{Planted, Summary};

const WORKER: &str = "worker";
const SOURCE: &str = "source";
const PLANNER: &str = "planner";
const RECORDER: &str = "recorder";
const PAGE: &str = "page";

/// Timeout of the worker's first frame.
const START_TIMEOUT_NS: u64 = 30_000_000_000;
/// Maximum time for the worker to process the last samples, and for its frame to be read. On a busy
/// machine either may get no processor for more than a second.
const DRAIN_TIMEOUT_NS: u64 = 5_000_000_000;
/// Time for each process to exit.
const GRACE: Duration = Duration::from_secs(5);
const POLL_INTERVAL: Duration = Duration::from_millis(10);

/// Run a simulated fleet, a worker, a planner and a recorder, and show their state
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus demo\n  \
    joulebus demo --robots 200 --duration 60\n  \
    joulebus demo --format json > demo.json\n\n\
    Needs no set-up, and leaves nothing except a capture, which Foxglove can open. Two robots get a fault, which the alarms detect. \
    If the program joulebus-serve is installed, the demo prints the address of a live page. Exit \
    code 3 if a sample that was sent is not accounted for.")]
pub(crate) struct Args {
    /// Number of simulated GTernal robots
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    robots: u32,
    /// Seed of the robots, their missions and their noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// How long the robots drive, s
    #[arg(long, value_name = "SECONDS", default_value_t = 20.0, value_parser = duration)]
    duration: f64,
    /// The capture to write [default: joulebus-demo-<time>.mcap in the current directory]
    #[arg(long, value_name = "FILE")]
    capture: Option<PathBuf>,
    /// Write no capture
    #[arg(long, conflicts_with = "capture")]
    no_capture: bool,
    /// One line per second instead of the live view
    #[arg(long)]
    plain: bool,
}

fn duration(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("{text:?} is not a number (s)"))?;
    if (0.1..=1e7).contains(&seconds) {
        Ok(seconds)
    } else {
        Err(format!("{seconds} s: allowed are 0.1 to 10000000 s"))
    }
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    // Before anything is created, so that a stop request during the start cleans up as well.
    let stop = Stop::on_signals()?;
    let wanted = (!args.no_capture).then_some(args.capture.as_deref());
    let capture = wanted.map(capture::file).transpose()?;
    let directory = DemoDirectory::make(args.robots)?;
    // After the directory, so that it is dropped first: all processes are waited for before the
    // clean-up.
    let mut demo = Demo {
        planted: planted(args.robots, args.duration),
        capture,
        args,
        supervisor: Supervisor::new()?,
        lines_to_stdout: output.format() == Format::Text,
        events: Vec::new(),
    };
    log_line(&demo.purpose());
    let played = demo.play(&directory, &stop);
    let events = demo.supervisor.end_all();
    if played.is_err() {
        for event in demo.events.iter().chain(&events) {
            log_line(&event.to_string());
        }
    }
    drop(demo);
    let left_behind = directory.clear()?;
    let mut summary = played?;
    summary.left_behind = left_behind;
    output.report(&summary)?;
    Ok(Outcome::unless_lost(!summary.is_whole()))
}

/// The robots that get a fault: enough healthy ones must remain for comparison.
fn planted(robots: u32, duration_s: f64) -> Vec<Planted> {
    if robots < 3 {
        return Vec::new();
    }
    // A fault from the start would be learned as the robot's own level.
    let from_s = |share: f64| (share * (duration_s - 15.0)).clamp(2.0, 60.0).round();
    vec![
        Planted {
            robot: robots / 4,
            fault: "load:3",
            means: "draws 3 W more than its commands explain",
            from_s: from_s(0.8),
        },
        Planted {
            robot: robots / 2,
            fault: "stuck",
            means: "its power monitor repeats one value",
            from_s: from_s(0.4),
        },
    ]
}

struct Demo<'a> {
    args: &'a Args,
    planted: Vec<Planted>,
    /// Path of the capture, if one is written.
    capture: Option<PathBuf>,
    supervisor: Supervisor,
    /// Progress lines go to stdout only if they do not mix with JSON.
    lines_to_stdout: bool,
    events: Vec<Event>,
}

impl Demo<'_> {
    /// States what the demo is about to show.
    fn purpose(&self) -> String {
        let Args { robots, duration, .. } = self.args;
        let mut text = format!(
            "{robots} simulated robots with batteries, a worker and a planner as processes of their own, for {duration} s"
        );
        for planted in &self.planted {
            let (robot, means, from_s) = (planted.robot, planted.means, planted.from_s);
            let _ = write!(text, "; robot {robot}: {means}, from {from_s} s on");
        }
        text
    }

    /// Starts, shows and ends everything in order.
    fn play(&mut self, directory: &DemoDirectory, stop: &Stop) -> anyhow::Result<Summary> {
        self.supervisor.add(task(WORKER, directory, &["run"]));
        self.supervisor.add(task(PLANNER, directory, &["watch", "--summary"]));
        if let Some(capture) = &self.capture {
            self.supervisor.add(recorder(directory, capture));
        }
        let feed = Feed::start(directory.config(), "demo", (true, true))?;
        self.wait_for_worker(&feed, stop)?;
        if self.capture.is_some() {
            self.wait_for_line(&feed, stop, RECORDER, "recording ")?;
        }
        if self.lines_to_stdout && find_program("joulebus-serve").is_ok() {
            let verb = ["serve", "--http", "127.0.0.1:0"];
            self.supervisor.add(task(PAGE, directory, &verb));
            if let Some(line) = self.wait_for_line(&feed, stop, PAGE, "serving fleet ")? {
                log_line(&line);
                feed.board().note(line, clock::monotonic_ns());
            }
        }
        feed.board().begin(clock::monotonic_ns());
        self.supervisor.add(self.source(directory));
        let began_ns = clock::monotonic_ns();
        if !stop.is_asked() {
            self.show(directory.config(), &feed, stop, began_ns)?;
        }
        self.finish(feed)
    }

    fn source(&self, directory: &DemoDirectory) -> Task {
        let mut task = task(SOURCE, directory, &["publish", "sim"]);
        let (robots, seed) = (self.args.robots.to_string(), self.args.seed.to_string());
        for argument in ["--robots", &robots, "--seed", &seed] {
            task.arguments.push(argument.into());
        }
        for planted in &self.planted {
            task.arguments.push("--fault".into());
            task.arguments.push(planted.argument().into());
        }
        task
    }

    /// Supervises the processes. Events are shown on the board.
    fn look_after(&mut self, feed: &Feed) -> anyhow::Result<()> {
        let now_ns = clock::monotonic_ns();
        let events = self.supervisor.poll();
        for event in &events {
            // Output of a process is shown only if something fails.
            if !matches!(event, Event::Output { .. }) {
                feed.board().note(event.to_string(), now_ns);
            }
        }
        self.events.extend(events);
        let died = self.events.iter().find(|event| matches!(event, Event::Exited { .. }));
        died.map_or(Ok(()), |died| {
            Err(anyhow::anyhow!(
                "{died}, and the demo with it. See the output of the processes above"
            ))
        })
    }

    /// Waits for the worker's first frame: from then on no sample is lost.
    fn wait_for_worker(&mut self, feed: &Feed, stop: &Stop) -> anyhow::Result<()> {
        let give_up_ns = clock::monotonic_ns() + START_TIMEOUT_NS;
        while feed.board().header().is_none() && !stop.is_asked() {
            self.look_after(feed)?;
            anyhow::ensure!(feed.is_reading(), "the demo's own planner has ended");
            anyhow::ensure!(
                clock::monotonic_ns() < give_up_ns,
                "the worker has sent nothing for {} s. See the output of the processes above",
                START_TIMEOUT_NS / 1_000_000_000
            );
            std::thread::sleep(POLL_INTERVAL);
        }
        Ok(())
    }

    /// Waits until a process reports that it is ready, and returns the line: so the capture begins
    /// before the first sample, and the page's address is known.
    fn wait_for_line(
        &mut self,
        feed: &Feed,
        stop: &Stop,
        of: &str,
        begin: &str,
    ) -> anyhow::Result<Option<String>> {
        let give_up_ns = clock::monotonic_ns() + START_TIMEOUT_NS;
        let printed = |event: &Event| match event {
            Event::Output { name, line } if *name == of && line.starts_with(begin) => {
                Some(line.clone())
            }
            _ => None,
        };
        while !stop.is_asked() && clock::monotonic_ns() < give_up_ns {
            self.look_after(feed)?;
            let line = self.events.iter().find_map(printed);
            if line.is_some() {
                return Ok(line);
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        Ok(None)
    }

    /// Stops the recorder. Returns its report on the capture.
    fn captured(&mut self) -> Option<Captured> {
        let path = self.capture.clone()?;
        let recorder = self.supervisor.end(RECORDER, GRACE, &mut self.events);
        let captured = Captured::read(&recorder.stdout, &path);
        if captured.is_none() {
            log_line("the recorder left no report");
        }
        captured
    }

    /// Stops the source first, drains, then stops planner and recorder, then the worker.
    fn finish(&mut self, feed: Feed) -> anyhow::Result<Summary> {
        let source = self.supervisor.end(SOURCE, GRACE, &mut self.events);
        let duration_s = feed.board().seconds(clock::monotonic_ns());
        let sent = samples_sent(&source.stdout);
        let give_up_ns = clock::monotonic_ns() + DRAIN_TIMEOUT_NS;
        loop {
            self.look_after(&feed)?;
            let drained = account(&feed.board(), sent).adds_up();
            if drained || clock::monotonic_ns() >= give_up_ns {
                break;
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        let planner = self.supervisor.end(PLANNER, GRACE, &mut self.events);
        self.supervisor.end(PAGE, GRACE, &mut self.events);
        let board = feed.finish()?;
        let captured = self.captured();
        self.supervisor.end(WORKER, GRACE, &mut self.events);
        // One that was stopped before it was ready has no report.
        let report: Option<PlannerReport> = serde_json::from_str(&planner.stdout).ok();
        if let (None, Some(status)) = (&report, planner.status) {
            log_line(&format!("the planner left no report: {status}"));
        }
        Ok(Summary::new(
            &board,
            account(&board, sent),
            report,
            &self.planted,
            (self.args.seed, duration_s),
            captured,
        ))
    }
}

/// `sent`: number of samples sent, reported by the source. Without a report, as many as were seen.
fn account(board: &Board, sent: Option<u64>) -> DemoCounts {
    let sent = sent.unwrap_or_else(|| board.sent.values().sum());
    DemoCounts::new(sent, board.accepted(), board.dropped())
}

/// A process of the demo.
fn task(name: &'static str, directory: &DemoDirectory, verb: &[&str]) -> Task {
    let mut arguments: Vec<std::ffi::OsString> = verb.iter().map(Into::into).collect();
    arguments.extend(["--config".into(), directory.file().into()]);
    arguments.extend(["--format".into(), "json".into()]);
    Task { name, arguments }
}

fn recorder(directory: &DemoDirectory, capture: &Path) -> Task {
    let mut task = task(RECORDER, directory, &["record"]);
    let arguments = ["--out".into(), capture.as_os_str().to_owned()];
    task.arguments.extend(arguments);
    task
}

/// The number of samples sent, from a source's report.
fn samples_sent(report: &str) -> Option<u64> {
    let report: serde_json::Value = serde_json::from_str(report).ok()?;
    report.get("samples_sent")?.as_u64()
}
