//! Datasets: finding recordings, describing them, and detecting faults in them.

mod check;
mod constant;
mod describe;
mod find;
mod finding;
mod hold;
mod judge;
mod limits;
mod profile;
mod python;
mod units;

pub use check::{Check, check_files, check_trial};
pub use describe::{ColumnReport, Steps, TrialReport, describe};
pub use find::{FindError, Found, find};
pub use finding::{Finding, FindingKind, Occurrence};
pub use hold::{Holds, holds};
pub use judge::{Implausible, is_short, judge, judge_from, judge_together};
pub use limits::{Limits, Range};
pub use profile::{Profile, Profiler};
pub use python::in_python;
pub use units::{PowerCheck, power_check};
