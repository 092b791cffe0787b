//! Paths: points in the plane, with a speed towards each.

use joulebus_settings::Platform as Settings;
use serde::{Deserialize, Serialize};

use crate::error::PathError;

/// Distance at which a point is reached, m.
pub(crate) const REACH_M: f64 = 0.05;

/// Largest coordinate, m.
const MAX_COORDINATE_M: f64 = 1e6;

/// Longest time of a path, s, and greatest time of a clock: until the year 5138.
const MAX_TIME_S: f64 = 1e11;

/// Greatest load, W.
const MAX_LOAD_W: f64 = 1e6;

/// Greatest tolerance, m.
const MAX_TOLERANCE_M: f32 = 1.0;

/// A point in the plane.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// East, m.
    pub x_m: f64,
    /// North, m.
    pub y_m: f64,
}

impl Point {
    /// Creates it from its coordinates, m.
    #[must_use]
    pub const fn new(x_m: f64, y_m: f64) -> Self {
        Self { x_m, y_m }
    }
}

/// A path: from the first point to the last, with a speed towards each.
///
/// The columns beside the points are empty, or have one value for each point.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Path {
    /// The points. The robot is at the first.
    pub points: Vec<Point>,
    /// Speed towards each point, m/s, at most the platform's. The first one is not used. Infinity
    /// means as fast as the model knows.
    pub speed_mps: Vec<f64>,
    /// Heading at the first point, rad. `None`: towards the first point that is elsewhere.
    pub heading_rad: Option<f64>,
    /// Time that the robot waits at each point, s, at least 0. Not with times.
    pub dwell_s: Vec<f64>,
    /// Power that the robot draws in addition, W, on the way to each point and while it waits there:
    /// a payload's, or a tool's. Negative if it draws less.
    pub load_w: Vec<f64>,
    /// Time at which the robot is at each point, s, by any clock, never falling. It starts at the
    /// first. A repeated point with a later time is a wait. Speeds are then upper limits.
    pub time_s: Vec<f64>,
    /// Distance from the path within which corners are cut, m. 0: none are. `None`: the stairs of a
    /// grid within half a cell ([`Path::simplified`]).
    pub tolerance_m: Option<f32>,
}

impl Path {
    /// With one speed for all legs, m/s.
    #[must_use]
    pub fn new(points: &[Point], speed_mps: f64) -> Self {
        Self {
            points: points.to_vec(),
            speed_mps: vec![speed_mps; points.len()],
            ..Self::default()
        }
    }

    /// Number of legs.
    #[must_use]
    pub fn legs(&self) -> usize {
        self.points.len().saturating_sub(1)
    }

    /// Refuses a speed above a platform's: the answer would be about another plan. Infinity asks
    /// for none. Refuses a load by which no allowed reading of the robot becomes another one.
    ///
    /// # Errors
    /// [`PathError::TooFast`] and [`PathError::Load`]. A platform that cannot drive at all is refused
    /// with the question.
    pub fn check_on(&self, platform: &Settings) -> Result<(), PathError> {
        let most_w = f64::from(platform.power_max_w) - f64::from(platform.power_min_w);
        if let Some(point) = self.load_w.iter().position(|load_w| load_w.abs() > most_w) {
            let (found, platform) = (self.load_w[point], platform.name.clone());
            return Err(PathError::Load { point, found, platform, allowed: most_w });
        }
        let allowed = platform.v_max_mps;
        let is_above = |speed: f64| speed.is_finite() && speed as f32 > allowed && allowed > 0.0;
        let above = (1..self.speed_mps.len()).find(|point| is_above(self.speed_mps[*point]));
        above.map_or(Ok(()), |point| {
            let (found, platform) = (self.speed_mps[point], platform.name.clone());
            Err(PathError::TooFast { point, found, platform, allowed })
        })
    }

    pub(crate) fn check(&self) -> Result<(), PathError> {
        if self.points.len() < 2 || self.speed_mps.len() != self.points.len() {
            return Err(PathError::Points { found: self.points.len().min(self.speed_mps.len()) });
        }
        let coordinate = |column, point, found: f64| {
            if found.abs() <= MAX_COORDINATE_M {
                return Ok(());
            }
            Err(PathError::Coordinate { column, point, found, allowed: MAX_COORDINATE_M })
        };
        for (column, values, allowed) in [
            ("dwell_s", &self.dwell_s, 0.0..=MAX_TIME_S),
            ("load_w", &self.load_w, -MAX_LOAD_W..=MAX_LOAD_W),
            ("time_s", &self.time_s, -MAX_TIME_S..=MAX_TIME_S),
        ] {
            if !(values.is_empty() || values.len() == self.points.len()) {
                let (found, allowed) = (values.len(), self.points.len());
                return Err(PathError::Column { column, found, allowed });
            }
            if let Some(point) = values.iter().position(|value| !allowed.contains(value)) {
                let (found, allowed) = (values[point], (*allowed.start(), *allowed.end()));
                return Err(PathError::Value { column, point, found, allowed });
            }
        }
        if let Some(before) = self.time_s.windows(2).position(|pair| pair[1] < pair[0]) {
            let (point, found) = (before + 1, self.time_s[before + 1]);
            return Err(PathError::Falls { point, found, before: self.time_s[before] });
        }
        if !self.time_s.is_empty() && self.dwell_s.iter().any(|dwell_s| *dwell_s > 0.0) {
            return Err(PathError::DwellWithTimes);
        }
        if let Some(found) =
            self.tolerance_m.filter(|found| !(0.0..=MAX_TOLERANCE_M).contains(found))
        {
            return Err(PathError::Tolerance { found, allowed: MAX_TOLERANCE_M });
        }
        for (place, point) in self.points.iter().enumerate() {
            coordinate("x_m", place, point.x_m)?;
            coordinate("y_m", place, point.y_m)?;
        }
        coordinate("heading_rad", 0, self.heading_rad.unwrap_or(0.0))?;
        for (point, speed) in self.speed_mps.iter().enumerate().skip(1) {
            if !(0.0 < *speed && *speed <= f64::INFINITY) {
                return Err(PathError::Speed { point, found: *speed });
            }
        }
        Ok(())
    }
}

pub(crate) fn distance_m(from: Point, to: Point) -> f64 {
    libm::hypot(to.x_m - from.x_m, to.y_m - from.y_m)
}
