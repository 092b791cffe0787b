//! The product in a mission: the fleet's core on the robots' samples, and the values that planners
//! read.

use joulebus_config::Config;
use joulebus_fleet::Fleet;
use joulebus_models::load_models;
use joulebus_plan::follow::Follower;
use joulebus_plan::{Frames, Platform, Point, Robot};
use joulebus_predictor::Model;
use joulebus_wire::{
    Alarm, Budget, BudgetHeader, PlanState, PlanStateHeader, SCHEMA_VERSION, Sample, SampleHeader,
};

use crate::error::MissionError;
use crate::scenario::{OMEGA_MAX_RADPS, SPEED_MPS, Scenario};

/// Interval of a plan's steps, ns. Robots are commanded at the platform's rate.
const PLAN_STEP_NS: u64 = 200_000_000;

/// Settings and models of the fleet.
#[derive(Debug)]
pub(crate) struct Product {
    config: Config,
    models: Vec<Model>,
    plans: joulebus_plan::PlanFleet,
    /// The follower that drives, at the platform's rate.
    pub follower: Follower,
    /// The follower that plans.
    pub planned: Follower,
    /// The path home from anywhere.
    pub home: [Point; 2],
}

impl Product {
    /// Creates the broker of a scenario, with a share of each battery kept in reserve.
    pub(crate) fn new(scenario: &Scenario, reserve: f64) -> Result<Self, MissionError> {
        let capacity_wh = scenario.capacity_j / 3600.0;
        let (robots, charge_w) = (scenario.robots, scenario.charge_w);
        let text = format!(
            "[fleet]\nname = \"mission\"\ncapacity = {robots}\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-{}\"]\n\
             v_max_mps = {SPEED_MPS:?}\nomega_max_radps = {OMEGA_MAX_RADPS:?}\n\
             [platform.battery]\ncapacity_wh = {capacity_wh:?}\nreserve = {reserve:?}\ninitial_soc_lo = 1.0\n\
             charge_power_w = {charge_w:?}\n",
            robots.saturating_sub(1)
        );
        let config = Config::parse(&text, std::path::Path::new("mission.toml"))?;
        let models = load_models(&config)?;
        let settings = config.settings();
        // The config has one platform.
        let (platform, model) = (&settings.platforms[0], &models[0]);
        let energy = model.energy_or_untrained(platform.power_max_w);
        let at_rate = Platform::new(platform.clone(), energy.clone(), model.hash());
        let mut coarse = platform.clone();
        coarse.period_ns = PLAN_STEP_NS;
        let coarse = Platform::new(coarse, energy, model.hash());
        let follower = |platform| Follower::new(platform).map_err(MissionError::from);
        Ok(Self {
            follower: follower(&at_rate)?,
            planned: follower(&coarse)?,
            home: scenario.home(),
            plans: joulebus_plan::PlanFleet::of(vec![coarse], settings.fingerprint()),
            config,
            models,
        })
    }

    pub(crate) fn period_ns(&self) -> u64 {
        self.config.settings().platforms[0].period_ns
    }

    pub(crate) fn model(&self) -> &Model {
        &self.models[0]
    }

    /// A fleet before its first sample.
    pub(crate) fn broker(&self) -> Result<Broker<'_>, MissionError> {
        let fleet = Fleet::new(self.config.settings().clone(), self.models.clone())?;
        let header = PlanStateHeader {
            schema: SCHEMA_VERSION,
            worker_epoch: 1,
            period_ns: self.period_ns(),
            settings_hash: fleet.settings_hash(),
            model_hash: fleet.model_hash(),
            models: fleet.model_hashes(),
            ..PlanStateHeader::default()
        };
        self.plans.check(&header)?;
        Ok(Broker {
            product: self,
            places: vec![None; self.config.settings().capacity as usize],
            fleet,
            header,
            frames: 0,
            sent: 0,
            now_ns: 0,
        })
    }
}

/// A fleet in a mission.
#[derive(Debug)]
pub(crate) struct Broker<'a> {
    pub product: &'a Product,
    fleet: Fleet,
    header: PlanStateHeader,
    /// Place of each robot.
    places: Vec<Option<usize>>,
    frames: u64,
    sent: u64,
    now_ns: u64,
}

impl Broker<'_> {
    /// Executes a tick with the samples of one control step.
    pub(crate) fn tick(&mut self, samples: &[Sample], now_ns: u64) {
        let header = SampleHeader {
            schema: SCHEMA_VERSION,
            source_id: 1,
            source_epoch: 1,
            frame_seq: self.frames,
            samples_before: self.sent,
            intended_ns: now_ns,
            sent_ns: now_ns,
            ..SampleHeader::default()
        };
        self.frames += 1;
        self.sent += samples.len() as u64;
        self.now_ns = now_ns;
        self.fleet.take(&header, samples, now_ns);
        self.fleet.tick(now_ns, false);
    }

    /// Finds the robots again, before questions about them.
    pub(crate) fn find(&mut self) {
        self.places.fill(None);
        for place in 0..self.fleet.len() {
            let robot = self.fleet.budget(place).robot as usize;
            self.places[robot] = Some(place);
        }
    }

    /// Samples that were refused.
    pub(crate) fn refused(&self) -> u64 {
        self.sent - self.fleet.accepted()
    }

    /// The rows that a planner reads of a robot. `None` if the robot has left or has not reported
    /// yet.
    pub(crate) fn state(&self, robot: usize) -> Option<(PlanState, Budget)> {
        let place = self.places[robot]?;
        Some((self.fleet.plan_state(place), self.fleet.budget(place)))
    }

    /// The robot for questions.
    pub(crate) fn robot(&self, (state, budget): &(PlanState, Budget)) -> Option<Robot<'_>> {
        let header = PlanStateHeader { tick: self.frames, sent_ns: self.now_ns, ..self.header };
        let of = BudgetHeader {
            schema: SCHEMA_VERSION,
            worker_epoch: header.worker_epoch,
            tick: header.tick,
            sent_ns: header.sent_ns,
            ..BudgetHeader::default()
        };
        self.product.plans.robot(&Frames {
            header: &header,
            state,
            budget: Some((&of, budget)),
            now_ns: self.now_ns,
        })
    }

    /// True if the robot's `CannotReturn` alarm is raised.
    pub(crate) fn cannot_return(&self, robot: usize) -> bool {
        self.places[robot].is_some_and(|place| {
            let diagnostic = self.fleet.diagnostic(place);
            diagnostic.alarms().has(Alarm::CannotReturn)
        })
    }
}
