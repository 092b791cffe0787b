//! The state of a fleet in a file: refused without a change to the fleet, or restored and
//! continued.
//!
//! An input's first byte selects settings and models; if its third bit is set, the rest follows the
//! valid head of such a state (format, capacity, hashes), which mutation would not find.

use joulebus_fleet::{Fleet, FleetState};
use joulebus_testkit_fleets::{PERIOD_NS, Source, bits, healthy};

use super::frames::{encoded, setting};
use super::input::Input;

const STEPS: u64 = 8;
const START_NS: u64 = 61_000_000_000;

/// A number in postcard's encoding.
fn varint_bytes(number: u64) -> usize {
    (64 - number.leading_zeros()).div_ceil(7).max(1) as usize
}

/// The head of the state of `fleet`, up to its counters.
pub(crate) fn beginning(fleet: &Fleet, settings_hash: u64, platforms: usize) -> Vec<u8> {
    let numbers =
        [u64::from(fleet.capacity()), platforms as u64, settings_hash, fleet.model_hash()];
    let mut state = encoded(fleet);
    state.truncate(8 + numbers.map(varint_bytes).iter().sum::<usize>());
    state
}

pub(crate) fn run(bytes: &[u8]) -> bool {
    let mut input = Input(bytes);
    let options = input.u8();
    let (settings, models) = setting(options);
    let new = || Fleet::new(settings.clone(), models.clone()).expect("the settings agree");
    let mut fleet = new();
    let bytes = match options & 4 {
        0 => input.0.to_vec(),
        _ => {
            [&beginning(&fleet, settings.fingerprint(), settings.platforms.len()), input.0].concat()
        }
    };
    let Ok(state) = FleetState::decode(&bytes) else {
        return false;
    };
    let (mut once, mut twice) = (Vec::new(), Vec::new());
    state.encode_into(&mut once);
    let again = FleetState::decode(&once).expect("what was encoded is decoded");
    again.encode_into(&mut twice);
    assert_eq!(once, twice, "decoded and encoded");

    let before = encoded(&fleet);
    if fleet.restore_state(&state).is_err() {
        assert_eq!(encoded(&fleet), before, "refused, yet changed");
        return false;
    }
    assert_eq!(encoded(&fleet), once, "the fleet is where the state was");
    let mut other = new();
    other.restore_state(&again).expect("the same state");
    for fleet in [&mut fleet, &mut other] {
        exercise(fleet);
    }
    assert_eq!(encoded(&fleet), encoded(&other), "two fleets of one state");
    for robot in 0..300 {
        assert_eq!(bits(&fleet, robot), bits(&other, robot), "robot {robot}");
    }
    true
}

/// Sends samples of every platform, ticks, and checks all outputs.
fn exercise(fleet: &mut Fleet) {
    let mut source = Source::new(1, 20);
    let (accepted, dropped) = (fleet.accepted(), fleet.drops().total());
    let mut sent = 0;
    for step in 0..STEPS {
        let now_ns = START_NS + step * PERIOD_NS;
        let robots = [1, 101, 201];
        let samples = robots.map(|robot| healthy(robot, step, now_ns, PERIOD_NS));
        source.send(fleet, &samples, now_ns);
        sent += samples.len() as u64;
        fleet.tick(now_ns, false);
        for place in 0..fleet.len() {
            let (forecast, _, _) =
                (fleet.forecast(place), fleet.diagnostic(place), fleet.budget(place));
            let shown = forecast.expected_w();
            assert!(shown.is_none_or(f32::is_finite), "{forecast:?}");
        }
    }
    let counted = (fleet.accepted() - accepted) + (fleet.drops().total() - dropped);
    assert_eq!(counted, sent, "sent = accepted + dropped");
}
