//! Splits the names of arrays into words.

/// The words and numbers of a path, in lower case.
pub(super) fn tokens(path: &str) -> Vec<String> {
    let mut tokens: Vec<String> = Vec::new();
    let mut last = None;
    for character in path.chars() {
        let kind = (character.is_alphabetic(), character.is_ascii_digit());
        if kind == (false, false) {
            last = None;
            continue;
        }
        if last != Some(kind) {
            tokens.push(String::new());
        }
        last = Some(kind);
        if let Some(token) = tokens.last_mut() {
            token.extend(character.to_lowercase());
        }
    }
    tokens
}
