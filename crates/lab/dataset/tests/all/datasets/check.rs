//! Faults of a recording are found, counted and reported with file and row; sound recordings have
//! none.

use std::ops::Range;
use std::path::PathBuf;

use joulebus_dataset::inspect::{
    self, Check, FindError, FindingKind, Limits, check_files, check_trial, describe, find, holds,
};
use joulebus_dataset::trial::{ColumnMap, Trial};
use joulebus_testkit::assert_contains;
use joulebus_testkit::recordings::trials;
use joulebus_testkit::trials::{Files, csv, npy_f8};

/// Sound rows at 10 Hz: all columns, every reading new, power the product of voltage and current.
fn sound(rows: usize) -> Vec<[f64; 11]> {
    let row = |row: usize| {
        let step = row as f64;
        let (voltage_mv, current_ma) = (11_000.0 - step, 300.0 + 7.0 * (step * 1.7).sin());
        let power_mw = voltage_mv * current_ma / 1e3;
        let (v, omega) = (0.1 * (step * 0.3).sin(), (step * 0.2).cos());
        let phase = (row / 20) as f64;
        [
            3.0,
            100.0 + step / 10.0,
            phase,
            v,
            omega,
            0.01 * step,
            0.02 * step,
            0.1 * v,
            voltage_mv,
            current_ma,
            power_mw,
        ]
    };
    (0..rows).map(row).collect()
}

fn check(name: &str, bytes: &[u8]) -> Check {
    let files = Files::new();
    check_files(&[files.write(name, bytes)], &ColumnMap::default(), &Limits::default(), 100)
}

fn faults(check: &Check) -> Vec<(FindingKind, usize)> {
    let faults = check.findings.iter().filter(|finding| finding.fault);
    faults.map(|finding| (finding.kind, finding.count)).collect()
}

#[test]
fn a_sound_recording_has_no_fault_in_any_form() {
    for (name, bytes) in [("a.npy", npy_f8(&sound(60))), ("a.csv", csv(&sound(60)).into_bytes())] {
        let found = check(name, &bytes);
        assert!(found.is_sound(), "{name}: {found:?}");
        assert_eq!((found.trials, found.robots, found.rows), (1, 1, 60));
        let notes: Vec<FindingKind> = found.findings.iter().map(|finding| finding.kind).collect();
        assert_eq!(notes, [FindingKind::MissingColumn], "the two that an array has not");
    }
}

#[test]
fn each_fault_is_found_with_its_row_and_nothing_else_is() {
    use FindingKind::{
        Gap, MissingReading, MissingValue, OutOfRange, PowerMismatch, Stuck, TimeBackward,
        TimeRepeated, Unit,
    };
    type Spoil = fn(&mut [f64; 11]);
    const ALL: Range<usize> = 0..260;
    const NAN: f64 = f64::NAN;
    type Fault = (FindingKind, &'static [usize], &'static str, Range<usize>, Spoil);
    let faults: [Fault; 11] = [
        (TimeRepeated, &[31], "s, as row", 30..260, |row| {
            row[1] -= 0.1;
        }),
        (Gap, &[31], "0.500 s", 30..260, |row| row[1] += 0.4),
        (MissingReading, &[10], "power_mW", 9..10, |row| {
            row[10] = NAN;
        }),
        (MissingValue, &[10], "v_cmd_mps", 9..10, |row| row[3] = NAN),
        (OutOfRange, &[10], "12 m/s, allowed", 9..10, |row| {
            row[3] = 12.0;
        }),
        (OutOfRange, &[10], "voltage_mV", 9..10, |row| row[8] *= -1.0),
        (PowerMismatch, &[10], "times current", 9..10, |row| {
            row[10] *= 1.2;
        }),
        (Unit, &[], "mW", ALL, |row| row[10] /= 1e3),
        (Unit, &[], "mV", ALL, |row| row[8] /= 1e3),
        (Unit, &[], "would be 0.3 A", ALL, |row| row[9] /= 1e3),
        (Unit, &[], "seconds?", ALL, |row| row[1] *= 1e3),
    ];
    for (kind, at, words, rows, spoil) in faults {
        let mut table = sound(260);
        table[rows].iter_mut().for_each(spoil);
        assert_only(kind, at, words, &table);
    }
    let mut table = sound(260);
    table[30..].iter_mut().for_each(|row| row[1] -= 0.1);
    table[30][1] -= 0.01;
    assert_only(TimeBackward, &[31], "s before row", &table);
    let mut table = sound(260);
    for row in 100..230 {
        let (first, other) = table.split_at_mut(row);
        other[0][8..].copy_from_slice(&first[99][8..]);
    }
    assert_only(Stuck, &[100], "131 rows", &table);
}

/// The table has this fault at these rows, in words, and no other, in either form.
fn assert_only(kind: FindingKind, rows: &[usize], words: &str, table: &[[f64; 11]]) {
    for (name, bytes, header) in
        [("spoiled.npy", npy_f8(table), 0), ("spoiled.csv", csv(table).into_bytes(), 1)]
    {
        let found = check(name, &bytes);
        let others: Vec<_> = faults(&found).into_iter().filter(|fault| fault.0 != kind).collect();
        assert!(others.is_empty(), "{kind:?}: {others:?}");
        let finding = found.finding(kind);
        let finding = finding.unwrap_or_else(|| panic!("{kind:?}: {found:?}"));
        assert!(finding.fault && finding.count >= 1 && !found.is_sound());
        let places = finding.places.iter();
        let at: Vec<usize> = places.clone().filter_map(|place| Some(place.row? - header)).collect();
        assert_eq!(at, rows, "{kind:?}");
        let message: String = places.map(ToString::to_string).collect();
        assert_contains(&message, [words, name]);
    }
}

/// No capture has the command of its first reading.
#[test]
fn a_first_row_without_a_command_is_sound() {
    let mut table = sound(260);
    (table[0][3], table[0][4]) = (f64::NAN, f64::NAN);
    let found = check("captured.csv", csv(&table).as_bytes());
    assert!(found.is_sound(), "{found:?}");
}

#[test]
fn a_file_that_is_not_a_recording_is_a_finding_beside_the_others() {
    let files = Files::new();
    let whole = npy_f8(&sound(40));
    let paths: Vec<PathBuf> = vec![
        files.write("a.npy", &whole),
        files.write("cut.npy", &whole[..60]),
        files.write("word.csv", b"timestamp,power_mW\n0,1\n1,two\n"),
        files.write("empty.csv", b""),
        files.write("last.csv", csv(&sound(40)).trim_end().as_bytes()),
        files.write("b.npy", &npy_f8(&sound(41))),
        files.write("same.csv", csv(&sound(41)).as_bytes()),
    ];
    let found = check_files(&paths, &ColumnMap::default(), &Limits::default(), 2);
    assert_eq!((found.files, found.trials), (7, 4));
    let wanted = [(FindingKind::Unreadable, 3), (FindingKind::Copy, 2), (FindingKind::CutOff, 1)];
    assert_eq!(faults(&found), wanted, "{found:?}");
    let unreadable = found.finding(FindingKind::Unreadable).unwrap();
    assert_eq!((unreadable.places.len(), unreadable.files), (2, 3), "the first two of three");
    assert!(unreadable.places[1].to_string().contains("row 3, column power_mW"), "{unreadable:?}");
    let copy = found.finding(FindingKind::Copy).unwrap();
    assert!(copy.places[1].file.ends_with("same.csv"), "{copy:?}");
    assert!(copy.places[1].what.ends_with("b.npy"), "{copy:?}");
}

#[test]
fn a_platform_narrows_the_allowed_ranges() {
    let files = Files::new();
    let trial = Trial::read(files.write("a.npy", &npy_f8(&sound(60)))).unwrap();
    let limits =
        Limits { power_w: inspect::Range { least: 0.0, greatest: 3.3 }, ..Limits::default() };
    let found = check_trial(&trial, &limits, 5);
    let finding = found.iter().find(|finding| finding.kind == FindingKind::OutOfRange).unwrap();
    let power_w = trial.column(joulebus_dataset::trial::Column::Power).unwrap();
    let wanted = power_w.iter().filter(|power_w| **power_w > 3.3).count();
    assert!(wanted > 5);
    assert_eq!((finding.count, finding.places.len()), (wanted, 5));
}

#[test]
fn a_sensor_that_is_read_ten_times_a_second_shows_its_period() {
    let mut table = sound(300);
    for row in 0..300 {
        table[row][1] = row as f64 / 30.0;
        let (read, held) = table.split_at_mut(row);
        if !row.is_multiple_of(3) {
            held[0][8..].copy_from_slice(&read[row - row % 3][8..]);
        }
    }
    let files = Files::new();
    let trial = Trial::read(files.write("held.npy", &npy_f8(&table))).unwrap();
    let found = holds(&trial);
    assert_eq!((found.readings, found.held, found.usual_rows), (300, 200, 3));
    assert_eq!((found.usual_share, found.longest_rows, found.longest_at_row), (1.0, 3, 1));
    assert!((found.new_hz - 10.0).abs() < 0.05, "{}", found.new_hz);
    assert!((found.longest_s - 2.0 / 30.0).abs() < 1e-9);
}

#[test]
fn a_description_counts_energy_without_gaps_and_checks_the_units() {
    let mut table = sound(40);
    table[20..].iter_mut().for_each(|row| row[1] += 2.0);
    let files = Files::new();
    let trial = Trial::read(files.write("gap_7.npy", &npy_f8(&table))).unwrap();
    let described = describe(&trial);
    // 100 ms for each of 40 rows; the pause of two seconds adds nothing.
    let wanted_j: f64 = table.iter().map(|row| row[10] / 1e3 * 0.1).sum();
    assert!(
        (described.energy_j - wanted_j).abs() < 1e-6 * wanted_j,
        "{} {wanted_j}",
        described.energy_j
    );
    assert_eq!((described.gaps, described.group.as_str()), (1, "gap"));
    assert!((described.longest_gap_s.unwrap() - 2.1).abs() < 1e-6);
    assert!((described.power_check.unwrap().median_ratio - 1.0).abs() < 1e-9);
    assert_eq!(described.missing_columns, ["v_meas_mps", "omega_meas_radps", "soc"]);
    let power = described.columns.iter().find(|column| column.name == "power_mW").unwrap();
    assert_eq!(Some(power.mean), described.mean_power_w);
    assert!(power.least <= power.mean && power.mean <= power.greatest && power.std > 0.0);
}

#[test]
fn files_directories_and_patterns_are_found_once_and_ignored_files_are_named() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name);
    std::fs::create_dir_all(path("runs/deep")).unwrap();
    for name in ["runs/b.npy", "runs/a.csv.gz", "runs/deep/c.csv", "runs/README.md", "runs/d.bin"] {
        std::fs::write(path(name), "x").unwrap();
    }
    let names = |paths: &[PathBuf]| -> Vec<String> {
        let relative = paths.iter().map(|found| found.strip_prefix(directory.path()).unwrap());
        relative.map(|found| found.display().to_string()).collect()
    };
    let found = find(&[path("runs")]).unwrap();
    assert_eq!(names(&found.files), ["runs/a.csv.gz", "runs/b.npy", "runs/deep/c.csv"]);
    assert_eq!(names(&found.others), ["runs/README.md", "runs/d.bin"]);
    let found = find(&[path("runs/**/*.csv"), path("runs/d.bin"), path("runs/deep")]).unwrap();
    assert_eq!(names(&found.files), ["runs/deep/c.csv", "runs/d.bin"]);
    assert_eq!(names(&found.repeated), ["runs/deep/c.csv"]);

    std::fs::create_dir(path("bare")).unwrap();
    type Wrong = fn(&FindError) -> bool;
    let cases: [(&str, Wrong); 4] = [
        ("nowhere", |e| matches!(e, FindError::Io { .. })),
        ("bare", |e| matches!(e, FindError::NoRecordings { .. })),
        ("runs/*.npz", |e| matches!(e, FindError::NoMatch { .. })),
        ("runs/***/x", |e| matches!(e, FindError::Pattern { .. })),
    ];
    for (name, wrong) in cases {
        let refused = find(&[path(name)]).unwrap_err();
        assert!(wrong(&refused) && refused.to_string().contains(name), "{refused}");
    }
}

#[test]
fn the_real_recordings_are_as_described() {
    let mut paths = Vec::new();
    for platform in ["robotino", "borealtc_husky", "ase_rover"] {
        let Some(found) = trials(platform) else {
            return;
        };
        paths.extend(found);
    }
    let found = check_files(&paths, &ColumnMap::default(), &Limits::default(), 1);
    assert_eq!((found.trials, found.robots, found.rows), (780, 3, 346_887));
    // Gaps of the Robotino, and a Husky at rest: nothing else.
    let kinds: Vec<FindingKind> = faults(&found).iter().map(|fault| fault.0).collect();
    assert_eq!(kinds, [FindingKind::Gap, FindingKind::Stuck]);
    let gaps = found.finding(FindingKind::Gap).unwrap();
    assert_eq!((gaps.count, gaps.files), (245, 159));
    let one = check_files(&paths[..1], &ColumnMap::default(), &Limits::default(), 1);
    assert!(one.is_sound(), "{one:?}");
}
