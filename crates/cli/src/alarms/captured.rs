//! The history of a capture.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use joulebus_board::AcknowledgedRecord;
use joulebus_capture_format::{Entry, Frame, ReadError, Reader};
use joulebus_consumer::{AlarmChange, AlarmHistory, Change, FleetAlarm};
use joulebus_plan::report::Lasting;
use joulebus_program::exit::Outcome;
use joulebus_program::output::{Output, log_line};
use joulebus_wire::{Acknowledgement, Acknowledgements, Diagnostics};
use serde::Serialize;

use super::s_between;

/// An alarm from its raise to its end.
#[derive(Debug, Serialize)]
struct Episode {
    fleet: String,
    robot: u32,
    alarm: &'static str,
    level: &'static str,
    /// Unix time, ns.
    raised_ns: u64,
    /// Null where it was raised at the end of the recording.
    lasted_s: Option<f64>,
    /// `cleared`, `left`, or `raised` at the end of the recording.
    end: &'static str,
    /// Name of the person who acknowledged it.
    #[serde(skip_serializing_if = "Option::is_none")]
    acknowledged: Option<AcknowledgedRecord>,
}

#[derive(Debug, Serialize)]
struct AlarmsReport {
    alarms: Vec<Episode>,
    /// Fleets whose diagnostics were read.
    fleets: Vec<String>,
    /// Ticks whose diagnostics were read.
    ticks: u64,
    /// Ticks between them without diagnostics.
    ticks_missed: u64,
    /// Errors of the files.
    damage: Vec<String>,
    /// Unix time of the first diagnostics, ns.
    from_ns: Option<u64>,
    /// Unix time of the last diagnostics, ns.
    to_ns: Option<u64>,
}

pub(super) fn run(files: &[PathBuf], output: Output) -> anyhow::Result<Outcome> {
    let mut found = CapturedAlarms::default();
    for file in files {
        found.read(file)?;
    }
    let report = found.report();
    for damage in &report.damage {
        log_line(damage);
    }
    output.report(&report)?;
    let is_whole = report.damage.is_empty() && report.ticks_missed == 0;
    Ok(Outcome::unless_lost(!is_whole))
}

#[derive(Default)]
struct CapturedAlarms {
    fleets: BTreeMap<Arc<str>, AlarmHistory>,
    episodes: Vec<Episode>,
    damage: Vec<String>,
    span_ns: Option<(u64, u64)>,
}

impl CapturedAlarms {
    fn read(&mut self, path: &Path) -> anyhow::Result<()> {
        let named = || path.display().to_string();
        let source = joulebus_files::open(path).with_context(named)?;
        let mut reader = Reader::new(source).with_context(named)?;
        let (mut read, mut of_fleets, mut others) = (0_u64, 0_u64, 0_u64);
        loop {
            match reader.next_entry() {
                Ok(Some(entry)) => {
                    read += 1;
                    of_fleets += u64::from(!entry.fleet.is_empty());
                    self.take(&entry);
                }
                Ok(None) => break,
                Err(ReadError::Message { .. }) => others += 1,
                Err(error) if read == 0 => return Err(error).with_context(named),
                Err(error) => {
                    self.damage.push(format!("{}: {error}", named()));
                    break;
                }
            }
        }
        if of_fleets == 0 {
            // A file of another program is refused.
            crate::info::look(path)?;
        }
        if others > 0 {
            let name = named();
            self.damage.push(format!("{name}: {others} messages cannot be read"));
        }
        Ok(())
    }

    fn take(&mut self, entry: &Entry) {
        let at_ns = entry.publish_time_ns;
        if let Some(Frame { header, rows }) = entry.message.frame::<Acknowledgements>() {
            // Unix time, as that of the diagnostics.
            let unix_ns = |row_ns| at_ns.saturating_sub(header.sent_ns.saturating_sub(row_ns));
            let at_unix =
                |row: &Acknowledgement| Acknowledgement { at_ns: unix_ns(row.at_ns), ..*row };
            let rows: Vec<Acknowledgement> = rows.iter().map(at_unix).collect();
            let history = self.fleets.entry(Arc::clone(&entry.fleet)).or_default();
            history.acknowledge(header, &rows, at_ns, drop);
        }
        let Some(Frame { header, rows }) = entry.message.frame::<Diagnostics>() else {
            return;
        };
        let (from_ns, to_ns) = self.span_ns.unwrap_or((at_ns, at_ns));
        self.span_ns = Some((from_ns.min(at_ns), to_ns.max(at_ns)));
        let history = self.fleets.entry(Arc::clone(&entry.fleet)).or_default();
        let episodes = &mut self.episodes;
        history.take(header, rows, at_ns, |change| {
            if matches!(change.change, Change::Cleared | Change::Left) {
                episodes.push(Episode::new(&entry.fleet, &change));
            }
        });
    }

    fn report(mut self) -> AlarmsReport {
        let (mut ticks, mut ticks_missed) = (0, 0);
        for (fleet, history) in &self.fleets {
            ticks += history.ticks();
            ticks_missed += history.ticks_missed();
            for (robot, alarm, raised_ns) in history.raised() {
                self.episodes.push(Episode {
                    fleet: fleet.to_string(),
                    robot,
                    alarm: alarm.name(),
                    level: alarm.level().name(),
                    raised_ns,
                    lasted_s: None,
                    end: Change::Raised.name(),
                    acknowledged: history.acknowledged(robot, alarm).map(acknowledged),
                });
            }
        }
        self.episodes.sort_by_key(|episode| (episode.raised_ns, episode.robot));
        AlarmsReport {
            alarms: self.episodes,
            fleets: self.fleets.keys().map(ToString::to_string).collect(),
            ticks,
            ticks_missed,
            damage: self.damage,
            from_ns: self.span_ns.map(|(from_ns, _)| from_ns),
            to_ns: self.span_ns.map(|(_, to_ns)| to_ns),
        }
    }
}

impl Episode {
    fn new(fleet: &str, change: &AlarmChange) -> Self {
        Self {
            fleet: fleet.to_owned(),
            robot: change.robot,
            alarm: change.alarm.name(),
            level: change.alarm.level().name(),
            raised_ns: change.raised_ns,
            lasted_s: FleetAlarm::from(*change).lasted_s(),
            end: change.change.name(),
            acknowledged: change.acknowledged.as_ref().map(acknowledged),
        }
    }
}

/// The record of a row whose time is Unix time.
fn acknowledged(row: &Acknowledgement) -> AcknowledgedRecord {
    AcknowledgedRecord::new(row, |at_ns| at_ns)
}

impl fmt::Display for AlarmsReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let from_ns = self.from_ns.unwrap_or_default();
        let lasted = Lasting(s_between(from_ns, self.to_ns.unwrap_or_default()));
        if self.from_ns.is_none() {
            return writeln!(out, "no diagnostics: record the topic `diagnostics`");
        }
        let count = self.alarms.len();
        writeln!(out, "{count} alarms in {lasted} of {} ticks", self.ticks)?;
        if self.ticks_missed > 0 {
            writeln!(out, "{} ticks without diagnostics", self.ticks_missed)?;
        }
        // With one fleet, its name would be the same in each line.
        let widths = self.fleets.iter().map(|fleet| fleet.chars().count());
        let width = widths.max().filter(|_| self.fleets.len() > 1);
        let fleet_column = |fleet: &str| {
            width.map_or(String::new(), |width| format!("  {fleet:<0$}", width.max("fleet".len())))
        };
        if !self.alarms.is_empty() {
            let titles = ["after s", "robot", "alarm", "level", "lasted", "end"];
            let [after, robot, alarm, level, lasted, end] = titles;
            let fleet = fleet_column("fleet");
            writeln!(
                out,
                "{after:>10}{fleet} {robot:>10}  {alarm:<16} {level:<6} {lasted:>10}  {end}"
            )?;
        }
        for episode in &self.alarms {
            let after_s = s_between(from_ns, episode.raised_ns);
            let lasted = episode.lasted_s.map_or(String::new(), |s| Lasting(s).to_string());
            let by = episode.acknowledged.as_ref().map_or(String::new(), |acknowledgement| {
                let after_s = s_between(episode.raised_ns, acknowledgement.at_unix_ns);
                format!(", acknowledged by {} after {}", acknowledgement.by, Lasting(after_s))
            });
            let Episode { fleet, robot, alarm, level, end, .. } = episode;
            let fleet = fleet_column(fleet);
            writeln!(
                out,
                "{after_s:>10.2}{fleet} {robot:>10}  {alarm:<16} {level:<6} {lasted:>10}  {end}{by}"
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(fleets: &[&str]) -> String {
        let episode = |(place, fleet): (usize, &&str)| Episode {
            fleet: (*fleet).to_owned(),
            robot: 7,
            alarm: "NoData",
            level: "stale",
            raised_ns: place as u64 * 1_000_000_000,
            lasted_s: None,
            end: "raised",
            acknowledged: None,
        };
        let report = AlarmsReport {
            alarms: fleets.iter().enumerate().map(episode).collect(),
            fleets: fleets.iter().map(ToString::to_string).collect(),
            ticks: 2,
            ticks_missed: 0,
            damage: Vec::new(),
            from_ns: Some(0),
            to_ns: Some(1),
        };
        report.to_string()
    }

    #[test]
    fn robots_of_several_fleets_are_distinguished() {
        let words =
            |line: &str| -> Vec<String> { line.split_whitespace().map(str::to_owned).collect() };
        let both = text(&["hall", "warehouse"]);
        let lines: Vec<Vec<String>> = both.lines().skip(1).map(words).collect();
        assert_eq!(lines[0][2..4], ["fleet", "robot"], "{both}");
        assert_eq!(lines[1][1..3], ["hall", "7"], "{both}");
        assert_eq!(lines[2][1..3], ["warehouse", "7"], "{both}");
        let one = text(&["hall"]);
        assert!(!one.contains("hall") && !one.contains("fleet"), "{one}");
    }
}
