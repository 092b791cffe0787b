//! The tests of the server: the page and its interface.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod http;
