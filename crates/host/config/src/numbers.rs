//! Numbers in a TOML document.

use toml::de::DeValue;

/// An integer, if it fits.
pub(crate) fn integer(value: &DeValue<'_>) -> Option<i64> {
    let digits = value.as_integer()?;
    i64::from_str_radix(digits.as_str(), digits.radix()).ok()
}

/// A number, with or without a decimal point.
pub(crate) fn number(value: &DeValue<'_>) -> Option<f64> {
    let float = value.as_float().and_then(|float| float.as_str().parse().ok());
    float.or_else(|| Some(integer(value)? as f64))
}
