//! Charging policies: which tasks a robot may do, and when it must go to its charger.

use std::fmt;

use joulebus_plan::follow::Pose;
use joulebus_plan::{Path, Point, Robot, Verdict, rank_each};
use joulebus_predictor::{ReadingAge, RolloutStart, Rollouts};
use joulebus_wire::{Budget, PlanState};
use serde::Serialize;

use crate::broker::Broker;
use crate::error::MissionError;
use crate::machine::Machine;
use crate::scenario::{SPEED_MPS, Task};

/// Rest of a robot that the oracle adds to a way, ns: it waits up to a second for the next
/// decision, and its load fluctuates otherwise when it leaves later.
const RESTS_NS: u64 = 4_000_000_000;

/// A policy with its tuned settings. All but the oracle use the same estimate of the battery, which
/// the fleet counts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Policy {
    /// Two thresholds of the state of charge, whatever the task.
    Threshold {
        /// A task is begun above this one.
        begin: f64,
        /// Below this one the robot goes to its charger, also out of a task.
        go: f64,
    },
    /// A constant power of all robots times the duration of the planned way.
    Distance {
        /// The power, W, tuned.
        power_w: f64,
        /// Share of the battery that is kept in reserve, tuned.
        reserve: f64,
    },
    /// The network's open-loop rollout over the planned commands, times a factor.
    Network {
        /// The factor, tuned.
        margin: f64,
        /// Share of the battery that is kept in reserve, tuned.
        reserve: f64,
    },
    /// `rank` and `CannotReturn`.
    Joulebus {
        /// Coverage of the intervals, tuned.
        coverage: f32,
        /// Share of the battery that is kept in reserve, tuned.
        reserve: f64,
    },
    /// Perfect forecasts: it drives a copy of the robot ahead, and reads the true battery. With the
    /// same dispatcher, the others cannot do better by better energy forecasts.
    Oracle,
}

/// A candidate robot for a task.
#[derive(Clone, Debug)]
pub(crate) struct Asked {
    pub robot: usize,
    pub pose: Pose,
    pub rows: (PlanState, Budget),
    /// The robot itself: for the oracle alone.
    pub truth: Option<Machine>,
}

impl Asked {
    fn usable_j(&self) -> f64 {
        self.rows.1.usable_j.into()
    }

    /// The robot's true energy, J, and its true consumption on a path.
    fn truly_j(&self, broker: &Broker<'_>, way: &[Point]) -> (f64, f64) {
        let Some(machine) = &self.truth else {
            return (0.0, f64::INFINITY);
        };
        let product = broker.product;
        let (then_ns, dt_ns) = (RESTS_NS, product.period_ns());
        let draws_j = machine.draws_j(way, then_ns, &product.follower, dt_ns);
        (machine.stored_j(), draws_j)
    }

    /// The path from its position over some points.
    fn path(&self, points: &[Point]) -> Path {
        let all: Vec<Point> = [&[self.pose.at], points].concat();
        Path { heading_rad: Some(self.pose.heading_rad), ..Path::new(&all, SPEED_MPS) }
    }

    fn distance_m(&self, to: Point) -> f64 {
        (self.pose.at.x_m - to.x_m).hypot(self.pose.at.y_m - to.y_m)
    }
}

impl Policy {
    /// The name in tables.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Threshold { .. } => "threshold",
            Self::Distance { .. } => "distance",
            Self::Network { .. } => "network",
            Self::Joulebus { .. } => "joulebus",
            Self::Oracle => "oracle",
        }
    }

    /// Share of the battery kept in reserve. The usable energy of budgets begins above it.
    pub(crate) const fn reserve(&self) -> f64 {
        match self {
            // Thresholds are states of charge, independent of the usable energy.
            Self::Threshold { .. } | Self::Oracle => 0.0,
            Self::Distance { reserve, .. }
            | Self::Network { reserve, .. }
            | Self::Joulebus { reserve, .. } => *reserve,
        }
    }

    /// Chooses the robot for a task. `None` if no robot may do it.
    pub(crate) fn choose(
        &self,
        broker: &Broker<'_>,
        asked: &[Asked],
        task: &Task,
    ) -> Result<Option<usize>, MissionError> {
        if let Self::Joulebus { coverage, .. } = self {
            return ranked(broker, asked, task, *coverage);
        }
        let mut nearest: Option<&Asked> = None;
        let start = task.points[0];
        for one in asked {
            let is_nearer =
                nearest.is_none_or(|other| one.distance_m(start) < other.distance_m(start));
            if is_nearer && self.allows(broker, one, task)? {
                nearest = Some(one);
            }
        }
        Ok(nearest.map(|one| one.robot))
    }

    fn allows(&self, broker: &Broker<'_>, one: &Asked, task: &Task) -> Result<bool, MissionError> {
        if let Self::Threshold { begin, .. } = self {
            return Ok(f64::from(one.rows.1.soc) >= *begin);
        }
        let way = [task.points.as_slice(), &broker.product.home].concat();
        if matches!(self, Self::Oracle) {
            let (stored_j, draws_j) = one.truly_j(broker, &way);
            return Ok(draws_j < stored_j);
        }
        Ok(self.needed_j(broker, one, &way)? <= one.usable_j())
    }

    /// Energy that a way needs, J.
    pub(crate) fn needed_j(
        &self,
        broker: &Broker<'_>,
        one: &Asked,
        way: &[Point],
    ) -> Result<f64, MissionError> {
        let path = one.path(way);
        match self {
            Self::Threshold { .. } => Ok(0.0),
            Self::Distance { power_w, .. } => {
                let followed = broker.product.planned.follow(&path)?;
                let drives_s = followed.v_mps.len() as f64 * f64::from(followed.period_s);
                Ok(power_w * drives_s)
            }
            Self::Oracle => Ok(one.truly_j(broker, way).1),
            Self::Network { margin, .. } => Ok(margin * rolled_j(broker, &one.rows.0, &path)?),
            Self::Joulebus { coverage, .. } => {
                let Some(robot) = broker.robot(&one.rows) else {
                    return Ok(f64::INFINITY);
                };
                let trip = robot.finish(&path, None, *coverage)?;
                let hi_j = trip.answer.energy.map_or(f32::INFINITY, |energy| energy.hi_j);
                // A load that has just begun: the mean of the last seconds knows it, the level of
                // the last minutes not yet.
                let recent_j = recent_w(&robot) * trip.answer.duration_s;
                Ok(hi_j.max(recent_j).into())
            }
        }
    }

    /// True if a robot must go to its charger now. `home_j` is [`Policy::needed_j`] of the path
    /// home.
    pub(crate) fn must_go(&self, broker: &Broker<'_>, one: &Asked, home_j: f64) -> bool {
        match self {
            Self::Threshold { go, .. } => f64::from(one.rows.1.soc) < *go,
            Self::Distance { .. } | Self::Network { .. } => one.usable_j() < home_j,
            // The fleet compares the battery with the path home that the samples state.
            Self::Joulebus { .. } => broker.cannot_return(one.robot),
            Self::Oracle => {
                // `home_j` is computed for the robot's position up to five seconds ago.
                let stored_j = one.truth.as_ref().map_or(0.0, Machine::stored_j);
                let is_short = || {
                    let (stored_j, draws_j) = one.truly_j(broker, &broker.product.home);
                    stored_j <= draws_j
                };
                stored_j <= home_j && is_short()
            }
        }
    }
}

/// A robot's mean power over the last seconds, W.
fn recent_w(robot: &Robot<'_>) -> f32 {
    /// Place of the level of 12 s.
    const LEVEL: usize = 2;
    let state = &robot.energy_state().metered;
    state.energy_j[LEVEL] / state.time_s[LEVEL]
}

/// The cheapest robot that does a task and returns with certainty.
fn ranked(
    broker: &Broker<'_>,
    asked: &[Asked],
    task: &Task,
    coverage: f32,
) -> Result<Option<usize>, MissionError> {
    let [line, charger] = broker.product.home;
    let way = [task.points.as_slice(), &[line]].concat();
    let robots = asked.iter().filter_map(|one| {
        let robot = broker.robot(&one.rows)?;
        Some((robot, one.path(&way)))
    });
    let robots: Vec<(Robot<'_>, Path)> = robots.collect();
    let ranked = rank_each(&robots, Some(charger), coverage)?;
    let best = ranked.first();
    let best = best.filter(|best| best.trip.answer.verdict == Verdict::Yes);
    Ok(best.map(|best| best.robot as usize))
}

/// Energy of a path by the network alone, fed with its own forecasts, J. Infinite if they diverge.
fn rolled_j(broker: &Broker<'_>, state: &PlanState, path: &Path) -> Result<f64, MissionError> {
    let followed = broker.product.planned.follow(path)?;
    let step_s = broker.product.period_ns() as f64 * 1e-9;
    // Each planned command is in force for several control steps.
    let held = (f64::from(followed.period_s) / step_s).round() as usize;
    let commands = |planned: &[f32]| -> Vec<f32> {
        let each = planned.iter();
        each.flat_map(|value| std::iter::repeat_n(*value, held)).collect()
    };
    let (v_mps, omega_radps) = (commands(&followed.v_mps), commands(&followed.omega_radps));
    let Some(lag_w) = state.lags_w() else {
        return Ok(f64::INFINITY);
    };
    let start = RolloutStart { command: state.command(), lag_w, reading_age: ReadingAge::UNKNOWN };
    let rollouts = Rollouts {
        starts: &[start],
        candidates: 1,
        steps: v_mps.len(),
        step_s: step_s as f32,
        v_mps: &v_mps,
        omega_radps: &omega_radps,
    };
    let mut energy_j = [f32::NAN];
    broker.product.model().rollout(&rollouts, 0..1, &mut energy_j, None)?;
    let energy_j = f64::from(energy_j[0]);
    Ok(if energy_j > 0.0 { energy_j } else { f64::INFINITY })
}

impl fmt::Display for Policy {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Threshold { begin, go } => {
                write!(out, "begin above {:.0} %, go below {:.0} %", 100.0 * begin, 100.0 * go)
            }
            Self::Distance { power_w, .. } => write!(out, "{power_w} W"),
            Self::Network { margin, .. } => write!(out, "rollout × {margin}"),
            Self::Joulebus { coverage, .. } => write!(out, "coverage {coverage}"),
            Self::Oracle => write!(out, "true energies"),
        }?;
        match self {
            Self::Threshold { .. } | Self::Oracle => Ok(()),
            _ => write!(out, ", {} % in reserve", 100.0 * self.reserve()),
        }
    }
}
