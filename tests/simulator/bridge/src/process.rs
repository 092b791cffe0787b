//! A bridge, without its process and its connections.

use std::sync::Arc;
use std::time::Duration;

use joulebus_board::Board;
use joulebus_bus::{Background, clock};
use joulebus_config::Config;
use joulebus_plausibility::{Expired, Kind, Origin};
use joulebus_publisher::Judgement;
use joulebus_settings::ChargeReading;

use crate::mapping::intake::{Holds, Intake};
use crate::mapping::observation::{Observation, PowerOf, PowerReading};
use crate::mapping::robots::Robots;
use crate::outbound::{self, Sink, Times};
use crate::publishing::{self, PublishedRecord};
use crate::shared::Shared;

/// Interval of the most frequent topic that is written. It polls fleets with shorter ticks, and
/// ticks of others wake it.
const WRITE_EVERY: Duration = Duration::from_secs(1);

#[allow(missing_debug_implementations, reason = "its ports have none")]
pub struct Bridge {
    shared: Arc<Shared>,
    publishing: Background<anyhow::Result<PublishedRecord>>,
    writing: Background<anyhow::Result<()>>,
}

struct Screen<F>(F);

impl<F: FnMut(&Board) + Send> Sink for Screen<F> {
    fn publish(&mut self, board: &Board, _: Times) {
        (self.0)(board);
    }

    fn finish(&mut self) {}
}

impl Bridge {
    /// Starts a bridge of `robots`, whose messages come `every` so often. It gives `show` each
    /// board that it has read.
    ///
    /// # Errors
    /// Those of the program.
    pub fn start(
        config: &Config,
        name: &str,
        (robots, every): (&[u32], Duration),
        show: impl FnMut(&Board) + Send + 'static,
    ) -> anyhow::Result<Self> {
        let mut named = Robots::default();
        for robot in robots {
            named.add(&format!("robot-{robot}"), &robot.to_string())?;
        }
        let every_ns = every.as_nanos() as u64;
        let holds = Holds {
            command_ns: 10 * every_ns,
            expired: Expired::Unknown,
            reading_ns: 5 * every_ns,
            silent_ns: 30 * every_ns,
        };
        let charge = robots.iter().map(|robot| (*robot, ChargeReading::Load));
        // Findings are written into files, which are not simulated.
        let judgement = Judgement::new(Origin::Bridge, Kind::ALL.to_vec());
        let intake = Intake::new(holds, false, charge).judged_by(judgement);
        let shared = Arc::new(Shared::new(intake, None));
        let publishing = publishing::start(config, name, &named, &shared)?;
        let sides: Vec<Box<dyn Sink>> = vec![Box::new(Screen(show))];
        let writing = outbound::start(config, name, (WRITE_EVERY, true), sides)?;
        Ok(Self { shared, publishing, writing })
    }

    /// A message of a robot comes.
    pub fn observe(&self, robot: u32, v_mps: f32, power_w: f32) {
        let seen = Observation {
            v_mps: Some(v_mps),
            omega_radps: Some(0.0),
            power: Some(PowerReading { power_w, of: PowerOf::Load }),
            ..Observation::default()
        };
        let now_ns = clock::monotonic_ns();
        self.shared.intake().take(robot, &seen, now_ns);
    }

    /// True if a thread has ended by itself.
    pub fn has_ended(&self) -> bool {
        self.publishing.has_ended() || self.writing.has_ended()
    }

    /// Ends the bridge.
    ///
    /// # Errors
    /// A thread's error.
    pub fn finish(self) -> anyhow::Result<()> {
        let published = self.publishing.join().map(drop);
        self.writing.join().and(published)
    }
}
