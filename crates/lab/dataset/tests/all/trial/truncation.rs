//! A truncated file is an error, or a shorter trial with a note.

use joulebus_dataset::inspect::{FindingKind, Limits, check_files};
use joulebus_dataset::trial::{ColumnMap, Fault, Trial};
use joulebus_testkit::assert_contains;
use joulebus_testkit::trials::{Files, ROWS, csv, gzip, header, npy, npy_f8};

#[test]
fn an_array_truncated_at_any_byte_is_reported_as_truncated() {
    let files = Files::new();
    let whole = npy_f8(&ROWS);
    for length in 1..whole.len() {
        let error = Trial::read(files.write("cut.npy", &whole[..length])).unwrap_err();
        let expected_rows = length.saturating_sub(whole.len() - 5 * 88) / 88;
        assert_eq!(error.fault(), Fault::Truncated, "{length} bytes: {error:?}");
        let rows = format!(" after {expected_rows} complete rows");
        assert_contains(&error.to_string(), ["truncated", &rows]);
    }
    Trial::read(files.write("cut.npy", &whole)).unwrap();
}

#[test]
fn a_truncated_array_keeps_its_whole_rows_on_request() {
    let files = Files::new();
    let whole = npy_f8(&ROWS);
    let map = ColumnMap::default().whole_rows(true);
    for missing in [1, 88, 100, 264, 265] {
        let path = files.write("cut.npy", &whole[..whole.len() - missing]);
        let read = Trial::read_mapped(&path, &map);
        let rows = 5 - missing.div_ceil(88);
        if rows < 2 {
            assert_eq!(read.unwrap_err().fault(), Fault::Truncated);
            continue;
        }
        let trial = &read.unwrap()[0];
        assert_eq!(trial.timestamp_s(), &[100.0, 100.1, 100.2, 100.3][..rows]);
        assert_eq!(trial.notes().left_out.lines, 5 - rows);
        let check = check_files(&[path], &ColumnMap::default(), &Limits::default(), 1);
        let finding = check.finding(FindingKind::NoRow).unwrap();
        assert!(finding.fault && check.rows == rows, "{check:?}");
        assert_contains(
            &finding.places[0].to_string(),
            [format!("row {}", rows + 1), format!("{missing} of")],
        );
    }
    // An array in Fortran order lacks its last columns.
    let columns = npy(&header("<f8", "True", 5), &[0; 54 * 8]);
    let path = files.write("columns.npy", &columns);
    let error = Trial::read_mapped(&path, &map).unwrap_err().to_string();
    assert_contains(&error, ["its last columns"]);
}

#[test]
fn compressed_text_truncated_at_any_byte_is_reported_as_truncated() {
    let files = Files::new();
    let whole = gzip(csv(&ROWS).as_bytes());
    for length in 2..whole.len() {
        let error = Trial::read(files.write("cut.csv.gz", &whole[..length])).unwrap_err();
        assert_eq!(error.fault(), Fault::Truncated, "{length} bytes: {error:?}");
        assert!(error.to_string().contains("truncated"));
    }
    Trial::read(files.write("cut.csv.gz", &whole[..1])).unwrap_err();
    Trial::read(files.write("cut.csv.gz", &whole)).unwrap();
}

#[test]
fn plain_text_truncated_at_any_byte_is_an_error_or_a_shorter_trial_with_a_note() {
    let files = Files::new();
    let whole = csv(&ROWS);
    // If truncated at a newline, only the reported number of rows shows it.
    let mut shorter = 0;
    for length in 0..whole.len() {
        let Ok(trial) = Trial::read(files.write("cut.csv", &whole.as_bytes()[..length])) else {
            continue;
        };
        let whole_lines = whole[..length].ends_with('\n');
        assert_eq!(trial.notes().no_final_line_break, !whole_lines, "{length} bytes");
        let lines = whole[..length].lines().count();
        assert_eq!(trial.notes().rows, lines - 1, "{length} bytes");
        shorter += usize::from(trial.notes().rows < 5);
    }
    assert!(shorter > 0);
}
