//! A fleet continues from a snapshot exactly like the original, in any state.

use joulebus_fleet::{Fleet, FleetState, StateError};
use joulebus_testkit_fleets::random::Noise;
use joulebus_testkit_fleets::{self as world, PERIOD_NS, bits};
use joulebus_wire::Forecast;
use proptest::prelude::*;

use super::faults::{Delivery, Rates};
use super::{CAPACITY, START_NS, senders};

/// All frames of a run with faults, each with its tick, and the times of the ticks.
pub(crate) fn traffic(seed: u64, ticks: usize) -> Vec<(u64, Vec<Delivery>)> {
    let rates = Rates { sample: 8, frame: 15 };
    let mut noise = Noise(seed);
    let mut senders = senders();
    let mut now_ns = START_NS;
    (0..ticks)
        .map(|_| {
            now_ns += PERIOD_NS / 2 + noise.next_u64() % PERIOD_NS;
            if noise.next_u64().is_multiple_of(40) {
                now_ns += noise.next_u64() % (60 * PERIOD_NS);
            }
            let mut arrived: Vec<Delivery> = senders
                .iter_mut()
                .flat_map(|sender| sender.arrivals(now_ns, rates, &mut noise))
                .collect();
            arrived.sort_by_key(|frame| frame.at_ns);
            (now_ns, arrived)
        })
        .collect()
}

pub(crate) fn take(fleet: &mut Fleet, frames: &[Delivery]) {
    for frame in frames {
        fleet.take(&frame.header, &frame.samples, frame.at_ns);
    }
}

pub(crate) fn encoded(fleet: &Fleet) -> Vec<u8> {
    let mut bytes = Vec::new();
    fleet.state().encode_into(&mut bytes);
    bytes
}

fn generations(fleet: &Fleet) -> Vec<(u32, u32)> {
    let forecast = |place| -> Forecast { fleet.forecast(place) };
    let of = |forecast: Forecast| (forecast.robot, forecast.generation);
    (0..fleet.len()).map(|place| of(forecast(place))).collect()
}

/// Compares two fleets: all outputs and the whole internal state.
pub(crate) fn same(one: &Fleet, other: &Fleet, tick: usize) -> Result<(), TestCaseError> {
    prop_assert_eq!(generations(one), generations(other), "tick {}", tick);
    for robot in 0..300 {
        prop_assert_eq!(bits(one, robot), bits(other, robot), "robot {}, tick {}", robot, tick);
        prop_assert_eq!(one.ledger(robot), other.ledger(robot), "robot {}, tick {}", robot, tick);
    }
    prop_assert_eq!(one.refusals(), other.refusals());
    prop_assert_eq!((one.drops(), one.accepted()), (other.drops(), other.accepted()));
    prop_assert_eq!(encoded(one), encoded(other), "internal state, tick {}", tick);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases.min(24)))]

    #[test]
    fn a_fleet_continues_from_a_snapshot_with_the_same_bits(
        seed in any::<u64>(), at in 0usize..120, restored_first in any::<bool>(), used in any::<bool>(),
        fresh in any::<bool>(), learning in any::<bool>(),
    ) {
        let traffic = traffic(seed, 200);
        let settings = match learning {
            true => world::learning(CAPACITY),
            false => world::settings(CAPACITY),
        };
        let new = || {
            let models = if fresh { world::fresh_models() } else { world::models() };
            Fleet::new(settings.clone(), models).expect("the settings are consistent")
        };
        let mut fleet = new();
        if restored_first {
            let ledger = joulebus_fleet::Ledger::restored((5, 6), 7, 8, 9, START_NS / 2);
            fleet.restore(3, ledger, true, None);
        }
        for (tick, (now_ns, frames)) in traffic[..at].iter().enumerate() {
            take(&mut fleet, frames);
            fleet.tick(*now_ns, tick % 7 == 0);
        }
        // In the middle of an intake, so that samples are waiting.
        let (now_ns, frames) = &traffic[at];
        let (before, after) = frames.split_at(frames.len() / 2);
        take(&mut fleet, before);

        let mut other = new();
        if used {
            for (now_ns, frames) in &traffic[at + 20..at + 60] {
                take(&mut other, frames);
                other.tick(*now_ns, false);
            }
        }
        let state = FleetState::decode(&encoded(&fleet)).expect("an encoded state can be decoded");
        other.restore_state(&state).expect("the same settings and models");
        same(&fleet, &other, at)?;
        for fleet in [&mut fleet, &mut other] {
            take(fleet, after);
            prop_assert_eq!(fleet.intake().frames as usize, frames.len());
            fleet.tick(*now_ns, false);
        }
        for (tick, (now_ns, frames)) in traffic.iter().enumerate().skip(at + 1) {
            for fleet in [&mut fleet, &mut other] {
                take(fleet, frames);
            }
            prop_assert_eq!(fleet.complete(*now_ns), other.complete(*now_ns));
            for fleet in [&mut fleet, &mut other] {
                fleet.tick(*now_ns, tick % 7 == 0);
            }
            same(&fleet, &other, tick)?;
        }
    }

    /// Arbitrary bytes are refused, or the fleet continues from them without a panic.
    #[test]
    fn a_state_with_flipped_bytes_never_panics(
        seed in 0u64..8, flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let traffic = traffic(seed, 80);
        let new = || Fleet::new(world::learning(CAPACITY), world::models()).expect("they agree");
        let mut fleet = new();
        for (now_ns, frames) in &traffic[..60] {
            take(&mut fleet, frames);
            fleet.tick(*now_ns, false);
        }
        let mut bytes = encoded(&fleet);
        for (at, byte) in flips {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        let Ok(state) = FleetState::decode(&bytes) else {
            return Ok(());
        };
        let mut other = new();
        if other.restore_state(&state).is_err() {
            prop_assert_eq!(encoded(&other), encoded(&new()), "changed although refused");
            return Ok(());
        }
        for (now_ns, frames) in &traffic[60..] {
            take(&mut other, frames);
            other.tick(*now_ns, false);
            for place in 0..other.len() {
                let _ = (other.forecast(place), other.diagnostic(place), other.budget(place));
            }
        }
    }
}

#[test]
fn another_fleets_state_is_refused_with_both_numbers() {
    let state = world::fleet(CAPACITY).state();
    let refused = |fleet: &mut Fleet| fleet.restore_state(&state).expect_err("another fleet");
    let with = |change: &dyn Fn(&mut joulebus_settings::FleetSettings)| {
        let mut settings = world::settings(CAPACITY);
        change(&mut settings);
        let models = world::models().into_iter().take(settings.platforms.len());
        Fleet::new(settings, models.collect()).expect("the settings are consistent")
    };
    assert_eq!(
        refused(&mut world::fleet(CAPACITY + 1)),
        StateError::Capacity { found: CAPACITY, expected: CAPACITY + 1 }
    );
    assert_eq!(
        refused(&mut with(&|settings| settings.platforms.truncate(2))),
        StateError::Platforms { found: 3, expected: 2 }
    );
    let sensitive =
        &|settings: &mut joulebus_settings::FleetSettings| settings.alarms.noise_limit += 0.5;
    assert!(matches!(refused(&mut with(sensitive)), StateError::FleetSettings { .. }));
    let mut models = world::models();
    models.swap(0, 2);
    let mut swapped = Fleet::new(world::settings(CAPACITY), models).expect("as many as platforms");
    assert!(matches!(refused(&mut swapped), StateError::Models { .. }));
}

#[test]
fn every_truncation_and_another_version_are_refused() {
    let traffic = traffic(1, 40);
    let mut fleet = world::fleet(CAPACITY);
    for (now_ns, frames) in &traffic {
        take(&mut fleet, frames);
        fleet.tick(*now_ns, false);
    }
    let bytes = encoded(&fleet);
    assert!(fleet.len() > 3, "{} robots", fleet.len());
    for length in 0..bytes.len() {
        let error = FleetState::decode(&bytes[..length]).expect_err("cut off");
        let known = matches!(error, StateError::Version { .. } | StateError::Malformed { .. });
        assert!(known, "{length}: {error}");
    }
    let mut longer = bytes.clone();
    longer.push(0);
    assert!(matches!(FleetState::decode(&longer), Err(StateError::Malformed { .. })));
    let mut newer = bytes;
    newer[7] += 1;
    assert!(matches!(FleetState::decode(&newer), Err(StateError::Version { .. })));
}
