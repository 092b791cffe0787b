//! Checks of a text's words.

use std::fmt::Display;

/// Checks that a text has all of these parts.
///
/// # Panics
/// The text lacks a part.
#[track_caller]
pub fn assert_contains(text: &(impl Display + ?Sized), parts: impl IntoIterator<Item: AsRef<str>>) {
    let text = text.to_string();
    for part in parts {
        let part = part.as_ref();
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
}
