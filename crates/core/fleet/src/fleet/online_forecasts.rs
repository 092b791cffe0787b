//! Forecasts that learn online, without a fleet: the estimates of the tick for rows of a member's
//! forecasts and readings.
//!
//! Samples, clocks and features are the caller's. So any regressor can take the network's part.

use joulebus_predictor::nan::canonical;
use joulebus_predictor::{Model, ResidualStats};
use joulebus_settings::IntervalSettings;
use serde::{Deserialize, Serialize};

use crate::estimate::interval::{ConformalInterval, IntervalLanes, QuantileStep};
use crate::estimate::online::{Learned, Members, Online, OnlineLanes};
use crate::estimate::window::{Window, WindowLanes};
use crate::layout::lanes::{self, LANES};
use crate::layout::versions;
use crate::state::snapshot::StateError;
use crate::tick::platform_context::PossiblePower;

/// First bytes of the encoding. The last of them is its version.
const MAGIC: [u8; 8] = *b"jbonlin\x03";
/// The oldest version that is read too, and the version of the fleets' states of its time.
const OLDEST: (u8, u8) = (2, 0x12);

/// Settings of [`OnlineForecasts`], with the meaning that they have for a platform.
#[derive(Debug, Clone, Copy)]
pub struct OnlineSettings {
    /// The intervals' coverage and rate.
    pub interval: IntervalSettings,
    /// True if robots learn online. Otherwise the member's forecasts are taken as they are, and
    /// only the intervals adapt.
    pub online: bool,
    /// Resolution of the readings, W, above 0.
    pub resolution_w: f32,
    /// Least possible reading, W.
    pub power_min_w: f32,
    /// Largest possible reading, W.
    pub power_max_w: f32,
    /// Maximum number of successive missing readings that its own forecasts bridge.
    pub longest_steps: u16,
}

/// A forecast and the ends of its interval, W. NaN if there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IntervalForecast {
    /// The reading expected next.
    pub power_w: f32,
    /// Lower end.
    pub lo_w: f32,
    /// Upper end.
    pub hi_w: f32,
}

/// The estimates of one robot.
#[derive(Debug, Clone, Copy)]
struct Robot {
    window: Window,
    online: Online,
    interval: ConformalInterval,
}

/// Learned state of the robots. The lanes of the last block that are beyond `robots` are unused.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Columns {
    robots: usize,
    windows: Vec<WindowLanes>,
    online: Vec<OnlineLanes>,
    intervals: Vec<IntervalLanes>,
}

impl Columns {
    fn get(&self, robot: usize) -> Robot {
        Robot {
            window: lanes::get(&self.windows, robot),
            online: lanes::get(&self.online, robot),
            interval: lanes::get(&self.intervals, robot),
        }
    }

    fn set(&mut self, robot: usize, state: &Robot) {
        lanes::set(&mut self.windows, robot, state.window);
        lanes::set(&mut self.online, robot, state.online);
        lanes::set(&mut self.intervals, robot, state.interval);
    }

    fn are_whole(&self) -> bool {
        let blocks = self.robots.div_ceil(LANES);
        [self.windows.len(), self.online.len(), self.intervals.len()] == [blocks; 3]
    }
}

/// The forecasts of some robots, each from its own readings and a member's forecasts.
#[derive(Debug, Clone)]
pub struct OnlineForecasts {
    members: Option<Members>,
    residual: ResidualStats,
    quantile_step: QuantileStep,
    settings: OnlineSettings,
    columns: Columns,
}

impl OnlineForecasts {
    /// Without robots. Autoregression, training range and residuals are those on the model's card.
    /// The model itself forecasts nothing here.
    pub fn new(model: &Model, settings: OnlineSettings) -> Self {
        let residual = model.residual();
        let sigma_w = residual.std_w.max(settings.resolution_w);
        let members = settings.online.then(|| Members::new(model, sigma_w, settings.resolution_w));
        Self {
            members: members.flatten(),
            residual,
            quantile_step: QuantileStep::new(&settings.interval),
            settings,
            columns: Columns::default(),
        }
    }

    /// Number of robots.
    pub fn len(&self) -> usize {
        self.columns.robots
    }

    /// True if there is no robot.
    pub fn is_empty(&self) -> bool {
        self.columns.robots == 0
    }

    /// Adds a robot that has read nothing yet. Returns its index.
    pub fn add(&mut self) -> usize {
        let columns = &mut self.columns;
        if columns.robots.is_multiple_of(LANES) {
            columns.windows.push(WindowLanes::default());
            columns.online.push(OnlineLanes::default());
            columns.intervals.push(IntervalLanes::default());
        }
        columns.robots += 1;
        let robot = columns.robots - 1;
        self.reset(robot);
        robot
    }

    /// Forgets what a robot has read.
    pub fn reset(&mut self, robot: usize) {
        self.columns.set(robot, &self.fresh());
    }

    /// The forecast of a robot's next reading, given the member's finite forecast of it. `None`
    /// stands for a robot that has read nothing. While the robot has read less than a forecast
    /// takes, it is the member's own.
    pub fn forecast(&self, robot: Option<usize>, member_w: f32) -> IntervalForecast {
        let robot = robot.map_or_else(|| self.fresh(), |robot| self.columns.get(robot));
        self.ahead(&robot, member_w)
    }

    /// Takes a robot's next reading, W, and whether it is a repeated measurement. NaN if there was
    /// none. Returns the [forecast](Self::forecast) that was made before it.
    pub fn read(
        &mut self,
        robot: usize,
        member_w: f32,
        reading_w: f32,
        held: bool,
    ) -> IntervalForecast {
        let made = self.ahead(&self.columns.get(robot), member_w);
        let known = !made.power_w.is_nan();
        let windows = &mut self.columns.windows[robot / LANES];
        windows.forecast(robot % LANES, known, made.power_w);
        let Robot { mut window, mut online, mut interval } = self.columns.get(robot);
        if known {
            online.network_w = member_w;
        }
        if reading_w.is_nan() {
            window.miss(self.settings.longest_steps);
        } else {
            let (scored, due) = (window.is_scored(), window.due());
            if let Some(members) = &self.members {
                if scored && window.is_full() {
                    online.learn(members, &window.lags_w(), due, reading_w);
                }
                online.read(members, window.last_w(), due, reading_w);
            }
            window.read(reading_w, !held);
            if scored {
                let residual_w = reading_w - made.power_w;
                let floor_w = self.settings.resolution_w;
                interval.observe(residual_w, due, floor_w, self.quantile_step);
            }
        }
        self.columns.set(robot, &Robot { window, online, interval });
        made
    }

    /// A robot's learned forecast state. `None` if robots do not learn online.
    pub fn learned(&self, robot: usize) -> Option<Learned> {
        let (members, online) = (self.members?, self.columns.get(robot).online);
        Some(online.learned(&online.weights(members.sceptic_loss)))
    }

    /// Encodes what the robots have learned.
    pub fn to_bytes(&self) -> Vec<u8> {
        // Serialisation into a growing vector of known lengths cannot fail.
        postcard::to_extend(&self.columns, MAGIC.to_vec()).unwrap_or_default()
    }

    /// Replaces what the robots have learned by what [`Self::to_bytes`] encoded.
    ///
    /// # Errors
    /// [`StateError::Version`] or [`StateError::Malformed`].
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let decoded = match bytes.strip_prefix(&MAGIC[..7]) {
            Some([version, encoded @ ..]) if *version == MAGIC[7] => postcard::from_bytes(encoded),
            Some([version, encoded @ ..]) if *version == OLDEST.0 => {
                versions::decode_version(OLDEST.1, || postcard::from_bytes(encoded))
            }
            _ => {
                let found = bytes.iter().take(MAGIC.len()).copied().collect();
                return Err(StateError::Version { found, oldest: OLDEST.0, expected: MAGIC[7] });
            }
        };
        let malformed =
            |reason: &str| StateError::Malformed { bytes: bytes.len(), reason: reason.to_owned() };
        let columns: Columns = decoded.map_err(|error| malformed(&error.to_string()))?;
        if !columns.are_whole() {
            return Err(malformed("its columns differ in length"));
        }
        self.columns = columns;
        Ok(())
    }

    fn fresh(&self) -> Robot {
        let (residual, settings) = (&self.residual, &self.settings);
        let (floor_w, coverage) = (settings.resolution_w, settings.interval.coverage);
        Robot {
            window: Window::EMPTY,
            online: self
                .members
                .as_ref()
                .map_or(Online::NONE, |members| Online::new(members, false)),
            interval: ConformalInterval::new(residual.q05_w, residual.q95_w, floor_w, coverage),
        }
    }

    fn ahead(&self, robot: &Robot, member_w: f32) -> IntervalForecast {
        let (window, online) = (&robot.window, &robot.online);
        let settings = &self.settings;
        let possible = PossiblePower { min_w: settings.power_min_w, max_w: settings.power_max_w };
        // As in the tick: where robots learn nothing, nobody else judges the output of the member.
        let is_number =
            member_w.is_finite() & (self.members.is_some() | possible.is_near(member_w));
        let (due, unread) = (window.due(), window.unread_steps);
        let power_w = match &self.members {
            _ if !is_number => f32::NAN,
            Some(members) if window.is_full() => {
                online.forecast(members, &window.lags_w(), member_w, due)
            }
            _ => member_w,
        };
        let power_w = possible.nearest(power_w);
        let (lo_w, hi_w) = robot.interval.around(power_w, unread, due);
        let [power_w, lo_w, hi_w] = [power_w, lo_w, hi_w].map(canonical);
        IntervalForecast { power_w, lo_w, hi_w }
    }
}
