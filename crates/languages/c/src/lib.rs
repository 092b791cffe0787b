//! The C library `libjoulebus`: publisher, subscriber, questions and predictor for C and C++.
//!
//! `include/joulebus.h`, `include/joulebus.hpp` and `docs/tutorial/cpp.md` are its documentation.
//! This crate is no library for Rust: [`abi`] holds what C calls, the other modules what makes
//! such calls safe.
//!
//! - `handles`: a handle is a number in the shape of a pointer. It is looked up in a table of the
//!   thread that opened it, so one that is closed, of another thread, or of the process that forked
//!   this one is refused.
//! - `memory`: pointers and lengths of the caller, checked as far as they can be.
//! - `failure`: error codes and their messages, and the border that no panic crosses.
#![deny(unsafe_code)]

pub mod abi;
mod failure;
mod handles;
mod memory;
mod model;
mod question;
mod version;
