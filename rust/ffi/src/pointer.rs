//! The pointers that C hands in.
//!
//! The headers say of every argument what it must point to, and for how long. That is the one promise on which all of
//! [`In`], [`Out`] and [`Held`] rely: they are made of arguments of `extern "C"` functions and of nothing else, and
//! live no longer than the call. What can be told about a pointer, whether it is NULL, they tell.

use std::ffi::{CStr, c_char};

use crate::status::glimt_status::{self, GLIMT_ERROR_ARGUMENT};
use crate::status::{fail, guarded};

/// NULL, or a pointer to one or more `T` that nobody changes during the call.
pub struct In<T>(pub *const T);

impl<T> In<T> {
    /// What it points to, or nothing for NULL.
    pub fn optional<'a>(self) -> Option<&'a T> {
        // SAFETY: the promise of the headers, see above.
        unsafe { self.0.as_ref() }
    }

    /// What it points to; NULL is an error that names the argument.
    pub fn get<'a>(self, argument: &str) -> Result<&'a T, glimt_status> {
        self.optional().ok_or_else(|| missing(argument))
    }

    /// The `n` that it points to.
    pub fn slice<'a>(self, n: usize, argument: &str) -> Result<&'a [T], glimt_status> {
        if self.0.is_null() {
            return Err(missing(argument));
        }
        // SAFETY: the promise of the headers, see above.
        Ok(unsafe { std::slice::from_raw_parts(self.0, n) })
    }
}

impl In<f32> {
    /// The same numbers in arrays.
    pub fn arrays<const N: usize>(self) -> In<[f32; N]> {
        In(self.0.cast())
    }
}

impl In<c_char> {
    /// The string that it points to, which is UTF-8.
    pub fn str<'a>(self, argument: &str) -> Result<&'a str, glimt_status> {
        let start = self.0;
        self.get(argument)?;
        // SAFETY: the promise of the headers, see above: strings end with a zero byte.
        let text = unsafe { CStr::from_ptr(start) };
        text.to_str().map_err(|_| fail(GLIMT_ERROR_ARGUMENT, format!("{argument} is not UTF-8")))
    }
}

/// NULL, or a pointer to room for one or more `T`, at which nobody else looks during the call.
pub struct Out<T>(pub *mut T);

impl<T: Copy> Out<T> {
    /// Writes an answer.
    pub fn set(&mut self, value: T, argument: &str) -> Result<(), glimt_status> {
        self.check(argument)?;
        // SAFETY: the promise of the headers, see above. What was there needs no drop.
        unsafe { self.0.write(value) };
        Ok(())
    }

    /// The room for `n` answers, which are numbers of some kind: any bits are such.
    pub fn slice<'a>(self, n: usize, argument: &str) -> Result<&'a mut [T], glimt_status> {
        self.check(argument)?;
        // SAFETY: the promise of the headers, see above.
        Ok(unsafe { std::slice::from_raw_parts_mut(self.0, n) })
    }

    fn check(&self, argument: &str) -> Result<(), glimt_status> {
        if self.0.is_null() { Err(missing(argument)) } else { Ok(()) }
    }
}

impl<T> Out<*mut T> {
    /// Where an object goes that C will hold: NULL until there is one.
    pub fn empty(mut self, argument: &str) -> Result<Self, glimt_status> {
        self.set(std::ptr::null_mut(), argument)?;
        Ok(self)
    }

    /// Gives an object to C, which hands it back as [`Held`].
    pub fn give(mut self, object: T, argument: &str) -> Result<(), glimt_status> {
        self.check(argument)?;
        self.set(Box::into_raw(Box::new(object)), argument)
    }
}

/// NULL, or an object that [`Out::give`] gave to C and that C uses no more.
pub struct Held<T>(pub *mut T);

impl<T> Held<T> {
    /// Ends the object.
    pub fn release(self) {
        if !self.0.is_null() {
            // SAFETY: the promise of the headers, see above.
            let object = unsafe { Box::from_raw(self.0) };
            guarded((), || drop(object));
        }
    }
}

/// What is answered where an argument is NULL that must not be.
fn missing(argument: &str) -> glimt_status {
    fail(GLIMT_ERROR_ARGUMENT, format!("{argument} is NULL"))
}
