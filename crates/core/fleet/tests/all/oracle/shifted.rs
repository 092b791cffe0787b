//! A state moved to another clock equals that of a fleet whose samples had been stamped by that
//! clock.

use joulebus_fleet::{Fleet, FleetState};
use joulebus_testkit_fleets::{self as world, MS, PERIOD_NS, Source, healthy};
use joulebus_wire::{SampleHeader, sample_flag};
use proptest::prelude::*;

use super::faults::Delivery;
use super::state::{encoded, same, take, traffic};
use super::{CAPACITY, START_NS};

/// The frames with their instants of another clock. Stamps far from all others, which cannot be
/// moved, are left out.
fn moved(frames: &[Delivery], offset_ns: i64) -> Vec<Delivery> {
    let by = |stamp_ns: u64| match stamp_ns {
        0 => 0,
        _ => stamp_ns.checked_add_signed(offset_ns).expect("it can be moved"),
    };
    let moved = |frame: &Delivery| {
        let header = SampleHeader {
            intended_ns: by(frame.at_ns - 2 * MS),
            sent_ns: by(frame.at_ns - MS),
            ..frame.header
        };
        let near = |stamp_ns: u64| (START_NS / 2..1 << 60).contains(&stamp_ns);
        let samples = frame.samples.iter().filter(|sample| near(sample.stamp_ns));
        let samples = samples.map(|sample| {
            let mut sample = *sample;
            sample.stamp_ns = by(sample.stamp_ns);
            sample.measured_ns = by(sample.measured_ns);
            sample
        });
        Delivery { at_ns: by(frame.at_ns), header, samples: samples.collect(), lost: frame.lost }
    };
    frames.iter().map(moved).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases.min(24)))]

    #[test]
    fn a_shifted_state_is_that_of_the_fleet_whose_samples_were_shifted_bit_for_bit(
        seed in any::<u64>(), at in 0usize..120,
        offset_ns in prop_oneof![-(START_NS as i64) / 3..1, 1i64..1 << 60],
        fresh in any::<bool>(), learning in any::<bool>(),
    ) {
        let traffic = traffic(seed, 160);
        let settings = match learning {
            true => world::learning(CAPACITY),
            false => world::settings(CAPACITY),
        };
        let new = || {
            let models = if fresh { world::fresh_models() } else { world::models() };
            Fleet::new(settings.clone(), models).expect("the settings are consistent")
        };
        let by = |stamp_ns: u64| stamp_ns.checked_add_signed(offset_ns).expect("it can be moved");
        let (mut here, mut there) = (new(), new());
        for (tick, (now_ns, frames)) in traffic[..at].iter().enumerate() {
            take(&mut there, &moved(frames, 0));
            there.tick(*now_ns, tick % 7 == 0);
            take(&mut here, &moved(frames, offset_ns));
            here.tick(by(*now_ns), tick % 7 == 0);
        }
        // In the middle of an intake, so that samples are waiting.
        let (now_ns, frames) = &traffic[at];
        let (before, after) = frames.split_at(frames.len() / 2);
        take(&mut there, &moved(before, 0));
        take(&mut here, &moved(before, offset_ns));

        let mut other = new();
        let state = there.state().shifted(offset_ns);
        other.restore_state(&state).expect("the same settings and models");
        same(&here, &other, at)?;
        if offset_ns != 0 && !here.is_empty() {
            prop_assert_ne!(encoded(&there), encoded(&other));
        }
        let mut back = Vec::new();
        state.shifted(-offset_ns).encode_into(&mut back);
        prop_assert_eq!(encoded(&there), back);
        for fleet in [&mut here, &mut other] {
            take(fleet, &moved(after, offset_ns));
            fleet.tick(by(*now_ns), false);
        }
        for (tick, (now_ns, frames)) in traffic.iter().enumerate().skip(at + 1) {
            for fleet in [&mut here, &mut other] {
                take(fleet, &moved(frames, offset_ns));
                fleet.tick(by(*now_ns), tick % 7 == 0);
            }
            same(&here, &other, tick)?;
        }
    }

    /// A host that has just booted: its clock begins after the robot's last sample.
    #[test]
    fn time_before_the_clock_of_this_host_began_is_unmetered_and_none_is_lost(
        behind_ns in 0u64..40_000 * MS, later_ns in 1u64..5_000 * MS,
    ) {
        let (mut there, mut source) = (world::fleet(CAPACITY), Source::new(1, 1));
        for step in 0..30 {
            let now_ns = START_NS + step * PERIOD_NS;
            source.tick(&mut there, &[healthy(3, step, now_ns, PERIOD_NS)], now_ns);
        }
        let before = there.ledger(3).expect("it has begun");
        let stamp_ns = before.stamp_ns().expect("it has begun");
        // The last sample was `behind_ns` before instant 1 of this host.
        let offset_ns = 1 - (stamp_ns + behind_ns) as i64;
        let mut here = world::fleet(CAPACITY);
        let state = there.state().shifted(offset_ns);
        here.restore_state(&state).expect("the same settings and models");
        let now_ns = 1 + later_ns;
        let sample = healthy(3, 31, now_ns, PERIOD_NS).with(sample_flag::DISCONTINUITY);
        source.tick(&mut here, &[sample], now_ns);
        let after = here.ledger(3).expect("it goes on");
        let time_ns = |ledger: joulebus_fleet::Ledger| ledger.metered_ns + ledger.unmetered_ns;
        prop_assert_eq!(time_ns(after), time_ns(before) + behind_ns + later_ns);
        prop_assert!(after.drawn_uj >= before.drawn_uj);
    }
}

#[test]
fn frames_that_a_state_contains_are_known_and_no_others() {
    let (mut fleet, mut source) = (world::fleet(CAPACITY), Source::new(1, 5));
    let frame = |source: &mut Source, step: u64| {
        let stamp_ns = START_NS + step * PERIOD_NS;
        let samples = [1, 2].map(|robot| healthy(robot, step, stamp_ns, PERIOD_NS));
        (source.frame(samples.len()), samples, stamp_ns)
    };
    let mut older = Source::new(1, 4);
    let frames: Vec<_> = (1..7).map(|step| frame(&mut source, step)).collect();
    for (header, samples, now_ns) in &frames[..4] {
        // The third is lost in transit.
        if header.frame_seq != 2 {
            fleet.take(header, samples, *now_ns);
        }
    }
    let bytes = encoded(&fleet);
    let mut other = world::fleet(CAPACITY);
    let state = FleetState::decode(&bytes).expect("its own state");
    other.restore_state(&state.shifted(77)).expect("the same fleet");
    let known: Vec<bool> =
        frames.iter().map(|(header, _, now_ns)| other.has_accounted(header, now_ns + 77)).collect();
    assert_eq!(known, [true, true, true, true, false, false]);
    let is_known = |source: &mut Source| {
        let (header, _, now_ns) = frame(source, 9);
        other.has_accounted(&header, now_ns + 77)
    };
    assert!(is_known(&mut older));
    assert!(!is_known(&mut Source::new(1, 6)));
    assert!(!is_known(&mut Source::new(2, 5)));
    for (header, samples, now_ns) in &frames {
        if !other.has_accounted(header, now_ns + 77) {
            other.take(header, samples, *now_ns + 77);
        }
    }
    let sent: u64 = frames.iter().map(|(_, samples, _)| samples.len() as u64).sum();
    assert_eq!(sent, other.accepted() + other.drops().total());
}
