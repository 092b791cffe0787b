//! What a text has to say.

use std::fmt::Display;

/// Checks that a text has all of these parts.
///
/// # Panics
/// It lacks one.
#[track_caller]
pub fn says<const N: usize>(text: &(impl Display + ?Sized), parts: [impl AsRef<str>; N]) {
    let text = text.to_string();
    for part in parts.each_ref().map(AsRef::as_ref) {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
}
