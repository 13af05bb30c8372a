//! Fitting glimt's models to measured or simulated reflectance.

pub mod backprop;
