//! Recordings over a grid of robots, rates, lengths, gaps and idle shares: sound ones have no
//! finding, planted faults have theirs and no other.

use joulebus_plausibility::{Finding, Kind, Known, Observation, Quantity, Severity};

use super::robot::{Numbers, Recording, current_above, judged};

/// The grid: 3 robots × 4 rates × 3 lengths × 3 gaps × 4 idle shares.
fn grid() -> impl Iterator<Item = Recording> {
    let robots = [(3.6, 4.0), (20.0, 24.0), (300.0, 48.0)];
    let mut all = Vec::new();
    for (idle_w, voltage_v) in robots {
        for rate_hz in [1.0, 6.5, 30.0, 100.0] {
            for rows in [150, 600, 2_000] {
                for gaps in [0.0, 0.05, 0.3] {
                    for idle in [0.0, 0.3, 0.7, 0.9] {
                        let seed = all.len() as u64 + 1;
                        all.push(Recording {
                            idle_w,
                            voltage_v,
                            rate_hz,
                            rows,
                            gaps,
                            idle,
                            seed,
                            ..Recording::USUAL
                        });
                    }
                }
            }
        }
    }
    all.into_iter()
}

/// Those of three seconds or more: less may be all braking.
fn long() -> impl Iterator<Item = Recording> {
    grid().filter(|one| one.rows as f64 / one.rate_hz >= 3.5)
}

fn kinds(found: &[Finding]) -> Vec<(Kind, Option<Quantity>)> {
    found.iter().map(|finding| (finding.kind, finding.quantity)).collect()
}

fn each(mut rows: Vec<Observation>, change: impl Fn(&mut Observation)) -> Vec<Observation> {
    rows.iter_mut().for_each(change);
    rows
}

/// Share of a grid's recordings that `is_found` holds for.
fn share(
    of: impl Iterator<Item = Recording>,
    is_found: impl Fn(&Recording) -> bool,
) -> (usize, usize) {
    of.fold((0, 0), |(found, all), one| (found + usize::from(is_found(&one)), all + 1))
}

/// Robots that drive, feed energy back, charge, and stand still, with and without velocities and
/// battery.
#[test]
fn sound_recordings_have_no_finding() {
    // A short recording may be all braking.
    let changes: [fn(&mut Recording); 7] = [
        |_| (),
        |one| (one.regenerates, one.rows) = (0.4, one.rows.max(10 * one.rate_hz as usize)),
        |one| one.velocities = false,
        |one| one.battery = false,
        |one| (one.charger, one.rows) = (true, one.rows.max(600)),
        |one| (one.charger, one.velocities, one.rows) = (true, false, one.rows.max(600)),
        |one| one.idle = 1.0,
    ];
    for base in grid() {
        for change in changes {
            let mut one = base;
            change(&mut one);
            let found = judged(Known::default(), &one.rows());
            assert!(found.is_empty(), "{one:?}: {found:#?}");
        }
    }
}

#[test]
fn a_turned_sign_is_found() {
    let turned = |one: &Recording| {
        each(one.rows(), |seen| {
            (seen.power_w, seen.current_a) = (-seen.power_w, -seen.current_a);
        })
    };
    let is_error = |one: &Recording| {
        let found = judged(Known::default(), &turned(one));
        let others = found.iter().filter(|finding| finding.kind != Kind::Sign);
        assert_eq!(others.count(), 0, "{one:?}: {found:?}");
        found.iter().any(|finding| finding.severity == Severity::Error)
    };
    for (what, change, least) in [
        ("plain", (|_| ()) as fn(&mut Recording), 1.0),
        ("no velocities", |one| one.velocities = false, 1.0),
        ("power alone", |one| (one.velocities, one.battery) = (false, false), 1.0),
        // Nothing shows that a robot that hardly moves is on a charger: a warning.
        ("no battery", |one| one.battery = false, 0.93),
        // While it feeds back a part of the time.
        ("regenerating", |one| one.regenerates = 0.05, 0.9),
    ] {
        let changed = long().map(|mut one| {
            change(&mut one);
            one
        });
        let (found, all) = share(changed, is_error);
        println!("sign, {what}: {found} of {all}");
        let least = least * all as f64;
        assert!(found as f64 >= least, "{what}: {found} of {all}");
    }
}

#[test]
fn a_current_with_the_other_sign_than_power_is_found() {
    let (found, all) = share(grid(), |one| {
        let rows = each(one.rows(), |seen| seen.current_a = -seen.current_a);
        kinds(&judged(Known::default(), &rows)) == [(Kind::Sign, Some(Quantity::Current))]
    });
    assert_eq!(found, all);
}

#[test]
fn a_factor_of_a_thousand_is_found() {
    type Change = fn(&mut Observation);
    let cases: [(&str, Change, bool); 8] = [
        ("V read as mV", |seen| seen.voltage_v /= 1e3, true),
        ("mV read as V", |seen| seen.voltage_v *= 1e3, true),
        ("A read as mA", |seen| seen.current_a /= 1e3, true),
        ("mA read as A", |seen| seen.current_a *= 1e3, true),
        ("W read as mW", |seen| seen.power_w /= 1e3, true),
        ("mW read as W", |seen| seen.power_w *= 1e3, true),
        // Power made of both.
        (
            "V and A read as mV and mA",
            |seen| {
                (seen.voltage_v, seen.current_a) = (seen.voltage_v / 1e3, seen.current_a / 1e3);
                seen.power_w = seen.voltage_v * seen.current_a;
            },
            true,
        ),
        ("percentages", |seen| seen.soc *= 100.0, true),
    ];
    for (what, change, expected) in cases {
        let (found, all) = share(grid(), |one| {
            let found = judged(Known::default(), &each(one.rows(), change));
            let is_unit =
                found.iter().any(|finding| finding.kind == Kind::Unit && finding.is_error());
            let others = found.iter().filter(|finding| finding.kind != Kind::Unit);
            assert_eq!(others.count(), 0, "{what}, {one:?}: {found:?}");
            is_unit
        });
        println!("unit, {what}: {found} of {all}");
        assert!(!expected || found == all, "{what}: {found} of {all}");
    }
}

/// Columns called `voltage` and `current`.
#[test]
fn columns_without_a_unit_are_read_if_only_one_unit_fits() {
    let known = Known::default().unstated(Quantity::Voltage).unstated(Quantity::Current);
    for one in grid() {
        let found = judged(known, &one.rows());
        assert!(found.is_empty(), "{one:?}: {found:?}");
        let rows = each(one.rows(), |seen| {
            (seen.voltage_v, seen.current_a) = (seen.voltage_v / 1e3, seen.current_a / 1e3);
            seen.power_w = seen.voltage_v * seen.current_a;
        });
        let found = judged(known, &rows);
        let expected = [Quantity::Voltage, Quantity::Current].map(|of| (Kind::Unit, Some(of)));
        assert_eq!(kinds(&found), expected, "{one:?}: {found:?}");
    }
    // A current alone that could be 150 mA or 150 A.
    let known = Known::default().unstated(Quantity::Current);
    let rows: Vec<Observation> = (0..200)
        .map(|row| {
            let mut seen = Observation::at(f64::from(row) / 10.0);
            seen.voltage_v = 24.0;
            seen.current_a = 0.15 + 1e-4 * f64::from(row % 7);
            seen.power_w = seen.voltage_v * seen.current_a;
            seen
        })
        .collect();
    let found = judged(known, &rows);
    assert_eq!(kinds(&found), [(Kind::Unit, Some(Quantity::Current))]);
    assert!(
        found[0].found.contains("mA") && found[0].found.contains("could be either"),
        "{found:?}"
    );
}

#[test]
fn other_units_of_time_and_speed_are_found() {
    for one in grid() {
        let rows = each(one.rows(), |seen| seen.time_s *= 1e6);
        let found = judged(Known::default(), &rows);
        assert!(kinds(&found).contains(&(Kind::Unit, None)), "{one:?}: {found:?}");
        let moving = Recording { idle: 0.0, ..one };
        let rows = each(moving.rows(), |seen| seen.v_mps *= 1e3);
        let found = judged(Known::default(), &rows);
        assert!(kinds(&found).contains(&(Kind::Unit, Some(Quantity::V))), "{one:?}: {found:?}");
        // Degrees of a robot that mostly corrects its course, and turns now and then.
        let mut rows = moving.rows();
        let turns = [34.0, 5.0, -5.0, 5.0, 5.0].into_iter().cycle();
        rows.iter_mut().zip(turns).for_each(|(seen, omega)| seen.omega_radps = omega);
        let found = judged(Known::default(), &rows);
        assert!(kinds(&found).contains(&(Kind::Unit, Some(Quantity::Omega))), "{one:?}: {found:?}");
    }
}

#[test]
fn clocks_that_stand_still_or_go_back_are_found() {
    for one in grid().filter(|one| one.rate_hz > 2.0 && one.rows > 150) {
        let rows = each(one.rows(), |seen| seen.time_s = seen.time_s.floor());
        let found = judged(Known::default(), &rows);
        let clock = found.iter().find(|finding| finding.kind == Kind::Clock);
        assert!(
            clock.is_some_and(
                |finding| finding.is_error() && finding.found.contains("whole seconds")
            ),
            "{one:?}: {found:?}"
        );
        let mut rows = one.rows();
        let half = rows.len() / 2;
        let last_s = rows[half].time_s;
        rows[half..].iter_mut().for_each(|seen| seen.time_s -= 0.9 * last_s);
        let found = judged(Known::default(), &rows);
        assert_eq!(kinds(&found), [(Kind::Clock, None)], "{one:?}: {found:?}");
    }
}

/// A remote control that falls silent, and a base that stops by its timeout.
#[test]
fn a_command_that_never_ends_is_found() {
    for one in grid().filter(|one| one.rows as f64 / one.rate_hz > 30.0 && one.idle < 0.5) {
        let mut rows = one.rows();
        let count = rows.len();
        for seen in &mut rows[count / 2..] {
            (seen.v_mps, seen.v_measured_mps) = (0.5, 0.0);
        }
        let found = judged(Known::default(), &rows);
        assert_eq!(kinds(&found), [(Kind::Hold, Some(Quantity::V))], "{one:?}: {found:?}");
        assert!(!found[0].is_error());
    }
}

#[test]
fn full_registers_and_wraps_are_found() {
    for one in grid() {
        // A monitor whose range ends within what the robot draws.
        let mut rows = one.rows();
        let end_a = current_above(&rows, 0.7);
        let steps = [1.0, 1.25, 2.0, 2.5, 4.0, 5.0, 8.0, 10.0];
        let step_a = end_a / 32_767.0;
        let decade = 10f64.powf(step_a.log10().floor());
        let step_a = steps.iter().map(|step| step * decade).find(|step| *step >= step_a).unwrap();
        let end_a = 32_767.0 * step_a;
        rows.iter_mut().for_each(|seen| seen.current_a = seen.current_a.min(end_a));
        let at_end = rows.iter().filter(|seen| seen.current_a == end_a).count();
        let found = judged(Known::default(), &rows);
        let is_found = kinds(&found).contains(&(Kind::Saturation, Some(Quantity::Current)));
        let in_a_row =
            rows.windows(3).any(|three| three.iter().all(|seen| seen.current_a == end_a));
        assert_eq!(is_found, at_end >= 5 && in_a_row, "{one:?}: {at_end} {found:?}");
    }
    for one in grid().filter(|one| one.rows > 150) {
        // Steps of 1 mA in a robot whose current hardly changes.
        let mut numbers = Numbers::new(one.seed);
        let mut rows: Vec<Observation> = (0..one.rows)
            .map(|row| {
                let mut seen = Observation::at(row as f64 / one.rate_hz);
                seen.voltage_v = 24.0 + 0.01 * numbers.normal();
                seen.current_a = 2.0 + 0.1 * numbers.normal();
                seen
            })
            .collect();
        for row in (20..one.rows).step_by(97) {
            rows[row].current_a -= 65.536;
        }
        rows.iter_mut().for_each(|seen| seen.power_w = 60.0 + (seen.time_s * 7.0).sin());
        let found = judged(Known::default(), &rows);
        assert!(
            kinds(&found).contains(&(Kind::Saturation, Some(Quantity::Current))),
            "{one:?}: {found:?}"
        );
    }
}

#[test]
fn readings_that_never_change_or_never_came_are_found() {
    for one in grid() {
        for (change, expected) in [
            (
                (|seen| seen.power_w = 0.0) as fn(&mut Observation),
                (Kind::Constant, Some(Quantity::Power)),
            ),
            (|seen| seen.current_a = 0.0, (Kind::Constant, Some(Quantity::Current))),
            (|seen| seen.power_w = 12.5, (Kind::Constant, Some(Quantity::Power))),
            (|seen| seen.soc = f64::NAN, (Kind::NeverCame, Some(Quantity::Soc))),
        ] {
            let rows = each(one.rows(), change);
            let found = judged(Known::default().expects(Quantity::Soc), &rows);
            let is_found = kinds(&found).contains(&expected);
            assert!(is_found || rows.len() < 110, "{one:?}: {found:?}");
        }
    }
}

#[test]
fn ranges_are_counted_and_mostly_wrong_ones_stop() {
    let known = Known::default().within(Quantity::Power, 0.0, 10.0);
    for one in grid().filter(|one| one.idle_w == 20.0) {
        let found = judged(known, &one.rows());
        assert_eq!(kinds(&found), [(Kind::Range, Some(Quantity::Power))]);
        assert!(found[0].is_error());
    }
    let wide = Known::default().within(Quantity::Power, 0.0, 60.0);
    let found = judged(wide, &Recording { idle: 0.7, ..Recording::USUAL }.rows());
    assert!(found.iter().all(|finding| !finding.is_error()), "{found:?}");
}

#[test]
fn findings_name_the_option_of_each_source() {
    let rows = each(Recording::USUAL.rows(), |seen| seen.power_w = -seen.power_w);
    let found = judged(Known::default(), &rows);
    use joulebus_plausibility::Origin;
    let remedy = |source| found[0].remedy(source, Some("p"));
    assert!(remedy(Origin::Recording).contains("--current discharge-negative"));
    assert!(remedy(Origin::TurnedRecording).contains("--current discharge-positive"));
    assert!(remedy(Origin::Recording).contains("--accept sign"));
    assert!(remedy(Origin::Bridge).contains("negate = true"));
    assert!(!remedy(Origin::Program).contains("--accept"));
}

/// The units that remedies name are those that --map takes.
#[test]
fn a_share_that_was_divided_is_stated_as_a_share() {
    let rows = each(Recording::USUAL.rows(), |seen| seen.soc /= 100.0);
    let found = judged(Known::default(), &rows);
    let soc = found.iter().find(|one| one.quantity == Some(Quantity::Soc));
    let source = joulebus_plausibility::Origin::Recording;
    let remedy = soc.unwrap().remedy(source, Some("charge"));
    assert!(remedy.contains("--map soc_share=charge"), "{remedy}");
}
