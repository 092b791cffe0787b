//! The tick against a slow oracle, under a virtual clock, with random faults.

mod compare;
mod experts;
mod faults;
mod intake;
mod robot;
mod shifted;
mod state;

use compare::compare;
use faults::{Rates, Sender};
use intake::Oracle;
use joulebus_fleet::Fleet;
use joulebus_testkit_fleets::random::Noise;
use joulebus_testkit_fleets::{self as world, MS, PERIOD_NS};
use proptest::prelude::*;
use robot::rarely;

const START_NS: u64 = 60_000 * MS;
/// Less than the number of robots that the sources send, so that some are refused.
const CAPACITY: u32 = 9;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases.min(24)))]

    #[test]
    fn forecasts_residuals_ledgers_and_scores_equal_the_oracle_after_every_tick(
        seed in any::<u64>(),
        sample in prop::sample::select(vec![5u64, 20, 100, 1_000_000]),
        frame in prop::sample::select(vec![10u64, 50, 1_000_000]),
        jitter_ns in prop::sample::select(vec![1, PERIOD_NS / 4, 3 * PERIOD_NS]),
        fresh in any::<bool>(),
        learning in any::<bool>(),
        narrow in any::<bool>(),
    ) {
        simulate(seed, Rates { sample, frame }, jitter_ns, 150, (fresh, learning, narrow))?;
    }
}

/// A long run that covers every fault, which shows that the oracle handles them.
#[test]
fn the_injector_produces_every_fault() {
    let mut drops = Vec::new();
    let mut qualities = Vec::new();
    for seed in 0..6 {
        let rates = Rates { sample: 8, frame: 20 };
        let seen = simulate(seed, rates, PERIOD_NS, 400, (seed % 2 == 0, seed % 3 == 0, seed == 4))
            .expect("equal to the oracle");
        drops.extend(seen.0);
        qualities.extend(seen.1);
    }
    for name in [
        "UnknownRobot",
        "OverCapacity",
        "ForeignSource",
        "OldEpoch",
        "Duplicate",
        "OutOfOrder",
        "BadTime",
        "NotFinite",
        "PowerOutOfRange",
        "CommandOutOfRange",
        "BadFlags",
        "Backlog",
        "Overflow",
        "Schema",
        "TooManySources",
        "BatteryOutOfRange",
    ] {
        assert!(drops.contains(&name), "no {name} among {drops:?}");
    }
    for name in [
        "Fresh",
        "Held",
        "Warmup",
        "OpenLoop",
        "Stale",
        "NoCommand",
        "NoFreshness",
        "NoReading",
        "NotFinite",
        "BadTime",
        "BadFlags",
    ] {
        assert!(qualities.iter().any(|q| q.contains(name)), "never {name}");
    }
}

type Seen = (Vec<&'static str>, Vec<String>);

fn senders() -> [Sender; 5] {
    [
        Sender::new(1, &[1, 2, 3, 201], false, START_NS),
        Sender::new(2, &[101, 102, 103], true, START_NS),
        Sender::new(3, &[4, 2, 202], false, START_NS + 20 * PERIOD_NS),
        Sender::new(4, &[104], true, START_NS),
        Sender::new(5, &[5], false, START_NS + 40 * PERIOD_NS),
    ]
}

fn simulate(
    seed: u64,
    rates: Rates,
    jitter_ns: u64,
    ticks: u64,
    (fresh, learning, narrow): (bool, bool, bool),
) -> Result<Seen, TestCaseError> {
    let mut noise = Noise(seed);
    let models = || match fresh {
        true => world::fresh_models(),
        false => world::models(),
    };
    let mut settings = match learning {
        true => world::learning(CAPACITY),
        false => world::settings(CAPACITY),
    };
    if narrow {
        // Models forecast more and less than that.
        for platform in &mut settings.platforms {
            (platform.power_min_w, platform.power_max_w) = (3.3, 3.9);
        }
    }
    let mut fleet = Fleet::new(settings.clone(), models()).expect("the settings agree");
    let mut oracle = Oracle::new(settings, models());
    let mut senders = senders();
    let (mut now_ns, mut sent) = (START_NS, 0);
    let mut ends = Noise(!seed);
    let mut qualities = Vec::new();
    for _ in 0..ticks {
        now_ns += PERIOD_NS / 2 + noise.next_u64() % jitter_ns.max(PERIOD_NS);
        if rarely(&mut noise, rates.frame) {
            now_ns += noise.next_u64() % (20 * PERIOD_NS); // The worker itself was delayed.
        }
        let mut arrived: Vec<_> = senders
            .iter_mut()
            .flat_map(|sender| sender.arrivals(now_ns, rates, &mut noise))
            .collect();
        arrived.sort_by_key(|frame| frame.at_ns);
        if rarely(&mut ends, rates.frame) {
            // Of a run that sends on, or has been replaced, as well.
            let header = senders[(ends.next_u64() % 5) as usize].header();
            let epoch = header.source_epoch - ends.next_u64() % 2;
            fleet.end_source(header.source_id, epoch);
            oracle.end(header.source_id, epoch);
        }
        for frame in arrived {
            let taken_ns = frame.at_ns;
            let source_id = frame.header.source_id;
            let counted = oracle.keeps_account_of(source_id) || oracle.has_free_place();
            fleet.take(&frame.header, &frame.samples, taken_ns);
            oracle.take(&frame.header, &frame.samples, taken_ns);
            sent += frame.samples.len() as u64;
            // A source too many has no account, nor do its samples from before it got a slot.
            if counted && oracle.keeps_account_of(source_id) {
                sent += frame.lost;
            }
        }
        fleet.tick(now_ns, false);
        oracle.tick(now_ns);
        compare(&fleet, &oracle, now_ns)?;
        // If a source returns after it made room, its earlier count is unknown.
        if oracle.recycled == 0 {
            prop_assert_eq!(sent, fleet.accepted() + fleet.drops().total());
        }
        qualities.extend((0..fleet.len()).map(|at| format!("{:?}", fleet.forecast(at).quality())));
    }
    prop_assert!(ticks < 400 || oracle.ended > 0, "no source has ended");
    Ok((oracle.drops.into_keys().collect(), qualities))
}
