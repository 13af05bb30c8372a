//! The core of glimt for C and C++ callers, as one static library.
//!
//! Every function that C++ can call catches panics: one that unwound into foreign code would abort
//! the whole renderer.

mod bridge;
pub mod c_api;
pub mod image_api;
mod packet;
mod sampler_packet;
