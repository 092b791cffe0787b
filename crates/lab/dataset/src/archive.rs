//! Archives: recordings as a folder of Parquet files, which every distributed engine reads. Only
//! this module uses the crate `parquet`.
//!
//! A file has one trial: its rows in the order and the units of the original recording, to the bit,
//! and in its footer the other parts of a [`Table`](crate::trial::Table). Files are in partitions,
//! `fleet=…/day=…/robot=…`. A recording is in an archive once its listing is there,
//! `_joulebus/000017.recording`, which names the files of its trials. An archive therefore reads as
//! the exported recordings, in their order.

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

pub(crate) use listing::{each_table, open, table as listed};
pub(crate) use read::{MAGIC, table};
