//! The core of glimt: what a renderer needs to evaluate and sample a fitted BRDF.

pub mod brdf;
pub mod features;
pub mod ggx;
pub mod hybrid;
pub mod lobes;
pub mod math;
pub mod microfacet;
pub mod nbrdf;
pub mod network;
pub mod neural;
pub mod simd;

pub use brdf::{Brdf, Sample, SampleBrdf, is_lit};
pub use glam::Vec3;
