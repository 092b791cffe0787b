//! The tests of the server: the page and its interface, and webhooks.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod http;
