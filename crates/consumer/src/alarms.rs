//! Changes of the robots' alarms, from one frame of diagnostics to the next.

use std::collections::HashMap;
use std::fmt;
use std::time::Duration;

use joulebus_bus::{Bus, Reader, clock};
use joulebus_config::Config;
use joulebus_connect::raises::raises;
use joulebus_connect::{ConnectError, join};
use joulebus_wire::{
    Acknowledgement, AcknowledgementHeader, Acknowledgements, Alarm, AlarmSet, Diagnostic,
    DiagnosticHeader, Diagnostics, FrameHeader as _, FrameOrder, SCHEMA_VERSION,
};

use crate::newest::{ReadError, check_schema};
use crate::subscriber::look_every;

/// A change of an alarm.
///
/// [`AlarmHistory`] has an example.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Change {
    /// The alarm is raised.
    Raised,
    /// The alarm is no longer raised.
    Cleared,
    /// The robot has left the fleet while it was raised.
    Left,
    /// A person has acknowledged it. It is still raised.
    Acknowledged,
}

impl Change {
    /// The name, as in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Raised => "raised",
            Self::Cleared => "cleared",
            Self::Left => "left",
            Self::Acknowledged => "acknowledged",
        }
    }
}

/// A change of an alarm of a robot.
///
/// [`AlarmHistory`] has an example.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct AlarmChange {
    /// The robot.
    pub robot: u32,
    /// Its alarm.
    pub alarm: Alarm,
    /// The change.
    pub change: Change,
    /// When, as the caller of [`AlarmHistory::take`] counts time, ns. Of a raise that was [known
    /// before](AlarmHistory::know), when it was raised.
    pub at_ns: u64,
    /// When it was raised, ns. If the first frame had it already and that is not known, the time of
    /// that frame.
    pub raised_ns: u64,
    /// The acknowledgement of this raise, if there is one. Earlier raises do not count.
    pub acknowledged: Option<Acknowledgement>,
}

/// The alarms that are raised, and since when.
///
/// ```
/// use joulebus_consumer::wire::{Alarm, AlarmSet, Diagnostic, DiagnosticHeader};
/// use joulebus_consumer::{AlarmHistory, Change};
///
/// let alarms = AlarmSet::default().with(Alarm::StuckSensor).0;
/// let stuck = Diagnostic { robot: 7, alarms, ..Diagnostic::default() };
/// let header = DiagnosticHeader { tick: 1, ..DiagnosticHeader::default() };
/// let mut history = AlarmHistory::default();
/// let mut changes = Vec::new();
/// history.take(&header, &[stuck], 1_000, |change| changes.push(change));
/// assert_eq!((changes[0].robot, changes[0].change), (7, Change::Raised));
/// assert_eq!(history.raised().next(), Some((7, Alarm::StuckSensor, 1_000)));
/// ```
#[derive(Debug, Clone, Default)]
pub struct AlarmHistory {
    robots: HashMap<u32, Raised>,
    /// When alarms of the next frame were raised, by robot and code.
    known: HashMap<(u32, u16), u64>,
    /// Run of the worker, and tick, of the newest frame.
    newest_tick: Option<(u64, u64)>,
    ticks: u64,
    ticks_missed: u64,
    /// The newest frame of what is acknowledged.
    listed: Vec<Listed>,
    listed_at: Option<FrameOrder>,
}

/// An alarm that the worker lists as acknowledged.
#[derive(Debug, Clone, Copy)]
struct Listed {
    row: Acknowledgement,
    raise: Raise,
}

/// The raise that an acknowledgement is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Raise {
    /// The raise is not known yet.
    Awaited,
    Lasts,
    /// The raise has ended, and the worker has not noticed yet.
    Over,
}

/// The alarms of a robot.
#[derive(Debug, Clone, Copy)]
struct Raised {
    alarms: AlarmSet,
    since_ns: [u64; Alarm::ALL.len()],
    /// Number of the frame that had them.
    seen: u64,
}

impl AlarmHistory {
    /// The next frame may have alarms that were raised before: these, by robot and code, with their
    /// times as the caller of [`AlarmHistory::take`] counts time, ns.
    pub fn know(&mut self, raises: HashMap<(u32, u16), u64>) {
        self.known = raises;
    }

    /// Run of the worker of the newest frame that was taken.
    pub fn run(&self) -> Option<u64> {
        self.newest_tick.map(|(run, _)| run)
    }

    /// Takes the diagnostics of a tick, sent or received at `at_ns`, and calls `each` for every
    /// change: robots in the order of the frame, then robots that left, by id. Skips earlier ticks.
    pub fn take(
        &mut self,
        header: &DiagnosticHeader,
        robots: &[Diagnostic],
        at_ns: u64,
        mut each: impl FnMut(AlarmChange),
    ) {
        let tick = (header.worker_epoch, header.tick);
        if self.newest_tick >= Some(tick) {
            return;
        }
        // Ticks of different runs are not comparable.
        let before = self.newest_tick.filter(|(epoch, _)| *epoch == tick.0);
        let missed = before.map_or(0, |(_, before)| tick.1 - before - 1);
        self.ticks_missed = self.ticks_missed.saturating_add(missed);
        self.newest_tick = Some(tick);
        self.ticks += 1;
        let mut waiting = self.robots.len();
        for robot in robots {
            let had_alarms = waiting > 0 && self.robots.contains_key(&robot.robot);
            if robot.alarms != 0 || had_alarms {
                waiting -= usize::from(had_alarms);
                self.update(robot.robot, AlarmSet(robot.alarms), at_ns, &mut each);
            }
        }
        if waiting > 0 {
            self.remove_others(at_ns, &mut each);
        }
        self.known.clear();
    }

    fn update(
        &mut self,
        robot: u32,
        alarms: AlarmSet,
        at_ns: u64,
        each: &mut impl FnMut(AlarmChange),
    ) {
        let raised = self.robots.entry(robot).or_insert(Raised {
            alarms: AlarmSet::default(),
            since_ns: [0; Alarm::ALL.len()],
            seen: 0,
        });
        raised.seen = self.ticks;
        let changed = AlarmSet(raised.alarms.0 ^ alarms.0);
        for alarm in changed.iter() {
            let since_ns = &mut raised.since_ns[usize::from(alarm.code()) - 1];
            let (change, at_ns) = if alarms.has(alarm) {
                let known_ns = self.known.get(&(robot, alarm.code()));
                *since_ns = known_ns.map_or(at_ns, |known_ns| at_ns.min(*known_ns));
                (Change::Raised, *since_ns)
            } else {
                (Change::Cleared, at_ns)
            };
            let raised_ns = *since_ns;
            report(
                &mut self.listed,
                each,
                AlarmChange { robot, alarm, change, at_ns, raised_ns, acknowledged: None },
            );
        }
        raised.alarms = alarms;
        if alarms.0 == 0 {
            self.robots.remove(&robot);
        }
    }

    /// Takes what is acknowledged, sent or received at `at_ns`, and calls `each` for every raised
    /// alarm that newly is. Frames earlier than one that was taken are passed over.
    pub fn acknowledge(
        &mut self,
        header: &AcknowledgementHeader,
        rows: &[Acknowledgement],
        at_ns: u64,
        mut each: impl FnMut(AlarmChange),
    ) {
        if self.listed_at >= Some(header.order()) {
            return;
        }
        self.listed_at = Some(header.order());
        let known = std::mem::take(&mut self.listed);
        for row in rows {
            let found = known.iter().find(|known| known.row == *row);
            let raised = self.of(row.robot).find(|(alarm, _)| *alarm == row.alarm());
            let raise = match (found.map_or(Raise::Awaited, |known| known.raise), raised) {
                (Raise::Awaited, Some((alarm, raised_ns))) => {
                    each(AlarmChange {
                        robot: row.robot,
                        alarm,
                        change: Change::Acknowledged,
                        at_ns,
                        raised_ns,
                        acknowledged: Some(*row),
                    });
                    Raise::Lasts
                }
                (raise, _) => raise,
            };
            self.listed.push(Listed { row: *row, raise });
        }
    }

    /// The acknowledgement of an alarm since it was raised.
    #[must_use]
    pub fn acknowledged(&self, robot: u32, alarm: Alarm) -> Option<&Acknowledgement> {
        let of_it = |listed: &&Listed| {
            (listed.row.robot, listed.row.alarm()) == (robot, alarm) && listed.raise == Raise::Lasts
        };
        self.listed.iter().find(of_it).map(|listed| &listed.row)
    }

    /// Ends the alarms of the robots that were not in the newest frame.
    fn remove_others(&mut self, at_ns: u64, each: &mut impl FnMut(AlarmChange)) {
        let newest = self.ticks;
        let left = self.robots.iter().filter(|(_, raised)| raised.seen != newest);
        let mut left: Vec<u32> = left.map(|(robot, _)| *robot).collect();
        left.sort_unstable();
        for robot in left {
            let ended = self.of(robot).map(|(alarm, raised_ns)| AlarmChange {
                robot,
                alarm,
                change: Change::Left,
                at_ns,
                raised_ns,
                acknowledged: None,
            });
            let ended: Vec<AlarmChange> = ended.collect();
            for change in ended {
                report(&mut self.listed, each, change);
            }
            self.robots.remove(&robot);
        }
    }

    fn of(&self, robot: u32) -> impl Iterator<Item = (Alarm, u64)> {
        let raised = self.robots.get(&robot).copied();
        raised.into_iter().flat_map(|raised| {
            let since_ns = move |alarm: Alarm| raised.since_ns[usize::from(alarm.code()) - 1];
            raised.alarms.iter().map(move |alarm| (alarm, since_ns(alarm)))
        })
    }

    /// The alarms that are raised, in the order of robots and alarms: robot, alarm, and when it was
    /// raised, ns.
    pub fn raised(&self) -> impl Iterator<Item = (u32, Alarm, u64)> {
        let mut robots: Vec<u32> = self.robots.keys().copied().collect();
        robots.sort_unstable();
        let alarms = robots.into_iter().map(|robot| (robot, self.of(robot)));
        alarms.flat_map(|(robot, alarms)| alarms.map(move |(alarm, since)| (robot, alarm, since)))
    }

    /// Ticks whose diagnostics were taken.
    pub const fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Ticks between them without diagnostics: overwritten before they were read, or left out by an
    /// overloaded worker. Alarms that were raised and cleared within them are not known.
    pub const fn ticks_missed(&self) -> u64 {
        self.ticks_missed
    }
}

/// Reports a raise or an end, with who had acknowledged it first.
fn report(listed: &mut [Listed], each: &mut impl FnMut(AlarmChange), change: AlarmChange) {
    let is_of_it =
        |listed: &Listed| (listed.row.robot, listed.row.alarm()) == (change.robot, change.alarm);
    let first = listed.iter().find(|listed| is_of_it(listed));
    let acknowledged = first.filter(|first| first.raise == Raise::Lasts).map(|first| first.row);
    each(AlarmChange { acknowledged, ..change });
    for listed in listed.iter_mut().filter(|listed| is_of_it(listed)) {
        if change.change != Change::Raised {
            listed.raise = Raise::Over;
        } else if listed.raise == Raise::Awaited {
            // Acknowledged before this history began: the raise itself is not known.
            listed.raise = Raise::Lasts;
            each(AlarmChange {
                change: Change::Acknowledged,
                acknowledged: Some(listed.row),
                ..change
            });
        }
    }
}

/// All diagnostics of a fleet from now on, as changes of alarms. Belongs to the connecting thread.
///
/// ```no_run
/// use joulebus_consumer::{AlarmFeed, Config};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut feed = AlarmFeed::with_config(&Config::load("configs/fleet.toml")?, "pager")?;
/// loop {
///     feed.changes(|change| {
///         println!("{} of robot {}: {}", change.alarm.name(), change.robot, change.change.name());
///     })?;
///     std::thread::sleep(feed.look_every());
/// }
/// # }
/// ```
pub struct AlarmFeed {
    reader: Reader<Diagnostics>,
    acknowledgements: Reader<Acknowledgements>,
    history: AlarmHistory,
    look_every: Duration,
    config: Config,
    // After the port, which must be dropped before the process leaves the domain.
    _bus: Bus,
}

impl AlarmFeed {
    /// Joins the fleet of `config` as `name`. The worker need not run.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn with_config(config: &Config, name: &str) -> Result<Self, ConnectError> {
        let limits = config.limits();
        let bus = join(config, name)?;
        Ok(Self {
            reader: bus.reader(&limits)?,
            acknowledgements: bus.reader(&limits)?,
            history: AlarmHistory::default(),
            look_every: look_every(config),
            config: config.clone(),
            _bus: bus,
        })
    }

    /// Longest pause between calls of [`AlarmFeed::changes`] in which nothing is overwritten.
    pub const fn look_every(&self) -> Duration {
        self.look_every
    }

    /// Takes everything that the worker has sent since the last call, and calls `each` for every
    /// change, with monotonic times. Of alarms that were raised before this began, the process of
    /// the worker states when. Does not wait, nor listen to events, which would cost the worker
    /// time in every tick.
    ///
    /// # Errors
    /// [`ReadError`]. The next call may succeed, unless the fleet's files were removed.
    pub fn changes(&mut self, mut each: impl FnMut(AlarmChange)) -> Result<(), ReadError> {
        let (now_ns, history) = (clock::monotonic_ns(), &mut self.history);
        let config = &self.config;
        let (mut foreign, mut found) = (None, false);
        self.reader.take_all(|header, robots| {
            if header.schema == SCHEMA_VERSION {
                found = true;
                if history.run() != Some(header.worker_epoch) {
                    history.know(raises(config, header.worker_epoch));
                }
                history.take(header, robots, now_ns, &mut each);
            } else {
                foreign = Some(header.schema);
            }
        })?;
        // After the diagnostics, which have what is acknowledged.
        self.acknowledgements.take_all(|header, rows| {
            if header.schema == SCHEMA_VERSION {
                history.acknowledge(header, rows, now_ns, &mut each);
            }
        })?;
        check_schema(found, foreign)
    }

    /// The alarms so far.
    pub const fn history(&self) -> &AlarmHistory {
        &self.history
    }
}

impl fmt::Debug for AlarmFeed {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("AlarmFeed").field("history", &self.history).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use proptest::prelude::*;

    use super::*;

    fn header(worker_epoch: u64, tick: u64) -> DiagnosticHeader {
        DiagnosticHeader { schema: SCHEMA_VERSION, worker_epoch, tick, ..Default::default() }
    }

    fn row((robot, alarms): (&u32, &u32)) -> Diagnostic {
        Diagnostic { robot: *robot, alarms: *alarms, ..Default::default() }
    }

    #[test]
    fn an_alarm_that_the_first_frame_has_is_raised_when_it_is_known_to_have_been() {
        let mut history = AlarmHistory::default();
        let alarms = AlarmSet::default().with(Alarm::NoData).with(Alarm::BiasHigh).0;
        let (seven, nine) = (row((&7, &alarms)), row((&9, &alarms)));
        let no_data = Alarm::NoData.code();
        // A time in the future is not believed.
        history.know([((7, no_data), 1_000), ((9, no_data), 9_000)].into());
        let mut raises = Vec::new();
        let mut each = |change: AlarmChange| {
            raises.push((change.robot, change.alarm, change.at_ns, change.raised_ns));
        };
        history.take(&header(1, 1), &[seven, nine], 5_000, &mut each);
        let expected = [
            (7, Alarm::NoData, 1_000, 1_000),
            (7, Alarm::BiasHigh, 5_000, 5_000),
            (9, Alarm::NoData, 5_000, 5_000),
            (9, Alarm::BiasHigh, 5_000, 5_000),
        ];
        assert_eq!(raises, expected);
        let mut raises = Vec::new();
        // It was known of the first frame alone.
        history.take(&header(1, 2), &[], 6_000, |_| ());
        history.take(&header(1, 3), &[seven], 7_000, |change| raises.push(change.raised_ns));
        assert_eq!(raises, [7_000, 7_000]);
    }

    /// Expected changes from one frame to the next, for each alarm of each robot.
    fn expected(
        before: &BTreeMap<u32, u32>,
        after: &BTreeMap<u32, u32>,
    ) -> BTreeSet<(u32, u16, u8)> {
        let ids: BTreeSet<u32> = before.keys().chain(after.keys()).copied().collect();
        let mut changes = BTreeSet::new();
        for id in ids {
            for alarm in Alarm::ALL {
                let had = before.get(&id).is_some_and(|set| AlarmSet(*set).has(alarm));
                let has = after.get(&id).map(|set| AlarmSet(*set).has(alarm));
                let change = match (had, has) {
                    (false, Some(true)) => 0,
                    (true, Some(false)) => 1,
                    (true, None) => 2,
                    _ => continue,
                };
                changes.insert((id, alarm.code(), change));
            }
        }
        changes
    }

    proptest! {
        #[test]
        fn every_change_is_reported_once_with_its_times(
            frames in prop::collection::vec(
                prop::collection::btree_map(0u32..6, prop_oneof![Just(0), any::<u32>()], 0..6),
                1..20,
            ),
        ) {
            let all = (1 << Alarm::ALL.len()) - 1;
            let mut history = AlarmHistory::default();
            let (mut before, mut raised) = (BTreeMap::new(), BTreeMap::new());
            for (tick, frame) in frames.into_iter().enumerate() {
                let frame: BTreeMap<u32, u32> =
                    frame.into_iter().map(|(robot, alarms)| (robot, alarms & all)).collect();
                let rows: Vec<Diagnostic> = frame.iter().map(row).collect();
                let at_ns = 100 * tick as u64 + 7;
                let mut found = Vec::new();
                history.take(&header(1, tick as u64), &rows, at_ns, |change| found.push(change));
                for change in &found {
                    let place = (change.robot, change.alarm);
                    match change.change {
                        Change::Raised => prop_assert_eq!(raised.insert(place, at_ns), None),
                        _ => prop_assert_eq!(raised.remove(&place), Some(change.raised_ns)),
                    }
                    prop_assert_eq!(change.at_ns, at_ns);
                }
                let reported: Vec<_> = found
                    .iter()
                    .map(|change| (change.robot, change.alarm.code(), change.change as u8))
                    .collect();
                let expected = expected(&before, &frame);
                prop_assert_eq!(reported.len(), expected.len());
                prop_assert_eq!(reported.into_iter().collect::<BTreeSet<_>>(), expected);
                let now: BTreeMap<_, _> =
                    history.raised().map(|(robot, alarm, since)| ((robot, alarm), since)).collect();
                prop_assert_eq!(&now, &raised);
                before = frame;
            }
            prop_assert_eq!(history.ticks_missed(), 0);
        }
    }

    #[test]
    fn an_acknowledgement_is_of_one_raise_and_ends_with_it() {
        let (mut history, mut reported) = (AlarmHistory::default(), Vec::new());
        let ann = Acknowledgement::new(7, Alarm::NoData, 3, "ann").unwrap();
        let bob = Acknowledgement::new(7, Alarm::NoData, 9, "bob").unwrap();
        let other = Acknowledgement::new(8, Alarm::NoData, 3, "ann").unwrap();
        let (on, off) = ([row((&7, &1))], [row((&7, &0))]);
        let steps: [(&[Diagnostic], &[Acknowledgement], &[&str]); 8] = [
            // A reader that comes later finds both, in either order.
            (&off, &[ann, other], &[]),
            (&on, &[ann, other], &["raised -", "acknowledged ann"]),
            (&on, &[ann], &[]),
            (&off, &[ann], &["cleared ann"]),
            // Returned before the worker noticed.
            (&on, &[ann], &["raised -"]),
            (&on, &[], &[]),
            (&on, &[bob], &["acknowledged bob"]),
            (&[], &[bob], &["left bob"]),
        ];
        for (tick, (robots, listed, expected)) in (1..).zip(steps) {
            let header = header(1, tick);
            history.take(&header, robots, tick, |change| reported.push(change));
            let header = AcknowledgementHeader { number: tick, ..AcknowledgementHeader::default() };
            history.acknowledge(&header, listed, tick, |change| reported.push(change));
            let shown = reported.drain(..).map(|change: AlarmChange| {
                let by = change.acknowledged.map(|row| row.by().to_owned());
                format!("{} {}", change.change.name(), by.as_deref().unwrap_or("-"))
            });
            assert_eq!(shown.collect::<Vec<_>>(), expected, "{tick}");
            let now = history.acknowledged(7, Alarm::NoData);
            let is_acknowledged = [2, 3, 7].contains(&tick);
            assert_eq!(now.is_some(), is_acknowledged, "{tick}");
        }
        // An earlier frame is passed over.
        history.acknowledge(&AcknowledgementHeader::default(), &[ann], 9, |_| unreachable!());
    }

    #[test]
    fn missed_ticks_are_counted_within_a_run_and_earlier_frames_passed_over() {
        let mut history = AlarmHistory::default();
        let rows = [row((&3, &1))];
        let mut changes = 0;
        for (epoch, tick) in [(5, 10), (5, 11), (5, 15), (5, 12), (4, 99), (6, 0), (6, 2)] {
            history.take(&header(epoch, tick), &rows, tick, |_| changes += 1);
        }
        assert_eq!((history.ticks(), history.ticks_missed()), (5, 4));
        assert_eq!(changes, 1);
    }
}
