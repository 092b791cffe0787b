//! Omitting a part of a tick's outputs does not change the rest.

mod world;

use joulebus_fleet::{Batch, Outputs};
use joulebus_wire::{Budget, Diagnostic, Forecast, Sample};
use world::{MS, PERIOD_NS, Source, fleet, healthy};

const ROBOTS: u32 = 100;
const START_NS: u64 = 60_000 * MS;

/// Budgets and forecasts of the last of several ticks, in two passes or one, with diagnostics or
/// without.
fn run(halves: bool, with_diagnostics: bool) -> (Vec<Forecast>, Vec<Budget>) {
    let (mut fleet, mut source) = (fleet(ROBOTS), Source::new(1, 1));
    let mut forecasts = vec![Forecast::default(); ROBOTS as usize];
    let mut budgets = vec![Budget::default(); ROBOTS as usize];
    let mut diagnostics = vec![Diagnostic::default(); ROBOTS as usize];
    for step in 0..12 {
        let now_ns = START_NS + step * PERIOD_NS;
        let sample = |robot| healthy(robot, step, now_ns, PERIOD_NS);
        let samples: Vec<Sample> = (0..ROBOTS).map(sample).collect();
        source.send(&mut fleet, &samples, now_ns);
        fleet.begin(now_ns, false);
        let (mut batch, mut shard) = (Batch::default(), fleet.shard());
        let outputs = Outputs {
            forecasts: &mut forecasts,
            diagnostics: if with_diagnostics {
                &mut diagnostics
            } else {
                &mut []
            },
            budgets: &mut budgets,
        };
        if halves {
            let (mut first, mut second) = shard.split_at(ROBOTS as usize / 2);
            let (to_first, to_second) = outputs.split_at(first.len());
            first.run(&mut batch, to_first, &mut |_| {});
            second.run(&mut batch, to_second, &mut |_| {});
        } else {
            shard.forecast(&mut batch, outputs.forecasts, &mut |_| {});
            shard.account(
                &mut batch,
                outputs.diagnostics,
                outputs.budgets,
                &mut |_| {},
            );
        }
    }
    (forecasts, budgets)
}

#[test]
fn forecasts_and_budgets_are_the_same_where_diagnostics_are_left_out() {
    // As text, in which NaN equals NaN.
    let whole = format!("{:?}", run(false, true));
    assert!(whole.contains(&format!("robot: {}", ROBOTS - 1)), "{whole}");
    for (halves, with_diagnostics) in [(false, false), (true, true), (true, false)] {
        let found = format!("{:?}", run(halves, with_diagnostics));
        assert_eq!(found, whole, "{halves} {with_diagnostics}");
    }
}
