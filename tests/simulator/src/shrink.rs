//! Makes a failing scenario small: fewer faults, and shorter.

use crate::scenario::Scenario;
use crate::world::Outcome;

/// The smallest scenario found that fails with the same invariant as `scenario`, and its result.
/// `run` runs a scenario; `give_up` is asked before each further run.
pub fn shrink(
    scenario: &Scenario,
    outcome: &Outcome,
    run: impl Fn(&Scenario) -> Outcome,
    give_up: impl Fn() -> bool,
) -> (Scenario, Outcome) {
    let mut small = Small { scenario: scenario.clone(), outcome: outcome.clone(), run };
    // Later events do not matter.
    if let Some(failure) = &outcome.failure {
        small.accepts(scenario.clone().until(failure.at_ns + scenario.setup.period_ns));
    }
    let mut part = small.scenario.faults.len().div_ceil(2).max(1);
    loop {
        let mut from = 0;
        let mut is_smaller = false;
        while from < small.scenario.faults.len() {
            if give_up() {
                return (small.scenario, small.outcome);
            }
            let mut fewer = small.scenario.clone();
            let until = (from + part).min(fewer.faults.len());
            fewer.faults.drain(from..until);
            if small.accepts(fewer) {
                is_smaller = true;
            } else {
                from += part;
            }
        }
        if part == 1 && !is_smaller {
            return (small.scenario, small.outcome);
        }
        part = part.div_ceil(2);
    }
}

struct Small<R> {
    scenario: Scenario,
    outcome: Outcome,
    run: R,
}

impl<R: Fn(&Scenario) -> Outcome> Small<R> {
    /// Takes a smaller scenario if it fails in the same way.
    fn accepts(&mut self, smaller: Scenario) -> bool {
        let outcome = (self.run)(&smaller);
        let name = |outcome: &Outcome| outcome.failure.as_ref().map(|failure| failure.invariant);
        let is_same = name(&outcome).is_some() && name(&outcome) == name(&self.outcome);
        if is_same {
            (self.scenario, self.outcome) = (smaller, outcome);
        }
        is_same
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Failure;

    /// Fails if all of `needed` happen before the end.
    fn outcome(scenario: &Scenario, needed: &[usize]) -> Outcome {
        let happens = |number: &usize| scenario.faults.iter().any(|(other, _)| other == number);
        let last_ns = scenario.faults.iter().map(|(_, (at_ns, _))| *at_ns).max().unwrap_or(0);
        let failure = needed.iter().all(happens).then(|| Failure {
            invariant: "invented",
            found: String::new(),
            at_ns: last_ns,
        });
        Outcome { failure, ..Outcome::default() }
    }

    #[test]
    fn of_all_faults_those_that_are_needed_are_left() {
        let whole = (1..).map(|seed| Scenario::new(seed, None));
        let whole =
            whole.into_iter().find(|scenario| scenario.faults.len() > 200).expect("there are many");
        for needed in [&[][..], &[0], &[3, 17], &[5, 6, 150], &[199]] {
            let run = |scenario: &Scenario| outcome(scenario, needed);
            let (small, _) = shrink(&whole, &run(&whole), run, || false);
            let left: Vec<usize> = small.faults.iter().map(|(number, _)| *number).collect();
            assert_eq!(left, needed);
            let (all, _) = shrink(&whole, &run(&whole), run, || true);
            assert_eq!(all.faults.len(), whole.faults.len(), "it was given up");
        }
    }
}
