//! Judges whether what robots report is plausible, while it comes.

use std::collections::{BTreeMap, BTreeSet};

use joulebus_plausibility::{Finding, Judge, Kind, Known, Observation, Origin, Quantity, Rows};
use serde::Serialize;

use crate::{Charger, RobotState};

/// Readings between two judgements of a robot.
const EVERY: u64 = 64;
/// Readings after which a robot is judged anew: some ten minutes at 30 Hz.
const WINDOW: u64 = 20_000;
/// Readings after which a finding that does not come again ends.
const ENDS_AFTER: u64 = 1_024;
/// Readings of a robot that are kept, to try remedies on them.
const MAX_KEPT: usize = 256;

/// Something implausible about a robot.
///
/// [`Judgement`] has an example.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Implausible {
    /// The robot.
    pub robot: u32,
    /// The finding.
    #[serde(flatten)]
    pub finding: Finding,
    /// The remedy. An option or a key in it was tried on what the robot has reported.
    pub remedy: String,
}

/// Judges what the robots of a source report: sign, unit, clock, range, saturation, constancy.
///
/// Give it each state that is published. It alters nothing and publishes nothing: a program logs
/// [`Judgement::take_news`]. It keeps some 22 kB of each robot.
///
/// ```
/// use joulebus_publisher::plausibility::Origin;
/// use joulebus_publisher::{Judgement, RobotState};
///
/// let mut judgement = Judgement::new(Origin::Program, Vec::new());
/// for step in 0..200 {
///     // The battery's monitor counts to 100, not to 1.
///     let state = RobotState::new(7).reading(40.0 + (step as f32 * 0.7).sin());
///     judgement.take(&state, Some(96.0), step * 100_000_000);
/// }
/// assert!(judgement.take_news()[0].starts_with("robot 7: "));
/// assert!(!judgement.records()[0].remedy.is_empty());
/// ```
#[derive(Debug, Clone)]
pub struct Judgement {
    origin: Origin,
    /// What the source's mapping calls quantities, with their units.
    names: Vec<(Quantity, String)>,
    /// Findings that are not reported.
    accepted: Vec<Kind>,
    robots: BTreeMap<u32, Robot>,
    max_robots: usize,
    /// True if robots were not judged because there are too many.
    others_wait: bool,
    /// Robots that were found plausible and made room, until all were judged.
    plausible: BTreeSet<u32>,
    news: Vec<String>,
}

#[derive(Debug, Clone)]
struct Robot {
    judge: Box<Judge>,
    kept: ThinnedReadings,
    found: Vec<Implausible>,
}

/// Readings of a robot, evenly thinned out.
#[derive(Debug, Clone)]
struct ThinnedReadings {
    /// Time in s, values in the order of [`Quantity::ALL`], and whether it charges.
    rows: Vec<(f64, [f32; 6], bool)>,
    /// One of so many is kept, and readings since the last.
    every: usize,
    since: usize,
}

impl ThinnedReadings {
    fn new() -> Self {
        Self { rows: Vec::with_capacity(MAX_KEPT), every: 1, since: 0 }
    }

    fn take(&mut self, seen: &Observation) {
        self.since += 1;
        if self.since < self.every {
            return;
        }
        self.since = 0;
        if self.rows.len() == MAX_KEPT {
            let mut keeps = false;
            self.rows.retain(|_| {
                keeps = !keeps;
                keeps
            });
            self.every *= 2;
        }
        let values = Quantity::ALL.map(|quantity| seen.value(quantity) as f32);
        self.rows.push((seen.time_s, values, seen.charging == Some(true)));
    }

    fn observations(&self) -> impl Iterator<Item = Observation> + Clone {
        self.rows.iter().map(|(time_s, values, charges)| {
            let mut seen = Observation { charging: Some(*charges), ..Observation::at(*time_s) };
            for (quantity, value) in Quantity::ALL.into_iter().zip(values) {
                *seen.value_mut(quantity) = f64::from(*value);
            }
            seen
        })
    }

    /// True if power is voltage times current wherever all three are known.
    fn is_product(&self) -> bool {
        self.observations().all(|seen| {
            let away_w = seen.power_w - seen.voltage_v * seen.current_a;
            away_w.is_nan() || away_w.abs() <= 1e-6 * seen.power_w.abs()
        })
    }
}

impl Judgement {
    /// In the words of a source, without findings of the accepted kinds.
    #[must_use]
    pub const fn new(origin: Origin, accepted: Vec<Kind>) -> Self {
        Self {
            origin,
            names: Vec::new(),
            accepted,
            robots: BTreeMap::new(),
            max_robots: usize::MAX,
            others_wait: false,
            plausible: BTreeSet::new(),
            news: Vec::new(),
        }
    }

    /// With the names of quantities in the source's mapping, whose ends state units: `voltage_mV`.
    #[must_use]
    pub fn named(self, names: Vec<(Quantity, String)>) -> Self {
        Self { names, ..self }
    }

    /// Judges at most so many robots at the same time. One that is found plausible makes room for
    /// one that waits.
    #[must_use]
    pub fn of_at_most(self, max_robots: usize) -> Self {
        Self { max_robots, ..self }
    }

    /// Adds a state with a new reading at `now_ns` (monotonic). `soc` as it came, which may be more
    /// than was published. States without one, or with a held one, add nothing new: leave them out.
    pub fn take(&mut self, state: &RobotState, soc: Option<f32>, now_ns: u64) {
        let number = |value: Option<f32>| value.map_or(f64::NAN, f64::from);
        let new = || Robot {
            judge: Box::new(Judge::new(Known::default())),
            kept: ThinnedReadings::new(),
            found: Vec::new(),
        };
        if self.robots.len() >= self.max_robots && !self.robots.contains_key(&state.robot) {
            self.others_wait |= !self.plausible.contains(&state.robot);
            return;
        }
        if self.plausible.contains(&state.robot) {
            return;
        }
        let robot = self.robots.entry(state.robot).or_insert_with(new);
        let seen = Observation {
            v_mps: number(state.v_mps),
            omega_radps: number(state.omega_radps),
            power_w: number(state.power_w),
            voltage_v: number(state.voltage_v),
            current_a: number(state.current_a),
            soc: number(soc),
            charging: Some(state.charger != Charger::Disconnected),
            ..Observation::at(now_ns as f64 * 1e-9)
        };
        robot.judge.take(&seen);
        robot.kept.take(&seen);
        let count = robot.judge.observations();
        // Not all robots of a frame in the same one.
        if (count + u64::from(state.robot)).is_multiple_of(EVERY) {
            self.judge(state.robot);
        }
    }

    fn judge(&mut self, id: u32) {
        let Some(robot) = self.robots.get_mut(&id) else {
            return;
        };
        let mut all = robot.judge.findings();
        all.retain(|finding| !self.accepted.contains(&finding.kind));
        let count = robot.judge.observations();
        let name = |of: &Finding| {
            let named = self.names.iter().find(|(quantity, _)| Some(*quantity) == of.quantity);
            named.map(|(_, name)| name.clone())
        };
        let mut found = Vec::with_capacity(all.len());
        for finding in &all {
            let known = robot.found.iter().find(|known| known.finding.is_like(finding));
            let remedy = known.map(|known| known.remedy.clone()).unwrap_or_else(|| {
                let kept = &robot.kept;
                let rows = Rows::new(kept.observations(), Known::default(), kept.is_product());
                let edits = rows.working(finding, &all, name);
                let remedy = finding.remedy_by(self.origin, name(finding).as_deref(), &edits);
                let sentences = finding.sentences(&remedy);
                self.news.push(format!("robot {id}: {}: {sentences}", finding.kind));
                remedy
            });
            found.push(Implausible { robot: id, finding: finding.clone(), remedy });
        }
        if count < ENDS_AFTER {
            let ended = robot.found.iter();
            let ended = ended.filter(|known| !all.iter().any(|one| one.is_like(&known.finding)));
            found.extend(ended.cloned());
        }
        if found.is_empty() && self.others_wait && count >= ENDS_AFTER {
            self.robots.remove(&id);
            self.plausible.insert(id);
            self.others_wait = false;
            return;
        }
        robot.found = found;
        if count >= WINDOW {
            // Those that made room are judged again.
            self.plausible.clear();
            *robot.judge = Judge::new(Known::default());
            robot.kept = ThinnedReadings::new();
        }
    }

    /// All that is implausible, by robot.
    pub fn records(&self) -> Vec<Implausible> {
        self.robots.values().flat_map(|robot| robot.found.iter().cloned()).collect()
    }

    /// Takes the findings that are new since the last call, a line each.
    pub fn take_news(&mut self) -> Vec<String> {
        std::mem::take(&mut self.news)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(change: impl Fn(u64, &mut RobotState), readings: u64) -> (Judgement, Vec<String>) {
        let names = vec![(Quantity::Power, "power_W".to_owned())];
        let mut judgement = Judgement::new(Origin::Bridge, Vec::new()).named(names);
        for step in 0..readings {
            let mut state = RobotState::new(7);
            let wave = (step as f32 * 0.7).sin();
            (state.v_mps, state.omega_radps) = (Some(0.2), Some(0.0));
            state.power_w = Some(40.0 + wave);
            (state.voltage_v, state.current_a) =
                (Some(24.0 - 0.01 * wave), Some((40.0 + wave) / 24.0));
            state.soc = Some(0.5);
            change(step, &mut state);
            judgement.take(&state, state.soc, step * 100_000_000);
        }
        let news = judgement.take_news();
        (judgement, news)
    }

    #[test]
    fn a_sound_robot_is_not_reported_and_a_turned_sign_once() {
        let (judgement, news) = judged(|_, _| {}, 3_000);
        assert_eq!((judgement.records(), news), (Vec::new(), Vec::new()));
        let turned = |_: u64, state: &mut RobotState| {
            state.power_w = state.power_w.map(|power_w| -power_w);
            state.current_a = state.current_a.map(|current_a| -current_a);
        };
        let (judgement, news) = judged(turned, 30_000);
        assert_eq!(news.len(), 1, "{news:?}");
        assert!(news[0].contains("robot 7: sign") && news[0].contains("negate = true"), "{news:?}");
        assert_eq!(judgement.records()[0].robot, 7);
    }

    #[test]
    fn robots_of_one_frame_are_judged_in_different_ones() {
        let mut judgement = Judgement::new(Origin::Bridge, Vec::new());
        let mut first_reported = BTreeMap::new();
        for step in 0..400 {
            for robot in 0..4 {
                let mut state = RobotState::new(robot);
                state.power_w = Some(40.0);
                judgement.take(&state, Some(96.0), step * 100_000_000);
                if !judgement.take_news().is_empty() {
                    first_reported.entry(robot).or_insert(step);
                }
            }
        }
        let steps: std::collections::BTreeSet<_> = first_reported.values().collect();
        assert_eq!((first_reported.len(), steps.len()), (4, 4), "{first_reported:?}");
    }

    #[test]
    fn of_more_robots_than_are_judged_at_a_time_each_has_its_turn() {
        let mut judgement = Judgement::new(Origin::Program, Vec::new()).of_at_most(2);
        let mut found = BTreeSet::new();
        for step in 0..30_000_u64 {
            for robot in 0..5 {
                let mut state = RobotState::new(robot);
                state.power_w = Some(40.0 + (step as f32 * 0.7).sin());
                // The last robot from the beginning, the first one after its first round.
                let is_percent = robot == 4 || (robot == 0 && step > 5_000);
                let soc = if is_percent { 96.0 } else { 0.5 };
                judgement.take(&state, Some(soc), step * 100_000_000);
            }
            assert!(judgement.robots.len() <= 2);
            found.extend(judgement.records().into_iter().map(|found| found.robot));
        }
        assert_eq!(found, BTreeSet::from([0, 4]));
    }

    #[test]
    fn a_percentage_is_reported_and_a_finding_ends_when_it_does_not_come_again() {
        let percent =
            |step: u64, state: &mut RobotState| state.soc = Some(96.0 - 1e-4 * step as f32);
        let (_, news) = judged(percent, 200);
        assert!(news.iter().any(|line| line.contains("percentage")), "{news:?}");
        let mends = |step: u64, state: &mut RobotState| {
            if step < 20_000 {
                state.soc = Some(96.0);
            }
        };
        let (judgement, _) = judged(mends, 19_000);
        assert_eq!(judgement.records().len(), 1);
        let (judgement, _) = judged(mends, 25_000);
        assert_eq!(judgement.records(), Vec::new());
    }
}
