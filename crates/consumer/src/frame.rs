//! Frames for planners.

use std::cell::RefCell;
use std::slice;

use joulebus_bus::{Frame as Borrowed, clock};
use joulebus_wire::{Channel, Forecast, ForecastHeader, Forecasts};

use crate::Arrival;
use crate::index::RobotIndex;

/// A frame in shared memory, borrowed from its reader.
///
/// ```no_run
/// # use joulebus_consumer::Subscriber;
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut subscriber = Subscriber::connect("configs/fleet.toml")?;
/// if let Some(frame) = subscriber.latest()? {
///     let missed = frame.arrival().ticks_missed;
///     println!("tick {}, {} ns old, {missed} missed", frame.header().tick, frame.age_ns());
///     let expected_w = frame.robot(7).and_then(|robot| robot.expected_w());
///     println!("robot 7 will draw {expected_w:?} W");
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a, C: Channel> {
    header: &'a C::Header,
    robots: &'a [C::Row],
    number: u64,
    index: &'a RefCell<RobotIndex>,
    arrival: Arrival,
}

impl<'a, C: Channel> Frame<'a, C> {
    pub(crate) const fn new(
        (header, robots): (&'a C::Header, &'a [C::Row]),
        number: u64,
        index: &'a RefCell<RobotIndex>,
        arrival: Arrival,
    ) -> Self {
        Self { header, robots, number, index, arrival }
    }

    /// The frame's header.
    pub const fn header(&self) -> &'a C::Header {
        self.header
    }

    /// All robots of the frame, in no particular order.
    pub const fn robots(&self) -> &'a [C::Row] {
        self.robots
    }

    /// Iterates over [`Frame::robots`].
    pub fn iter(&self) -> slice::Iter<'a, C::Row> {
        self.robots.iter()
    }

    /// The robot with the id `robot`, if the frame has it. It usually takes one look-up in a table
    /// that is kept from frame to frame. When a robot has moved or is missing, it takes one pass
    /// over the frame, at most once per frame.
    #[must_use]
    pub fn robot(&self, robot: u32) -> Option<&'a C::Row> {
        // Rows of other channels have no robot.
        let id = |position: usize| C::robot(&self.robots[position]).unwrap_or_default();
        // Not borrowed elsewhere: it is borrowed only here, and `id` does not recurse.
        let mut index = self.index.borrow_mut();
        let position = index.position(robot, self.number, self.robots.len(), id)?;
        self.robots.get(position)
    }
}

/// A frame of forecasts that is kept beyond the next call ([`crate::Subscriber::take_current`]).
/// Belongs to the planner's thread, and may outlive the planner: its rows stay as they are until it
/// is dropped. A planner that was dropped before keeps its place among the `max_planners` as long.
///
/// ```no_run
/// # fn example(subscriber: &mut joulebus_consumer::Subscriber) {
/// if let Some(kept) = subscriber.take_current() {
///     println!("{} robots at tick {}", kept.robots().len(), kept.header().tick);
/// }
/// # }
/// ```
#[derive(Debug)]
pub struct KeptForecasts(pub(crate) Borrowed<'static, Forecasts>);

impl KeptForecasts {
    /// The frame's header.
    pub fn header(&self) -> &ForecastHeader {
        self.0.header()
    }

    /// All robots of the frame, in no particular order.
    pub fn robots(&self) -> &[Forecast] {
        self.0.payload()
    }
}

impl<'a, C: Channel> IntoIterator for &Frame<'a, C> {
    type Item = &'a C::Row;
    type IntoIter = slice::Iter<'a, C::Row>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl Frame<'_, Forecasts> {
    /// Ticks missed and restarts between this frame and the previous one.
    pub const fn arrival(&self) -> Arrival {
        self.arrival
    }

    /// Time since the frame was sent, ns, on the monotonic clock.
    pub fn age_ns(&self) -> u64 {
        clock::monotonic_ns().saturating_sub(self.header.sent_ns)
    }
}
