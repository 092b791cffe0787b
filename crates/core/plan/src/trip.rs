//! Trips along paths: their energy, the latest time to turn back, and the choice of a robot.

use joulebus_energy::Commands;

use crate::answer::{Answer, Verdict};
use crate::candidates::Candidates;
use crate::error::AskError;
use crate::estimate::Progress;
use crate::follower::Followed;
use crate::limits::MAX_STEPS;
use crate::path::{Path, Point};
use crate::question::{Row, best_first};
use crate::robot::{Legs, Robot, Walk};
use crate::route::{Home, Later, Route, Ways};

/// The answer to a path, and back if asked.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Trip {
    /// The answer for all legs. The path back is the last one.
    pub answer: Answer,
    /// With a path back: the time until which the robot can follow the path and still return with
    /// [`crate::Verdict::Yes`], s. `None` if the whole trip is a yes, so that it never has to turn
    /// back early, if it cannot even turn back now, and without a path back.
    ///
    /// Up to 64 evenly spaced times are tried. The result is the last one before the first
    /// that fails, or from which the path back is not reached or has too many steps.
    pub turn_back_s: Option<f32>,
    /// The commands of the whole trip.
    pub commands: Followed,
}

/// A robot's answer to a task.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Ranked {
    /// The robot.
    pub robot: u32,
    /// Its answer.
    pub trip: Trip,
}

impl Robot<'_> {
    /// True if the robot can follow a path and then return to a point and dock, at the speed of the
    /// last leg.
    ///
    /// # Errors
    /// A path that the platform cannot follow, or a coverage that is not allowed.
    pub fn can_finish(
        &self,
        path: &Path,
        back_to: Option<Point>,
        coverage: f32,
    ) -> Result<Trip, AskError> {
        self.can_finish_within(path, back_to, coverage, MAX_STEPS)
    }

    /// Same as [`Robot::can_finish`], for a path and path back of at most `max_steps` steps in
    /// all, which bounds the time of the computation.
    ///
    /// # Errors
    /// Those of [`Robot::can_finish`], or more steps.
    pub fn can_finish_within(
        &self,
        path: &Path,
        back_to: Option<Point>,
        coverage: f32,
        max_steps: usize,
    ) -> Result<Trip, AskError> {
        let mut route = Route::new(self, path, back_to, max_steps, 0)?;
        let answer = self.on(&route, coverage)?;
        // There are fewer than that.
        let mut ways = Ways(usize::MAX);
        let turned = self.turn_back_s(&mut route, &answer, coverage, &mut ways)?;
        Ok(Trip { answer, turn_back_s: turned.unwrap_or(None), commands: route.into_whole() })
    }

    /// Same as [`Robot::can_finish`], without the time to turn back, whose search costs up to 64
    /// times as much as the answer: for choosing among many plans.
    ///
    /// # Errors
    /// Those of [`Robot::can_finish`].
    pub fn finish(
        &self,
        path: &Path,
        back_to: Option<Point>,
        coverage: f32,
    ) -> Result<Trip, AskError> {
        let route = Route::new(self, path, back_to, MAX_STEPS, 0)?;
        Ok(Trip {
            answer: self.on(&route, coverage)?,
            turn_back_s: None,
            commands: route.into_whole(),
        })
    }

    /// The answer to a route of its platform.
    pub(crate) fn on(&self, route: &Route, coverage: f32) -> Result<Answer, AskError> {
        let whole = route.whole();
        let columns = (&whole.v_mps, &whole.omega_radps);
        let candidates = Candidates::new(1, whole.period_s, columns.0, columns.1)?;
        self.check(&candidates, coverage)?;
        Ok(self.answer(&route.legs(self), coverage))
    }

    /// Latest time at which the robot can turn back on a route. `whole` is its answer to all of it:
    /// after a yes, there is no such time.
    pub(crate) fn turn_back_s(
        &self,
        route: &mut Route,
        whole: &Answer,
        coverage: f32,
        ways: &mut Ways,
    ) -> Result<Result<Option<f32>, Later>, AskError> {
        if !route.returns() || whole.verdict == Verdict::Yes {
            return Ok(Ok(None));
        }
        let turns = route.turns();
        let (legs, whole, homes) = route.parts();
        let (mut walk, mut leg, mut last_s) = (Walk::new(self, &legs), 0, None);
        for (place, turn) in turns.enumerate() {
            while let Some(end) = legs.ends.get(leg).filter(|end| **end <= turn) {
                walk.to(*end);
                leg += 1;
                if *end > 0 && !self.makes(&walk.at.progress, coverage) {
                    return Ok(Ok(last_s));
                }
            }
            walk.to(turn);
            let home = match homes.home(self, whole, (place, turn), ways)? {
                Ok(Some(home)) => home,
                Ok(None) => return Ok(Ok(last_s)),
                Err(later) => return Ok(Err(later)),
            };
            if !self.makes(&self.turned(&walk, home), coverage) {
                return Ok(Ok(last_s));
            }
            last_s = Some(turn as f32 * whole.period_s);
        }
        Ok(Ok(last_s))
    }

    /// A plan that continues with a path back, on which it keeps the load that it had.
    fn turned(&self, walk: &Walk<'_>, home: &Home) -> Progress {
        let mut progress = walk.at.progress;
        let first = Commands {
            period_s: progress.sum.period_s(),
            v_mps: &[home.v_mps],
            omega_radps: &[home.omega_radps],
        };
        let home_s = home.rest.sum.duration_s() + progress.sum.period_s();
        progress.add(&self.platform().energy, first, 0.0);
        progress.join(&home.rest);
        // What it could put down saves nothing for sure.
        progress.added_j += f64::from(walk.at.load_w.max(0.0)) * f64::from(home_s);
        progress
    }
}

impl Followed {
    /// The followed steps as commands of a plan.
    #[must_use]
    pub fn commands(&self) -> Commands<'_> {
        Commands { period_s: self.period_s, v_mps: &self.v_mps, omega_radps: &self.omega_radps }
    }

    pub(crate) fn legs(&self) -> Legs<'_> {
        Legs {
            ends: &self.leg_ends,
            load_w: &self.load_w,
            start: self.start,
            late_s: self.late_s,
            ..Legs::none(self.commands())
        }
    }

    /// Adds the loads of the legs to the power of every step, W.
    pub(crate) fn add_loads(&self, power_w: &mut [f32]) {
        let (started, load_w) = self.start;
        let steps = power_w.get_mut(..started).unwrap_or_default();
        steps.iter_mut().for_each(|power_w| *power_w += load_w);
        let mut begin = started;
        for (end, load_w) in self.leg_ends.iter().zip(&self.load_w) {
            let steps = power_w.get_mut(begin..*end).unwrap_or_default();
            steps.iter_mut().for_each(|power_w| *power_w += load_w);
            begin = *end;
        }
    }
}

/// The answers of several robots to one task, the best first: by verdict (yes, tight, no, unknown),
/// then robots without alarms on their readings first, then by the expected energy, then by id.
///
/// # Errors
/// As [`Robot::can_finish`].
pub fn rank(
    robots: &[Robot<'_>],
    path: &Path,
    back_to: Option<Point>,
    coverage: f32,
) -> Result<Vec<Ranked>, AskError> {
    let ranked = robots.iter().map(|robot| {
        let trip = robot.can_finish(path, back_to, coverage)?;
        Ok(Ranked { robot: robot.id(), trip })
    });
    let mut ranked = ranked.collect::<Result<Vec<Ranked>, AskError>>()?;
    sort(&mut ranked);
    Ok(ranked)
}

/// Same as [`rank`], with a path of its own for each robot, which begins at the robot. Without
/// times to turn back ([`Robot::finish`]).
///
/// # Errors
/// Those of [`Robot::can_finish`].
pub fn rank_each(
    robots: &[(Robot<'_>, Path)],
    back_to: Option<Point>,
    coverage: f32,
) -> Result<Vec<Ranked>, AskError> {
    let ranked = robots.iter().map(|(robot, path)| {
        let trip = robot.finish(path, back_to, coverage)?;
        Ok(Ranked { robot: robot.id(), trip })
    });
    let mut ranked = ranked.collect::<Result<Vec<Ranked>, AskError>>()?;
    sort(&mut ranked);
    Ok(ranked)
}

/// The best first.
fn sort(ranked: &mut [Ranked]) {
    let row = |ranked: &Ranked| Row {
        robot: ranked.robot,
        answer: ranked.trip.answer,
        turn_back_s: ranked.trip.turn_back_s,
    };
    ranked.sort_by(|one, other| best_first(&row(one), &row(other)));
}
