//! Interleaved measurements, so that disturbances of the machine affect all of them.

use std::time::{Duration, Instant};

/// Minimum number of repetitions.
const LEAST: usize = 5;

/// Executes one repetition of a measurement and returns its figure.
pub(crate) type Run<'a> = Box<dyn FnMut() -> f64 + 'a>;

/// The figures of all measurements, repetition by repetition. They run interleaved, for `rounds`
/// rounds. One that would take longer than `each` in total takes part in fewer rounds, spread
/// evenly. The first repetition of each is a warm-up and not counted.
pub(crate) fn interleave(mut runs: Vec<Run<'_>>, rounds: usize, each: Duration) -> Vec<Vec<f64>> {
    let every = runs.iter_mut().map(|run| {
        run();
        let start = Instant::now();
        run();
        every(rounds, start.elapsed().as_secs_f64(), each.as_secs_f64())
    });
    let every: Vec<usize> = every.collect();
    let mut values = vec![Vec::new(); runs.len()];
    for round in 0..rounds {
        for (place, run) in runs.iter_mut().enumerate() {
            if round % every[place] == 0 {
                values[place].push(run());
            }
        }
    }
    values
}

/// The n for which a measurement of `one_s` per repetition takes part in every n-th round.
fn every(rounds: usize, one_s: f64, each_s: f64) -> usize {
    let affordable = ((each_s / one_s.max(1e-9)) as usize).max(LEAST.min(rounds));
    rounds.div_ceil(affordable.max(1)).max(1)
}

/// Number of calls per repetition of 100 µs, long enough for the clock's resolution of some 20 ns.
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
    fn slow_measurements_take_part_in_fewer_rounds_but_at_least_the_minimum() {
        let each_s = 2.0;
        for (rounds, one_s, expected) in
            [(1000, 1e-4, 1), (1000, 1e-2, 5), (1000, 10.0, 200), (3, 10.0, 1), (1, 1e-9, 1)]
        {
            assert_eq!(every(rounds, one_s, each_s), expected, "{rounds} {one_s}");
        }
    }

    #[test]
    fn measurements_are_interleaved_and_warmed_up() {
        let order = RefCell::new(String::new());
        let run = |name| -> Run<'_> {
            let order = &order;
            Box::new(move || {
                order.borrow_mut().push(name);
                order.borrow().len() as f64
            })
        };
        let values = interleave(vec![run('a'), run('b')], 2, Duration::from_secs(60));
        assert_eq!(values[0], [5.0, 7.0]);
        assert_eq!(order.into_inner(), "aabbabab");
    }
}
