//! The judgement of whole recordings: none of the real ones is implausible, and what is planted in
//! them is found.

use std::path::{Path, PathBuf};

use joulebus_dataset::inspect::{Limits, check_files, judge, judge_from, judge_together};
use joulebus_dataset::trial::{Column, ColumnMap, MappedColumn, Trial};
use joulebus_plausibility::{Card, Kind, Origin, Severity};
use joulebus_testkit::assert_page_contains;
use joulebus_testkit::recordings::trials;
use joulebus_testkit::trials::{Files, npy_f8};

const PLATFORMS: [&str; 3] = ["robotino", "borealtc_husky", "ase_rover"];

fn mapped(text: &str) -> ColumnMap {
    let column: MappedColumn = text.parse().unwrap();
    vec![column].into()
}

/// Kinds of the errors in a recording that is read so.
fn errors(path: &Path, map: &ColumnMap) -> Vec<Kind> {
    let trials = Trial::read_mapped(path, map).unwrap();
    let found = trials.iter().flat_map(|trial| judge(trial, &Limits::default()));
    let errors = found.filter(|one| one.finding.severity == Severity::Error);
    errors.map(|one| one.finding.kind).collect()
}

#[test]
fn no_real_recording_is_implausible() {
    for platform in PLATFORMS {
        let Some(paths) = trials(platform) else {
            return;
        };
        for path in paths {
            let trial = Trial::read(&path).unwrap();
            let found = judge(&trial, &Limits::default());
            assert!(found.is_empty(), "{}: {found:#?}", path.display());
        }
    }
}

/// The thresholds were chosen on simulated recordings; these are real ones.
#[test]
fn what_is_planted_in_real_recordings_is_found() {
    // The rover has neither voltage nor current: 12 W or 12 kW.
    let columns = [
        ("power_mW=-power_mW", Kind::Sign, [1.0; 3]),
        ("power_W=power_mW", Kind::Unit, [1.0, 1.0, 0.0]),
        ("power_kW=power_mW", Kind::Unit, [1.0; 3]),
    ];
    let columns = columns.map(|(what, kind, least)| (what, mapped(what), kind, least));
    let turned = ColumnMap::default().discharge_negative(true);
    let turned = ("the other sign", turned, Kind::Sign, [1.0; 3]);
    for (what, map, kind, least) in columns.into_iter().chain([turned]) {
        for (platform, least) in PLATFORMS.into_iter().zip(least) {
            let Some(paths) = trials(platform) else {
                return;
            };
            let is_found = |path: &&PathBuf| {
                let errors = errors(path, &map);
                !errors.is_empty() && errors.iter().all(|error| *error == kind)
            };
            let found = paths.iter().filter(is_found);
            let (found, all) = (found.count(), paths.len());
            println!("{what}, {platform}: {found} of {all}");
            assert!(found as f64 >= least * all as f64, "{what}, {platform}: {found} of {all}");
        }
    }
}

/// A robot of 24 V that discharges with a negative current.
fn discharging(rows: usize) -> Vec<[f64; 11]> {
    let row = |row: usize| {
        let step = row as f64;
        let current_ma = -2_000.0 - 200.0 * (0.7 * step).sin();
        let voltage_mv = 24_000.0 + 10.0 * (1.3 * step).cos();
        let power_mw = voltage_mv * current_ma / 1e3;
        let nan = f64::NAN;
        [1.0, step / 30.0, nan, 0.2, 0.0, nan, nan, nan, voltage_mv, current_ma, power_mw]
    };
    (0..rows).map(row).collect()
}

/// The sign of an array, which has no names to map.
#[test]
fn the_sign_of_the_current_is_found_and_turned_in_every_format() {
    let files = Files::new();
    let npy = files.write("a.npy", &npy_f8(&discharging(300)));
    let mut text = "timestamp,voltage_V,current_A,v_cmd\n".to_owned();
    for row in discharging(300) {
        text += &format!("{},{},{},{}\n", row[1], row[8] / 1e3, row[9] / 1e3, row[3]);
    }
    let csv = files.write("a.csv", text.as_bytes());
    for path in [npy, csv] {
        assert_eq!(errors(&path, &ColumnMap::default()), [Kind::Sign], "{}", path.display());
        let turned = ColumnMap::default().discharge_negative(true);
        assert_eq!(errors(&path, &turned), [], "{}", path.display());
        let checked = |accepted: &[Kind]| {
            let paths: [PathBuf; 1] = [path.clone()];
            let mut check = check_files(&paths, &ColumnMap::default(), &Limits::default(), 3);
            check.accept(accepted);
            check
        };
        assert_eq!((checked(&[]).faults, checked(&[Kind::Unit]).faults), (1, 1));
        let accepted = checked(&[Kind::Sign]);
        assert!(accepted.is_sound() && accepted.findings[0].accepted, "{accepted:?}");
    }
    // By a mapping, with the unit.
    let text = "t,u,i\n".to_owned()
        + &(0..60).map(|row| format!("{row},24.{row},-2.{row}\n")).collect::<String>();
    let path = files.write("b.csv", text.as_bytes());
    let columns = ["voltage_V=u", "current_A=-i"].map(|text| text.parse::<MappedColumn>().unwrap());
    assert_eq!(errors(&path, &columns.to_vec().into()), []);
}

/// `voltage` and `current` in V and A: the published layout has them in mV and mA.
#[test]
fn columns_without_a_unit_are_refused_with_both_readings() {
    let files = Files::new();
    let table = |factor: f64| {
        let mut text = "timestamp,voltage,current,v_cmd\n".to_owned();
        for row in discharging(300) {
            let [voltage, current] = [row[8] * factor, -row[9] * factor];
            text += &format!("{},{voltage},{current},{}\n", row[1], row[3]);
        }
        text
    };
    let path = files.write("si.csv", table(1e-3).as_bytes());
    assert_eq!(errors(&path, &ColumnMap::default()), [Kind::Unit, Kind::Unit]);
    let trial = Trial::read(&path).unwrap();
    let found = judge(&trial, &Limits::default());
    let printed: Vec<String> = found.iter().map(|one| one.place.to_string()).collect();
    for (printed, words) in printed.iter().zip([
        ["0.024 V", "24", "--map voltage_V=voltage"],
        ["A", "in A", "--map current_A=current"],
    ]) {
        assert!(words.iter().all(|word| printed.contains(word)), "{printed}");
    }
    let columns = ["voltage_V=voltage", "current_A=current"];
    let columns = columns.map(|text| text.parse::<MappedColumn>().unwrap());
    assert_eq!(errors(&path, &columns.to_vec().into()), []);
    // The layout's own.
    let path = files.write("milli.csv", table(1.0).as_bytes());
    assert_eq!(errors(&path, &ColumnMap::default()), []);
}

#[test]
fn the_remedy_of_a_time_in_another_unit_names_its_column() {
    let files = Files::new();
    let mut text = "clock,power_W\n".to_owned();
    for row in 0..100 {
        let row = f64::from(row);
        text += &format!("{:.1},{}\n", 33.3 * row, 4.0 + (0.7 * row).sin());
    }
    let path = files.write("log.csv", text.as_bytes());
    let map = ColumnMap::from(vec!["time=clock".parse().unwrap()]);
    let trial = Trial::read_mapped(&path, &map).unwrap().remove(0);
    let found = judge(&trial, &Limits::default());
    let unit = found.iter().find(|one| one.finding.quantity.is_none());
    let remedy = &unit.unwrap().remedy;
    assert!(remedy.contains("--map time_ms=clock"), "{remedy}");
}

/// Forty runs of 18 rows: none of them is judged by itself where some readings have the other sign.
#[test]
fn short_recordings_of_a_folder_are_judged_as_one() {
    let files = Files::new();
    let paths: Vec<PathBuf> = (0..40)
        .map(|file| {
            let mut rows = discharging(18);
            rows[file % 18][9] *= -1.0;
            rows[file % 18][10] *= -1.0;
            rows.iter_mut().for_each(|row| row[9] *= 1.0 + 1e-3 * file as f64);
            rows.iter_mut().for_each(|row| row[10] *= 1.0 + 1e-3 * file as f64);
            files.write(&format!("{file}.npy"), &npy_f8(&rows))
        })
        .collect();
    let trials: Vec<Trial> = paths.iter().map(|path| Trial::read(path).unwrap()).collect();
    for trial in &trials {
        let found = judge(trial, &Limits::default());
        assert!(found.is_empty(), "{found:?}");
    }
    let found = judge_together(&trials);
    let kinds: Vec<Kind> = found.iter().map(|one| one.finding.kind).collect();
    assert_eq!(kinds, [Kind::Sign], "{found:?}");
    assert!(found[0].place.to_string().contains("40 short recordings as one"), "{found:?}");
    assert!(judge_together(&trials[..1]).is_empty());
    let check = check_files(&paths, &ColumnMap::default(), &Limits::default(), 3);
    assert_eq!(check.faults, 1, "{check:?}");
    // A lone one of which every reading is negative.
    let path = files.write("all.npy", &npy_f8(&discharging(18)));
    assert_eq!(errors(&path, &ColumnMap::default()), [Kind::Sign]);
}

/// Columns in the wrong order.
#[test]
fn power_that_is_not_voltage_times_current_is_an_error() {
    let files = Files::new();
    let mut rows = discharging(300);
    rows.iter_mut().for_each(|row| (row[8], row[9], row[10]) = (-row[10], -row[9], row[8]));
    let path = files.write("order.npy", &npy_f8(&rows));
    assert_eq!(errors(&path, &ColumnMap::default()), [Kind::Mismatch]);
    let mut check = check_files(&[path], &ColumnMap::default(), &Limits::default(), 3);
    assert!(!check.is_sound());
    check.accept(&[Kind::Mismatch]);
    assert!(check.is_sound(), "{check:?}");
}

/// Seconds of driving, and seconds on a dock, where the battery takes 70 W.
fn docked(rows: usize) -> Vec<[f64; 11]> {
    let nan = f64::NAN;
    let row = |row: usize| {
        let (step, is_docked) = (row as f64, row >= rows / 2);
        let v_mps = if is_docked { 0.0 } else { 0.3 };
        let current_ma = if is_docked { -2_900.0 } else { 420.0 } + 20.0 * (0.7 * step).sin();
        let voltage_mv = 24_600.0 - 0.1 * current_ma;
        let power_mw = voltage_mv * current_ma / 1e3;
        [1.0, step / 10.0, nan, v_mps, 0.0, nan, nan, nan, voltage_mv, current_ma, power_mw]
    };
    (0..rows).map(row).collect()
}

#[test]
fn power_on_the_charger_is_no_consumption_in_any_format() {
    let files = Files::new();
    let rows = docked(300);
    let table = |columns: &str, row: &dyn Fn(&[f64; 11], bool) -> String| {
        let lines = rows.iter().enumerate().map(|(at, values)| row(values, at >= 150));
        format!("{columns}\n{}\n", lines.collect::<Vec<_>>().join("\n"))
    };
    let moving =
        |row: &[f64; 11]| format!("{},{},{},{}", row[1], row[8] / 1e3, row[9] / 1e3, row[3]);
    let still = |row: &[f64; 11]| format!("{},{},{}", row[1], row[8] / 1e3, row[9] / 1e3);
    let cases = [
        ("a.npy", npy_f8(&rows)),
        (
            "by_sign.csv",
            table("timestamp,voltage_V,current_A,v_cmd", &|row, _| moving(row)).into_bytes(),
        ),
        (
            "flag.csv",
            table("timestamp,voltage_V,current_A,is_charging", &|row, is_docked| {
                format!("{},{is_docked}", still(row))
            })
            .into_bytes(),
        ),
        (
            "status.csv",
            table(
                "timestamp,voltage_V,current_A,battery/power_supply_status",
                &|row, is_docked| format!("{},{}", still(row), if is_docked { 1 } else { 2 }),
            )
            .into_bytes(),
        ),
        (
            "positive.csv",
            table("timestamp,power_W,charging", &|row, is_docked| {
                format!("{},{},{}", row[1], row[10].abs() / 1e3, u8::from(is_docked))
            })
            .into_bytes(),
        ),
    ];
    for (name, bytes) in cases {
        let path = files.write(name, &bytes);
        let trial = Trial::read(&path).unwrap();
        let power = trial.column(Column::Power).unwrap();
        let known = power.iter().filter(|power_w| power_w.is_finite());
        assert!(known.clone().all(|power_w| (8.0..13.0).contains(power_w)), "{name}: {power:?}");
        assert_eq!(known.count(), 150, "{name}");
        let notes = trial.notes().to_string();
        assert!(notes.contains("150 of 300 readings are on the charger"), "{name}: {notes}");
        assert!(trial.notes().ignored_columns.is_empty(), "{name}: {notes}");
        let check =
            check_files(std::slice::from_ref(&path), &ColumnMap::default(), &Limits::default(), 3);
        assert!(check.is_sound(), "{name}: {check:?}");
        // Written again, it is the same: no missing readings, and no power of the product.
        let written = path.with_extension("again.csv");
        trial.write_csv(&written).unwrap();
        let check = check_files(
            std::slice::from_ref(&written),
            &ColumnMap::default(),
            &Limits::default(),
            3,
        );
        assert!(check.is_sound(), "{name}: {check:?}");
        let again = Trial::read(&written).unwrap();
        assert!(again.notes().charged().unwrap().contains("150 of 300"), "{name}");
        let power = again.column(Column::Power).unwrap();
        assert_eq!(power.iter().filter(|power_w| power_w.is_finite()).count(), 150, "{name}");
        if name != "positive.csv" && name != "flag.csv" && name != "status.csv" {
            let current = trial.column(Column::Current).unwrap();
            assert!(current.iter().all(|current_a| current_a.is_finite()), "{name}");
        }
    }
}

/// A driver that does not measure the current writes a number all the same.
#[test]
fn a_current_that_is_not_measured_stops_and_no_remedy_makes_a_power_of_it() {
    let files = Files::new();
    let table = |header: &str, current: &dyn Fn(usize) -> f64| {
        let row = |row: usize| {
            let volt = 24.6 - 1e-4 * row as f64 + 0.01 * (1.3 * row as f64).sin();
            format!("{},{volt:.4},{}\n", 0.1 * row as f64, current(row))
        };
        header.to_owned() + &(0..300).map(row).collect::<String>()
    };
    let in_amperes = "timestamp_s,voltage_V,current_A\n";
    for (name, current_a, says) in [
        ("minus_one", -1.0, "--map missing:=-1"),
        ("tenth", 0.01, "another monitor"),
        ("plus", 2.5, "another monitor"),
    ] {
        let path =
            files.write(&format!("{name}.csv"), table(in_amperes, &|_| current_a).as_bytes());
        let trial = Trial::read(&path).unwrap();
        let found = judge(&trial, &Limits::default());
        assert_eq!(found.len(), 1, "{name}: {found:?}");
        let finding = &found[0].finding;
        assert_eq!((finding.kind, finding.is_error()), (Kind::Constant, true), "{name}");
        let remedy = &found[0].remedy;
        assert!(remedy.contains(says), "{name}: {remedy}");
        assert!(!remedy.contains("--current") && !remedy.contains("--accept"), "{name}: {remedy}");
    }
    // Its own remedy leaves nothing that could be taken for a power.
    let path = files.write("again.csv", table(in_amperes, &|_| -1.0).as_bytes());
    let missing = vec!["missing:=-1".parse::<MappedColumn>().unwrap()].into();
    for trial in Trial::read_mapped(&path, &missing).unwrap() {
        assert_eq!((trial.column(Column::Power), trial.column(Column::Current)), (None, None));
    }
    let measured = files
        .write("measured.csv", table(in_amperes, &|row| 0.3 + 0.1 * (row % 3) as f64).as_bytes());
    assert_eq!(errors(&measured, &ColumnMap::default()), []);
}

/// What a bag's messages say of the charger stays said, and a row without a reading counts once.
#[test]
fn rows_of_a_bag_on_the_charger_are_no_faults_and_others_count_once() {
    let files = Files::new();
    let known = |row: usize, current_a: f64, power_w: f64| joulebus_dataset::trial::Row {
        timestamp_s: 0.1 * row as f64,
        values: std::array::from_fn(|at| match at {
            6 => 24.0 - 0.01 * (row % 7) as f64,
            7 => current_a,
            8 => power_w,
            1 | 2 => 0.1 * (row % 5) as f64,
            _ => f64::NAN,
        }),
    };
    let drives = |row: usize| {
        let current_a = 0.4 + 0.1 * (1.3 * row as f64).sin();
        known(row, current_a, (24.0 - 0.01 * (row % 7) as f64) * current_a)
    };
    let charged: Vec<usize> = (150..300).collect();
    for (name, current_a, on_charger, faults) in [
        ("in", -2.9, &charged[..], 0),
        ("out", 2.9, &charged[..], 0),
        ("unmeasured", f64::NAN, &[][..], 150),
    ] {
        let rows = (0..300).map(|row| match row {
            150.. => known(row, current_a + 0.01 * (row % 3) as f64, f64::NAN),
            _ => drives(row),
        });
        let path = files.write(&format!("{name}.bag"), b"");
        let trial = Trial::from_bag(&path, "r", rows, on_charger, true).unwrap();
        let written = path.with_extension("csv");
        trial.write_csv(&written).unwrap();
        let (map, limits) = (ColumnMap::default(), Limits::default());
        let check = check_files(std::slice::from_ref(&written), &map, &limits, 3);
        assert_eq!(check.faults, faults, "{name}: {check:?}");
        let flags = trial.to_samples(7, 1).into_iter();
        let flags = flags.filter(|one| one.has(joulebus_wire::sample_flag::CHARGING));
        assert_eq!(flags.count(), on_charger.len(), "{name}");
    }
}

/// The rows of a bag are tried, whose power is voltage times current.
#[test]
fn remedies_of_a_bag_are_those_of_its_mapping_that_work() {
    let files = Files::new();
    for (volt, ampere, is_turned, words, never) in [
        (1e3, 1.0, true, &["voltage_unit_v = 0.001 in a mapping file"][..], "current_unit_a"),
        (1e3, 1e3, true, &["voltage_unit_v = 0.001", "current_unit_a = 0.001"], "--current"),
        (1.0, -1.0, true, &["--current discharge-positive"], "unit"),
        (1.0, -1.0, false, &["--current discharge-negative"], "unit"),
    ] {
        let rows = (0..300).map(|row| {
            let load_a = 2.0 + 0.2 * (0.7 * f64::from(row)).sin();
            let (voltage_v, current_a) = (volt * (24.0 - 0.1 * load_a), ampere * load_a);
            let values = std::array::from_fn(|at| match at {
                1 => 0.2,
                6 => voltage_v,
                7 => current_a,
                8 => voltage_v * current_a,
                _ => f64::NAN,
            });
            joulebus_dataset::trial::Row { timestamp_s: 0.1 * f64::from(row), values }
        });
        let path = files.write("bag.mcap", b"");
        let trial = Trial::from_bag(&path, "r", rows, &[], is_turned).unwrap();
        let found = judge_from(Origin::Bag, &trial, &Limits::default());
        let told: String = found.iter().map(|one| one.remedy.as_str()).collect();
        for word in words {
            assert!(told.contains(word), "{volt} {ampere}: {told}");
        }
        assert!(!told.contains(never), "{volt} {ampere}: {told}");
    }
}

/// Each finding has a card, and the page has all of them. `JOULEBUS_WRITE=1` writes it.
#[test]
fn the_page_of_findings_has_the_cards() {
    let mut kinds = "| kind | what it means | what to check |\n|---|---|---|\n".to_owned();
    let mut cases = "| kind | level | what was found |\n|---|---|---|\n".to_owned();
    for card in Card::all() {
        kinds += &format!("| `{}` | {} | {} |\n", card.name, card.means, card.check);
        for (severity, what) in card.cases {
            cases += &format!("| `{}` | {} | {what} |\n", card.name, severity.name());
        }
    }
    assert_page_contains("docs/reference/plausibility.md", &[kinds, cases]);
}
