//! DuckDB, Polars, pandas, pyarrow and Dask read an archive.

use std::fs;
use std::path::Path;
use std::process::Command;

use joulebus_dataset::archive::{Listing, RowStamp, fields, listings};
use joulebus_dataset::trial::{Column, Table, each_run, is_capture};
use serde_json::{Value, json};

use crate::recordings::{BEGIN_NS, capture, every_kind, full, sparse};
use crate::{export, export_mixed, parquet};

/// Exit code of `tools/read_archive.py` without its packages.
const NO_PACKAGES: i32 = 77;

/// A trial as it was recorded: its fleet, rows, and the exact integers of each row.
type Recorded = (Option<String>, Table, Option<Vec<RowStamp>>);

fn recorded(path: &Path) -> Vec<Recorded> {
    let mut all = Vec::new();
    if is_capture(path) {
        each_run(path, |run| {
            all.push((Some(run.fleet), run.table, Some(run.stamps)));
            Ok::<_, joulebus_dataset::trial::TrialError>(())
        })
        .unwrap();
        return all;
    }
    let tables = Table::read_robots(path).unwrap();
    all.extend(tables.into_iter().map(|table| (None, table, None)));
    all
}

/// The columns of a trial as text: bits of numbers with a fraction, others in decimal.
fn columns((_, table, stamps): &Recorded) -> Value {
    let bits = |value: f64| (!value.is_nan()).then(|| value.to_bits().to_string());
    let mut columns = serde_json::Map::new();
    let rows = 0..table.rows();
    columns.insert(
        "timestamp_s".to_owned(),
        table.timestamp_s().iter().map(|time_s| bits(*time_s)).collect(),
    );
    for column in Column::ALL {
        let value = |row: usize| table.column(column).and_then(|values| bits(values[row]));
        columns.insert(column.name().to_owned(), rows.clone().map(value).collect());
    }
    let row = |row: usize| Some(table.file_row(row).to_string());
    columns.insert("row".to_owned(), rows.clone().map(row).collect());
    let id: Option<u32> = table.robot_name().and_then(|name| name.parse().ok());
    let id = id.map(|id| id.to_string());
    columns.insert("robot_id".to_owned(), rows.clone().map(|_| id.clone()).collect());
    let mut stamped = |name: &str, of: fn(&RowStamp) -> Option<u64>| {
        let number = |row: usize| {
            let stamp = stamps.as_ref().map(|stamps| stamps[row]);
            stamp.as_ref().and_then(of).map(|number| number.to_string())
        };
        columns.insert(name.to_owned(), rows.clone().map(number).collect());
    };
    stamped("unix_ns", |stamp| Some(stamp.unix_ns));
    stamped("stamp_ns", |stamp| Some(stamp.stamp_ns));
    stamped("measured_ns", |stamp| (stamp.measured_ns > 0).then_some(stamp.measured_ns));
    stamped("seq", |stamp| Some(stamp.seq));
    stamped("flags", |stamp| Some(u64::from(stamp.flags)));
    Value::Object(columns)
}

#[test]
fn each_reader_that_the_documents_name_reads_every_value_to_the_bit_and_integers_as_integers() {
    let place = tempfile::tempdir().unwrap();
    let from = |name: &str| {
        let folder = place.path().join(name);
        fs::create_dir(&folder).unwrap();
        folder
    };
    let (tables, unnamed, captures) = (from("tables"), from("unnamed"), from("captures"));
    full(&tables, "a.csv", 400, 1);
    sparse(&tables, "b.csv", 300, 3);
    fs::write(unnamed.join("c.csv"), "time,power_W\n0,1\n1,\n2,1.5\n").unwrap();
    capture(&captures, "run.mcap", 600, 3);
    let all = place.path().join("all");
    every_kind(&all);
    for (number, (from, levels)) in [
        (&tables, &["robot"][..]),
        (&unnamed, &[]),
        (&captures, &["fleet", "day", "robot"]),
        (&all, &["fleet", "day", "robot"]),
    ]
    .into_iter()
    .enumerate()
    {
        let archive = place.path().join(format!("archive-{number}"));
        let is_mixed = *from == all;
        match is_mixed {
            true => export_mixed(&[from], &archive).exits(0),
            false => export(&[from], &archive).exits(0),
        };
        if !is_read(&archive, levels, is_mixed) {
            return;
        }
    }
}

/// Compares what each reader finds in an archive with what was exported; false without packages.
fn is_read(archive: &Path, levels: &[&str], is_mixed: bool) -> bool {
    let mut trials = Vec::new();
    for path in listings(archive).unwrap() {
        let listing = Listing::read(&path).unwrap();
        let recorded = recorded(Path::new(&listing.name));
        assert_eq!(listing.trials.len(), recorded.len());
        for (listed, one) in listing.trials.iter().zip(&recorded) {
            let day = one.2.as_ref().map(|_| "2026-11-22");
            trials.push(json!({
                "file": listed.file, "rows": one.1.rows(), "fleet": one.0, "day": day,
                "robot": one.1.robot_name(), "columns": columns(one),
            }));
        }
    }
    assert_eq!(trials.len(), parquet(archive).len());
    let kinds = fields().into_iter();
    let kinds: serde_json::Map<String, Value> =
        kinds.map(|field| (field.name.to_owned(), field.kind.name().into())).collect();
    let expected = archive.with_extension("json");
    let text = json!({ "trials": trials, "kinds": kinds, "levels": levels, "mixed": is_mixed })
        .to_string();
    fs::write(&expected, text).unwrap();
    let tool = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tools/read_archive.py");
    let ended = Command::new("python3").arg(tool).arg(archive).arg(&expected).output();
    let ended = ended.unwrap();
    let message = String::from_utf8_lossy(&ended.stderr);
    if ended.status.code() == Some(NO_PACKAGES) {
        assert!(std::env::var("CI").as_deref() != Ok("true"), "{message}");
        println!("{message}");
        return false;
    }
    println!("{}", String::from_utf8_lossy(&ended.stdout));
    assert!(ended.status.success(), "{message}");
    true
}

#[test]
fn a_captures_integers_are_those_of_its_samples_and_its_day_that_of_its_first() {
    let place = tempfile::tempdir().unwrap();
    let path = capture(place.path(), "run.mcap", 90, 2);
    let mut runs = Vec::new();
    each_run(&path, |run| {
        runs.push(run);
        Ok::<_, joulebus_dataset::trial::TrialError>(())
    })
    .unwrap();
    // Robot 1 begins again in the middle.
    let [one, first, second] = &runs[..] else {
        panic!("{} runs", runs.len());
    };
    assert_eq!((one.stamps.len(), first.stamps.len(), second.stamps.len()), (90, 45, 45));
    for run in &runs {
        let from = if std::ptr::eq(run, second) { 45 } else { 0 };
        for (row, stamp) in run.stamps.iter().enumerate() {
            let frame = from + row as u64;
            assert_eq!(stamp.seq, frame);
            assert_eq!(stamp.unix_ns, BEGIN_NS + frame * 33_333_333);
            if row > 0 {
                assert_eq!(stamp.stamp_ns, 5_000_000_000 + (frame - 1) * 33_333_333);
            }
            let time_s = (stamp.stamp_ns - run.stamps[0].stamp_ns) as f64 * 1e-9;
            assert_eq!(time_s.to_bits(), run.table.timestamp_s()[row].to_bits());
        }
    }
}
