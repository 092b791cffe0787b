//! Recordings: reading, checking, converting and resampling them, and building training rows.
#![forbid(unsafe_code)]

pub mod archive;
pub mod inspect;
pub mod npy;
pub mod rows;
pub mod split;
pub mod trained_rows;
pub mod trial;
