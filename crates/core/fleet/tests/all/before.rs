//! States that versions before encoded are read, and forecasts go on with the same bits.
//!
//! The files of [`BEFORE`] are what 16f64ea6 and 5759d979 encoded of the fleet of [`source`], and the
//! [`digest`] of its next forecasts. No test writes them: this version would encode its own.

use std::fs;

use joulebus_fleet::{Fleet, FleetState, SavedBattery, StateError};
use joulebus_predictor::Kernel;
use joulebus_testkit_fleets::{self as world, PERIOD_NS, Source};
use joulebus_wire::{Forecast, sample_flag};

const STATES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/all/states");
/// Files, and the versions of their encodings.
const BEFORE: [(&str, u8); 2] = [("before.bin", 0x11), ("before-12.bin", 0x12)];
const START_NS: u64 = 60_000 * world::MS;

/// Seven robots of three platforms. One loses samples, one is charged, and one leaves.
fn tick(fleet: &mut Fleet, source: &mut Source, step: u64) {
    let now_ns = START_NS + step * PERIOD_NS;
    let robots = [7u32, 8, 9, 10, 107, 207];
    let sent = robots.iter().filter(|robot| match robot {
        8 => !step.is_multiple_of(7),
        10 => step < 20,
        _ => true,
    });
    let samples = sent.map(|robot| {
        let mut sample = world::healthy(*robot, step, now_ns, PERIOD_NS);
        sample.power_w += 0.3 * (step % 11) as f32;
        if *robot == 9 && step % 100 > 60 {
            sample = sample.with(sample_flag::CHARGING);
        }
        sample
    });
    let samples: Vec<_> = samples.collect();
    source.tick(fleet, &samples, now_ns);
}

/// FNV-1a of the forecasts of 60 ticks after the state.
fn digest(fleet: &mut Fleet, source: &mut Source) -> u64 {
    let mut bytes = Vec::new();
    for step in 300..360 {
        tick(fleet, source, step);
        for place in 0..fleet.len() {
            let Forecast { robot, power_w, lo_w, hi_w, .. } = fleet.forecast(place);
            bytes.extend(robot.to_le_bytes());
            for watts in [power_w, lo_w, hi_w] {
                bytes.extend(watts.to_bits().to_le_bytes());
            }
        }
    }
    joulebus_wire::fnv1a(bytes)
}

/// The source of the state, which goes on.
fn source() -> (Fleet, Source) {
    let models = world::models_on(Kernel::Scalar);
    let (mut fleet, mut source) = (world::fleet_of(16, models), Source::new(1, 1));
    let ledger = joulebus_fleet::Ledger::restored((5, 6), 7, 8, 9, START_NS);
    let mut budget = joulebus_wire::Budget { robot: 11, ..Default::default() };
    budget.flags = joulebus_wire::budget_flag::BATTERY | joulebus_wire::budget_flag::CHARGE;
    (budget.soc, budget.soc_hi) = (0.5, 0.8);
    fleet.restore(11, ledger, true, SavedBattery::new(&budget, 0));
    for step in 0..300 {
        tick(&mut fleet, &mut source, step);
    }
    (fleet, source)
}

#[test]
fn states_of_the_versions_before_are_read_and_forecasts_go_on_with_their_bits() {
    for (file, version) in BEFORE {
        let bytes = fs::read(format!("{STATES}/{file}")).expect("it is part of the repository");
        let (state, expected) = bytes.split_last_chunk::<8>().expect("it ends with a digest");
        assert!(state.starts_with(b"jbstate") && state[7] == version, "{file}: another version");
        assert!(!FleetState::is_of_this_version(state));
        let state = FleetState::decode(state).expect("the versions before are read");
        goes_on(&state, expected);
    }
    // An older one is refused by its name.
    let older = FleetState::decode(b"jbstate\x10").unwrap_err();
    assert!(matches!(older, StateError::Version { oldest: 0x11, .. }), "{older}");
}

fn goes_on(state: &FleetState, expected: &[u8; 8]) {
    let (mut now, mut source) = source();
    let mut fleet = world::fleet_of(16, world::models_on(Kernel::Scalar));
    fleet.restore_state(state).expect("the same settings and models");
    for robot in [7, 8, 9] {
        let [before, after] = [&fleet, &now].map(|fleet| world::budget(fleet, robot));
        assert!((before.soc - after.soc).abs() < 0.05, "{before:?} {after:?}");
        assert!(before.soc_lo <= before.soc && before.soc <= before.soc_hi, "{before:?}");
        assert_eq!(before.mean_power_w.is_nan(), after.mean_power_w.is_nan());
        assert_eq!((before.drawn_uj, before.unmetered_ns), (after.drawn_uj, after.unmetered_ns));
    }
    assert!(fleet.ledger(10).is_some() && fleet.ledger(11).is_some(), "departed, and saved");
    let mut again = Vec::new();
    fleet.state().encode_into(&mut again);
    assert_eq!(FleetState::decode(&again).map(|state| state.len()), Ok(fleet.len()));
    assert_eq!(digest(&mut fleet, &mut source).to_le_bytes(), *expected);
    assert_eq!(fleet.len(), now.len());
    tick(&mut now, &mut Source::new(2, 1), 300);
}
