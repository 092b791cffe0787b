//! Which files are read, in which units, and the messages of refusals.

use joulebus_dataset::trial::{Column, Fault, Gap, Trial};
use joulebus_testkit::trials::{Files, ROWS, csv, gzip, header, npy, npy_f8, timed};
use joulebus_testkit::{assert_contains, cases};

fn assert_is_rows(trial: &Trial, context: &str) {
    assert_eq!(trial.rows(), 5, "{context}");
    assert_eq!(trial.robot_name(), Some("7"), "{context}");
    let times = ROWS.map(|row| row[1]);
    assert_eq!(trial.timestamp_s(), times, "{context}");
    let wanted = [
        (Column::Phase, 2, 1.0),
        (Column::V, 3, 1.0),
        (Column::Omega, 4, 1.0),
        (Column::Voltage, 8, 1000.0),
        (Column::Current, 9, 1000.0),
        (Column::Power, 10, 1000.0),
    ];
    for (column, position, divisor) in wanted {
        let found = trial.column(column).unwrap();
        for (row, value) in found.iter().enumerate() {
            let expected = ROWS[row][position] / divisor;
            let same = *value == expected || (value.is_nan() && expected.is_nan());
            assert!(same, "{context}: {column:?} row {row}: {value} {expected}");
        }
    }
    for missing in [Column::X, Column::Y, Column::Theta, Column::VMeasured] {
        assert_eq!(trial.column(missing), None, "{context}: {missing:?}");
    }
}

#[test]
fn every_form_of_the_table_reads_as_the_same_trial_in_si_units() {
    let files = Files::new();
    let c_order = ROWS.as_flattened().to_vec();
    let f_order = (0..11).flat_map(|column| ROWS.map(|row| row[column])).collect::<Vec<_>>();
    let le = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>();
    let be = |values: &[f64]| values.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<_>>();
    let text = csv(&ROWS);
    let plain_names = text
        .replace("_s,", ",")
        .replace("_mps", "")
        .replace("_radps", "")
        .replace("x_m,y_m,theta_rad", "x,y,theta")
        .replace("voltage_mV", "voltage")
        .replace("current_mA", "current");
    assert!(plain_names.starts_with("robot_id,timestamp,phase,v_cmd,omega_cmd,x,y,theta,voltage,"));
    let reversed = text
        .lines()
        .map(|line| line.split(',').rev().collect::<Vec<_>>().join(",") + "\n")
        .collect::<String>();
    let cases: [(&str, Vec<u8>); 14] = [
        ("c.npy", npy_f8(&ROWS)),
        ("fortran.npy", npy(&header("<f8", "True", 5), &le(&f_order))),
        ("big_endian.npy", npy(&header(">f8", "False", 5), &be(&c_order))),
        ("npy_without_its_name", npy_f8(&ROWS)),
        ("table.csv", text.clone().into_bytes()),
        ("table.csv.gz", gzip(text.as_bytes())),
        ("gzip_without_its_name.csv", gzip(text.as_bytes())),
        ("text_named.csv.gz", text.clone().into_bytes()),
        ("two_members.csv.gz", {
            let (first, second) = text.split_at(150);
            [gzip(first.as_bytes()), gzip(second.as_bytes())].concat()
        }),
        ("plain_names.csv", plain_names.into_bytes()),
        ("reversed.csv", reversed.into_bytes()),
        ("windows.csv", text.replace('\n', "\r\n").into_bytes()),
        ("bom.csv", ["\u{feff}", &text].concat().into_bytes()),
        ("empty_fields.csv", text.replace("NaN", "").into_bytes()),
    ];
    for (name, bytes) in cases {
        let trial =
            Trial::read(files.write(name, &bytes)).unwrap_or_else(|error| panic!("{error}"));
        assert_is_rows(&trial, name);
        assert!(!trial.notes().no_final_line_break, "{name}");
    }
}

#[test]
fn an_array_of_f4_reads_with_the_precision_it_has() {
    let files = Files::new();
    let rows = ROWS.map(|row| row.map(|value| value as f32));
    let data = rows.iter().flatten().flat_map(|value| value.to_le_bytes());
    let bytes = npy(&header("<f4", "False", 5), &data.collect::<Vec<_>>());
    let trial = Trial::read(files.write("f4.npy", &bytes)).unwrap();
    let power_w = trial.column(Column::Power).unwrap();
    assert_eq!(power_w[2], f64::from(3550.0_f32) / 1000.0);
    assert_eq!(trial.column(Column::V).unwrap()[1], f64::from(0.2_f32));
}

#[test]
fn extra_columns_are_ignored_and_named() {
    let files = Files::new();
    let text = csv(&ROWS)
        .lines()
        .enumerate()
        .map(|(line, row)| format!("{row},{}\n", if line == 0 { "slip" } else { "no number" }))
        .collect::<String>();
    let trial = Trial::read(files.write("slip.csv", text.as_bytes())).unwrap();
    assert_is_rows(&trial, "slip");
    assert_eq!(trial.notes().ignored_columns, ["slip"]);
    assert!(!trial.notes().is_clean());
}

#[test]
fn time_and_power_suffice_for_a_trial_and_missing_values_are_not_zero() {
    let files = Files::new();
    let text = "timestamp,power_mW\n0,1000\n0.5,2000\n";
    let trial = Trial::read(files.write("two.csv", text.as_bytes())).unwrap();
    assert_eq!(trial.robot_name(), None);
    assert_eq!(trial.column(Column::Power), Some([1.0, 2.0].as_slice()));
    assert_eq!(trial.notes().missing_columns.len(), Column::ALL.len() - 1);
    assert!(trial.notes().is_clean());
    assert_eq!(trial.notes().rate_hz, 2.0);
}

/// Reads a file, which is refused with this fault. The message has the name of the file and
/// `parts`.
fn assert_refused(name: &str, bytes: &[u8], fault: &str, parts: &[String]) {
    let files = Files::new();
    let refused = match Trial::read(files.write(name, bytes)) {
        Ok(_) => panic!("{name} was read"),
        Err(error) => error,
    };
    let message = refused.to_string();
    assert_eq!(format!("{:?}", refused.fault()), fault, "{name}: {message}");
    assert!(message.contains(name), "{name}: {message}");
    for part in parts {
        assert!(message.contains(part), "{name}: {part:?} not in {message:?}");
    }
}

#[test]
fn malformed_text_is_refused_with_row_column_what_was_found_and_what_is_allowed() {
    let text = csv(&ROWS);
    for case in cases(
        r#"
        no_time.csv | timestamp_s | clock | MissingColumns | timestamp_s, timestamp | robot_id, clock, phase | --map
        twice.csv | v_cmd_mps,omega_cmd_radps | v_cmd_mps,v_cmd | DuplicateColumn | v_cmd_mps | v_cmd
        word.csv | 3550 | off | Value | row 4 | power_mW | "off" | a number, NaN, or nothing
        comma.csv | 100.1 | "100,1" | Value | row 3 | 100,1
        inf.csv | 3550 | inf | Value | row 4 | "inf" | finite
        huge.csv | 3550 | 1e300 | Value | row 4 | finite
        second.csv | \n7,100.2 | \n8,100.2 | SecondRobot | row 4 | "8" after robot "7"
        "#,
    ) {
        let [name, from, to, error, parts @ ..] = case.as_slice() else {
            panic!("{case:?}");
        };
        assert!(text.contains(from), "{from}");
        assert_refused(name, text.replacen(from, to, 1).as_bytes(), error, parts);
    }
    for case in cases(
        r#"
        empty.csv |  | Empty | empty
        late.csv | timestamp,power_mW\n0,1\n1e10,1\n | Value | row 3 | 1e10 | 4e9 | --map time_ms=timestamp
        no_stamp.csv | timestamp,power_mW\n0,1\nNaN,1\n | Value | row 3 | NaN
        short_row.csv | timestamp,power_mW\n0,1\n1\n | FieldCount | row 3 | 1 fields | has 2
        long_row.csv | timestamp,power_mW\n0,1\n1,2,3\n | FieldCount | row 3
        header_only.csv | timestamp,power_mW\n | NoPeriod | 0 rows
        one_row.csv | timestamp,power_mW\n0,1\n | NoPeriod | two rows
        standing.csv | timestamp,power_mW\n0,1\n0,1\n | NoPeriod | no timestamp advances
        "#,
    ) {
        let [name, text, error, parts @ ..] = case.as_slice() else {
            panic!("{case:?}");
        };
        assert_refused(name, text.as_bytes(), error, parts);
    }
    let refused = |name: &str, bytes: &[u8], error: &str, parts: &[&str]| {
        let parts: Vec<String> = parts.iter().map(|part| (*part).to_owned()).collect();
        assert_refused(name, bytes, error, &parts);
    };
    // With voltage and current, power would be their product.
    let no_power = text.replacen("power_mW", "power", 1);
    let no_power = no_power.replacen("voltage_mV", "tension", 1);
    let parts = ["power_mW", "power_W", "voltage and current"];
    refused("no_power.csv", no_power.as_bytes(), "MissingColumns", &parts);
    let (_, no_header) = text.split_once('\n').unwrap();
    let parts = ["first line has no names", "ros2 topic echo"];
    refused("no_header.csv", no_header.as_bytes(), "NoHeader", &parts);
    let latin = b"timestamp,power_mW\n0,\xb5\n";
    refused("latin.csv", latin, "Value", &["row 2"]);
    refused("t.npz", b"PK\x03\x04\x14\0\0\0\x08\0", "Kind", &["zip"]);
    let array = gzip(&npy_f8(&ROWS));
    refused("array.npy.gz", &array, "Kind", &["decompress"]);
    refused("text.npy", text.as_bytes(), "Kind", &["not a NumPy array"]);
    let mut flipped = gzip(text.as_bytes());
    let at = flipped.len() - 6;
    flipped[at] ^= 1;
    let parts = ["damaged gzip data after 5"];
    refused("flipped.csv.gz", &flipped, "Gzip", &parts);
}

#[test]
fn arrays_of_another_layout_are_refused_and_pickles_are_never_opened() {
    for case in cases(
        r"
        object.npy | '|O' | ObjectArray | Python objects | never read | float64
        int.npy | '<i8' | ElementType | <i8 | f8
        half.npy | '<f2' | ElementType | <f2
        complex.npy | '<c16' | ElementType | <c16
        record.npy | [('a', '<f8'), ('b', '|O')] | ElementType | record
        sum.npy | 1+2j | NpyHeader
        ",
    ) {
        let [name, descr, error, parts @ ..] = case.as_slice() else {
            panic!("{case:?}");
        };
        let header = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': (5, 11), }}");
        assert_refused(name, &npy(&header, &[0; 55 * 8]), error, parts);
    }
    for case in cases(
        "
        narrow.npy | (5, 10) | 50 | Shape | 5, 10 | (n, 11)
        wide.npy | (5, 13) | 65 | Shape | 5, 13
        flat.npy | (55,) | 55 | Shape | 55
        cube.npy | (5, 11, 1) | 55 | Shape | 5, 11, 1
        one.npy | (1, 11) | 11 | Shape | n ≥ 2
        none.npy | (0, 11) | 0 | Shape | 0, 11
        overflow.npy | (18446744073709551615, 11) | 55 | Shape | 18446744073709551615
        negative.npy | (-5, 11) | 55 | NpyHeader | -5
        many.npy | (999999999, 11) | 55 | Truncated | truncated
        claim.npy | (4000000, 11) | 55 | Truncated | truncated | after 5 complete rows
        ",
    ) {
        let [name, shape, values, error, parts @ ..] = case.as_slice() else {
            panic!("{case:?}");
        };
        let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
        let data = vec![0; 8 * values.parse::<usize>().unwrap()];
        assert_refused(name, &npy(&header, &data), error, parts);
    }
    let nested = format!("{{'descr': '<f8', 'shape': {}1,", "(".repeat(9_000));
    let mut long_header = b"\x93NUMPY\x02\x00\xff\xff\xff\xff".to_vec();
    long_header.extend([b' '; 100]);
    let mut future = npy_f8(&ROWS);
    future[6] = 9;
    let (mut infinite, mut second) = (ROWS, ROWS);
    infinite[3][8] = f64::NEG_INFINITY;
    second[3][0] = 8.0;
    let no_order = npy("{'descr': '<f8', 'shape': (5, 11), }", &[0; 55 * 8]);
    let trailing = [npy_f8(&ROWS), vec![0]].concat();
    let voltage = "Value";
    for (name, bytes, error, part) in [
        ("t.npy", trailing, "TrailingBytes", "5 rows end at"),
        ("n.npy", npy(&nested, &[]), "NpyHeader", "allowed: {'descr'"),
        ("order.npy", no_order, "NpyHeader", ""),
        ("long.npy", long_header.clone(), "NpyHeader", "4294967295"),
        ("long.npy", long_header, "NpyHeader", "10000"),
        ("future.npy", future, "NpyHeader", "version 9"),
        ("inf.npy", npy_f8(&infinite), voltage, "row 4, column voltage_mV: found \"-inf\""),
        ("s.npy", npy_f8(&second), "SecondRobot", "row 4: robot \"8\""),
    ] {
        assert_refused(name, &bytes, error, &[part.to_owned()]);
    }
}

#[test]
fn a_missing_file_is_named() {
    let error = Trial::read("no/such/trial.npy").unwrap_err();
    assert_eq!(error.fault(), Fault::Io);
    assert!(error.to_string().starts_with("no/such/trial.npy: "));
}

#[test]
fn every_flipped_byte_of_an_array_header_is_an_error_or_a_trial_never_a_panic() {
    let files = Files::new();
    let whole = npy_f8(&ROWS);
    for at in 0..128 {
        for flip in [0x01, 0x10, 0x20, 0x80, 0xff] {
            let mut bytes = whole.clone();
            bytes[at] ^= flip;
            if let Ok(trial) = Trial::read(files.write("flipped.npy", &bytes)) {
                assert_eq!(trial.rows(), 5, "byte {at}");
            }
        }
    }
}

#[test]
fn what_is_questionable_is_reported_with_its_row_and_kept() {
    let files = Files::new();
    let table = timed(&[
        (10.0, 1.0),
        (10.1, 1.0),
        (10.2, 2.0),
        (10.2, 3.0),
        (10.1, f64::NAN),
        (10.15, 3.0),
        (10.3, 3.0),
        (10.46, 3.0),
        (10.56, 4.0),
        (10.66, 5.0),
    ]);
    let trial = Trial::read(files.write("odd.npy", &npy_f8(&table))).unwrap();
    assert_eq!(trial.rows(), 10);
    let notes = trial.notes();
    assert_eq!(notes.rows, 10);
    assert_eq!(notes.not_advancing, [4, 5, 6]);
    let gap = Gap { row: 8, length_ns: 160_000_000 };
    assert_eq!(notes.gaps, [gap]);
    assert_eq!(notes.held_readings, 3, "rows 2, 7 and 8");
    assert_eq!(notes.missing_readings, 1);
    assert_eq!(notes.missing_columns.len(), Column::ALL.len() - 1);
    assert!((notes.rate_hz - 10.0).abs() < 1e-6);
    assert!(!notes.is_clean());
    let text = notes.to_string();
    let parts = "10 rows at 10.00 Hz | 3 readings held | 1 readings missing | \
        1 gaps, the longest 0.160 s before row 8 | \
        3 rows whose time does not advance, the first 4 | without phase v_cmd_mps";
    assert_contains(&text, parts.split(" | "));
}

#[test]
fn the_text_in_a_small_compressed_file_is_bounded() {
    let files = Files::new();
    let head = b"timestamp_s,power_mW\n";
    let rows = |row: &[u8], bytes: usize| [head, row.repeat(bytes / row.len()).as_slice()].concat();
    // Rows without an end: zeros, a quoted field of many lines, a header.
    for (name, text) in [
        ("zeros.csv.gz", rows(b"\0", 64 << 20)),
        ("quoted.csv.gz", [head, b"\"".as_slice(), &b"x\n".repeat(4 << 20)].concat()),
        ("header.csv.gz", b"timestamp_s,".repeat(1 << 20)),
        ("plain.csv", rows(b"\0", 4 << 20)),
    ] {
        let text = if name.ends_with(".gz") { gzip(&text) } else { text };
        let refused = Trial::read(files.write(name, &text)).unwrap_err();
        assert_eq!(refused.fault(), Fault::RowTooLong, "{name}: {refused}");
        assert!(
            refused.to_string().contains("1048576 bytes in the row after 0 whole rows"),
            "{refused}"
        );
    }
    // Valid rows, but too many for the size of the gzip file.
    let bomb = gzip(&rows(b"000000000000000000000000000000000000000000000000.5,1\n", 20 << 20));
    let refused = Trial::read(files.write("bomb.csv.gz", &bomb)).unwrap_err();
    assert_eq!(refused.fault(), Fault::Expands, "{refused}");
    let (found, allowed) = (bomb.len().to_string(), (16 << 20).to_string());
    let message = refused.to_string();
    assert_contains(&message, [&found, &allowed]);
}
