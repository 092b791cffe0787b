//! Many trials as a fleet: every sample once, in order, in frames that do not depend on the
//! playback speed.

use joulebus_dataset::trial::{Playback, Trial, TrialFleet, TrialFleetError};
use joulebus_testkit::trials::{Files, npy_f8, timed};
use joulebus_wire::Sample;
use joulebus_wire::sample_flag::DISCONTINUITY;
use proptest::prelude::*;

use super::samples::bits;

const MS: u64 = 1_000_000;

fn trial(rate_hz: f64, rows: usize) -> Trial {
    let rows = (0..rows).map(|row| (row as f64 / rate_hz, row as f64 * 10.0));
    let bytes = npy_f8(&timed(&rows.collect::<Vec<_>>()));
    Trial::read(Files::new().write("trial.npy", &bytes)).unwrap()
}

fn playback(frame_period_ns: u64, repeat: bool) -> Playback {
    Playback { base_ns: 5_000 * MS, frame_period_ns, repeat }
}

fn play(fleet: &mut TrialFleet) -> Vec<(u64, Vec<Sample>)> {
    let mut frames = Vec::new();
    while let Some(due_ns) = fleet.next_due_ns() {
        let mut frame = Vec::new();
        fleet.frame_into(due_ns, &mut frame);
        frames.push((due_ns, frame));
    }
    frames
}

#[test]
fn frames_are_on_the_grid_and_hold_due_samples_by_robot_and_time() {
    let trials = vec![(8, trial(10.0, 4)), (3, trial(20.0, 4)), (5, trial(4.0, 2))];
    let mut fleet = TrialFleet::new(trials, playback(100 * MS, false)).unwrap();
    assert_eq!(fleet.robots().collect::<Vec<_>>(), [3, 5, 8]);
    let frames = play(&mut fleet);
    let frames = frames
        .iter()
        .map(|(due_ns, frame)| {
            let members = frame.iter().map(|sample| (sample.robot, sample.seq));
            (due_ns / MS, members.collect::<Vec<_>>())
        })
        .collect::<Vec<_>>();
    let expected = [
        (100, vec![(3, 0), (3, 1), (8, 0)]),
        (200, vec![(3, 2), (3, 3), (8, 1)]),
        (300, vec![(5, 0), (8, 2)]),
        (400, vec![(8, 3)]),
        (500, vec![(5, 1)]),
    ];
    assert_eq!(frames, expected);
    assert_eq!(fleet.next_due_ns(), None);
}

#[test]
fn a_repeated_trial_starts_with_a_discontinuity_and_its_times_and_numbers_continue() {
    let recording = trial(10.0, 3);
    let once = recording.to_samples(1, 5_000 * MS);
    let mut fleet = TrialFleet::new(vec![(1, recording)], playback(100 * MS, true)).unwrap();
    let mut samples = Vec::new();
    let mut frame = Vec::new();
    for _ in 0..9 {
        let due_ns = fleet.next_due_ns().unwrap();
        fleet.frame_into(due_ns, &mut frame);
        samples.extend_from_slice(&frame);
    }
    let found =
        samples.iter().map(|sample| (sample.seq, sample.stamp_ns / MS, sample.measured_ns / MS));
    let expected = (0..9).map(|k| (k, 5_100 + 100 * k, 5_000 + 100 * k));
    assert!(found.eq(expected), "{samples:?}");
    for (k, sample) in samples.iter().enumerate() {
        assert_eq!(sample.has(DISCONTINUITY), k == 3 || k == 6, "{k}");
        assert_eq!(sample.power_w, once[k % 3].power_w);
        assert_eq!(sample.flags & !DISCONTINUITY, once[k % 3].flags);
    }
}

#[test]
fn a_late_caller_gets_everything_that_is_due_in_one_frame() {
    let trials = vec![(20, trial(10.0, 5)), (21, trial(30.0, 7))];
    let mut fleet = TrialFleet::new(trials, playback(33 * MS, false)).unwrap();
    let mut frame = vec![Sample::new(0, 0, 0); 3];
    fleet.frame_into(0, &mut frame);
    assert!(frame.is_empty(), "nothing is due with the first row");
    fleet.frame_into(u64::MAX, &mut frame);
    let robots = frame.iter().map(|sample| sample.robot).collect::<Vec<_>>();
    assert_eq!(robots, [vec![20; 5], vec![21; 7]].concat());
    fleet.frame_into(u64::MAX, &mut frame);
    assert!(frame.is_empty() && fleet.next_due_ns().is_none());
}

#[test]
fn an_invalid_fleet_is_refused_with_its_numbers() {
    let settings = playback(1, false);
    let cases = [
        (TrialFleet::new(vec![], settings), TrialFleetError::NoTrial),
        (
            TrialFleet::new(vec![(4, trial(1.0, 2)), (4, trial(1.0, 2))], settings),
            TrialFleetError::DuplicateRobot { robot: 4 },
        ),
        (TrialFleet::new(vec![(4, trial(1.0, 2))], playback(0, false)), TrialFleetError::NoPeriod),
    ];
    for (result, expected) in cases {
        assert_eq!(result.unwrap_err(), expected);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn every_sample_is_played_once_in_order_whatever_the_frames(
        shapes in prop::collection::vec(prop::collection::vec(-0.05..0.3_f64, 1..40), 1..6),
        frame_period_ns in 1_000_000..900_000_000_u64,
    ) {
        let trials = shapes.iter().map(|steps| {
            let mut time_s = 50.0;
            let mut rows = vec![(time_s, 1.0), (time_s + 0.01, 2.0)];
            for step_s in steps {
                time_s += step_s;
                rows.push((time_s, 3.0));
            }
            Trial::read(Files::new().write("any.npy", &npy_f8(&timed(&rows)))).unwrap()
        }).collect::<Vec<_>>();
        let settings = playback(frame_period_ns, false);
        let mut fleet = TrialFleet::new((0..).zip(trials.clone()).collect(), settings).unwrap();
        let frames = play(&mut fleet);
        for pair in frames.windows(2) {
            prop_assert!(pair[0].0 < pair[1].0);
        }
        for (due_ns, frame) in &frames {
            prop_assert!(due_ns % frame_period_ns == 0 && !frame.is_empty());
            for sample in frame {
                prop_assert!(sample.stamp_ns <= settings.base_ns + due_ns);
            }
            prop_assert!(frame.is_sorted_by_key(|sample| (sample.robot, sample.seq)));
        }
        for (robot, trial) in (0..).zip(&trials) {
            let played = frames.iter().flat_map(|(_, frame)| frame);
            let played = played.filter(|sample| sample.robot == robot).copied();
            let alone = trial.to_samples(robot, settings.base_ns);
            prop_assert_eq!(bits(&played.collect::<Vec<_>>()), bits(&alone));
        }
    }
}
