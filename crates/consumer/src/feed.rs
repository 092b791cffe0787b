//! Diagnostics and budgets.

use std::cell::RefCell;
use std::fmt;

use joulebus_bus::Reader;
use joulebus_wire::{Channel, FrameHeader as _};

use crate::index::RobotIndex;
use crate::newest::{ReadError, check_schema, newer};
use crate::tracker::RunOrder;
use crate::{Arrival, Frame};

/// Frames that the worker sends in addition to its forecasts: rows of robots, or for
/// [`joulebus_wire::Queries`] counts and words of 8 bytes ([`joulebus_wire::records`]). Belongs to
/// the thread of its planner, and may outlive it.
///
/// ```no_run
/// # use joulebus_consumer::Subscriber;
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let subscriber = Subscriber::connect("configs/fleet.toml")?;
/// let mut budgets = subscriber.budgets()?;
/// if let Some(frame) = budgets.latest()? {
///     for budget in &frame {
///         println!("robot {} can spend {:.0} J", budget.robot, budget.usable_j);
///     }
/// }
/// # Ok(())
/// # }
/// ```
pub struct Feed<C: Channel> {
    reader: Reader<C>,
    newest_order: Option<RunOrder>,
    frames: u64,
    index: RefCell<RobotIndex>,
}

impl<C: Channel> Feed<C> {
    pub(crate) fn new(reader: Reader<C>) -> Self {
        Self { reader, newest_order: None, frames: 0, index: RefCell::default() }
    }

    /// The newest frame, whether or not it was returned before: its header has the tick. `None`
    /// until the first has arrived. Borrowed until the next call.
    ///
    /// # Errors
    /// [`ReadError`]. The next call may succeed.
    pub fn latest(&mut self) -> Result<Option<Frame<'_, C>>, ReadError> {
        let (mut newest_order, mut foreign) = (self.newest_order, None);
        let found = self.reader.hold_latest(|header, _, run| {
            let at = header.order();
            newer(header.schema(), (run, at.run, at.number), &mut newest_order, &mut foreign)
        })?;
        check_schema(found, foreign)?;
        self.newest_order = newest_order;
        self.frames += u64::from(found);
        let held = self.reader.held();
        let frame = |held| Frame::new(held, self.frames, &self.index, Arrival::default());
        Ok(held.map(frame))
    }
}

impl<C: Channel> fmt::Debug for Feed<C> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Feed")
            .field("frames", &self.frames)
            .field("place", &self.newest_order)
            .finish_non_exhaustive()
    }
}
