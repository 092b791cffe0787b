//! Rows 10 and 11: robots join late, leave, and rejoin.

use std::time::Duration;

use joulebus_tests::{
    Arena, Dice, FrameRead, Planner, Setup, Source, Spread, answer, figure, sample,
};
use joulebus_wire::{Forecast, Forecasts, Quality, Sample};

/// Readings in a lag window.
const WINDOW: u64 = 5;

/// Sends the frame and waits for its answer; returns its tick and its robots.
fn answered(planner: &mut Planner, source: &mut Source, frame: &[Sample]) -> (u64, Vec<Forecast>) {
    source.send(frame);
    let answered = planner.answered(frame);
    (answered.tick, answered.robots)
}

fn line(lines: &[Forecast], robot: u32) -> Forecast {
    *lines.iter().find(|line| line.robot == robot).expect("an answer for each robot")
}

#[test]
fn row_10_a_late_joiner_is_warming_up_and_gets_a_forecast_with_its_fifth_sample() {
    const JOINERS: u32 = 20;
    let setup = Setup { capacity: 32, ..Setup::default() };
    let arena = Arena::new(&setup);
    let _worker = arena.worker();
    let mut planner = arena.planner();
    let mut source = arena.source("fleet");
    let fleet: Vec<u32> = (0..4).collect();
    let (mut seq, mut ticks) = (0, Spread::default());
    let mut most_ticks = 0;
    for joiner in 10..10 + JOINERS {
        let mut joined_tick = None;
        for own in 0..=WINDOW {
            let mut frame: Vec<Sample> =
                fleet.iter().map(|robot| sample(*robot, seq, setup.period_ns())).collect();
            frame.push(sample(joiner, own, setup.period_ns()));
            seq += 1;
            let before = planner.forecasts().last().map_or(0, |frame| frame.tick);
            let (tick, lines) = answered(&mut planner, &mut source, &frame);
            let found = line(&lines, joiner);
            let expected = if own + 1 < WINDOW {
                Quality::Warmup { have: own as u16 + 1 }
            } else {
                Quality::Fresh
            };
            assert_eq!(found.quality(), expected, "robot {joiner} sample {own}");
            assert_eq!(
                found.flags & 1 != 0,
                own + 1 >= WINDOW,
                "a forecast from the fifth sample on only"
            );
            // It appears in the tick that accepts its first sample.
            let first = *joined_tick.get_or_insert(tick);
            assert!(own > 0 || tick > before || before == 0);
            if own + 1 == WINDOW {
                most_ticks = most_ticks.max(tick - first);
            }
        }
        let read = |seq: u64| {
            move |frame: &&FrameRead<Forecasts>| {
                frame.robot(joiner).is_some_and(|line| line.sample_seq >= seq && line.stamp_ns > 0)
            }
        };
        let joined_ns = planner.forecasts().find(read(0)).expect("answered").read_ns;
        let forecast_ns = planner.forecasts().find(read(WINDOW - 1)).expect("answered").read_ns;
        ticks.add_ns(forecast_ns - joined_ns);
    }
    figure(
        "row 10, join to first forecast",
        format_args!("{WINDOW} samples, at most {most_ticks} ticks after the joining one; {ticks}"),
    );
}

#[test]
fn row_11_a_reused_slot_keeps_no_state_of_its_previous_robot() {
    const SAMPLES: u64 = 8;
    let stays = Dice::rounds("JOULEBUS_STAYS", 4);
    // No continuing robot is silent for two seconds, however busy the machine is.
    let setup = Setup { capacity: 4, stale_after_s: 2.0, leave_after_s: 2.0, ..Setup::default() };
    let arena = Arena::new(&setup);
    let _worker = arena.worker();
    let mut planner = arena.planner();
    let mut source = arena.source("fleet");
    let stayers = [2, 3];
    let mut seq = 0;
    let mut stayers_frame = || {
        seq += 1;
        stayers.map(|robot| sample(robot, seq, setup.period_ns())).to_vec()
    };
    let mut first_stay: Vec<Vec<Forecast>> = Vec::new();
    let (mut compared, mut generations) = (0, Vec::new());
    for stay in 0..stays {
        // Two pairs of robots alternate in the same two slots.
        let visitors = if stay % 2 == 0 { [0, 1] } else { [4, 5] };
        for own in 0..SAMPLES {
            let mut frame = stayers_frame();
            frame.extend(visitors.map(|robot| sample(robot, own, setup.period_ns())));
            let (_, lines) = answered(&mut planner, &mut source, &frame);
            assert_eq!(lines.len(), 4);
            let found = visitors.map(|robot| line(&lines, robot));
            if own + 1 < WINDOW {
                let expected = Quality::Warmup { have: own as u16 + 1 };
                assert_eq!(
                    found.map(|line| line.quality()),
                    [expected; 2],
                    "stay {stay}: a lag of the previous robot"
                );
            }
            let at = (stay % 2 * SAMPLES + own) as usize;
            match first_stay.get(at) {
                None => first_stay.push(found.to_vec()),
                Some(first) => {
                    for (first, again) in first.iter().zip(&found) {
                        // Provisional open-loop forecasts of a busy machine are excluded.
                        if !matches!(again.quality(), Quality::OpenLoop { .. }) {
                            let (first, again) = (answer(first), answer(again));
                            assert_eq!(first, again, "stay {stay} sample {own}");
                            compared += 1;
                        }
                    }
                }
            }
            if own == 0 {
                generations.push(found[0].generation);
            }
        }
        // The visitors fall silent; the others continue until the slots are free.
        loop {
            let frame = stayers_frame();
            let (_, lines) = answered(&mut planner, &mut source, &frame);
            if lines.len() == 2 {
                break;
            }
            assert_eq!(lines.len(), 4, "both leave in the same tick, having the same silence");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
    assert!(
        generations.windows(2).all(|pair| pair[0] < pair[1]),
        "each owner has its own generation: {generations:?}"
    );
    assert!(compared as u64 >= (stays - 2) * SAMPLES, "{compared}");
    figure(
        "row 11, stale reads",
        format_args!("0 of {compared} answers after {stays} changes of owner, compared to the bit"),
    );
}
