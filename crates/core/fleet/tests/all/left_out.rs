//! Omitting a part of a tick's outputs does not change the rest.

use joulebus_fleet::{Accounts, Batch, Outputs};
use joulebus_testkit_fleets::{MS, PERIOD_NS, Source, fleet, healthy};
use joulebus_wire::{Budget, Diagnostic, Forecast, Outlook, PlanState, Sample};

const ROBOTS: u32 = 100;
const START_NS: u64 = 60_000 * MS;

/// Which outputs are written besides forecasts and budgets.
#[derive(Debug, Clone, Copy)]
struct With {
    diagnostics: bool,
    plan_states: bool,
    outlooks: bool,
}

/// The outputs of a tick.
type Rows = (Vec<Forecast>, Vec<Budget>, Vec<Diagnostic>, Vec<PlanState>, Vec<Outlook>);

/// All outputs of the last of several ticks, in two passes or one; those that are left out stay as
/// they were.
fn run(halves: bool, with: With) -> Rows {
    let (mut fleet, mut source) = (fleet(ROBOTS), Source::new(1, 1));
    let mut forecasts = vec![Forecast::default(); ROBOTS as usize];
    let mut budgets = vec![Budget::default(); ROBOTS as usize];
    let mut diagnostics = vec![Diagnostic::default(); ROBOTS as usize];
    let mut plan_states = vec![PlanState::default(); ROBOTS as usize];
    let mut outlooks = vec![Outlook::default(); ROBOTS as usize];
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
            outlooks: if with.outlooks { &mut outlooks } else { &mut [] },
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
    (forecasts, budgets, diagnostics, plan_states, outlooks)
}

#[test]
fn an_output_is_the_same_whatever_else_is_left_out() {
    // As text, in which NaN equals NaN.
    let text = |rows: &dyn std::fmt::Debug| format!("{rows:?}");
    let all = run(false, With { diagnostics: true, plan_states: true, outlooks: true });
    for whole in [text(&all.0), text(&all.1), text(&all.2), text(&all.3), text(&all.4)] {
        assert!(whole.contains(&format!("robot: {}", ROBOTS - 1)), "{whole}");
    }
    let untouched = (
        text(&vec![Diagnostic::default(); ROBOTS as usize]),
        text(&vec![PlanState::default(); ROBOTS as usize]),
        text(&vec![Outlook::default(); ROBOTS as usize]),
    );
    for bits in 0..16 {
        let [halves, diagnostics, plan_states, outlooks] = [1, 2, 4, 8].map(|bit| bits & bit != 0);
        let with = With { diagnostics, plan_states, outlooks };
        let found = run(halves, with);
        let or =
            |written: bool, all: String, other: &String| if written { all } else { other.clone() };
        assert_eq!(text(&found.0), text(&all.0), "{halves} {with:?}");
        assert_eq!(text(&found.1), text(&all.1), "{halves} {with:?}");
        let expected = or(diagnostics, text(&all.2), &untouched.0);
        assert_eq!(text(&found.2), expected, "{halves} {with:?}");
        let expected = or(plan_states, text(&all.3), &untouched.1);
        assert_eq!(text(&found.3), expected, "{halves} {with:?}");
        let expected = or(outlooks, text(&all.4), &untouched.2);
        assert_eq!(text(&found.4), expected, "{halves} {with:?}");
    }
}
