//! Searches among robots, and the platforms that they name.

use std::ops::RangeInclusive;

use joulebus_settings::FleetSettings;
use joulebus_wire::{Alarm, AlarmSet, Level};

use crate::board::Newest;
use crate::record::quality_name;

/// Names of platforms, with their robots.
#[derive(Debug, Clone, Default)]
pub struct Platforms {
    names: Vec<String>,
    robots: Vec<(RangeInclusive<u32>, usize)>,
}

impl Platforms {
    /// The platforms of a fleet.
    #[must_use]
    pub fn new(settings: &FleetSettings) -> Self {
        let mut platforms = Self::default();
        for (place, platform) in settings.platforms.iter().enumerate() {
            platforms.names.push(platform.name.clone());
            let ranges = platform.robots.iter().map(|ids| (ids.clone(), place));
            platforms.robots.extend(ranges);
        }
        platforms
    }

    /// Names, by place.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Index of a robot's platform. `None` if the fleet's settings do not have the robot.
    #[must_use]
    pub fn of_robot(&self, robot: u32) -> Option<usize> {
        let found = self.robots.iter().find(|(ids, _)| ids.contains(&robot));
        found.map(|(_, place)| *place)
    }
}

/// A search text, prepared once for all robots.
///
/// It finds parts of ids and of the names of platforms, alarms, levels and qualities, in any case.
/// As `<30` or `<30%` it finds batteries below 30 %. An empty one finds all robots.
#[derive(Debug, Clone)]
pub struct Search {
    text: String,
    platforms: Vec<bool>,
    alarms: AlarmSet,
    levels: [bool; 4],
    soc_below: Option<f64>,
}

impl Search {
    /// The search for `text` in a fleet.
    #[must_use]
    pub fn new(text: &str, platforms: &Platforms) -> Self {
        let text = text.trim().to_lowercase();
        let found = |name: &str| name.to_lowercase().contains(&text);
        let alarms = Alarm::ALL.into_iter().filter(|alarm| found(alarm.name()));
        let mut levels = [false; 4];
        for level in [Level::Ok, Level::Warn, Level::Error, Level::Stale] {
            levels[usize::from(level.code())] = found(level.name());
        }
        Self {
            platforms: platforms.names.iter().map(|name| found(name)).collect(),
            alarms: alarms.fold(AlarmSet::default(), AlarmSet::with),
            levels,
            soc_below: soc_below(&text),
            text,
        }
    }

    /// True if the search finds a robot. `platform` is the index of its platform.
    #[must_use]
    pub fn finds(&self, robot: u32, platform: Option<usize>, newest: &Newest) -> bool {
        if self.text.is_empty() {
            return true;
        }
        if let Some(below) = self.soc_below {
            return newest.soc().is_some_and(|soc| soc < below);
        }
        let of_platform = platform.and_then(|place| self.platforms.get(place));
        of_platform.is_some_and(|found| *found)
            || newest.diagnostic.is_some_and(|diagnostic| diagnostic.alarms & self.alarms.0 != 0)
            || self.levels[usize::from(newest.level().code())]
            || quality_name(newest.forecast.quality()).to_lowercase().contains(&self.text)
            || robot.to_string().contains(&self.text)
    }
}

/// The state of charge of `<30` and `<30%`, 0 to 1.
fn soc_below(text: &str) -> Option<f64> {
    let number = text.strip_prefix('<')?.trim();
    let number = number.strip_suffix('%').unwrap_or(number).trim();
    let percent: f64 = number.parse().ok()?;
    percent.is_finite().then_some(percent / 100.0)
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{Budget, Diagnostic, Forecast, Quality, budget_flag};

    use super::*;

    fn newest(alarms: AlarmSet, soc: Option<f32>) -> Newest {
        let (quality, quality_detail) = Quality::Held.encode();
        Newest {
            forecast: Forecast { quality, quality_detail, ..Forecast::default() },
            diagnostic: Some(Diagnostic {
                level: alarms.level().code(),
                alarm: alarms.first().code(),
                alarms: alarms.0,
                ..Diagnostic::default()
            }),
            budget: soc.map(|soc| Budget { flags: budget_flag::BATTERY, soc, ..Budget::default() }),
        }
    }

    #[test]
    fn a_search_finds_ids_platforms_alarms_levels_qualities_and_low_batteries() {
        let platforms = Platforms {
            names: vec!["gternal".to_owned(), "rover".to_owned()],
            robots: vec![(0..=9, 0), (100..=109, 1)],
        };
        let stuck = newest(AlarmSet::default().with(Alarm::StuckSensor), Some(0.25));
        let fine = newest(AlarmSet::default(), Some(0.8));
        let unknown = newest(AlarmSet::default(), None);
        for (text, in_stuck, in_fine, in_unknown) in [
            ("", true, true, true),
            ("  ", true, true, true),
            ("10", false, false, true),
            ("rov", false, false, true),
            ("STUCK", true, false, false),
            ("error", true, false, false),
            ("ok", false, true, true),
            ("held", true, true, true),
            ("nothing", false, false, false),
            ("<30", true, false, false),
            ("< 30 %", true, false, false),
            ("<25%", false, false, false),
            ("<100", true, true, false),
            ("<NaN", false, false, false),
            ("<", false, false, false),
        ] {
            let search = Search::new(text, &platforms);
            let found = [(7, &stuck), (8, &fine), (100, &unknown)]
                .map(|(robot, newest)| search.finds(robot, platforms.of_robot(robot), newest));
            assert_eq!(found, [in_stuck, in_fine, in_unknown], "{text:?}");
        }
    }
}
