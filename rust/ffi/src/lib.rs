//! The C interface of glimt, as a static and as a shared library.
//!
//! Every function that C can call catches panics: one that unwound into foreign code would abort the whole program.

pub mod c_api;
pub mod image_api;
mod pointer;
pub mod status;
