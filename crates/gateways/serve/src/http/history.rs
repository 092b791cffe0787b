//! The last two minutes of each robot.

use std::collections::HashMap;

use joulebus_board::{Board, Row};
use joulebus_wire::budget_flag;
use serde::Serialize;

/// Time between points, ns.
pub(super) const STEP_NS: u64 = 500_000_000;
/// Points of a robot: two minutes.
const POINTS: usize = 240;

/// A point in time. NaN where unknown.
#[derive(Debug, Clone, Copy)]
struct Point {
    reading_w: f32,
    power_w: f32,
    lo_w: f32,
    hi_w: f32,
    residual_w: f32,
    soc: f32,
}

const UNKNOWN: Point = Point {
    reading_w: f32::NAN,
    power_w: f32::NAN,
    lo_w: f32::NAN,
    hi_w: f32::NAN,
    residual_w: f32::NAN,
    soc: f32::NAN,
};

#[derive(Debug)]
struct Track {
    points: Box<[Point; POINTS]>,
    /// Steps at which it was first and last in the fleet.
    first: u64,
    last: u64,
}

/// A ring of points for each robot. All robots have their points at the same times.
#[derive(Debug, Default)]
pub(super) struct History {
    tracks: HashMap<u32, Track>,
    steps: u64,
    end_unix_ns: u64,
}

/// A robot's points, oldest first.
#[derive(Debug, Serialize)]
pub(super) struct HistoryRecord {
    robot: u32,
    step_s: f64,
    /// Time of the last point.
    end_unix_ns: u64,
    reading_w: Vec<Option<f32>>,
    /// The forecast that was made for the reading.
    power_w: Vec<Option<f32>>,
    lo_w: Vec<Option<f32>>,
    hi_w: Vec<Option<f32>>,
    residual_w: Vec<Option<f32>>,
    soc: Vec<Option<f32>>,
}

impl History {
    /// Adds a point of every robot on the board.
    pub(super) fn add(&mut self, board: &Board, now_unix_ns: u64) {
        let step = self.steps;
        let place = (step % POINTS as u64) as usize;
        for (robot, row) in &board.rows {
            let track = self.tracks.entry(*robot).or_insert_with(|| Track {
                points: Box::new([UNKNOWN; POINTS]),
                first: step,
                last: step,
            });
            track.points[place] = Point::new(row);
            track.last = step;
        }
        if self.tracks.len() > board.rows.len() {
            self.tracks.retain(|_, track| {
                if track.last < step {
                    track.points[place] = UNKNOWN;
                }
                step - track.last < POINTS as u64
            });
        }
        self.steps += 1;
        self.end_unix_ns = now_unix_ns;
    }

    /// The points of `robot`. `None` if it has not been in the fleet for two minutes.
    pub(super) fn of(&self, robot: u32) -> Option<HistoryRecord> {
        let track = self.tracks.get(&robot)?;
        let first = track.first.max(self.steps.saturating_sub(POINTS as u64));
        let column = |value: fn(&Point) -> f32| -> Vec<Option<f32>> {
            let points = (first..self.steps).map(|step| &track.points[step as usize % POINTS]);
            points.map(|point| Some(value(point)).filter(|value| value.is_finite())).collect()
        };
        Some(HistoryRecord {
            robot,
            step_s: STEP_NS as f64 * 1e-9,
            end_unix_ns: self.end_unix_ns,
            reading_w: column(|point| point.reading_w),
            power_w: column(|point| point.power_w),
            lo_w: column(|point| point.lo_w),
            hi_w: column(|point| point.hi_w),
            residual_w: column(|point| point.residual_w),
            soc: column(|point| point.soc),
        })
    }
}

impl Point {
    fn new(row: &Row) -> Self {
        let battery = row.budget.filter(|budget| budget.flags & budget_flag::BATTERY != 0);
        let soc = battery.map_or(f32::NAN, |budget| budget.soc);
        let Some(point) = row.point else {
            return Self { soc, ..UNKNOWN };
        };
        Self {
            reading_w: point.reading_w,
            power_w: point.forecast_w,
            lo_w: point.interval_w.0,
            hi_w: point.interval_w.1,
            residual_w: row.residual_w.map_or(f32::NAN, |residual_w| residual_w as f32),
            soc,
        }
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{Forecast, ForecastHeader, forecast_flag};

    use super::*;

    fn board(tick: u64, robots: &[u32]) -> Board {
        let mut board = Board::new(0);
        for tick in [tick, tick + 1] {
            let header = ForecastHeader { worker_epoch: 1, tick, ..ForecastHeader::default() };
            let forecasts: Vec<Forecast> = robots
                .iter()
                .map(|robot| Forecast {
                    robot: *robot,
                    flags: forecast_flag::POWER | forecast_flag::READING | forecast_flag::SAMPLE,
                    sample_seq: tick,
                    reading_w: tick as f32,
                    power_w: 0.5,
                    ..Forecast::default()
                })
                .collect();
            board.forecasts(&header, &forecasts, 0);
        }
        board
    }

    #[test]
    fn the_newest_two_minutes_are_kept_oldest_first_with_gaps() {
        let mut history = History::default();
        assert!(history.of(3).is_none());
        for step in 0..POINTS as u64 + 10 {
            let robots: &[u32] = if step == 245 { &[4] } else { &[3, 4] };
            history.add(&board(step, robots), step * STEP_NS);
        }
        let record = history.of(3).expect("it is in the fleet");
        assert_eq!(record.reading_w.len(), POINTS);
        // The reading of step n is n + 1 W.
        assert_eq!((record.reading_w[0], record.reading_w[239]), (Some(11.0), Some(250.0)));
        assert_eq!((record.reading_w[235], record.power_w[234]), (None, Some(0.5)));
        assert_eq!(record.residual_w[239], Some(249.5));
        assert_eq!((record.soc[0], record.lo_w[0]), (None, None));
        assert_eq!(record.end_unix_ns, 249 * STEP_NS);
    }

    #[test]
    fn robots_that_have_left_are_forgotten_and_new_ones_begin_when_they_come() {
        let mut history = History::default();
        history.add(&board(0, &[7]), 0);
        for step in 1..POINTS as u64 {
            history.add(&board(step, &[8]), 0);
        }
        assert_eq!(history.of(8).map(|record| record.soc.len()), Some(239));
        assert!(history.of(7).is_some());
        history.add(&board(0, &[8]), 0);
        assert!(history.of(7).is_none());
    }
}
