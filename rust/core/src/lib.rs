//! The core of glimt: what a renderer needs to evaluate and sample a fitted BRDF.
//!
//! A [`Library`] is a file of materials. A [`Material`] answers f ([`Brdf`]), and samples light directions with an exact
//! density ([`SampleBrdf`]):
//!
//! ```
//! use glimt_core::{Brdf, Library, SampleBrdf, Vec3};
//!
//! let library = Library::open("../../scenes/models/rgl.safetensors")?;
//! let orange = library.material(Some("chm_orange"))?;
//! let (light, view) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.6, 0.0, 0.8));
//! let f = orange.eval(light, view); // sr⁻¹, linear RGB, no cosine
//! let density = orange.pdf(light, view);
//! let sample = orange.sample(view, Vec3::new(0.1, 0.2, 0.3)); // light, pdf, f cosθ / pdf
//! assert!(f.x > f.z && density > 0.0 && sample.light.z > 0.0);
//! # Ok::<(), glimt_core::Error>(())
//! ```
//!
//! Directions are unit vectors in a local frame with the normal +z, and point away from the surface. `light` is Mitsuba's
//! `wo` and pbrt's `wi`, `view` is Mitsuba's `wi` and pbrt's `wo`.
//!
//! The folders are floors, and each imports only from those before it: `simd`, `brdf`, `directions`, `microfacet` and
//! `surface`, `kernels`, `sampling`, `models`, `material`, `library`.

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
pub mod surface;

pub use brdf::{Brdf, Sample, SampleBrdf, is_lit};
pub use error::{Error, Invalid, Unmixable};
pub use glam::Vec3;
pub use library::Library;
pub use material::{AnyModel, Kind, Material};
pub use models::Model;
pub use oddity::Oddity;
