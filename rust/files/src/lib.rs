//! Every file that holds reflectance, opened by its content: model libraries, measured tables, scattered
//! samples, and the network weights that Sztrajman et al. publish; and NumPy arrays.
//!
//! ```no_run
//! use glimt_core::{Brdf, Vec3};
//! use glimt_files::Source;
//!
//! let source = Source::open("gold-metallic-paint.npz")?;
//! println!("{}: {}", source.kind(), source.brdf(None)?.eval(Vec3::Z, Vec3::Z));
//! # Ok::<(), glimt_files::Error>(())
//! ```

mod error;
pub mod keras;
pub mod merl_fits;
pub mod nbrdf;
pub mod npy;
mod origin;
pub mod samples;
mod source;

pub use error::Error;
pub use npy::Array;
pub use origin::{sha256, sha256_of};
pub use samples::Samples;
pub use source::Source;
