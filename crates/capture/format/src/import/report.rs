//! Report of an import.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use super::channel::Channel;
use super::join::{Row, Track};
use super::mapping::{CurrentSign, TimeSource};
use joulebus_ros_messages::{RosError, RosType};

/// Messages of a topic, used and refused.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TopicReport {
    /// The topic.
    pub topic: String,
    /// Messages in the file.
    pub messages: u64,
    /// Messages not used, or only partly, by reason.
    pub refused: BTreeMap<String, u64>,
}

/// An unused channel of a relevant type.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Unusable {
    /// Its topic.
    pub topic: String,
    /// The type of its messages.
    pub type_name: String,
    /// Their encoding.
    pub encoding: String,
    /// Messages.
    pub messages: u64,
    /// The reason.
    pub why: String,
}

/// A robot that was imported.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RobotReport {
    /// Its name.
    pub name: String,
    /// Its id in captures, if the mapping gives one.
    pub id: Option<u32>,
    /// Clock of its rows.
    pub time: &'static str,
    /// Its battery.
    pub battery: TopicReport,
    /// Its commands.
    pub command: Option<TopicReport>,
    /// Its odometry.
    pub odometry: Option<TopicReport>,
    /// True if its current was turned, because it is negative while the battery discharges.
    #[serde(skip)]
    pub is_turned: bool,
    /// Readings merged into the last one of their burst.
    pub merged_in_bursts: u64,
    /// Rows.
    pub row_count: u64,
    /// Notes.
    pub notes: Vec<String>,
    /// The first row of each run but the first: there the recorder's clock was set back.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub runs_from: Vec<usize>,
    /// The rows, in order of time in each run.
    #[serde(skip)]
    pub rows: Vec<Row>,
}

/// An imported recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Imported {
    /// Its robots.
    pub robots: Vec<RobotReport>,
    /// Channels of relevant types that cannot be read.
    pub unusable: Vec<Unusable>,
    /// Channels of irrelevant types, by type.
    pub others: BTreeMap<String, u64>,
    /// Damage of the file.
    pub damage: Vec<String>,
}

impl Imported {
    /// True if everything in the mapping was used.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        let is_used = |topic: &TopicReport| topic.refused.is_empty();
        self.damage.is_empty()
            && self.robots.iter().all(|robot| {
                is_used(&robot.battery)
                    && robot.command.as_ref().is_none_or(is_used)
                    && robot.odometry.as_ref().is_none_or(is_used)
            })
    }
}

pub(super) fn imported(tracks: Vec<Track>, channels: &[Channel], damage: Vec<String>) -> Imported {
    let mut unusable = Vec::new();
    let mut others = BTreeMap::new();
    let used: Vec<String> = tracks
        .iter()
        .flat_map(|track| {
            let robot = &track.robot;
            let others = [&robot.command, &robot.odometry].into_iter().flatten().cloned();
            robot.batteries().map(str::to_owned).chain(others).collect::<Vec<_>>()
        })
        .collect();
    for channel in channels {
        let why = match &channel.kind {
            _ if used.contains(&channel.topic) => continue,
            Err(RosError::Type { .. }) | Ok(RosType::Bool) => {
                *others.entry(channel.type_name.clone()).or_default() += channel.messages;
                continue;
            }
            Err(error) => error.to_string(),
            Ok(_) if channel.messages == 0 => "it has no messages".to_owned(),
            Ok(_) => "it belongs to no robot".to_owned(),
        };
        unusable.push(Unusable {
            topic: channel.topic.clone(),
            type_name: channel.type_name.clone(),
            encoding: channel.encoding.clone(),
            messages: channel.messages,
            why,
        });
    }
    Imported { robots: tracks.into_iter().map(robot).collect(), unusable, others, damage }
}

fn robot(mut track: Track) -> RobotReport {
    let joined = track.join();
    let Track { robot, battery, command, odometry, .. } = track;
    let batteries = robot.batteries().collect::<Vec<_>>().join(" + ");
    let time = match joined.clock {
        TimeSource::Header => "header",
        TimeSource::Auto | TimeSource::Log => "log",
        TimeSource::Publish => "publish",
    };
    let topic = |topic: String, messages, refused| TopicReport { topic, messages, refused };
    RobotReport {
        name: robot.name,
        id: robot.id,
        time,
        battery: topic(batteries, battery.messages, battery.refused),
        command: robot.command.map(|name| topic(name, command.messages, command.refused)),
        odometry: robot.odometry.map(|name| topic(name, odometry.messages, odometry.refused)),
        is_turned: robot.current == CurrentSign::DischargeNegative,
        merged_in_bursts: joined.merged,
        row_count: joined.rows.len() as u64,
        notes: joined.notes,
        runs_from: joined.runs_from,
        rows: joined.rows,
    }
}

impl fmt::Display for Imported {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for damage in &self.damage {
            writeln!(out, "damaged    {damage}")?;
        }
        for robot in &self.robots {
            write!(out, "{robot}")?;
        }
        if self.robots.is_empty() {
            writeln!(out, "no robot: no channel has battery readings that can be used")?;
        }
        for channel in &self.unusable {
            let Unusable { topic, type_name, messages, why, .. } = channel;
            writeln!(
                out,
                "not used   {} ({}), {messages} messages: {why}",
                one_line(topic),
                one_line(type_name)
            )?;
        }
        let (kinds, messages) = (self.others.len(), self.others.values().sum::<u64>());
        if kinds > 0 {
            writeln!(out, "ignored: {messages} messages of {kinds} other types")?;
        }
        Ok(())
    }
}

impl fmt::Display for RobotReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "robot      {}: {} rows by {} time",
            one_line(&self.name),
            self.row_count,
            self.time
        )?;
        write_topic(out, "battery", Some(&self.battery))?;
        if self.merged_in_bursts > 0 {
            let merged = self.merged_in_bursts;
            writeln!(out, "             {merged} merged in bursts")?;
        }
        write_topic(out, "command", self.command.as_ref())?;
        write_topic(out, "odometry", self.odometry.as_ref())?;
        for note in &self.notes {
            writeln!(out, "  note     {note}")?;
        }
        Ok(())
    }
}

/// A name of a file with its line breaks escaped: it would write lines of its own into the report.
fn one_line(name: &str) -> String {
    name.replace('\n', "\\u000a")
}

fn write_topic(
    out: &mut fmt::Formatter<'_>,
    what: &str,
    topic: Option<&TopicReport>,
) -> fmt::Result {
    let Some(topic) = topic else {
        return writeln!(out, "  {what:<9}none: missing in every row");
    };
    writeln!(out, "  {what:<9}{}, {} messages", one_line(&topic.topic), topic.messages)?;
    for (why, count) in &topic.refused {
        writeln!(out, "             {count} of them: {why}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_writes_no_line_of_its_own() {
        assert_eq!(one_line("/b\nwritten    x"), "/b\\u000awritten    x");
        assert_eq!(one_line("/größe"), "/größe");
    }
}
