//! The alarms that are acknowledged: a bounded table that follows the diagnostics, and its channel.

use joulebus_bus::{Bus, Limits, OpenError, Reader, SendError, Writer, clock, process_id};
use joulebus_plan::Refused;
use joulebus_wire::{
    Acknowledgement, AcknowledgementHeader, Acknowledgements, Diagnostic, Diagnostics,
    MAX_ACKNOWLEDGED, MAX_ACKNOWLEDGED_BY, QueryRefusal, SCHEMA_VERSION,
};

use crate::error::ServerError;

/// Interval at which the table is sent again while it is not empty, ns.
const REPEAT_EVERY_NS: u64 = 1_000_000_000;
/// Interval of reading diagnostics while the table is not empty, ns.
const FOLLOW_EVERY_NS: u64 = 10_000_000;

/// The alarms that are acknowledged, by robot and alarm. Pure: it knows no clock and no port.
#[derive(Debug, Clone, Default)]
pub(crate) struct Table {
    rows: Vec<Acknowledgement>,
    /// Frames in which it was sent.
    frames: u64,
}

impl Table {
    /// Enters an alarm. What a person has acknowledged stays as it is: again by the same is no
    /// change, and another person is entered after the first.
    ///
    /// # Errors
    /// The alarm is not raised, or there is no room.
    fn enter(&mut self, row: Acknowledgement, is_raised: bool) -> Result<(), Refused> {
        let (robot, alarm) = (row.robot, row.alarm().name());
        if !is_raised {
            let text =
                format!("{alarm} of robot {robot} is not raised: `joulebus watch` shows what is");
            return Err(Refused::new(QueryRefusal::NotRaised, text));
        }
        let place = |row: &Acknowledgement| (row.robot, row.alarm);
        let first = self.rows.partition_point(|known| place(known) < place(&row));
        let end = self.rows.partition_point(|known| place(known) <= place(&row));
        let of_it = &self.rows[first..end];
        if of_it.iter().any(|known| known.by == row.by) {
            return Ok(());
        }
        let full = if of_it.len() >= MAX_ACKNOWLEDGED_BY {
            let by: Vec<_> = of_it.iter().map(Acknowledgement::by).collect();
            format!(
                "{alarm} of robot {robot} is acknowledged by {}: no more are kept",
                by.join(", ")
            )
        } else if self.rows.len() >= MAX_ACKNOWLEDGED {
            format!(
                "all {MAX_ACKNOWLEDGED} acknowledgements are taken, one for each person and alarm: no more are \
                 kept until some alarms end"
            )
        } else {
            self.rows.insert(end, row);
            return Ok(());
        };
        Err(Refused::new(QueryRefusal::Busy, full))
    }

    /// Drops the alarms that have ended as of these diagnostics, and those of robots that have
    /// left. Returns whether there were any.
    fn follow(&mut self, robots: &[Diagnostic]) -> bool {
        let mut raised = [false; MAX_ACKNOWLEDGED];
        for robot in robots.iter().filter(|robot| robot.alarms != 0) {
            let first = self.rows.partition_point(|row| row.robot < robot.robot);
            let rows = self.rows[first..].iter().zip(&mut raised[first..]);
            for (row, raised) in rows.take_while(|(row, _)| row.robot == robot.robot) {
                *raised = robot.alarms().has(row.alarm());
            }
        }
        let (before, mut raised) = (self.rows.len(), raised.into_iter());
        self.rows.retain(|_| raised.next() == Some(true));
        self.rows.len() < before
    }
}

/// The table and its ports.
#[derive(Debug)]
pub(crate) struct Acknowledged {
    table: Table,
    writer: Writer<Acknowledgements>,
    /// Only while alarms are acknowledged, or are to be: a reader costs the tick a little.
    diagnostics: Option<Reader<Diagnostics>>,
    begun_ns: u64,
    /// When the table is sent next, monotonic ns.
    due_ns: u64,
}

impl Acknowledged {
    /// Opens the port for a table from before any loss of ports. `begun_ns` is when the thread
    /// began.
    pub(crate) fn open(
        bus: &Bus,
        limits: &Limits,
        begun_ns: u64,
        table: Table,
    ) -> Result<Self, OpenError> {
        Ok(Self { table, writer: bus.writer(limits)?, diagnostics: None, begun_ns, due_ns: 0 })
    }

    pub(crate) fn table(&self) -> Table {
        self.table.clone()
    }

    /// Takes the diagnostics that have arrived. Returns, if there are any, which of the alarms
    /// `asked` about are raised.
    pub(crate) fn look(
        &mut self,
        (bus, limits): (&Bus, &Limits),
        asked: &[Acknowledgement],
    ) -> Result<Option<Vec<bool>>, ServerError> {
        if asked.is_empty() && self.table.rows.is_empty() {
            self.diagnostics = None;
            return Ok(None);
        }
        let reader = match &mut self.diagnostics {
            Some(reader) => reader,
            none => none.insert(bus.reader(limits)?),
        };
        let (table, mut raised, mut has_changed) = (&mut self.table, None, false);
        reader.take_all(|header, robots| {
            if header.schema == SCHEMA_VERSION {
                has_changed |= table.follow(robots);
                raised = Some(asked.iter().map(|row| is_raised(row, robots)).collect());
            }
        })?;
        if has_changed {
            self.due_ns = 0;
        }
        Ok(raised)
    }

    /// Acknowledges an alarm, of which the newest diagnostics state whether it is raised. One that
    /// was entered before only has to be raised still.
    pub(crate) fn enter(&mut self, row: Acknowledgement, is_raised: bool) -> Result<(), Refused> {
        let before = self.table.rows.len();
        self.table.enter(row, is_raised)?;
        if self.table.rows.len() > before {
            self.due_ns = 0;
        }
        Ok(())
    }

    /// Sends the table if it has changed or is due. Returns when there is something to do next,
    /// monotonic ns.
    pub(crate) fn flush(&mut self) -> Result<u64, SendError> {
        let now_ns = clock::monotonic_ns();
        let rows = &self.table.rows;
        if now_ns < self.due_ns {
            // A reader that has joined gets the newest frame.
            self.writer.update();
        } else {
            let header = AcknowledgementHeader {
                schema: SCHEMA_VERSION,
                pid: process_id(),
                server_epoch: self.begun_ns,
                number: self.table.frames + 1,
                sent_ns: now_ns,
                sent_unix_ns: clock::unix_ns(),
            };
            self.writer.send(header, rows.len(), |place| rows[place])?;
            self.table.frames += 1;
            self.due_ns = match rows.is_empty() {
                true => u64::MAX,
                false => now_ns.saturating_add(REPEAT_EVERY_NS),
            };
        }
        let follow_ns = now_ns.saturating_add(FOLLOW_EVERY_NS);
        Ok(if rows.is_empty() { self.due_ns } else { follow_ns })
    }
}

fn is_raised(row: &Acknowledgement, robots: &[Diagnostic]) -> bool {
    let mut robots = robots.iter();
    let robot = robots.find(|robot| robot.robot == row.robot);
    robot.is_some_and(|robot| robot.alarms().has(row.alarm()))
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{Alarm, AlarmSet};

    use super::*;

    fn row(robot: u32, alarm: Alarm, by: &str) -> Acknowledgement {
        Acknowledgement::new(robot, alarm, 5, by).unwrap()
    }

    fn robot(robot: u32, alarms: &[Alarm]) -> Diagnostic {
        let with = |set: AlarmSet, alarm: &Alarm| set.with(*alarm);
        Diagnostic {
            robot,
            alarms: alarms.iter().fold(AlarmSet::default(), with).0,
            ..Diagnostic::default()
        }
    }

    fn held(table: &Table) -> Vec<(u32, Alarm, &str)> {
        let row = |row: &'_ Acknowledgement| (row.robot, row.alarm());
        let by = table.rows.iter().map(Acknowledgement::by);
        let rows = table.rows.iter().map(row).zip(by);
        rows.map(|((robot, alarm), by)| (robot, alarm, by)).collect()
    }

    #[test]
    fn an_alarm_is_acknowledged_from_when_it_is_raised_until_it_ends() {
        use Alarm::{BiasHigh, NoData, StuckSensor};
        let mut table = Table::default();
        let enter = |table: &mut Table, row, is_raised| {
            table.enter(row, is_raised).map_err(|refused| refused.reason)
        };
        let refused = enter(&mut table, row(7, BiasHigh, "ann"), false);
        assert_eq!(refused, Err(QueryRefusal::NotRaised));
        for (id, alarm, by) in [(9, NoData, "ann"), (7, BiasHigh, "ann"), (7, StuckSensor, "bob")] {
            assert_eq!(enter(&mut table, row(id, alarm, by), true), Ok(()));
        }
        // Another person does not replace the first, and the same one again changes nothing.
        for by in ["eve", "ann", "eve"] {
            let later = Acknowledgement { at_ns: 9, ..row(9, NoData, by) };
            assert_eq!(enter(&mut table, later, true), Ok(()));
        }
        assert_eq!((table.rows[2].at_ns, table.rows[3].at_ns), (5, 9));
        let nine_by = [(9, NoData, "ann"), (9, NoData, "eve")];
        let all = [&[(7, StuckSensor, "bob"), (7, BiasHigh, "ann")][..], &nine_by].concat();
        assert_eq!(held(&table), all);
        let (seven, nine) = (robot(7, &[BiasHigh, StuckSensor]), robot(9, &[NoData]));
        // In the order of slots, among others.
        assert!(!table.follow(&[nine, robot(3, &[NoData]), robot(1, &[]), seven]));
        assert_eq!(held(&table), all);
        // One ends, one has another alarm instead. Then a robot leaves.
        assert!(table.follow(&[nine, robot(7, &[BiasHigh, NoData])]));
        assert_eq!(held(&table), [&[(7, BiasHigh, "ann")][..], &nine_by].concat());
        assert!(table.follow(&[nine]));
        assert_eq!(held(&table), nine_by);
        assert!(table.follow(&[robot(9, &[])]));
        // It returns, and nobody has acknowledged that.
        assert!(!table.follow(&[nine]));
        assert_eq!(held(&table), []);
    }

    #[test]
    fn the_table_is_bounded_by_alarms_and_by_persons() {
        let mut table = Table::default();
        for (person, taken) in
            ["ann", "bob", "eve", "zoe", "dan"].into_iter().zip([true, true, true, true, false])
        {
            let entered = table.enter(row(7, Alarm::NoData, person), true);
            assert_eq!(entered.is_ok(), taken, "{person}");
        }
        let mut table = Table::default();
        for id in 0..MAX_ACKNOWLEDGED as u32 {
            assert_eq!(table.enter(row(id, Alarm::NoData, "ann"), true), Ok(()));
        }
        let refused = table.enter(row(999, Alarm::NoData, "ann"), true);
        assert_eq!(refused.map_err(|refused| refused.reason), Err(QueryRefusal::Busy));
        assert_eq!(table.enter(row(5, Alarm::NoData, "ann"), true), Ok(()));
        let all: Vec<Diagnostic> = (0..2_000).map(|id| robot(id, &[Alarm::NoData])).collect();
        assert!(!table.follow(&all));
        assert!(table.follow(&all[..64]));
        assert_eq!(table.rows.len(), 64);
    }
}
