//! A fleet as a planner knows it: settings and models, without shared memory.

use joulebus_predictor::Model;
use joulebus_settings::FleetSettings;
use joulebus_wire::{LISTED_MODELS, PlanStateHeader, combine_hashes};

use crate::error::Differs;
use crate::platform::{Frames, Platform};
use crate::robot::Robot;

/// Settings and models of a fleet.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanFleet {
    platforms: Vec<Platform>,
    settings_hash: u64,
}

impl PlanFleet {
    /// A fleet of platforms with energy models of any origin. `settings_hash` is
    /// [`FleetSettings::fingerprint`].
    #[must_use]
    pub const fn of(platforms: Vec<Platform>, settings_hash: u64) -> Self {
        Self { platforms, settings_hash }
    }

    /// `models[i]` is the model of `settings.platforms[i]`. Further ones are ignored.
    #[must_use]
    pub fn new(settings: &FleetSettings, models: &[Model]) -> Self {
        let platforms = settings.platforms.iter().zip(models);
        let platforms = platforms.map(|(settings, model)| {
            let energy = model.energy_or_untrained(settings.power_max_w);
            Platform::new(settings.clone(), energy, model.hash())
        });
        Self::of(platforms.collect(), settings.fingerprint())
    }

    /// The platforms, in the order of the config.
    #[must_use]
    pub fn platforms(&self) -> &[Platform] {
        &self.platforms
    }

    /// Checks that the worker which sent a frame runs with these settings and models.
    ///
    /// # Errors
    /// [`Differs`] names the difference.
    pub fn check(&self, header: &PlanStateHeader) -> Result<(), Differs> {
        if header.settings_hash != self.settings_hash {
            return Err(Differs::Settings {
                found: header.settings_hash,
                expected: self.settings_hash,
            });
        }
        let listed = self.platforms.iter().take(LISTED_MODELS);
        for (platform, found) in listed.zip(header.models) {
            if platform.model_hash != found {
                return Err(Differs::Model {
                    platform: platform.settings.name.clone(),
                    found,
                    expected: platform.model_hash,
                });
            }
        }
        let expected = self.model_hash();
        if header.model_hash != expected {
            return Err(Differs::Model {
                platform: format!("1 to {}", self.platforms.len()),
                found: header.model_hash,
                expected,
            });
        }
        Ok(())
    }

    /// The hash of the models, computed like the worker's
    /// ([`joulebus_wire::ForecastHeader::model_hash`]).
    fn model_hash(&self) -> u64 {
        combine_hashes(self.platforms.iter().map(|platform| platform.model_hash))
    }

    /// A robot, from a copy of its rows. `None` if this fleet does not have its platform, which
    /// never happens for the rows of a worker that passes [`PlanFleet::check`].
    #[must_use]
    pub fn robot(&self, frames: &Frames<'_>) -> Option<Robot<'_>> {
        let platform = self.platforms.get(usize::from(frames.state.platform))?;
        let ranges = &platform.settings.robots;
        let is_its = ranges.iter().any(|ids| ids.contains(&frames.state.robot));
        is_its.then(|| Robot::new(platform, frames))
    }
}
