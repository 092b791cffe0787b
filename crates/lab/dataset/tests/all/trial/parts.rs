//! A file with more rows than memory has room for is read in parts.

use std::path::Path;

use joulebus_dataset::inspect::{FindingKind, Limits, Profiler, check_files};
use joulebus_dataset::trial::{Column, ColumnMap, Fault, Table, Trial, TrialError};
use joulebus_testkit::assert_contains;
use joulebus_testkit::trials::{Files, csv, gzip, header, npy, npy_f8};

/// Rows of the robots 1 to `robots`, in turn.
fn rows(count: u32, robots: u32) -> Vec<[f64; 11]> {
    let row = |at: u32| {
        let power_mw = 4_000.0 + f64::from(at * 7919 % 101);
        let mut row = [f64::NAN; 11];
        (row[0], row[1]) = (f64::from(at % robots + 1), f64::from(at) * 0.1);
        (row[8], row[10]) = (7_400.0 - f64::from(at), power_mw);
        row
    };
    (0..count).map(row).collect()
}

fn parts(path: &Path, map: &ColumnMap) -> Vec<Table> {
    let mut parts = Vec::new();
    Table::each(path, map, |part| {
        parts.push(part);
        Ok::<_, TrialError>(())
    })
    .unwrap();
    parts
}

/// The rows of a robot to the bit, with their places in the file.
fn contents<'a>(tables: impl IntoIterator<Item = &'a Table>) -> Vec<(usize, u64, u64)> {
    let of = |table: &'a Table| {
        let power = table.column(Column::Power).unwrap();
        let rows = table.timestamp_s().iter().zip(power).enumerate();
        rows.map(|(row, (time_s, power))| (table.file_row(row), time_s.to_bits(), power.to_bits()))
    };
    tables.into_iter().flat_map(of).collect()
}

/// The numbers of a robot's rows among those of its file.
fn data_rows(table: &Table) -> Vec<usize> {
    let trial = table.clone().into_trial().unwrap();
    (0..trial.rows()).map(|row| trial.data_row(row)).collect()
}

#[test]
fn the_parts_of_a_file_have_its_rows_to_the_bit_each_once_in_every_format() {
    let files = Files::new();
    for robots in [1, 3] {
        let rows = rows(1_001, robots);
        let columns: Vec<u8> = (0..11)
            .flat_map(|column| rows.iter().map(move |row| row[column]))
            .flat_map(f64::to_be_bytes)
            .collect();
        for (name, bytes) in [
            ("long.csv", csv(&rows).into_bytes()),
            ("spaced.csv", csv(&rows).replace('\n', "\n\n").into_bytes()),
            ("long.csv.gz", gzip(csv(&rows).as_bytes())),
            ("long.npy", npy_f8(&rows)),
            ("columns.npy", npy(&header(">f8", "True", rows.len()), &columns)),
        ] {
            let path = files.write(name, &bytes);
            let whole = Table::read_robots(&path).unwrap();
            let parts = parts(&path, &ColumnMap::default().in_parts_of(300));
            assert!(parts.len() > 3, "{name}");
            for table in &whole {
                let own = || parts.iter().filter(|part| part.robot_name() == table.robot_name());
                assert_eq!(contents(own()), contents([table]), "{name}");
                assert_eq!(own().flat_map(data_rows).collect::<Vec<_>>(), data_rows(table));
                assert!(own().all(|part| (2..=300).contains(&part.rows())), "{name}");
            }
            for part in parts {
                let trial = part.into_trial().unwrap();
                assert!(trial.is_part(), "{name}");
            }
            // A file that fits is not divided.
            let fits = self::parts(&path, &ColumnMap::default().in_parts_of(1_001));
            assert_eq!(fits.len(), whole.len(), "{name}");
            assert!(fits.iter().all(|table| !table.clone().into_trial().unwrap().is_part()));
        }
    }
}

#[test]
fn what_a_text_states_once_holds_for_all_its_parts() {
    let files = Files::new();
    let map = ColumnMap::default().in_parts_of(300).whole_rows(true);
    let mut text = "stamp;power_W\n# begun\n".to_owned();
    for row in 0..1_000_u64 {
        let power = row * 7919 % 101;
        text += &format!("{};4,{power:04}\n", 1_764_000_000_000 + row * 100);
    }
    let path = files.write("long.csv", (text + "cut").as_bytes());
    let trials: Vec<Trial> =
        parts(&path, &map).into_iter().map(|part| part.into_trial().unwrap()).collect();
    let (first, last) = (&trials[0], trials.last().unwrap());
    assert_eq!(first.timestamp_s()[0], 1_764_000_000.0);
    assert_eq!(*last.timestamp_s().last().unwrap(), 1_764_000_099.9);
    assert_contains(&first.notes().understood.join(", "), ["';'", "milliseconds since 1970"]);
    let lines = trials.iter().map(|trial| trial.notes().left_out.lines);
    assert_eq!(lines.sum::<usize>(), 2);
    // Later times of another unit are refused.
    let mixed = (0..1_000).map(|row| match row {
        900.. => format!("{row},1\n"),
        _ => format!("{},1\n", 1_764_000_000_000_u64 + row * 100),
    });
    let text = format!("stamp,power_W\n{}", mixed.collect::<String>());
    let path = files.write("mixed.csv", text.as_bytes());
    let error: TrialError = Table::each(path, &map, |_| Ok(())).unwrap_err();
    assert_eq!(error.fault(), Fault::Value);
    assert_contains(&error.to_string(), ["--map time_ms=stamp"]);
}

#[test]
fn a_check_and_a_profile_of_the_parts_are_those_of_the_whole() {
    let files = Files::new();
    let mut broken = csv(&rows(1_000, 1)) + &csv(&rows(20, 1));
    broken += "1,2,3\n";
    let path = files.write("long.csv", broken.as_bytes());
    let [whole, in_parts] = [ColumnMap::default(), ColumnMap::default().in_parts_of(300)]
        .map(|map| check_files(std::slice::from_ref(&path), &map, &Limits::default(), 3));
    assert!(in_parts.trials > 3 && whole.trials == 2);
    assert_eq!(whole.rows, 1_020);
    assert_eq!(in_parts.rows, whole.rows);
    for kind in [FindingKind::NoRow, FindingKind::Clock, FindingKind::Held] {
        let of = |check: &joulebus_dataset::inspect::Check| {
            let found = check.finding(kind);
            found.map(|found| (found.count, found.places.first().and_then(|place| place.row)))
        };
        assert_eq!(of(&in_parts), of(&whole), "{kind:?}");
    }
    let path = files.write("long.csv", csv(&rows(1_000, 1)).as_bytes());
    let profile = |map: &ColumnMap| {
        let mut profiler = Profiler::default();
        Trial::each(&path, map, |trial| {
            profiler.take(&trial);
            Ok::<_, TrialError>(())
        })
        .unwrap();
        profiler.finish().unwrap()
    };
    let whole = profile(&ColumnMap::default());
    let in_parts = profile(&ColumnMap::default().in_parts_of(300));
    assert_eq!(in_parts.readings, whole.readings);
    assert_eq!(in_parts.power_w, whole.power_w);
    assert_eq!(in_parts.voltage_v, whole.voltage_v);
    assert_eq!(in_parts.resolution_w, whole.resolution_w);
}

#[test]
fn whoever_wants_no_more_gets_no_more() {
    let files = Files::new();
    let path = files.write("long.npy", &npy_f8(&rows(1_000, 1)));
    let mut taken = 0;
    let stopped: Result<(), Option<TrialError>> =
        Table::each(&path, &ColumnMap::default().in_parts_of(300), |_| {
            taken += 1;
            if taken == 2 { Err(None) } else { Ok(()) }
        });
    assert!(matches!(stopped, Err(None)) && taken == 2);
}
