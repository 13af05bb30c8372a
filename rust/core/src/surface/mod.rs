//! Where on a surface one looks, how much of it, and what is kept of it at every size.

pub mod place;
pub mod precision;
pub mod pyramid;

pub use place::{Footprint, Place};
pub use precision::{Precision, Range};
pub use pyramid::{Layout, Pyramid, Wrap};
