//! The `joulebus` program.
fn main() {}
