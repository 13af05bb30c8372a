//! Error metrics of BRDFs and of images, studies of models against measurements, and the page of a study.
//!
//! [`brdf_error`] and [`image`] measure; [`study`] puts models beside measurements with them; [`page`] and [`table`]
//! show a study.

pub mod brdf_error;
pub mod error;
pub mod image;
pub mod page;
pub mod study;
pub mod table;

pub use brdf_error::{BrdfError, Protocol};
pub use error::Error;
