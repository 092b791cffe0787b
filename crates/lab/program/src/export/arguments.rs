//! The options of `joulebus export`.

use std::ffi::OsString;
use std::path::PathBuf;

use crate::recordings::ColumnArguments;

/// Write recordings and captures as a folder of Parquet files
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus export run.mcap --to parquet archive/\n  \
    joulebus export recordings/ --to parquet archive/\n  \
    joulebus eval archive/ --model my.safetensors\n\n\
    Each trial is a file, DIR/fleet=…/day=…/robot=…/*.parquet, in the order and the units of its recording, to the bit. \
    A property that no recording has, such as fleet and day of a CSV, makes no folder. Recordings \
    that have them go into another DIR. docs/how-to/archives.md has the columns. Every verb that \
    takes recordings takes DIR as the recordings that were exported, in their order. From a \
    partition (DIR/fleet=a/day=2026-11-22) verbs take one file after the other. Further exports \
    into DIR add to it. Captures of any length need little memory. A temporary file in TMPDIR has \
    their samples meanwhile.\n\n\
    Exit code 1: something cannot be read or written, and whole recordings before it are in DIR. \
    2: wrong usage, such as a folder with other files. 3: lines were left out because they are no \
    whole rows.")]
pub(crate) struct Args {
    /// Recordings (.npy, .csv, .csv.gz), captures (.mcap), directories (searched recursively), or
    /// patterns in quotes: 'runs/**/*.npy'
    #[arg(required = true, value_name = "PATH")]
    pub(super) paths: Vec<PathBuf>,
    /// The format, parquet, and the folder: a new or an empty one, or one of an earlier export
    #[arg(long, required = true, num_args = 2, value_names = ["FORMAT", "DIR"])]
    pub(super) to: Vec<OsString>,
    /// Put recordings with and without fleet, day and robot into one archive: DuckDB, Polars and
    /// pyarrow read what is unknown as null, pandas and Dask cannot read it
    #[arg(long)]
    pub(super) mixed: bool,
    #[command(flatten)]
    pub(super) columns: ColumnArguments,
}
