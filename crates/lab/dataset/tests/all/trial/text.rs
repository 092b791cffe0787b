//! Texts as other programs write them, and as a loss of power leaves them.

use joulebus_dataset::inspect::{FindingKind, Limits, check_files, judge};
use joulebus_dataset::trial::{Column, ColumnMap, Fault, MappedColumn, Table, Trial, TrialError};
use joulebus_testkit::trials::{Files, ROWS, csv, gzip, npy_f8};
use joulebus_testkit::{assert_contains, cases};

use super::forms::row;

fn mapped(columns: &str) -> ColumnMap {
    let columns = columns.split(',').filter(|column| *column != "-");
    let columns: Vec<MappedColumn> = columns.map(|one| one.parse().unwrap()).collect();
    ColumnMap::from(columns)
}

fn fault(read: Result<Trial, TrialError>) -> Fault {
    read.map(|trial| trial.rows()).unwrap_err().fault()
}

fn read(files: &Files, text: &str, columns: &str) -> Result<Trial, TrialError> {
    let path = files.write("log.csv", text.as_bytes());
    Table::only_of(path, &mapped(columns))?.into_trial()
}

#[test]
fn times_separators_and_headers_of_other_programs_are_read() {
    let files = Files::new();
    // Mapping, the text, its first time, the second, the second power in W, and the note.
    for case in cases(
        r#"
        - | timestamp,power_W\n2026-04-07T10:30:00Z,4.5\n2026-04-07T10:30:00.5Z,4.6\n | 1775557800 | 0.5 | 4.6 | -
        - | time,power_W\n2026-04-07 10:30:00,4.5\n2026-04-07 10:30:01,4.6\n | 1775557800 | 1 | 4.6 | -
        - | time,power_W\n2026-04-07T12:30:00+02:00,4.5\n2026-04-07T12:30:01+02:00,4.6\n | 1775557800 | 1 | 4.6 | -
        - | time,power_W\n23:59:59.5,4.5\n00:00:00.5,4.6\n | 86399.5 | 1 | 4.6 | pass midnight 1 times
        - | time,power_W\n0 days 00:00:00.1,4.5\n0 days 00:00:00.2,4.6\n | 0.1 | 0.1 | 4.6 | -
        - | timestamp,power_W\n1748899754000,4.5\n1748899754500,4.6\n | 1748899754 | 0.5 | 4.6 | read as milliseconds
        - | Time,power_W\n1748899754000000,4.5\n1748899754500000,4.6\n | 1748899754 | 0.5 | 4.6 | as microseconds
        - | %time,power_W\n1748899754000000000,4.5\n1748899754500000000,4.6\n | 1748899754 | 0.5 | 4.6 | as nanoseconds
        time=at | at,power_W\n1748899754000,4.5\n1748899754500,4.6\n | 1748899754 | 0.5 | 4.6 | read as milliseconds
        - | header.stamp.sec,header.stamp.nanosec,power_W\n7,500000000,4.5\n8,0,4.6\n | 7.5 | 0.5 | 4.6 | -
        - | secs,nsecs,power_W\n7,500000000,4.5\n8,0,4.6\n | 7.5 | 0.5 | 4.6 | -
        time=/b/stamp | /a/stamp/sec,/a/stamp/nanosec,/b/stamp/sec,/b/stamp/nanosec,power_W\n1,0,7,5,4.5\n1,0,8,5,4.6\n | 7 | 1 | 4.6 | -
        - | __time,/bat/header/stamp/sec,/bat/header/stamp/nanosec,/bat/voltage,/bat/current\n1,0,0,2,1\n2,0,0,2,2.3\n | 1 | 1 | 4.6 | -
        - | ,power_W\n2026-04-07 10:30:00,4.5\n2026-04-07 10:30:01,4.6\n | 1775557800 | 1 | 4.6 | -
        - | Unnamed: 0,time,power_W\n0,1,4.5\n1,2,4.6\n | 1 | 1 | 4.6 | -
        - | time;power_W\n0;4,5\n0,5;4,6\n | 0 | 0.5 | 4.6 | decimal comma
        - | time;power_W\n0.0;4.5\n0.5;4.6\n | 0 | 0.5 | 4.6 | separated by ';'
        - | time;power, W\n0,000;4,500\n0,500;4,600\n | 0 | 0.5 | 4.6 | decimal comma
        - | time;power_W\n00,250;4,500\n00,750;4,600\n | 0.25 | 0.5 | 4.6 | decimal comma
        - | time;power_W\n1775557800,000;4,500\n1775557800,500;4,600\n | 1775557800 | 0.5 | 4.6 | decimal comma
        - | time\tpower_W\n0\t4.5\n0.5\t4.6\n | 0 | 0.5 | 4.6 | separated by '\t'
        - | sep=;\ntime;power_W\n0;4.5\n1;4.6\n | 0 | 1 | 4.6 | -
        - | # a log\n# of a robot\ntime,power_W\n0,4.5\n1,4.6\n | 0 | 1 | 4.6 | -
        - | # time,power_W\n0,4.5\n1,4.6\n | 0 | 1 | 4.6 | -
        time_s=t | t,power_W\n0,4.5\n10,4.6\n | 0 | 10 | 4.6 | -
        time_ms=t | t,power_W\n0,4.5\n10,4.6\n | 0 | 0.01 | 4.6 | -
        - | t_s,power_W\n0,4.5\n10,4.6\n | 0 | 10 | 4.6 | -
        - | t,power_W\n0,4.5\n1,4.6\n | 0 | 1 | 4.6 | -
        - | time,power_W\n0,4.5,\n1,4.6,\n | 0 | 1 | 4.6 | -
        - | time,power_W,\n0,4.5\n1,4.6\n | 0 | 1 | 4.6 | -
        voltage_V:=2 | time,Current(uA)\n0,2250000\n1,2300000\n | 0 | 1 | 4.6 | -
        - | t_min,power_W\n0,4.5\n1,4.6\n | 0 | 60 | 4.6 | -
        v_mps=v | t,v,current_A,power_W\n0,0.2,1,5\n1,0.2,1,4.6\n | 0 | 1 | 4.6 | -
        voltage_V=v,current_A=i | t,v,i\n0,2,1\n1,2,2.3\n | 0 | 1 | 4.6 | -
        - | # t power_W\n0.0e+00 4.5e+00\n5.0e-01 4.6e+00\n | 0 | 0.5 | 4.6 | separated by ' '
        - | t power_W\n0 4.5\n1 4.6\n | 0 | 1 | 4.6 | separated by ' '
        - | t,power_W\n"0,0","4,5"\n"0,5","4,6"\n | 0 | 0.5 | 4.6 | decimal comma
        - | t,power_W,soc\n0,4.5,96%\n1,4.6,95 %\n | 0 | 1 | 4.6 | -
        - | Timestamp(ms),power_uW\n0,4500000\n500,4600000\n | 0 | 0.5 | 4.6 | -
        "#,
    ) {
        let [columns, text, first_s, step_s, power_w, expected] = case.as_slice() else {
            panic!("{case:?}");
        };
        let text = &text.replace("\\t", "\t");
        let trial = read(&files, text, columns).unwrap_or_else(|error| panic!("{text}: {error}"));
        let number = |text: &str| text.parse::<f64>().unwrap();
        let times_s = trial.timestamp_s();
        assert!((times_s[0] - number(first_s)).abs() < 1e-6, "{text}: {times_s:?}");
        assert!((times_s[1] - times_s[0] - number(step_s)).abs() < 1e-6, "{text}: {times_s:?}");
        let found = trial.column(Column::Power).unwrap()[1];
        assert!((found - number(power_w)).abs() < 1e-9, "{text}: {found}");
        assert!(
            expected == "-" || trial.notes().to_string().contains(expected),
            "{}",
            trial.notes()
        );
        assert_eq!(
            trial.notes().ignored_columns.iter().filter(|name| !name.contains("stamp")).count(),
            0,
            "{text}"
        );
    }
}

#[test]
fn texts_that_can_mean_two_things_are_refused_with_the_way_out() {
    let files = Files::new();
    for case in cases(
        r#"
        - | timestamp,power_W\n2026-04-07,4.5\n2026-04-08,4.6\n | row 2 | "2026-04-07" | 2026-04-07T10:30:00.5Z
        - | stamp,power_W\n12345678901,4.5\n12345678934,4.6\n | column stamp | --map time_ms=stamp | time_us | time_ns
        - | stamp,power_W\n1500000000000,4.5\n1500033000000,4.6\n | --map time_ms=stamp
        - | time,power_W\n1,4.5\n2026-04-07T10:30:00,4.6\n | row 3 | as in the first row
        - | time;power_W\n0;4,500\n1;4,600\n | "4,500" | could separate thousands
        - | time;power_W\n0;1.234,5\n1;4,6\n | "1.234,5" | could separate thousands
        - | a.sec,a.nanosec,b.sec,b.nanosec,power_W\n1,0,1,0,4\n2,0,2,0,4\n | a.sec and b.sec | --map
        - | time;v;power_mW\n0;0,25;38.638\n1;0,25;38.024\n | "38.638" | could separate thousands
        - | t,v,i,power_W\n0,5.1,1,5\n1,5.1,1,5\n | column v beside i | --map v_mps=v | --map voltage_V=v
        - | t,v,current_A,power_W\n0,5.1,1,5\n1,5.1,1,5\n | v beside current_A | --map voltage_V=v
        voltage_V:=3 | time,voltage_V\n0,1\n1,1\n | no column for power
        - | t,power_W\n7,4.5\n17,4.6\n27,4.7\n | column t | 10 apart | --map time_s=t | --map time_ms=t
        time=at | at,power_W\n0,4.5\n2,4.6\n4,4.7\n | column at | 2 apart | --map time_s=at
        "#,
    ) {
        let [columns, text, parts @ ..] = case.as_slice() else {
            panic!("{case:?}");
        };
        let error = read(&files, text, columns).unwrap_err().to_string();
        assert_contains(&error, parts);
    }
}

#[test]
fn words_for_missing_values_are_no_values_and_a_whole_number_with_a_fraction_is_an_id() {
    let files = Files::new();
    for word in [
        "NA",
        "N/A",
        "null",
        "None",
        "-",
        "#N/A",
        "-nan(ind)",
        "NaN",
        "nan",
        "",
        "<NA>",
        "unavailable",
    ] {
        let text = format!("robot,time,power_W\n3.0,0,4.5\n3,1,{word}\n{word},2,4.5\n");
        let trial = read(&files, &text, "-").unwrap_or_else(|error| panic!("{word}: {error}"));
        assert_eq!(trial.robot_name(), Some("3"), "{word}");
        assert!(trial.column(Column::Power).unwrap()[1].is_nan(), "{word}");
        assert_eq!(trial.notes().unnamed_rows, 1, "{word}");
    }
    let trial = read(&files, "time,power_W\n0,1\n1,1\n", "robot:=r1").unwrap();
    assert_eq!(trial.robot_name(), Some("r1"));
}

/// Numbers that stand for no value, and ROS's charge that is not measured.
#[test]
fn numbers_that_stand_for_no_value_are_none_on_request() {
    let files = Files::new();
    let text = "time,power_W,soc\n0,4.5,-1\n1,-999,-1.0\n2,4.6,0.5\n3,-9999.0,0.4\n";
    let trial = read(&files, text, "missing:=-999,missing:=-9999").unwrap();
    let nan = |values: &[f64]| values.iter().map(|value| value.is_nan()).collect::<Vec<_>>();
    assert_eq!(nan(trial.column(Column::Power).unwrap()), [false, true, false, true]);
    assert_eq!(nan(trial.column(Column::Soc).unwrap()), [true, true, false, false]);
    let mut rows = [[1.0; 11]; 4];
    for (at, row) in rows.iter_mut().enumerate() {
        (row[1], row[10]) = (at as f64, if at == 2 { -999.0 } else { 4.5 });
    }
    let path = files.write("a.npy", &npy_f8(&rows));
    let trial = Table::only_of(path, &mapped("missing:=-999")).unwrap().into_trial().unwrap();
    assert_eq!(nan(trial.column(Column::Power).unwrap()), [false, false, true, false]);
    for wrong in ["missing=power", "missing:=no", "missing:="] {
        assert!(wrong.parse::<MappedColumn>().is_err(), "{wrong}");
    }
}

/// A quote that opens and does not close takes the rows behind it into its text: until the next
/// quote, or to the end.
#[test]
fn a_quote_that_is_not_closed_is_a_fault_with_its_row() {
    let files = Files::new();
    for (name, quotes, swallowed) in [("end", vec![30], 29), ("pair", vec![30, 50], 20)] {
        for separator in [",", ";"] {
            let mut text = ["time", "power_W", "note\n"].join(separator);
            for row in 0..60 {
                let note = if quotes.contains(&row) { "\"5 inch" } else { "x" };
                text += &[&row.to_string(), "4.5", note].join(separator);
                text.push('\n');
            }
            let path = files.write("quote.csv", text.as_bytes());
            let error = Trial::read(&path).unwrap_err().to_string();
            assert_contains(
                &error,
                ["row 32", "a quote that is not closed", &swallowed.to_string()],
            );
            let found = check_files(&[path], &ColumnMap::default(), &Limits::default(), 3);
            let finding = found.finding(FindingKind::NoRow);
            assert!(finding.is_some_and(|one| one.fault), "{name}: {found:?}");
        }
    }
    // Text in several lines.
    let text = "time,power_W,note\n0,4.5,\"a\nb\"\n1,4.6,\"a, 1\nb\"\n";
    assert_eq!(read(&files, text, "-").unwrap().rows(), 2);
}

/// Row numbers are lines of the file, with what is above the header, empty lines, texts of several
/// lines, and any ends of lines. Of the rows that show how a text is written, the last may be cut.
#[test]
fn rows_are_numbered_as_the_lines_of_their_file() {
    let files = Files::new();
    let text = "made by me\n# of\ntime,power_W,note\n0,1,\"a\nb\"\n\n1,2,\n2,off,c\n";
    for (text, row) in [
        (text, 8),
        (&text.replace('\n', "\r\n"), 8),
        ("time,power_W\r0,1\r\r1,2\r2,off\r", 5),
        ("time,power_W\n0,1\n2,off", 3),
    ] {
        let error = read(&files, text, "-").unwrap_err().to_string();
        assert_contains(&error, [&format!("row {row}, column power_W")]);
    }
    let text = format!("{}3,1,d\n", text.replace("off", "3"));
    let trial = read(&files, &text, "-").unwrap();
    let numbers: Vec<_> = (0..4).map(|row| (trial.file_row(row), trial.data_row(row))).collect();
    assert_eq!(numbers, [(4, 1), (7, 2), (8, 3), (9, 4)]);
    let long = "x".repeat(400);
    let rows =
        (0..300).map(|row| format!("{long},2026-04-07 10:{:02}:{:02},4\n", row / 60, row % 60));
    let text = format!("note,timestamp,power_W\n{}", rows.collect::<String>());
    assert_eq!(read(&files, &text, "-").unwrap().rows(), 300);
}

/// Four rows, of which two are before `broken`.
fn around(broken: &str) -> String {
    format!("time,power_W\n0,4.5\n1,4.6\n{broken}2,4.7\n3,4.8\n")
}

#[test]
fn lines_that_are_no_rows_are_named_and_the_whole_rows_are_kept_on_request() {
    let files = Files::new();
    let head = "time,power_W\n0,4.5\n1,4.6\n2,4.7\n3,4.8\n";
    let nul = "\0".repeat(4096);
    for (name, text, row, what, in_front) in [
        ("cut", format!("{head}4"), 6, "may be cut", 4),
        ("nul", format!("{head}{nul}"), 6, "4096 NUL bytes", 4),
        ("nul within", around(&format!("{nul}\n")), 4, "4096 NUL bytes", 2),
        ("comment", around("# restarted\n"), 4, "a comment", 2),
        ("header", around("time,power_W\n"), 4, "the header again", 2),
        ("merged", around("1.5,1.7,4.6\n"), 4, "found 3 fields, the header has 2", 2),
        ("word", around("1.5,off\n"), 4, "\"off\"", 2),
        ("empty", around(",\n"), 4, "an empty line", 2),
        ("units", head.replacen('\n', "\ns,W\n", 1), 2, "units or words", 0),
    ] {
        let path = files.write("broken.csv", text.as_bytes());
        let error = Trial::read(&path).unwrap_err().to_string();
        assert_contains(&error, ["broken.csv", &format!("row {row}")]);
        if name != "word" {
            assert_contains(&error, [what, "--whole-rows", "leave the file out"]);
        }
        let check =
            check_files(std::slice::from_ref(&path), &ColumnMap::default(), &Limits::default(), 3);
        let finding = check.finding(FindingKind::NoRow).expect(name);
        assert!(finding.fault && finding.count == 1 && check.rows == 4, "{name}: {check:?}");
        assert_contains(&finding.places[0].to_string(), [what, &format!("row {row}")]);
        let whole = ColumnMap::default().whole_rows(true);
        let trial = Table::only_of(&path, &whole).unwrap().into_trial().unwrap();
        assert_eq!(trial.column(Column::Power), Some([4.5, 4.6, 4.7, 4.8].as_slice()), "{name}");
        assert_eq!(trial.notes().left_out.lines, 1, "{name}");
        assert_eq!(trial.file_row(3), if in_front == 4 { 5 } else { 6 }, "{name}");
        assert_contains(
            &trial.notes().to_string(),
            ["1 lines that are no whole rows were left out", what],
        );
        let asked = check_files(&[path], &whole, &Limits::default(), 3);
        assert!(
            asked.finding(FindingKind::NoRow).is_some_and(|one| one.accepted && !one.fault),
            "{name}"
        );
    }
}

#[test]
fn a_compressed_text_without_its_end_keeps_its_rows_on_request() {
    let files = Files::new();
    let rows: String = (0..500).map(|row| format!("{row},{}\n", row * row % 97)).collect();
    let whole = gzip(format!("time,power_W\n{rows}").as_bytes());
    let path = files.write("cut.csv.gz", &whole[..whole.len() / 2]);
    assert_eq!(fault(Trial::read(&path)), Fault::Truncated);
    let trials = Trial::read_mapped(&path, &ColumnMap::default().whole_rows(true)).unwrap();
    assert!((50..500).contains(&trials[0].rows()), "{}", trials[0].rows());
    assert_eq!(trials[0].notes().left_out.lines, 1);
}

#[test]
fn a_text_of_which_most_lines_are_no_rows_is_refused_though_whole_rows_are_wanted() {
    let files = Files::new();
    let path = files.write("log.csv", b"time,power_W\n0,1\n1,1\nx,y,z\nx,y,z\nx,y,z\n");
    let whole = ColumnMap::default().whole_rows(true);
    let refused = Trial::read_mapped(path, &whole).unwrap_err();
    assert_eq!(refused.fault(), Fault::FieldCount);
    assert_contains(&refused.to_string(), ["row 4"]);
}

#[test]
fn files_of_other_programs_are_named_with_how_they_are_converted() {
    let files = Files::new();
    let tar = [vec![b'a'; 257], b"ustar\0".to_vec()].concat();
    for (bytes, what, remedy) in [
        (&b"MATLAB 7.3 MAT-file, Platform: posix"[..], "MATLAB", "joulebus.read_table"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64", "MATLAB", "scipy.io.loadmat"),
        (b"PAR1\x15\x04\x15", "Parquet", "pandas.read_parquet"),
        (b"SQLite format 3\0\x10", "SQLite", "joulebus.read_bag"),
        (b"\x89HDF\r\n\x1a\n\0", "HDF5", "h5py"),
        (b"#ROSBAG V2.0\n\x45\0\0\0", "bag of ROS 1", "joulebus.read_bag"),
        (b"ULog\x01\x12\x35\x01\0\0", "ULog", "ulog2csv"),
        (b"ARROW1\0\0\x10\0\0\0", "Feather", "read_feather"),
        (b"\x28\xb5\x2f\xfd\x04\x58", "zstd", "zstd -d"),
        (b"BZh91AY&SY", "bzip2", "bzip2 -d"),
        (b"\x80\x05\x95\xda\x28", "pickle", "Only if you trust it"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "Git LFS", "git lfs pull"),
        (b"\xff\xfet\0i\0m\0e\0", "UTF-16", "iconv"),
        (b"{\"time\": [0, 1]}", "JSON", "read_json"),
        (b"<!DOCTYPE html>", "web page", "raw"),
        (&tar, "tar", "unpack"),
    ] {
        for name in ["log.csv", "log.mat"] {
            let error = Trial::read(files.write(name, bytes)).unwrap_err();
            assert_eq!(error.fault(), Fault::Kind, "{what}: {error:?}");
            assert_contains(&error.to_string(), [name, what, remedy]);
        }
        let error = Trial::read(files.write("log.csv.gz", &gzip(bytes))).unwrap_err();
        assert_contains(&error.to_string(), [what, "in gzip"]);
    }
    // What is read is none of them.
    Trial::read(files.write("log.csv", csv(&ROWS).as_bytes())).unwrap();
    Trial::read(files.write("log", &npy_f8(&ROWS))).unwrap();
}

/// Settings of a config are for the files of the platform's own program, not for converted ones.
#[test]
fn configured_columns_and_signs_are_for_files_that_have_them() {
    let files = Files::new();
    let columns = "power_W=p,current_A=i".split(',').map(|one| one.parse().unwrap());
    let map =
        ColumnMap::default().configured(columns.collect()).configured_discharge_negative(true);
    let read = |text: &str, map: &ColumnMap| {
        let path = files.write("log.csv", text.as_bytes());
        Table::only_of(path, map)
    };
    let theirs = read("time,p,i\n0,-4.5,-1\n1,-4.6,-1\n", &map).unwrap();
    let ours = read("timestamp_s,power_mW,current_mA\n0,4500,1000\n1,4600,1000\n", &map).unwrap();
    for table in [theirs, ours] {
        assert_eq!(table.column(Column::Power), Some(&[4500.0, 4600.0][..]));
        assert_eq!(table.column(Column::Current), Some(&[1000.0, 1000.0][..]));
    }
    // Without columns in the config, what `data convert` wrote is known by its header.
    let sign = ColumnMap::default().configured_discharge_negative(true);
    let turned = read("time,power_W,current_A\n0,-4.5,-1\n1,-4.6,-1\n", &sign).unwrap();
    turned.write(&files.write("x", b"").with_file_name("converted.csv")).unwrap();
    let converted = Table::only_of(files.write("x", b"").with_file_name("converted.csv"), &sign);
    assert_eq!(converted.unwrap().column(Column::Current), turned.column(Column::Current));
    assert_eq!(turned.column(Column::Current), Some(&[1000.0, 1000.0][..]));
    // One of them is missing: it is a broken file of that program.
    let error = read("time,p\n0,4.5\n1,4.6\n", &map).unwrap_err();
    assert_contains(&error.to_string(), ["mapped: current=i"]);
    // Columns that the caller names must be there.
    let columns_of_power = mapped("power_W=p");
    assert!(read("time,power_W\n0,4.5\n1,4.6\n", &columns_of_power).is_err());
}

/// A robot whose first row is after midnight has the same day as the others.
#[test]
fn midnight_is_that_of_the_file_and_not_of_each_robot() {
    let files = Files::new();
    let text = "robot,time,power_W\na,23:59:58,4\na,23:59:59,4\na,00:00:00,4\nb,00:00:01,4\nb,00:00:02,4\n";
    let path = files.write("log.csv", text.as_bytes());
    let tables = Table::read_robots(path).unwrap();
    assert_eq!(tables[0].timestamp_s(), [86_398.0, 86_399.0, 86_400.0]);
    assert_eq!(tables[1].timestamp_s(), [86_401.0, 86_402.0]);
}

#[test]
fn a_robot_may_have_a_name_that_begins_as_a_comment() {
    let files = Files::new();
    let text = "robot_id,time,power_W\n#3,0,4.5\n#3,1,4.6\n";
    let path = files.write("log.csv", text.as_bytes());
    assert_eq!(Table::read(path).unwrap().robot_name(), Some("#3"));
    let error = read(&files, &format!("{text}# the end\n"), "-").unwrap_err();
    assert_contains(&error.to_string(), ["row 4", "a comment"]);
}

/// Kinds of text that were found in public logs, each with what it is read as.
#[test]
fn headers_below_other_lines_units_in_brackets_and_behind_values_are_understood() {
    let files = Files::new();
    let read = |text: &str, map: &str| {
        let columns = map.split(',').filter(|one| !one.is_empty());
        let columns: Vec<_> = columns.map(|one| one.parse().unwrap()).collect();
        let table = Table::only_of(files.write("log.csv", text.as_bytes()), &columns.into());
        table.unwrap_or_else(|error| panic!("{text}: {error}"))
    };
    for (text, map) in [
        ("Report of 3 readings, 4.5 W\n\nTime (s),Power (W)\n0,4.5\n1,4.6\n", ""),
        ("Time (s),Power (W)\n0,4.5 W\n1,4.6W\n", ""),
        ("MonoS,CH0,CH1\n0,9.0V,0.5A\n1,9.2V,0.5 A\n", "time=MonoS,voltage_V=CH0,current_A=CH1"),
        ("time_s,current (cA),voltage (cV)\n0,50,900\n1,50,920\n", ""),
    ] {
        let power = read(text, map).column(Column::Power).unwrap().to_vec();
        assert_eq!(power, [4500.0, 4600.0], "{text}");
    }
    let understood = read("made by me\nt,power_W\n0,1\n1,2\n", "");
    assert_contains(&understood.understood().join(", "), ["line 2"]);
    let percent = read("t,power_W,SOC (%)\n0,4.5,80\n1,4.6,79\n", "");
    assert_eq!(percent.column(Column::Soc), Some(&[0.8, 0.79][..]));
    // A unit of another size is none of the column's.
    let other = files.write("log.csv", b"time_s,power_W\n0,4500mW\n1,4600mW\n");
    assert_eq!(fault(Trial::read(other)), Fault::Value);
}

/// A text of rows of a template.
fn table(header: &str, template: &str, rows: u32) -> String {
    let rows: String = (0..rows).map(|number| row(template, number) + "\n").collect();
    format!("{header}\n{rows}")
}

/// Words that a message has, and behind a `!` those that it has not.
fn assert_says(message: &str, words: &[String]) {
    for word in words {
        match word.strip_prefix('!') {
            Some(never) => assert!(!message.contains(never), "{never}: {message}"),
            None => assert_contains(message, [word]),
        }
    }
}

/// Options are tried on the first rows: those that leave a finding, or a time that repeats, are not
/// proposed. Of several none is chosen.
#[test]
fn what_is_missing_is_named_with_the_options_that_work() {
    let files = Files::new();
    // No unit of the last is that of a robot.
    for case in cases(
        r"
        Time,Voltage,Current,Power | {s},{V},{A},{W} | --map 'voltage_V=Voltage,current_A=Current' | --map 'power_W=Power' | none is chosen | !sum
        at_date,power_W | {s},{W} | Name them: --map 'time_s=at_date'
        epoch_ms,local_time,seconds_from_start,watts,kwh | {epoch_ms},2026-04-07 10:59:4{tens},{s},{W},0.1 | time_ms=epoch_ms,power_W=watts | time_s=seconds_from_start,power_W=watts | !=local_time | !=kwh
        TimeUS,Inst,Volt,Curr,CurrTot | {us},{inst},{V},{A/inst},0.1 | Name them: --map 'time_us=TimeUS,voltage_V=Volt,current_A=Curr,robot=Inst'
        time_s,voltage_1_V,current_1_A,voltage_2_V,current_2_A | {s},{V},{A},{V},{0.7A} | --map 'voltage=voltage_1_V,current=current_1_A', or --map 'voltage=voltage_2_V,current=current_2_A' | their sum: --map 'power_W=voltage_1_V*current_1_A+voltage_2_V*current_2_A'
        interval_ms,power_mW | 100,{mW} | df['interval_ms'].cumsum() / 1000 | !--map
        a,b | {s},{W} | such as --map time=t,power_W=p
        time,power | {s},{MW} | such as | !power_W=power
        ",
    ) {
        let [header, template, words @ ..] = case.as_slice() else {
            panic!("{case:?}");
        };
        let path = files.write("log.csv", table(header, template, 120).as_bytes());
        let error = Trial::read(&path).unwrap_err().to_string();
        assert_says(&error, words);
        // Each works on the whole file.
        for option in error.split("--map '").skip(1) {
            let columns = mapped(option.split('\'').next().unwrap());
            let trials = Trial::read_mapped(&path, &columns).unwrap();
            let found = trials.iter().flat_map(|trial| judge(trial, &Limits::default()));
            assert_eq!(found.filter(|one| one.finding.is_error()).count(), 0, "{option}");
        }
    }
}

/// Forms of numbers, times and rows that were found in public logs.
#[test]
fn forms_of_rows_that_can_mean_one_thing_are_read() {
    let files = Files::new();
    // Header, a row, `--map`, the first time, the period, and a note.
    for case in cases(
        r#"
        Timestamp,Power_W | 04/07/2026 10:59:4{tens}.{ones}00000 AM,{n+5} | - | 1775559580 | 0.1 | month, day and year
        Timestamp,Power_W | 07.04.2026 10:59:4{tens}.{ones}00,{n+5} | - | 1775559580 | 0.1 | -
        timestamp,power_W | Tue Apr 07 2026 12:59:{40+n} GMT+0200 (CEST),{n+5} | - | 1775559580 | 1 | -
        time,power_W | 59:4{tens}.{ones},{n+5} | - | 3580 | 0.1 | without the hour
        asctime,power_W,x | 2026-04-07 10:59:4{tens},{ones}00,{n+5},0 | time=asctime | 1775559580 | 0.1 | -
        t,power_mW | {n},"{n+5},000.0" | time_s=t | 0 | 1 | -
        Time,Power | 2026-04-07 10:59:{40+n},{mixed} | - | 1775559580 | 1 | -
        Date,Time,Power_W | 2026-04-0{day},10:59:4{ones},{n+5} | - | 1775559580 | 1 | -
        timestamp,power_W | 2026-04-07T10:59:{59-n},{24-n} | - | 1775559580 | 1 | newest first
        timestamp,power_W | {down_ms},{24-n} | - | 1775559580 | 1 | newest first
        t,a,b | {n},{n+3},2 | time_s=t,power_W=a+b | 0 | 1 | -
        t,a,b | {n},{n+7},2 | time_s=t,power_W=a-b | 0 | 1 | -
        t,u 1,i-1,c | {n},2,{n/2+1},3 | time_s=t,power_W=u 1*i-1+c | 0 | 1 | -
        t,power_W,vx,vy | {n},{n+5},0.3,0.4 | time_s=t | 0 | 1 | -
        t,power_W,vx_mmps,vy_mmps | {n},{n+5},300,400 | time_s=t,v=vx_mmps | 0 | 1 | -
        "#,
    ) {
        let [header, template, columns, first_s, period_s, note] = case.as_slice() else {
            panic!("{case:?}");
        };
        let [first_s, period_s] = [first_s, period_s].map(|text| text.parse::<f64>().unwrap());
        let trial = read(&files, &table(header, template, 20), columns);
        let trial = trial.unwrap_or_else(|error| panic!("{header}: {error}"));
        let times_s = trial.timestamp_s();
        assert!((times_s[0] - first_s).abs() < 1e-6, "{header}: {times_s:?}");
        assert!((times_s[1] - times_s[0] - period_s).abs() < 1e-6, "{header}: {times_s:?}");
        let power_w = trial.column(Column::Power).unwrap();
        let expected: Vec<f64> = (5..25).map(f64::from).collect();
        let is_near = |(found, expected): (&f64, &f64)| (found - expected).abs() < 1e-9;
        assert!(power_w.iter().zip(&expected).all(is_near), "{header}: {power_w:?}");
        let notes = trial.notes().to_string();
        assert!(note == "-" || notes.contains(note), "{header}: {notes}");
        if header.contains("vy") {
            assert_eq!(trial.column(Column::V), Some(&[0.5; 20][..]));
        }
        if header.starts_with("Date") {
            assert!((times_s[10] - times_s[9] - 86_391.0).abs() < 1e-6, "{times_s:?}");
        }
        if note == "newest first" {
            assert_eq!((trial.file_row(0), trial.file_row(19)), (21, 2));
        }
    }
    for case in cases(
        r#"
        timestamp,power_W | 1.77556E+12,{n} | - | 1 different times in 20 rows | spreadsheet
        time,power_W | 07/04/2026 10:59:{40+n},{n} | - | row 2 | 07/04/2026
        t,power_W | {n},"1,50{ones}" | time_s=t | could separate thousands
        "#,
    ) {
        let [header, template, columns, words @ ..] = case.as_slice() else {
            panic!("{case:?}");
        };
        let error = read(&files, &table(header, template, 20), columns).unwrap_err();
        assert_says(&error.to_string(), words);
    }
}

/// A remedy is tried before it is told, and a column that tells sources apart, or that looks like a
/// command, is named.
#[test]
fn remedies_that_work_are_told_with_their_columns() {
    let files = Files::new();
    // Turned, the last is as wrong: every tenth reading is of the other sign.
    for case in cases(
        r"
        t_s,sensor,power_W | {s},m{inst},{W/inst} | alternates between two levels | --map robot=sensor
        t_s,cmd_speed,power_W | {s},0.3,{W} | cmd_speed looks like a command | --map 'v_mps=cmd_speed'
        t_s,voltage_V,current_A | {s},{V},{-A} | --current discharge-negative
        t_s,v_cmd_mps,power_W | {s},0.3,{±W} | its sign is not reliable | !--current
        ",
    ) {
        let [header, template, words @ ..] = case.as_slice() else {
            panic!("{case:?}");
        };
        let path = files.write("log.csv", table(header, template, 300).as_bytes());
        let found = judge(&Trial::read(path).unwrap(), &Limits::default());
        assert_says(&found.iter().map(|one| one.place.to_string()).collect::<String>(), words);
    }
}

#[test]
fn a_time_in_another_unit_is_named() {
    let files = Files::new();
    for (per_second, unit) in [(1e3, "ms"), (1e6, "us")] {
        let rows =
            (0..200).map(|row| format!("{},{}\n", f64::from(row) * 0.1 * per_second, row % 7));
        let text = format!("timestamp_s,power_W\n{}", rows.collect::<String>());
        let path = files.write("log.csv", text.as_bytes());
        let found = judge(&Trial::read(path).unwrap(), &Limits::default());
        let remedies: String = found.into_iter().map(|one| one.remedy).collect();
        assert_contains(&remedies, [&format!("--map time_{unit}=timestamp_s")]);
    }
}
