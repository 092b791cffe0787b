//! The changes of a running fleet.

use joulebus_board::AlarmRecord;
use joulebus_bus::{NoWorker, clock};
use joulebus_capture_format::Clock;
use joulebus_capture_recorder::host_clock;
use joulebus_consumer::{FleetAlarm, FleetAlarms};
use joulebus_program::exit::Outcome;
use joulebus_program::output::{Output, log_line};
use joulebus_program::stop::Stop;

use super::command::OnAlarm;
use super::{Args, Line};

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let stop = Stop::on_signals()?;
    let config = args.config.load()?;
    let mut alarms = FleetAlarms::with_config(&config, "alarms")?;
    let mut sink = Sink {
        fleet: config.fleet().to_owned(),
        clock: host_clock(),
        command: args.on_alarm.clone().map(OnAlarm::start).transpose()?,
        output,
    };
    let until = args.duration.map_or("until Ctrl-C".to_owned(), |s| format!("for {s} s"));
    log_line(&format!("alarms of fleet {}, {until}", config.fleet()));
    if let Some(no_worker) = NoWorker::look(&config.domain()?) {
        log_line(&format!("{no_worker}. Waiting for one"));
    }
    let length_ns = args.duration.map_or(u64::MAX, |s| (s * 1e9) as u64);
    let until_ns = clock::monotonic_ns().saturating_add(length_ns);
    let mut watched = Ok(());
    while !stop.is_asked() && clock::monotonic_ns() < until_ns && watched.is_ok() {
        watched = sink.turn(&mut alarms);
    }
    let missed = alarms.history().ticks_missed();
    let not_run = sink.command.map_or(0, OnAlarm::finish);
    watched?;
    if missed > 0 {
        log_line(&format!("{missed} ticks without diagnostics"));
    }
    if not_run > 0 {
        log_line(&format!("{not_run} changes were not taken by --on-alarm"));
    }
    Ok(Outcome::unless_lost(missed + not_run > 0))
}

struct Sink {
    fleet: String,
    clock: Clock,
    command: Option<OnAlarm>,
    output: Output,
}

impl Sink {
    /// Waits for changes, and passes them on.
    fn turn(&mut self, alarms: &mut FleetAlarms) -> anyhow::Result<()> {
        let mut result = Ok(());
        alarms.wait(|change| {
            if result.is_ok() {
                result = self.print(&change);
            }
        })?;
        result
    }

    /// The command first: a full disk of stdout does not keep it from being run.
    fn print(&mut self, change: &FleetAlarm) -> anyhow::Result<()> {
        let stamp_ns = self.clock.unix_ns(change.at_ns);
        let line = Line(AlarmRecord::new(&self.fleet, change, stamp_ns));
        if let Some(command) = &mut self.command {
            command.run(&line);
        }
        self.output.line(&line)
    }
}
