//! Recordings: reading, checking, converting and resampling them, and building training rows.
//!
//! ```
//! use joulebus_dataset::rows::trial_rows;
//! use joulebus_dataset::trial::Trial;
//!
//! let directory = tempfile::tempdir()?;
//! let path = directory.path().join("robot7.csv");
//! let rows: String =
//!     (0..20).map(|row| format!("{}.{},{}\n", row / 10, row % 10, 4 + row % 3)).collect();
//! std::fs::write(&path, format!("time_s,power_w\n{rows}"))?;
//!
//! let trial = Trial::read(&path)?;
//! assert_eq!((trial.rows(), trial.period_ns()), (20, 100_000_000));
//! // A row to learn from needs five readings, and the one that follows them.
//! let training = trial_rows(&trial);
//! assert_eq!(training.rows.len(), 15);
//! assert_eq!(training.rows[0].target_w, 6.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Three types to know.** A [`Trial`](trial::Trial) is the recording of one robot in one run. A
//! [`Dataset`](rows::Dataset) has the rows for training, validation and scores. An
//! [`Assignment`](split::Assignment) states which rows of which trial go to which part.
//!
//! **Modules.** [`trial`] reads and writes recordings, and [`npy`] the header of NumPy's arrays. [`inspect`] finds recordings and their faults. [`rows`]
//! and [`split`] make training data. [`trained_rows`] recognises rows that a model was trained on.
//!
//! **Units** are SI, whatever the file has: units are converted once, at reading. A value that was
//! not recorded is NaN, or its column is missing.
//!
//! **Errors** name the file, and where there is one the row and the column, with what was found and
//! what is allowed: [`TrialError`](trial::TrialError) and [`SplitError`](split::SplitError).
//!
//! **In the book**: [recordings, formats][1], [columns of recordings][2], [from CSV logs to a
//! worker][3], [resample, split and evaluate][4].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/recordings.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/reference/columns.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/tutorial/csv.md
//! [4]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/resample-and-split.md
#![forbid(unsafe_code)]

pub mod altered;
pub mod inspect;
pub mod npy;
pub mod rows;
pub mod split;
pub mod trained_rows;
pub mod trial;
