//! Windows of a block of robots.

use joulebus_predictor::ReadingAge;
use serde::{Deserialize, Deserializer, Serialize};

use super::{LagLanes, Lags, Window};
use crate::layout::lanes::{Block, LANES, Lanes, put};
use crate::layout::versions::{NARROW, before};

/// The windows of a block.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[repr(align(64))]
pub(crate) struct WindowLanes {
    pub closed: ClosedLanes,
    open: LagLanes,
}

const _: () = assert!(size_of::<WindowLanes>() == 56 * LANES);

/// The windows without their open-loop part.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[repr(align(64))]
pub(crate) struct ClosedLanes {
    closed: LagLanes,
    #[serde(deserialize_with = "read_after_commands")]
    open_steps: Lanes<u16>,
    unread_steps: Lanes<u16>,
    have: Lanes<u8>,
    commanded: Lanes<bool>,
    reading_age: [Lanes<u8>; 2],
}

/// Reads the column behind that of the commands, which windows had before 0x13: the energy states
/// have the same.
fn read_after_commands<'de, D>(from: D) -> Result<Lanes<u16>, D::Error>
where
    D: Deserializer<'de>,
{
    before(NARROW, from, |(_, steps): ([Lanes<f32>; 2], Lanes<u16>)| steps)
}

impl ClosedLanes {
    /// A window without open-loop steps.
    #[inline(always)]
    pub(crate) fn get(&self, lane: usize) -> Window {
        let [age, interval] = &self.reading_age;
        Window {
            closed: self.closed.get(lane),
            open: Lags::EMPTY,
            open_steps: self.open_steps[lane],
            unread_steps: self.unread_steps[lane],
            have: self.have[lane],
            commanded: self.commanded[lane],
            reading_age: ReadingAge::from_bytes([age[lane], interval[lane]]),
        }
    }

    #[inline(always)]
    pub(crate) fn put(&mut self, lane: usize, mask: bool, robot: &Window) {
        self.closed.set(lane, mask, robot.closed);
        put(&mut self.open_steps[lane], mask, robot.open_steps);
        put(&mut self.unread_steps[lane], mask, robot.unread_steps);
        put(&mut self.have[lane], mask, robot.have);
        put(&mut self.commanded[lane], mask, robot.commanded);
        let [age, interval] = robot.reading_age.to_bytes();
        put(&mut self.reading_age[0][lane], mask, age);
        put(&mut self.reading_age[1][lane], mask, interval);
    }
}

impl Block for WindowLanes {
    type Robot = Window;

    #[inline(always)]
    fn get(&self, lane: usize) -> Window {
        Window { open: self.open.get(lane), ..self.closed.get(lane) }
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, mask: bool, robot: Window) {
        self.open.set(lane, mask, robot.open);
        self.closed.put(lane, mask, &robot);
    }
}

impl WindowLanes {
    /// Stores the forecast for the row that [`Window::next_row`] returned, W, where the mask is
    /// set.
    #[inline(always)]
    pub(crate) fn forecast(&mut self, lane: usize, mask: bool, forecast_w: f32) {
        put(&mut self.closed.closed.forecast_w[lane], mask, forecast_w);
    }

    /// The forecast for the row that [`Window::open_towards`] gave.
    pub(crate) fn opened(&mut self, lane: usize, forecast_w: f32) {
        self.open.forecast_w[lane] = forecast_w;
    }

    /// True if a window has open-loop steps.
    #[inline(always)]
    pub(crate) fn is_open(&self, lane: usize) -> bool {
        self.closed.open_steps[lane] > 0
    }

    /// Readings in a window.
    #[inline(always)]
    pub(crate) fn have(&self, lane: usize) -> u8 {
        self.closed.have[lane]
    }

    /// The reading before the newest one, W.
    #[inline(always)]
    pub(crate) fn previous_w(&self, lane: usize) -> f32 {
        self.closed.closed.lag_w[1][lane]
    }
}
