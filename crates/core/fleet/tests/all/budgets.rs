//! Budgets fail closed: unknown energy lowers the usable energy, and never raises it.

use joulebus_fleet::{Fleet, Ledger, SavedBattery};
use joulebus_settings::Battery;
use joulebus_testkit_fleets::{
    self as world, MS, PERIOD_NS, Source, battery, budget, fleet, healthy,
};
use joulebus_wire::{Budget, ChargeState, Sample, budget_flag, sample_flag};
use proptest::prelude::*;

const ROBOT: u32 = 7;
const START_NS: u64 = 60_000 * MS;
const POWER_MAX_W: f64 = 20.0;

fn send(fleet: &mut Fleet, source: &mut Source, sample: Sample) -> Budget {
    source.tick(fleet, &[sample], sample.stamp_ns);
    budget(fleet, ROBOT)
}

fn at(step: u64) -> Sample {
    healthy(ROBOT, step, START_NS + step * PERIOD_NS, PERIOD_NS)
}

fn warm() -> (Fleet, Source, Budget) {
    let (mut fleet, mut source) = (fleet(1), Source::new(1, 1));
    for step in 0..30 {
        send(&mut fleet, &mut source, at(step));
    }
    let shown = budget(&fleet, ROBOT);
    (fleet, source, shown)
}

/// Conservative bounds are below the best estimate, and all are within the battery.
fn assert_in_order(budget: &Budget) {
    let full_j = battery().capacity_j as f32;
    let energies = [0.0, budget.usable_lo_j, budget.usable_j, budget.left_j, full_j];
    let shares = [0.0, budget.soc_lo, budget.soc, budget.soc_hi, 1.0];
    assert!(energies.is_sorted() && shares.is_sorted(), "{budget:?}");
    let [lo_s, hi_s] = [budget.time_to_empty_lo_s, budget.time_to_empty_hi_s];
    if budget.flags & budget_flag::TIME_TO_EMPTY != 0 {
        assert!([lo_s, budget.time_to_empty_s, hi_s].is_sorted(), "{budget:?}");
    } else {
        assert!(budget.time_to_empty_s.is_nan(), "{budget:?}");
    }
}

/// The lower bound of the usable energy is `spent_s` of the greatest power below that of `start`.
fn assert_spent(shown: &Budget, start: &Budget, spent_s: f64) {
    let expected = f64::from(start.usable_lo_j) - spent_s * POWER_MAX_W;
    let off = (f64::from(shown.usable_lo_j) - expected).abs();
    assert!(off < 0.01, "{shown:?}, {expected}");
}

/// Periods, s.
fn seconds(periods: u64) -> f64 {
    (periods * PERIOD_NS) as f64 * 1e-9
}

#[test]
fn the_budget_follows_from_the_ledger() {
    let (fleet, _, shown) = warm();
    let ledger = fleet.ledger(ROBOT).expect("it has sent samples");
    assert_eq!(shown.drawn_uj, ledger.drawn_uj);
    assert_eq!(shown.metered_ns, 29 * PERIOD_NS);
    assert_eq!(shown.unmetered_ns, 0);
    assert_eq!(shown.valid_until_ns, shown.stamp_ns + 30 * PERIOD_NS);
    let Battery { capacity_j, reserve, initial_soc, initial_soc_lo, .. } = battery();
    let usable_j = capacity_j * (initial_soc - reserve) - shown.drawn_j();
    let usable_lo_j = capacity_j * (initial_soc_lo - reserve) - shown.drawn_j();
    let near = |found: f32, expected: f64| (f64::from(found) - expected).abs() < 1e-3;
    assert!(near(shown.usable_j, usable_j), "{shown:?}, {usable_j}");
    assert!(near(shown.usable_lo_j, usable_lo_j), "{shown:?}");
    let flags = budget_flag::BATTERY
        | budget_flag::CHARGE
        | budget_flag::TIME_TO_EMPTY
        | budget_flag::LEDGER;
    assert_eq!(shown.flags, flags);
    assert_in_order(&shown);
}

#[test]
fn silence_is_charged_at_maximum_power_and_returning_raises_nothing() {
    let (mut fleet, mut source, mut before) = warm();
    let start = before;
    for step in 31..90 {
        fleet.tick(START_NS + step * PERIOD_NS, false);
        let shown = budget(&fleet, ROBOT);
        assert!(shown.usable_lo_j < before.usable_lo_j, "{step}: {shown:?}");
        assert!(shown.usable_j < before.usable_j, "{step}: {shown:?}");
        assert_spent(&shown, &start, seconds(step - 30));
        assert_in_order(&shown);
        before = shown;
    }
    let back = send(&mut fleet, &mut source, at(90));
    assert!(back.usable_lo_j <= before.usable_lo_j, "{back:?}, {before:?}");
    assert_eq!(back.unmetered_ns, 61 * PERIOD_NS);
}

#[test]
fn refused_or_missing_input_lowers_the_budget_like_silence() {
    type Spoil = fn(&mut Sample);
    let cases: [(&str, Spoil); 5] = [
        ("NaN power", |sample| sample.power_w = f32::NAN),
        ("negative power", |sample| sample.power_w = -5.0),
        ("huge power", |sample| sample.power_w = 1e30),
        ("absurd command", |sample| sample.v_mps = 1e30),
        ("no reading", |sample| sample.flags &= !sample_flag::POWER),
    ];
    for (what, spoil) in cases {
        let (mut fleet, mut source, mut before) = warm();
        let start = before;
        for step in 30..60 {
            let mut sample = at(step);
            spoil(&mut sample);
            let shown = send(&mut fleet, &mut source, sample);
            // One period of tolerance: the robot may just be late.
            let (now, last) = (shown.usable_lo_j, before.usable_lo_j);
            assert!(now < last || step == 30 && now == last, "{what}, step {step}");
            assert_eq!(shown.metered_ns, start.metered_ns, "{what}, step {step}");
            assert_in_order(&shown);
            before = shown;
        }
        let back = send(&mut fleet, &mut source, at(60));
        assert!(back.usable_lo_j <= before.usable_lo_j, "{what}: {back:?}");
        assert_spent(&back, &start, seconds(31));
        let account_ns = back.metered_ns + back.unmetered_ns;
        assert_eq!(account_ns, 60 * PERIOD_NS, "{what}");
    }
}

#[test]
fn a_charge_that_is_not_metered_widens_the_range_to_what_it_may_have_stored() {
    let (mut fleet, mut source, _) = warm();
    let charging = send(&mut fleet, &mut source, at(30).with(sample_flag::CHARGING));
    assert_eq!(charging.charge_state(), ChargeState::Charging);
    let lo = charging.soc_lo;
    let charging = send(&mut fleet, &mut source, at(31).with(sample_flag::CHARGING));
    assert_in_order(&charging);
    let [soc_lo, soc_hi] = [charging.soc_lo, charging.soc_hi];
    assert!(soc_hi == 1.0 && soc_lo <= lo, "{charging:?}");
    assert!(charging.time_to_empty_s.is_nan(), "{charging:?}");
    let after = send(&mut fleet, &mut source, at(32));
    assert_eq!(after.charge_state(), ChargeState::Discharging);
    assert_in_order(&after);
    assert!(after.time_to_empty_s > 0.0, "{after:?}");
    assert!(after.soc_hi > 0.999 && after.soc_lo <= lo, "{after:?}");
    fleet.tick(START_NS + 32 * PERIOD_NS + 2_501 * MS, false);
    assert!(fleet.is_empty());
    let back = send(&mut fleet, &mut source, at(200));
    assert_in_order(&back);
    assert!(back.soc_lo < after.soc_lo, "{back:?}, before {after:?}");
    assert!(back.flags & budget_flag::CHARGED != 0);
    assert!(back.drawn_uj > 0, "the ledger continues");
}

fn assert_unknown(budget: &Budget) {
    let flags = budget.flags & !budget_flag::CHARGED;
    assert_eq!(flags, budget_flag::LEDGER, "{budget:?}");
    let figures = [
        budget.left_j,
        budget.usable_j,
        budget.usable_lo_j,
        budget.soc,
        budget.soc_lo,
        budget.time_to_empty_s,
        budget.time_to_empty_lo_s,
        budget.time_to_empty_hi_s,
    ];
    assert!(figures.iter().all(|figure| figure.is_nan()), "{budget:?}");
}

#[test]
fn without_a_battery_or_an_accepted_sample_nothing_is_published() {
    let (mut fleet, mut source) = (fleet(2), Source::new(1, 1));
    let mut refused = at(0);
    refused.power_w = f32::NAN;
    let shown = send(&mut fleet, &mut source, refused);
    assert_eq!(shown.flags, 0);
    assert_eq!(shown.charge_state(), ChargeState::Unknown);
    assert!(shown.usable_lo_j.is_nan() && shown.left_j.is_nan());
    source.tick(&mut fleet, &[healthy(207, 0, START_NS, PERIOD_NS)], START_NS);
    assert_unknown(&budget(&fleet, 207));
}

#[test]
fn a_restored_account_continues_and_the_gap_is_charged_at_maximum_power() {
    let (_, _, saved) = warm();
    let mut fleet = fleet(2);
    let account = Ledger::restored(
        (saved.drawn_uj, saved.drawn_remainder),
        saved.forecast_uj,
        saved.metered_ns,
        saved.unmetered_ns,
        saved.stamp_ns,
    );
    assert!(fleet.restore(8, account, false, None));
    let battery = SavedBattery::new(&saved, 0);
    assert!(fleet.restore(ROBOT, account, false, battery));
    // A stored account can be replaced. There is capacity for two: the oldest is dropped.
    assert!(fleet.restore(ROBOT, account, false, battery));
    assert!(!fleet.restore(9, account, false, None));
    assert!(fleet.ledger(8).is_none());
    let back = send(&mut fleet, &mut Source::new(1, 2), at(129));
    let drawn = |budget: &Budget| (budget.drawn_uj, budget.drawn_remainder);
    assert_eq!(drawn(&back), drawn(&saved));
    assert_eq!(back.unmetered_ns, 100 * PERIOD_NS);
    assert_spent(&back, &saved, seconds(100));
}

#[test]
fn a_persistent_bias_never_inverts_the_conservative_bound() {
    for power_w in [0.5, 19.0] {
        let (mut fleet, mut source) = (fleet(1), Source::new(1, 1));
        for step in 0..6_000 {
            let mut sample = at(step);
            sample.power_w = power_w + 0.01 * (step % 7) as f32;
            let shown = send(&mut fleet, &mut source, sample);
            assert_in_order(&shown);
        }
    }
}

#[test]
fn regeneration_fills_a_battery_no_further_than_full() {
    let (mut fleet, mut source) = (fleet(1), Source::new(1, 1));
    for step in 0..8_000 {
        let now_ns = START_NS + step * world::SLOW_NS;
        let mut sample = healthy(107, step, now_ns, world::SLOW_NS);
        sample.power_w = -9.0;
        source.tick(&mut fleet, &[sample], now_ns);
        assert_in_order(&budget(&fleet, 107));
    }
    assert_eq!(budget(&fleet, 107).left_j, battery().capacity_j as f32);
}

proptest! {
    /// Each step is a sample with a reading, one without, a refused one, or none: only metered time
    /// costs less than the maximum power, and nothing ever adds energy.
    #[test]
    fn the_usable_energy_never_rises(steps in prop::collection::vec(0u8..6, 1..200)) {
        let (mut fleet, mut source, mut before) = warm();
        for (index, context) in steps.iter().enumerate() {
            let step = 30 + index as u64;
            let mut sample = at(step);
            match context {
                0 => sample.flags &= !sample_flag::POWER,
                1 => sample.power_w = f32::NAN,
                2 => {
                    fleet.tick(sample.stamp_ns, false);
                    let Some(_) = world::place(&fleet, ROBOT) else { return Ok(()) };
                }
                _ => {}
            }
            let shown = match context {
                2 => budget(&fleet, ROBOT),
                _ => send(&mut fleet, &mut source, sample),
            };
            prop_assert!(shown.usable_lo_j <= before.usable_lo_j, "step {step}: {shown:?}");
            assert_in_order(&shown);
            before = shown;
        }
    }
}
