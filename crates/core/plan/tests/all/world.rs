//! A fleet of one platform, and rows of its robots.
#![allow(dead_code, reason = "each test uses a part")]

use std::path::Path;

use joulebus_config::Config;
use joulebus_energy::{CommandModel, EnergyModel, EnergySample, EnergyState};
use joulebus_plan::{Frames, PlanFleet, Platform, Robot};
use joulebus_settings::FleetSettings;
use joulebus_wire::{
    Budget, BudgetHeader, PlanState, PlanStateHeader, Quality, SCHEMA_VERSION, budget_flag,
    plan_state_flag,
};

pub(crate) const PERIOD_NS: u64 = 33_333_333;
pub(crate) const NOW_NS: u64 = 1_000_000_000_000;
pub(crate) const CAPACITY_J: f64 = 36_000.0;
pub(crate) const SETTINGS_HASH: u64 = 77;
pub(crate) const MODEL_HASH: u64 = 99;

/// A command model of 3 W at rest, and errors of ±10 % at 90 %.
pub(crate) fn model() -> EnergyModel {
    let mut command = CommandModel::constant(3.0);
    command.weights[1] = 5.0;
    command.weights[4] = 0.4;
    command.weights[10] = 0.05;
    let quantiles = [-0.16, -0.1, -0.08, -0.04, 0.0, 0.04, 0.08, 0.1, 0.16];
    EnergyModel {
        command,
        calibrated: 6,
        errors: [quantiles; 6],
        v_mps: [-0.2, 0.2],
        omega_radps: [-2.0, 2.0],
        ..EnergyModel::untrained(3.6)
    }
}

pub(crate) fn settings() -> FleetSettings {
    let text = "[fleet]\nname = \"lab\"\n[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-99\"]\n\
                [platform.battery]\ncapacity_wh = 10.0\nreserve = 0.1\ninitial_soc_lo = 0.9\n";
    let config = Config::parse(text, Path::new("/nowhere")).expect("the config is valid");
    config.settings().clone()
}

pub(crate) fn platform() -> Platform {
    Platform::new(settings().platforms[0].clone(), model(), MODEL_HASH)
}

pub(crate) fn fleet() -> PlanFleet {
    PlanFleet::of(vec![platform()], SETTINGS_HASH)
}

/// The rows of a robot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows {
    pub(crate) header: PlanStateHeader,
    pub(crate) state: PlanState,
    pub(crate) budget_header: BudgetHeader,
    pub(crate) budget: Budget,
    pub(crate) has_budget: bool,
    pub(crate) now_ns: u64,
}

impl Rows {
    /// The rows of a robot that has drawn 3.6 W at rest for 20 s, with this much energy above its
    /// reserve.
    pub(crate) fn with_usable(usable_j: f64) -> Self {
        let mut energy = EnergyState::new(7);
        for _ in 0..600 {
            energy.observe(
                &model(),
                &EnergySample { power_w: 3.6, elapsed_s: 1.0 / 30.0, v_mps: 0.0, omega_radps: 0.0 },
            );
        }
        let mut models = [0; joulebus_wire::LISTED_MODELS];
        models[0] = MODEL_HASH;
        let (quality, quality_detail) = Quality::Fresh.encode();
        let left_j = usable_j + 0.1 * CAPACITY_J;
        let lo_j = 0.9 * usable_j + 0.1 * CAPACITY_J;
        Self {
            header: PlanStateHeader {
                schema: SCHEMA_VERSION,
                worker_epoch: 5,
                tick: 1_000,
                period_ns: PERIOD_NS,
                settings_hash: SETTINGS_HASH,
                model_hash: MODEL_HASH,
                models,
                sent_ns: NOW_NS,
                ..PlanStateHeader::default()
            },
            state: PlanState {
                robot: 7,
                flags: plan_state_flag::SAMPLE | plan_state_flag::LAGS | plan_state_flag::COMMAND,
                quality,
                quality_detail,
                v_mps: 0.0,
                omega_radps: 0.0,
                energy_j: energy.metered.energy_j,
                command_j: energy.metered.command_j,
                time_s: energy.metered.time_s,
                error_lower: energy.bounds.lower,
                error_upper: energy.bounds.upper,
                command_trust: energy.learned.command_trust,
                ..PlanState::default()
            },
            budget_header: BudgetHeader {
                schema: SCHEMA_VERSION,
                worker_epoch: 5,
                tick: 1_000,
                sent_ns: NOW_NS,
                ..BudgetHeader::default()
            },
            budget: Budget {
                robot: 7,
                flags: budget_flag::BATTERY | budget_flag::CHARGE | budget_flag::LEDGER,
                left_j: left_j as f32,
                usable_j: usable_j as f32,
                usable_lo_j: (0.9 * usable_j) as f32,
                soc: (left_j / CAPACITY_J) as f32,
                soc_lo: (lo_j / CAPACITY_J) as f32,
                soc_sd: (0.5 * (left_j - lo_j) / CAPACITY_J) as f32,
                ..Budget::default()
            },
            has_budget: true,
            now_ns: NOW_NS + 1_000_000,
        }
    }

    pub(crate) fn robot<'a>(&self, fleet: &'a PlanFleet) -> Robot<'a> {
        let frames = Frames {
            header: &self.header,
            state: &self.state,
            budget: self.has_budget.then_some((&self.budget_header, &self.budget)),
            now_ns: self.now_ns,
        };
        fleet.robot(&frames).expect("the robot is of the fleet")
    }
}
