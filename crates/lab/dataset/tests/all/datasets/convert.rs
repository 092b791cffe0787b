//! A converted recording is the same to the bit, and what a format cannot represent is refused.

use std::path::Path;

use joulebus_dataset::trial::{Column, Fault, Table, Trial};
use joulebus_testkit::assert_contains;
use joulebus_testkit::recordings::trials;
use joulebus_testkit::trials::{Files, ROWS, csv, npy_f8, timed};
use proptest::prelude::*;

/// The contents of a table as bits; all NaNs are equal, and a column of NaNs is absent.
fn bits(table: &Table) -> (Option<String>, Vec<u64>, Vec<Option<Vec<u64>>>) {
    let bit = |value: &f64| {
        if value.is_nan() { f64::NAN.to_bits() } else { value.to_bits() }
    };
    let columns = Column::ALL.map(|column| {
        let values = table.column(column)?;
        let known = values.iter().any(|value| !value.is_nan());
        known.then(|| values.iter().map(bit).collect::<Vec<_>>())
    });
    (
        table.robot_name().map(str::to_owned),
        table.timestamp_s().iter().map(bit).collect(),
        columns.to_vec(),
    )
}

/// Converts through every format in turn, each from the previous file.
fn through_all_forms(directory: &Path, table: &Table) {
    let wanted = bits(table);
    let mut latest = table.clone();
    for name in ["1.npy", "2.csv", "3.npy", "4.csv.gz", "5.csv", "6.npy"] {
        let path = directory.join(name);
        latest.write(&path).unwrap();
        latest = Table::read(&path).unwrap();
        assert_eq!(bits(&latest), wanted, "{name}");
        std::fs::remove_file(path).unwrap();
    }
}

fn value() -> impl Strategy<Value = f64> {
    let small = -1e30..1e30;
    prop_oneof![
        Just(f64::NAN),
        Just(0.0),
        Just(-0.0),
        Just(5e-324),
        small,
        (-1_000_000_i64..1_000_000).prop_map(|hundredths| hundredths as f64 / 100.0),
        any::<i32>().prop_map(|whole| f64::from(whole) * 1e-3),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn conversion_through_every_format_preserves_the_bits(
        rows in prop::collection::vec((0.0_f64..4e9, prop::array::uniform9(value())), 2..40),
        robot in prop_oneof![Just(f64::NAN), Just(7.0), Just(-2.5), Just(1e15)],
    ) {
        let rows: Vec<[f64; 11]> = rows
            .into_iter()
            .map(|(time_s, values)| {
                let mut row = [robot; 11];
                row[1] = time_s;
                row[2..].copy_from_slice(&values);
                row
            })
            .collect();
        let files = Files::new();
        let table = Table::read(files.write("first.npy", &npy_f8(&rows))).unwrap();
        for (row, wanted) in rows.iter().enumerate() {
            prop_assert_eq!(table.timestamp_s()[row].to_bits(), wanted[1].to_bits());
            let power = table.column(Column::Power).unwrap()[row];
            prop_assert!(power.to_bits() == wanted[10].to_bits() || power.is_nan() && wanted[10].is_nan());
        }
        let directory = tempfile::tempdir().unwrap();
        through_all_forms(directory.path(), &table);
    }
}

#[test]
fn conversion_of_real_recordings_preserves_the_bits_of_all_kept_columns() {
    for platform in ["robotino", "borealtc_husky", "ase_rover"] {
        let Some(paths) = trials(platform) else {
            return;
        };
        for path in paths.iter().step_by(25) {
            let table = Table::read(path).unwrap();
            let directory = tempfile::tempdir().unwrap();
            let text = directory.path().join("a.csv");
            table.write(&text).unwrap();
            assert_eq!(bits(&Table::read(&text).unwrap()), bits(&table));

            let array = directory.path().join("a.npy");
            let refused = table.write(&array).unwrap_err();
            assert_eq!(refused.fault(), Fault::RobotName, "{refused}");
            let mut plain = table.clone();
            plain.rename("3");
            for column in [Column::VMeasured, Column::OmegaMeasured] {
                plain.drop_column(column);
            }
            through_all_forms(directory.path(), &plain);
        }
    }
}

#[test]
fn what_a_format_cannot_represent_is_refused_and_no_file_is_left() {
    let files = Files::new();
    let named = csv(&ROWS).replace("\n7,", "\nseven,");
    let twice = csv(&ROWS).replace("\n7,", "\n07,");
    let measured = "timestamp,power_mW,v_meas\n0,1,0.5\n1,2,NaN\n";
    let cases = [
        ("named.csv", named, Fault::RobotName),
        ("zero.csv", twice, Fault::RobotName),
        ("measured.csv", measured.to_owned(), Fault::NoSuchColumns),
    ];
    let directory = tempfile::tempdir().unwrap();
    for (name, text, fault) in cases {
        let table = Table::read(files.write(name, text.as_bytes())).unwrap();
        let refused = table.write(&directory.path().join("a.npy")).unwrap_err();
        assert_eq!(refused.fault(), fault, "{name}: {refused}");
        assert!(refused.to_string().contains("a.npy"), "{refused}");
    }
    let table = Table::read(files.write("plain.npy", &npy_f8(&ROWS))).unwrap();
    let refused = table.write(&directory.path().join("a.txt")).unwrap_err();
    assert_eq!(refused.fault(), Fault::Ending, "{refused}");
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);

    for name in ["there.csv", "there.csv.gz", "there.npy"] {
        let there = directory.path().join(name);
        std::fs::write(&there, "mine").unwrap();
        let refused = table.write(&there).unwrap_err();
        assert!(refused.to_string().contains("not overwritten"), "{refused}");
        assert_eq!(std::fs::read_to_string(&there).unwrap(), "mine");
    }
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 3);
}

#[test]
fn several_robots_in_a_file_are_separate_trials_with_the_rows_of_the_file() {
    let files = Files::new();
    let mut rows = Vec::new();
    for step in 0..20 {
        for robot in 0..3 {
            let mut row = [f64::NAN; 11];
            let late = if step > 9 && robot == 1 { 1.0 } else { 0.0 };
            (row[0], row[1]) = (f64::from(robot), f64::from(step) / 30.0 + late);
            row[10] = f64::from(3_000 + 100 * robot + step);
            rows.push(row);
        }
    }
    // A CSV has its header in front.
    for (name, bytes, first) in [("a.npy", npy_f8(&rows), 1), ("a.csv", csv(&rows).into_bytes(), 2)]
    {
        let path = files.write(name, &bytes);
        let trials = Trial::read_robots(&path).unwrap();
        assert_eq!(trials.len(), 3, "{name}");
        for (robot, trial) in trials.iter().enumerate() {
            assert_eq!(trial.robot_name(), Some(robot.to_string().as_str()));
            assert_eq!(trial.rows(), 20);
            assert_eq!(trial.file_row(2), 6 + robot + first);
            let power_w = trial.column(Column::Power).unwrap()[4];
            assert!((power_w - (3.004 + 0.1 * robot as f64)).abs() < 1e-9);
        }
        let gaps: Vec<usize> = trials[1].notes().gaps.iter().map(|gap| gap.row).collect();
        assert_eq!(gaps, [31 + first], "the row in the file");
        let refused = Trial::read(&path).unwrap_err();
        let second = format!("row {}: robot", first + 1);
        assert!(refused.to_string().contains(&second), "{refused}");
    }
}

#[test]
fn rows_without_a_robot_are_counted_where_there_is_one_and_refused_where_there_are_several() {
    let files = Files::new();
    let text = "robot_id,timestamp,power_mW\n,0,1\n7,1,2\nnan,2,3\n7,3,4\n";
    let trial = Trial::read(files.write("one.csv", text.as_bytes())).unwrap();
    assert_eq!(trial.robot_name(), Some("7"));
    assert_eq!(trial.notes().unnamed_rows, 2);
    assert!(!trial.notes().is_clean());
    for (text, row) in [
        ("robot_id,timestamp,power_mW\n7,0,1\n8,0,2\n,1,3\n", "row 4"),
        ("robot_id,timestamp,power_mW\n7,0,1\n,1,2\n8,1,3\n", "row 4"),
    ] {
        let path = files.write("several.csv", text.as_bytes());
        let refused = Trial::read_robots(path).unwrap_err().to_string();
        assert_contains(&refused, [row, "a name in every row"]);
    }
}

#[test]
fn a_file_with_more_robots_than_there_can_be_is_refused() {
    let files = Files::new();
    let mut text = "robot_id,timestamp,power_mW\n".to_owned();
    for robot in 0..10_001 {
        text += &format!("r{robot},0,1\n");
    }
    let refused = Table::read_robots(files.write("many.csv", text.as_bytes())).unwrap_err();
    assert_eq!(refused.fault(), Fault::TooManyRobots, "{refused}");
}

#[test]
fn a_table_without_robot_or_extra_columns_writes_only_what_it_has() {
    let files = Files::new();
    let text = "timestamp_s,power_mW\n0,1\n0.5,2.25\n";
    let table = Table::read(files.write("a.csv", text.as_bytes())).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("b.csv");
    table.write(&path).unwrap();
    let written = std::fs::read_to_string(&path).unwrap();
    assert_eq!(written, "robot_id,timestamp_s,power_mW\nNaN,0,1\nNaN,0.5,2.25\n");
    let array = npy_f8(&timed(&[(0.0, 1.0), (0.5, 2.25)]));
    assert_eq!(bits(&Table::read(files.write("c.npy", &array)).unwrap()), bits(&table));
}

/// A table may have fewer rows than the reader of an array accepts.
#[test]
fn an_array_of_fewer_than_two_rows_is_not_written() {
    let (files, directory) = (Files::new(), tempfile::tempdir().unwrap());
    let path = directory.path().join("a.npy");
    for (rows, text) in ["", "0,3600\n"].into_iter().enumerate() {
        let text = format!("timestamp_s,power_mW\n{text}");
        let table = Table::read(files.write("few.csv", text.as_bytes())).unwrap();
        let refused = table.write(&path).unwrap_err();
        assert_eq!(refused.fault(), Fault::TooFewRows, "{refused}");
        assert_contains(&refused.to_string(), [format!("{rows} rows")]);
        assert!(!path.exists());
    }
}

#[test]
fn a_table_without_rows_is_written_as_text_that_is_read_again() {
    let (files, directory) = (Files::new(), tempfile::tempdir().unwrap());
    let table = Table::read(files.write("none.csv", b"timestamp_s,power_mW\n")).unwrap();
    let path = directory.path().join("a.csv");
    table.write(&path).unwrap();
    assert_eq!(bits(&Table::read(&path).unwrap()), bits(&table));
}
