//! Numbers as other programs write them in fields of a text.

#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Numbers {
    /// True if a comma is in front of the fraction. Unknown until a number shows it.
    pub(super) decimal_comma: Option<bool>,
    pub(super) has_point: bool,
}

impl Numbers {
    /// The number in a field, NaN for one that means that there is none, or what is allowed.
    pub(super) fn parse(&mut self, field: &[u8]) -> Result<f64, &'static str> {
        const ALLOWED: &str = "a number, NaN, or nothing";
        if is_missing(field) {
            return Ok(f64::NAN);
        }
        let text = std::str::from_utf8(field).map_err(|_| ALLOWED)?;
        if let Ok(number) = text.parse() {
            self.has_point |= text.contains('.');
            if self.decimal_comma == Some(true) && is_thousands(text) {
                return Err("a number with a decimal comma; a point could separate thousands here");
            }
            return Ok(number);
        }
        if let Some(number) = grouped(text).filter(|_| self.decimal_comma != Some(true)) {
            self.has_point = true;
            return Ok(number);
        }
        let comma = text.split_once(',').filter(|_| self.decimal_comma != Some(false));
        let (whole, fraction) = comma.ok_or(ALLOWED)?;
        let digits = whole.trim_start_matches(['-', '+']);
        // Thousands have one to three digits in front of them, and no zero first.
        let is_fraction =
            fraction.len() != 3 || !(1..=3).contains(&digits.len()) || digits.starts_with('0');
        if text.contains('.') || !(is_fraction || self.decimal_comma == Some(true)) {
            return Err("a number with a point. A comma could separate thousands here");
        }
        let number = format!("{whole}.{fraction}").parse().map_err(|_| ALLOWED)?;
        self.decimal_comma = Some(true);
        Ok(number)
    }
}

/// A number whose commas can only separate thousands: it has a point behind them, or several.
fn grouped(text: &str) -> Option<f64> {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let mut groups = whole.trim_start_matches(['-', '+']).split(',');
    let is_digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    let first = groups.next()?;
    let mut others = 0;
    let is_whole = groups.all(|group| {
        others += 1;
        group.len() == 3 && is_digits(group)
    });
    let is_sure = others > 1 || (others == 1 && text.contains('.'));
    let is_grouped = is_whole && is_sure && (1..=3).contains(&first.len()) && is_digits(first);
    (is_grouped && is_digits(fraction)).then(|| text.replace(',', "").parse().ok())?
}

/// True if a point in a number could separate thousands: one to three digits in front, three
/// behind.
fn is_thousands(text: &str) -> bool {
    let digits = text.trim_start_matches(['-', '+']);
    digits.split_once('.').is_some_and(|(whole, rest)| {
        (1..=3).contains(&whole.len()) && !whole.starts_with('0') && rest.len() == 3
    })
}

/// A number and the letters behind it: `12.1 V`.
pub(super) fn with_unit(field: &[u8]) -> Option<(&[u8], &str)> {
    let is_letter = |byte: &u8| byte.is_ascii_alphabetic() || *byte == b'%';
    let end = field.iter().rposition(|byte| !is_letter(byte))? + 1;
    let (number, unit) = field.split_at(end);
    let unit = std::str::from_utf8(unit).ok().filter(|unit| !unit.is_empty())?;
    Some((number.trim_ascii(), unit))
}

/// True if a field states that there is no value.
pub(super) fn is_missing(field: &[u8]) -> bool {
    const WORDS: [&str; 16] = [
        "nan",
        "na",
        "n/a",
        "<na>",
        "#n/a",
        "nat",
        "null",
        "none",
        "nil",
        "-",
        "--",
        "-nan(ind)",
        "nan(ind)",
        "-1.#ind",
        "1.#qnan",
        "unavailable",
    ];
    let is_word = |word: &&str| field.eq_ignore_ascii_case(word.as_bytes());
    field.is_empty() || WORDS.iter().any(is_word)
}
