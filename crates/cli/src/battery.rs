//! `joulebus battery`: what is known of the robots' batteries, and what a person states of one.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use joulebus_bus::NoWorker;
use joulebus_config::Config;
use joulebus_plan::report::{Joules, Lasting};
use joulebus_planner::PlanClient;
use joulebus_predictor_worker::{LearnedCapacity, learned_capacities};
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::Outcome;
use joulebus_program::output::{Output, log_line};
use joulebus_program::utc::Utc;
use joulebus_wire::{Budget, ChargeState, Statement, budget_flag};
use serde::Serialize;

use crate::alarms::person;
use crate::ask::refused;
use crate::budgets::budgets;

/// Timeout of an answer of the worker.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);
/// Timeout for a worker's budgets.
const PATIENCE: Duration = Duration::from_millis(2_500);

/// Show what is known of the robots' batteries, or state that one is full, exchanged or measured
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus battery                           all robots\n  \
    joulebus battery 7                         also the capacities learned, month by month\n  \
    joulebus battery 7 --full                  its charger or a person says so\n  \
    joulebus battery 7 --charge .8 --by ann    a display or a meter says 80 %\n  \
    joulebus battery 7 --exchanged             another battery, charged like the first\n\n\
    Time without readings widens the bounds by all that the robot could have drawn, and after a \
    night nothing is known. A statement ends that. The worker's next tick takes it and counts from \
    there. Its log and a capture name who stated it, and a replay computes the same. \
    It is as good as the config says: `sensor_sd` for --charge, 1 % for --full, `initial_soc_lo` \
    for --exchanged. A robot that sends state_of_charge needs none.\n\
    Exit code 1: no worker, or it did not take the statement.")]
pub(crate) struct Args {
    #[command(flatten)]
    config: ConfigFile,
    /// Only this robot, of which --full, --charge and --exchanged state something
    #[arg(value_name = "ROBOT")]
    robot: Option<u32>,
    /// Its battery is full
    #[arg(long, group = "statement", requires = "robot")]
    full: bool,
    /// Its battery was measured: state of charge, 0 to 1
    #[arg(long, group = "statement", requires = "robot", value_name = "SHARE", value_parser = share)]
    charge: Option<f32>,
    /// Its battery was exchanged
    #[arg(long, group = "statement", requires = "robot")]
    exchanged: bool,
    /// Who states it [default: the user's name, from the environment]
    #[arg(long, value_name = "NAME", requires = "statement")]
    by: Option<String>,
}

fn share(text: &str) -> Result<f32, String> {
    let found = text.parse().ok().filter(|share| (0.0..=1.0).contains(share));
    found.ok_or_else(|| format!("{text} is no state of charge, allowed are 0 to 1"))
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let statement = match (args.full, args.charge, args.exchanged) {
        (true, ..) => Some(Statement::Full),
        (_, Some(soc), _) => Some(Statement::Charge(soc)),
        (.., true) => Some(Statement::Exchanged),
        _ => None,
    };
    let config = args.config.load()?;
    let (Some(robot), Some(statement)) = (args.robot, statement) else {
        return list(&config, args.robot, output);
    };
    let by = person(args.by.as_deref())?;
    let mut client = PlanClient::with_config(&config, "battery")?;
    let taken = client.state_battery(robot, statement, &by, ANSWER_TIMEOUT);
    taken.map_err(|error| refused(error, &config))?;
    let fleet = config.fleet().to_owned();
    output.report(&Stated { fleet, robot, statement: statement.to_string(), by })?;
    Ok(Outcome::Done)
}

/// The statement that the worker has taken.
#[derive(Debug, Serialize)]
struct Stated {
    fleet: String,
    robot: u32,
    statement: String,
    by: String,
}

impl fmt::Display for Stated {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "robot {}: {}, states {}", self.robot, self.statement, self.by)
    }
}

fn list(config: &Config, robot: Option<u32>, output: Output) -> anyhow::Result<Outcome> {
    let robots: Vec<u32> = robot.into_iter().collect();
    let (found, seen) = budgets(config, "battery", &robots, PATIENCE)?;
    let saved = learned_capacities(config);
    let robots = found.iter().map(|budget| BatteryRecord::new(budget, &saved)).collect();
    let list = BatteryList { fleet: config.fleet().to_owned(), robots };
    if list.robots.is_empty() {
        let why = match (seen, robot) {
            (true, Some(robot)) => {
                format!("robot {robot} is not in the fleet: no source publishes samples of it")
            }
            (true, None) => "no robot is in the fleet: no source publishes samples".to_owned(),
            (false, _) => NoWorker::seen_nowhere(&config.domain()?).to_string(),
        };
        log_line(&why);
        return Ok(Outcome::Failed);
    }
    output.report(&list)?;
    Ok(Outcome::Done)
}

#[derive(Debug, Serialize)]
struct BatteryList {
    fleet: String,
    robots: Vec<BatteryRecord>,
}

/// What is known of a robot's battery. Shares of the capacity, from 0 to 1.
#[derive(Debug, Serialize)]
struct BatteryRecord {
    robot: u32,
    /// False if the robot's platform has none.
    battery: bool,
    soc: Option<f64>,
    soc_lo: Option<f64>,
    soc_hi: Option<f64>,
    usable_j: Option<f64>,
    time_to_empty_s: Option<f64>,
    charging: bool,
    off: bool,
    idle_w: Option<f64>,
    /// Time without readings since the charge was known, s, and by how much it may have lowered it.
    pause_s: f64,
    pause: f64,
    /// What a pause cost, and what to do.
    note: Option<String>,
    /// Learned capacity and its standard deviation, J.
    capacity_j: Option<f64>,
    capacity_sd_j: Option<f64>,
    /// Time on the charger by earlier charges, s.
    time_to_80_s: Option<f64>,
    time_to_full_s: Option<f64>,
    /// Learned capacities, the last of each month, as the worker on this host has saved them.
    months: Vec<LearnedCapacity>,
}

impl BatteryRecord {
    fn new(budget: &Budget, saved: &BTreeMap<u32, Vec<LearnedCapacity>>) -> Self {
        let number = |value: f32| value.is_finite().then_some(f64::from(value));
        Self {
            robot: budget.robot,
            battery: budget.flags & budget_flag::BATTERY != 0,
            soc: number(budget.soc),
            soc_lo: number(budget.soc_lo),
            soc_hi: number(budget.soc_hi),
            usable_j: number(budget.usable_j),
            time_to_empty_s: number(budget.time_to_empty_s),
            charging: budget.charge_state() == ChargeState::Charging,
            off: budget.flags & budget_flag::OFF != 0,
            idle_w: number(budget.idle_w),
            pause_s: budget.pause_s.into(),
            pause: budget.pause.into(),
            note: budget.pause_note(),
            capacity_j: budget.learned_capacity_j().map(|(joules, _)| joules.into()),
            capacity_sd_j: budget.learned_capacity_j().map(|(_, sd_j)| sd_j.into()),
            time_to_80_s: budget.charging_s(budget.soc.into(), 0.8),
            time_to_full_s: budget.charging_s(budget.soc.into(), 1.0),
            months: saved.get(&budget.robot).cloned().unwrap_or_default(),
        }
    }
}

/// A capacity and its standard deviation, J, as people read it: with two of them.
struct Capacity(f64, f64);

impl fmt::Display for Capacity {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(capacity_j, sd_j) = *self;
        let [lo, hi] = [(capacity_j - 2.0 * sd_j).max(0.0), capacity_j + 2.0 * sd_j].map(Joules);
        write!(out, "{} ({lo} to {hi})", Joules(capacity_j))
    }
}

impl fmt::Display for BatteryList {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for robot in &self.robots {
            write!(out, "robot {}: ", robot.robot)?;
            let percent = |share: Option<f64>| share.map_or(f64::NAN, |share| 100.0 * share);
            match (robot.battery, robot.soc) {
                (false, _) => write!(out, "{}", joulebus_settings::NO_BATTERY)?,
                (true, None) => write!(out, "charge unknown")?,
                (true, soc) => write!(
                    out,
                    "{:.0} % ({:.0} to {:.0})",
                    percent(soc),
                    percent(robot.soc_lo),
                    percent(robot.soc_hi)
                )?,
            }
            if robot.charging {
                write!(out, ", charging")?;
            }
            if robot.off {
                write!(out, ", switched off")?;
            }
            if let Some((capacity_j, sd_j)) = robot.capacity_j.zip(robot.capacity_sd_j) {
                write!(out, ", capacity {}", Capacity(capacity_j, sd_j))?;
            }
            if let Some(time_s) = robot.time_to_full_s.filter(|_| robot.charging) {
                write!(out, ", full in {}", Lasting(time_s))?;
            }
            match &robot.note {
                Some(note) => writeln!(out, ". {note}")?,
                None => writeln!(out)?,
            }
            // One line a robot, unless one is asked about.
            for month in robot.months.iter().filter(|_| self.robots.len() == 1) {
                let date = Utc::new(month.unix_s.saturating_mul(1_000_000_000)).date();
                let capacity = Capacity(month.capacity_j.into(), month.capacity_sd_j.into());
                writeln!(out, "  {date}  {capacity}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_has_the_learned_capacity_and_that_of_one_robot_its_months() {
        let of = |robot| Budget {
            robot,
            flags: budget_flag::BATTERY | budget_flag::CHARGE,
            charge_state: ChargeState::Charging.code(),
            soc: 0.5,
            soc_lo: 0.4,
            soc_hi: 0.6,
            capacity_j: 28_800.0,
            capacity_sd_j: 720.0,
            charge_rate: [500; joulebus_wire::CHARGE_TENTHS],
            ..Budget::default()
        };
        let (unix_s, capacity_j, capacity_sd_j) = (1_790_000_000, 32_400.0, 1_080.0);
        let saved = LearnedCapacity { unix_s, capacity_j, capacity_sd_j };
        let saved = BTreeMap::from([(7, vec![saved])]);
        let list = |robots: &[u32]| {
            let robots = robots.iter().map(|robot| BatteryRecord::new(&of(*robot), &saved));
            BatteryList { fleet: "lab".to_owned(), robots: robots.collect() }.to_string()
        };
        let known =
            "50 % (40 to 60), charging, capacity 8.00 Wh (7.60 Wh to 8.40 Wh), full in 60.0 min";
        let month = "  2026-09-21  9.00 Wh (8.40 Wh to 9.60 Wh)";
        assert_eq!(list(&[7]), format!("robot 7: {known}\n{month}\n"));
        assert_eq!(list(&[7, 8]), format!("robot 7: {known}\nrobot 8: {known}\n"));
    }
}
