//! Readers and writers of measured BRDFs: the MERL, RGL and UTIA databases.
//!
//! ```no_run
//! use glimt_core::{Brdf, Vec3};
//! use glimt_measured::Measured;
//!
//! let material = Measured::open("chm_orange_rgb.bsdf")?;
//! println!("{}: {}", material.name(), material.eval(Vec3::Z, Vec3::Z));
//! # Ok::<(), glimt_measured::Error>(())
//! ```

pub mod error;
pub mod file;
pub mod grid;
mod holes;
mod measured;
pub mod merl;
pub mod primaries;
pub mod rgl;
mod rgl_write;
pub mod spectrum;
pub mod tensor;
pub mod utia;
pub mod warp;

pub use error::Error;
pub use measured::Measured;
pub use merl::{Merl, write_merl};
pub use rgl::Rgl;
pub use rgl_write::{Colours, rgl_bytes, write_rgl};
pub use utia::{Utia, write_utia};
