//! Answers as `joulebus ask` prints them and `joulebus serve` sends them.

use std::fmt;

use joulebus_settings::{FleetSettings, Platform};
use joulebus_wire::Budget;
use serde::Serialize;

use crate::answer::{Answer, Caveats, Left, Range, Verdict};
use crate::question::Row;
use crate::shape::Simplified;

/// Answers about one question, as of one tick.
#[derive(Debug, Clone, Serialize)]
pub struct AnswersReport {
    /// Name of the fleet. Of several fleets all names, separated by commas.
    pub fleet: String,
    /// The tick that the answers are computed from. Of several fleets the oldest one.
    pub tick: u64,
    /// Its age, s.
    pub age_s: f64,
    /// Coverage of the intervals.
    pub coverage: f32,
    /// How the path's corners were cut, if they were.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub path: Option<Simplified>,
    /// The best first.
    pub answers: Vec<AnswerReport>,
    /// Robots that were asked about and are not in the fleet, or not followed on this host.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<u32>,
}

/// One robot's answer.
#[derive(Debug, Clone, Serialize)]
pub struct AnswerReport {
    robot: u32,
    /// Name of its fleet, if several fleets were asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fleet: Option<String>,
    platform: String,
    verdict: &'static str,
    /// Reason that the verdict is unknown.
    reason: Option<String>,
    duration_s: f32,
    energy: Option<Range>,
    /// At the end, reserve included.
    left: Option<Left>,
    /// Probability of finishing above the reserve. Null where it is not known.
    probability: Option<f32>,
    /// A bound: the least that is spare, at the upper bound of the energy.
    margin_j: Option<f32>,
    /// Index from 0.
    limiting_leg: Option<usize>,
    /// Latest time to turn back. Null with yes, which needs none, and if it was not requested or
    /// the robot cannot even turn back now.
    turn_back_s: Option<f32>,
    /// True if `turn_back_s` was asked for.
    #[serde(skip)]
    pub asked_to_return: bool,
    caveats: Caveats,
    /// Energy and charge at evenly spaced moments of the trip, the last at its end. Empty with several
    /// robots.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    along: Vec<Moment>,
    /// Charging behind the trip, if asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    charge: Option<ChargeAfter>,
    /// Power of every step, W, if asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub power_w: Option<Vec<f32>>,
}

/// Charging behind a trip.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ChargeAfter {
    /// To this state of charge.
    pub to: f64,
    /// Time on the charger by earlier charges of the robot, s: from the expected charge, and from
    /// its lower bound. Null if unknown.
    pub time_s: Option<f64>,
    /// See `time_s`.
    pub most_s: Option<f64>,
}

impl fmt::Display for ChargeAfter {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "charge to {:.0} %: ", 100.0 * self.to)?;
        match (self.time_s, self.most_s) {
            (Some(time_s), Some(most_s)) => {
                write!(out, "{} on the charger, at most {}", Lasting(time_s), Lasting(most_s))
            }
            _ => write!(out, "unknown time, until the robot has charged so far once"),
        }
    }
}

/// A moment of a trip. The charge is unknown without a battery whose charge is known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Moment {
    /// Time from the beginning, s.
    pub time_s: f32,
    /// Energy so far, with its interval.
    pub energy: Option<Range>,
    /// Energy left, reserve included.
    pub left: Option<Left>,
    /// State of charge: expected, its lower bound with the errors of plan and battery, and its upper
    /// bound with those of the plan alone. 0 to 1.
    pub charge: Option<[f32; 3]>,
    /// Verdict on the trip so far.
    pub verdict: &'static str,
}

impl Moment {
    /// `full_j`: energy in the battery before the trip.
    fn new(answer: &Answer, full_j: Option<f32>, capacity_j: Option<f64>) -> Self {
        let charge = answer.left.zip(answer.energy).zip(full_j.zip(capacity_j));
        Self {
            time_s: answer.duration_s,
            energy: answer.energy,
            left: answer.left,
            charge: charge.map(|((left, energy), (full_j, capacity_j))| {
                let most_j = (full_j - energy.lo_j).max(0.0);
                let share = |energy_j: f32| (f64::from(energy_j) / capacity_j).min(1.0) as f32;
                [share(left.mean_j), share(left.lo_j), share(most_j)]
            }),
            verdict: name(answer.verdict),
        }
    }
}

/// Name of a verdict without its reason.
const fn name(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Yes => "yes",
        Verdict::Tight => "tight",
        Verdict::No => "no",
        Verdict::Unknown(_) => "unknown",
    }
}

impl AnswerReport {
    /// The answer of one robot of a fleet.
    #[must_use]
    pub fn new(settings: &FleetSettings, row: &Row) -> Self {
        let answer = &row.answer;
        let platform =
            platform(settings, row.robot).map_or_else(String::new, |its| its.name.clone());
        let reason = match answer.verdict {
            Verdict::Unknown(reason) => Some(reason.to_string()),
            _ => None,
        };
        Self {
            robot: row.robot,
            fleet: None,
            platform,
            verdict: name(answer.verdict),
            reason,
            duration_s: answer.duration_s,
            energy: answer.energy,
            left: answer.left,
            probability: answer.probability,
            margin_j: answer.margin_j,
            limiting_leg: answer.limiting_leg,
            turn_back_s: row.turn_back_s,
            asked_to_return: false,
            caveats: answer.caveats,
            along: Vec::new(),
            charge: None,
            power_w: None,
        }
    }

    /// Adds the robot's answers to the parts of its trip, and the time to charge to a state of
    /// charge behind it, if that is asked for. `budget` has what its battery has taught.
    pub fn set_along(
        &mut self,
        settings: &FleetSettings,
        along: &[Row],
        (budget, charge_to): (Option<&Budget>, Option<f64>),
    ) {
        let battery = platform(settings, self.robot).and_then(|its| its.battery.as_ref());
        let learned = budget.and_then(Budget::learned_capacity_j);
        let stated_j = battery.map(|battery| battery.capacity_j);
        let capacity_j = learned.map(|(capacity_j, _)| capacity_j.into()).or(stated_j);
        self.charge = charge_to.map(|to| {
            let known = self.left.zip(capacity_j).zip(budget);
            let charging_s = |energy_j: fn(&Left) -> f32| {
                let ((left, capacity_j), budget) = known?;
                budget.charging_s((f64::from(energy_j(&left)) / capacity_j).min(1.0), to)
            };
            ChargeAfter {
                to,
                time_s: charging_s(|left| left.mean_j),
                most_s: charging_s(|left| left.lo_j),
            }
        });
        let its = || along.iter().filter(|row| row.robot == self.robot).map(|row| &row.answer);
        let full_j = its().next().and_then(full_j);
        self.along = its().map(|answer| Moment::new(answer, full_j, capacity_j)).collect();
    }

    /// The charge at the quarters of the trip.
    fn charges(&self) -> Option<String> {
        let count = self.along.len();
        let quarters =
            (1..=4).filter_map(|quarter| self.along.get((count * quarter / 4).checked_sub(1)?));
        let texts = quarters.map(|moment| {
            let [mean, lo, hi] = moment.charge?.map(|share| 100.0 * share);
            let after = Lasting(moment.time_s.into());
            Some(format!("{mean:.1} % ({lo:.1} to {hi:.1}) after {after}"))
        });
        let texts: Vec<String> = texts.collect::<Option<_>>()?;
        (!texts.is_empty()).then(|| format!("charge  {}", texts.join(", ")))
    }

    fn lines(&self, coverage: f32) -> Vec<String> {
        let mut lines = Vec::new();
        let percent = 100.0 * coverage;
        if let Some(energy) = self.energy {
            let lasting = Lasting(self.duration_s.into());
            let [mean, lo, hi] = of_one_unit([energy.mean_j, energy.lo_j, energy.hi_j]);
            lines.push(format!("energy  {mean}, {lo} to {hi} at {percent} %, in {lasting}"));
        }
        if let (Some(left), Some(margin_j)) = (self.left, self.margin_j) {
            let [mean, lo] = of_one_unit([left.mean_j, left.lo_j]);
            lines.push(format!("left    {mean}, at least {lo}"));
            lines.push(spare(margin_j));
            lines.push(match self.probability {
                Some(probability) => format!("above the reserve with probability {probability:.3}"),
                None => "above the reserve with unknown probability: the model's errors do not \
                         cover this plan or this robot's state"
                    .to_owned(),
            });
        }
        lines.extend(self.charges());
        lines.extend(self.charge.map(|charge| charge.to_string()));
        if let Some(leg) = self.limiting_leg {
            lines.push(format!("leg {leg} is the first that is not sure (from 0)"));
        }
        match (self.asked_to_return, self.turn_back_s) {
            (true, Some(turn_back_s)) => {
                let within = Lasting(turn_back_s.into());
                lines.push(format!("must turn back within {within}"));
            }
            (true, None) if self.verdict == "yes" => {
                lines.push("can drive the whole path and return".to_owned());
            }
            (true, None) => lines.push("no time to turn back can be promised".to_owned()),
            (false, _) => {}
        }
        if self.caveats.any() {
            lines.push(format!("weakened: {}", self.caveats));
        }
        lines
    }
}

fn platform(settings: &FleetSettings, robot: u32) -> Option<&Platform> {
    settings.platforms.iter().find(|its| its.robots.iter().any(|ids| ids.contains(&robot)))
}

/// Energy in the battery before a trip, by the first of its moments: later ones may find it empty.
fn full_j(first: &Answer) -> Option<f32> {
    Some(first.left?.mean_j + first.energy?.mean_j)
}

/// The line of the spare energy, which is a bound: of the battery the lower one, of the energy the
/// upper one.
fn spare(margin_j: f32) -> String {
    let bound = "at the upper bound of the energy";
    if margin_j < 0.0 {
        let missing = Joules((-margin_j).into());
        format!("spare   nothing for sure: at worst {missing:#} are missing, {bound}")
    } else {
        let spare = Joules(margin_j.into());
        format!("spare   at least {spare:#} above the reserve, even {bound}")
    }
}

/// The energies of a line in one unit: in J, with Wh beside if one of them has a watt-hour.
fn of_one_unit<const COUNT: usize>(energies_j: [f32; COUNT]) -> [String; COUNT] {
    let has_watt_hours = energies_j.iter().any(|energy_j| energy_j.abs() >= 3_600.0);
    energies_j.map(|energy_j| {
        let energy = Joules(energy_j.into());
        if has_watt_hours && energy_j.abs() < 3_600.0 {
            return format!("{energy} ({:.2} Wh)", energy_j / 3_600.0);
        }
        format!("{energy:#}")
    })
}

/// A time in s as people read it: seconds up to two minutes, minutes up to two hours, hours.
#[derive(Debug, Clone, Copy)]
pub struct Lasting(pub f64);

impl fmt::Display for Lasting {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            short if short < 120.0 => write!(out, "{short:.1} s"),
            long if long < 7_200.0 => write!(out, "{:.1} min", long / 60.0),
            long => write!(out, "{:.1} h", long / 3_600.0),
        }
    }
}

/// An energy in J as people read it: J below one watt-hour, then Wh and kWh, as batteries state
/// their capacity. `{:#}` writes Wh beside J.
#[derive(Debug, Clone, Copy)]
pub struct Joules(pub f64);

impl fmt::Display for Joules {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let watt_hours = self.0 / 3_600.0;
        // False for NaN.
        let has_watt_hours = watt_hours.abs() >= 1.0;
        let decimals = usize::from(self.0.abs() < 100.0);
        if !has_watt_hours || out.alternate() {
            write!(out, "{:.decimals$} J", self.0)?;
        }
        let (begin, end) = if out.alternate() { (" (", ")") } else { ("", "") };
        match watt_hours.abs() {
            _ if !has_watt_hours => Ok(()),
            few if few < 100.0 => write!(out, "{begin}{watt_hours:.2} Wh{end}"),
            some if some < 1_000.0 => write!(out, "{begin}{watt_hours:.1} Wh{end}"),
            _ => write!(out, "{begin}{:.2} kWh{end}", watt_hours / 1_000.0),
        }
    }
}

impl fmt::Display for AnswersReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(Simplified { points, lines, within_m }) = self.path {
            let within_cm = (1000.0 * within_m).round() / 10.0;
            writeln!(
                out,
                "path of {points} points: driven as {lines} straight lines within {within_cm} cm\n"
            )?;
        }
        for (place, answer) in self.answers.iter().enumerate() {
            if place > 0 {
                writeln!(out)?;
            }
            write!(out, "robot {}", answer.robot)?;
            if let Some(fleet) = &answer.fleet {
                write!(out, " of {fleet}")?;
            }
            write!(out, " ({}): {}", answer.platform, answer.verdict)?;
            if let Some(reason) = &answer.reason {
                write!(out, ": {reason}")?;
            }
            for line in answer.lines(self.coverage) {
                write!(out, "\n  {line}")?;
            }
        }
        self.missing.iter().try_for_each(|robot| {
            write!(out, "\n\nrobot {robot}: not in the fleet, or not followed on this host")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_energies_of_a_line_have_one_unit_and_the_spare_energy_is_a_bound() {
        let whole = [44.0, 30.0, 3_599.0].map(|joules: f32| Joules(joules.into()).to_string());
        assert_eq!(of_one_unit([44.0, 30.0, 3_599.0]), whole);
        let mixed = of_one_unit([4_711.0, 12.5, 33_187.0, 0.0]);
        assert_eq!(
            mixed,
            ["4711 J (1.31 Wh)", "12.5 J (0.00 Wh)", "33187 J (9.22 Wh)", "0.0 J (0.00 Wh)"]
        );
        assert!(spare(4_711.0).starts_with("spare   at least 4711 J (1.31 Wh) above the reserve"));
        let missing = spare(-47_135.0);
        assert!(!missing.contains('-') && missing.contains("at worst 47135 J"), "{missing}");
        for line in [spare(1.0), missing] {
            assert!(line.contains("upper bound of the energy"), "{line}");
        }
    }

    #[test]
    fn the_charge_of_a_battery_that_runs_empty_reaches_0_at_every_bound() {
        let moment = |mean_j: f32| Answer {
            energy: Some(Range { mean_j, lo_j: 0.8 * mean_j, hi_j: 1.2 * mean_j }),
            left: Some(Left { mean_j: (50.0 - mean_j).max(0.0), lo_j: 0.0 }),
            ..Answer::UNKNOWN
        };
        let full_j = full_j(&moment(10.0)).unwrap();
        let charges = [10.0, 60.0, 100.0]
            .map(|mean_j| Moment::new(&moment(mean_j), Some(full_j), Some(100.0)).charge.unwrap());
        assert_eq!(charges, [[0.4, 0.0, 0.42], [0.0, 0.0, 0.02], [0.0; 3]]);
    }

    #[test]
    fn an_energy_has_the_unit_that_fits_and_watt_hours_beside_joules() {
        for (energy_j, fitted, beside) in [
            (44.04, "44.0 J", "44.0 J"),
            (-0.5, "-0.5 J", "-0.5 J"),
            (3_599.0, "3599 J", "3599 J"),
            (33_187.0, "9.22 Wh", "33187 J (9.22 Wh)"),
            (-7_200.0, "-2.00 Wh", "-7200 J (-2.00 Wh)"),
            (1.8e6, "500.0 Wh", "1800000 J (500.0 Wh)"),
            (7.2e6, "2.00 kWh", "7200000 J (2.00 kWh)"),
            (f64::NAN, "NaN J", "NaN J"),
        ] {
            assert_eq!(Joules(energy_j).to_string(), fitted);
            assert_eq!(format!("{:#}", Joules(energy_j)), beside);
        }
    }
}
