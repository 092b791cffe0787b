//! Datasets: finding recordings, saying what they are, and finding what is wrong with them.

mod check;
mod constant;
mod describe;
mod find;
mod finding;
mod hold;
mod limits;
mod units;

pub use check::{Check, check_files, check_trial};
pub use describe::{ColumnReport, Steps, TrialReport, describe};
pub use find::{FindError, Found, find};
pub use finding::{Finding, FindingKind, Place};
pub use hold::{Holds, holds};
pub use limits::{Limits, Range};
pub use units::{PowerCheck, power_check};
