//! Handles: numbers in the shape of pointers, which are never followed.
//!
//! Ports of shared memory belong to the thread that opened them. So does a table of open ports, and
//! a handle is a slot in it with the number of the thread and of the slot's use. A handle that is
//! closed, of another thread, of the process that forked this one, or made up is refused without
//! touching memory. Open ports of a thread that ends stay open until the process ends. Then other
//! members of the fleet remove its remains.

use std::cell::{Cell, RefCell};
use std::mem::{ManuallyDrop, forget, replace};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;
use std::sync::atomic::{AtomicU64, Ordering};

use joulebus_bus::process_id;

use crate::abi::types::joulebus_error;
use crate::failure::Failure;

const SLOT_BITS: u32 = 16;
const USE_BITS: u32 = 20;
const THREAD_BITS: u32 = 24;

/// Open ports of one kind in one thread. Never dropped: at a thread's end iceoryx2 may be gone.
pub(crate) type Table<T> = ManuallyDrop<RefCell<Vec<Slot<T>>>>;

/// The kind of object that a handle stands for.
pub(crate) trait Kind: Sized + 'static {
    /// The type that C points to.
    type Handle;
    /// In messages.
    const NAME: &'static str;
    /// Differs from that of all others: 1 to 15.
    const CODE: u64;

    /// Calls `with` with this thread's table.
    fn table<R>(with: impl FnOnce(&Table<Self>) -> R) -> R;
}

/// Declares a [`Kind`] and its table.
macro_rules! kind {
    ($type:ty, $handle:ty, $name:literal, $code:literal) => {
        impl $crate::handles::Kind for $type {
            type Handle = $handle;
            const NAME: &'static str = $name;
            const CODE: u64 = $code;

            fn table<R>(with: impl FnOnce(&$crate::handles::Table<Self>) -> R) -> R {
                thread_local! {
                    static TABLE: $crate::handles::Table<$type> = const {
                        ::std::mem::ManuallyDrop::new(::std::cell::RefCell::new(Vec::new()))
                    };
                }
                TABLE.with(with)
            }
        }
    };
}
pub(crate) use kind;

#[derive(Debug)]
pub(crate) struct Slot<T> {
    uses: u64,
    pid: u32,
    state: State<T>,
}

#[derive(Debug)]
enum State<T> {
    Closed,
    /// A call has taken it.
    InCall,
    Open(Box<T>),
}

/// The contents of a handle.
#[derive(Debug, Clone, Copy)]
struct Token {
    kind: u64,
    thread: u64,
    uses: u64,
    slot: usize,
}

impl Token {
    fn encode(self) -> u64 {
        let Self { kind, thread, uses, slot } = self;
        (((kind << THREAD_BITS) | thread) << (USE_BITS + SLOT_BITS))
            | (uses << SLOT_BITS)
            | slot as u64
    }

    fn decode(number: u64) -> Self {
        let bits = |from: u32, count: u32| (number >> from) & ((1 << count) - 1);
        Self {
            kind: bits(THREAD_BITS + USE_BITS + SLOT_BITS, 4),
            thread: bits(USE_BITS + SLOT_BITS, THREAD_BITS),
            uses: bits(SLOT_BITS, USE_BITS),
            slot: bits(0, SLOT_BITS) as usize,
        }
    }
}

const _: () = assert!(usize::BITS == 64 && SLOT_BITS + USE_BITS + THREAD_BITS + 4 == 64);

/// The number of this thread among those that opened something, from 1.
fn thread() -> u64 {
    static THREADS: AtomicU64 = AtomicU64::new(1);
    thread_local! {
        static NUMBER: Cell<u64> = const { Cell::new(0) };
    }
    NUMBER.with(|number| {
        if number.get() == 0 {
            number.set(THREADS.fetch_add(1, Ordering::Relaxed));
        }
        number.get()
    })
}

/// The handle of what has been opened.
pub(crate) fn open<T: Kind>(value: T) -> Result<*mut T::Handle, Failure> {
    let none_left = |what: &str| {
        Failure::new(
            joulebus_error::Handle,
            format!("no more {what} of handles: close some, or use fewer threads"),
        )
    };
    let thread = thread();
    if thread >= 1 << THREAD_BITS {
        return Err(none_left("threads"));
    }
    let number = T::table(|table| {
        let mut slots = table.borrow_mut();
        let usable =
            |slot: &Slot<T>| matches!(slot.state, State::Closed) && slot.uses + 1 < 1 << USE_BITS;
        let slot = slots.iter().position(usable).unwrap_or(slots.len());
        if slot >= 1 << SLOT_BITS {
            return Err(none_left("places"));
        }
        if slot == slots.len() {
            let (uses, pid, state) = (0, 0, State::Closed);
            slots.push(Slot { uses, pid, state });
        }
        let at = &mut slots[slot];
        at.uses += 1;
        at.pid = process_id();
        at.state = State::Open(Box::new(value));
        let (kind, uses) = (T::CODE, at.uses);
        Ok(Token { kind, thread, uses, slot })
    })?;
    // Linux on 64 bits: asserted above.
    Ok(ptr::without_provenance_mut(number.encode() as usize))
}

/// Calls `call` with what a handle stands for. After a panic it is closed.
pub(crate) fn with<T: Kind, R>(
    handle: *mut T::Handle,
    call: impl FnOnce(&mut T) -> Result<R, Failure>,
) -> Result<R, Failure> {
    let token = check::<T>(handle)?;
    let mut value = take::<T>(token)?;
    let result = catch_unwind(AssertUnwindSafe(|| call(&mut value)));
    let (state, result) = match result {
        Ok(result) => (State::Open(value), result),
        Err(panic) => {
            // In what state its ports are is unknown.
            forget(value);
            (State::Closed, Err(Failure::defect(&*panic)))
        }
    };
    T::table(|table| table.borrow_mut()[token.slot].state = state);
    result
}

/// Closes a handle and drops what it stands for. Null is closed already.
pub(crate) fn close<T: Kind>(handle: *mut T::Handle) -> Result<(), Failure> {
    if handle.is_null() {
        return Ok(());
    }
    let token = check::<T>(handle)?;
    let value = take::<T>(token)?;
    T::table(|table| table.borrow_mut()[token.slot].state = State::Closed);
    drop(value);
    Ok(())
}

/// The contents of a number that is a handle of this kind and of this thread.
fn check<T: Kind>(handle: *mut T::Handle) -> Result<Token, Failure> {
    let name = T::NAME;
    if handle.is_null() {
        return Err(Failure::argument(format!(
            "the {name} is NULL: open one, and look at what opening returned"
        )));
    }
    let token = Token::decode(handle.addr() as u64);
    if token.kind != T::CODE {
        return Err(Failure::new(
            joulebus_error::Handle,
            format!("{:#x} is not a {name}", handle.addr()),
        ));
    }
    let thread = thread();
    if token.thread != thread {
        let text = format!(
            "a {name} of thread {} used in thread {thread} (counted as they open their first): it belongs to the \
             thread that opened it. Open another one there",
            token.thread
        );
        return Err(Failure::new(joulebus_error::Thread, text));
    }
    Ok(token)
}

fn take<T: Kind>(token: Token) -> Result<Box<T>, Failure> {
    let name = T::NAME;
    let closed = || {
        let text = format!("the {name} is closed. Open a new one");
        Failure::new(joulebus_error::Handle, text)
    };
    T::table(|table| {
        let mut slots = table.borrow_mut();
        let slot = slots.get_mut(token.slot).ok_or_else(closed)?;
        if slot.uses != token.uses {
            return Err(closed());
        }
        let (found, allowed) = (process_id(), slot.pid);
        if found != allowed {
            let text = format!(
                "a {name} used in process {found}, which was forked from {allowed}: its ports belong to process \
                 {allowed}. Open another one after a fork"
            );
            return Err(Failure::new(joulebus_error::Process, text));
        }
        match replace(&mut slot.state, State::InCall) {
            State::Open(value) => Ok(value),
            State::Closed => {
                slot.state = State::Closed;
                Err(closed())
            }
            State::InCall => {
                let text = format!(
                    "the {name} is in use by a call of this thread, which a signal handler has interrupted"
                );
                Err(Failure::new(joulebus_error::Handle, text))
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Number(u32);
    struct Other;
    #[derive(Debug)]
    struct Handle;
    kind!(Number, Handle, "number", 14);
    kind!(Other, Handle, "other", 15);

    fn code<R>(result: Result<R, Failure>) -> joulebus_error {
        result.map_or_else(|failure| failure.code, |_| joulebus_error::None)
    }

    #[test]
    fn a_handle_finds_what_was_opened_until_it_is_closed() {
        let (one, two) = (open(Number(1)).unwrap(), open(Number(2)).unwrap());
        assert_ne!(one, two);
        let value = |handle| with::<Number, _>(handle, |number| Ok(number.0));
        assert_eq!((value(one).unwrap(), value(two).unwrap()), (1, 2));
        close::<Number>(one).unwrap();
        assert_eq!(code(value(one)), joulebus_error::Handle);
        assert_eq!(code(close::<Number>(one)), joulebus_error::Handle);
        // The slot is used again, under another number.
        let three = open(Number(3)).unwrap();
        assert_eq!(three.addr() & 0xffff, one.addr() & 0xffff);
        assert_eq!(code(value(one)), joulebus_error::Handle);
        assert_eq!((value(two).unwrap(), value(three).unwrap()), (2, 3));
        close::<Number>(ptr::null_mut()).unwrap();
    }

    #[test]
    fn other_kinds_threads_and_numbers_are_refused() {
        let number = open(Number(1)).unwrap();
        let other = |handle| code(with::<Other, _>(handle, |_| Ok(())));
        assert_eq!(other(number), joulebus_error::Handle);
        assert_eq!(other(ptr::null_mut()), joulebus_error::Argument);
        for garbage in [1, 0xdead_beef, usize::MAX, number.addr() ^ 0x7] {
            let handle = ptr::without_provenance_mut(garbage);
            assert_eq!(code(close::<Number>(handle)), joulebus_error::Handle, "{garbage:#x}");
        }
        let address = number.addr();
        let elsewhere = std::thread::spawn(move || {
            let handle = ptr::without_provenance_mut(address);
            let used = code(with::<Number, _>(handle, |_| Ok(())));
            (used, code(close::<Number>(handle)))
        });
        let refused = joulebus_error::Thread;
        assert_eq!(elsewhere.join().unwrap(), (refused, refused));
        with::<Number, _>(number, |_| Ok(())).unwrap();
    }

    #[test]
    fn a_call_within_a_call_is_refused_and_a_panic_closes() {
        let number = open(Number(1)).unwrap();
        with::<Number, _>(number, |_| {
            assert_eq!(code(with::<Number, _>(number, |_| Ok(()))), joulebus_error::Handle);
            Ok(())
        })
        .unwrap();
        let failed = with::<Number, ()>(number, |_| panic!("seven"));
        assert!(failed.as_ref().unwrap_err().text.contains("seven"));
        assert_eq!(code(failed), joulebus_error::Defect);
        assert_eq!(code(with::<Number, _>(number, |_| Ok(()))), joulebus_error::Handle);
    }

    #[test]
    fn a_slot_is_given_up_before_its_uses_repeat() {
        let first = open(Number(0)).unwrap();
        let slot = Token::decode(first.addr() as u64).slot;
        close::<Number>(first).unwrap();
        Number::table(|table| table.borrow_mut()[slot].uses = (1 << USE_BITS) - 2);
        let last = open(Number(0)).unwrap();
        close::<Number>(last).unwrap();
        let next = open(Number(0)).unwrap();
        assert_ne!(Token::decode(next.addr() as u64).slot, slot);
        let token = Token::decode(last.addr() as u64);
        assert_eq!(token.encode(), last.addr() as u64);
    }
}
