//! The simulated fleet: reproducible, within its limits, and close to the published figures.

use joulebus_dataset::trial::{Column, Trial};
use joulebus_plant::Fault;
use joulebus_plant::arena::{Command, HALF_ARENA_M, STEP_S, saturated, wheels_mps};
use joulebus_plant::arena::{OMEGA_MAX_RADPS, V_MAX_MPS};
use joulebus_plant::driven::Driven;
use joulebus_plant::parts::Parts;
use joulebus_plant::protocol::{Protocol, SAMPLES, TRIAL_S, UnknownTrial};
use joulebus_plant::{Plant, PlantError, SimReading};
use joulebus_sim::protocol::{drive, trial};
use joulebus_sim::scenario::{self, seven_robots};

const DT_S: f64 = 1.0 / 30.0;

/// One series of readings per robot.
fn recorded(mut plant: Plant, steps: usize) -> Vec<Vec<SimReading>> {
    let mut series: Vec<Vec<SimReading>> = Vec::new();
    for _ in 0..steps {
        let readings = plant.step(DT_S);
        series.resize(readings.len(), Vec::new());
        for reading in readings {
            series[reading.robot].push(*reading);
        }
    }
    series
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    values.sum::<f64>() / count
}

#[test]
fn the_same_seed_gives_the_same_robots_in_any_fleet() {
    let small = recorded(Plant::new(3, 2), 300);
    let large = recorded(Plant::new(3, 5), 300);
    assert_eq!(small[..], large[..2]);
    assert_ne!(large[0], large[1], "robots differ");
    assert_ne!(recorded(Plant::new(4, 1), 300)[0], small[0], "seeds differ");
}

#[test]
fn readings_are_polled_at_10_hz_and_held_in_between() {
    for series in recorded(Plant::new(5, 4), 900) {
        let fresh = series.iter().filter(|reading| !reading.held).count();
        assert!((298..=302).contains(&fresh), "{fresh} in 30 s");
        for pair in series.windows(2) {
            if pair[1].held {
                assert_eq!(pair[0].power_w, pair[1].power_w);
                assert_eq!(pair[0].measured_ns, pair[1].measured_ns);
            } else if pair[0].measured_ns > 0 {
                assert_eq!(pair[1].measured_ns - pair[0].measured_ns, 100_000_000);
            }
        }
    }
}

#[test]
fn every_command_and_reading_is_within_the_platform_limits() {
    for reading in recorded(Plant::new(6, 10), 3_000).iter().flatten() {
        let [v, omega] =
            [reading.v_mps, reading.omega_radps].map(|command| f64::from(command.abs()));
        assert!(v <= V_MAX_MPS + 1e-6, "{reading:?}");
        assert!(omega <= OMEGA_MAX_RADPS + 1e-6, "{reading:?}");
        assert!((2.5..12.0).contains(&reading.power_w), "{reading:?}");
        assert!((3.0..4.2).contains(&reading.voltage_v), "{reading:?}");
        // Half a quantisation step of power, of current at full voltage, and of voltage at three
        // amperes.
        let product_w = reading.voltage_v * reading.current_a;
        let most_w = 0.005 + 4.2 * 0.000_625 + 3.0 * 0.000_625 + 1e-5;
        assert!((product_w - reading.power_w).abs() < most_w, "{reading:?}");
        let steps = f64::from(reading.power_w) * 100.0;
        assert!((steps - steps.round()).abs() < 1e-3, "{reading:?}");
    }
}

fn powers(series: &[SimReading]) -> Vec<f64> {
    let powers = series.iter().map(|reading| f64::from(reading.power_w));
    powers.collect()
}

/// Mean and standard deviation.
fn moments(values: &[f64]) -> (f64, f64) {
    let centre = mean(values.iter().copied());
    let square = mean(values.iter().map(|x| (x - centre) * (x - centre)));
    (centre, square.sqrt())
}

#[test]
fn the_robots_of_a_fleet_resemble_the_published_ones() {
    // Each robot drives every protocol once.
    let series = recorded(Plant::new(7, 42), (6.0 * TRIAL_S / DT_S) as usize);
    let robots: Vec<(f64, f64)> = series.iter().map(|samples| moments(&powers(samples))).collect();
    let lag1 = mean(series.iter().zip(&robots).map(|(series, (mean_w, std_w))| {
        let powers = powers(series);
        let pairs = powers.windows(2);
        mean(pairs.map(|pair| (pair[0] - mean_w) * (pair[1] - mean_w))) / (std_w * std_w)
    }));
    let std_w = mean(robots.iter().map(|(_, std_w)| *std_w));
    let mean_w = mean(robots.iter().map(|(mean_w, _)| *mean_w));
    let all = || series.iter().flat_map(|series| powers(series));
    let (lowest_w, highest_w) = (all().fold(f64::MAX, f64::min), all().fold(f64::MIN, f64::max));
    let commands = |pick: fn(&SimReading) -> f32| {
        let values = series.iter().flatten();
        let values: Vec<f64> = values.map(|reading| f64::from(pick(reading))).collect();
        moments(&values)
    };
    let (v_mps, v_std_mps) = commands(|reading| reading.v_mps);
    let (omega_radps, omega_std_radps) = commands(|reading| reading.omega_radps);
    println!(
        "power {mean_w:.3} W, deviation of a robot {std_w:.3} W, {lowest_w:.2} to \
         {highest_w:.2} W, lag-1 autocorrelation {lag1:.3}, v {v_mps:.4} ± \
         {v_std_mps:.4} m/s, ω {omega_radps:.3} ± {omega_std_radps:.3} rad/s"
    );
    assert!((mean_w - 3.65).abs() < 0.05, "{mean_w}");
    assert!((std_w - 0.375).abs() < 0.03, "{std_w}");
    assert!((2.6..3.2).contains(&lowest_w), "{lowest_w}");
    // A stalled wheel while the radio sends.
    assert!((7.0..12.0).contains(&highest_w), "{highest_w}");
    assert!((lag1 - 0.95).abs() < 0.01, "{lag1}");
    assert!((v_mps - 0.0279).abs() < 0.02, "{v_mps}");
    assert!((v_std_mps - 0.0736).abs() < 0.02, "{v_std_mps}");
    assert!((omega_radps - 0.0479).abs() < 0.1, "{omega_radps}");
    assert!((omega_std_radps - 1.0187).abs() < 0.2, "{omega_std_radps}");
}

#[test]
fn a_robot_of_the_fleet_drives_one_protocol_after_the_other() {
    // Robot 5 begins with the steady state, and continues with structured motion, which begins
    // idle.
    let steps = (TRIAL_S / DT_S) as usize;
    let series = recorded(Plant::new(3, 6), steps + 800).remove(5);
    let turns = |readings: &[SimReading]| readings.iter().filter(|r| r.omega_radps != 0.0).count();
    assert!(turns(&series[..steps]) > steps / 2, "circles and turns");
    assert_eq!(turns(&series[steps + 2..]), 0, "idle");
    // A robot of one protocol repeats it.
    let alone = recorded(Plant::driving(3, [Protocol::SteadyState]), 2 * steps).remove(0);
    assert!(turns(&alone[steps..]) > steps / 2, "again");
}

#[test]
fn most_robots_of_a_fleet_move_at_once() {
    let series = recorded(Plant::new(7, 60), 300);
    let moves = |readings: &&Vec<SimReading>| {
        let moves = |r: &SimReading| r.v_mps != 0.0 || r.omega_radps != 0.0;
        readings.iter().any(moves)
    };
    let moving = series.iter().filter(moves).count();
    assert!(moving >= 45, "{moving} of 60 move within ten seconds");
}

#[test]
fn robots_for_training_are_none_of_the_live_fleet() {
    let live = recorded(Plant::new(3, 6), 60);
    let training = recorded(Plant::driving(3, Protocol::ALL), 60);
    for robot in &live {
        assert!(training.iter().all(|other| powers(other) != powers(robot)));
    }
}

#[test]
fn trials_drive_as_in_the_paper() {
    let commands = |protocol: Protocol| -> Vec<(u32, f64, f64)> {
        let trial = drive(protocol, 9);
        let columns = [Column::Phase, Column::V, Column::Omega];
        let [phase, v, omega] = columns.map(|column| values(&trial, column));
        let rows = (0..phase.len()).map(|row| (phase[row] as u32, v[row], omega[row]));
        rows.collect()
    };
    for protocol in Protocol::ALL {
        for (phase, v_mps, omega_radps) in commands(protocol) {
            let what = format!("{protocol}, phase {phase}: {v_mps} m/s, {omega_radps} rad/s");
            assert!((-0.15 - 1e-9..=0.16 + 1e-9).contains(&v_mps), "{what}");
            assert!(omega_radps.abs() <= 3.140_001, "{what}");
        }
    }
    // Trial 1: each of eight phases once, in order, about an eighth of the trial.
    let structured = commands(Protocol::Structured);
    let mut phases: Vec<u32> = structured.iter().map(|(phase, ..)| *phase).collect();
    for phase in 0..8 {
        let samples = phases.iter().filter(|found| **found == phase).count();
        assert!((980..=1_020).contains(&samples), "{phase}: {samples}");
    }
    phases.dedup();
    assert_eq!(phases, [0, 1, 2, 3, 4, 5, 6, 7]);
    // Trial 4 reaches both ends of v and of ω, and reverses within one step.
    let extremes = commands(Protocol::Extremes);
    let most = |pick: fn(&(u32, f64, f64)) -> f64| extremes.iter().map(pick).fold(0.0, f64::max);
    assert!(most(|command| command.1) > 0.159 && most(|command| -command.1) > 0.149);
    assert!(most(|command| command.2) > 3.1 && most(|command| -command.2) > 3.1);
    let pairs = extremes.windows(2);
    let reversals = pairs.filter(|pair| pair[0].1 * pair[1].1 < -0.02);
    assert!(reversals.count() > 20);
    // Trial 5: no jumps, but at a wall.
    let walk = commands(Protocol::RandomWalk);
    let mut pairs = walk.windows(2);
    assert!(pairs.all(|pair| (pair[1].2 - pair[0].2).abs() <= 0.5));
    // Trial 6: at most a change in thirty seconds.
    let steady = commands(Protocol::SteadyState);
    let pairs = steady.windows(2);
    let changes = pairs.filter(|pair| pair[0].2 != pair[1].2).count();
    assert!((5..=8).contains(&changes), "{changes} changes");
}

#[test]
fn a_fault_changes_its_robot_from_its_time_on_and_no_other() {
    let healthy = recorded(Plant::new(8, 4), 1_200);
    let plant = Plant::new(8, 4)
        .with_fault(1, Fault::ExtraLoad { power_w: 0.8 }, 20.0)
        .and_then(|plant| plant.with_fault(2, Fault::StuckSensor, 20.0))
        .and_then(|plant| plant.with_fault(3, Fault::Noise { std_w: 0.8 }, 20.0))
        .expect("robots 1 to 3 exist");
    let faulty = recorded(plant, 1_200);
    assert_eq!(faulty[0], healthy[0]);
    for robot in 1..4 {
        let [found, sound] = [&faulty, &healthy].map(|of| &of[robot][..599]);
        assert_eq!(found, sound, "robot {robot} before the fault");
    }
    let late = |series: &[SimReading]| powers(&series[610..]);
    let spread = |values: &[f64]| {
        let steps = values.windows(2).map(|pair| pair[1] - pair[0]);
        mean(steps.map(|step| step * step)).sqrt()
    };
    let mean_w = |series: &[SimReading]| mean(late(series).into_iter());
    let more_w = mean_w(&faulty[1]) - mean_w(&healthy[1]);
    assert!((more_w - 0.8).abs() < 0.01, "{more_w}");
    let stuck = late(&faulty[2]);
    assert!(stuck.iter().all(|w| *w == stuck[0]));
    // It claims to be fresh.
    assert!(faulty[2][610..].iter().any(|reading| !reading.held));
    let ratio = spread(&late(&faulty[3])) / spread(&late(&healthy[3]));
    assert!(ratio > 1.5, "{ratio}");
    let refused = Plant::new(8, 4).with_fault(4, Fault::StuckSensor, 0.0);
    let (robot, robots) = (4, 4);
    assert_eq!(refused.err(), Some(PlantError::UnknownRobot { robot, robots }));
}

#[test]
fn steps_that_are_not_positive_have_no_effect() {
    let mut plant = Plant::new(9, 3);
    let before = plant.step(DT_S).to_vec();
    let now_ns = plant.now_ns();
    for dt_s in [0.0, -1.0, f64::NAN, f64::NEG_INFINITY] {
        assert_eq!(plant.step(dt_s), &before[..], "{dt_s}");
    }
    assert_eq!(plant.now_ns(), now_ns);
    plant.step(f64::INFINITY);
    assert_eq!(plant.now_ns(), now_ns + 1_000_000_000);
}

fn values(trial: &Trial, column: Column) -> &[f64] {
    trial.column(column).expect("a column of the layout")
}

#[test]
fn the_six_trials_have_the_published_shape_and_stay_within_the_platform_limits() {
    for protocol in Protocol::ALL {
        let trial = trial(protocol.number(), 3).expect("it is one of the six");
        assert_eq!(trial.rows(), SAMPLES, "{protocol}");
        assert_eq!(trial.period_ns(), 33_000_000, "{protocol}");
        let notes = trial.notes();
        assert_eq!((notes.gaps.len(), notes.not_advancing.len()), (0, 0));
        // Ten readings per second. Two equal ones in sequence look held.
        let fresh = SAMPLES - notes.held_readings;
        let polls = (SAMPLES as f64 * STEP_S * 10.0) as usize;
        let usual = polls * 9 / 10..=polls + 1;
        assert!(usual.contains(&fresh), "{protocol}: {fresh} of {polls}");
        let (v, omega) = (values(&trial, Column::V), values(&trial, Column::Omega));
        for (v_mps, omega_radps) in v.iter().copied().zip(omega.iter().copied()) {
            let command = Command { v_mps, omega_radps };
            let within = |speed_mps: f64| speed_mps.abs() <= V_MAX_MPS + 1e-12;
            let [left, right] = wheels_mps(command).map(within);
            assert!(left && right, "{protocol}: {command:?}");
        }
        for (column, half_m) in [(Column::X, HALF_ARENA_M.0), (Column::Y, HALF_ARENA_M.1)] {
            let inside = |at_m: &f64| at_m.abs() < half_m;
            let mut places = values(&trial, column).iter();
            assert!(places.all(inside), "{protocol} leaves the arena");
        }
        for power_w in values(&trial, Column::Power) {
            let off = (power_w * 100.0 - (power_w * 100.0).round()).abs();
            assert!(off < 1e-6, "{protocol}: {power_w}");
        }
    }
    for number in [0, 7] {
        assert_eq!(trial(number, 3).err(), Some(UnknownTrial { found: number }));
    }
}

#[test]
fn each_wheel_is_clamped_separately() {
    let far = saturated(Command { v_mps: 0.3, omega_radps: 2.0 });
    let [left_mps, right_mps] = wheels_mps(far);
    assert!((left_mps - 0.19).abs() < 1e-12, "{left_mps} was possible");
    assert!((right_mps - 0.2).abs() < 1e-12, "{right_mps} is the most");
    let near = Command { v_mps: -0.05, omega_radps: 1.5 };
    let kept = saturated(near);
    assert!((kept.v_mps - near.v_mps).abs() < 1e-12);
    assert!((kept.omega_radps - near.omega_radps).abs() < 1e-12);
}

#[test]
fn the_same_seed_gives_the_same_trials() {
    let rows = |trial: &Trial| -> Vec<u64> {
        let columns = Column::ALL.into_iter().filter_map(|column| trial.column(column));
        columns.flatten().map(|value| value.to_bits()).collect()
    };
    for protocol in Protocol::ALL {
        let [first, again, other] = [4, 4, 5].map(|seed| rows(&drive(protocol, seed)));
        assert!(first == again, "{protocol}");
        assert!(first != other, "{protocol}: seeds differ");
    }
    let [first, again, other] = [4, 4, 5].map(|seed| {
        let trials = seven_robots(seed, 500);
        trials.iter().map(rows).collect::<Vec<_>>()
    });
    assert!(first == again);
    assert!(first != other);
    assert_eq!(first.len(), scenario::ROBOTS);
}

#[test]
fn trials_are_written_in_the_published_layout_and_can_be_read() {
    let directory = tempfile::tempdir().expect("a directory");
    let trials = [drive(Protocol::Extremes, 6), seven_robots(6, 900).remove(2)];
    for (trial, robot) in trials.iter().zip(["8", "3"]) {
        let path = directory.path().join(format!("{robot}.npy"));
        trial.to_table().write(&path).expect("it can be written");
        let again = Trial::read(&path).expect("it can be read");
        assert_eq!(again.robot_name(), Some(robot));
        assert_eq!(again.rows(), trial.rows());
        assert_eq!(again.timestamp_s(), trial.timestamp_s());
        for column in Column::ALL.into_iter().take(9) {
            for (read, written) in values(&again, column).iter().zip(values(trial, column)) {
                let off = (read - written).abs();
                assert!(off < 1e-12, "{column:?}: {read} {written}");
            }
        }
    }
}

/// The energy of a robot that is driven from outside agrees with its monitor, up to the monitor's
/// noise. A fault adds to both.
#[test]
fn a_driven_robot_draws_what_its_monitor_shows() {
    let step_ns = 33_333_333;
    let shown = |fault_w: f64| {
        let pose = joulebus_plant::arena::Pose::default();
        let robot = Driven::new(Parts::default(), 0.5, pose, (3, 40));
        let mut robot = robot.with_fault(Fault::ExtraLoad { power_w: fault_w }, 30.0);
        let (mut shown_j, mut moved) = (0.0, 0.0);
        for step in 0..1_800 {
            let omega_radps = if step % 200 < 100 { 1.0 } else { -1.0 };
            let command = Command { v_mps: 0.1, omega_radps };
            let before = robot.pose().at_m;
            let driven = robot.drive(command, step_ns);
            let off = (driven.v_mps - 0.1).abs() + (driven.omega_radps - omega_radps).abs();
            assert!(off < 1e-9, "no wheel saturates: {driven:?}");
            moved += (robot.pose().at_m - before).norm();
            if robot.is_fresh() {
                shown_j += 0.1 * robot.power_w();
            }
        }
        assert!((moved - 6.0).abs() < 0.05, "{moved}");
        let drawn_j = robot.drawn_j();
        assert!((shown_j / drawn_j - 1.0).abs() < 0.002, "{shown_j} {drawn_j}");
        drawn_j
    };
    let (sound_j, faulty_j) = (shown(0.0), shown(2.0));
    let more_j = faulty_j - sound_j;
    assert!((more_j - 60.0).abs() < 1.0, "{sound_j} {faulty_j}");
}
