//! A measured file of any format.

use std::path::Path;
use std::sync::Arc;

use glam::Vec3;
use glimt_core::models::tabulated::{Table, Tabulated};
use glimt_core::{Brdf, Material, Oddity};

use crate::error::Error;
use crate::file;
use crate::merl::{self, Merl};
use crate::rgl::Rgl;
use crate::tensor;
use crate::utia::{self, Encoding, Utia};

/// A measured BRDF as it is: a table and its interpolation.
///
/// f is linear RGB in sr⁻¹, never negative; reciprocal only for [`Merl`].
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one per material, and a box would cost every eval")]
pub enum Measured {
    /// MERL `.binary`.
    Merl(Merl),
    /// RGL `.bsdf`.
    Rgl(Rgl),
    /// UTIA `.bin`.
    Utia(Utia),
}

impl Measured {
    /// Opens a file by its content: the magic of RGL, the dimensions of MERL, the length of UTIA. A file
    /// that has none of these is reported as a broken one of the format that its extension names.
    ///
    /// # Errors
    /// [`Error::UnknownFormat`] if the extension names none either, and the errors of the formats.
    pub fn open(path: impl AsRef<Path>) -> Result<Measured, Error> {
        let path = path.as_ref();
        let (size, start) = file::read_start(path, tensor::MAGIC.len() as u64)?;
        let merl_header: Vec<u8> = merl::BINS.iter().flat_map(|&bins| (bins as i32).to_le_bytes()).collect();
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        if start == tensor::MAGIC {
            Rgl::open(path).map(Measured::Rgl)
        } else if start == merl_header {
            Merl::open(path).map(Measured::Merl)
        } else if usize::try_from(size).is_ok_and(|size| utia::FILE_SIZES.contains(&size)) {
            Utia::open(path, Encoding::default()).map(Measured::Utia)
        } else {
            match extension.to_ascii_lowercase().as_str() {
                "bsdf" => Rgl::open(path).map(Measured::Rgl),
                "binary" => Merl::open(path).map(Measured::Merl),
                "bin" => Utia::open(path, Encoding::default()).map(Measured::Utia),
                _ => Err(Error::UnknownFormat {
                    path: path.to_owned(),
                    found: format!("{size} bytes that begin with \"{}\"", start.escape_ascii()),
                }),
            }
        }
    }

    /// The material's name, from that of the file.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Measured::Merl(merl) => merl.name(),
            Measured::Rgl(rgl) => rgl.name(),
            Measured::Utia(utia) => utia.name(),
        }
    }

    /// As a material that renderers hold: RGL files are sampled by their own warps, the others by
    /// tables.
    #[must_use]
    pub fn into_material(self) -> Material {
        Material::from(match self {
            Measured::Merl(merl) => Tabulated::new(Arc::new(merl), None),
            Measured::Utia(utia) => Tabulated::new(Arc::new(utia), None),
            Measured::Rgl(rgl) => {
                let rgl = Arc::new(rgl);
                Tabulated::new(rgl.clone(), Some(rgl))
            }
        })
    }

    fn table(&self) -> &dyn Table {
        match self {
            Measured::Merl(merl) => merl,
            Measured::Rgl(rgl) => rgl,
            Measured::Utia(utia) => utia,
        }
    }

    /// See [`Table::is_isotropic`].
    #[must_use]
    pub fn is_isotropic(&self) -> bool {
        self.table().is_isotropic()
    }

    /// See [`Table::description`].
    #[must_use]
    pub fn description(&self) -> &str {
        self.table().description()
    }

    /// See [`Table::oddities`].
    #[must_use]
    pub fn oddities(&self) -> &[Oddity] {
        self.table().oddities()
    }
}

impl Brdf for Measured {
    #[inline]
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        match self {
            Measured::Merl(merl) => merl.eval(light, view),
            Measured::Rgl(rgl) => rgl.eval(light, view),
            Measured::Utia(utia) => utia.eval(light, view),
        }
    }

    fn eval_batch(&self, light: &[Vec3], view: &[Vec3], out: &mut [Vec3]) {
        self.table().eval_batch(light, view, out);
    }

    fn has_data(&self, light: Vec3, view: Vec3) -> bool {
        self.table().has_data(light, view)
    }
}
