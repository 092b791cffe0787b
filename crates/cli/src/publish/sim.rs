//! `joulebus publish sim`: a simulated fleet.

use std::time::Duration;

use joulebus_bus::{clock, set_timer_slack};
use joulebus_config::Config;
use joulebus_plant::{Plant, SimReading};
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::Output;
use joulebus_program::stop::Stop;
use joulebus_publisher::{Grid, PublishError};
use joulebus_settings::Platform;
use joulebus_source::link::Link;
use joulebus_source::rate::{Hertz, seconds};
use joulebus_source::report::PublishReport;
use joulebus_wire::{Sample, sample_flag};

use super::fault::{self, FaultArgument};

/// Publish a simulated fleet of GTernal robots until SIGINT, SIGTERM or SIGHUP, then report
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus publish sim --robots 20 --seed 7\n  \
    joulebus publish sim --robots 5 --duration 60 --fault 3=load:1.5@20 --fault 4=stuck\n\n\
    Faults: load:WATT (additional power), noise:WATT (standard deviation), stuck \
    (the monitor repeats its last value).\n\
    Robots drive the paper's six trials in turn, the first robot from trial 1 on, the second from trial 2 \
    on. The same seed gives the same robots. Power and speed are a GTernal's, stretched to the \
    platform's limits.")]
pub(crate) struct Args {
    #[command(flatten)]
    config: ConfigFile,
    /// Number of robots
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    robots: u32,
    /// Seed of the robots and their motion
    #[arg(long, value_name = "N", default_value_t = 7)]
    seed: u64,
    /// End after this time, s [default: at a signal]
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    duration: Option<Duration>,
    /// Control ticks per second, Hz, 0.1 to 1000 [default: the platform's rate]
    #[arg(long, value_name = "HZ")]
    rate: Option<Hertz>,
    /// Inject a fault into a robot, optionally from a time on (may be repeated)
    #[arg(long = "fault", value_name = fault::HELP)]
    faults: Vec<FaultArgument>,
    /// Id of the first robot, of any platform, from which the others are numbered on [default: the
    /// ids of the config's first platform]
    #[arg(long, value_name = "ID")]
    first_robot: Option<u32>,
    /// Name of the source. A second source of the same name replaces the first [default: sim and
    /// the first robot's id]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let stop = Stop::on_signals()?;
    let config = args.config.load()?;
    let platform = args.platform(&config)?;
    let ids = args.ids(platform)?;
    let scale = Scale::new(platform);
    let plant = plant(args.seed, &ids, &args.faults, scale.power)?;
    let name = match &args.name {
        Some(name) => name.clone(),
        None => format!("sim-{}", ids[0]),
    };
    let mut link = Link::open(&config, &name)?;
    link.warn_without_worker()?;
    let mut source = Source {
        link,
        plant,
        scale,
        robots: ids.into_iter().map(Robot::new).collect(),
        frame: Vec::new(),
        report: PublishReport {
            fleet: config.fleet().to_owned(),
            source: name,
            robots: args.robots as usize,
            ..PublishReport::default()
        },
    };
    let period_ns = args.rate.map_or(platform.period_ns, Hertz::period_ns);
    source.play(period_ns, args.duration, &stop)?;
    output.report(&source.report)?;
    Ok(Outcome::unless_lost(source.report.has_lost()))
}

impl Args {
    fn platform<'a>(&self, config: &'a Config) -> Result<&'a Platform, UsageError> {
        let platforms = &config.settings().platforms;
        let has = |platform: &&Platform| {
            let mut ids = platform.robots.iter();
            self.first_robot.is_some_and(|first| ids.any(|ids| ids.contains(&first)))
        };
        let platform = platforms.iter().find(has).or(platforms.first());
        platform.ok_or_else(|| UsageError("the config has no platform".to_owned()))
    }

    /// Ids of the robots. As many as requested, at least one.
    fn ids(&self, platform: &Platform) -> Result<Vec<u32>, UsageError> {
        let wanted = self.robots as usize;
        let ids: Vec<u32> = match self.first_robot {
            Some(first) => (first..=u32::MAX).take(wanted).collect(),
            None => platform.robots.iter().cloned().flatten().take(wanted).collect(),
        };
        if ids.len() < wanted {
            let (found, name) = (ids.len(), &platform.name);
            return Err(UsageError(format!(
                "{wanted} robots requested, ids for {found}: enlarge the `robots` of platform \
                 {name} in the config, or give --first-robot"
            )));
        }
        Ok(ids)
    }
}

/// From the simulated GTernal to a platform: 1 for the limits of configs/platforms/gternal.toml.
#[derive(Clone, Copy)]
struct Scale {
    min_w: f32,
    power: f32,
    v: f32,
    omega: f32,
}

impl Scale {
    fn new(platform: &Platform) -> Self {
        let min_w = platform.power_min_w.max(0.0);
        Self {
            min_w,
            power: (platform.power_max_w - min_w) / 20.0,
            v: platform.v_max_mps / 0.25,
            omega: platform.omega_max_radps / 4.0,
        }
    }

    /// Volts of a GTernal would tell another robot a wrong charge.
    fn apply(self, sample: Sample, reading: &SimReading, measured_ns: u64) -> Sample {
        let power_w = self.min_w + self.power * reading.power_w;
        let sample = sample.reading(power_w, measured_ns);
        let sample = match self.v > 0.0 || self.omega > 0.0 {
            true => sample.command(self.v * reading.v_mps, self.omega * reading.omega_radps),
            false => sample,
        };
        match self.power == 1.0 {
            true => sample.battery(reading.voltage_v, reading.current_a),
            false => sample,
        }
    }
}

/// The simulated robots of some ids, at least one. Their power is scaled afterwards.
fn plant(seed: u64, ids: &[u32], faults: &[FaultArgument], scale: f32) -> anyhow::Result<Plant> {
    let mut plant = Plant::new(seed, ids.len());
    for FaultArgument { robot, fault, from_s } in faults {
        let place = ids.iter().position(|id| id == robot).ok_or_else(|| {
            let (first, last) = (ids[0], ids[ids.len() - 1]);
            UsageError(format!("--fault for robot {robot}, the robots are {first} to {last}"))
        })?;
        plant = plant.with_fault(place, fault::divided(*fault, f64::from(scale)), *from_s)?;
    }
    Ok(plant)
}

struct Robot {
    id: u32,
    seq: u64,
    /// Measurement time of the reading sent last, ns since the plant's start.
    measured_ns: Option<u64>,
}

impl Robot {
    const fn new(id: u32) -> Self {
        Self { id, seq: 0, measured_ns: None }
    }

    /// The sample of the robot at `stamp_ns`. The plant started at `base_ns`.
    fn sample(
        &mut self,
        reading: &SimReading,
        scale: Scale,
        stamp_ns: u64,
        base_ns: u64,
    ) -> Sample {
        let sample = Sample::new(self.id, self.seq, stamp_ns);
        let sample = scale.apply(sample, reading, base_ns.saturating_add(reading.measured_ns));
        // Not the plant's own flag: after skipped ticks the last reading *sent* counts.
        let held = self.measured_ns == Some(reading.measured_ns);
        self.measured_ns = Some(reading.measured_ns);
        self.seq += 1;
        sample.with(if held { sample_flag::HELD } else { 0 })
    }
}

struct Source {
    link: Link,
    plant: Plant,
    scale: Scale,
    robots: Vec<Robot>,
    frame: Vec<Sample>,
    report: PublishReport,
}

impl Source {
    /// Sends a frame at each grid time, until the end or a signal.
    fn play(
        &mut self,
        period_ns: u64,
        duration: Option<Duration>,
        stop: &Stop,
    ) -> Result<(), PublishError> {
        if let Err(error) = set_timer_slack() {
            tracing::warn!(%error, "frames may be sent 50 µs late");
        }
        let base_ns = clock::monotonic_ns();
        let end_ns = duration.map_or(u64::MAX, |duration| {
            base_ns.saturating_add(u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX))
        });
        let mut grid = Grid::new(base_ns.saturating_add(period_ns), period_ns);
        while grid.due_ns() <= end_ns && stop.sleep_until(grid.due_ns()) {
            let Some(slot) = grid.take(clock::monotonic_ns()) else {
                continue;
            };
            // After a stall the newest grid time is used. Earlier ones are skipped.
            let passed_ns = slot.skipped.saturating_mul(period_ns);
            let stamp_ns = slot.intended_ns.saturating_add(passed_ns);
            self.send(slot.intended_ns, stamp_ns, base_ns)?;
        }
        self.report.ticks_skipped = grid.skipped();
        self.report.duration_s = clock::monotonic_ns().saturating_sub(base_ns) as f64 / 1e9;
        Ok(())
    }

    fn send(&mut self, intended_ns: u64, stamp_ns: u64, base_ns: u64) -> Result<(), PublishError> {
        self.frame.clear();
        let robots = self.robots.iter_mut().zip(self.plant.advance(stamp_ns - base_ns));
        let scale = self.scale;
        self.frame
            .extend(robots.map(|(robot, reading)| robot.sample(reading, scale, stamp_ns, base_ns)));
        self.link.send(intended_ns, &self.frame, &mut self.report)?;
        Ok(())
    }
}
