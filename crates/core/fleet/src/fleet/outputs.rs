//! The outputs of a tick as a table. The worker sends them, and the verification of captures
//! computes them again.

use joulebus_wire::{Channel, Forecast, ForecastHeader, Forecasts};

use crate::fleet::Fleet;
use crate::tick::outputs::secondary_outputs;

/// A channel to which a tick sends a frame with a row for each robot.
pub trait Output: Channel {
    /// The fields of a header that samples and settings determine. The others are those of a
    /// process, and of the times at which it sends.
    const COMPUTED: &'static [&'static str];

    /// The header of its frame beside this one of the forecasts, without the times of sending.
    fn header(fleet: &Fleet, forecasts: &ForecastHeader) -> Self::Header;

    /// Its row of the robot at `place` (0 to [`Fleet::len`] − 1), as of the last tick. A
    /// [`crate::Shard`] writes those of all robots faster.
    fn row(fleet: &Fleet, place: usize) -> Self::Row;
}

/// Is called with each output by [`each_output`].
pub trait ForEachOutput {
    /// Takes an output.
    fn output<O: Output>(&mut self);
}

impl Output for Forecasts {
    const COMPUTED: &'static [&'static str] = &[
        "model_hash",
        "capacity",
        "frames_taken",
        "first_intended_ns",
        "first_sent_ns",
        "first_taken_ns",
        "compute_start_ns",
        "samples_accepted",
        "samples_dropped",
    ];

    fn header(_: &Fleet, forecasts: &ForecastHeader) -> ForecastHeader {
        *forecasts
    }

    fn row(fleet: &Fleet, place: usize) -> Forecast {
        fleet.forecast(place)
    }
}

macro_rules! declare {
    ($($(#[doc = $doc:literal])* $rows:ident: $channel:ident, $row:ident, $get:ident,
        $computed:expr, |$fleet:ident, $forecasts:ident| $header:ident { $($fields:tt)* };)*
    ) => {
        $(impl Output for joulebus_wire::$channel {
            const COMPUTED: &'static [&'static str] = &$computed;

            fn header($fleet: &Fleet, $forecasts: &ForecastHeader) -> joulebus_wire::$header {
                use joulebus_wire::$header;
                let ForecastHeader { schema, pid, worker_epoch, tick, .. } = *$forecasts;
                $header { schema, pid, worker_epoch, tick, $($fields)* }
            }

            fn row(fleet: &Fleet, place: usize) -> joulebus_wire::$row {
                fleet.$get(place)
            }
        })*

        /// Calls `each` with all outputs, the forecasts first.
        pub fn each_output(each: &mut impl ForEachOutput) {
            each.output::<Forecasts>();
            $(each.output::<joulebus_wire::$channel>();)*
        }
    };
}

secondary_outputs!(declare);
