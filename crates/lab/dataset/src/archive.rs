//! Archives: recordings as a folder of Parquet files, which every distributed engine reads. The only module that uses the
//! crate `parquet`.
//!
//! A file has one trial: its rows in the order and the units of the recording that it came from, to the bit, and in its
//! footer what else a [`Table`](crate::trial::Table) has. Files lie in partitions, `fleet=…/day=…/robot=…`. A recording is
//! in an archive when its listing is there, `_joulebus/000017.recording`: it names the files of its trials. So an archive
//! reads as the recordings that were exported, in their order.

mod head;
mod listing;
mod quiet;
mod read;
mod schema;
mod sum;
mod write;

pub use head::{Head, RowStamp};
pub use listing::{
    LISTING_ENDING, LISTINGS, ListedTrial, Listing, ListingError, MARK, is_archive, is_listing,
    listings,
};
pub use schema::{Field, Kind, SCHEMA, fields};
pub use write::{Exported, WriteArchiveError, write};

pub(crate) use listing::{open, table as listed, tables};
pub(crate) use read::{MAGIC, table};
