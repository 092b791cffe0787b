//! Diagnostics and budgets.

use std::cell::RefCell;
use std::fmt;

use joulebus_bus::Reader;
use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Payload, PlanState, PlanStateHeader,
    QueriesHeader,
};

use crate::index::RobotIndex;
use crate::newest::{ReadError, check_schema, newer};
use crate::tracker::Place;
use crate::{Arrival, Frame};

/// Frames that the worker sends in addition to its forecasts, robot by robot. Belongs to the thread
/// of its planner, and may outlive it.
pub struct Feed<H: Payload, T: Payload> {
    reader: Reader<H, T>,
    /// Schema, run of the worker and tick of a frame.
    of_header: fn(&H) -> (u32, u64, u64),
    id: fn(&T) -> u32,
    place: Option<Place>,
    frames: u64,
    index: RefCell<RobotIndex>,
}

/// Diagnostics, robot by robot.
pub type DiagnosticFeed = Feed<DiagnosticHeader, Diagnostic>;
/// Budgets, robot by robot.
pub type BudgetFeed = Feed<BudgetHeader, Budget>;
/// What plans start from, robot by robot.
pub type PlanStateFeed = Feed<PlanStateHeader, PlanState>;

/// Questions about plans and their answers: words of 8 bytes ([`joulebus_wire::records`]), and counts.
pub type QueryFeed = Feed<QueriesHeader, u64>;

impl<H: Payload, T: Payload> Feed<H, T> {
    pub(crate) fn new(
        reader: Reader<H, T>,
        of_header: fn(&H) -> (u32, u64, u64),
        id: fn(&T) -> u32,
    ) -> Self {
        Self {
            reader,
            of_header,
            id,
            place: None,
            frames: 0,
            index: RefCell::default(),
        }
    }

    /// The newest frame, whether or not it was returned before: its header has the tick. `None`
    /// until the first has arrived. Borrowed until the next call.
    ///
    /// # Errors
    /// [`ReadError`]; the next call may succeed.
    pub fn latest(&mut self) -> Result<Option<Frame<'_, H, T>>, ReadError> {
        let (mut place, mut foreign) = (self.place, None);
        let found = self.reader.hold_latest(|header, _, run| {
            let (schema, epoch, tick) = (self.of_header)(header);
            newer(schema, (run, epoch, tick), &mut place, &mut foreign)
        })?;
        check_schema(found, foreign)?;
        self.place = place;
        self.frames += u64::from(found);
        let held = self.reader.held();
        let frame = |held| Frame::new(held, self.frames, self.id, &self.index, Arrival::default());
        Ok(held.map(frame))
    }
}

impl<H: Payload, T: Payload> fmt::Debug for Feed<H, T> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Feed")
            .field("frames", &self.frames)
            .field("place", &self.place)
            .finish_non_exhaustive()
    }
}
