//! The tick against a slow, obvious oracle, under a virtual clock, with faults drawn from a seed.

mod experts;
mod faults;
mod intake;
mod robot;
mod state;
#[path = "../world/mod.rs"]
mod world;

use faults::{Rates, Sender};
use intake::{Member, Oracle};
use joulebus_fleet::Fleet;
use joulebus_wire::{Quality, diagnostic_flag};
use proptest::prelude::*;
use robot::{Account, Scored, rarely};
use world::random::Noise;
use world::{MS, PERIOD_NS};

const START_NS: u64 = 60_000 * MS;
/// Less than the robots that the sources name, so that some are refused.
const CAPACITY: u32 = 9;

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn forecasts_residuals_ledgers_and_scores_equal_the_oracle_after_every_tick(
        seed in any::<u64>(),
        sample in prop::sample::select(vec![5u64, 20, 100, 1_000_000]),
        frame in prop::sample::select(vec![10u64, 50, 1_000_000]),
        jitter_ns in prop::sample::select(vec![1, PERIOD_NS / 4, 3 * PERIOD_NS]),
        fresh in any::<bool>(),
        learning in any::<bool>(),
    ) {
        simulate(seed, Rates { sample, frame }, jitter_ns, 150, (fresh, learning))?;
    }
}

/// A long run in which everything happens: the oracle is then known to have seen it all.
#[test]
fn the_injector_produces_every_fault() {
    let mut drops = Vec::new();
    let mut qualities = Vec::new();
    for seed in 0..6 {
        let rates = Rates {
            sample: 8,
            frame: 20,
        };
        let seen = simulate(seed, rates, PERIOD_NS, 400, (seed % 2 == 0, seed % 3 == 0))
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
    (fresh, learning): (bool, bool),
) -> Result<Seen, TestCaseError> {
    let mut noise = Noise(seed);
    let models = || match fresh {
        true => world::fresh_models(),
        false => world::models(),
    };
    let settings = match learning {
        true => world::learning(CAPACITY),
        false => world::settings(CAPACITY),
    };
    let mut fleet = Fleet::new(settings.clone(), models()).expect("the settings agree");
    let mut oracle = Oracle::new(settings, models());
    let mut senders = senders();
    let (mut now_ns, mut sent) = (START_NS, 0);
    let mut qualities = Vec::new();
    for _ in 0..ticks {
        now_ns += PERIOD_NS / 2 + noise.next_u64() % jitter_ns.max(PERIOD_NS);
        if rarely(&mut noise, rates.frame) {
            now_ns += noise.next_u64() % (20 * PERIOD_NS); // The worker itself was held up.
        }
        let mut arrived: Vec<_> = senders
            .iter_mut()
            .flat_map(|sender| sender.arrivals(now_ns, rates, &mut noise))
            .collect();
        arrived.sort_by_key(|frame| frame.at_ns);
        for frame in arrived {
            let taken_ns = frame.at_ns;
            fleet.take(&frame.header, &frame.samples, taken_ns);
            oracle.take(&frame.header, &frame.samples, taken_ns);
            sent += frame.samples.len() as u64;
            // Of a source too many no account is kept.
            if oracle.keeps_account_of(frame.header.source_id) {
                sent += frame.lost;
            }
        }
        fleet.tick(now_ns, false);
        oracle.tick(now_ns);
        compare(&fleet, &oracle, now_ns)?;
        prop_assert_eq!(sent, fleet.accepted() + fleet.drops().total());
        qualities.extend((0..fleet.len()).map(|at| format!("{:?}", fleet.forecast(at).quality())));
    }
    Ok((oracle.drops.into_keys().collect(), qualities))
}

fn compare(fleet: &Fleet, oracle: &Oracle, now_ns: u64) -> Result<(), TestCaseError> {
    let drops: Vec<_> = fleet
        .drops()
        .iter()
        .map(|(reason, count)| (reason.name(), count))
        .collect();
    let mut expected: Vec<_> = oracle.drops.iter().map(|(name, n)| (*name, *n)).collect();
    expected.sort_by_key(|(name, _)| drops.iter().position(|drop| drop.0 == *name));
    prop_assert_eq!(drops, expected);
    prop_assert_eq!(fleet.accepted(), oracle.accepted);
    prop_assert_eq!(fleet.len(), oracle.members.len());
    for (id, member) in &oracle.members {
        compare_forecast(fleet, oracle, *id, member, now_ns)?;
        compare_scores(fleet, *id, member)?;
        compare_account(fleet, *id, &member.robot.account)?;
    }
    for (id, account) in &oracle.departed {
        compare_account(fleet, *id, account)?;
    }
    Ok(())
}

fn same(found: f32, expected: Option<f32>) -> bool {
    expected.map_or(found.is_nan(), |value| value.to_bits() == found.to_bits())
}

fn compare_forecast(
    fleet: &Fleet,
    oracle: &Oracle,
    id: u32,
    member: &Member,
    now_ns: u64,
) -> Result<(), TestCaseError> {
    let found = world::forecast(fleet, id);
    let silent_ns = now_ns - member.heard_ns;
    let (mut quality, mut power_w) = member
        .robot
        .shown(&oracle.models[member.context], silent_ns);
    let stale = silent_ns > member.robot.platform.stale_after_ns;
    if let Some(reason) = member.invalid.filter(|_| !stale) {
        (quality, power_w) = (Quality::Invalid(reason), None);
    }
    prop_assert_eq!(found.quality(), quality, "robot {}", id);
    prop_assert!(
        same(found.power_w, power_w),
        "robot {id} at {now_ns}: {} W, expected {power_w:?}",
        found.power_w
    );
    prop_assert_eq!(found.power_w().is_some(), power_w.is_some());
    if power_w.is_some() {
        prop_assert!(found.lo_w <= found.hi_w, "robot {}: {:?}", id, found);
    }
    if let Some(last) = &member.robot.last {
        prop_assert_eq!(
            (found.sample_seq, found.stamp_ns),
            (last.seq, last.stamp_ns)
        );
    }
    Ok(())
}

fn compare_scores(fleet: &Fleet, id: u32, member: &Member) -> Result<(), TestCaseError> {
    let found = world::diagnostic(fleet, id);
    let robot = &member.robot;
    prop_assert!(
        same(found.residual_w, robot.residual_w),
        "robot {id}: {found:?}"
    );
    prop_assert_eq!(
        found.flags & diagnostic_flag::RESIDUAL != 0,
        robot.residual_w.is_some()
    );
    prop_assert_eq!(found.refused, member.refused, "robot {}", id);
    let scored = &robot.scored;
    prop_assert_eq!(found.scored, scored.len() as u64, "robot {}", id);
    if scored.is_empty() {
        prop_assert!(found.mae_w.is_nan());
        return Ok(());
    }
    let n = scored.len() as f64;
    let step = |s: &Scored| f64::from(s.reading_w) - f64::from(s.previous_w);
    let sum = |term: &dyn Fn(&Scored) -> f64| scored.iter().fold(0.0, |sum, s| sum + term(s));
    let error = sum(&|s| f64::from(s.residual_w) * f64::from(s.residual_w));
    let steps = sum(&|s| step(s) * step(s));
    let mae_w = sum(&|s| f64::from(s.residual_w).abs()) / n;
    let persistence_mae_w = sum(&|s| step(s).abs()) / n;
    prop_assert_eq!(found.mae_w.to_bits(), mae_w.to_bits(), "robot {}", id);
    prop_assert_eq!(
        found.persistence_mae_w.to_bits(),
        persistence_mae_w.to_bits()
    );
    if steps > 0.0 {
        prop_assert_eq!(found.skill.to_bits(), (1.0 - error / steps).to_bits());
    }
    let mean = sum(&|s| f64::from(s.reading_w)) / n;
    let scatter = sum(&|s| (f64::from(s.reading_w) - mean).powi(2));
    if scatter > 1e-6 {
        let r2 = 1.0 - error / scatter;
        prop_assert!(
            (found.r2 - r2).abs() <= 1e-9 * (1.0 + r2.abs()),
            "{} {r2}",
            found.r2
        );
    }
    for value in [
        found.bias_w,
        found.cusum_up,
        found.cusum_down,
        found.noise_ratio,
    ] {
        prop_assert!(value.is_finite(), "robot {}: {:?}", id, found);
    }
    Ok(())
}

fn compare_account(fleet: &Fleet, id: u32, account: &Account) -> Result<(), TestCaseError> {
    const UNITS_PER_UJ: i128 = 2_000_000_000;
    let found = fleet.ledger(id).expect("every robot has an account");
    let drawn = i128::from(found.drawn_uj) * UNITS_PER_UJ + i128::from(found.drawn_remainder);
    prop_assert_eq!(drawn, account.drawn, "robot {}", id);
    let expected_uj = account.expected.div_euclid(UNITS_PER_UJ);
    prop_assert_eq!(i128::from(found.forecast_uj), expected_uj, "robot {}", id);
    let times = (found.metered_ns, found.unmetered_ns);
    prop_assert_eq!(
        times,
        (account.metered_ns, account.unmetered_ns),
        "robot {}",
        id
    );
    prop_assert_eq!(found.metered_ns + found.unmetered_ns, account.elapsed_ns);
    prop_assert_eq!(found.stamp_ns(), account.last.map(|last| last.0));
    Ok(())
}
