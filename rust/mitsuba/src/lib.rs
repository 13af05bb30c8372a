//! The core of glimt for its Mitsuba plugin, as one static library: a cxx bridge, and the functions that compiled
//! kernels call.
//!
//! Every function that C++ can call catches panics: one that unwound into foreign code would abort
//! the whole renderer.

mod bridge;
mod material;
mod packet;
mod place_packet;
mod ray_hit;
mod sampler_packet;
