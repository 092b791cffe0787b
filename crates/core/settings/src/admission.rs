//! Checks of a sample's values against a platform's limits. Publishers use them too, so that a
//! source knows at once which samples the worker would refuse.

use std::fmt;
use std::ops::RangeInclusive;

use joulebus_wire::{DropReason, Sample, sample_flag};

use crate::{FleetSettings, Platform};

/// Measured states of charge: batteries report a little more than full, or less than empty.
const SOC: RangeInclusive<f32> = -0.05..=1.05;
/// Energy to return, J: up to the largest battery.
const RETURN_J: RangeInclusive<f32> = 0.0..=3.6e9;
/// Range of values that only have to be finite.
const ANY: RangeInclusive<f32> = f32::MIN..=f32::MAX;

/// A sample whose values the worker refuses, and why.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RefusedSample {
    /// Its robot.
    pub robot: u32,
    /// The reason that the worker counts.
    pub reason: DropReason,
    /// The value outside its range: its name with the unit, what was found, what is allowed.
    /// `None` where no single value is at fault.
    pub value: Option<Value>,
}

/// The name of a value of a sample, itself, and its range.
type Value = (&'static str, f32, RangeInclusive<f32>);

/// A value of a sample: its flag, its name, itself, and its range with the reason outside it.
type Quantity = (u32, &'static str, f32, RangeInclusive<f32>, DropReason);

impl Platform {
    /// Refuses values outside the limits of the platform. A value whose flag is cleared is unknown
    /// and not checked.
    ///
    /// # Errors
    /// The reason that the worker counts.
    pub fn admit(&self, sample: &Sample) -> Result<(), DropReason> {
        self.judge(sample).map_err(|(reason, _)| reason)
    }

    /// The reason to refuse it, with the value at fault if it is a single one.
    fn judge(&self, sample: &Sample) -> Result<(), (DropReason, Option<Value>)> {
        let full_off_the_charger =
            sample.has(sample_flag::FULL) && !sample.has(sample_flag::CHARGING);
        if sample.flags & !sample_flag::ALL != 0 || sample.reserved != 0 || full_off_the_charger {
            return Err((DropReason::BadFlags, None));
        }
        if !self.is_inside(sample)
            && let Some((reason, value)) = self.outside(sample)
        {
            return Err((reason, Some(value)));
        }
        if sample.has(sample_flag::POWER) && sample.measured_ns > sample.stamp_ns {
            return Err((DropReason::BadTime, None));
        }
        Ok(())
    }

    /// True if every known value is inside its range: what [`Platform::outside`] finds, without
    /// branches, since nearly every sample is.
    #[inline(always)]
    fn is_inside(&self, sample: &Sample) -> bool {
        let within = |flag: u32, value: f32, least: f32, most: f32| {
            !sample.has(flag) | ((least <= value) & (value <= most))
        };
        let (v, omega) = (self.v_max_mps, self.omega_max_radps);
        within(sample_flag::POWER, sample.power_w, self.power_min_w, self.power_max_w)
            & within(sample_flag::V, sample.v_mps, -v, v)
            & within(sample_flag::OMEGA, sample.omega_radps, -omega, omega)
            & within(sample_flag::SOC, sample.soc, *SOC.start(), *SOC.end())
            & within(sample_flag::RETURN, sample.return_j, *RETURN_J.start(), *RETURN_J.end())
            & within(sample_flag::VOLTAGE, sample.voltage_v, *ANY.start(), *ANY.end())
            & within(sample_flag::CURRENT, sample.current_a, *ANY.start(), *ANY.end())
    }

    /// The first value that is known and outside its range. One that is not finite before all.
    fn outside(&self, sample: &Sample) -> Option<(DropReason, Value)> {
        let (power, v) = (self.power_min_w..=self.power_max_w, self.v_max_mps);
        let (omega, battery) = (self.omega_max_radps, DropReason::BatteryOutOfRange);
        let command = DropReason::CommandOutOfRange;
        let power_reason = DropReason::PowerOutOfRange;
        let quantities: [Quantity; 7] = [
            (sample_flag::POWER, "power_w", sample.power_w, power, power_reason),
            (sample_flag::V, "v_mps", sample.v_mps, -v..=v, command),
            (sample_flag::OMEGA, "omega_radps", sample.omega_radps, -omega..=omega, command),
            (sample_flag::SOC, "soc", sample.soc, SOC, battery),
            (sample_flag::RETURN, "return_j", sample.return_j, RETURN_J, battery),
            (sample_flag::VOLTAGE, "voltage_v", sample.voltage_v, ANY, DropReason::NotFinite),
            (sample_flag::CURRENT, "current_a", sample.current_a, ANY, DropReason::NotFinite),
        ];
        let mut outside = None;
        for (flag, name, value, range, reason) in quantities {
            if !sample.has(flag) || range.contains(&value) {
                continue;
            }
            if !value.is_finite() {
                return Some((DropReason::NotFinite, (name, value, range)));
            }
            outside = outside.or(Some((reason, (name, value, range))));
        }
        outside
    }
}

impl FleetSettings {
    /// Reason that the worker refuses a sample by its values. `None` if they are admitted.
    #[must_use]
    pub fn refusal(&self, sample: &Sample) -> Option<RefusedSample> {
        let is_its = |ids: &RangeInclusive<u32>| ids.contains(&sample.robot);
        let own = self.platforms.iter().find(|platform| platform.robots.iter().any(is_its));
        let (reason, value) = match own {
            None => (DropReason::UnknownRobot, None),
            Some(platform) => platform.judge(sample).err()?,
        };
        Some(RefusedSample { robot: sample.robot, reason, value })
    }
}

impl RefusedSample {
    /// The value, and what is allowed, in words.
    #[must_use]
    pub fn found(&self) -> String {
        match (&self.value, self.reason) {
            (Some((name, found, _)), DropReason::NotFinite) => {
                format!("{name} is {found}. Leave out what is unknown")
            }
            (Some((name, found, allowed)), _) => {
                let (lo, hi) = (allowed.start(), allowed.end());
                format!("{name} is {found}, allowed are {lo} to {hi}")
            }
            (None, DropReason::UnknownRobot) => DropReason::UnknownRobot.remedy().to_owned(),
            (None, DropReason::BadTime) => "it was measured after its stamp".to_owned(),
            (None, _) => "flags that contradict each other".to_owned(),
        }
    }
}

impl fmt::Display for RefusedSample {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (robot, reason, found) = (self.robot, self.reason.name(), self.found());
        write!(out, "the worker refuses the sample of robot {robot} ({reason}): {found}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::tests::settings;

    /// Reason to refuse a sample of robot 1 with all values known, after `set` changed it.
    fn refusal(set: impl Fn(&mut Sample)) -> Option<(DropReason, String)> {
        let mut sample = Sample {
            robot: 1,
            flags: sample_flag::POWER
                | sample_flag::V
                | sample_flag::OMEGA
                | sample_flag::SOC
                | sample_flag::RETURN
                | sample_flag::VOLTAGE
                | sample_flag::CURRENT,
            ..Sample::default()
        };
        set(&mut sample);
        let refused = settings().refusal(&sample)?;
        Some((refused.reason, refused.to_string()))
    }

    #[test]
    fn each_value_is_refused_outside_its_range_and_named_with_it() {
        assert_eq!(refusal(|_| ()), None);
        type Case = (fn(&mut Sample), DropReason, &'static str);
        let cases: [Case; 11] = [
            (
                |sample| sample.power_w = 3500.0,
                DropReason::PowerOutOfRange,
                "power_w is 3500, allowed are",
            ),
            (|sample| sample.v_mps = -9e9, DropReason::CommandOutOfRange, "v_mps is -9000000000"),
            (
                |sample| sample.omega_radps = 9e9,
                DropReason::CommandOutOfRange,
                "omega_radps is 9000000000",
            ),
            (
                |sample| sample.soc = 80.0,
                DropReason::BatteryOutOfRange,
                "soc is 80, allowed are -0.05 to 1.05",
            ),
            (|sample| sample.return_j = -1.0, DropReason::BatteryOutOfRange, "return_j is -1"),
            (|sample| sample.voltage_v = f32::NAN, DropReason::NotFinite, "voltage_v is NaN"),
            (|sample| sample.current_a = f32::INFINITY, DropReason::NotFinite, "current_a is inf"),
            (|sample| sample.measured_ns = 1, DropReason::BadTime, "measured after its stamp"),
            (|sample| sample.flags |= sample_flag::FULL, DropReason::BadFlags, "flags"),
            (|sample| sample.reserved = 1, DropReason::BadFlags, "flags"),
            (|sample| sample.robot = 10_000, DropReason::UnknownRobot, "platform.robots"),
        ];
        for (set, reason, expected) in cases {
            let (found, text) = refusal(set).unwrap();
            assert_eq!(found, reason, "{text}");
            assert!(text.contains(expected), "{text}");
        }
        // What is no number comes before what is out of range. What is unknown is not looked at.
        let both = refusal(|sample| (sample.power_w, sample.soc) = (3500.0, f32::NAN)).unwrap();
        assert_eq!(both.0, DropReason::NotFinite, "{}", both.1);
        let unknown =
            refusal(|sample| (sample.flags, sample.power_w, sample.soc) = (0, f32::NAN, 80.0));
        assert_eq!(unknown, None);
    }

    #[test]
    fn the_check_without_branches_admits_what_the_table_does() {
        let settings = settings();
        let platform = &settings.platforms[0];
        let power_w = [platform.power_min_w, platform.power_max_w];
        let ends =
            [power_w[0], power_w[1], platform.v_max_mps, platform.omega_max_radps, 1.05, 3.6e9];
        let ends = ends.into_iter().flat_map(|end| [end, -end, end.next_up(), end.next_down()]);
        let values = ends.chain([0.0, -0.05, (-0.05_f32).next_down(), f32::NAN, f32::INFINITY]);
        let fields: [fn(&mut Sample) -> &mut f32; 7] = [
            |sample| &mut sample.power_w,
            |sample| &mut sample.v_mps,
            |sample| &mut sample.omega_radps,
            |sample| &mut sample.soc,
            |sample| &mut sample.return_j,
            |sample| &mut sample.voltage_v,
            |sample| &mut sample.current_a,
        ];
        for field in fields {
            for value in values.clone() {
                for cleared in (0..32).map(|bit| 1 << bit) {
                    let mut sample = Sample { flags: !cleared, ..Sample::default() };
                    *field(&mut sample) = value;
                    let inside = platform.is_inside(&sample);
                    assert_eq!(inside, platform.outside(&sample).is_none(), "{sample:?}");
                }
            }
        }
    }
}
