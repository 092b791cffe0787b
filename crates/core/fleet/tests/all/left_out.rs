//! Omitting a part of a tick's outputs does not change the rest.

use std::fmt::Debug;

use joulebus_fleet::{Batch, OutputRows};
use joulebus_testkit_fleets::{MS, PERIOD_NS, Source, fleet, healthy};
use joulebus_wire::Sample;

const ROBOTS: u32 = 100;
const START_NS: u64 = 60_000 * MS;

/// Which outputs are written besides forecasts and budgets.
#[derive(Debug, Clone, Copy)]
struct With {
    diagnostics: bool,
    plan_states: bool,
    outlooks: bool,
}

/// All outputs of the last of several ticks, in two passes or one; those that are left out stay as
/// they were.
fn run(halves: bool, with: With) -> OutputRows {
    let (mut fleet, mut source) = (fleet(ROBOTS), Source::new(1, 1));
    let mut rows = OutputRows::new(ROBOTS as usize);
    for step in 0..12 {
        let now_ns = START_NS + step * PERIOD_NS;
        let sample = |robot| healthy(robot, step, now_ns, PERIOD_NS);
        let samples: Vec<Sample> = (0..ROBOTS).map(sample).collect();
        source.send(&mut fleet, &samples, now_ns);
        fleet.begin(now_ns, false);
        let (mut batch, mut shard) = (Batch::default(), fleet.shard());
        let mut outputs = rows.outputs(ROBOTS as usize);
        let secondary = &mut outputs.secondary;
        if !with.diagnostics {
            secondary.diagnostics = &mut [];
        }
        if !with.plan_states {
            secondary.plan_states = &mut [];
        }
        if !with.outlooks {
            secondary.outlooks = &mut [];
        }
        if halves {
            let (mut first, mut second) = shard.split_at(ROBOTS as usize / 2);
            let (to_first, to_second) = outputs.split_at(first.len());
            first.run(&mut batch, to_first, &mut |_| {});
            second.run(&mut batch, to_second, &mut |_| {});
        } else {
            shard.forecast(&mut batch, outputs.forecasts, &mut |_| {});
            shard.account(&mut batch, outputs.secondary, &mut |_| {});
        }
    }
    rows
}

/// The outputs as text, in which NaN equals NaN.
fn text(rows: &OutputRows) -> [String; 5] {
    let OutputRows { forecasts, budgets, diagnostics, plan_states, outlooks } = rows;
    let outputs: [&dyn Debug; 5] = [forecasts, budgets, diagnostics, plan_states, outlooks];
    outputs.map(|rows| format!("{rows:?}"))
}

#[test]
fn an_output_is_the_same_whatever_else_is_left_out() {
    let all = text(&run(false, With { diagnostics: true, plan_states: true, outlooks: true }));
    for whole in &all {
        assert!(whole.contains(&format!("robot: {}", ROBOTS - 1)), "{whole}");
    }
    let untouched = text(&OutputRows::new(ROBOTS as usize));
    for bits in 0..16 {
        let [halves, diagnostics, plan_states, outlooks] = [1, 2, 4, 8].map(|bit| bits & bit != 0);
        let with = With { diagnostics, plan_states, outlooks };
        let found = text(&run(halves, with));
        for (output, is_written) in
            [true, true, diagnostics, plan_states, outlooks].into_iter().enumerate()
        {
            let expected = if is_written { &all } else { &untouched };
            assert_eq!(found[output], expected[output], "{halves} {with:?}");
        }
    }
}
