//! Recordings: reading, checking, converting and resampling them, and making rows to learn from.
#![forbid(unsafe_code)]

pub mod inspect;
pub mod npy;
pub mod rows;
pub mod split;
pub mod trial;
