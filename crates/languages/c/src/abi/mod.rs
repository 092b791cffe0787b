//! What C calls. Every function catches panics, and checks pointers, lengths and handles first.
//!
//! `tests/all/layouts/header.rs` makes `include/joulebus.h` from the files of this module and the
//! layouts of `joulebus-wire`. It states what every caller promises.
#![allow(
    unsafe_code,
    clippy::missing_safety_doc,
    reason = "the header states once what pointers must be"
)]

mod client;
mod errors;

mod predictor;
mod publisher;
mod questions;
mod subscriber;
pub mod types;

pub use client::*;
pub use errors::*;

pub use predictor::*;
pub use publisher::*;
pub use questions::*;
pub use subscriber::*;
