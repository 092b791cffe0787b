//! `joulebus watch`: shows the forecasts of a fleet's worker.

mod summary;

use std::cell::RefCell;
use std::io::IsTerminal as _;
use std::time::Duration;

use joulebus_board::{Board, Feed, FrameRecord, Link, Platforms, Reading, Row};
use joulebus_bus::{NoWorker, clock};
use joulebus_config::{Config, Domain};
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::Outcome;
use joulebus_program::output::{Format, Output, log_line, text};
use joulebus_program::stop::Stop;

use crate::view::{Screen, line, show, table};

pub(crate) use summary::PlannerReport;

/// A worker that answers questions sends their counts to a new reader within 100 ms, ns.
const COUNTS_WITHIN_NS: u64 = 500_000_000;
/// Timeout of `--once` for a worker, ns.
const PATIENCE_NS: u64 = 2_500_000_000;
/// Interval between plain lines, ns.
const LINE_EVERY_NS: u64 = 1_000_000_000;
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Show the forecasts of a fleet's worker, live, as lines or as JSON
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus watch --config configs/fleet.toml\n  \
    joulebus watch --once\n  \
    joulebus watch --robot 3 --format json | jq .robots[0].power_w\n\n\
    It may start before the worker, and continues when the worker is restarted. A terminal shows \
    the live view. Elsewhere it prints one line a second. --format json: one object for each \
    frame, in one line.")]
pub(crate) struct Args {
    #[command(flatten)]
    config: ConfigFile,
    /// Only this robot, or in the live view the initial selection
    #[arg(long, value_name = "ID")]
    robot: Option<u32>,
    /// Show the newest frame and exit, with code 1 if there is no worker within 2.5 s
    #[arg(long, conflicts_with_all = ["duration", "summary"])]
    once: bool,
    /// Stop after this time, s [default: at a signal]
    #[arg(long, value_name = "SECONDS", value_parser = crate::alarms::seconds)]
    duration: Option<f64>,
    /// Lines also on a terminal
    #[arg(long)]
    plain: bool,
    /// Also the energy that each robot will draw if it goes on as now: over the next minute in the
    /// table, over 1, 10, 60 and 300 s as JSON. The worker computes it only while somebody asks
    #[arg(long, conflicts_with = "summary")]
    outlook: bool,
    /// Only a summary of latencies and gaps at the end
    #[arg(long)]
    summary: bool,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let stop = Stop::on_signals()?;
    let config = args.config.load()?;
    let end_ns = args.end_ns();
    if args.once {
        return args.once(&config, output, &stop);
    }
    if args.summary {
        return summary::run(&config, output, &stop, end_ns);
    }
    if output.format() == Format::Json {
        return args.stream(&config, output, &stop, end_ns);
    }
    args.live(&config, &stop, end_ns)
}

impl Args {
    fn end_ns(&self) -> u64 {
        let duration_ns = self.duration.map_or(u64::MAX, |duration_s| (duration_s * 1e9) as u64);
        clock::monotonic_ns().saturating_add(duration_ns)
    }

    fn once(&self, config: &Config, output: Output, stop: &Stop) -> anyhow::Result<Outcome> {
        let board = RefCell::new(Board::new(clock::monotonic_ns()));
        let mut reading = Reading::open(config, "watch", false)?;
        reading.want_outlooks(self.outlook)?;
        let give_up_ns = clock::monotonic_ns() + PATIENCE_NS;
        let mut counts_by_ns = give_up_ns;
        while !stop.is_asked() && clock::monotonic_ns() < give_up_ns {
            // The first frames may be empty: no robot has sent samples yet.
            reading.poll(|| board.borrow_mut())?;
            let board = board.borrow();
            let whole = |row: &Row| row.diagnostic.is_some() && row.budget.is_some();
            if board.rows.values().any(whole)
                && (!self.outlook || !board.outlooks.is_empty())
                && self.robot.is_none_or(|robot| board.rows.contains_key(&robot))
            {
                let now_ns = clock::monotonic_ns();
                counts_by_ns = counts_by_ns.min(now_ns + COUNTS_WITHIN_NS);
                if board.queries.is_none() && now_ns < counts_by_ns {
                    continue;
                }
                break;
            }
        }
        let board = board.borrow();
        let Some(record) = FrameRecord::newest(&board, self.robot) else {
            log_line(&NoWorker::seen_nowhere(&config.domain()?).to_string());
            return Ok(Outcome::Failed);
        };
        if let Some(robot) = self.robot.filter(|robot| !board.rows.contains_key(robot)) {
            log_line(&format!(
                "robot {robot} is not in the fleet: no source publishes samples of it"
            ));
            return Ok(Outcome::Failed);
        }
        match output.format() {
            Format::Json => output.line(&record)?,
            Format::Text => text(&format!(
                "{}\n{}{}",
                line(&board, clock::monotonic_ns()).trim_start(),
                table(&board, self.robot),
                board.model_fit().join("\n")
            ))?,
        }
        Ok(Outcome::Done)
    }

    /// One JSON object per frame.
    fn stream(
        &self,
        config: &Config,
        output: Output,
        stop: &Stop,
        end_ns: u64,
    ) -> anyhow::Result<Outcome> {
        let board = RefCell::new(Board::new(clock::monotonic_ns()));
        let mut reading = Reading::open(config, "watch", false)?;
        reading.want_outlooks(self.outlook)?;
        let mut reporter = LinkReporter::new(config)?;
        while !stop.is_asked() && clock::monotonic_ns() < end_ns {
            let came = reading.poll(|| board.borrow_mut())?;
            let board = board.borrow();
            reporter.report_changes(&board);
            if let Some(record) = FrameRecord::newest(&board, self.robot).filter(|_| came) {
                output.line(&record)?;
            }
        }
        Ok(Outcome::Done)
    }

    /// The live view, or one line per second.
    fn live(&self, config: &Config, stop: &Stop, end_ns: u64) -> anyhow::Result<Outcome> {
        let feed = Feed::start(config, "watch", (false, self.outlook))?;
        let began_ns = clock::monotonic_ns();
        if !self.plain && std::io::stdout().is_terminal() && std::io::stdin().is_terminal() {
            let mut screen =
                Screen::new(config.fleet(), Platforms::new(config.settings()), self.robot);
            if let Some(no_worker) = NoWorker::look(&config.domain()?) {
                screen.say_while_waiting(no_worker.to_string());
            }
            show(&feed, &mut screen, stop, || {
                let now_ns = clock::monotonic_ns();
                let seconds = (now_ns - began_ns) as f64 * 1e-9;
                Ok((now_ns < end_ns).then(|| format!("{seconds:.0} s")))
            })?;
        } else {
            let mut reporter = LinkReporter::new(config)?;
            let mut next_ns = began_ns + LINE_EVERY_NS;
            while !stop.is_asked() && feed.is_reading() && clock::monotonic_ns() < end_ns {
                std::thread::sleep(POLL_INTERVAL);
                let now_ns = clock::monotonic_ns();
                reporter.report_changes(&feed.board());
                if now_ns >= next_ns {
                    next_ns += LINE_EVERY_NS;
                    let line = line(&feed.board(), now_ns);
                    text(&line)?;
                }
            }
        }
        feed.finish()?;
        Ok(Outcome::Done)
    }
}

/// State of the worker last reported on stderr.
#[derive(Debug)]
struct LinkReporter {
    domain: Domain,
    link: Option<Link>,
    noted_s: f64,
}

impl LinkReporter {
    fn new(config: &Config) -> anyhow::Result<Self> {
        Ok(Self { domain: config.domain()?, link: None, noted_s: 0.0 })
    }

    fn report_changes(&mut self, board: &Board) {
        if self.link != Some(board.link) && board.link == Link::Waiting {
            match NoWorker::look(&self.domain) {
                Some(no_worker) => log_line(&format!("{no_worker}. Waiting for one")),
                None => log_line("waiting for the first frame of the worker"),
            }
        }
        self.link = Some(board.link);
        for (at_s, note) in board.notes.iter().filter(|(at_s, _)| *at_s > self.noted_s) {
            log_line(&format!("{at_s:>6.1} s  {note}"));
        }
        self.noted_s = board.notes.back().map_or(self.noted_s, |(at_s, _)| *at_s);
    }
}
