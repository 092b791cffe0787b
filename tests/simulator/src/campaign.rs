//! Runs many seeds, on several threads.

use std::fmt;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use serde::Serialize;

use crate::hosts;
use crate::scenario::Scenario;
use crate::shrink::shrink;
use crate::world::{Outcome, run};
use crate::{Failure, Grown};

const HOUR_NS: f64 = 3_600e9;
/// Duration of a seed of linked hosts, ns.
const LINKED_NS: u64 = 300_000_000_000;

/// Which seeds are run, and how.
#[derive(Debug, Clone, Default)]
pub struct Campaign {
    pub first: u64,
    pub seeds: u64,
    /// Duration of each instead of its own, ns.
    pub duration_ns: Option<u64>,
    /// Earlier end, ns.
    pub until_ns: Option<u64>,
    /// Only the faults of these numbers.
    pub only: Option<Vec<usize>>,
    /// Fleets over several hosts, joined by links. Their plans are not made small.
    pub linked: bool,
    pub threads: usize,
    /// True if a failing seed is made small.
    pub shrinks: bool,
}

/// Results of a campaign.
#[derive(Debug, Default, Serialize)]
pub struct Totals {
    pub seeds: u64,
    /// Simulated time, hours.
    pub simulated_h: f64,
    /// Ticks of all workers.
    pub ticks: u64,
    pub faults: u64,
    pub processes: u64,
    /// Files of captures that were computed again.
    pub captures: u64,
    pub verified_ticks: u64,
    /// Questions about plans that clients were answered.
    pub questions: u64,
    /// Answers and ledgers compared with undisturbed runs.
    pub answers: u64,
    /// By how much processes of each kind have grown at most, bytes.
    pub grown_bytes: Grown,
    pub failed: Vec<Failed>,
}

/// A seed that failed.
#[derive(Debug, Serialize)]
pub struct Failed {
    pub seed: u64,
    /// The invariant that did not hold.
    pub failure: Failure,
    /// Faults of its plan, and those that are left of them, each with its number.
    pub planned: usize,
    /// The faults left: number, time in s, fault.
    pub left: Vec<(usize, f64, String)>,
    /// The command that does the same again.
    pub command: String,
}

impl Totals {
    fn add(&mut self, outcome: &Outcome) {
        self.seeds += 1;
        self.simulated_h += outcome.simulated_ns as f64 / HOUR_NS;
        self.ticks += outcome.ticks;
        self.faults += outcome.faults;
        self.processes += outcome.processes;
        self.captures += outcome.captures;
        self.verified_ticks += outcome.verified_ticks;
        self.questions += outcome.questions;
        self.answers += outcome.answers;
        self.grown_bytes.take(&outcome.grown);
    }
}

impl fmt::Display for Totals {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "{} seeds, {:.1} simulated hours: {} ticks, {} faults, {} processes",
            self.seeds, self.simulated_h, self.ticks, self.faults, self.processes
        )?;
        writeln!(
            out,
            "{} captures with {} ticks computed again, {} answers compared with undisturbed runs, {} questions \
             answered",
            self.captures, self.verified_ticks, self.answers, self.questions
        )?;
        let grown = &self.grown_bytes;
        writeln!(
            out,
            "processes have grown by at most: worker {}, source {}, planner {}, client {}, recorder {}, display {}, \
             bridge {} bytes",
            grown.worker,
            grown.source,
            grown.planner,
            grown.client,
            grown.recorder,
            grown.display,
            grown.bridge
        )?;
        for failed in &self.failed {
            writeln!(out, "{failed}")?;
        }
        write!(out, "{} seeds failed", self.failed.len())
    }
}

impl fmt::Display for Failed {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at_s = self.failure.at_ns as f64 * 1e-9;
        writeln!(
            out,
            "seed {}: \"{}\" does not hold after {at_s:.3} s",
            self.seed, self.failure.invariant
        )?;
        writeln!(out, "  {}", self.failure.found)?;
        writeln!(out, "  {} of {} faults are left:", self.left.len(), self.planned)?;
        for (number, at_s, fault) in &self.left {
            writeln!(out, "  {number:>5} {at_s:>12.3} s  {fault}")?;
        }
        write!(out, "  again: {}", self.command)
    }
}

/// Runs a campaign. `progress` gets the number of seeds done. Setting `stop` gives up running
/// seeds.
pub fn play(campaign: &Campaign, stop: &AtomicBool, progress: impl Fn(u64) + Sync) -> Totals {
    let next = AtomicU64::new(campaign.first);
    let totals = Mutex::new(Totals::default());
    let work = || {
        while !stop.load(Ordering::Relaxed) {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed - campaign.first >= campaign.seeds {
                return;
            }
            let (outcome, failed) = one(campaign, seed, stop);
            if outcome.is_stopped {
                return;
            }
            let mut totals = totals.lock().unwrap_or_else(PoisonError::into_inner);
            totals.add(&outcome);
            totals.failed.extend(failed);
            let done = totals.seeds;
            drop(totals);
            progress(done);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..campaign.threads.max(1) {
            scope.spawn(work);
        }
    });
    let mut totals = totals.into_inner().unwrap_or_else(PoisonError::into_inner);
    totals.failed.sort_by_key(|failed| failed.seed);
    totals
}

fn one(campaign: &Campaign, seed: u64, stop: &AtomicBool) -> (Outcome, Option<Failed>) {
    if campaign.linked {
        let duration_ns = campaign.duration_ns.unwrap_or(LINKED_NS);
        let (outcome, left) = hosts::run(seed, duration_ns, stop);
        let hours = duration_ns as f64 / HOUR_NS;
        let command = format!("joulebus-sim --linked --seed {seed} --hours {hours}");
        let failure = outcome.failure.clone();
        let planned = left.len();
        let failed = failure.map(|failure| Failed { seed, failure, planned, left, command });
        return (outcome, failed);
    }
    let whole = Scenario::new(seed, campaign.duration_ns);
    let planned = whole.faults.len();
    let whole = match campaign.until_ns {
        Some(until_ns) => whole.until(until_ns),
        None => whole,
    };
    let scenario = match &campaign.only {
        Some(numbers) => whole.only(numbers),
        None => whole,
    };
    let run = |scenario: &Scenario| run(scenario, stop);
    let outcome = run(&scenario);
    if outcome.failure.is_none() {
        return (outcome, None);
    }
    let (small, of_small) = if campaign.shrinks {
        shrink(&scenario, &outcome, run, || stop.load(Ordering::Relaxed))
    } else {
        (scenario, outcome.clone())
    };
    let left = small
        .faults
        .iter()
        .map(|(number, (at_ns, fault))| (*number, *at_ns as f64 * 1e-9, format!("{fault:?}")));
    let failed = of_small.failure.map(|failure| Failed {
        seed,
        failure,
        planned,
        left: left.collect(),
        command: command(&small),
    });
    (outcome, failed)
}

fn command(scenario: &Scenario) -> String {
    let numbers: Vec<String> =
        scenario.faults.iter().map(|(number, _)| number.to_string()).collect();
    // The plan depends on the duration: it is that of the whole scenario, cut at the end.
    let until = match scenario.whole_ns == scenario.duration_ns {
        true => String::new(),
        false => format!(" --until-ns {}", scenario.duration_ns),
    };
    let hours = scenario.asked_ns.map(|ns| format!(" --hours {}", ns as f64 / HOUR_NS));
    let only = if numbers.is_empty() { "none".to_owned() } else { numbers.join(",") };
    format!(
        "joulebus-sim --seed {}{}{until} --only {only}",
        scenario.seed,
        hours.unwrap_or_default()
    )
}
