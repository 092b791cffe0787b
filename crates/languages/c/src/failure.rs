//! Results of calls, the message of this thread's last failure, and the border that no panic
//! crosses.

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;

use crate::abi::types::joulebus_error;

/// Reason that a call failed.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) code: joulebus_error,
    pub(crate) text: String,
}

impl Failure {
    #[allow(clippy::needless_pass_by_value, reason = "texts and errors, as they come")]
    pub(crate) fn new(code: joulebus_error, text: impl ToString) -> Self {
        let text = text.to_string();
        Self { code, text }
    }

    pub(crate) fn argument(text: impl ToString) -> Self {
        Self::new(joulebus_error::Argument, text)
    }

    /// The failure of a panic: a defect of joulebus.
    pub(crate) fn defect(panic: &(dyn Any + Send)) -> Self {
        let text = panic.downcast_ref::<&str>().copied();
        let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
        let text = format!(
            "a defect of joulebus: {}. The handle of this call is closed. Please report it",
            text.unwrap_or("without a message")
        );
        Self::new(joulebus_error::Defect, text)
    }
}

thread_local! {
    static LAST: RefCell<Option<CString>> = const { RefCell::new(None) };
}

/// Runs what an exported function does, and turns its result into a code and a message.
pub(crate) fn entry(call: impl FnOnce() -> Result<(), Failure>) -> joulebus_error {
    let result = catch_unwind(AssertUnwindSafe(call));
    let result = result.unwrap_or_else(|panic| Err(Failure::defect(&*panic)));
    match result {
        Ok(()) => joulebus_error::None,
        Err(failure) => {
            remember(&failure.text);
            failure.code
        }
    }
}

fn remember(text: &str) {
    let bytes: Vec<u8> = text.bytes().filter(|byte| *byte != 0).collect();
    let text = CString::new(bytes).ok();
    // An ending thread has no messages. A signal handler that interrupts this must not call.
    let _ = LAST.try_with(|last| {
        if let Ok(mut last) = last.try_borrow_mut() {
            *last = text;
        }
    });
}

/// The message of the last call that failed in this thread. Null before.
pub(crate) fn last() -> *const c_char {
    let text = LAST.try_with(|last| {
        let last = last.try_borrow().ok()?;
        last.as_ref().map(|text| text.as_ptr())
    });
    text.ok().flatten().unwrap_or(ptr::null())
}
