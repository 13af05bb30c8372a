//! The core of glimt: what a renderer needs to evaluate and sample a fitted BRDF.

pub mod analytic;
pub mod brdf;
pub mod edit;
pub mod elevations;
pub mod error;
pub mod factor;
pub mod features;
pub mod ggx;
pub mod healpix;
pub mod hybrid;
pub mod kernel;
pub mod library;
pub mod lobes;
pub mod material;
pub mod math;
pub mod microfacet;
pub mod mixed;
pub mod model;
pub mod nbrdf;
pub mod network;
pub mod neural;
pub mod oddity;
pub mod sampler;
pub mod simd;
pub mod smith;
pub mod spherical;
pub mod table_sampler;
pub mod tabulated;

pub use brdf::{Brdf, Sample, SampleBrdf, is_lit};
pub use error::Error;
pub use glam::Vec3;
pub use library::Library;
pub use material::{AnyModel, Kind, Material};
pub use model::Model;
pub use oddity::Oddity;
