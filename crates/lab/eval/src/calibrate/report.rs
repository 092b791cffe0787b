//! A calibration as text and as JSON.

use std::fmt;

use serde::Serialize;

use super::choose::Basis;
use super::delay::{Delay, Delays, Thresholds};
use super::play::{KINDS, OTHERS};

/// Limits with their evidence. `Display` is a table. Unknown numbers are null in JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Calibration {
    /// Robots of the fleet.
    pub robots: u32,
    /// False alarms asked for, a robot and hour, all residual alarms together.
    pub wanted_per_robot_h: f64,
    /// Level of the bounds.
    pub confidence: f64,
    /// False alarms at these limits, a robot and hour, are at most this with that confidence.
    pub at_most_per_robot_h: f64,
    /// True if the limits are extrapolated beyond what the recordings prove.
    pub extrapolated: bool,
    /// Robot-hours without an alarm, of both halves, that would prove the requested rate.
    pub needed_h: f64,
    /// FNV-1a of the recordings' times and powers, hexadecimal.
    pub digest: String,
    /// Recordings that decide how the limits stand to each other.
    pub chosen_on: Evidence,
    /// The others, which state their rate.
    pub stated_on: Evidence,
    /// The limits of noise, mismatch and level.
    pub limits: [Limit; KINDS],
    /// Alarms of all recordings that these limits do not set, true or false, by name.
    pub others: [(&'static str, u64); OTHERS.len()],
    /// Limits of power and voltage with as many false alarms on the first half.
    pub thresholds: Thresholds,
    /// Recordings with inserted faults: those of the second half that are long enough.
    pub faulty_recordings: usize,
    /// Median of the time from the fault to the end of the recording, s.
    pub after_s: f64,
    /// Delays to find faults.
    pub delays: Vec<Delays>,
}

/// A half of the recordings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Evidence {
    /// Their number. One longer than ten minutes counts once for each piece of ten minutes.
    pub recordings: usize,
    /// Their rows.
    pub rows: usize,
    /// Robot-hours in which an alarm could be raised: from the settling of the residuals on.
    pub hours: f64,
    /// False alarms at the chosen limits.
    pub alarms: u64,
}

/// A limit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limit {
    /// Its key in `[alarms]`.
    pub key: &'static str,
    /// The config's limit.
    pub before: f64,
    /// The chosen limit.
    pub value: f64,
    /// Its source.
    pub basis: Basis,
    /// False alarms on the first half, and on the second.
    pub alarms: [u64; 2],
}

impl Limit {
    /// Its source in words.
    pub fn evidence(&self) -> String {
        let [first, second] = self.alarms;
        let counts = format!("{first} false alarms on the first half, {second} on the second");
        match self.basis {
            Basis::Shown => format!("Shown by the recordings: {counts}."),
            Basis::Extrapolated => format!(
                "Extrapolated beyond the recordings, by a power law of their highest values: {counts}."
            ),
            Basis::Kept => {
                format!("As before: no recording reached even the least limit ({counts}).")
            }
        }
    }
}

impl Calibration {
    /// The rate and its evidence, in sentences.
    pub fn evidence(&self) -> Vec<String> {
        let percent = 100.0 * self.confidence;
        let (first, second) = (self.chosen_on, self.stated_on);
        let per_day = |per_robot_h: f64| per_robot_h * f64::from(self.robots) * 24.0;
        let mut lines = vec![
            format!(
                "Asked for: {:.3e} false alarms a robot-hour, {:.3} a day of {} robots.",
                self.wanted_per_robot_h,
                per_day(self.wanted_per_robot_h),
                self.robots
            ),
            format!(
                "First half: {} recordings, {} rows, {:.2} robot-hours, {} false alarms at these limits.",
                first.recordings, first.rows, first.hours, first.alarms
            ),
            format!(
                "Second half: {} recordings, {} rows, {:.2} robot-hours, {} false alarms: at most {:.3} a \
                 robot-hour at {percent:.0} %, {:.3} a day of the fleet.",
                second.recordings,
                second.rows,
                second.hours,
                second.alarms,
                self.at_most_per_robot_h,
                per_day(self.at_most_per_robot_h)
            ),
        ];
        if self.extrapolated {
            lines.push(format!(
                "EXTRAPOLATED: the recordings do not show what was asked for. {:.0} robot-hours \
                    without an alarm \
                 would.",
                self.needed_h
            ));
        }
        lines.push(format!("Digest of the recordings: {}.", self.digest));
        lines
    }

    fn write_limits(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "\n{:<16} {:>10} {:>10} {:>14} {:>14}  basis",
            "limit", "before", "now", "alarms, 1st", "alarms, 2nd"
        )?;
        for limit in &self.limits {
            let [first, second] = limit.alarms;
            let basis = match limit.basis {
                Basis::Shown => "shown",
                Basis::Extrapolated => "extrapolated",
                Basis::Kept => "kept: nothing reached the least limit",
            };
            let (key, before, value) = (limit.key, limit.before, limit.value);
            writeln!(
                out,
                "{key:<16} {before:>10.2} {value:>10.2} {first:>14} {second:>14}  {basis}"
            )?;
        }
        let others = self.others.iter().filter(|(_, count)| *count > 0);
        for (name, count) in others {
            writeln!(
                out,
                "{count} × {name} on all recordings, true or false: not of these limits, not counted"
            )?;
        }
        Ok(())
    }

    fn write_delays(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Thresholds { power_w, voltage_v, power_false, voltage_false } = self.thresholds;
        writeln!(
            out,
            "\nFaults put into {} recordings of the second half, {:.0} s (median) before their end:\n\
             share found; median, 90 % quantile of the delay (s)",
            self.faulty_recordings, self.after_s
        )?;
        writeln!(
            out,
            "power: above {power_w:.2} W; false in {:.1} % of the second half's recordings",
            100.0 * power_false
        )?;
        match voltage_v {
            Some(voltage_v) => writeln!(
                out,
                "voltage: below {voltage_v:.3} V; false in {:.1} %",
                100.0 * voltage_false
            )?,
            None => writeln!(out, "voltage: not recorded")?,
        }
        writeln!(out, "\n{:<18} {:>20} {:>20} {:>20}", "fault", "calibrated", "power", "voltage")?;
        for delays in &self.delays {
            let name = delays.fault.name();
            let [calibrated, power, voltage] =
                [delays.calibrated, delays.power, delays.voltage].map(cell);
            writeln!(out, "{name:<18} {calibrated:>20} {power:>20} {voltage:>20}")?;
        }
        Ok(())
    }
}

/// `95 %; 1.2, 3.4`.
fn cell(delay: Delay) -> String {
    let shown = |time_s: f64| match time_s.is_finite() {
        true => format!("{time_s:.1}"),
        false => "–".to_owned(),
    };
    let (median, q90) = (shown(delay.median_s), shown(delay.q90_s));
    format!("{:.0} %; {median}, {q90}", 100.0 * delay.found)
}

impl fmt::Display for Calibration {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for line in self.evidence() {
            writeln!(out, "{line}")?;
        }
        self.write_limits(out)?;
        if self.delays.is_empty() {
            return writeln!(out, "no recording of the second half is long enough for faults");
        }
        self.write_delays(out)
    }
}
