//! Outputs of a worker in each tick, and their recomputation.

use std::fmt;

use joulebus_fleet::{Fleet, ForEachOutput, Output as TickOutput, each_output};
use joulebus_wire::{Channel, ForecastHeader, FrameHeader as _, TICK_RULES, TickHeader};

use crate::compare::{self, FieldDifference, Value};
use joulebus_capture_format::{Message, MessageKind};

/// The first [`TICK_RULES`] by which a channel has the bits that this version computes. Captures of
/// older rules are compared in the channels whose number is not greater than theirs.
const SAME_BITS_SINCE: [(&str, u32); 6] = [
    ("forecasts", 9),
    ("diagnostics", 11),
    ("budgets", 11),
    ("plan_states", 11),
    ("outlooks", 11),
    ("state", 11),
];

/// True if a channel has the same bits by `tick_rules` as by this version's.
pub(super) fn has_same_bits(channel: &str, tick_rules: u32) -> bool {
    let since = SAME_BITS_SINCE.iter().find(|(name, _)| *name == channel);
    (since.map_or(TICK_RULES, |(_, since)| *since)..=TICK_RULES).contains(&tick_rules)
}

/// True if a capture whose ticks were computed by `tick_rules` has channels that this version
/// computes to the same bits.
#[must_use]
pub fn is_comparable(tick_rules: u32) -> bool {
    SAME_BITS_SINCE.iter().any(|(channel, _)| has_same_bits(channel, tick_rules))
}

/// A tick that was computed again.
#[derive(Debug, Clone, Copy)]
pub struct RecomputedTick<'a> {
    /// The fleet after it.
    pub fleet: &'a Fleet,
    /// Its journal.
    pub journal: &'a TickHeader,
    /// The fields about the intake in the header of its forecasts. The others are 0.
    pub intake: &'a ForecastHeader,
    /// The period of the worker's ticks, ns, if it is known.
    pub period_ns: Option<u64>,
}

/// Takes a difference: what is compared, and the robot, if it concerns one.
pub(super) type Differs<'a> = &'a mut dyn FnMut(&str, Option<u32>, FieldDifference);

type Compare = dyn Fn(RecomputedTick<'_>, &Message, Differs<'_>) + Send + Sync;

/// A channel whose frames are computed again, each of one row for each robot.
pub struct Output {
    pub(super) kind: MessageKind,
    /// True if its bits depend on the rules of ticks alone.
    pub(super) is_ours: bool,
    compare: Box<Compare>,
}

impl fmt::Debug for Output {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Output").field("kind", &self.kind).finish_non_exhaustive()
    }
}

impl Output {
    /// A channel whose frames are [sent in ticks](MessageKind::is_of_tick). `header` computes a
    /// header, of which the `fields` are compared, and the period if it states one. `row` computes
    /// the row at a place, of which all fields are compared.
    #[must_use]
    pub fn of<C: Channel>(
        fields: &'static [&'static str],
        header: impl Fn(RecomputedTick<'_>) -> C::Header + Send + Sync + 'static,
        row: impl Fn(RecomputedTick<'_>, usize) -> C::Row + Send + Sync + 'static,
    ) -> Self {
        let compare = move |tick: RecomputedTick<'_>, message: &Message, differs: Differs<'_>| {
            let Some(recorded) = message.frame::<C>() else {
                return;
            };
            let (frame, robots) = (C::SERVICE.name(), tick.fleet.len());
            let mut in_header = |robot, difference| differs(frame, robot, difference);
            compare::fields(&recorded.header, &header(tick), Some(fields), &mut in_header);
            let mut stated = recorded.header;
            if let (Some(found), Some(expected)) = (stated.period_ns(), tick.period_ns)
                && *found != expected
            {
                differs(frame, None, ("period_ns", (*found).into(), expected.into()));
            }
            if recorded.rows.len() != robots {
                let lengths = (recorded.rows.len() as u64, robots as u64);
                let difference = ("robots", Value::from(lengths.0), Value::from(lengths.1));
                differs(frame, None, difference);
            }
            for (place, recorded) in recorded.rows.iter().enumerate().take(robots) {
                let computed = row(tick, place);
                compare::fields(recorded, &computed, None, &mut |_, difference| {
                    let of = MessageKind::of_robot::<C>().message_name();
                    differs(&of, C::robot(&computed), difference);
                });
            }
        };
        Self { kind: MessageKind::of::<C>(), is_ours: false, compare: Box::new(compare) }
    }

    /// All outputs of a worker.
    pub(super) fn all() -> Vec<Self> {
        struct All(Vec<Output>);
        impl ForEachOutput for All {
            fn output<O: TickOutput>(&mut self) {
                let output = Output::of::<O>(
                    O::COMPUTED,
                    |tick| O::header(tick.fleet, tick.intake),
                    |tick, place| O::row(tick.fleet, place),
                );
                self.0.push(Output { is_ours: true, ..output });
            }
        }
        let mut all = All(Vec::new());
        each_output(&mut all);
        all.0
    }

    pub(super) fn compare(
        &self,
        tick: RecomputedTick<'_>,
        recorded: &Message,
        differs: Differs<'_>,
    ) {
        (self.compare)(tick, recorded, differs);
    }
}
