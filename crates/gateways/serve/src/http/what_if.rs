//! Questions about plans, as `joulebus ask` asks them, and its answers.

use joulebus_plan::{MAX_STEPS, Path, Plan, Point, Question};
use serde::Deserialize;

/// Maximum number of robots in a question.
const MAX_ROBOTS: usize = 64;
/// Moments along a trip.
const MOMENTS: usize = 48;
/// Maximum number of points of a path.
const MAX_POINTS: usize = 10_000;

/// A question as JSON.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Asked {
    /// One robot.
    robot: Option<u32>,
    /// Several robots, answered the best first.
    #[serde(default)]
    rank: Vec<u32>,
    /// Stand still for this time, s.
    idle_s: Option<f32>,
    /// Follow this path.
    path: Option<Vec<Waypoint>>,
    /// Return afterwards.
    #[serde(rename = "return")]
    back: Option<ReturnTo>,
    /// Distance from the path within which corners are cut, m. Without it, the stairs of a grid within
    /// half a cell.
    tolerance_m: Option<f32>,
    /// Then charge to this state of charge.
    pub(super) charge_to: Option<f64>,
    /// Coverage of the intervals.
    #[serde(default = "usual_coverage")]
    coverage: f32,
}

/// A point, and the speed towards it. Without one, the highest that the model was trained on.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields, rename = "Place")] // Errors name it as the schema does.
struct Waypoint {
    x_m: f64,
    y_m: f64,
    speed_mps: Option<f64>,
    /// Time that the robot waits there, s.
    dwell_s: Option<f64>,
    /// Power that it draws in addition on the way there and while it waits, W.
    load_w: Option<f64>,
    /// When it is there, s. All points have one, or none has.
    time_s: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "return is \"dock\" or a Place: {\"x_m\": 0, \"y_m\": 0}")]
enum ReturnTo {
    /// "dock": where the path begins.
    Named(Dock),
    Waypoint(Waypoint),
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Dock {
    Dock,
}

const fn usual_coverage() -> f32 {
    0.9
}

impl Asked {
    /// The question.
    pub(super) fn question(self) -> Result<Question, String> {
        let robots: Vec<u32> = self.robot.into_iter().chain(self.rank).collect();
        if !(1..=MAX_ROBOTS).contains(&robots.len()) {
            let found = robots.len();
            return Err(format!("{found} robots in robot and rank, allowed: 1 to {MAX_ROBOTS}"));
        }
        if let Some(to) = self.charge_to.filter(|to| !(0.0..=1.0).contains(to)) {
            return Err(format!("charge_to is {to}, allowed: 0 to 1"));
        }
        let plan = match (self.path, self.idle_s) {
            (Some(waypoints), None) => {
                follow(robots, &waypoints, self.back.as_ref(), self.tolerance_m)?
            }
            (None, Some(duration_s)) if self.back.is_none() && self.tolerance_m.is_none() => {
                Plan::Idle { robots, duration_s }
            }
            _ => {
                let allowed = "give either path, with return and tolerance_m if wanted, or idle_s";
                return Err(allowed.to_owned());
            }
        };
        let moments = if plan.robots().len() == 1 { MOMENTS } else { 0 };
        Ok(Question { plan, coverage: self.coverage, power: false, moments })
    }
}

fn follow(
    robots: Vec<u32>,
    waypoints: &[Waypoint],
    back: Option<&ReturnTo>,
    tolerance_m: Option<f32>,
) -> Result<Plan, String> {
    if !(2..=MAX_POINTS).contains(&waypoints.len()) {
        let found = waypoints.len();
        return Err(format!(
            "path has {found} points, allowed: 2 to {MAX_POINTS}. The first is where the robot is"
        ));
    }
    let point = |waypoint: &Waypoint| Point::new(waypoint.x_m, waypoint.y_m);
    let column = |of: fn(&Waypoint) -> Option<f64>| {
        let stated = waypoints.iter().any(|waypoint| of(waypoint).is_some());
        let values = waypoints.iter().filter(|_| stated).map(of);
        values.map(|value| value.unwrap_or(0.0)).collect()
    };
    let with_times = waypoints.iter().filter(|waypoint| waypoint.time_s.is_some()).count();
    if !(with_times == 0 || with_times == waypoints.len()) {
        let count = waypoints.len();
        return Err(format!("{with_times} of {count} points have time_s: give it to all or none"));
    }
    let speed_mps = |waypoint: &Waypoint| waypoint.speed_mps.unwrap_or(f64::INFINITY);
    let path = Path {
        points: waypoints.iter().map(point).collect(),
        speed_mps: waypoints.iter().map(speed_mps).collect(),
        dwell_s: column(|waypoint| waypoint.dwell_s),
        load_w: column(|waypoint| waypoint.load_w),
        time_s: column(|waypoint| waypoint.time_s),
        tolerance_m,
        heading_rad: None,
    };
    let back_to = back.map(|back| match back {
        ReturnTo::Named(Dock::Dock) => path.points[0],
        ReturnTo::Waypoint(waypoint) => point(waypoint),
    });
    Ok(Plan::Follow { robots, path, back_to })
}

/// Maximum length of a path, steps. The server computes one question at a time.
pub(super) const MAX_PATH_STEPS: usize = MAX_STEPS;
