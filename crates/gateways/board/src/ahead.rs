//! Accuracy of the outlooks: shadow forecasts that are compared with the metered energy.
//!
//! One shadow forecast is open at a time for each robot and horizon. It is made from the robot's
//! outlook, from its last reading, and from its mean power over 5 s. As soon as the ledger has
//! metered the horizon without a gap, the energy that was drawn is known to the µJ.

use std::collections::{HashMap, VecDeque};

use joulebus_wire::{
    Budget, Forecast, OUTLOOK_HORIZONS, OUTLOOK_S, Outlook, budget_flag, forecast_flag,
};
use serde::Serialize;

use crate::scores::known;

/// Time of the plain mean, ns.
const MEAN_NS: u64 = 5_000_000_000;
/// Interval of the points that it is computed from, ns.
const POINT_NS: u64 = 250_000_000;
/// Share of errors outside the interval.
const MISSES: f64 = 0.1;

/// The ledger of a robot at one time.
#[derive(Debug, Clone, Copy)]
struct Metered {
    drawn_uj: i64,
    metered_ns: u64,
    unmetered_ns: u64,
}

impl Metered {
    const fn new(budget: &Budget) -> Self {
        Self {
            drawn_uj: budget.drawn_uj,
            metered_ns: budget.metered_ns,
            unmetered_ns: budget.unmetered_ns,
        }
    }

    /// Time and energy since an earlier ledger, s and J. `None` if time is missing between the two.
    fn since(&self, earlier: &Self) -> Option<(f64, f64)> {
        let metered_ns = self.metered_ns.checked_sub(earlier.metered_ns)?;
        let drawn_uj = self.drawn_uj.checked_sub(earlier.drawn_uj)?;
        let whole = self.unmetered_ns == earlier.unmetered_ns;
        whole.then_some((metered_ns as f64 * 1e-9, drawn_uj as f64 * 1e-6))
    }
}

/// An open forecast, W over the horizon.
#[derive(Debug, Clone, Copy)]
struct Shadow {
    from: Metered,
    outlook_w: f64,
    bounds_w: Option<(f64, f64)>,
    last_w: f64,
    mean_w: f64,
}

/// A robot's open forecasts, and its ledger over the last seconds, oldest first.
#[derive(Debug, Clone, Default)]
struct Robot {
    shadows: [Option<Shadow>; OUTLOOK_HORIZONS],
    points: VecDeque<Metered>,
}

impl Robot {
    /// The mean power over the last 5 s, or since the beginning, W.
    fn mean_w(&mut self, now: Metered) -> Option<f64> {
        let newest = self.points.back().map(|point| now.since(point));
        match newest {
            Some(None) => self.points.clear(),
            Some(Some((seconds, _))) if seconds * 1e9 < POINT_NS as f64 => {}
            _ => self.points.push_back(now),
        }
        let long_ago = |point: &Metered| now.metered_ns.saturating_sub(point.metered_ns) >= MEAN_NS;
        while self.points.get(1).is_some_and(long_ago) {
            self.points.pop_front();
        }
        let (seconds, joules) = now.since(self.points.front()?)?;
        (seconds > 0.0).then(|| joules / seconds)
    }
}

/// Sums of a horizon, J.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    compared: u64,
    bounded: u64,
    inside: u64,
    measured_j: f64,
    error_j: f64,
    last_error_j: f64,
    mean_error_j: f64,
    bounded_j: f64,
    width_j: f64,
    interval_score_j: f64,
}

impl Sums {
    fn add(&mut self, shadow: &Shadow, (seconds, joules): (f64, f64)) {
        let error_j = |watts: f64| (watts * seconds - joules).abs();
        self.compared += 1;
        self.measured_j += joules.abs();
        self.error_j += error_j(shadow.outlook_w);
        self.last_error_j += error_j(shadow.last_w);
        self.mean_error_j += error_j(shadow.mean_w);
        let Some((lo_w, hi_w)) = shadow.bounds_w else {
            return;
        };
        let (lo_j, hi_j) = (lo_w * seconds, hi_w * seconds);
        let beyond_j = (lo_j - joules).max(joules - hi_j).max(0.0);
        self.bounded += 1;
        self.inside += u64::from(beyond_j == 0.0);
        self.bounded_j += joules.abs();
        self.width_j += hi_j - lo_j;
        self.interval_score_j += hi_j - lo_j + 2.0 / MISSES * beyond_j;
    }

    fn scores(&self, horizon_s: f32) -> AheadScores {
        let of = |joules: f64| known(joules / self.measured_j);
        let bounded = |joules: f64| known(joules / self.bounded_j);
        AheadScores {
            horizon_s,
            compared: self.compared,
            error: of(self.error_j),
            last_reading_error: of(self.last_error_j),
            mean_5s_error: of(self.mean_error_j),
            coverage: known(self.inside as f64 / self.bounded as f64),
            width: bounded(self.width_j),
            interval_score: bounded(self.interval_score_j),
        }
    }
}

/// Scores of the outlooks over one horizon, all robots, over the comparisons that this planner has
/// made. Errors, width and interval score are relative to the energy that was drawn. Unknown values
/// are `None`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AheadScores {
    /// The horizon, s.
    pub horizon_s: f32,
    /// Number of forecasts compared with the metered energy.
    pub compared: u64,
    /// Error of the outlooks: sum of the absolute errors.
    pub error: Option<f64>,
    /// Error if the last reading went on.
    pub last_reading_error: Option<f64>,
    /// Error if the mean power of the last 5 s went on.
    pub mean_5s_error: Option<f64>,
    /// Fraction of the energies that lay inside the 90 % interval.
    pub coverage: Option<f64>,
    /// Width of the intervals.
    pub width: Option<f64>,
    /// Interval score of the intervals: their width, and 20 times the distance of those outside.
    pub interval_score: Option<f64>,
}

/// All shadow forecasts and their scores.
#[derive(Debug, Clone, Default)]
pub(crate) struct Ahead {
    robots: HashMap<u32, Robot>,
    sums: [Sums; OUTLOOK_HORIZONS],
}

impl Ahead {
    /// Takes the newest rows of a robot. Those of different ticks are passed over.
    pub(crate) fn add(&mut self, outlook: &Outlook, budget: &Budget, forecast: &Forecast) {
        let is_one_tick =
            outlook.stamp_ns == budget.stamp_ns && outlook.stamp_ns == forecast.stamp_ns;
        if !is_one_tick || budget.flags & budget_flag::LEDGER == 0 {
            return;
        }
        let now = Metered::new(budget);
        let robot = self.robots.entry(outlook.robot).or_default();
        let mean_w = robot.mean_w(now);
        let is_read = forecast.flags & forecast_flag::READING != 0;
        let open = |place: usize| {
            let watts = |joules: f32| f64::from(joules) / f64::from(OUTLOOK_S[place]);
            let outlook_w = outlook.expected_j(place).map(watts);
            outlook_w.zip(mean_w).filter(|_| is_read).map(|(outlook_w, mean_w)| {
                let bounds_j = outlook.bounds_j(place);
                Shadow {
                    from: now,
                    outlook_w,
                    bounds_w: bounds_j.map(|(lo_j, hi_j)| (watts(lo_j), watts(hi_j))),
                    last_w: forecast.reading_w.into(),
                    mean_w,
                }
            })
        };
        for (place, horizon_s) in OUTLOOK_S.map(f64::from).into_iter().enumerate() {
            let shadow = &mut robot.shadows[place];
            if let Some(open) = shadow {
                match now.since(&open.from) {
                    Some((seconds, _)) if seconds < horizon_s => continue,
                    Some(drawn) => self.sums[place].add(open, drawn),
                    None => {}
                }
            }
            *shadow = open(place);
        }
    }

    /// The scores of every horizon.
    pub(crate) fn scores(&self) -> [AheadScores; OUTLOOK_HORIZONS] {
        std::array::from_fn(|place| self.sums[place].scores(OUTLOOK_S[place]))
    }

    /// Forgets robots that have left.
    pub(crate) fn keep(&mut self, is_there: impl Fn(u32) -> bool) {
        self.robots.retain(|robot, _| is_there(*robot));
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::outlook_flag;

    use super::*;

    const TICK_NS: u64 = 100_000_000;

    /// Ticks of one robot that draws `watts`, whose outlook expects 10 W within 8 and 12.
    fn watch(ahead: &mut Ahead, ticks: std::ops::Range<u64>, watts: impl Fn(u64) -> f64, gap: u64) {
        let mut drawn_uj = (0..ticks.start).map(|tick| (watts(tick) * 1e5) as i64).sum::<i64>();
        for tick in ticks {
            let stamp_ns = (tick + 1) * TICK_NS;
            let outlook = Outlook {
                flags: outlook_flag::ENERGY,
                bounded: 3,
                stamp_ns,
                energy_j: OUTLOOK_S.map(|seconds| 10.0 * seconds),
                energy_lo_j: OUTLOOK_S.map(|seconds| 8.0 * seconds),
                energy_hi_j: OUTLOOK_S.map(|seconds| 12.0 * seconds),
                ..Outlook::default()
            };
            drawn_uj += (watts(tick) * 1e5) as i64;
            let budget = Budget {
                flags: budget_flag::LEDGER,
                drawn_uj,
                metered_ns: stamp_ns,
                unmetered_ns: gap,
                stamp_ns,
                ..Budget::default()
            };
            let forecast = Forecast {
                flags: forecast_flag::READING,
                reading_w: watts(tick) as f32,
                stamp_ns,
                ..Forecast::default()
            };
            ahead.add(&outlook, &budget, &forecast);
        }
    }

    fn near(found: Option<f64>, expected: f64) -> bool {
        found.is_some_and(|found| (found - expected).abs() < 1e-6)
    }

    #[test]
    fn forecasts_are_compared_with_the_energy_that_was_drawn() {
        // The last reading is misled by each tenth reading of 19 W, on which a second begins.
        let mut ahead = Ahead::default();
        watch(&mut ahead, 0..401, |tick| if tick % 10 == 1 { 19.0 } else { 10.0 }, 0);
        let [one, ten, minute, five] = ahead.scores();
        assert!((38..=40).contains(&one.compared) && (3..=4).contains(&ten.compared), "{one:?}");
        assert!(near(one.error, 0.9 / 10.9), "{one:?}");
        assert!(near(one.last_reading_error, 8.1 / 10.9), "{one:?}");
        assert!(one.mean_5s_error.unwrap() < 0.05 && near(ten.error, 0.9 / 10.9), "{ten:?}");
        assert!(near(one.coverage, 1.0) && near(one.width, 4.0 / 10.9), "{one:?}");
        assert_eq!(one.width, one.interval_score);
        // A minute has not passed, and nothing is known then.
        assert_eq!((minute.compared, minute.error, five.coverage), (0, None, None));
    }

    #[test]
    fn energy_outside_the_interval_costs_twenty_times_its_distance() {
        let mut ahead = Ahead::default();
        watch(&mut ahead, 0..50, |_| 13.0, 0);
        let [one, ..] = ahead.scores();
        assert!(near(one.coverage, 0.0) && near(one.interval_score, 24.0 / 13.0), "{one:?}");
    }

    #[test]
    fn a_gap_in_the_ledger_is_not_compared_and_forecasts_begin_anew() {
        let mut ahead = Ahead::default();
        watch(&mut ahead, 0..9, |_| 10.0, 0);
        assert_eq!(ahead.scores()[0].compared, 0);
        watch(&mut ahead, 9..15, |_| 10.0, 5);
        assert_eq!(ahead.scores()[0].compared, 0, "half of that time is missing");
        watch(&mut ahead, 15..40, |_| 10.0, 5);
        assert!(ahead.scores()[0].compared >= 2);
        ahead.keep(|_| false);
        assert!(ahead.robots.is_empty() && ahead.scores()[0].compared >= 2);
    }
}
