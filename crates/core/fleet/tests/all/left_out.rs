//! Omitting a part of a tick's outputs does not change the rest.

use joulebus_fleet::{Accounts, Batch, Outputs};
use joulebus_testkit_fleets::{MS, PERIOD_NS, Source, fleet, healthy};
use joulebus_wire::{Budget, Diagnostic, Forecast, PlanState, Sample};

const ROBOTS: u32 = 100;
const START_NS: u64 = 60_000 * MS;

/// Which outputs are written besides forecasts and budgets.
#[derive(Debug, Clone, Copy)]
struct With {
    diagnostics: bool,
    plan_states: bool,
}

/// All outputs of the last of several ticks, in two passes or one; those that are left out stay as
/// they were.
fn run(halves: bool, with: With) -> (Vec<Forecast>, Vec<Budget>, Vec<Diagnostic>, Vec<PlanState>) {
    let (mut fleet, mut source) = (fleet(ROBOTS), Source::new(1, 1));
    let mut forecasts = vec![Forecast::default(); ROBOTS as usize];
    let mut budgets = vec![Budget::default(); ROBOTS as usize];
    let mut diagnostics = vec![Diagnostic::default(); ROBOTS as usize];
    let mut plan_states = vec![PlanState::default(); ROBOTS as usize];
    for step in 0..12 {
        let now_ns = START_NS + step * PERIOD_NS;
        let sample = |robot| healthy(robot, step, now_ns, PERIOD_NS);
        let samples: Vec<Sample> = (0..ROBOTS).map(sample).collect();
        source.send(&mut fleet, &samples, now_ns);
        fleet.begin(now_ns, false);
        let (mut batch, mut shard) = (Batch::default(), fleet.shard());
        let accounts = Accounts {
            diagnostics: if with.diagnostics { &mut diagnostics } else { &mut [] },
            budgets: &mut budgets,
            plan_states: if with.plan_states { &mut plan_states } else { &mut [] },
        };
        let outputs = Outputs { forecasts: &mut forecasts, accounts };
        if halves {
            let (mut first, mut second) = shard.split_at(ROBOTS as usize / 2);
            let (to_first, to_second) = outputs.split_at(first.len());
            first.run(&mut batch, to_first, &mut |_| {});
            second.run(&mut batch, to_second, &mut |_| {});
        } else {
            shard.forecast(&mut batch, outputs.forecasts, &mut |_| {});
            shard.account(&mut batch, outputs.accounts, &mut |_| {});
        }
    }
    (forecasts, budgets, diagnostics, plan_states)
}

#[test]
fn an_output_is_the_same_whatever_else_is_left_out() {
    let with = |diagnostics, plan_states| With { diagnostics, plan_states };
    // As text, in which NaN equals NaN.
    let text = |rows: &dyn std::fmt::Debug| format!("{rows:?}");
    let all = run(false, with(true, true));
    for whole in [text(&all.0), text(&all.1), text(&all.2), text(&all.3)] {
        assert!(whole.contains(&format!("robot: {}", ROBOTS - 1)), "{whole}");
    }
    for halves in [false, true] {
        for (diagnostics, plan_states) in
            [(false, false), (false, true), (true, false), (true, true)]
        {
            let with = with(diagnostics, plan_states);
            let found = run(halves, with);
            assert_eq!(text(&found.0), text(&all.0), "{halves} {with:?}");
            assert_eq!(text(&found.1), text(&all.1), "{halves} {with:?}");
            let untouched = text(&vec![Diagnostic::default(); ROBOTS as usize]);
            let expected = if diagnostics { text(&all.2) } else { untouched };
            assert_eq!(text(&found.2), expected, "{halves} {with:?}");
            let untouched = text(&vec![PlanState::default(); ROBOTS as usize]);
            let expected = if plan_states { text(&all.3) } else { untouched };
            assert_eq!(text(&found.3), expected, "{halves} {with:?}");
        }
    }
}
