//! Interpretation of a recording, by options or a mapping file.

use std::path::PathBuf;

use anyhow::Context as _;
use joulebus_capture_format::import::{CurrentSign, Mapping, RobotMapping, TimeSource};
use joulebus_program::exit::UsageError;

use crate::recordings::Sign;

/// Maximum size of a mapping, bytes.
const MAX_MAPPING_BYTES: u64 = 4 << 20;

/// Interpretation of a rosbag2 recording.
#[derive(Debug, clap::Args)]
pub(super) struct ImportArguments {
    /// A TOML file with the mapping of each robot
    #[arg(long, value_name = "FILE", conflicts_with_all = ["battery", "command", "odometry", "robot_name", "robot_id"])]
    mapping: Option<PathBuf>,
    /// Topic of the robot's BatteryState [default: each such topic is a robot]
    #[arg(long, value_name = "TOPIC")]
    battery: Option<String>,
    /// Topic of its Twist or TwistStamped [default: the one of its namespace]
    #[arg(long, value_name = "TOPIC", requires = "battery")]
    command: Option<String>,
    /// Topic of its Odometry [default: the one of its namespace]
    #[arg(long, value_name = "TOPIC", requires = "battery")]
    odometry: Option<String>,
    /// Its name in a dataset
    #[arg(long, value_name = "NAME", requires = "battery")]
    robot_name: Option<String>,
    /// Its id in a capture
    #[arg(long, value_name = "ID", requires = "battery")]
    robot_id: Option<u32>,
    /// Time to use [default: auto: the header's, or the log time where headers have none]
    #[arg(long, value_name = "CLOCK")]
    time: Option<Clock>,
    /// Readings within this time are one burst, of which the last is used, s (0 keeps all)
    /// [default: 0.005]
    #[arg(long, value_name = "SECONDS")]
    burst: Option<f64>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Clock {
    /// The header's if all have one, else the log time
    Auto,
    /// Measurement time
    Header,
    /// Log time
    Log,
    /// Publish time
    Publish,
}

impl ImportArguments {
    /// The mapping of file and options. Options take precedence.
    pub(super) fn mapping(&self, current: Option<Sign>) -> anyhow::Result<Mapping> {
        let mut mapping = match &self.mapping {
            None => Mapping::default(),
            Some(path) => {
                let named = || path.display().to_string();
                let text =
                    joulebus_files::read_to_string(path, MAX_MAPPING_BYTES).with_context(named)?;
                let parsed = text.parse::<Mapping>();
                parsed.map_err(|error| UsageError(format!("{}: {error}", named())))?
            }
        };
        if let Some(sign) = current {
            mapping.set_current(match sign {
                Sign::DischargeNegative => CurrentSign::DischargeNegative,
                Sign::DischargePositive => CurrentSign::DischargePositive,
            });
        }
        if let Some(clock) = self.time {
            mapping.time = match clock {
                Clock::Auto => TimeSource::Auto,
                Clock::Header => TimeSource::Header,
                Clock::Log => TimeSource::Log,
                Clock::Publish => TimeSource::Publish,
            };
        }
        if let Some(burst_s) = self.burst {
            mapping.burst_s = burst_s;
        }
        if let Some(battery) = &self.battery {
            mapping.robots = vec![self.robot(battery, mapping.current)];
        }
        mapping.check().map_err(|error| UsageError(error.to_string()))?;
        Ok(mapping)
    }

    fn robot(&self, battery: &str, current: CurrentSign) -> RobotMapping {
        let usual = battery.trim_start_matches('/').replace('/', "_");
        RobotMapping {
            name: self.robot_name.clone().unwrap_or(usual),
            id: self.robot_id,
            battery: battery.to_owned(),
            battery_wh: None,
            packs: Vec::new(),
            is_searched: true,
            command: self.command.clone(),
            odometry: self.odometry.clone(),
            current,
            voltage_unit_v: 1.0,
            current_unit_a: 1.0,
        }
    }
}
