//! Compares the fleet with the oracle, bit for bit.

use joulebus_energy::EnergyState;
use joulebus_fleet::{Fleet, ForEachOutput, Output, each_output};
use joulebus_predictor::Model;
use joulebus_testkit_fleets as world;
use joulebus_wire::{
    FieldType, OUTLOOK_S, Quality, Row as _, diagnostic_flag, outlook_flag, plan_state_flag,
};
use proptest::prelude::*;

use super::intake::{Member, Oracle};
use super::robot::{Account, Scored};

/// Every forecast, score and account after the tick at `now_ns`.
pub(crate) fn compare(fleet: &Fleet, oracle: &Oracle, now_ns: u64) -> Result<(), TestCaseError> {
    let drops: Vec<_> =
        fleet.drops().iter().map(|(reason, count)| (reason.name(), count)).collect();
    let mut expected: Vec<_> = oracle.drops.iter().map(|(name, n)| (*name, *n)).collect();
    expected.sort_by_key(|(name, _)| drops.iter().position(|drop| drop.0 == *name));
    prop_assert_eq!(drops, expected);
    prop_assert_eq!(fleet.accepted(), oracle.accepted);
    prop_assert_eq!(fleet.len(), oracle.members.len());
    for (id, member) in &oracle.members {
        compare_forecast(fleet, oracle, *id, member, now_ns)?;
        compare_scores(fleet, *id, member)?;
        compare_learned(fleet, *id, member, &oracle.models[member.context])?;
        compare_energy(fleet, oracle, *id, member)?;
        compare_account(fleet, *id, &member.robot.account)?;
        compare_plan_state(fleet, oracle, *id, member, now_ns)?;
        compare_outlook(fleet, oracle, *id, member)?;
        one_nan(fleet, *id)?;
    }
    for (id, account) in &oracle.departed {
        compare_account(fleet, *id, account)?;
    }
    Ok(())
}

/// Names the numbers of a robot's rows that are NaN with other bits than on other machines.
struct OtherNans<'a> {
    fleet: &'a Fleet,
    place: usize,
    found: Vec<&'static str>,
}

impl ForEachOutput for OtherNans<'_> {
    fn output<O: Output>(&mut self) {
        let words = world::row_bits(&O::row(self.fleet, self.place));
        let bytes: Vec<u8> = words.into_iter().flat_map(u64::to_ne_bytes).collect();
        for field in O::Row::LAYOUT.fields {
            let numbers = &bytes[field.offset..][..field.size];
            let is_canonical = match field.of {
                FieldType::F32 => numbers.as_chunks().0.iter().all(|number| {
                    let number = f32::from_ne_bytes(*number);
                    !number.is_nan() || number.to_bits() == f32::NAN.to_bits()
                }),
                FieldType::F64 => numbers.as_chunks().0.iter().all(|number| {
                    let number = f64::from_ne_bytes(*number);
                    !number.is_nan() || number.to_bits() == f64::NAN.to_bits()
                }),
                _ => true,
            };
            self.found.extend((!is_canonical).then_some(field.name));
        }
    }
}

/// Whatever is not a number leaves with the same bits on every machine.
fn one_nan(fleet: &Fleet, id: u32) -> Result<(), TestCaseError> {
    let place = world::place(fleet, id).expect("it is in the fleet");
    let mut others = OtherNans { fleet, place, found: Vec::new() };
    each_output(&mut others);
    prop_assert!(others.found.is_empty(), "robot {}: {:?}", id, others.found);
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
    let silent_ns = now_ns - member.received_ns;
    let (mut quality, mut power_w) = member.robot.shown(&oracle.models[member.context], silent_ns);
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
    prop_assert_eq!(found.expected_w().is_some(), power_w.is_some());
    if power_w.is_some() {
        // Also in open loop, and for any residuals.
        let inside = found.lo_w <= found.power_w && found.power_w <= found.hi_w;
        prop_assert!(inside, "robot {}: {:?}", id, found);
    }
    if let Some(last) = &member.robot.last {
        prop_assert_eq!((found.sample_seq, found.stamp_ns), (last.seq, last.stamp_ns));
    }
    Ok(())
}

fn compare_learned(
    fleet: &Fleet,
    id: u32,
    member: &Member,
    model: &Model,
) -> Result<(), TestCaseError> {
    let found = world::diagnostic(fleet, id);
    let robot = &member.robot;
    let flagged = found.flags & diagnostic_flag::LEARNED != 0;
    let learns = robot.platform.online && matches!(model, Model::Network(_));
    prop_assert_eq!(flagged, learns, "robot {}", id);
    // Everything is recomputed from the first reading on: now and then.
    if learns && !robot.scored.len().is_multiple_of(8) {
        return Ok(());
    }
    let shown = [
        found.mean_w,
        found.change_w,
        found.weight_last,
        found.weight_network,
        found.weight_stack,
        found.held_weight_last,
        found.held_weight_stack,
        found.gain_last,
        found.gain_network,
        found.gain_mean,
        found.level_w,
    ];
    let expected = robot.experts.learned(&robot.platform, model);
    let expected = expected.unwrap_or([f32::NAN; 11]);
    prop_assert_eq!(
        shown.map(f32::to_bits),
        expected.map(f32::to_bits),
        "robot {}: {:?}, expected {:?}",
        id,
        found,
        expected
    );
    Ok(())
}

/// Robot by robot from the first sample on, the energy states have the bits of the blocks'.
fn compare_energy(
    fleet: &Fleet,
    oracle: &Oracle,
    id: u32,
    member: &Member,
) -> Result<(), TestCaseError> {
    let robot = &member.robot;
    let platform = oracle.errors[member.context].calibration.platform();
    let expected = EnergyState { bounds: platform.plans, ..robot.energy };
    let found = fleet.energy(id).expect("it is in the fleet");
    let bits = |state: EnergyState| {
        let (metered, learned) = (state.metered.to_array(), state.learned.to_groups());
        let bounds = [state.bounds.lower, state.bounds.upper];
        (
            metered.map(f32::to_bits),
            learned.map(|group| group.map(f32::to_bits)),
            bounds.map(|bound| bound.map(f32::to_bits)),
        )
    };
    prop_assert_eq!(
        bits(found),
        bits(expected),
        "robot {}: {:?}, expected {:?}",
        id,
        found,
        expected
    );
    Ok(())
}

/// Window, command and reading age are the oracle's. Quality and what was learned come from the
/// other outputs.
fn compare_plan_state(
    fleet: &Fleet,
    oracle: &Oracle,
    id: u32,
    member: &Member,
    now_ns: u64,
) -> Result<(), TestCaseError> {
    let found = world::plan_state(fleet, id);
    let (forecast, diagnostic) = (world::forecast(fleet, id), world::diagnostic(fleet, id));
    prop_assert_eq!(
        (found.robot, found.quality(), found.stamp_ns),
        (forecast.robot, forecast.quality(), forecast.stamp_ns)
    );
    prop_assert_eq!(usize::from(found.platform), member.context);
    let learned = [
        (found.network_w, diagnostic.network_w),
        (found.mean_w, diagnostic.mean_w),
        (found.change_w, diagnostic.change_w),
        (found.weight_last, diagnostic.weight_last),
        (found.weight_network, diagnostic.weight_network),
        (found.weight_stack, diagnostic.weight_stack),
        (found.held_weight_stack, diagnostic.held_weight_stack),
        (found.gain_last, diagnostic.gain_last),
        (found.gain_network, diagnostic.gain_network),
        (found.gain_mean, diagnostic.gain_mean),
        (found.level_w, diagnostic.level_w),
    ];
    for (found, expected) in learned {
        prop_assert_eq!(found.to_bits(), expected.to_bits(), "robot {}", id);
    }
    let energy = fleet.energy(id).expect("it is in the fleet");
    for (found, expected) in [
        (found.energy_j, energy.metered.energy_j),
        (found.command_j, energy.metered.command_j),
        (found.time_s, energy.metered.time_s),
    ] {
        prop_assert_eq!(found.map(f32::to_bits), expected.map(f32::to_bits));
    }
    let trust = energy.learned.command_trust;
    prop_assert_eq!(found.command_trust.to_bits(), trust.to_bits());
    for (found, expected) in
        [(found.error_lower, energy.bounds.lower), (found.error_upper, energy.bounds.upper)]
    {
        prop_assert_eq!(found.map(f32::to_bits), expected.map(f32::to_bits));
    }
    let silent_ns = now_ns - member.received_ns;
    let model = &oracle.models[member.context];
    let start = member.robot.plan_start(model, silent_ns);
    let start = start.filter(|_| forecast.expected_w().is_some());
    let Some(run) = start else {
        return Ok(());
    };
    let lags_w = found.lags_w().expect("a forecast has a full window");
    let newest_first = run.powers_w.iter().rev().take(5);
    prop_assert!(newest_first.zip(lags_w).all(|(a, b)| a.to_bits() == b.to_bits()));
    prop_assert_eq!(found.command(), run.command, "robot {}", id);
    prop_assert_eq!(u64::from(found.open_steps), run.unread, "robot {}", id);
    let (age, interval) = (run.history.known_age(), run.history.interval());
    prop_assert_eq!(u64::from(found.age_steps), age.unwrap_or(255), "robot {}", id);
    prop_assert_eq!(u64::from(found.interval_steps), interval.unwrap_or(0));
    let is_known = found.flags & plan_state_flag::READING_AGE != 0;
    prop_assert_eq!(is_known, interval.is_some(), "robot {}", id);
    Ok(())
}

/// Quality is that of the forecast, energy that of the pure function, and time to empty that of the
/// budget.
fn compare_outlook(
    fleet: &Fleet,
    oracle: &Oracle,
    id: u32,
    member: &Member,
) -> Result<(), TestCaseError> {
    let found = world::outlook(fleet, id);
    let (forecast, budget) = (world::forecast(fleet, id), world::budget(fleet, id));
    prop_assert_eq!(
        (found.robot, found.quality(), found.stamp_ns, found.generation),
        (forecast.robot, forecast.quality(), forecast.stamp_ns, forecast.generation)
    );
    prop_assert_eq!(usize::from(found.platform), member.context);
    for (found, expected) in [
        (found.usable_j, budget.usable_j),
        (found.time_to_empty_s, budget.time_to_empty_s),
        (found.time_to_empty_lo_s, budget.time_to_empty_lo_s),
        (found.time_to_empty_hi_s, budget.time_to_empty_hi_s),
    ] {
        prop_assert_eq!(found.to_bits(), expected.to_bits(), "robot {}", id);
    }
    let state = fleet.energy(id).expect("it is in the fleet");
    let is_metered = state.metered.time_s[0] > 0.0;
    let is_known = is_metered && !matches!(forecast.quality(), Quality::Invalid(_));
    prop_assert_eq!(found.flags & outlook_flag::ENERGY != 0, is_known, "robot {}", id);
    if !is_known {
        prop_assert!(found.energy_j.iter().all(|joules| joules.is_nan()));
        prop_assert_eq!((found.bounded, found.mean_w.is_nan()), (0, true));
        return Ok(());
    }
    let model = fleet.energy_model(member.context).expect("its platform has one");
    let ahead = model.outlook(OUTLOOK_S);
    let (run, errors) = (&member.robot.run, &oracle.errors[member.context]);
    let last_w = run.powers_w.last().copied().filter(|_| run.unread == 0).unwrap_or(f32::NAN);
    let expected = ahead.of(&state, errors.calibration.platform(), last_w);
    prop_assert_eq!(usize::from(found.bounded), ahead.bounded());
    for (found, expected) in [
        (found.energy_j, expected.energy_j),
        (found.energy_lo_j, expected.lo_j),
        (found.energy_hi_j, expected.hi_j),
    ] {
        prop_assert_eq!(found.map(f32::to_bits), expected.map(f32::to_bits), "robot {}", id);
    }
    Ok(())
}

fn compare_scores(fleet: &Fleet, id: u32, member: &Member) -> Result<(), TestCaseError> {
    let found = world::diagnostic(fleet, id);
    let robot = &member.robot;
    prop_assert!(same(found.residual_w, robot.residual_w), "robot {id}: {found:?}");
    prop_assert_eq!(found.flags & diagnostic_flag::RESIDUAL != 0, robot.residual_w.is_some());
    prop_assert_eq!(found.refused, member.refused, "robot {}", id);
    let scored = &robot.scored;
    prop_assert_eq!(found.scored, scored.len() as u64, "robot {}", id);
    if scored.is_empty() {
        prop_assert!(found.mae_w.is_nan());
        return Ok(());
    }
    let share = 1.0 / scored.len() as f64;
    let step = |s: &Scored| f64::from(s.reading_w) - f64::from(s.previous_w);
    let sum = |term: &dyn Fn(&Scored) -> f64| scored.iter().fold(0.0, |sum, s| sum + term(s));
    let error = sum(&|s| f64::from(s.residual_w) * f64::from(s.residual_w));
    let steps = sum(&|s| step(s) * step(s));
    let mae_w = sum(&|s| f64::from(s.residual_w).abs()) * share;
    let persistence_mae_w = sum(&|s| step(s).abs()) * share;
    prop_assert_eq!(found.mae_w.to_bits(), mae_w.to_bits(), "robot {}", id);
    prop_assert_eq!(found.persistence_mae_w.to_bits(), persistence_mae_w.to_bits());
    if steps > 0.0 {
        prop_assert_eq!(found.skill.to_bits(), (1.0 - error * (1.0 / steps)).to_bits());
    }
    let mean = sum(&|s| f64::from(s.reading_w)) * share;
    let scatter = sum(&|s| (f64::from(s.reading_w) - mean).powi(2));
    if scatter > 1e-6 {
        let r2 = 1.0 - error / scatter;
        prop_assert!((found.r2 - r2).abs() <= 1e-9 * (1.0 + r2.abs()), "{} {r2}", found.r2);
    }
    for value in [found.bias_w, found.noise_ratio] {
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
    prop_assert_eq!(times, (account.metered_ns, account.unmetered_ns), "robot {}", id);
    prop_assert_eq!(found.metered_ns + found.unmetered_ns, account.elapsed_ns);
    prop_assert_eq!(found.stamp_ns(), account.last.map(|last| last.0));
    Ok(())
}
