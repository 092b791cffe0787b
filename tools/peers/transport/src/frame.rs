//! The frames as bytes, for transports of bytes: headers and records of the same length as in
//! shared memory, stamps at the beginning, the robot's id at the beginning of each record.

use std::mem::size_of;

use joulebus_wire::{Forecast, ForecastHeader, Sample, SampleHeader};

/// Stamps of a frame, monotonic ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamps {
    /// When it was due; 0 ends the measurement.
    pub due_ns: u64,
    /// When it was sent.
    pub sent_ns: u64,
}

/// Bytes of a frame of samples.
pub const fn sample_bytes(robots: usize) -> usize {
    size_of::<SampleHeader>() + robots * size_of::<Sample>()
}

/// Bytes of a frame of forecasts.
pub const fn forecast_bytes(robots: usize) -> usize {
    size_of::<ForecastHeader>() + robots * size_of::<Forecast>()
}

/// Writes a whole frame of samples into `frame`.
pub fn write_samples(frame: &mut [u8], stamps: Stamps) {
    let (header, records) = frame.split_at_mut(size_of::<SampleHeader>());
    write_stamps(header, stamps);
    let mut record = [0x5a; size_of::<Sample>()];
    for (robot, place) in records.chunks_exact_mut(size_of::<Sample>()).enumerate() {
        record[..4].copy_from_slice(&(robot as u32).to_ne_bytes());
        place.copy_from_slice(&record);
    }
}

/// Writes the frame of forecasts in response to a frame of samples.
pub fn write_forecasts(samples: &[u8], forecasts: &mut [u8]) {
    let stamps = stamps(samples);
    let (header, records) = forecasts.split_at_mut(size_of::<ForecastHeader>());
    write_stamps(header, stamps);
    let mut record = [0x5a; size_of::<Forecast>()];
    let robots = samples[size_of::<SampleHeader>()..].chunks_exact(size_of::<Sample>());
    for (sample, place) in robots.zip(records.chunks_exact_mut(size_of::<Forecast>())) {
        record[..4].copy_from_slice(&sample[..4]);
        place.copy_from_slice(&record);
    }
}

/// The stamps of a frame.
pub fn stamps(frame: &[u8]) -> Stamps {
    let word = |place: usize| {
        let mut bytes = [0; 8];
        bytes.copy_from_slice(&frame[place..place + 8]);
        u64::from_ne_bytes(bytes)
    };
    Stamps { due_ns: word(0), sent_ns: word(8) }
}

fn write_stamps(header: &mut [u8], stamps: Stamps) {
    header.fill(0);
    header[..8].copy_from_slice(&stamps.due_ns.to_ne_bytes());
    header[8..16].copy_from_slice(&stamps.sent_ns.to_ne_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_of_forecasts_answers_each_robot_of_its_samples() {
        let stamps_then = Stamps { due_ns: 7, sent_ns: 9 };
        let mut samples = vec![0; sample_bytes(3)];
        write_samples(&mut samples, stamps_then);
        let mut forecasts = vec![0; forecast_bytes(3)];
        write_forecasts(&samples, &mut forecasts);
        assert_eq!(stamps(&forecasts), stamps_then);
        let records = forecasts[size_of::<ForecastHeader>()..].chunks(size_of::<Forecast>());
        let robots: Vec<u8> = records.map(|record| record[0]).collect();
        assert_eq!(robots, [0, 1, 2]);
    }
}
