//! Error metrics of BRDFs and of images.

pub mod brdf_error;
pub mod error;
pub mod image;

pub use brdf_error::{BrdfError, Protocol};
pub use error::Error;
