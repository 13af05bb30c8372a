//! Where on a surface one looks, how much of it, and what is kept of it at every size.

pub mod place;
pub mod pyramid;

pub use place::{Footprint, Place};
pub use pyramid::{Pyramid, Wrap};
