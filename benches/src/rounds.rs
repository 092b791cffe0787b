//! Measurements that take turns, so that whatever disturbs the machine disturbs all of them.

use std::time::{Duration, Instant};

/// A measurement repeated less often than this has no distribution worth the name.
const LEAST: usize = 5;

/// One measurement of several that take turns.
pub(crate) struct Turn<'a> {
    run: Box<dyn FnMut() -> f64 + 'a>,
    /// Takes part in every so many rounds.
    every: usize,
    values: Vec<f64>,
}

impl<'a> Turn<'a> {
    /// `run` does one repetition and returns its figure.
    pub(crate) fn new(run: impl FnMut() -> f64 + 'a) -> Self {
        Self {
            run: Box::new(run),
            every: 1,
            values: Vec::new(),
        }
    }

    /// What was measured, repetition by repetition.
    pub(crate) fn values(&self) -> &[f64] {
        &self.values
    }
}

/// Runs all in turn, `rounds` times. One that would take longer than `each` in all takes part in
/// fewer rounds, spread evenly. The first repetition of each warms up and does not count.
pub(crate) fn take_turns(turns: &mut [Turn<'_>], rounds: usize, each: Duration) {
    for turn in turns.iter_mut() {
        (turn.run)();
        let start = Instant::now();
        (turn.run)();
        let one = start.elapsed().as_secs_f64();
        turn.every = every(rounds, one, each.as_secs_f64());
    }
    for round in 0..rounds {
        let due = turns.iter_mut().filter(|turn| round % turn.every == 0);
        for turn in due {
            turn.values.push((turn.run)());
        }
    }
}

/// Of how many rounds one that takes `one_s` a repetition takes part in one.
fn every(rounds: usize, one_s: f64, each_s: f64) -> usize {
    let affordable = ((each_s / one_s.max(1e-9)) as usize).max(LEAST.min(rounds));
    rounds.div_ceil(affordable.max(1)).max(1)
}

/// Calls that make a repetition long enough for the clock, which resolves some 20 ns: 100 µs.
pub(crate) fn calls(mut call: impl FnMut()) -> usize {
    const ENOUGH: Duration = Duration::from_micros(100);
    call();
    let mut calls = 1;
    loop {
        let start = Instant::now();
        for _ in 0..calls {
            call();
        }
        if start.elapsed() >= ENOUGH || calls >= 1 << 20 {
            return calls;
        }
        calls *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    #[test]
    fn slow_ones_take_part_in_fewer_rounds_but_never_in_too_few() {
        for (rounds, one_s, each_s, expected) in [
            (1000, 1e-4, 2.0, 1),
            (1000, 1e-2, 2.0, 5),
            (1000, 10.0, 2.0, 200),
            (3, 10.0, 2.0, 1),
            (1, 1e-9, 2.0, 1),
        ] {
            assert_eq!(every(rounds, one_s, each_s), expected, "{rounds} {one_s}");
        }
    }

    #[test]
    fn measurements_take_turns_and_warm_up_first() {
        let order = RefCell::new(Vec::new());
        let mut turns: Vec<Turn<'_>> = ["a", "b"]
            .into_iter()
            .map(|name| {
                let order = &order;
                let mut count = 0.0;
                Turn::new(move || {
                    order.borrow_mut().push(name);
                    count += 1.0;
                    count
                })
            })
            .collect();
        take_turns(&mut turns, 2, Duration::from_secs(60));
        assert_eq!(turns[0].values(), [3.0, 4.0]);
        drop(turns);
        assert_eq!(order.into_inner().concat(), "aabbabab");
    }
}
