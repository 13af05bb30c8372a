//! Readers and writers of measured BRDF formats.

pub mod error;
pub mod grid;
pub mod rgl;
pub mod spectrum;
pub mod tensor;
pub mod warp;

use std::path::Path;

pub use error::Error;
pub use rgl::Rgl;

/// The file's name without directory and extension.
fn file_stem(path: &Path) -> String {
    path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
}
