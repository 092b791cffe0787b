//! A fleet with an unlimited number of successive robots, sources and forged frames: its tables
//! free silent entries, and live ones keep their slots.

use joulebus_fleet::Fleet;
use joulebus_testkit::counting::allocations;
use joulebus_testkit_fleets::{
    self as world, MS, PERIOD_NS, Source, fleet, forecast, healthy, quality,
};
use joulebus_wire::{DropReason, Quality};

const NAMES: u64 = 100_000;
/// `leave_after` of the fleets.
const LEAVE_AFTER_NS: u64 = 2_500 * MS;
const LIVING: u32 = 7;

#[test]
fn a_hundred_thousand_successive_sources_and_robots_do_not_affect_a_live_robot() {
    // Capacity for the live robot and its source, and for 63 others.
    let mut settings = world::settings(64);
    settings.intake.max_sources = 64;
    let mut fleet = Fleet::new(settings, world::models()).unwrap();
    let mut living = Source::new(2 * NAMES, 1);
    let (mut now_ns, mut step, mut names) = (60_000 * MS, 0, 0);
    let allocated = allocations(|| {
        while names < NAMES {
            now_ns += PERIOD_NS;
            let sample = healthy(LIVING, step, now_ns, PERIOD_NS);
            living.send(&mut fleet, &[sample], now_ns);
            step += 1;
            if step % (LEAVE_AFTER_NS / PERIOD_NS + 2) == 0 {
                for _ in 0..63 {
                    names += 1;
                    let robot = (names % 290) as u32 + 8;
                    let mut source = Source::new(names, 1);
                    source.send(&mut fleet, &[healthy(robot, 0, now_ns, PERIOD_NS)], now_ns);
                    assert_eq!(fleet.drops().total(), 0, "name {names}");
                }
            }
            fleet.tick(now_ns, false);
            if step > 10 {
                let found = quality(&fleet, LIVING);
                assert!(matches!(found, Quality::Fresh | Quality::Held), "{found:?}");
            }
        }
    });
    assert_eq!(allocated, 0, "no table has grown");
    assert_eq!(fleet.accepted(), step + names);
    let given_up = fleet.accounts_given_up();
    assert!(given_up > NAMES / 2, "{given_up} accounts made room for others");
    let account = fleet.ledger(LIVING).unwrap();
    assert_eq!(account.metered_ns, (step - 1) * PERIOD_NS, "its account is whole");
}

#[test]
fn impossible_samples_of_any_number_of_robots_cost_no_departed_robot_its_account() {
    let mut fleet = fleet(4);
    let mut real = Source::new(1, 1);
    let mut now_ns = 60_000 * MS;
    for step in 0..20 {
        now_ns += PERIOD_NS;
        let sample = healthy(LIVING, step, now_ns, PERIOD_NS);
        real.tick(&mut fleet, &[sample], now_ns);
    }
    let account = fleet.ledger(LIVING).unwrap();
    assert_eq!(account.metered_ns, 19 * PERIOD_NS);
    // It leaves, as do many others without an accepted sample.
    let mut liar = Source::new(2, 1);
    for step in 0..200 {
        now_ns += LEAVE_AFTER_NS + PERIOD_NS;
        let wrong = [f32::NAN, f32::INFINITY, 1e30][step as usize % 3];
        let impossible: Vec<_> = (0..3)
            .map(|place| healthy(10 + (3 * step + place) as u32 % 280, step, now_ns, PERIOD_NS))
            .map(|sample| sample.reading(wrong, now_ns))
            .collect();
        liar.tick(&mut fleet, &impossible, now_ns);
        let kept = fleet.ledger(LIVING);
        assert_eq!(kept, Some(account), "step {step}");
    }
    assert_eq!((fleet.accepted(), fleet.accounts_given_up()), (20, 0));
}

#[test]
fn a_forged_frame_blocks_the_robots_of_a_source_for_one_stale_period_only() {
    let far = u64::MAX;
    let settings = world::settings(2);
    let stale_after_ns = settings.platforms.iter().map(|platform| platform.stale_after_ns).max();
    let forged_at = 20;
    let back_at = forged_at + stale_after_ns.unwrap() / PERIOD_NS + 2;
    for (epoch, before) in [(far, 0), (far, far), (6, 0), (5, far), (5, 1 << 40)] {
        let what = format!("run {epoch}, {before} samples before");
        let (mut fleet, mut source) = (fleet(2), Source::new(1, 5));
        let mut shut_out = 0;
        for step in 0..back_at + 60 {
            let now_ns = 60_000 * MS + step * PERIOD_NS;
            source.send(&mut fleet, &[healthy(LIVING, step, now_ns, PERIOD_NS)], now_ns);
            if step == forged_at {
                let mut forged = Source::new(1, epoch).header;
                forged.samples_before = before;
                let sample = healthy(LIVING, step + 1, now_ns + MS, PERIOD_NS);
                fleet.take(&forged, &[sample], now_ns);
            }
            fleet.tick(now_ns, false);
            let refused = [DropReason::OldEpoch, DropReason::Duplicate];
            let refused: u64 = refused.iter().map(|reason| fleet.drops().get(*reason)).sum();
            if step == back_at {
                shut_out = refused;
                assert!(shut_out > 0, "{what}: it looks like the next run");
            }
            // Five readings fill the window again.
            if (5..forged_at).contains(&step) || step > back_at + 5 {
                let found = quality(&fleet, LIVING);
                let fresh = matches!(found, Quality::Fresh | Quality::Held);
                assert!(fresh, "{what}: {found:?} in step {step}");
            }
            assert!(step <= back_at || refused == shut_out, "{what}: step {step}");
        }
        assert_eq!(forecast(&fleet, LIVING).source_epoch, 5, "{what}");
    }
}
