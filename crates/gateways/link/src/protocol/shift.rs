//! Converts times of another host's frames to times of this one.
//!
//! Only instants of the monotonic clock are moved. Durations, Unix times, and the runs of sources
//! and workers, which identify them everywhere, stay.

use joulebus_wire::Row;

use crate::protocol::offset::shifted;

/// Moves all instants of a header or a row. 0 means unknown and stays.
pub(crate) fn shift<R: Row>(part: &mut R, offset_ns: i128) {
    part.instants(|stamp_ns| *stamp_ns = shifted(*stamp_ns, offset_ns));
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{Budget, Forecast};

    use super::*;

    #[test]
    fn distances_between_times_stay_and_what_is_not_known_stays_so() {
        let mut row =
            Budget { stamp_ns: 1_000, valid_until_ns: 1_500, metered_ns: 70, ..Budget::default() };
        shift(&mut row, -400);
        assert_eq!((row.stamp_ns, row.valid_until_ns, row.metered_ns), (600, 1_100, 70));
        let mut nothing = Forecast::default();
        shift(&mut nothing, 5_000);
        assert_eq!(nothing, Forecast::default());
    }
}
