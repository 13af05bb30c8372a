//! What is computed of directions before anything reflects: inputs of networks, and places on the sphere.

pub mod elevations;
pub mod features;
pub mod healpix;
