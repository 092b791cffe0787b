//! The connection of a planner to its fleet.

use std::fmt;
use std::path::Path;
use std::time::{Duration, Instant};

use joulebus_config::Config;
use joulebus_connect::ConnectError;
use joulebus_consumer::{Budgets, Event, Feed, Frame, PlanStates, ReadError, Subscriber, clock};
use joulebus_models::load_models;
use joulebus_plan::{Differs, PlanFleet, Robot, RobotRows};
use joulebus_wire::AnswerHeader;

/// Reads what plans start from, and answers questions about them. Belongs to one thread, as every
/// reader of shared memory. The [`Robot`]s that it gives do not.
///
/// The [crate](crate)'s page asks one robot. To find the robot for a task, ask all:
///
/// ```no_run
/// # use std::time::Duration;
/// # use joulebus_planner::Planner;
/// use joulebus_planner::plan::{Path, Point, rank};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut planner = Planner::connect("configs/fleet.toml")?;
/// let view = planner.wait(Duration::from_secs(1))?;
/// let robots: Vec<_> = view.ids().filter_map(|id| view.robot(id)).collect();
/// // In m, at 0.2 m/s, and back to the dock. The intervals cover 90 %.
/// let dock = Point::new(0.0, 0.0);
/// let path = Path::new(&[dock, Point::new(2.0, 1.0)], 0.2);
/// if let Some(best) = rank(&robots, &path, Some(dock), 0.9)?.first() {
///     println!("robot {}: {:?}", best.robot, best.trip.answer.verdict);
/// }
/// # Ok(())
/// # }
/// ```
pub struct Planner {
    subscriber: Subscriber,
    states: Feed<PlanStates>,
    budgets: Feed<Budgets>,
    fleet: PlanFleet,
}

/// Errors of reading the fleet's state.
///
/// ```no_run
/// # use joulebus_planner::{Planner, ViewError};
/// # fn example(planner: &mut Planner) {
/// match planner.wait(std::time::Duration::from_secs(1)) {
///     Ok(view) => println!("{} robots", view.ids().count()),
///     Err(ViewError::Nothing { waited_s, .. }) => println!("nothing within {waited_s} s"),
///     Err(error) => println!("{error}"),
/// }
/// # }
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ViewError {
    /// The frames could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The worker has other settings or models.
    #[error(transparent)]
    Differs(#[from] Differs),
    /// Nothing has arrived.
    #[error(
        "no frame of the fleet within {waited_s:.1} s: start its worker (`joulebus run --config …`), \
         or see `joulebus doctor`"
    )]
    Nothing { waited_s: f64 },
    /// A signal arrived while waiting.
    #[error("interrupted by a signal")]
    Interrupted,
}

impl Planner {
    /// Joins the fleet of the config file at `config_path`, and loads its models. The worker need
    /// not run. It writes what plans start from while at least one planner like this is connected:
    /// keep it for as long as there are questions.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn connect(config_path: impl AsRef<Path>) -> Result<Self, ConnectError> {
        Self::with_config(&Config::load(config_path)?, "planner")
    }

    /// Same as [`Planner::connect`], with a loaded config, and a name that is shown to operators.
    ///
    /// # Errors
    /// [`ConnectError`].
    pub fn with_config(config: &Config, name: &str) -> Result<Self, ConnectError> {
        let models = load_models(config).map_err(|error| ConnectError::Models(error.into()))?;
        let fleet = PlanFleet::new(config.settings(), &models);
        Self::with_fleet(config, name, fleet)
    }

    /// Same as [`Planner::with_config`], with models that are loaded already.
    ///
    /// # Errors
    /// [`ConnectError`].
    pub fn with_fleet(config: &Config, name: &str, fleet: PlanFleet) -> Result<Self, ConnectError> {
        let subscriber = Subscriber::with_config(config, name)?;
        Ok(Self {
            states: subscriber.plan_states()?,
            budgets: subscriber.budgets()?,
            subscriber,
            fleet,
        })
    }

    /// Settings and models.
    pub const fn fleet(&self) -> &PlanFleet {
        &self.fleet
    }

    /// The readers of the worker's other channels are opened with it.
    pub const fn subscriber(&self) -> &Subscriber {
        &self.subscriber
    }

    /// The newest frame, without waiting. `None` until the first has arrived. Its robots answer
    /// as of now: ask again for a newer view before the next questions.
    ///
    /// # Errors
    /// [`ViewError`]. The next call may succeed.
    pub fn view(&mut self) -> Result<Option<View<'_>>, ViewError> {
        // The state first: the budget of the same tick has been sent before it.
        let Some(states) = self.states.latest()? else {
            return Ok(None);
        };
        self.fleet.check(states.header())?;
        Ok(Some(View {
            states,
            budgets: self.budgets.latest()?,
            fleet: &self.fleet,
            now_ns: clock::monotonic_ns(),
        }))
    }

    /// Waits for a frame, and its budgets, that are at most two ticks old. After `timeout` returns
    /// what there is.
    ///
    /// # Errors
    /// [`ViewError`]. [`ViewError::Nothing`] if nothing has arrived.
    pub fn wait(&mut self, timeout: Duration) -> Result<View<'_>, ViewError> {
        let begun = Instant::now();
        while !self.is_current()? {
            let left = timeout.saturating_sub(begun.elapsed());
            if left.is_zero() {
                break;
            }
            if let Event::Interrupted = self.subscriber.wait_next(left)? {
                return Err(ViewError::Interrupted);
            }
        }
        let waited_s = begun.elapsed().as_secs_f64();
        self.view()?.ok_or(ViewError::Nothing { waited_s })
    }

    fn is_current(&mut self) -> Result<bool, ViewError> {
        let view = self.view()?;
        Ok(view.is_some_and(|view| view.is_current()))
    }
}

impl fmt::Debug for Planner {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Planner")
            .field("subscriber", &self.subscriber)
            .field("states", &self.states)
            .finish_non_exhaustive()
    }
}

/// The fleet as of one tick, read in shared memory.
///
/// ```no_run
/// # use joulebus_planner::{Planner, ViewError};
/// # fn example(planner: &mut Planner) -> Result<(), ViewError> {
/// if let Some(view) = planner.view()? {
///     println!("tick {}, {} ns old", view.tick(), view.age_ns());
///     println!("robot 7 is there: {}", view.robot(7).is_some());
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    states: Frame<'a, PlanStates>,
    budgets: Option<Frame<'a, Budgets>>,
    fleet: &'a PlanFleet,
    now_ns: u64,
}

impl<'a> View<'a> {
    /// The tick that it is of.
    pub const fn tick(&self) -> u64 {
        self.states.header().tick
    }

    /// Time since its frame was sent, ns.
    pub const fn age_ns(&self) -> u64 {
        self.now_ns.saturating_sub(self.states.header().sent_ns)
    }

    /// Ids of the fleet's robots, in no particular order.
    pub fn ids(&self) -> impl Iterator<Item = u32> + 'a {
        self.states.robots().iter().map(|row| row.robot)
    }

    /// A robot, if it is in the fleet.
    #[must_use]
    pub fn robot(&self, robot: u32) -> Option<Robot<'a>> {
        self.fleet.robot(&self.rows(robot)?.frames())
    }

    /// A copy of a robot's rows, if it is in the fleet.
    #[must_use]
    pub fn rows(&self, robot: u32) -> Option<RobotRows> {
        // Copied before it is looked at.
        let state = *self.states.robot(robot)?;
        let budget = self.budgets.as_ref().and_then(|budgets| {
            let row = *budgets.robot(robot)?;
            Some((*budgets.header(), row))
        });
        Some(RobotRows { header: *self.states.header(), state, budget, now_ns: self.now_ns })
    }

    /// States in an answer's header which frames it is computed from, and when. For the worker's
    /// thread that answers others.
    #[doc(hidden)]
    pub fn state_in(&self, answer: &mut AnswerHeader) {
        let states = self.states.header();
        answer.worker_epoch = states.worker_epoch;
        answer.tick = states.tick;
        answer.period_ns = states.period_ns;
        answer.sent_state_ns = states.sent_ns;
        answer.now_ns = self.now_ns;
        if let Some(budgets) = self.budgets.as_ref().map(Frame::header) {
            answer.budget_epoch = budgets.worker_epoch;
            answer.budget_tick = budgets.tick;
            answer.sent_budget_ns = budgets.sent_ns;
        }
    }

    /// True if both frames are of one run of the worker, and neither is stale, nor from the future
    /// by this process's clock.
    pub fn is_current(&self) -> bool {
        let header = self.states.header();
        let fresh =
            |sent_ns: u64| self.now_ns.abs_diff(sent_ns) <= header.period_ns.saturating_mul(2);
        let budgets = self.budgets.as_ref().map(Frame::header);
        fresh(header.sent_ns)
            && budgets.is_some_and(|of| of.worker_epoch == header.worker_epoch && fresh(of.sent_ns))
    }
}
