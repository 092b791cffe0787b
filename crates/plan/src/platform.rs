//! A platform as a planner knows it, and the rows of its robots.

use joulebus_energy::EnergyModel;
use joulebus_settings::Platform as PlatformSettings;
use joulebus_wire::{Budget, BudgetHeader, PlanState, PlanStateHeader};

/// A platform with its energy model.
#[derive(Debug, Clone, PartialEq)]
pub struct Platform {
    /// Its settings.
    pub settings: PlatformSettings,
    /// What is known of the energy of its commands.
    pub energy: EnergyModel,
    pub(crate) model_hash: u64,
}

impl Platform {
    /// `model_hash`: of the model file that the energy model is from.
    #[must_use]
    pub const fn new(settings: PlatformSettings, energy: EnergyModel, model_hash: u64) -> Self {
        Self {
            settings,
            energy,
            model_hash,
        }
    }
}

/// The rows of one robot, with the headers of the frames that they are from, and the time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frames<'a> {
    /// Of the frame of plan states.
    pub header: &'a PlanStateHeader,
    /// The robot's row.
    pub state: &'a PlanState,
    /// The robot's budget with its header, if there is one.
    pub budget: Option<(&'a BudgetHeader, &'a Budget)>,
    /// The time now, monotonic ns.
    pub now_ns: u64,
}
