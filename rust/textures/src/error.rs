//! What can go wrong with texture maps. Every message names the file.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use crate::Map;

/// Why texture maps could not be read.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system would not let the file be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// The file is no image of a format that is read here, or no whole one.
    #[error("{} is not {format}: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What it should have been, with an article.
        format: &'static str,
        /// What was found and what was expected.
        reason: String,
    },
    /// A folder has no map of the colour.
    #[error(
        "{} has no map of the colour: {found}; expected a PNG, JPEG or OpenEXR image whose name ends in Color, \
         BaseColor, Albedo, Diffuse or diff",
        path.display()
    )]
    NoColor {
        /// The folder.
        path: PathBuf,
        /// What it has instead.
        found: String,
    },
    /// Several materials, and none was named.
    #[error("{} has {} materials, name one of them: {}", path.display(), names.len(), Few(names))]
    SeveralMaterials {
        /// The folder or glTF file.
        path: PathBuf,
        /// Their names.
        names: Vec<String>,
    },
    /// No material has the name that was asked for.
    #[error("{} has no material \"{}\", only {}", path.display(), name.escape_debug(), Few(names))]
    NoMaterial {
        /// The folder or glTF file.
        path: PathBuf,
        /// The name.
        name: String,
        /// The names that there are.
        names: Vec<String>,
    },
    /// One image was given, and its name says that it is no map of the colour.
    #[error("{} is a map of {found} by its name, expected one of the colour, or the folder of all maps", path.display())]
    NotColor {
        /// The file.
        path: PathBuf,
        /// What the map is of.
        found: &'static str,
    },
    /// The image has too few channels for what it should be.
    #[error("{} has {found}, expected {expected} for the {map}", path.display())]
    Channels {
        /// The file.
        path: PathBuf,
        /// What it was taken for.
        map: Map,
        /// The channels that it has.
        found: &'static str,
        /// The channels that are needed.
        expected: &'static str,
    },
    /// The image is no map of normals, by its texels.
    #[error("{} holds no normals: {found}, expected unit vectors as (n + 1)/2", path.display())]
    NotNormals {
        /// The file.
        path: PathBuf,
        /// What its texels are.
        found: String,
    },
    /// Two maps have different shapes, so that they cannot be of one material.
    #[error(
        "{} has {} × {} texels and {} has {} × {}: expected maps of one shape",
        path.display(), size[0], size[1], other.display(), other_size[0], other_size[1]
    )]
    Shape {
        /// A map.
        path: PathBuf,
        /// Its width and height.
        size: [usize; 2],
        /// The largest map.
        other: PathBuf,
        /// Its width and height.
        other_size: [usize; 2],
    },
    /// A width or height of no texel was asked for.
    #[error("{}: maps of {} × {} texels were asked for, expected at least one", path.display(), size[0], size[1])]
    NoTexels {
        /// The folder.
        path: PathBuf,
        /// The width and height.
        size: [usize; 2],
    },
    /// Decoding would take more memory than it may.
    #[error(
        "{} has {} × {} texels: to decode it and make maps of {} × {} takes {}, expected at most {}",
        path.display(), size[0], size[1], wanted[0], wanted[1], Amount(*bytes), Amount(*limit)
    )]
    Memory {
        /// The image that takes most.
        path: PathBuf,
        /// Its width and height.
        size: [usize; 2],
        /// The width and height of the maps to be made.
        wanted: [usize; 2],
        /// What it takes in bytes.
        bytes: u64,
        /// What it may take in bytes.
        limit: u64,
    },
}

impl Error {
    /// An error of reading `path`, for `map_err`.
    pub(crate) fn read(path: &Path) -> impl FnOnce(io::Error) -> Error + '_ {
        |source| Error::Read { path: path.to_owned(), source }
    }
}

/// Names for a message; a folder may have any number.
pub(crate) struct Few<'a>(pub(crate) &'a [String]);

impl fmt::Display for Few<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        const MOST: usize = 6;
        for (i, name) in self.0.iter().take(MOST).enumerate() {
            write!(f, "{}\"{}\"", if i == 0 { "" } else { ", " }, name.escape_debug())?;
        }
        if self.0.len() > MOST { write!(f, " and {} more", self.0.len() - MOST) } else { Ok(()) }
    }
}

/// An amount of memory for a message.
struct Amount(u64);

impl fmt::Display for Amount {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let (mega, giga) = ((1_u64 << 20) as f64, (1_u64 << 30) as f64);
        let bytes = self.0 as f64;
        if bytes < mega {
            write!(f, "{} bytes", self.0)
        } else if bytes < giga {
            write!(f, "{:.1} MiB", bytes / mega)
        } else {
            write!(f, "{:.1} GiB", bytes / giga)
        }
    }
}
