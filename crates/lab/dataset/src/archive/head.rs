//! The metadata of an archive's file, beside the values of its trial.

use serde::{Deserialize, Serialize};

use crate::trial::{LeftOut, SourceColumn};

/// The metadata of a trial in its file, beside the rows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Head {
    /// Name of the recording: the file that was exported.
    pub recording: String,
    /// Number of the recording in its archive, from 0.
    pub ordinal: u32,
    /// Number of the trial in its recording, from 0.
    pub trial: u32,
    /// Name of the robot, if the recording has one.
    pub robot: Option<String>,
    /// Name of the fleet. Captures only.
    pub fleet: Option<String>,
    /// Names of the recording's columns that the trial has, maybe without a value.
    pub columns: Vec<String>,
    /// Columns of the recording that are not in the archive.
    pub ignored_columns: Vec<String>,
    /// The recording, a CSV, does not end with a newline.
    pub no_final_line_break: bool,
    /// Rows without a robot's name, while others have one.
    pub unnamed_rows: usize,
    /// The columns of a CSV that were read.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<SourceColumn>,
    /// Name of the CSV's column with the time as a number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_name: Option<String>,
    /// True if that name, or the size of the numbers, states the unit of the time.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub states_time_unit: bool,
    /// Lines of a CSV that were left out.
    #[serde(default, skip_serializing_if = "LeftOut::is_none")]
    pub left_out: LeftOut,
    /// Interpretation of the text of a CSV, where it is not usual.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub understood: Vec<String>,
}

/// Exact integers of a row of a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RowStamp {
    /// When the sample with the row's reading was recorded, Unix ns.
    pub unix_ns: u64,
    /// Time of the row, monotonic ns.
    pub stamp_ns: u64,
    /// When the row's power was measured, monotonic ns. 0 if that is unknown.
    pub measured_ns: u64,
    /// Number of the sample with the row's reading, within the epoch of its source.
    pub seq: u64,
    /// Flags of that sample ([`joulebus_wire::sample_flag`]).
    pub flags: u32,
}
