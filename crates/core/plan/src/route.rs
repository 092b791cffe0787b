//! The robot-independent part of a path and the paths back from it, for a platform.

use crate::error::{AskError, PathError};
use crate::estimate::Progress;
use crate::follower::{Followed, Follower};
use crate::path::{Path, Point};
use crate::robot::{Legs, Mark, Robot, Walk, moments_of};

/// Times at which turning back is tried, at most.
const MAX_TURN_BACKS: usize = 64;

/// A path as a platform follows it, the path back from its end, and the paths back from the points
/// where turning back is tried.
///
/// Following costs some hundred times as much as computing the energy of the followed steps, and is
/// the same for all robots of a platform. So are the sums over the steps, but for the first. All are
/// done once, and the energies are computed last, from rows that are still young.
#[derive(Debug, Clone)]
pub(crate) struct Route {
    /// The path, with the path back from the end as one more leg.
    whole: Followed,
    /// Steps of the path alone.
    there: usize,
    /// At the end of each leg, at each turn and each moment.
    marks: Vec<Mark>,
    homes: Homes,
}

/// The ways back from within a path.
#[derive(Debug, Clone)]
pub(crate) struct Homes {
    follower: Follower,
    back: Option<Back>,
    /// As far as they were followed, in the order of [`Route::turns`].
    followed: Vec<Option<Home>>,
}

/// The point to return to.
#[derive(Debug, Clone, Copy)]
struct Back {
    dock: Point,
    speed_mps: f64,
}

/// A way back from within the path.
#[derive(Debug, Clone)]
pub(crate) struct Home {
    /// Its first command, m/s and rad/s. The command before it is in force until then.
    pub(crate) v_mps: f32,
    pub(crate) omega_radps: f32,
    pub(crate) rest: Progress,
}

/// Remaining number of paths back that may be followed for the first time before other questions
/// get their turn.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ways(pub(crate) usize);

/// More ways back would have to be followed than is allowed at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Later;

impl Route {
    /// Follows the path of a robot's platform, and the path back at the speed of its last leg.
    /// Together they have at most `max_steps` steps. `moments`: at which its parts are answered.
    pub(crate) fn new(
        robot: &Robot<'_>,
        path: &Path,
        back_to: Option<Point>,
        max_steps: usize,
        moments: usize,
    ) -> Result<Self, AskError> {
        let follower = Follower::new(robot.platform())?.within(max_steps);
        path.check_on(&robot.platform().settings)?;
        let mut whole = follower.follow(path)?;
        let there = whole.v_mps.len();
        let speed_mps = path.speed_mps.last().copied().unwrap_or(0.0);
        let back = back_to.map(|dock| Back { dock, speed_mps });
        if let Some(back) = back {
            let home = back.home(&follower, &whole, there)?;
            append(&mut whole, home);
        }
        let homes = Homes { follower, back, followed: Vec::new() };
        let mut route = Self { whole, there, marks: Vec::new(), homes };
        let legs = route.legs(robot);
        let moments = moments_of(legs.commands.steps(), moments);
        let mut stops: Vec<usize> = legs.ends.iter().copied().chain(route.turns()).collect();
        stops.extend(moments.chain([legs.commands.steps()]));
        stops.sort_unstable();
        stops.dedup();
        // The first step is the robot's own.
        route.marks = Walk::marks(robot, &legs, stops.into_iter().filter(|step| *step > 0));
        Ok(route)
    }

    /// The commands of path and way back.
    pub(crate) const fn whole(&self) -> &Followed {
        &self.whole
    }

    /// The path of [`Route::whole`], without the other parts.
    pub(crate) fn into_whole(self) -> Followed {
        self.whole
    }

    /// Path and way back, with docking at its end.
    pub(crate) fn legs(&self, robot: &Robot<'_>) -> Legs<'_> {
        let docking_j = if self.returns() { robot.docking_j() } else { 0.0 };
        Legs { docking_j, marks: &self.marks, ..self.whole.legs() }
    }

    /// Path and way back without docking, and the ways back from within the path.
    pub(crate) fn parts(&mut self) -> (Legs<'_>, &Followed, &mut Homes) {
        (Legs { marks: &self.marks, ..self.whole.legs() }, &self.whole, &mut self.homes)
    }

    /// True if there is a way back.
    pub(crate) const fn returns(&self) -> bool {
        self.homes.back.is_some()
    }

    /// The steps after which turning back is tried.
    pub(crate) fn turns(&self) -> impl Iterator<Item = usize> + use<> {
        (0..self.there).step_by(self.there.div_ceil(MAX_TURN_BACKS).max(1))
    }
}

impl Homes {
    /// The path back from a turn, by its index in [`Route::turns`], which are taken in order.
    /// `None` if the robot cannot turn back there.
    pub(crate) fn home(
        &mut self,
        robot: &Robot<'_>,
        there: &Followed,
        (place, turn): (usize, usize),
        ways: &mut Ways,
    ) -> Result<Result<Option<&Home>, Later>, AskError> {
        if self.followed.len() <= place {
            let Some(left) = ways.0.checked_sub(1) else {
                return Ok(Err(Later));
            };
            ways.0 = left;
            let home = self.turned(robot, there, turn)?;
            self.followed.push(home);
        }
        Ok(Ok(self.followed[place].as_ref()))
    }

    fn turned(
        &self,
        robot: &Robot<'_>,
        there: &Followed,
        turn: usize,
    ) -> Result<Option<Home>, AskError> {
        let Some(back) = &self.back else {
            return Ok(None);
        };
        match back.home(&self.follower, there, turn) {
            Ok(home) => Ok(Some(Home {
                v_mps: home.v_mps[0],
                omega_radps: home.omega_radps[0],
                rest: robot.rest(home.commands()),
            })),
            Err(
                AskError::Steps { .. }
                | AskError::Path(PathError::NotReached { .. } | PathError::TooLong { .. }),
            ) => Ok(None),
            Err(error) => Err(error),
        }
    }
}

impl Back {
    /// The way back after the first steps of a path, which may have as many steps as the path
    /// leaves.
    fn home(
        &self,
        follower: &Follower,
        there: &Followed,
        steps: usize,
    ) -> Result<Followed, AskError> {
        let pose = there.poses[steps];
        let home = Path {
            points: vec![pose.at, self.dock],
            speed_mps: vec![self.speed_mps; 2],
            heading_rad: Some(pose.heading_rad),
            ..Path::default()
        };
        let home = follower.follow(&home)?;
        let found = steps + home.v_mps.len();
        let allowed = follower.max_steps();
        if found > allowed {
            return Err(AskError::Steps { found, allowed });
        }
        Ok(home)
    }
}

/// Adds the path back from the end of a path as one more leg, on which nothing is loaded.
fn append(there: &mut Followed, home: Followed) {
    let steps = there.v_mps.len();
    there.leg_ends.push(steps + home.v_mps.len());
    there.v_mps.extend(home.v_mps);
    there.omega_radps.extend(home.omega_radps);
    there.poses.truncate(steps);
    there.poses.extend(home.poses);
}
