//! Frames for planners.

use std::cell::RefCell;
use std::slice;

use joulebus_bus::{KeptFrame, clock};
use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, PlanState,
    PlanStateHeader,
};

use crate::Arrival;
use crate::index::RobotIndex;

/// A frame in shared memory, borrowed from its reader.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a, H, T> {
    header: &'a H,
    robots: &'a [T],
    number: u64,
    id: fn(&T) -> u32,
    index: &'a RefCell<RobotIndex>,
    arrival: Arrival,
}

/// A frame of forecasts.
pub type Forecasts<'a> = Frame<'a, ForecastHeader, Forecast>;
/// A frame of diagnostics.
pub type Diagnostics<'a> = Frame<'a, DiagnosticHeader, Diagnostic>;
/// A frame of budgets.
pub type Budgets<'a> = Frame<'a, BudgetHeader, Budget>;
/// A frame of what plans start from.
pub type PlanStates<'a> = Frame<'a, PlanStateHeader, PlanState>;

impl<'a, H, T> Frame<'a, H, T> {
    pub(crate) const fn new(
        (header, robots): (&'a H, &'a [T]),
        number: u64,
        id: fn(&T) -> u32,
        index: &'a RefCell<RobotIndex>,
        arrival: Arrival,
    ) -> Self {
        Self {
            header,
            robots,
            number,
            id,
            index,
            arrival,
        }
    }

    /// The frame's header.
    #[must_use]
    pub const fn header(&self) -> &'a H {
        self.header
    }

    /// All robots of the frame, in no particular order.
    #[must_use]
    pub const fn robots(&self) -> &'a [T] {
        self.robots
    }

    /// Iterates over [`Frame::robots`].
    pub fn iter(&self) -> slice::Iter<'a, T> {
        self.robots.iter()
    }

    /// The robot with the id `robot`, if the frame has it. Usually one look-up in a table that is
    /// kept from frame to frame; when a robot has moved or is missing, one pass over the frame, at
    /// most once per frame.
    #[must_use]
    pub fn robot(&self, robot: u32) -> Option<&'a T> {
        let id = |position: usize| (self.id)(&self.robots[position]);
        // Not borrowed elsewhere: it is borrowed only here, and `id` does not recurse.
        let mut index = self.index.borrow_mut();
        let position = index.position(robot, self.number, self.robots.len(), id)?;
        self.robots.get(position)
    }
}

/// A frame of forecasts that is kept beyond the next call: [`crate::Planner::keep`]. Belongs to the planner's thread,
/// and may outlive the planner.
#[derive(Debug)]
pub struct KeptForecasts(pub(crate) KeptFrame<ForecastHeader, Forecast>);

impl KeptForecasts {
    /// The frame's header.
    #[must_use]
    pub fn header(&self) -> &ForecastHeader {
        self.0.header()
    }

    /// All robots of the frame, in no particular order.
    #[must_use]
    pub fn robots(&self) -> &[Forecast] {
        self.0.payload()
    }
}

impl<'a, H, T> IntoIterator for &Frame<'a, H, T> {
    type Item = &'a T;
    type IntoIter = slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl Forecasts<'_> {
    /// Ticks missed and restarts between this frame and the previous one.
    #[must_use]
    pub const fn arrival(&self) -> Arrival {
        self.arrival
    }

    /// Time since the frame was sent, ns, on the monotonic clock.
    #[must_use]
    pub fn age_ns(&self) -> u64 {
        clock::monotonic_ns().saturating_sub(self.header.sent_ns)
    }
}
