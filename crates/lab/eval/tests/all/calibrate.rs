//! Limits of alarms for a rate of false alarms, on simulated robots.

use std::ops::Range;
use std::path::Path;

use joulebus_config::{Config, builtin_model};
use joulebus_dataset::trial::Trial;
use joulebus_eval::calibrate::{
    Basis, CalibrateError, Calibration, Delays, Fault, Request, calibrate,
};
use joulebus_fleet::Fleet;
use joulebus_plant::parts::Parts;
use joulebus_plant::protocol::Protocol;
use joulebus_predictor::{Model, Network};
use joulebus_settings::{AlarmLimits, FleetSettings};
use joulebus_sim::protocol::drive_with;
use joulebus_statistics::poisson::{at_most, upper_mean};
use joulebus_wire::{Alarm, SCHEMA_VERSION, Sample, SampleHeader};

const FLEET: &str =
    "[fleet]\nname = \"lab\"\n[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-99\"]\n";

const WANTED: Request =
    Request { fleet_per_h: 240.0, robots: 20, confidence: 0.95, extrapolate: false };

fn settings() -> FleetSettings {
    let config = Config::parse(FLEET, Path::new("fleet.toml")).unwrap();
    config.settings().clone()
}

fn model() -> Model {
    let (_, file) = builtin_model("gternal-sim").unwrap();
    Model::Network(Network::from_safetensors(file).unwrap())
}

/// Healthy recordings of 99 s, 3,000 rows, of each of the six protocols for every seed.
fn trials(seeds: Range<u64>) -> Vec<Trial> {
    let each = seeds.flat_map(|seed| Protocol::ALL.map(|protocol| (seed, protocol)));
    let trials = each.map(|(seed, protocol)| drive_with(protocol, Parts::default(), seed, 3_000));
    trials.collect()
}

fn asked(trials: &[Trial], request: &Request) -> Result<Calibration, CalibrateError> {
    calibrate(&settings(), 0, &model(), trials, request)
}

/// The times from `from_ns` on at which alarms with a limit are raised, ns, and the hours watched.
/// Computed by the fleet's core, without `calibrate`'s code.
fn raised_ns(limits: AlarmLimits, samples: &[Sample], from_ns: u64) -> (Vec<u64>, f64) {
    let mut settings = settings();
    settings.alarms = settings
        .alarms
        .of(&joulebus_settings::Platform { alarms: Some(limits), ..settings.platforms[0].clone() });
    let settles = u64::from(settings.alarms.settle_samples);
    let mut fleet = Fleet::new(settings, vec![model()]).unwrap();
    let (mut raised, mut before, mut watched) = (Vec::new(), 0, 0);
    for sample in samples {
        let header = SampleHeader {
            schema: SCHEMA_VERSION,
            source_id: 7,
            source_epoch: 1,
            frame_seq: sample.seq,
            samples_before: sample.seq,
            intended_ns: sample.stamp_ns,
            sent_ns: sample.stamp_ns,
            ..SampleHeader::default()
        };
        fleet.take(&header, std::slice::from_ref(sample), sample.stamp_ns);
        fleet.tick(sample.stamp_ns, false);
        let alarms = fleet.diagnostic(0).alarms();
        let limited = [Alarm::LevelHigh, Alarm::LevelLow, Alarm::NoiseHigh, Alarm::ModelMismatch];
        let now = limited.iter().filter(|alarm| alarms.has(**alarm)).count();
        if now > before && sample.stamp_ns >= from_ns {
            raised.push(sample.stamp_ns);
        }
        before = now;
        watched += u64::from(fleet.scores(sample.robot).unwrap().count >= settles);
    }
    (raised, watched as f64 / 30.0 / 3600.0)
}

fn limits(found: &Calibration) -> AlarmLimits {
    let [noise_limit, mismatch_limit, level_limit] = found.limits.map(|limit| limit.value as f32);
    AlarmLimits { noise_limit, mismatch_limit, level_limit }
}

fn delays_of(found: &Calibration, fault: Fault) -> Delays {
    *found.delays.iter().find(|delays| delays.fault == fault).unwrap()
}

#[test]
fn what_recordings_cannot_show_is_refused_with_the_hours_needed() {
    let trials = trials(1..2);
    let rare = Request { fleet_per_h: 1.0 / 24.0, ..WANTED };
    let refused = asked(&trials, &rare).unwrap_err();
    let CalibrateError::Hours { hours, needed_h, .. } = refused else {
        panic!("six trials of 99 s cannot show an alarm in 480 hours: {refused}");
    };
    // Two halves without an alarm, 3.0 expected at 95 %.
    let exactly_h = 2.0 * upper_mean(0, 0.95) * 480.0;
    assert!((needed_h - exactly_h).abs() < 1e-6, "{needed_h}");
    assert!(0.05 < hours && hours < 0.1, "{hours}");
    let text = refused.to_string();
    assert!(text.contains("Record 2875.9 robot-hours"), "{text}");
    let one = asked(&trials[..1], &WANTED).unwrap_err();
    assert_eq!(one, CalibrateError::Recordings { found: 1 });
}

#[test]
fn limits_keep_their_rate_on_robots_that_did_not_choose_them_and_find_faults_as_soon_as_stated() {
    let found = asked(&trials(1..9), &WANTED).unwrap();
    assert!(!found.extrapolated);
    assert!(found.limits.iter().all(|limit| limit.basis == Basis::Shown));
    assert_eq!(found.at_most_per_robot_h, 12.0);
    let load = delays_of(&found, Fault::ExtraLoad(1.0)).calibrated;
    assert!(load.found >= 0.9, "{found}");

    let others = trials(101..109);
    let (mut false_alarms, mut hours, mut in_time) = (0, 0.0, 0);
    for trial in &others {
        let mut samples = trial.to_samples(3, 1_000_000_000);
        let (raised, watched_h) = raised_ns(limits(&found), &samples, 0);
        false_alarms += raised.len() as u64;
        hours += watched_h;
        let mean_w =
            samples.iter().map(|sample| sample.power_w).sum::<f32>() / samples.len() as f32;
        let from_ns = samples[1_200].stamp_ns;
        for sample in &mut samples[1_200..] {
            sample.power_w += mean_w;
        }
        let (raised, _) = raised_ns(limits(&found), &samples, from_ns);
        let delay_s = raised.first().map(|at_ns| (at_ns - from_ns) as f64 * 1e-9);
        in_time += usize::from(delay_s.is_some_and(|delay_s| delay_s <= load.q90_s));
    }
    // More than the stated rate allows in 99 of 100 draws would refute it.
    assert!(
        false_alarms == 0 || 1.0 - at_most(false_alarms - 1, 12.0 * hours) > 0.01,
        "{false_alarms} in {hours} h"
    );
    // 90 % were stated, of as many recordings.
    assert!(in_time * 100 >= others.len() * 80, "{in_time} of {}", others.len());
}

#[test]
fn the_table_of_faults_distinguishes_a_load_from_a_sensor_and_both_from_chance() {
    let found = asked(&trials(1..5), &WANTED).unwrap();
    assert_eq!(found.delays.len(), Fault::ALL.len());
    assert_eq!(found.faulty_recordings, found.stated_on.recordings);
    assert!((found.after_s - 59.4).abs() < 1.0, "{}", found.after_s);
    let none = delays_of(&found, Fault::None);
    assert!(none.calibrated.found < 0.3, "{found}");
    for fault in [Fault::StuckSensor, Fault::Gain(1.0), Fault::Dropout] {
        let delays = delays_of(&found, fault);
        assert_eq!(delays.calibrated.found, 1.0, "{fault:?}: {found}");
        // The voltage is a healthy robot's.
        assert_eq!(delays.voltage.found, none.voltage.found, "{fault:?}");
    }
    // A monitor must repeat itself for ten seconds.
    let stuck = delays_of(&found, Fault::StuckSensor).calibrated;
    assert!(9.0 < stuck.median_s && stuck.median_s < 12.0, "{stuck:?}");
    // More of it is found no later.
    let found_by = |fault| delays_of(&found, fault).calibrated.found;
    assert!(found_by(Fault::Drift(3.0)) >= found_by(Fault::Drift(0.3)));
    assert!(found_by(Fault::ExtraLoad(1.0)) > found_by(Fault::ExtraLoad(0.1)));
}

#[test]
fn the_same_recordings_give_the_same_result_and_others_another_digest() {
    let mut trials = trials(1..3);
    let lax = Request { fleet_per_h: 2_000.0, ..WANTED };
    let once = asked(&trials, &lax).unwrap();
    let json = |found: &Calibration| serde_json::to_string(found).unwrap();
    assert_eq!(json(&asked(&trials, &lax).unwrap()), json(&once));
    trials.swap(0, 1);
    assert_ne!(asked(&trials, &lax).unwrap().digest, once.digest);
}

#[test]
fn a_single_long_recording_is_divided_into_pieces() {
    // 25 minutes of one robot: three pieces of at most ten.
    let long = drive_with(Protocol::RandomWalk, Parts::default(), 5, 45_000);
    let lax = Request { fleet_per_h: 2_000.0, ..WANTED };
    let found = asked(std::slice::from_ref(&long), &lax).unwrap();
    let pieces = found.chosen_on.recordings + found.stated_on.recordings;
    assert_eq!(pieces, 3, "{found}");
    assert_eq!(found.chosen_on.rows + found.stated_on.rows, 45_000);
}

#[test]
fn recordings_of_which_no_reading_is_scored_are_refused_without_a_rate() {
    let short = [1, 2].map(|seed| drive_with(Protocol::RandomWalk, Parts::default(), seed, 5));
    let refused = asked(&short, &WANTED).unwrap_err();
    assert_eq!(refused, CalibrateError::Unscored);
}
