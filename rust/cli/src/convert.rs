//! `glimt convert`: from every format that can be read to every one that can be written.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use clap::builder::NonEmptyStringValueParser;
use glimt_core::library::Entry;
use glimt_core::material::At;
use glimt_core::models::maps::Maps;
use glimt_core::{Library, Material};
use glimt_disk::STANDARD_OUTPUT;
use glimt_files::Source;
use glimt_measured::Colours;
use glimt_measured::utia::Encoding;
use rayon::prelude::*;

use crate::output::Overwrite;
use crate::place::PlaceArguments;
use crate::textures::{self, Opened};
use crate::values::PrecisionName;
use crate::{Usage, fitting, inputs, output};

/// Convert files: NBRDF weights or libraries to one library, models or measurements to a measured format
///
/// OUT is a file, whose extension says the format, or a directory, into which every material is written
/// as a file of its own. MERL stores isotropic, reciprocal materials: the half vector stays in one plane,
/// and both orders of light and view are averaged. RGL stores any material, and
/// Mitsuba's own `measured` renders it, in RGB or, with --spectral, in spectral variants; pbrt-v4 reads the latter.
/// UTIA stores directions 15° and 7.5° apart.
/// IN may also be a folder of texture maps, as ambientCG, Poly Haven, MatSynth and glTF name them: it is a surface,
/// and a library keeps it whole. In a measured format it is what it is at --uv.
#[derive(clap::Args)]
pub struct Arguments {
    /// Files, directories or globs to read, and last, without -o, the file or directory to write; - for the standard
    /// input and output
    #[arg(required = true, value_names = ["IN", "OUT"], num_args = 1..)]
    paths: Vec<PathBuf>,
    /// The file or directory to write
    #[arg(short, long, value_name = "OUT", value_parser = inputs::file_or_output())]
    output: Option<PathBuf>,
    /// Name of the material to convert; all if not given
    #[arg(long, value_name = "NAME", value_parser = NonEmptyStringValueParser::new())]
    material: Option<String>,
    /// Format to write, where the extension of OUT does not say it
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: Option<Format>,
    /// Write spectra instead of linear sRGB: smooth ones with the same colours (RGL)
    #[arg(long)]
    spectral: bool,
    #[command(flatten)]
    maps: textures::Options,
    /// In how many bits the texels of maps are kept in a library [default: as they are; texture maps in f32]
    #[arg(long, value_enum, value_name = "BITS")]
    precision: Option<PrecisionName>,
    #[command(flatten)]
    place: PlaceArguments,
    #[command(flatten)]
    overwrite: Overwrite,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Model library (.safetensors)
    Library,
    /// MERL table (.binary), 33 MB
    Merl,
    /// RGL table (.bsdf), 4 MB if isotropic, else 29 MB; several times as much with --spectral
    Rgl,
    /// UTIA table (.bin), 2 MB
    Utia,
}

impl Format {
    fn extension(self) -> &'static str {
        match self {
            Format::Library => "safetensors",
            Format::Merl => "binary",
            Format::Rgl => "bsdf",
            Format::Utia => "bin",
        }
    }

    fn as_output(self) -> output::Format {
        match self {
            Format::Library => output::Format::Library,
            Format::Merl => output::Format::Merl,
            Format::Rgl => output::Format::Rgl,
            Format::Utia => output::Format::Utia,
        }
    }

    fn of(path: &Path) -> Result<Format, Usage> {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        let formats = [Format::Library, Format::Merl, Format::Rgl, Format::Utia];
        formats.into_iter().find(|format| extension.eq_ignore_ascii_case(format.extension())).ok_or_else(|| {
            Usage(format!(
                "the extension of {} names no format that can be written; expected .safetensors, .bsdf, .binary \
                 or .bin, or the format with --to",
                path.display()
            ))
        })
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let (inputs, out) = match (&arguments.output, &arguments.paths[..]) {
        (Some(out), inputs) => (inputs, out.clone()),
        (None, [inputs @ .., out]) => (inputs, inputs::or_standard_output(out.clone())),
        (None, []) => unreachable!("paths are required"),
    };
    let out = &out;
    if inputs.is_empty() {
        return Err(Usage(format!("{} is all that was given, expected IN and OUT", out.display())).into());
    }
    let format = arguments.to.map_or_else(|| Format::of(out), Ok)?;
    if arguments.spectral && format != Format::Rgl {
        let extension = format.extension();
        return Err(Usage(format!("--spectral does not apply to .{extension} files, but to .bsdf")).into());
    }
    if arguments.precision.is_some() && format != Format::Library {
        let extension = format.extension();
        return Err(
            Usage(format!("--precision does not apply to .{extension} files, but to .safetensors")).into()
        );
    }
    if arguments.place.is_given() && format == Format::Library {
        let reason = "--uv and --footprint do not apply to a library, which keeps surfaces whole, but to .bsdf, .binary \
                      and .bin files";
        return Err(Usage(reason.into()).into());
    }
    let colours = if arguments.spectral { Colours::Spectra } else { Colours::Rgb };
    let into_directory = out.is_dir() || out.as_os_str().as_encoded_bytes().ends_with(b"/");
    if format == Format::Library || !into_directory {
        arguments.overwrite.check(out, format.as_output())?;
    }
    let sources = open(inputs, out, arguments)?;
    if format == Format::Library {
        return write_library(out, &sources, arguments);
    }
    let materials = materials(&sources, arguments.material.as_deref(), &arguments.place)?;
    if into_directory {
        let files = Files { directory: out, format, colours, overwrite: arguments.overwrite };
        return files.write(&sources, &materials);
    }
    match materials[..] {
        [ref material] => write_table(out, material, format, colours),
        _ => bail!(
            "{} holds one material, but there are {}; name one with --material, or give a directory and --to",
            out.display(),
            materials.len()
        ),
    }
}

/// Opens what is read. Of texture maps, which are read with freedom, it says what was made of them.
fn open(inputs: &[PathBuf], out: &Path, arguments: &Arguments) -> Result<Vec<Source>> {
    if !inputs.iter().any(|input| textures::are_at(input)) {
        arguments.maps.refuse()?;
        return inputs::open_any(inputs, &[out]);
    }
    let command = fitting::command(&arguments.paths);
    let mut sources = Vec::new();
    for input in inputs {
        if !textures::are_at(input) {
            sources.extend(inputs::open(std::slice::from_ref(input), &[out])?);
            continue;
        }
        let only = arguments.material.as_deref();
        let Opened { source, findings, .. } = textures::open(input, only, &arguments.maps, &[out], &command)?;
        let lines: String = findings.iter().map(|finding| format!("{finding}\n")).collect();
        if out == Path::new(STANDARD_OUTPUT) {
            lines.lines().for_each(output::note);
        } else {
            output::print(&lines)?;
        }
        sources.push(source);
    }
    Ok(sources)
}

/// A material as it is written to a table.
struct Shown<'a> {
    name: String,
    material: &'a Material,
    /// A surface at its place.
    brdf: At<'a>,
}

impl Shown<'_> {
    fn is_isotropic(&self) -> bool {
        self.material.is_isotropic()
    }
}

/// The materials of all sources, or those of that name.
fn materials<'a>(
    sources: &'a [Source],
    only: Option<&str>,
    place: &PlaceArguments,
) -> Result<Vec<Shown<'a>>> {
    let mut materials = Vec::new();
    for source in sources {
        let names = only.map_or_else(|| source.names(), |name| vec![name.to_owned()]);
        for name in names {
            let material = source.brdf(Some(&name))?;
            let brdf = place.look(&name, material)?;
            materials.push(Shown { name, material, brdf });
        }
    }
    Ok(materials)
}

fn write_library(path: &Path, sources: &[Source], arguments: &Arguments) -> Result<()> {
    let mut entries: Vec<Entry> = Vec::new();
    for source in sources {
        let library = source.library()?;
        match &arguments.material {
            Some(name) => entries.push(library.entry(Some(name))?.clone()),
            None => entries.extend(library.entries()?.into_iter().cloned()),
        }
    }
    if let Some(precision) = arguments.precision {
        for Entry { name, material, .. } in &mut entries {
            let maps = <&Maps>::try_from(&*material).map_err(|()| {
                Usage(format!(
                    "--precision does not apply to \"{name}\", a {} material, but to maps",
                    material.kind()
                ))
            })?;
            *material = maps.rounded(precision.into()).into();
        }
    }
    Ok(Library::new(path, entries)?.save()?)
}

/// A file for each material.
struct Files<'a> {
    directory: &'a Path,
    format: Format,
    colours: Colours,
    overwrite: Overwrite,
}

impl Files<'_> {
    fn path(&self, name: &str) -> PathBuf {
        self.directory.join(format!("{name}.{}", self.format.extension()))
    }

    fn write(&self, sources: &[Source], materials: &[Shown]) -> Result<()> {
        let cannot_write = || format!("cannot write {}", self.directory.display());
        std::fs::create_dir_all(self.directory).with_context(cannot_write)?;
        for (i, Shown { name, .. }) in materials.iter().enumerate() {
            let path = self.path(name);
            if name.contains(['/', '\\']) {
                bail!("the material \"{name}\" cannot be the name of a file");
            }
            inputs::keep_apart(sources.iter().map(Source::path), &[&path])?;
            if materials[..i].iter().any(|other| other.name == *name) {
                bail!("two materials are named \"{name}\", and both would become {}", path.display());
            }
            self.overwrite.check(&path, self.format.as_output())?;
        }
        let bar = output::progress_bar(materials.len(), "write");
        materials.par_iter().try_for_each(|material| {
            write_table(&self.path(&material.name), material, self.format, self.colours)?;
            bar.inc(1);
            Ok(())
        })
    }
}

fn write_table(path: &Path, material: &Shown, format: Format, colours: Colours) -> Result<()> {
    let Shown { name, brdf, .. } = material;
    if format == Format::Merl && !material.is_isotropic() {
        output::note(&format!(
            "warning: \"{name}\" is anisotropic, and MERL stores isotropic materials: {} holds its half vectors of \
             one azimuth; .bsdf and .bin keep the others",
            path.display()
        ));
    }
    match format {
        Format::Merl => glimt_measured::write_merl(path, brdf)?,
        Format::Rgl => {
            let description = format!("{} model \"{name}\", written by glimt", material.material.kind());
            glimt_measured::write_rgl(path, brdf, material.is_isotropic(), colours, &description)?;
        }
        Format::Utia => glimt_measured::write_utia(path, brdf, Encoding::default())?,
        Format::Library => unreachable!("a library is written as a whole"),
    }
    Ok(())
}
