//! What the C interface answers, and the message that goes with an error.

// Types are spelled as in C.
#![allow(non_camel_case_types)]

use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

use glimt_disk::printable;

/// What a function answers.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum glimt_status {
    /// It did what it says.
    GLIMT_OK = 0,
    /// An argument is NULL that must not be, a name is not UTF-8, or a size is 0.
    GLIMT_ERROR_ARGUMENT = 1,
    /// The file cannot be read.
    GLIMT_ERROR_READ = 2,
    /// The file is not a model library, or not a valid one.
    GLIMT_ERROR_FORMAT = 3,
    /// The library has no material of that name, or has several and none was named.
    GLIMT_ERROR_MATERIAL = 4,
    /// A parameter is out of its range, or the model has no such parameter.
    GLIMT_ERROR_PARAMETER = 5,
    /// An error of glimt itself.
    GLIMT_ERROR_INTERNAL = 6,
    /// The file cannot be written.
    GLIMT_ERROR_WRITE = 7,
}
use glimt_status::*;

thread_local! {
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// Keeps the message for `glimt_last_error`.
pub(crate) fn fail(status: glimt_status, message: impl Into<String>) -> glimt_status {
    let mut message = printable(&message.into()).into_owned().into_bytes();
    message.retain(|&byte| byte != 0);
    // A thread that is ending has no place for messages left, and nobody who could ask for them.
    let _ = LAST_ERROR.try_with(|last| *last.borrow_mut() = CString::new(message).unwrap_or_default());
    status
}

/// The message of the last error in this thread, for as long as it is the last; empty if there was none.
pub(crate) fn last_error() -> *const c_char {
    LAST_ERROR.try_with(|last| last.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}

/// What `f` returns, or `fallback` where it panics: a panic that reached C would end the process.
pub(crate) fn guarded<T>(fallback: T, f: impl FnOnce() -> T) -> T {
    catch_unwind(AssertUnwindSafe(f)).unwrap_or(fallback)
}

/// Whether `f` did what it says; a panic becomes a status, as it must not reach C.
pub(crate) fn call(f: impl FnOnce() -> Result<(), glimt_status>) -> glimt_status {
    match guarded(None, || Some(f())) {
        Some(Ok(())) => GLIMT_OK,
        Some(Err(status)) => status,
        None => fail(GLIMT_ERROR_INTERNAL, "internal error of glimt; the standard error stream says more"),
    }
}
