//! Texture maps as their sources name them: ambientCG, Poly Haven, MatSynth and glTF.
//!
//! [`Folder::open`] finds the files of a material and reads their headers. [`Folder::maps`] decodes them into the
//! parameters of a metallic-roughness material at every texel, all of one size, and [`Maps::surface`] makes a material
//! of them. What was taken, filled in or left out is said in [`Finding`]s, and nothing of the images' size is allocated
//! before it is compared with a limit.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let folder = std::env::temp_dir().join(format!("glimt-textures-example-{}", std::process::id()));
//! # std::fs::create_dir_all(&folder)?;
//! # let mut encoder = png::Encoder::new(std::fs::File::create(folder.join("Wood049_1K_Color.png"))?, 2, 2);
//! # encoder.set_color(png::ColorType::Rgb);
//! # encoder.write_header()?.write_image_data(&[188; 12])?;
//! use glimt_textures::{Folder, MEMORY, Size};
//!
//! let folder = Folder::open(&folder)?;
//! for finding in folder.findings() {
//!     println!("{finding}"); // colour: Wood049_1K_Color.png, 2 × 2 texels, 8 bits, PNG, sRGB …
//! }
//! let maps = folder.maps(Size::LongestSide(256), MEMORY)?;
//! assert_eq!((maps.size, maps.roughness[0]), ([2, 2], 0.5));
//! # std::fs::remove_dir_all(folder.path())?;
//! # Ok(())
//! # }
//! ```

mod decode;
pub mod error;
pub mod finding;
mod folder;
mod gltf;
mod green;
mod image;
mod maps;
mod names;
mod normal;
mod recipe;
mod resample;
mod source;
mod surface;

pub use error::Error;
pub use finding::{Finding, Map, Oddity};
pub use folder::{Folder, MEMORY};
pub use maps::{Maps, Size};
