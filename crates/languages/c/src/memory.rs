//! Memory of the caller, checked as far as possible: not whether it is mapped, nor its length.

use std::ffi::{CStr, c_char};
use std::marker::PhantomData;
use std::slice;

use crate::failure::Failure;

/// A place of the caller for one result.
#[derive(Debug)]
pub(crate) struct Out<'a, T> {
    to: *mut T,
    lives: PhantomData<&'a mut T>,
}

impl<T> Out<'_, T> {
    pub(crate) fn set(&mut self, value: T) {
        // SAFETY: `out` made it, whose caller promises a writable place. Aligned and not null.
        #[allow(unsafe_code, reason = "memory of the caller")]
        unsafe {
            self.to.write(value);
        }
    }
}

/// A text in UTF-8.
///
/// # Safety
/// `text` is null, or ends with a zero and does not change while the result is in use.
#[allow(unsafe_code, reason = "memory of the caller")]
pub(crate) unsafe fn text<'a>(name: &str, text: *const c_char) -> Result<&'a str, Failure> {
    check(name, text, 1)?;
    // SAFETY: not null, and the caller promises the zero at its end.
    let text = unsafe { CStr::from_ptr(text) };
    text.to_str().map_err(|error| {
        Failure::argument(format!(
            "{name} is not UTF-8 from byte {} on: give it in UTF-8",
            error.valid_up_to()
        ))
    })
}

/// An array that is read. Without elements it may be null.
///
/// # Safety
/// If `first` is not null, `count` elements lie there and do not change while the result is in use.
#[allow(unsafe_code, reason = "memory of the caller")]
pub(crate) unsafe fn array<'a, T: Copy>(
    name: &str,
    first: *const T,
    count: usize,
) -> Result<&'a [T], Failure> {
    if count == 0 {
        return Ok(&[]);
    }
    check(name, first, count)?;
    // SAFETY: not null, aligned, not longer than an object. The caller promises the elements.
    Ok(unsafe { slice::from_raw_parts(first, count) })
}

/// An array that is written. Without elements it may be null.
///
/// # Safety
/// As of [`array`], and nobody else uses the elements meanwhile.
#[allow(unsafe_code, reason = "memory of the caller")]
pub(crate) unsafe fn array_mut<'a, T: Copy>(
    name: &str,
    first: *mut T,
    count: usize,
) -> Result<&'a mut [T], Failure> {
    if count == 0 {
        return Ok(&mut []);
    }
    check(name, first, count)?;
    // SAFETY: not null, aligned, not longer than an object. The caller promises the elements.
    Ok(unsafe { slice::from_raw_parts_mut(first, count) })
}

/// A struct that is read.
///
/// # Safety
/// If `from` is not null, a struct lies there.
#[allow(unsafe_code, reason = "memory of the caller")]
pub(crate) unsafe fn read<T: Copy>(name: &str, from: *const T) -> Result<T, Failure> {
    check(name, from, 1)?;
    // SAFETY: not null and aligned. The caller promises the struct.
    Ok(unsafe { from.read() })
}

/// A place for one result.
///
/// # Safety
/// If `to` is not null, it may be written while the result is in use.
#[allow(unsafe_code, reason = "memory of the caller")]
pub(crate) unsafe fn out<'a, T>(name: &str, to: *mut T) -> Result<Out<'a, T>, Failure> {
    check(name, to.cast_const(), 1)?;
    let lives = PhantomData;
    Ok(Out { to, lives })
}

/// Refuses an array that is read and one that is written in the same memory.
pub(crate) fn check_apart<T, U>(
    (name, first, count): (&str, *const T, usize),
    (to_name, to, to_count): (&str, *const U, usize),
) -> Result<(), Failure> {
    if count == 0 || to_count == 0 {
        return Ok(());
    }
    check(name, first, count)?;
    check(to_name, to, to_count)?;
    // Neither overflows: checked.
    let read = first.addr()..first.addr() + size_of::<T>() * count;
    let written = to.addr()..to.addr() + size_of::<U>() * to_count;
    if read.end <= written.start || written.end <= read.start {
        return Ok(());
    }
    Err(Failure::argument(format!(
        "{to_name} lies in the memory of {name}, which is read: give it memory of its own"
    )))
}

/// The product of counts that the caller gives.
pub(crate) fn product(name: &str, counts: &[usize]) -> Result<usize, Failure> {
    let product = |all: usize, count: &usize| all.checked_mul(*count);
    counts.iter().try_fold(1, product).ok_or_else(|| {
        let counts: Vec<String> = counts.iter().map(ToString::to_string).collect();
        let counts = counts.join(" × ");
        Failure::argument(format!("{name} of {counts} elements: no memory holds so many"))
    })
}

fn check<T>(name: &str, first: *const T, count: usize) -> Result<(), Failure> {
    if first.is_null() {
        return Err(Failure::argument(format!("{name} is NULL: give it a pointer")));
    }
    if !first.is_aligned() {
        return Err(Failure::argument(format!(
            "{name} lies at {:#x}: its address must be a multiple of {}",
            first.addr(),
            align_of::<T>()
        )));
    }
    let most = isize::MAX as usize / size_of::<T>().max(1);
    let bytes = size_of::<T>().saturating_mul(count);
    if count > most || first.addr().checked_add(bytes).is_none() {
        return Err(Failure::argument(format!(
            "{name} of {count} elements of {} bytes: no memory holds so many",
            size_of::<T>()
        )));
    }
    Ok(())
}
