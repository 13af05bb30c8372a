//! Fitting surfaces: what is seen of them at every place and scale.

pub mod dual;
pub mod gated;
pub mod queries;
pub mod training;
