//! Which files are read, in which units, and the messages of refusals.

use joulebus_dataset::trial::{Column, Gap, MAX_ROWS, Trial, TrialError};
use joulebus_testkit::trials::{Files, ROWS, csv, gzip, header, npy, npy_f8, timed};

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
    let f_order = (0..11)
        .flat_map(|column| ROWS.map(|row| row[column]))
        .collect::<Vec<_>>();
    let le = |values: &[f64]| {
        values
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect::<Vec<_>>()
    };
    let be = |values: &[f64]| {
        values
            .iter()
            .flat_map(|v| v.to_be_bytes())
            .collect::<Vec<_>>()
    };
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
        (
            "big_endian.npy",
            npy(&header(">f8", "False", 5), &be(&c_order)),
        ),
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

/// A file name, its contents, the expected error, and what its message must contain.
type Refusal = (
    &'static str,
    Vec<u8>,
    fn(&TrialError) -> bool,
    &'static [&'static str],
);

fn assert_refused(cases: Vec<Refusal>) {
    let files = Files::new();
    for (name, bytes, is_expected, parts) in cases {
        let error = match Trial::read(files.write(name, &bytes)) {
            Ok(_) => panic!("{name} was read"),
            Err(error) => error,
        };
        assert!(is_expected(&error), "{name}: {error:?}");
        let message = error.to_string();
        for part in [&[name], parts].concat() {
            assert!(
                message.contains(part),
                "{name}: {part:?} not in {message:?}"
            );
        }
    }
}

#[test]
fn malformed_text_is_refused_with_row_column_what_was_found_and_what_is_allowed() {
    let text = csv(&ROWS);
    let with = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1).into_bytes()
    };
    let row = |values: &str| format!("timestamp,power_mW\n0,1\n{values}\n").into_bytes();
    assert_refused(vec![
        (
            "empty.csv",
            vec![],
            |e| matches!(e, TrialError::Empty { .. }),
            &["empty"],
        ),
        (
            "no_time.csv",
            with("timestamp_s", "clock"),
            |e| matches!(e, TrialError::MissingColumns { .. }),
            &["timestamp_s, timestamp", "robot_id, clock, phase", "--map"],
        ),
        (
            "no_power.csv",
            // With voltage and current, power would be their product.
            String::from_utf8(with("power_mW", "power"))
                .unwrap()
                .replacen("voltage_mV", "tension", 1)
                .into_bytes(),
            |e| matches!(e, TrialError::MissingColumns { .. }),
            &["power_mW", "power_W", "voltage and current"],
        ),
        (
            "semicolons.csv",
            text.replace(',', ";").into_bytes(),
            |e| matches!(e, TrialError::Separator { found: ';', .. }),
            &["';'", "commas"],
        ),
        (
            "no_header.csv",
            text.split_once('\n').unwrap().1.as_bytes().to_vec(),
            |e| matches!(e, TrialError::MissingColumns { .. }),
            &["timestamp_s"],
        ),
        (
            "twice.csv",
            with("v_cmd_mps,omega_cmd_radps", "v_cmd_mps,v_cmd"),
            |e| matches!(e, TrialError::DuplicateColumn { .. }),
            &["v_cmd_mps", "v_cmd"],
        ),
        (
            "word.csv",
            with("3550", "n/a"),
            |e| {
                matches!(
                    e,
                    TrialError::Value {
                        row: 3,
                        column: "power_mW",
                        ..
                    }
                )
            },
            &["row 3", "power_mW", "\"n/a\"", "a number, NaN, or nothing"],
        ),
        (
            "comma.csv",
            with("100.1", "\"100,1\""),
            |e| {
                matches!(
                    e,
                    TrialError::Value {
                        row: 2,
                        column: "timestamp_s",
                        ..
                    }
                )
            },
            &["100,1"],
        ),
        (
            "latin.csv",
            [b"timestamp,power_mW\n0,\xb5\n".as_slice()].concat(),
            |e| matches!(e, TrialError::Value { row: 1, .. }),
            &["row 1"],
        ),
        (
            "inf.csv",
            with("3550", "inf"),
            |e| {
                matches!(
                    e,
                    TrialError::Value {
                        row: 3,
                        column: "power_mW",
                        ..
                    }
                )
            },
            &["\"inf\"", "finite"],
        ),
        (
            "huge.csv",
            with("3550", "1e300"),
            |e| matches!(e, TrialError::Value { row: 3, .. }),
            &["finite"],
        ),
        (
            "late.csv",
            row("1e10,1"),
            |e| {
                matches!(
                    e,
                    TrialError::Value {
                        row: 2,
                        column: "timestamp_s",
                        ..
                    }
                )
            },
            &["10000000000", "4e9"],
        ),
        (
            "no_stamp.csv",
            row("NaN,1"),
            |e| {
                matches!(
                    e,
                    TrialError::Value {
                        row: 2,
                        column: "timestamp_s",
                        ..
                    }
                )
            },
            &["NaN"],
        ),
        (
            "short_row.csv",
            row("1"),
            |e| {
                matches!(
                    e,
                    TrialError::FieldCount {
                        row: 2,
                        found: 1,
                        expected: 2,
                        ..
                    }
                )
            },
            &["row 2", "1 fields", "has 2"],
        ),
        (
            "long_row.csv",
            row("1,2,3"),
            |e| {
                matches!(
                    e,
                    TrialError::FieldCount {
                        row: 2,
                        found: 3,
                        expected: 2,
                        ..
                    }
                )
            },
            &[],
        ),
        (
            "second.csv",
            with("\n7,100.2", "\n8,100.2"),
            |e| matches!(e, TrialError::SecondRobot { row: 3, .. }),
            &["\"8\" after robot \"7\""],
        ),
        (
            "header_only.csv",
            b"timestamp,power_mW\n".to_vec(),
            |e| matches!(e, TrialError::NoPeriod { rows: 0, .. }),
            &["0 rows"],
        ),
        (
            "one_row.csv",
            b"timestamp,power_mW\n0,1\n".to_vec(),
            |e| matches!(e, TrialError::NoPeriod { rows: 1, .. }),
            &["two rows"],
        ),
        (
            "standing.csv",
            row("0,1"),
            |e| matches!(e, TrialError::NoPeriod { rows: 2, .. }),
            &["no timestamp advances"],
        ),
        (
            "table.npz",
            b"PK\x03\x04\x14\x00\x00\x00\x08\x00".to_vec(),
            |e| matches!(e, TrialError::Kind { .. }),
            &["zip"],
        ),
        (
            "array.npy.gz",
            gzip(&npy_f8(&ROWS)),
            |e| matches!(e, TrialError::Kind { .. }),
            &["decompress"],
        ),
        (
            "text.npy",
            text.clone().into_bytes(),
            |e| matches!(e, TrialError::Kind { .. }),
            &["not a NumPy array"],
        ),
        (
            "flipped.csv.gz",
            {
                let mut bytes = gzip(text.as_bytes());
                let at = bytes.len() - 6;
                bytes[at] ^= 1;
                bytes
            },
            |e| matches!(e, TrialError::Gzip { rows: 5, .. }),
            &["damaged gzip data after 5"],
        ),
    ]);
}

#[test]
fn arrays_of_another_layout_are_refused_and_pickles_are_never_opened() {
    let data = |values: usize| vec![0; values * 8];
    let shape = |shape: &str, data: &[u8]| {
        npy(
            &format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}"),
            data,
        )
    };
    let descr = |descr: &str| {
        npy(
            &format!("{{'descr': {descr}, 'fortran_order': False, 'shape': (5, 11), }}"),
            &data(55),
        )
    };
    let nested = format!("{{'descr': '<f8', 'shape': {}1,", "(".repeat(9_000));
    let mut long_header = b"\x93NUMPY\x02\x00\xff\xff\xff\xff".to_vec();
    long_header.extend([b' '; 100]);
    let mut future = npy_f8(&ROWS);
    future[6] = 9;
    let is_shape: fn(&TrialError) -> bool = |e| matches!(e, TrialError::Shape { .. });
    let is_header: fn(&TrialError) -> bool = |e| matches!(e, TrialError::NpyHeader { .. });
    let is_type: fn(&TrialError) -> bool = |e| matches!(e, TrialError::ElementType { .. });
    assert_refused(vec![
        (
            "object.npy",
            descr("'|O'"),
            |e| matches!(e, TrialError::ObjectArray { .. }),
            &["Python objects", "never read", "float64"],
        ),
        ("int.npy", descr("'<i8'"), is_type, &["<i8", "f8"]),
        ("half.npy", descr("'<f2'"), is_type, &["<f2"]),
        ("complex.npy", descr("'<c16'"), is_type, &["<c16"]),
        (
            "record.npy",
            descr("[('a', '<f8'), ('b', '|O')]"),
            is_type,
            &["record"],
        ),
        (
            "narrow.npy",
            shape("(5, 10)", &data(50)),
            is_shape,
            &["5, 10", "(n, 11)"],
        ),
        (
            "wide.npy",
            shape("(5, 13)", &data(65)),
            is_shape,
            &["5, 13"],
        ),
        ("flat.npy", shape("(55,)", &data(55)), is_shape, &["55"]),
        (
            "cube.npy",
            shape("(5, 11, 1)", &data(55)),
            is_shape,
            &["5, 11, 1"],
        ),
        ("one.npy", shape("(1, 11)", &data(11)), is_shape, &["n ≥ 2"]),
        ("none.npy", shape("(0, 11)", &data(0)), is_shape, &["0, 11"]),
        (
            "overflow.npy",
            shape("(18446744073709551615, 11)", &data(55)),
            is_shape,
            &["18446744073709551615"],
        ),
        (
            "negative.npy",
            shape("(-5, 11)", &data(55)),
            is_header,
            &["-5"],
        ),
        (
            "many.npy",
            shape(&format!("({}, 11)", MAX_ROWS + 1), &data(55)),
            |e| matches!(e, TrialError::TooManyRows { .. }),
            &["4194304 rows"],
        ),
        (
            "claim.npy",
            shape("(4000000, 11)", &data(55)),
            |e| matches!(e, TrialError::Truncated { rows: 5, .. }),
            &["truncated", "after 5 complete rows"],
        ),
        (
            "trailing.npy",
            [npy_f8(&ROWS), vec![0]].concat(),
            |e| matches!(e, TrialError::TrailingBytes { rows: 5, .. }),
            &["5 rows end at"],
        ),
        (
            "nested.npy",
            npy(&nested, &[]),
            is_header,
            &["allowed: {'descr'"],
        ),
        (
            "sum.npy",
            npy(
                "{'descr': 1+2j, 'fortran_order': False, 'shape': (5, 11), }",
                &data(55),
            ),
            is_header,
            &[],
        ),
        (
            "order.npy",
            npy("{'descr': '<f8', 'shape': (5, 11), }", &data(55)),
            is_header,
            &[],
        ),
        (
            "long_header.npy",
            long_header,
            is_header,
            &["4294967295", "10000"],
        ),
        ("future.npy", future, is_header, &["version 9"]),
        (
            "inf.npy",
            {
                let mut rows = ROWS;
                rows[3][8] = f64::NEG_INFINITY;
                npy_f8(&rows)
            },
            |e| {
                matches!(
                    e,
                    TrialError::Value {
                        row: 4,
                        column: "voltage_mV",
                        ..
                    }
                )
            },
            &["-inf"],
        ),
        (
            "second.npy",
            {
                let mut rows = ROWS;
                rows[3][0] = 8.0;
                npy_f8(&rows)
            },
            |e| matches!(e, TrialError::SecondRobot { row: 4, .. }),
            &["\"8\""],
        ),
    ]);
}

#[test]
fn a_missing_file_is_named() {
    let error = Trial::read("no/such/trial.npy").unwrap_err();
    assert!(matches!(error, TrialError::Io { .. }));
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
    let gap = Gap {
        row: 8,
        length_ns: 160_000_000,
    };
    assert_eq!(notes.gaps, [gap]);
    assert_eq!(notes.held_readings, 3, "rows 2, 7 and 8");
    assert_eq!(notes.missing_readings, 1);
    assert_eq!(notes.missing_columns.len(), Column::ALL.len() - 1);
    assert!((notes.rate_hz - 10.0).abs() < 1e-6);
    assert!(!notes.is_clean());
    let text = notes.to_string();
    for part in [
        "10 rows at 10.00 Hz",
        "3 readings held",
        "1 readings missing",
        "1 gaps, the longest 0.160 s before row 8",
        "3 rows whose time does not advance, the first 4",
        "without phase v_cmd_mps",
    ] {
        assert!(text.contains(part), "{part:?} not in {text:?}");
    }
}

#[test]
fn the_text_in_a_small_compressed_file_is_bounded() {
    let files = Files::new();
    let head = b"timestamp_s,power_mW\n";
    let rows = |row: &[u8], bytes: usize| [head, row.repeat(bytes / row.len()).as_slice()].concat();
    // Rows without an end: zeros, a quoted field of many lines, a header.
    for (name, text) in [
        ("zeros.csv.gz", rows(b"\0", 64 << 20)),
        (
            "quoted.csv.gz",
            [head, b"\"".as_slice(), &b"x\n".repeat(4 << 20)].concat(),
        ),
        ("header.csv.gz", b"timestamp_s,".repeat(1 << 20)),
        ("plain.csv", rows(b"\0", 4 << 20)),
    ] {
        let text = if name.ends_with(".gz") {
            gzip(&text)
        } else {
            text
        };
        let refused = Trial::read(files.write(name, &text)).unwrap_err();
        assert!(
            matches!(refused, TrialError::RowTooLong { rows: 0, .. }),
            "{name}: {refused}"
        );
        assert!(refused.to_string().contains("1048576 bytes"), "{refused}");
    }
    // Valid rows, but too many for the size of the gzip file.
    let bomb = gzip(&rows(
        b"000000000000000000000000000000000000000000000000.5,1\n",
        20 << 20,
    ));
    let refused = Trial::read(files.write("bomb.csv.gz", &bomb)).unwrap_err();
    assert!(matches!(refused, TrialError::Expands { .. }), "{refused}");
    let (found, allowed) = (bomb.len().to_string(), (16 << 20).to_string());
    let message = refused.to_string();
    assert!(
        message.contains(&found) && message.contains(&allowed),
        "{message}"
    );
}
