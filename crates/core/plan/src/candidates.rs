//! Command sequences to compare.

use joulebus_energy::Commands;

use crate::error::AskError;
use crate::limits::{MAX_PERIOD_S, MAX_STEPS};

/// Candidate command sequences, all of one length, one after the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidates<'a> {
    count: usize,
    steps: usize,
    period_s: f32,
    v_mps: &'a [f32],
    omega_radps: &'a [f32],
}

impl<'a> Candidates<'a> {
    /// `count` candidates. Both columns hold the steps of the first, then of the second, and so on.
    /// Each command is in force for `period_s`.
    ///
    /// # Errors
    /// Lengths that do not match, more than [`MAX_STEPS`] steps, or a period that is not above 0.
    pub fn new(
        count: usize,
        period_s: f32,
        v_mps: &'a [f32],
        omega_radps: &'a [f32],
    ) -> Result<Self, AskError> {
        let steps = v_mps.len().checked_div(count).unwrap_or(0);
        if steps == 0 {
            return Err(AskError::Empty { candidates: count, steps });
        }
        let allowed = steps * count;
        for (column, found) in [("v_mps", v_mps.len()), ("omega_radps", omega_radps.len())] {
            if found != allowed {
                return Err(AskError::Shape { column, found, allowed, candidates: count });
            }
        }
        if steps > MAX_STEPS {
            return Err(AskError::Steps { found: steps, allowed: MAX_STEPS });
        }
        if !(period_s > 0.0 && period_s <= MAX_PERIOD_S) {
            return Err(AskError::Period { found: period_s, allowed: MAX_PERIOD_S });
        }
        Ok(Self { count, steps, period_s, v_mps, omega_radps })
    }

    /// Number of candidates.
    #[must_use]
    pub const fn count(&self) -> usize {
        self.count
    }

    /// Steps of each.
    #[must_use]
    pub const fn steps(&self) -> usize {
        self.steps
    }

    /// The commands of each candidate.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Commands<'a>> + '_ {
        (0..self.count).map(|candidate| {
            let steps = candidate * self.steps..(candidate + 1) * self.steps;
            Commands {
                period_s: self.period_s,
                v_mps: &self.v_mps[steps.clone()],
                omega_radps: &self.omega_radps[steps],
            }
        })
    }

    /// Checks that every command is finite and within the limits of a platform, m/s and rad/s.
    pub(crate) fn check(
        &self,
        platform: &str,
        (v_max_mps, omega_max_radps): (f32, f32),
    ) -> Result<(), AskError> {
        for (column, values, allowed) in
            [("v_mps", self.v_mps, v_max_mps), ("omega_radps", self.omega_radps, omega_max_radps)]
        {
            let within = |value: &f32| value.abs() <= allowed;
            // Without an early exit, so that the loop becomes one of vectors.
            if values.iter().fold(true, |all, value| all & within(value)) {
                continue;
            }
            let at = values.iter().position(|value| !within(value)).unwrap_or(0);
            return Err(AskError::Command {
                column,
                candidate: at / self.steps,
                step: at % self.steps,
                found: values[at],
                platform: platform.to_owned(),
                allowed,
            });
        }
        Ok(())
    }
}

/// The steps of a plan from one to another.
pub(crate) fn part(commands: Commands<'_>, from: usize, to: usize) -> Commands<'_> {
    let to = to.min(commands.steps());
    let from = from.min(to);
    Commands {
        v_mps: &commands.v_mps[from..to],
        omega_radps: &commands.omega_radps[from..to],
        ..commands
    }
}
