//! Folders of texture maps as materials.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow};
use clap::ValueEnum;
use glimt_core::Library;
use glimt_core::library::{Entry, Origin, SourceFile};
use glimt_core::models::maps::Filter;
use glimt_core::surface::Wrap;
use glimt_files::{Source, sha256, sha256_of};
use glimt_textures::{Error, Finding, Folder, MEMORY, Size};

use crate::{Usage, inputs};

/// How texture maps become a material.
#[derive(clap::Args)]
pub struct Options {
    /// Texels along the longer side to which larger texture maps are reduced [default: as many as they have]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1 << 16))]
    size: Option<u32>,
    /// How texture maps are seen from afar [default: moments]
    #[arg(long, value_enum, value_name = "FILTER")]
    filter: Option<FilterName>,
    /// What lies beyond the edges of texture maps [default: repeat]
    #[arg(long, value_enum, value_name = "WRAP")]
    wrap: Option<WrapName>,
}

#[derive(Clone, Copy, ValueEnum)]
enum FilterName {
    /// Normals that differ within a pixel make a rougher surface
    Moments,
    /// Averages of the maps alone, as renderers without such a filter see them
    Average,
}

#[derive(Clone, Copy, ValueEnum)]
enum WrapName {
    /// The maps again: they are a tile
    Repeat,
    /// The texels at the edge
    Clamp,
}

impl Options {
    /// Refuses options that have nothing to apply to.
    ///
    /// # Errors
    /// Names the option.
    pub fn refuse(&self) -> Result<(), Usage> {
        let given = [
            ("--size", self.size.is_some()),
            ("--filter", self.filter.is_some()),
            ("--wrap", self.wrap.is_some()),
        ];
        match given.iter().find(|(_, is_given)| *is_given) {
            None => Ok(()),
            Some((option, _)) => {
                Err(Usage(format!("{option} applies to folders of texture maps, and none is read")))
            }
        }
    }

    fn size(&self) -> Size {
        self.size.map_or(Size::Own, |size| Size::LongestSide(size as usize))
    }

    fn filter(&self) -> Filter {
        match self.filter {
            None | Some(FilterName::Moments) => Filter::Moments,
            Some(FilterName::Average) => Filter::Average,
        }
    }

    fn wrap(&self) -> Wrap {
        match self.wrap {
            None | Some(WrapName::Repeat) => Wrap::Repeat,
            Some(WrapName::Clamp) => Wrap::Clamp,
        }
    }
}

/// A material of texture maps.
pub struct Opened {
    /// A library of it alone.
    pub source: Source,
    /// What was taken, filled in, resized and odd.
    pub findings: Vec<Finding>,
    /// The files that were taken.
    pub files: Vec<PathBuf>,
}

/// Whether a path is a folder of texture maps, or a file that names or is one; if not, it is for [`inputs::open`].
pub fn are_at(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    match std::fs::read_dir(path) {
        Ok(mut folder) => folder.next().is_some() && !inputs::holds_materials(path),
        Err(_) => matches!(extension.as_str(), "gltf" | "glb" | "png" | "jpg" | "jpeg" | "exr"),
    }
}

/// Reads the material of a folder: the only one, or that of a name. `command` is kept in the library.
///
/// # Errors
/// Those of [`Folder`], and that `outputs` are among its files.
pub fn open(
    path: &Path,
    material: Option<&str>,
    options: &Options,
    outputs: &[&Path],
    command: &str,
) -> Result<Opened> {
    let folder = match material {
        Some(material) => Folder::open_material(path, material)?,
        None => Folder::open(path)?,
    };
    inputs::keep_apart(folder.files(), outputs)?;
    let maps = folder.maps(options.size(), MEMORY).map_err(|error| with_advice(error, &folder))?;
    let surface = maps.surface(options.wrap(), options.filter());
    let surface = surface.map_err(|reason| anyhow!("{}: {reason}", path.display()))?;
    let findings = folder.findings().iter().chain(&maps.findings).cloned().collect();
    let entry = Entry {
        name: folder.material().to_owned(),
        material: surface.into(),
        origin: origin(&folder, command)?,
    };
    let files = folder.files().into_iter().map(Path::to_owned).collect();
    Ok(Opened { source: Source::Library(Library::new(path, vec![entry])?), findings, files })
}

/// Smaller maps take less memory, unless it is the image itself that takes too much.
fn with_advice(error: Error, folder: &Folder) -> anyhow::Error {
    match error {
        Error::Memory { .. } if folder.memory(Size::LongestSide(1)) <= MEMORY => {
            anyhow!("{error}; --size N makes smaller maps")
        }
        error => error.into(),
    }
}

fn origin(folder: &Folder, command: &str) -> Result<Origin> {
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let file = |path: &Path| Ok(SourceFile { name: name(path), sha256: sha256(path)? });
    let files = folder.files().into_iter().map(file).collect::<Result<Vec<_>>>()?;
    let lines: String = files.iter().map(|file| format!("{}  {}\n", file.sha256, file.name)).collect();
    // The last part of `.` has no name.
    let path = folder.path().canonicalize().unwrap_or_else(|_| PathBuf::from(folder.path()));
    Ok(Origin {
        source: name(&path),
        sha256: sha256_of(lines.as_bytes()),
        files,
        command: command.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        ..Origin::default()
    })
}
