//! Lists of robot ids.

use std::ops::RangeInclusive;

use toml::Spanned;
use toml::de::DeValue;

use crate::numbers::integer;

/// Parses one entry of the list in `source`: an id, or an inclusive range `"a-b"`.
pub(crate) fn parse(
    entry: &Spanned<DeValue<'_>>,
    source: &str,
) -> Result<RangeInclusive<u32>, String> {
    let wrong = || {
        let text = source.get(entry.span()).unwrap_or_default();
        format!("has the entry {text}")
    };
    let entry_value = entry.get_ref();
    if let Some(id) = integer(entry_value) {
        let id = u32::try_from(id).map_err(|_| wrong())?;
        return Ok(id..=id);
    }
    let text = entry_value.as_str().ok_or_else(wrong)?;
    let id = |text: &str| text.trim().parse::<u32>().map_err(|_| wrong());
    let (first, last) = match text.split_once('-') {
        Some((first, last)) => (id(first)?, id(last)?),
        None => (id(text)?, id(text)?),
    };
    if first > last {
        return Err(format!("{}, which ends before it begins", wrong()));
    }
    Ok(first..=last)
}

/// The range as written in a config.
pub(crate) fn text(range: &RangeInclusive<u32>) -> String {
    if range.start() == range.end() {
        format!("\"{}\"", range.start())
    } else {
        format!("\"{}-{}\"", range.start(), range.end())
    }
}

/// Number of robots in the range. A full range exceeds `u32`.
pub(crate) fn count(range: &RangeInclusive<u32>) -> u64 {
    u64::from(*range.end()) - u64::from(*range.start()) + 1
}
