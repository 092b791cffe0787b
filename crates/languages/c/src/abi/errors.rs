//! Versions, errors, names of codes, and the clock.

use std::ffi::{CStr, c_char};

use joulebus_bus::clock;
use joulebus_wire::{Alarm, InvalidReason, Level, SCHEMA_VERSION};

use crate::abi::types::joulebus_error;
use crate::failure::{self, entry};
use crate::memory::text;
use crate::version;

/// The library's release. Its terminator is the only zero.
const VERSION: &CStr =
    match CStr::from_bytes_with_nul(concat!(env!("CARGO_PKG_VERSION"), "\0").as_bytes()) {
        Ok(version) => version,
        Err(_) => c"",
    };

/// The library's release, like "0.1.0".
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_version() -> *const c_char {
    VERSION.as_ptr()
}

/// The schema version of the payloads that the library writes and reads.
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_schema_version() -> u32 {
    SCHEMA_VERSION
}

/// Refuses a program whose header is not of this library's release, with both versions. What opens
/// a handle checks it.
///
/// @param header JOULEBUS_HEADER.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_check_version(header: *const c_char) -> joulebus_error {
    // SAFETY: the caller's promises, in joulebus.h.
    entry(|| version::check(unsafe { text("header", header) }?))
}

/// The message of the last call that failed in this thread: what was found, what is allowed, what
/// to do, with the words of the Rust library. NULL if none has failed. Valid until the next call
/// that fails in this thread.
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_last_error() -> *const c_char {
    failure::last()
}

/// The name of an error, like "thread", or "unknown" of another number.
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_error_name(error: i32) -> *const c_char {
    let names = [
        c"none",
        c"argument",
        c"handle",
        c"thread",
        c"process",
        c"version",
        c"connect",
        c"read",
        c"no frame",
        c"interrupted",
        c"publish",
        c"model",
        c"question",
        c"unanswered",
        c"defect",
    ];
    let name = usize::try_from(error).ok().and_then(|at| names.get(at));
    name.copied().unwrap_or(c"unknown").as_ptr()
}

/// Bytes of the longest name of a code, with the zero that C needs.
const MAX_NAME: usize = 24;

/// The names of all variants, each with the zero that C needs.
macro_rules! names {
    ($of:ident) => {{
        let mut names = [[0; MAX_NAME]; $of::ALL.len()];
        let mut at = 0;
        while at < names.len() {
            let name = $of::ALL[at].name().as_bytes();
            let (start, zeros) = names[at].split_at_mut(name.len());
            assert!(!zeros.is_empty());
            start.copy_from_slice(name);
            at += 1;
        }
        names
    }};
}

static ALARMS: [[u8; MAX_NAME]; Alarm::ALL.len()] = names!(Alarm);
static INVALID_REASONS: [[u8; MAX_NAME]; InvalidReason::ALL.len()] = names!(InvalidReason);

/// The name of a code. The first is 1.
fn name(names: &'static [[u8; MAX_NAME]], code: u16) -> *const c_char {
    let name = code.checked_sub(1).and_then(|at| names.get(usize::from(at)));
    name.map_or(c"Unknown".as_ptr(), |name| name.as_ptr().cast())
}

/// The name of a diagnostic's alarm, like "BatteryLow".
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_alarm_name(code: u16) -> *const c_char {
    if code == Alarm::None.code() { c"None".as_ptr() } else { name(&ALARMS, code) }
}

/// The name of the reason why a robot has no forecast, like "NotFinite": the detail of
/// JOULEBUS_QUALITY_INVALID.
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_invalid_name(code: u16) -> *const c_char {
    name(&INVALID_REASONS, code)
}

/// The name of a diagnostic's level, like "warn".
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_level_name(code: u16) -> *const c_char {
    let name = match Level::decode(code) {
        Level::Ok => c"ok",
        Level::Warn => c"warn",
        Level::Error => c"error",
        Level::Stale => c"stale",
    };
    name.as_ptr()
}

/// The time of all stamps: the host's monotonic clock (CLOCK_MONOTONIC), ns.
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_monotonic_ns() -> u64 {
    clock::monotonic_ns()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(name: *const c_char) -> &'static str {
        // SAFETY: a literal of this file, which ends with a zero.
        unsafe { CStr::from_ptr(name) }.to_str().unwrap()
    }

    #[test]
    fn codes_have_the_names_of_wire() {
        for code in 0..40 {
            let alarm = Alarm::decode(code).name();
            assert_eq!(text(joulebus_alarm_name(code)), alarm);
            let reason = InvalidReason::decode(code).name();
            assert_eq!(text(joulebus_invalid_name(code)), reason);
            let level = Level::decode(code).name();
            assert_eq!(text(joulebus_level_name(code)), level);
        }
        assert_eq!(text(joulebus_version()), env!("CARGO_PKG_VERSION"));
    }

    #[test]
    fn errors_have_names() {
        let name = |error: i32| text(joulebus_error_name(error));
        assert_eq!(name(joulebus_error::None as i32), "none");
        assert_eq!(name(joulebus_error::NoFrame as i32), "no frame");
        assert_eq!(name(joulebus_error::Defect as i32), "defect");
        for unknown in [-1, joulebus_error::Defect as i32 + 1, i32::MIN] {
            assert_eq!(name(unknown), "unknown");
        }
    }
}
