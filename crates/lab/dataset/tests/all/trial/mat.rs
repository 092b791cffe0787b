//! Files of MATLAB, level 5.

use std::io::Write as _;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use joulebus_dataset::trial::{Column, Table, Trial, TrialError};
use joulebus_testkit::assert_contains;
use joulebus_testkit::trials::Files;

const DOUBLE: u8 = 6;

/// An element with its size in front, filled up to 8 bytes.
fn element(kind: u32, bytes: &[u8], is_big: bool) -> Vec<u8> {
    let word = |word: u32| match is_big {
        true => word.to_be_bytes(),
        false => word.to_le_bytes(),
    };
    let size = bytes.len() as u32;
    let mut made = Vec::new();
    if (1..=4).contains(&size) {
        // A small one.
        made.extend(word(size << 16 | kind));
    } else {
        made.extend(word(kind));
        made.extend(word(size));
    }
    made.extend(bytes);
    made.resize(made.len().next_multiple_of(8), 0);
    made
}

/// A variable; `values` in their own type, column by column.
fn variable(name: &str, class: u8, sizes: [u32; 2], values: (u32, &[u8]), is_big: bool) -> Vec<u8> {
    let words = |words: &[u32]| -> Vec<u8> {
        let bytes = words.iter().map(|word| match is_big {
            true => word.to_be_bytes(),
            false => word.to_le_bytes(),
        });
        bytes.flatten().collect()
    };
    let parts = [
        element(6, &words(&[u32::from(class), 0]), is_big),
        element(5, &words(&sizes), is_big),
        element(1, name.as_bytes(), is_big),
        element(values.0, values.1, is_big),
    ];
    element(14, &parts.concat(), is_big)
}

fn doubles(values: &[f64], is_big: bool) -> Vec<u8> {
    let bytes = values.iter().map(|value| match is_big {
        true => value.to_be_bytes(),
        false => value.to_le_bytes(),
    });
    bytes.flatten().collect()
}

fn file(variables: &[Vec<u8>], is_big: bool, is_zipped: bool) -> Vec<u8> {
    let mut bytes = b"MATLAB 5.0 MAT-file, Platform: GLNXA64".to_vec();
    bytes.resize(124, b' ');
    bytes.extend(if is_big { [1, 0] } else { [0, 1] });
    bytes.extend(if is_big { b"MI" } else { b"IM" });
    for variable in variables {
        if is_zipped {
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(variable).unwrap();
            let zipped = encoder.finish().unwrap();
            let mut tag = element(15, &[0; 8], is_big);
            tag.truncate(8);
            let size = zipped.len() as u32;
            let size = match is_big {
                true => size.to_be_bytes(),
                false => size.to_le_bytes(),
            };
            tag[4..].copy_from_slice(&size);
            bytes.extend([tag, zipped].concat());
        } else {
            bytes.extend(variable);
        }
    }
    bytes
}

/// Time, a voltage in whole mV, a row of currents, commands as a matrix, and what is no column.
fn log(is_big: bool, is_zipped: bool) -> Vec<u8> {
    let time_s: Vec<f64> = (0..50).map(|row| f64::from(row) * 0.033).collect();
    let current_a: Vec<f64> = (0..50).map(|row| 0.25 + f64::from(row % 7) * 0.01).collect();
    let commands: Vec<f64> = (0..100).map(f64::from).collect();
    let voltage_mv = (0..50_u16).map(|row| match is_big {
        true => (12_000 + row).to_be_bytes(),
        false => (12_000 + row).to_le_bytes(),
    });
    let voltage_mv: Vec<u8> = voltage_mv.flatten().collect();
    let of = |name, class, sizes, kind, bytes: &[u8]| {
        variable(name, class, sizes, (kind, bytes), is_big)
    };
    let variables = [
        of("t", DOUBLE, [50, 1], 9, &doubles(&time_s, is_big)),
        of("voltage_mV", DOUBLE, [50, 1], 4, &voltage_mv),
        of("current_A", DOUBLE, [1, 50], 9, &doubles(&current_a, is_big)),
        of("cmd", DOUBLE, [50, 2], 9, &doubles(&commands, is_big)),
        of("robot", 4, [1, 3], 4, &[0; 6]),
        of("rate", DOUBLE, [1, 1], 9, &doubles(&[30.0], is_big)),
        of("short", DOUBLE, [7, 1], 9, &doubles(&[1.0; 7], is_big)),
    ];
    file(&variables, is_big, is_zipped)
}

#[test]
fn vectors_and_matrices_are_columns_in_either_byte_order_compressed_and_not() {
    let files = Files::new();
    for (is_big, is_zipped) in [(false, false), (false, true), (true, false), (true, true)] {
        let path = files.write("log.mat", &log(is_big, is_zipped));
        let map = "v=cmd_1,omega=cmd_2".split(',').map(|one| one.parse().unwrap());
        let map = joulebus_dataset::trial::ColumnMap::from(map.collect::<Vec<_>>());
        let table = Table::only_of(&path, &map).unwrap();
        assert_eq!(table.rows(), 50);
        assert_eq!(table.timestamp_s()[2], 0.066);
        assert_eq!(table.column(Column::Voltage).unwrap()[49], 12_049.0);
        assert_eq!(table.column(Column::Current).unwrap()[1], 260.0);
        assert_eq!(table.column(Column::V).unwrap()[3], 3.0);
        assert_eq!(table.column(Column::Omega).unwrap()[3], 53.0);
        assert_contains(
            &table.understood().join(", "),
            ["robot is a text", "rate is a single number", "short has 7"],
        );
    }
    // A matrix whose columns are times.
    let values = doubles(&[0.0, 4.5, 0.1, 4.6, 0.2, 4.7], false);
    let wide = variable("d", DOUBLE, [2, 3], (9, &values), false);
    let path = files.write("wide.mat", &file(&[wide], false, false));
    let map: Vec<_> = "time=d_1,power_W=d_2".split(',').map(|one| one.parse().unwrap()).collect();
    let trial = &Trial::read_mapped(path, &map.into()).unwrap()[0];
    assert_eq!(trial.timestamp_s(), [0.0, 0.1, 0.2]);
    assert_eq!(trial.column(Column::Power), Some(&[4.5, 4.6, 4.7][..]));
}

#[test]
fn what_is_no_array_of_numbers_is_refused_by_name() {
    let files = Files::new();
    for (class, what) in [(1, "a cell array"), (2, "a struct"), (5, "a sparse matrix")] {
        let other = variable("log", class, [1, 1], (9, &[0; 8]), false);
        let path = files.write("log.mat", &file(&[other], false, false));
        let error = Trial::read(path).unwrap_err().to_string();
        assert_contains(&error, [what, "log is", "writetable"]);
    }
    let path = files.write("log.mat", &file(&[], false, false));
    assert_contains(&Trial::read(path).unwrap_err().to_string(), ["no variables"]);
}

/// However it is damaged: an error, or a trial.
#[test]
fn a_damaged_file_is_an_error_or_a_trial() {
    let files = Files::new();
    let mut refused = 0;
    for is_zipped in [false, true] {
        let whole = log(false, is_zipped);
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] = if at % 3 == 0 { 0xff } else { whole[at] ^ 0x80 };
            refused += u32::from(Trial::read(files.write("log.mat", &damaged)).is_err());
        }
        for length in (19..whole.len()).step_by(7) {
            let read = Trial::read(files.write("log.mat", &whole[..length]));
            if let Err(error) = read {
                let is_reported = matches!(
                    error,
                    TrialError::Truncated { .. }
                        | TrialError::MissingColumns { .. }
                        | TrialError::Kind { .. }
                );
                assert!(is_reported, "{length} bytes: {error:?}");
                refused += 1;
            }
        }
    }
    assert!(refused > 200, "{refused}");
}
