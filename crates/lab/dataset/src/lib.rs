#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod inspect;
pub mod npy;
pub mod rows;
pub mod split;
pub mod trained_rows;
pub mod trial;
