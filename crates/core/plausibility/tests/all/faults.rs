//! Faults of registers, of missing readings and of parts of a recording, planted in simulated
//! recordings; those of the grid have none of them.

use joulebus_plausibility::{Finding, Judge, Kind, Known, Observation, Origin, Quantity, Severity};

use super::robot::{Numbers, Recording, current_above, judged};

/// Robots of three sizes, at three rates.
fn robots() -> impl Iterator<Item = Recording> {
    let sizes = [(3.6, 4.0), (20.0, 24.0), (300.0, 48.0)];
    let rates = [1.0, 10.0, 50.0];
    let all =
        sizes.into_iter().flat_map(move |size| rates.into_iter().map(move |rate| (size, rate)));
    all.zip(1..).map(|(((idle_w, voltage_v), rate_hz), seed)| Recording {
        idle_w,
        voltage_v,
        rate_hz,
        rows: 1_200,
        seed,
        ..Recording::USUAL
    })
}

fn is_found(found: &[Finding], kind: Kind, quantity: Quantity) -> bool {
    found.iter().any(|one| one.kind == kind && one.quantity == Some(quantity))
}

/// Power of voltage and current, to the digits of a file.
fn rounded(mut rows: Vec<Observation>) -> Vec<Observation> {
    for seen in &mut rows {
        seen.current_a = (seen.current_a * 1e4).round() / 1e4;
        seen.voltage_v = (seen.voltage_v * 1e3).round() / 1e3;
        seen.power_w = seen.voltage_v * seen.current_a;
    }
    rows
}

/// The usual step of which `value` is fewer than `counts`, but nearly as many.
fn step_of(value: f64, counts: f64) -> f64 {
    let decade = 10f64.powf((value / counts).log10().floor());
    let steps = [1.0, 1.25, 2.0, 2.5, 4.0, 5.0, 8.0, 10.0].map(|step| step * decade);
    steps.into_iter().rfind(|step| step * counts <= value).unwrap_or(decade)
}

/// Registers that end within what the robot draws, and wrap there in many rows or in few.
#[test]
fn registers_that_wrap_are_found_however_often() {
    for one in robots() {
        for share in [0.98, 0.7, 0.3] {
            for (bits, signed) in [(16, true), (16, false), (15, false), (12, false)] {
                let mut rows = rounded(one.rows());
                let end_a = current_above(&rows, share);
                let counts = f64::from(bits).exp2();
                let above = if signed { 0.5 * counts } else { counts };
                let step_a = step_of(end_a, above);
                for seen in &mut rows {
                    let counted = (seen.current_a / step_a).round();
                    let counted = match signed {
                        true => (counted + above).rem_euclid(counts) - above,
                        false => counted.rem_euclid(counts),
                    };
                    seen.current_a = counted * step_a;
                }
                let least_a = if signed { -above * step_a } else { 0.0 };
                // Where neighbours pass the end often enough to be seen.
                let near = |value: f64, end: f64| (value - end).abs() <= 2e-3 * counts * step_a;
                let passes = rows.windows(2).filter(|pair| {
                    let step_a = (pair[0].current_a - pair[1].current_a).abs();
                    step_a >= 0.92 * counts * step_a.signum() * step_of(end_a, above)
                });
                let fills = [least_a, least_a + counts * step_a]
                    .iter()
                    .all(|end| rows.iter().any(|seen| near(seen.current_a, *end)));
                let must = passes.count() >= 3 && fills;
                let found = judged(Known::default(), &rows);
                let found = found.iter().find(|one| one.kind == Kind::Saturation);
                assert!(
                    !must || found.is_some_and(Finding::is_error),
                    "{one:?} {share} {bits} {signed}: {found:?}"
                );
            }
        }
    }
}

/// A monitor that ends anywhere, and one that is coarse or slow and does not.
#[test]
fn readings_that_stay_at_the_greatest_are_found() {
    for one in robots() {
        for share in [0.7, 0.85] {
            let mut rows = rounded(one.rows());
            let end_a = current_above(&rows, share) * 1.003;
            rows.iter_mut().for_each(|seen| seen.current_a = seen.current_a.min(end_a));
            rows.iter_mut().for_each(|seen| seen.power_w = seen.voltage_v * seen.current_a);
            let in_a_row =
                rows.windows(5).any(|all| all.iter().all(|seen| seen.current_a == end_a));
            let found = judged(Known::default(), &rows);
            // A robot that drives at any speed passes the end again and again.
            let at_end = |seen: &Observation| seen.current_a == end_a;
            let begins = rows.windows(2).filter(|two| !at_end(&two[0]) && at_end(&two[1]));
            let must = in_a_row && one.rate_hz >= 10.0 && begins.count() >= 3;
            assert!(
                !must || is_found(&found, Kind::Saturation, Quantity::Current),
                "{one:?} {share}: {found:?}"
            );
        }
        let step_w = one.idle_w / 3.0;
        let mut coarse = one.rows();
        coarse.iter_mut().for_each(|seen| seen.power_w = (seen.power_w / step_w).round() * step_w);
        let mut slow = one.rows();
        for at in 0..slow.len() {
            let read = slow[at - at % 10];
            (slow[at].power_w, slow[at].voltage_v) = (read.power_w, read.voltage_v);
            slow[at].current_a = read.current_a;
        }
        // A simulation: constant power at each speed.
        let mut exact = one.rows();
        let power = |v_mps: f64| one.idle_w * (1.0 + 3.0 * (v_mps * 4.0).round() / 4.0);
        exact.iter_mut().for_each(|seen| seen.power_w = power(seen.v_mps));
        for (what, mut rows) in [("coarse", coarse), ("slow", slow), ("exact", exact)] {
            rows.iter_mut().for_each(|seen| seen.current_a = seen.power_w / seen.voltage_v);
            let found = judged(Known::default(), &rows);
            assert!(found.is_empty(), "{what} {one:?}: {found:?}");
        }
    }
}

#[test]
fn numbers_that_stand_for_no_reading_are_found() {
    for one in robots() {
        for number in [-1.0, -999.0, -9_999.0, 65_535.0, 1e30] {
            for every in [7, 100] {
                let mut rows = one.rows();
                for at in (every..rows.len()).step_by(every) {
                    rows[at].power_w = number;
                    (rows[at].voltage_v, rows[at].current_a) = (f64::NAN, f64::NAN);
                }
                let found = judged(Known::default(), &rows);
                let sentinel = found.iter().find(|one| one.kind == Kind::Sentinel);
                let sentinel = sentinel.unwrap_or_else(|| panic!("{number} {one:?}: {found:?}"));
                let remedy = sentinel.remedy(Origin::Recording, None);
                assert!(
                    sentinel.is_error() && remedy.contains(&format!("missing:={number}")),
                    "{remedy}"
                );
            }
        }
        // 0 V and 0 A for a reading that failed.
        let mut rows = one.rows();
        for at in (3..rows.len()).step_by(7) {
            (rows[at].voltage_v, rows[at].current_a, rows[at].power_w) = (0.0, 0.0, 0.0);
        }
        let found = judged(Known::default(), &rows);
        assert!(is_found(&found, Kind::Sentinel, Quantity::Voltage), "{one:?}: {found:?}");
    }
}

/// A last one may be the first of a robot that starts to drive.
#[test]
fn a_single_power_far_from_all_others_is_told_unless_it_is_the_last() {
    for one in robots() {
        let mut rows = one.rows();
        let most_w = rows.iter().map(|row| row.power_w).fold(0.0, f64::max);
        let (at, last) = (rows.len() / 2, rows.len() / 2 + 1);
        (rows[at].power_w, rows[at].current_a) = (25.0 * most_w, f64::NAN);
        let of = |rows: &[Observation]| {
            let found = judged(Known::default(), rows);
            let is_one = |found: &&Finding| found.kind == Kind::Sentinel;
            found.iter().find(is_one).map(|found| (found.severity, found.quantity, found.readings))
        };
        let told = (Severity::Warning, Some(Quantity::Power), 1);
        assert_eq!(of(&rows), Some(told), "{one:?}");
        assert_eq!(of(&rows[..last]), None, "{one:?}");
    }
}

/// A sign option hides no number for a missing value, and no remedy makes a reading of it.
#[test]
fn numbers_that_stand_for_no_reading_are_judged_as_recorded() {
    for one in robots() {
        for (number, turned, discharge) in [
            (-1.0, false, 1.0),
            (-1.0, false, -1.0),
            (-1.0, true, 1.0),
            (-1.0, true, -1.0),
            (-999.0, true, -1.0),
            (-999.0, true, 1.0),
        ] {
            let mut rows = one.rows();
            let sign = if turned { -1.0 } else { 1.0 };
            for (at, seen) in rows.iter_mut().enumerate() {
                let recorded_a = if at % 3 == 0 { number } else { discharge * seen.current_a };
                seen.current_a = sign * recorded_a;
                seen.power_w = seen.voltage_v * seen.current_a;
            }
            let found = judged(Known::default().whole().turned(turned), &rows);
            let of = (Kind::Sentinel, Some(Quantity::Current));
            let sentinel = found.iter().find(|one| (one.kind, one.quantity) == of);
            let case = format!("{number} {turned} {discharge} {one:?}");
            let sentinel = sentinel.unwrap_or_else(|| panic!("{case}: {found:?}"));
            let source = if turned { Origin::TurnedRecording } else { Origin::Recording };
            let remedy = sentinel.remedy(source, Some("current_A"));
            assert!(sentinel.is_error(), "{case}: {sentinel:?}");
            assert!(remedy.contains(&format!("missing:={number}")), "{case}: {remedy}");
            assert!(number != -1.0 || !remedy.contains("--accept"), "{case}: {remedy}");
        }
    }
}

/// While readings come, the first ones of a current that nobody measures have no other finding.
#[test]
fn a_current_that_is_no_measurement_has_no_sign_and_no_unit() {
    for one in robots() {
        for current_a in [-1.0, 0.01, -0.01, 1.0, -2.5, 1e3] {
            let mut judge = Judge::new(Known::default());
            for (at, seen) in one.rows().iter().enumerate() {
                let voltage_v = seen.voltage_v + 1e-3 * (at % 7) as f64;
                let power_w = voltage_v * current_a;
                judge.take(&Observation { voltage_v, current_a, power_w, ..*seen });
                if at % 32 == 0 {
                    let found = judge.findings();
                    let mut others = found.iter().filter(|found| {
                        (found.kind, found.quantity) != (Kind::Constant, Some(Quantity::Current))
                    });
                    assert_eq!(others.next(), None, "{current_a} A, {at}: {one:?}");
                }
            }
            let found = judge.findings();
            assert!(is_found(&found, Kind::Constant, Quantity::Current), "{current_a}: {one:?}");
        }
    }
}

#[test]
fn a_unit_or_a_sign_that_changes_is_found() {
    for one in robots() {
        for half in [true, false] {
            let mut rows = one.rows();
            let middle = rows.len() / 2;
            let part = if half { &mut rows[middle..] } else { &mut rows[..middle] };
            for seen in part {
                seen.power_w *= 1e3;
                (seen.voltage_v, seen.current_a) = (f64::NAN, f64::NAN);
            }
            let found = judged(Known::default(), &rows);
            assert!(is_found(&found, Kind::Unit, Quantity::Power), "{one:?}: {found:?}");
            let mut rows = one.rows();
            let part = if half { &mut rows[middle..] } else { &mut rows[..middle] };
            for seen in part {
                (seen.power_w, seen.current_a) = (-seen.power_w, -seen.current_a);
            }
            let found = judged(Known::default(), &rows);
            assert!(is_found(&found, Kind::Sign, Quantity::Power), "{one:?}: {found:?}");
        }
    }
}

#[test]
fn power_that_is_not_voltage_times_current_is_found() {
    for one in robots() {
        for factor in [0.5, 1.3, 2.0, 12.0] {
            let mut rows = one.rows();
            rows.iter_mut().for_each(|seen| seen.power_w *= factor);
            let found = judged(Known::default(), &rows);
            let [found] = found.as_slice() else {
                panic!("{one:?} {factor}: {found:?}");
            };
            assert!(found.kind == Kind::Mismatch && found.is_error(), "{found:?}");
        }
    }
}

/// A few rows are judged where nothing more will come, and several short recordings as one.
#[test]
fn short_recordings_are_judged() {
    let whole = Known::default().whole();
    for one in robots() {
        for rows in [4, 18] {
            let sound = Recording { rows, idle: 0.0, ..one }.rows();
            let found = judged(whole, &sound);
            assert!(found.is_empty(), "{one:?}: {found:?}");
            let mut turned = sound.clone();
            turned.iter_mut().for_each(|seen| {
                (seen.power_w, seen.current_a) = (-seen.power_w, -seen.current_a);
            });
            let found = judged(whole, &turned);
            assert!(found.iter().any(|one| one.kind == Kind::Sign && one.is_error()), "{found:?}");
            // More may come.
            assert!(judged(Known::default(), &turned).is_empty());
            let mut milli = sound;
            milli.iter_mut().for_each(|seen| {
                (seen.voltage_v, seen.current_a) = (seen.voltage_v / 1e3, seen.current_a / 1e3);
                seen.power_w = seen.voltage_v * seen.current_a;
            });
            let unstated = whole.unstated(Quantity::Voltage).unstated(Quantity::Current);
            assert!(is_found(&judged(unstated, &milli), Kind::Unit, Quantity::Voltage), "{one:?}");
        }
        // None of them is wholly negative.
        let mut judge = Judge::new(whole);
        let mut numbers = Numbers::new(one.seed);
        for seed in 0..40 {
            judge.begin();
            let mut rows = Recording { rows: 18, idle: 0.2, seed, ..one }.rows();
            let wrong = (numbers.uniform() * 18.0) as usize;
            for (at, seen) in rows.iter_mut().enumerate() {
                let sign = if at == wrong { 1.0 } else { -1.0 };
                (seen.power_w, seen.current_a) = (sign * seen.power_w, sign * seen.current_a);
                judge.take(seen);
            }
        }
        let found = judge.findings();
        assert!(is_found(&found, Kind::Sign, Quantity::Power), "{one:?}: {found:?}");
    }
}

/// Voltage and current of a robot of 12 V in other units than they are read in.
#[test]
fn each_reading_of_a_unit_is_named() {
    use joulebus_plausibility::Origin;
    let both = Known::default().whole().unstated(Quantity::Voltage).unstated(Quantity::Current);
    let stated = Known::default().whole();
    // Scales of voltage and current, what is known, the current in A, and the remedies for a table.
    let cases: [(f64, f64, Known, f64, &[&str]); 15] = [
        // Read in mV and mA, as they are.
        (1.0, 1.0, both, 0.85, &[]),
        (1.0, 1.0, both, 4.2, &[]),
        // V and A.
        (1e-3, 1e-3, both, 0.85, &["--map voltage_V=x", "--map current_A=x"]),
        (1e-3, 1e-3, both, 20.3, &["--map voltage_V=x", "--map current_A=x"]),
        // mV and A, V and mA, mV and µA.
        (1.0, 1e-3, both, 0.85, &["--map current_A=x"]),
        (1.0, 1e-3, both, 20.3, &["--map current_mA=x or --map current_A=x"]),
        (1e-3, 1.0, both, 0.85, &["--map voltage_V=x"]),
        (1e-3, 1.0, both, 0.25, &["--map voltage_V=x", "--map current_mA=x or --map current_A=x"]),
        (1.0, 1e3, both, 0.25, &["--map current_mA=x or --map current_uA=x"]),
        // A vehicle.
        (4.0, 1e-3, both, 131.4, &["--map current_mA=x or --map current_A=x"]),
        // Units that are stated, and wrong.
        (1e3, 1.0, stated, 0.85, &["--map voltage_mV=x"]),
        (1.0, 1e6, stated, 0.85, &["--map current_uA=x"]),
        (1.0, 1e-3, stated, 0.85, &["--map current_A=x"]),
        // A robot may have this size, so the voltage decides.
        (1.0, 1e-3, stated, 20.0, &["--map current_A=x"]),
        (1.0, 1e3, stated, 0.25, &["--map current_mA=x"]),
    ];
    for (voltage, current, known, ampere, expected) in cases {
        let rows = (0..200).map(|row| {
            let load_a = ampere * (1.0 + 0.1137 * (0.7 * f64::from(row)).sin());
            let mut seen = Observation::at(f64::from(row) / 10.0);
            (seen.voltage_v, seen.current_a) = ((12.0 - 0.01 * load_a) * voltage, load_a * current);
            seen.power_w = seen.voltage_v * seen.current_a;
            seen
        });
        let found = judged(known, &rows.collect::<Vec<_>>());
        let units = found.iter().filter(|one| one.kind == Kind::Unit);
        let remedies: Vec<String> =
            units.map(|one| one.remedy(Origin::Recording, Some("x"))).collect();
        let is_complete = remedies.len() == expected.len()
            && remedies.iter().zip(expected).all(|(remedies, part)| remedies.contains(part));
        let case = (voltage, current, ampere);
        assert!(is_complete, "{case:?}: {remedies:?}, and not {expected:?}: {found:?}");
    }
}

/// Rows of two units in turn.
#[test]
fn two_units_in_one_column_are_found_however_often_they_change() {
    for every in [2, 3, 7, 100] {
        for quantity in [Quantity::Voltage, Quantity::Current, Quantity::Power] {
            let mut rows = Recording { idle: 0.0, ..Recording::USUAL }.rows();
            for seen in rows.iter_mut().step_by(every) {
                match quantity {
                    Quantity::Voltage => seen.voltage_v *= 1e3,
                    Quantity::Current => seen.current_a *= 1e3,
                    _ => seen.power_w *= 1e3,
                }
            }
            let found = judged(Known::default(), &rows);
            let is_of_unit = |one: &&Finding| one.kind == Kind::Unit && one.is_error();
            assert!(
                found.iter().any(|one| is_of_unit(&one)) || every == 100,
                "{quantity:?}: {found:?}"
            );
        }
    }
}

#[test]
fn a_monitor_that_does_not_answer_now_and_then_is_found() {
    for one in robots() {
        let mut rows = rounded(one.rows());
        for seen in rows.iter_mut().step_by(11) {
            (seen.power_w, seen.current_a) = (0.0, 0.0);
        }
        let found = judged(Known::default(), &rows);
        assert!(is_found(&found, Kind::Sentinel, Quantity::Power), "{one:?}: {found:?}");
    }
}

/// Changes one reading: its number in the recording, and what would be right.
type Plant = fn(usize, &mut Observation, &mut f64);

/// Voltage and current of another meter.
fn product(seen: &mut Observation) {
    seen.power_w = seen.voltage_v * seen.current_a;
}

/// Kinds of faults that are of one quantity, or of its place among the others, each with the worst
/// finding that it has to have.
#[test]
fn faults_of_each_quantity_are_found() {
    use Quantity::{Current, Power};
    let cases: [(&str, Kind, Quantity, bool, Plant); 11] = [
        ("an energy so far", Kind::Unit, Power, true, |_, seen, sum| {
            *sum += 0.1 * seen.power_w;
            (seen.power_w, seen.voltage_v, seen.current_a) = (*sum, f64::NAN, f64::NAN);
        }),
        ("an energy that begins again", Kind::Unit, Power, true, |at, seen, sum| {
            *sum = if at % 300 == 299 { 0.0 } else { *sum + 0.1 * seen.power_w };
            (seen.power_w, seen.voltage_v, seen.current_a) = (*sum, f64::NAN, f64::NAN);
        }),
        ("a charge so far", Kind::Unit, Current, true, |_, seen, sum| {
            *sum += 0.01 * seen.current_a;
            seen.current_a = *sum;
            product(seen);
        }),
        ("two meters in turn", Kind::Sources, Current, true, |at, seen, _| {
            seen.current_a *= if at % 2 == 0 { 1.0 } else { 0.05 };
            product(seen);
        }),
        ("two meters of power in turn", Kind::Sources, Power, true, |at, seen, _| {
            seen.power_w *= if at % 2 == 0 { 1.0 } else { 0.4 };
            (seen.voltage_v, seen.current_a) = (f64::NAN, f64::NAN);
        }),
        ("every tenth of the other sign", Kind::Sign, Power, true, |at, seen, _| {
            seen.v_mps = if seen.v_mps > 0.0 { 0.5 } else { 0.0 };
            let size = if seen.v_mps > 0.0 { 2.5 } else { 1.0 };
            seen.power_w =
                size * (1.0 + 0.02 * (at as f64).sin()) * if at % 10 == 0 { -20.0 } else { 20.0 };
            (seen.voltage_v, seen.current_a) = (12.0, seen.power_w / 12.0);
            seen.v_measured_mps = seen.v_mps;
        }),
        (
            "the other sign from the middle on, power alone",
            Kind::Sign,
            Power,
            true,
            |at, seen, _| {
                seen.v_mps = if seen.v_mps > 0.0 { 0.5 } else { 0.0 };
                let size = if seen.v_mps > 0.0 { 2.5 } else { 1.0 };
                seen.power_w =
                    size * (1.0 + 0.02 * (at as f64).sin()) * if at > 600 { -20.0 } else { 20.0 };
                (seen.voltage_v, seen.current_a) = (f64::NAN, f64::NAN);
                seen.v_measured_mps = seen.v_mps;
            },
        ),
        ("a register of 20 bits around 0", Kind::Saturation, Current, true, |at, seen, _| {
            let small_a = 0.004 * (0.9 * at as f64).sin() + 0.0005;
            if seen.v_mps == 0.0 {
                seen.current_a = if small_a < -0.003 { 20.0 + small_a } else { small_a.abs() };
            }
            product(seen);
        }),
        ("a dead band", Kind::Sentinel, Power, false, |_, seen, _| {
            if seen.v_mps == 0.0 {
                (seen.power_w, seen.current_a) = (0.0, 0.0);
            }
        }),
        ("another power at rest", Kind::Mismatch, Power, false, |_, seen, _| {
            seen.power_w *= if seen.v_mps == 0.0 { 8.0 } else { 1.0 };
        }),
        ("a charge divided by 100", Kind::Unit, Quantity::Soc, true, |_, seen, _| {
            (seen.soc, seen.v_mps) = (0.0065, 0.3);
            (seen.power_w, seen.current_a) = (f64::NAN, f64::NAN);
        }),
    ];
    for one in robots().filter(|one| one.rate_hz == 10.0) {
        for (what, kind, quantity, is_error, plant) in cases {
            // Its register ends within what the largest draws.
            if what.starts_with("a register") && one.idle_w > 20.0 {
                continue;
            }
            let found = planted(&one, plant);
            let found_one =
                found.iter().find(|one| one.kind == kind && one.quantity == Some(quantity));
            let is_as_bad = found_one.is_some_and(|one| one.is_error() == is_error);
            assert!(is_as_bad, "{what}: {one:?}: {found:?}");
        }
    }
}

/// The findings of a recording with a change of each row.
fn planted(one: &Recording, plant: Plant) -> Vec<Finding> {
    let (mut rows, mut sum) = (one.rows(), 0.0);
    for (at, seen) in rows.iter_mut().enumerate() {
        plant(at, seen, &mut sum);
    }
    judged(Known::default().whole(), &rows)
}

/// What brakes, switches or is coarse has none of these faults.
#[test]
fn loads_that_switch_and_robots_that_feed_back_are_no_faults_of_these_kinds() {
    let cases: [(&str, Plant); 4] = [
        ("a load that switches for half a second", |at, seen, _| {
            seen.current_a *= if at % 10 < 5 { 1.0 } else { 3.0 };
            product(seen);
        }),
        ("a load that switches at random", |at, seen, sum| {
            *sum = (*sum * 69_069.0 + 1.0 + at as f64) % 65_537.0;
            seen.current_a *= if *sum < 32_768.0 { 1.0 } else { 3.0 };
            product(seen);
        }),
        ("energy fed back on half of the way", |at, seen, _| {
            if at % 100 < 30 && seen.v_mps > 0.0 {
                seen.current_a *= -0.4;
                product(seen);
            }
        }),
        ("values that are read every second row", |at, seen, sum| {
            if at % 2 == 0 {
                *sum = seen.current_a;
            }
            seen.current_a = *sum;
            product(seen);
        }),
    ];
    for one in robots().filter(|one| one.rate_hz == 10.0) {
        for (what, plant) in cases {
            let found = planted(&one, plant);
            let is_one = |one: &&Finding| one.kind != Kind::Unit;
            assert_eq!(found.iter().find(is_one), None, "{what}: {one:?}");
        }
    }
}
