//! Paths: what they cost, until when the robot must turn back, which robot does them for the least.

use joulebus_energy::Commands;

use crate::answer::{Answer, Verdict};
use crate::candidates::{Candidates, part};
use crate::error::{AskError, PathError};
use crate::follower::{Followed, Follower, Path, Point};
use crate::limits::MAX_STEPS;
use crate::question::{Row, best_first};
use crate::robot::Robot;

/// Times at which turning back is tried, at most.
const TURNS: usize = 64;

/// The answer to a path, and back if asked.
#[derive(Debug, Clone, PartialEq)]
pub struct Trip {
    /// The answer for all legs; the way back is the last one.
    pub answer: Answer,
    /// With a way back: the time until which the robot can follow the path and still return with
    /// [`crate::Verdict::Yes`], s. The path's duration if it can follow all of it; `None` if it cannot say
    /// so even now, and without a way back. Tried at up to 64 times, evenly spaced: the last before the first that
    /// fails, or from which the way back is not reached or has too many steps.
    pub turn_back_s: Option<f32>,
    /// The commands of the whole trip.
    pub commands: Followed,
}

/// A robot's answer to a task.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranked {
    /// The robot.
    pub robot: u32,
    /// Its answer.
    pub trip: Trip,
}

impl Robot<'_> {
    /// Whether the robot can follow a path and then return to a point, at the speed of the last leg.
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

    /// As [`Robot::can_finish`], where path and way back have at most `most_steps` steps in all: what bounds
    /// the time that it takes.
    ///
    /// # Errors
    /// As there, or more steps.
    pub fn can_finish_within(
        &self,
        path: &Path,
        back_to: Option<Point>,
        coverage: f32,
        most_steps: usize,
    ) -> Result<Trip, AskError> {
        let follower = Follower::new(self.platform())?.within(most_steps);
        let Some(dock) = back_to else {
            return self.trip(follower.follow(path)?, None, coverage);
        };
        let there = follower.follow(path)?;
        let back = Back::after(path, &follower, dock);
        let all = back.append(&there)?;
        let mut trip = self.trip(all, None, coverage)?;
        trip.turn_back_s = self.turn_back_s(&there, &trip, &back, coverage)?;
        Ok(trip)
    }

    /// As [`Robot::can_finish`], without the time to turn back, whose search costs up to 64 times as
    /// much as the answer: for choosing among many plans.
    ///
    /// # Errors
    /// As there.
    pub fn finish(
        &self,
        path: &Path,
        back_to: Option<Point>,
        coverage: f32,
    ) -> Result<Trip, AskError> {
        let follower = Follower::new(self.platform())?;
        let there = follower.follow(path)?;
        let commands = match back_to {
            Some(dock) => Back::after(path, &follower, dock).append(&there)?,
            None => there,
        };
        self.trip(commands, None, coverage)
    }

    fn trip(
        &self,
        commands: Followed,
        turn_back_s: Option<f32>,
        coverage: f32,
    ) -> Result<Trip, AskError> {
        self.check_followed(&commands, coverage)?;
        let answer = self.answer(commands.commands(), &commands.leg_ends, coverage);
        Ok(Trip {
            answer,
            turn_back_s,
            commands,
        })
    }

    fn check_followed(&self, followed: &Followed, coverage: f32) -> Result<(), AskError> {
        let columns = (&followed.v_mps, &followed.omega_radps);
        let candidates = Candidates::new(1, followed.period_s, columns.0, columns.1)?;
        self.check(&candidates, coverage)
    }

    /// `whole`: the whole path and the way back from its end.
    fn turn_back_s(
        &self,
        there: &Followed,
        whole: &Trip,
        back: &Back<'_>,
        coverage: f32,
    ) -> Result<Option<f32>, AskError> {
        let (commands, steps) = (there.commands(), there.v_mps.len());
        let stride = steps.div_ceil(TURNS).max(1);
        let mut leg_ends = there.leg_ends.iter().peekable();
        let (mut progress, mut done, mut last_s) = (self.begin(there.period_s), 0, None);
        for turn in (0..steps).step_by(stride) {
            while let Some(end) = leg_ends.next_if(|end| **end <= turn) {
                self.follow(&mut progress, part(commands, done, *end));
                done = *end;
                if !self.makes(&progress, coverage) {
                    return Ok(last_s);
                }
            }
            self.follow(&mut progress, part(commands, done, turn));
            done = turn;
            let Some(home) = back.turned(there, turn)? else {
                return Ok(last_s);
            };
            let mut turned = progress;
            self.follow(&mut turned, home.commands());
            if !self.makes(&turned, coverage) {
                return Ok(last_s);
            }
            last_s = Some(turn as f32 * there.period_s);
        }
        if whole.answer.verdict == Verdict::Yes {
            last_s = Some(steps as f32 * there.period_s);
        }
        Ok(last_s)
    }
}

/// The way back.
struct Back<'a> {
    follower: &'a Follower,
    dock: Point,
    speed_mps: f64,
}

impl<'a> Back<'a> {
    /// At the speed of the path's last leg.
    fn after(path: &Path, follower: &'a Follower, dock: Point) -> Self {
        Self {
            follower,
            dock,
            speed_mps: path.speed_mps.last().copied().unwrap_or(0.0),
        }
    }

    /// The way back after the first steps of a path, which may have as many steps as the path leaves.
    fn home(&self, there: &Followed, steps: usize) -> Result<Followed, AskError> {
        let pose = there.poses[steps];
        let home = Path {
            points: vec![pose.at, self.dock],
            speed_mps: vec![self.speed_mps; 2],
            heading_rad: Some(pose.heading_rad),
        };
        let home = self.follower.follow(&home)?;
        let found = steps + home.v_mps.len();
        let allowed = self.follower.most_steps();
        if found > allowed {
            return Err(AskError::Steps { found, allowed });
        }
        Ok(home)
    }

    /// As [`Back::home`]; `None` if the robot cannot turn back there.
    fn turned(&self, there: &Followed, steps: usize) -> Result<Option<Followed>, AskError> {
        match self.home(there, steps) {
            Ok(home) => Ok(Some(home)),
            Err(AskError::Steps { .. } | AskError::Path(PathError::NotReached { .. })) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// A path, and the way back from its end as one more leg.
    fn append(&self, there: &Followed) -> Result<Followed, AskError> {
        let steps = there.v_mps.len();
        let home = self.home(there, steps)?;
        let mut leg_ends = there.leg_ends.clone();
        leg_ends.push(steps + home.v_mps.len());
        Ok(Followed {
            period_s: there.period_s,
            v_mps: [&there.v_mps[..], &home.v_mps].concat(),
            omega_radps: [&there.omega_radps[..], &home.omega_radps].concat(),
            leg_ends,
            poses: [&there.poses[..steps], &home.poses].concat(),
        })
    }
}

impl Followed {
    /// As commands of a plan.
    #[must_use]
    pub fn commands(&self) -> Commands<'_> {
        Commands {
            period_s: self.period_s,
            v_mps: &self.v_mps,
            omega_radps: &self.omega_radps,
        }
    }
}

/// The answers of several robots to one task, the best first: by verdict (yes, tight, no, unknown),
/// then by the expected energy, then by id.
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
        Ok(Ranked {
            robot: robot.id(),
            trip,
        })
    });
    let mut ranked = ranked.collect::<Result<Vec<Ranked>, AskError>>()?;
    sort(&mut ranked);
    Ok(ranked)
}

/// As [`rank`], each robot by a path of its own, which begins where the robot is; without times to turn
/// back ([`Robot::finish`]).
///
/// # Errors
/// As [`Robot::can_finish`].
pub fn rank_each(
    robots: &[(Robot<'_>, Path)],
    back_to: Option<Point>,
    coverage: f32,
) -> Result<Vec<Ranked>, AskError> {
    let ranked = robots.iter().map(|(robot, path)| {
        let trip = robot.finish(path, back_to, coverage)?;
        Ok(Ranked {
            robot: robot.id(),
            trip,
        })
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
