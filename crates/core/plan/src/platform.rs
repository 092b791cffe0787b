//! A platform as a planner knows it, and the rows of its robots.

use joulebus_energy::EnergyModel;
use joulebus_settings::Platform as PlatformSettings;
use joulebus_wire::{AnswerHeader, Budget, BudgetHeader, PlanState, PlanStateHeader};

/// A platform with its energy model.
#[derive(Debug, Clone, PartialEq)]
pub struct Platform {
    /// Its settings.
    pub settings: PlatformSettings,
    /// Model of the energy of its commands.
    pub energy: EnergyModel,
    pub(crate) model_hash: u64,
}

impl Platform {
    /// `model_hash`: of the model file that the energy model is from.
    #[must_use]
    pub const fn new(settings: PlatformSettings, energy: EnergyModel, model_hash: u64) -> Self {
        Self { settings, energy, model_hash }
    }
}

/// The rows of one robot, with the headers of the frames that they are from, and the time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frames<'a> {
    /// Header of the frame of plan states.
    pub header: &'a PlanStateHeader,
    /// The robot's row.
    pub state: &'a PlanState,
    /// The robot's budget with its header, if there is one.
    pub budget: Option<(&'a BudgetHeader, &'a Budget)>,
    /// The time now, monotonic ns.
    pub now_ns: u64,
}

/// A copy of the rows of one robot, with the headers of their frames and the time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotRows {
    /// Header of the frame of plan states.
    pub header: PlanStateHeader,
    /// The robot's row.
    pub state: PlanState,
    /// The robot's budget with its header, if there is one.
    pub budget: Option<(BudgetHeader, Budget)>,
    /// The time, monotonic ns.
    pub now_ns: u64,
}

impl RobotRows {
    /// The inputs of a robot's answer beside its rows, as recorded with the answer.
    #[must_use]
    pub fn recorded(answer: &AnswerHeader, state: PlanState, budget: Option<Budget>) -> Self {
        let header = PlanStateHeader {
            worker_epoch: answer.worker_epoch,
            tick: answer.tick,
            sent_ns: answer.sent_state_ns,
            period_ns: answer.period_ns,
            ..PlanStateHeader::default()
        };
        let of = BudgetHeader {
            worker_epoch: answer.budget_epoch,
            tick: answer.budget_tick,
            sent_ns: answer.sent_budget_ns,
            ..BudgetHeader::default()
        };
        Self { header, state, budget: budget.map(|budget| (of, budget)), now_ns: answer.now_ns }
    }

    /// The rows as frames.
    #[must_use]
    pub fn frames(&self) -> Frames<'_> {
        Frames {
            header: &self.header,
            state: &self.state,
            budget: self.budget.as_ref().map(|(header, row)| (header, row)),
            now_ns: self.now_ns,
        }
    }
}
