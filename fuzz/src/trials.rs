//! Recorded trials as files: refused, or read, written and read again bit for bit.

use std::io::Write as _;
use std::path::Path;

use joulebus_dataset::trial::{Column, Fault, Form, Method, Resample, Table, Trial};

/// Maximum length of an input, bytes: longer ones reach no further code.
const MAX_BYTES: usize = 64 << 10;

pub(crate) fn npy(bytes: &[u8]) -> bool {
    read(bytes, ".npy")
}

/// CSV, plain or in gzip: the reader decides by the first bytes.
pub(crate) fn csv(bytes: &[u8]) -> bool {
    read(bytes, ".csv")
}

fn read(bytes: &[u8], ending: &str) -> bool {
    if bytes.len() > MAX_BYTES {
        return false;
    }
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join(format!("input{ending}"));
    let file = std::fs::File::create(&path);
    file.and_then(|mut file| file.write_all(bytes)).expect("room for the input");
    match Table::read_robots(&path) {
        Ok(tables) => {
            assert!(!tables.is_empty());
            for (number, table) in tables.into_iter().enumerate() {
                for form in Form::ALL {
                    let again = directory.path().join(format!("{number}{}", form.ending()));
                    written_and_read(&table, form, &again);
                }
                samples(table);
            }
            true
        }
        Err(error) => {
            assert!(error.to_string().starts_with(&path.display().to_string()), "{error}");
            false
        }
    }
}

fn written_and_read(table: &Table, form: Form, path: &Path) {
    match table.write(path) {
        Ok(()) => {}
        // An array has no names, no further columns, and at least two rows.
        Err(error)
            if form == Form::Npy
                && matches!(
                    error.fault(),
                    Fault::RobotName | Fault::NoSuchColumns | Fault::TooFewRows
                ) =>
        {
            return;
        }
        Err(error) => panic!("{error}"),
    }
    let again = match Table::read(path) {
        Ok(again) => again,
        Err(error) => panic!("what was written cannot be read: {error}"),
    };
    assert_eq!(again.robot_name(), table.robot_name());
    let bits = |values: &[f64]| -> Vec<Option<u64>> {
        let bit = |value: &f64| (!value.is_nan()).then(|| value.to_bits());
        values.iter().map(bit).collect()
    };
    assert_eq!(bits(again.timestamp_s()), bits(table.timestamp_s()));
    for column in Column::ALL {
        let nothing = vec![f64::NAN; table.rows()];
        let of = |table: &Table| bits(table.column(column).unwrap_or(&nothing));
        assert_eq!(of(&again), of(table), "{column:?} in {form:?}");
    }
}

/// Operations on a trial that was read.
fn samples(table: Table) {
    let rows = table.rows();
    let Ok(trial) = table.into_trial() else {
        return;
    };
    assert!(trial.period_ns() > 0);
    let samples = trial.to_samples(1, 1 << 40);
    assert_eq!(samples.len(), rows);
    assert!(samples.iter().all(|sample| sample.flags <= 0xff));
    // Two rows years apart would be resampled to the maximum number of rows: hundreds of megabytes.
    let times = trial.timestamp_s();
    let rows = (times[rows - 1] - times[0]) * 1e9 / trial.period_ns() as f64;
    if rows <= MAX_RESAMPLED_ROWS {
        for method in [Method::Hold, Method::Mean, Method::Linear] {
            resampled(&trial, method);
        }
    }
}

/// Maximum rows of a resampled trial within the target's memory limit.
const MAX_RESAMPLED_ROWS: f64 = 65_536.0;

fn resampled(trial: &Trial, method: Method) {
    let how = Resample { method, rate_hz: 1e9 / trial.period_ns() as f64 };
    if let Ok((again, change)) = trial.resampled(how) {
        assert_eq!(again.rows(), change.rows);
        assert_eq!(change.rows_before, trial.rows());
        let times = again.timestamp_s();
        assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "{method:?}");
    }
}
