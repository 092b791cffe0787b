//! Outputs of a worker in each tick, and their recomputation.

use std::fmt;

use joulebus_fleet::Fleet;
use joulebus_wire::{
    BudgetHeader, Budgets, Channel, DiagnosticHeader, Diagnostics, ForecastHeader, Forecasts,
    OutlookHeader, Outlooks, PlanStateHeader, PlanStates, TickHeader, tick_flag,
};

use crate::compare::{self, FieldDifference, Value};
use joulebus_capture_format::{Message, MessageKind};

/// A tick that was computed again.
#[derive(Debug, Clone, Copy)]
pub struct RecomputedTick<'a> {
    /// The fleet after it.
    pub fleet: &'a Fleet,
    /// Its journal.
    pub journal: &'a TickHeader,
    /// The fields about the intake in the header of its forecasts. The others are 0.
    pub intake: &'a ForecastHeader,
}

/// Takes a difference: what is compared, and the robot, if it concerns one.
pub(super) type Differs<'a> = &'a mut dyn FnMut(&str, Option<u32>, FieldDifference);

type Compare = dyn Fn(RecomputedTick<'_>, &Message, Differs<'_>) + Send + Sync;

/// A channel whose frames are computed again, each of one row for each robot.
pub struct Output {
    pub(super) kind: MessageKind,
    /// True if a tick with this journal sends a frame.
    pub(super) is_sent: fn(&TickHeader) -> bool,
    compare: Box<Compare>,
}

impl fmt::Debug for Output {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Output").field("kind", &self.kind).finish_non_exhaustive()
    }
}

impl Output {
    /// A channel that is sent in each tick. `header` computes a header, of which the `fields` are
    /// compared, and `row` the row at a place, of which all fields are.
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
        Self { kind: MessageKind::of::<C>(), is_sent: |_| true, compare: Box::new(compare) }
    }

    /// All outputs of a worker.
    pub(super) fn all() -> Vec<Self> {
        let forecasts = Self::of::<Forecasts>(
            &[
                "model_hash",
                "capacity",
                "frames_taken",
                "first_intended_ns",
                "first_sent_ns",
                "first_taken_ns",
                "compute_start_ns",
                "samples_accepted",
                "samples_dropped",
            ],
            |tick| *tick.intake,
            |tick, place| tick.fleet.forecast(place),
        );
        let diagnostics = Self::of::<Diagnostics>(
            &["refused"],
            |tick| DiagnosticHeader {
                refused: tick.fleet.refusals(),
                ..DiagnosticHeader::default()
            },
            |tick, place| tick.fleet.diagnostic(place),
        );
        let budgets = Self::of::<Budgets>(
            &[],
            |_| BudgetHeader::default(),
            |tick, place| tick.fleet.budget(place),
        );
        let plan_states = Self::of::<PlanStates>(
            &["settings_hash", "model_hash", "models", "compute_start_ns"],
            |tick| PlanStateHeader {
                settings_hash: tick.fleet.settings_hash(),
                model_hash: tick.fleet.model_hash(),
                models: tick.fleet.model_hashes(),
                compute_start_ns: tick.journal.start_ns,
                ..PlanStateHeader::default()
            },
            |tick, place| tick.fleet.plan_state(place),
        );
        let outlooks = Self::of::<Outlooks>(
            &["model_hash", "compute_start_ns"],
            |tick| OutlookHeader {
                model_hash: tick.fleet.model_hash(),
                compute_start_ns: tick.journal.start_ns,
                ..OutlookHeader::default()
            },
            |tick, place| tick.fleet.outlook(place),
        );
        vec![
            forecasts,
            // Under overload the worker omits them, and reports so.
            Self {
                is_sent: |journal| journal.flags & tick_flag::NO_DIAGNOSTICS == 0,
                ..diagnostics
            },
            budgets,
            // The worker writes these while somebody reads them, and reports so.
            Self { is_sent: |journal| journal.flags & tick_flag::PLAN_STATES != 0, ..plan_states },
            Self { is_sent: |journal| journal.flags & tick_flag::OUTLOOKS != 0, ..outlooks },
        ]
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
