//! A panic of the crate `parquet` is a refusal of its input: it is caught, and nothing about it is
//! printed.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind, set_hook, take_hook};
use std::sync::atomic::{AtomicBool, Ordering};

thread_local! {
    /// True if this thread is in [`caught`].
    static IS_CAUGHT: Cell<bool> = const { Cell::new(false) };
}

type Hook = Box<dyn Fn(&PanicHookInfo<'_>) + Sync + Send>;

/// A hook that passes on panics of other threads, and of this one elsewhere.
fn quiet(before: Hook) -> Hook {
    Box::new(move |panic| {
        // While a thread ends, its variables are gone, and it is not reading.
        if !IS_CAUGHT.try_with(Cell::get).unwrap_or(false) {
            before(panic);
        }
    })
}

/// Wraps the process's panic hook, once. Others do not wait until it is wrapped: a lock for that
/// would be taken for ever in a child made by `fork` meanwhile.
fn wrap_hook() {
    static IS_WRAPPED: AtomicBool = AtomicBool::new(false);
    if !IS_WRAPPED.swap(true, Ordering::Relaxed) {
        set_hook(quiet(take_hook()));
    }
}

/// The result of `read`, or `None` if it panicked. A panic prints nothing.
pub(super) fn caught<T>(read: impl FnOnce() -> T) -> Option<T> {
    // The hook cannot be changed by a thread that panics. Then its message is printed.
    if !std::thread::panicking() {
        wrap_hook();
    }
    let before = IS_CAUGHT.replace(true);
    let read = catch_unwind(AssertUnwindSafe(read));
    IS_CAUGHT.set(before);
    read.ok()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use super::*;

    #[test]
    fn a_caught_panic_is_not_printed_and_one_elsewhere_is() {
        static PRINTED: AtomicUsize = AtomicUsize::new(0);
        const MARK: &str = "quiet's own panic";
        let count = |panic: &PanicHookInfo<'_>| {
            if panic.payload().downcast_ref::<String>().is_some_and(|text| text == MARK) {
                PRINTED.fetch_add(1, Ordering::Relaxed);
            }
        };
        // From now on `caught` does not change the hook.
        wrap_hook();
        set_hook(quiet(Box::new(count)));
        let printed = || PRINTED.load(Ordering::Relaxed);
        let fail = || -> u32 { panic!("{MARK}") };
        assert_eq!(caught(|| 5), Some(5));
        assert_eq!(caught(fail), None);
        assert_eq!(printed(), 0);
        // Beside a thread that reads, and in this one after reading.
        let beside = caught(|| std::thread::spawn(fail).join().is_err());
        assert_eq!((beside, printed()), (Some(true), 1));
        assert!(catch_unwind(fail).is_err());
        assert_eq!(printed(), 2);
        let _ = take_hook();
    }
}
