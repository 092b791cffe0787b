//! Compares the version of a program's header with this library's.

use joulebus_wire::SCHEMA_VERSION;

use crate::abi::types::joulebus_error;
use crate::failure::Failure;

/// The release of this library.
pub(crate) const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The value of `JOULEBUS_HEADER` in this library's header.
pub(crate) fn header() -> String {
    format!("{VERSION}, schema {SCHEMA_VERSION}")
}

/// Refuses a program that was compiled with the header of another release: its structs may differ.
pub(crate) fn check(found: &str) -> Result<(), Failure> {
    let ours = header();
    if found == ours {
        return Ok(());
    }
    let found: String = found.chars().take(80).collect();
    let text = format!(
        "the program was compiled with joulebus.h of joulebus {found}, the library is {ours}: compile it with the \
         header that was installed with this library, or install the libjoulebus of its header"
    );
    Err(Failure::new(joulebus_error::Version, text))
}

/// The remedy when the fleet has another version.
pub(crate) fn remedy() -> String {
    format!(
        "This library is joulebus {VERSION}. `joulebus --version` on the worker's side says which release to install"
    )
}
