//! The core of glimt: what a renderer needs to evaluate and sample a fitted BRDF.
//!
//! The folders are floors, and each imports only from those before it: `simd`, `brdf`, `directions` and `microfacet`,
//! `kernels`, `sampling`, `models`, `material`, `library`.

pub mod brdf;
pub mod directions;
pub mod error;
pub mod kernels;
pub mod library;
pub mod material;
pub mod microfacet;
pub mod models;
pub mod oddity;
pub mod sampling;
pub mod simd;

pub use brdf::{Brdf, Sample, SampleBrdf, is_lit};
pub use error::Error;
pub use glam::Vec3;
pub use library::Library;
pub use material::{AnyModel, Kind, Material};
pub use models::Model;
pub use oddity::Oddity;
