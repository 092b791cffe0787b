//! Words of commands that a program proposes, as a shell takes them.

use std::path::Path;

/// A path as a word of a command.
#[must_use]
pub fn word(path: &Path) -> String {
    quoted(&path.display().to_string())
}

/// A text as a word of a command.
#[must_use]
pub fn quoted(text: &str) -> String {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/._-+,:=@%".contains(&byte);
    match !text.is_empty() && text.bytes().all(is_plain) {
        true => text.to_owned(),
        false => format!("'{}'", text.replace('\'', "'\\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_quoted_where_a_shell_would_take_them_apart() {
        for (path, expected) in [
            ("trials/a-1.csv.gz", "trials/a-1.csv.gz"),
            ("my trials/*.csv", "'my trials/*.csv'"),
            ("it's", "'it'\\''s'"),
            ("", "''"),
        ] {
            assert_eq!(word(Path::new(path)), expected);
        }
    }
}
