//! Everyday questions about the robot that ships get the verdict that a person would give.

use std::path::Path as FilePath;

use joulebus_config::{Config, builtin_model};
use joulebus_energy::{EnergySample, EnergyState};
use joulebus_plan::{Path, PlanFleet, Point, Robot, Trip, Unknown, Verdict};
use joulebus_predictor::{Model, Network};
use joulebus_wire::{PlanState, budget_flag};

use crate::world::Rows;

const CAPACITY_J: f64 = 33_300.0;

/// The shipped platform with its model and a battery of 9.25 Wh.
fn fleet() -> PlanFleet {
    let text = "[fleet]\nname = \"lab\"\n[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-99\"]\n\
                [platform.battery]\ncapacity_wh = 9.25\nreserve = 0.1\ninitial_soc_lo = 0.9\n";
    let config = Config::parse(text, FilePath::new("/nowhere")).expect("the config is valid");
    let (_, bytes) = builtin_model("gternal-sim").expect("it ships");
    let network = Network::from_safetensors(bytes).expect("a valid file");
    PlanFleet::new(config.settings(), &[Model::Network(network)])
}

/// A robot that has stood for a minute at 3.5 W, with these states of charge: the best estimate and
/// the lower bound.
fn rows(fleet: &PlanFleet, soc: f64, soc_lo: f64) -> Rows {
    let mut energy = EnergyState::new(7);
    for _ in 0..1_800 {
        let sample =
            EnergySample { power_w: 3.5, elapsed_s: 1.0 / 30.0, v_mps: 0.0, omega_radps: 0.0 };
        energy.observe(&fleet.platforms()[0].energy, &sample);
    }
    let mut rows = Rows::with_usable(1.0);
    rows.state = PlanState {
        energy_j: energy.metered.energy_j,
        command_j: energy.metered.command_j,
        time_s: energy.metered.time_s,
        ..rows.state
    };
    let usable_j = |soc: f64| (CAPACITY_J * (soc - 0.1).max(0.0)) as f32;
    let budget = &mut rows.budget;
    (budget.soc, budget.soc_lo) = (soc as f32, soc_lo as f32);
    budget.soc_sd = (0.5 * (soc - soc_lo)) as f32;
    budget.left_j = (CAPACITY_J * soc) as f32;
    (budget.usable_j, budget.usable_lo_j) = (usable_j(soc), usable_j(soc_lo));
    rows
}

/// There and back, at the speed of every documented example.
fn there_and_back(robot: &Robot<'_>, away_m: f64) -> Trip {
    let dock = Point::new(0.0, 0.0);
    let path = Path::new(&[dock, Point::new(away_m, 0.0)], 0.2);
    robot.can_finish(&path, Some(dock), 0.9).expect("it is a path")
}

#[test]
fn everyday_questions_get_the_verdict_that_a_person_would_give() {
    let fleet = fleet();
    // State of charge and its lower bound, distance, verdict, probability.
    let table = [
        // Near, with 25 kJ to spare and with a battery that is half unknown.
        ((0.86, 0.84), 1.0, Verdict::Yes, 0.999..=1.0),
        ((0.86, 0.43), 1.0, Verdict::Yes, 0.99..=1.0),
        // Far, all longer than the model's longest horizon: a quarter of an hour, and most of an
        // hour, with enough and with hardly enough, and as long as no battery lasts.
        ((1.00, 0.95), 100.0, Verdict::Yes, 0.999..=1.0),
        ((1.00, 0.95), 300.0, Verdict::Yes, 0.999..=1.0),
        ((0.47, 0.46), 300.0, Verdict::Tight, 0.5..=0.9),
        ((1.00, 0.95), 2_000.0, Verdict::No, 0.0..=0.001),
        // Nearly empty: what is left suffices, suffices perhaps, does not.
        ((0.1032, 0.1022), 1.0, Verdict::Yes, 0.99..=1.0),
        ((0.1016, 0.1010), 1.0, Verdict::Tight, 0.55..=0.95),
        ((0.1200, 0.1000), 1.0, Verdict::Tight, 0.9..=1.0),
        ((0.1010, 0.1000), 1.0, Verdict::No, 0.0..=0.45),
        ((0.0800, 0.0500), 1.0, Verdict::No, 0.0..=0.1),
        // Not charged for long: the best estimate allows it, the lower bound nothing.
        ((0.70, 0.0), 1.0, Verdict::Tight, 0.9..=1.0),
    ];
    for ((soc, soc_lo), away_m, verdict, probability) in table {
        let rows = rows(&fleet, soc, soc_lo);
        let trip = there_and_back(&rows.robot(&fleet), away_m);
        let answer = trip.answer;
        let asked = format!("{soc} {soc_lo}, {away_m} m: {answer:?} {:?}", trip.turn_back_s);
        assert_eq!(answer.verdict, verdict, "{asked}");
        assert!(probability.contains(&answer.probability.expect("known")), "{asked}");
        assert_eq!(answer.caveats.steps_outside_training, 0, "{asked}");
        // Nobody has to turn back from what is a yes.
        assert!(verdict != Verdict::Yes || trip.turn_back_s.is_none(), "{asked}");
        if away_m == 1.0 {
            let energy = answer.energy.expect("known");
            assert!((40.0..60.0).contains(&energy.mean_j), "{asked}");
            assert!(energy.hi_j - energy.lo_j < 0.25 * energy.mean_j, "{asked}");
        }
    }
    // Unknown: nobody reports it, or somebody reports something else.
    let mut unknown = rows(&fleet, 0.5, 0.4);
    unknown.has_budget = false;
    let verdict = |rows: &Rows| there_and_back(&rows.robot(&fleet), 1.0).answer.verdict;
    assert_eq!(verdict(&unknown), Verdict::Unknown(Unknown::NoBudget));
    let mut contradicted = rows(&fleet, 0.5, 0.4);
    contradicted.budget.flags |= budget_flag::CONTRADICTED;
    assert_eq!(verdict(&contradicted), Verdict::Unknown(Unknown::BatteryUnknown));
}
