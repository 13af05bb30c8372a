//! Fitting glimt's models to measured or simulated reflectance.

pub mod adamw;
pub mod analytic;
pub mod backprop;
pub mod checkpoint;
pub mod error;
pub mod fit;
pub mod ggx;
pub mod hybrid;
pub mod loss;
pub mod neural;
pub mod objective;
pub mod pairs;
pub mod train;
