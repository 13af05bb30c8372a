//! Error metrics of BRDFs.

pub mod brdf_error;

pub use brdf_error::{BrdfError, Protocol};
