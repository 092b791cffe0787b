//! Omitting a part of a tick's outputs does not change the rest.

use joulebus_fleet::{Batch, OutputRows, SecondaryOutputs};
use joulebus_testkit_fleets::{MS, PERIOD_NS, Source, fleet, healthy};
use joulebus_wire::Sample;

const ROBOTS: u32 = 100;
const START_NS: u64 = 60_000 * MS;

/// Declares what is done with each output beside the forecasts.
macro_rules! each_secondary {
    ($($(#[doc = $doc:literal])* $rows:ident: $channel:ident, $row:ident, $get:ident,
        $computed:expr, |$fleet:ident, $forecasts:ident| $header:ident { $($fields:tt)* };)*
    ) => {
        const SECONDARY: usize = [$(stringify!($rows)),*].len();

        /// Leaves out the outputs whose element of `written` is false.
        fn leave_out(outputs: &mut SecondaryOutputs<'_>, written: [bool; SECONDARY]) {
            let mut written = written.into_iter();
            $(if written.next() == Some(false) {
                outputs.$rows = &mut [];
            })*
        }

        /// The outputs as text, in which NaN equals NaN.
        fn text(rows: &OutputRows) -> Vec<String> {
            vec![format!("{:?}", rows.forecasts), $(format!("{:?}", rows.$rows)),*]
        }
    };
}

joulebus_fleet::secondary_outputs!(each_secondary);

/// All outputs of the last of several ticks, in two passes or one; those that are left out stay as
/// they were.
fn run(halves: bool, written: [bool; SECONDARY]) -> OutputRows {
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
        leave_out(&mut outputs.secondary, written);
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

#[test]
fn an_output_is_the_same_whatever_else_is_left_out() {
    let all = text(&run(false, [true; SECONDARY]));
    for whole in &all {
        assert!(whole.contains(&format!("robot: {}", ROBOTS - 1)), "{whole}");
    }
    let untouched = text(&OutputRows::new(ROBOTS as usize));
    for bits in 0..1 << SECONDARY {
        let written = std::array::from_fn(|output| bits & (1 << output) != 0);
        for halves in [false, true] {
            let found = text(&run(halves, written));
            for (output, is_written) in [true].into_iter().chain(written).enumerate() {
                let expected = if is_written { &all } else { &untouched };
                assert_eq!(found[output], expected[output], "{halves} {written:?}");
            }
        }
    }
}
