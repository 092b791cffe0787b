//! Read-only inputs of a tick.

use std::ops::RangeInclusive;

use joulebus_predictor::Model;
use joulebus_predictor::simd::SimdLevel;
use joulebus_settings::{FleetSettings, SettingsError};

use crate::ingest::admission::AdmissionState;
use crate::tick::platform_context::PlatformContext;

/// Read-only inputs of a tick.
#[derive(Debug)]
pub(crate) struct TickContext {
    pub settings: FleetSettings,
    pub platforms: Vec<PlatformContext>,
    /// Instruction set of everything except the models, taken from the first platform's model.
    pub simd_level: SimdLevel,
    pub now_ns: u64,
    pub deadline_missed: bool,
}

impl TickContext {
    /// `models[i]` is the model of `settings.platforms[i]`.
    pub(crate) fn new(settings: FleetSettings, models: Vec<Model>) -> Result<Self, SettingsError> {
        if settings.platforms.len() != models.len() {
            return Err(SettingsError::Models {
                platforms: settings.platforms.len(),
                models: models.len(),
            });
        }
        let platforms = settings.platforms.iter().cloned().zip(models);
        let platforms: Vec<PlatformContext> = platforms
            .map(|(platform, model)| PlatformContext::new(platform, model, &settings))
            .collect();
        let simd_level =
            platforms.first().map_or_else(SimdLevel::best, |context| context.model.simd_level());
        Ok(Self { settings, platforms, simd_level, now_ns: 0, deadline_missed: false })
    }

    /// Ranges of robot ids, ascending, with the platform they belong to.
    pub(crate) fn robot_ranges(&self) -> Vec<(u32, u32, u16)> {
        let platforms = self.settings.platforms.iter().enumerate();
        let mut ranges: Vec<(u32, u32, u16)> = platforms
            .flat_map(|(index, platform)| {
                let span =
                    move |range: &RangeInclusive<u32>| (*range.start(), *range.end(), index as u16);
                platform.robots.iter().map(span)
            })
            .collect();
        ranges.sort_unstable();
        ranges
    }

    /// Time since a robot's last sample was taken, ns.
    #[inline(always)]
    pub(crate) fn silent_ns(&self, admission: &AdmissionState) -> u64 {
        self.now_ns.saturating_sub(admission.taken_ns)
    }

    /// True if a robot has been silent for longer than its platform allows.
    #[inline(always)]
    pub(crate) fn is_stale(&self, admission: &AdmissionState) -> bool {
        self.silent_ns(admission)
            > self.platforms[usize::from(admission.platform)].platform.stale_after_ns
    }
}
