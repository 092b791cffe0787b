//! Missions of several policies as a table and as JSON.

use std::fmt;

use joulebus_statistics::bootstrap::{Bootstrap, Estimate};
use serde::Serialize;

use crate::policy::Policy;
use crate::run::Outcome;
use crate::scenario::Scenario;

/// Draws of the intervals.
const RESAMPLES: u32 = 10_000;

/// The missions of one policy, in the order of their seeds.
#[derive(Debug, Clone, PartialEq)]
pub struct Runs {
    /// The policy.
    pub policy: Policy,
    /// Outcomes, one per seed.
    pub outcomes: Vec<Outcome>,
}

/// The outcomes of all policies. `Display` is a table. Unknown numbers are null in JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// The conditions of all policies.
    pub scenario: Scenario,
    /// The first seed.
    pub first_seed: u64,
    /// Missions of each policy.
    pub missions: usize,
    /// One summary per policy.
    pub policies: Vec<PolicySummary>,
    /// The comparison that the benchmark is about.
    pub verdict: Option<Comparison>,
}

/// The outcomes of one policy.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PolicySummary {
    /// Its name.
    pub name: &'static str,
    /// Its setting.
    pub setting: String,
    /// Tasks finished an hour.
    pub tasks_per_h: Estimate,
    /// Robots stranded in all missions.
    pub stranded: u64,
    /// Stranded robots a mission.
    pub stranded_per_mission: Estimate,
    /// Relative number of additional tasks of joulebus (the last policy), paired by seed.
    pub joulebus_more: Estimate,
    /// Tasks broken off to charge, a mission.
    pub broken_off: f64,
    /// Charges an hour.
    pub charges_per_h: f64,
    /// Share of the chargers' time in which one stored energy.
    pub charger_use: f64,
    /// Mean true state of charge at the beginning of a charge.
    pub soc_before: f64,
    /// Share of the robots' time on tasks.
    pub at_work: f64,
    /// Share of the robots' time on the way to a charger or waiting for one.
    pub in_line: f64,
    /// Seconds per mission in which a full robot was allowed no task.
    pub idle_full_s: f64,
    /// Every mission.
    pub outcomes: Vec<Outcome>,
}

/// Joulebus compared with the best baseline that strands at most as many robots.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The baseline. `None` if all of them strand more.
    pub baseline: Option<&'static str>,
    /// Tasks of joulebus over its, less 1.
    pub more: Option<Estimate>,
    /// Robots that joulebus strands.
    pub stranded: u64,
}

impl Summary {
    /// Summarises the missions of each policy, all of the same seeds, joulebus last. The oracle is
    /// no baseline.
    pub fn new(scenario: Scenario, first_seed: u64, runs: &[Runs]) -> Self {
        let last = runs.last().map(|runs| runs.outcomes.as_slice());
        let policies = runs.iter().map(|own| summary(own, last.unwrap_or_default(), &scenario));
        let policies: Vec<PolicySummary> = policies.collect();
        Self {
            scenario,
            first_seed,
            missions: runs.first().map_or(0, |runs| runs.outcomes.len()),
            verdict: verdict(&policies),
            policies,
        }
    }
}

fn verdict(policies: &[PolicySummary]) -> Option<Comparison> {
    let (joulebus, baselines) = policies.split_last()?;
    if joulebus.name != "joulebus" {
        return None;
    }
    let safe = baselines
        .iter()
        .filter(|other| other.name != Policy::Oracle.name() && other.stranded <= joulebus.stranded);
    let tasks = |policy: &PolicySummary| policy.tasks_per_h.value;
    let best = safe.max_by(|one, other| tasks(one).total_cmp(&tasks(other)));
    Some(Comparison {
        baseline: best.map(|best| best.name),
        more: best.map(|best| best.joulebus_more),
        stranded: joulebus.stranded,
    })
}

fn summary(runs: &Runs, joulebus: &[Outcome], scenario: &Scenario) -> PolicySummary {
    let outcomes = &runs.outcomes;
    let hours = scenario.duration_s / 3600.0;
    let count = outcomes.len() as f64;
    let mean = |of: fn(&Outcome) -> f64| outcomes.iter().map(of).sum::<f64>() / count;
    let bootstrap = Bootstrap { resamples: RESAMPLES, ..Bootstrap::default() };
    let estimates = bootstrap.estimate(outcomes.len(), |seeds| {
        let sum = |of: &[Outcome], value: fn(&Outcome) -> u64| {
            seeds.iter().map(|seed| value(&of[*seed])).sum::<u64>() as f64
        };
        let drawn = seeds.len() as f64;
        let tasks = sum(outcomes, |outcome| outcome.tasks);
        vec![
            tasks / drawn / hours,
            sum(outcomes, |outcome| outcome.stranded) / drawn,
            sum(joulebus, |outcome| outcome.tasks) / tasks - 1.0,
        ]
    });
    PolicySummary {
        name: runs.policy.name(),
        setting: runs.policy.to_string(),
        tasks_per_h: estimates[0],
        stranded: outcomes.iter().map(|outcome| outcome.stranded).sum(),
        stranded_per_mission: estimates[1],
        joulebus_more: estimates[2],
        broken_off: mean(|outcome| outcome.broken_off as f64),
        charges_per_h: mean(|outcome| outcome.charges as f64) / hours,
        charger_use: mean(|outcome| outcome.charger_use),
        soc_before: mean(|outcome| outcome.soc_before),
        at_work: mean(|outcome| outcome.at_work),
        in_line: mean(|outcome| outcome.in_line),
        idle_full_s: mean(|outcome| outcome.idle_full as f64),
        outcomes: outcomes.clone(),
    }
}

/// An estimate with its interval, if it has one.
struct Shown(Estimate, usize);

impl fmt::Display for Shown {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(Estimate { value, lo, hi }, digits) = *self;
        let words = if lo.is_finite() && hi.is_finite() {
            format!("{value:.digits$} [{lo:.digits$}, {hi:.digits$}]")
        } else {
            format!("{value:.digits$}")
        };
        out.pad(&words)
    }
}

fn percent(estimate: Estimate) -> Estimate {
    Estimate { value: 100.0 * estimate.value, lo: 100.0 * estimate.lo, hi: 100.0 * estimate.hi }
}

impl fmt::Display for Summary {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Scenario { robots, chargers, duration_s, capacity_j, dragging_share, .. } =
            self.scenario;
        let (missions, first) = (self.missions, self.first_seed);
        writeln!(
            out,
            "{missions} missions of {:.2} h each, seeds from {first}: {robots} robots of {:.2} Wh, {chargers} \
             chargers, a dragging brush in {:.0} % of the robots",
            duration_s / 3600.0,
            capacity_j / 3600.0,
            100.0 * dragging_share
        )?;
        writeln!(
            out,
            "{:<10} {:<30} {:>24} {:>9} {:>22} {:>11} {:>10} {:>8} {:>10} {:>8} {:>8}",
            "policy",
            "setting",
            "tasks/h",
            "stranded",
            "joulebus does more, %",
            "broken off",
            "charges/h",
            "charging",
            "SoC before",
            "at work",
            "in line"
        )?;
        for policy in &self.policies {
            writeln!(
                out,
                "{:<10} {:<30} {:>24} {:>9} {:>22} {:>11.1} {:>10.0} {:>7.0}% {:>9.0}% {:>7.0}% {:>7.0}%",
                policy.name,
                policy.setting,
                Shown(policy.tasks_per_h, 0),
                policy.stranded,
                Shown(percent(policy.joulebus_more), 1),
                policy.broken_off,
                policy.charges_per_h,
                100.0 * policy.charger_use,
                100.0 * policy.soc_before,
                100.0 * policy.at_work,
                100.0 * policy.in_line,
            )?;
        }
        match &self.verdict {
            Some(Comparison { baseline: Some(name), more: Some(more), stranded }) => writeln!(
                out,
                "joulebus strands {stranded} robots and does {} % more tasks than {name}, the best baseline \
                 that strands at most as many",
                Shown(percent(*more), 1)
            ),
            Some(Comparison { stranded, .. }) => {
                writeln!(out, "joulebus strands {stranded} robots. Every baseline strands more")
            }
            None => Ok(()),
        }
    }
}
