//! `glimt check`: does a material do what it says?

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::builder::NonEmptyStringValueParser;
use glimt_check::edits::EditLaw;
use glimt_check::{BrdfSubject, Claims, Options, Report};
use glimt_core::Material;
use glimt_core::material::At;
use glimt_core::sampling::SamplerChoice;
use glimt_core::surface::{Footprint, Place};
use glimt_files::Source;

use crate::edit::{self, Edit};
use crate::output::{Format, Overwrite};
use crate::place::{self, PlaceArguments};
use crate::{inputs, output};

/// Test materials: sampling, weights, energy, symmetry, the horizon
///
/// Every material goes through the same tests: samples against the density by χ², weights against f·cosθ/pdf,
/// the mean weight against an integral that no sampler has touched, and more; docs/guide/check.md explains each.
/// A surface is tested at several places and footprints, or at the one that is named. Exit code 1 if one fails. Warnings (an albedo above 1 among them) do not, nor does what a measurement says against
/// physics: that is of its file.
#[derive(clap::Args)]
pub struct Arguments {
    /// Model libraries, measurements or NBRDF weights; directories and globs of them
    #[arg(required = true, value_name = "FILE", value_parser = inputs::file())]
    files: Vec<PathBuf>,
    /// Name of one material; all if not given
    #[arg(long, value_name = "NAME", value_parser = NonEmptyStringValueParser::new())]
    material: Option<String>,
    /// Test the materials with this change of their analytic part: kd=R,G,B, eta=N or alpha=A; may be given several
    /// times. One more test then asks whether the edit keeps the energy
    #[arg(long = "edit", value_name = "NAME=VALUE")]
    edits: Vec<Edit>,
    /// lobes, table, table:paper or table:VIEWSxRINGSxSECTORS [default: the materials' own]
    #[arg(long, value_name = "SAMPLER")]
    sampler: Option<SamplerChoice>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Write a page with the pictures behind every verdict
    #[arg(long, value_name = "PAGE.html", value_parser = inputs::file())]
    html: Option<PathBuf>,
    #[command(flatten)]
    place: PlaceArguments,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Samples for each view
    #[arg(long, default_value_t = Options::FULL.samples as u32, value_name = "N", value_parser = clap::value_parser!(u32).range(1000..=10_000_000))]
    samples: u32,
    /// Seed of the random numbers
    #[arg(long, default_value_t = Options::FULL.seed, value_name = "SEED")]
    seed: u64,
}

/// Where a surface is tested if no place is named: points, a few texels, a long footprint of a grazing view, half the
/// surface, and all of it. The places have no pattern.
const PLACES: [Place; 6] = [
    Place { uv: [0.1371, 0.7193], footprint: Footprint::Point },
    Place { uv: [0.6184, 0.3817], footprint: Footprint::Point },
    Place { uv: [0.3529, 0.1462], footprint: Footprint::Isotropic(0.01) },
    Place { uv: [0.8717, 0.5538], footprint: Footprint::Axes([[0.06, 0.03], [-0.004, 0.008]]) },
    Place { uv: [0.2241, 0.9126], footprint: Footprint::Isotropic(0.25) },
    Place { uv: [0.5; 2], footprint: Footprint::Isotropic(f32::INFINITY) },
];

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    if let Some(page) = &arguments.html {
        arguments.overwrite.check(page, Format::Page)?;
    }
    let options = Options { samples: arguments.samples as usize, seed: arguments.seed, ..Options::FULL };
    let mut materials = Vec::new();
    let outputs: Vec<&Path> = arguments.html.iter().map(PathBuf::as_path).collect();
    for source in &inputs::open(&arguments.files, &outputs)? {
        materials.extend(materials_of(source, arguments)?);
    }
    let edited = materials
        .iter()
        .map(|(name, material)| Ok((name.clone(), edit::apply(&arguments.edits, name, material)?)))
        .collect::<Result<Vec<_>>>()?;
    let mut sights = Vec::new();
    for (i, (name, material)) in edited.iter().enumerate() {
        sights.extend(sights_of(i, name, material, &arguments.place)?);
    }
    let subjects: Vec<BrdfSubject> = sights
        .iter()
        .map(|Sight { name, index, brdf }| BrdfSubject {
            name: name.clone(),
            claims: Claims::of(&edited[*index].1),
            brdf,
        })
        .collect();
    let bar = output::progress_bar(subjects.len(), "check");
    let mut checked = Vec::new();
    for (i, subject) in bar.wrap_iter(subjects.iter()).enumerate() {
        // A material of a file always answers; the error is for subjects that live elsewhere.
        let mut of_subject = glimt_check::check(subject, &options).map_err(anyhow::Error::from_boxed)?;
        if !arguments.edits.is_empty() {
            let index = sights[i].index;
            of_subject.findings.extend(EditLaw::new(&materials[index].1).findings(&edited[index].1));
        }
        checked.push(of_subject);
    }
    let report = Report::new(checked);
    // First, as nobody need read the table to the end.
    if let Some(page) = &arguments.html {
        output::write(page, glimt_check::page::html(&report).as_bytes())?;
    }
    if arguments.json {
        output::print_raw(&(report.json() + "\n"))?;
    } else {
        output::print(&report.text())?;
        let surfaces = edited.iter().filter(|(_, material)| material.is_surface()).count();
        if surfaces > 0 && !arguments.place.is_given() {
            let (surface, places) = (if surfaces == 1 { "A surface" } else { "Surfaces" }, PLACES.len());
            output::print(&format!("{surface} at {places} places; --uv and --footprint name another.\n"))?;
        }
    }
    if !report.passed() {
        bail!("{} of {} failed: {}", report.failed().len(), subjects.len(), report.failed().join(", "));
    }
    Ok(())
}

/// A material as it is tested.
struct Sight<'a> {
    name: String,
    /// The number of the material.
    index: usize,
    brdf: At<'a>,
}

/// A material, or a surface at the place that was named, or at several.
///
/// # Errors
/// A footprint of a surface without a place.
fn sights_of<'a>(
    index: usize,
    name: &str,
    material: &'a Material,
    asked: &PlaceArguments,
) -> Result<Vec<Sight<'a>>> {
    if !material.is_surface() {
        return Ok(vec![Sight { name: name.to_owned(), index, brdf: At::Everywhere(material) }]);
    }
    let sight =
        |place: &Place, brdf| Sight { name: format!("{name} {}", place::spelled(place)), index, brdf };
    match asked.place() {
        Some(place) => Ok(vec![sight(&place, material.at(&place))]),
        None if asked.is_given() => asked.look(name, material).map(|_| Vec::new()),
        None => Ok(PLACES.iter().map(|place| sight(place, material.at(place))).collect()),
    }
}

/// The materials of a file by name, or the one that was asked for, with the sampler that was.
fn materials_of(source: &Source, arguments: &Arguments) -> Result<Vec<(String, Material)>> {
    // There is nothing between scattered samples that could be tested, and that is the error.
    let library = source.library()?;
    let entries = match &arguments.material {
        Some(name) => vec![library.entry(Some(name))?],
        None => library.entries()?,
    };
    for entry in &entries {
        place::refuse_sampler(&entry.name, &entry.material, arguments.sampler.is_some())?;
    }
    let material = |material: &Material| match arguments.sampler {
        Some(choice) => material.with_sampler(choice),
        None => material.clone(),
    };
    Ok(entries.iter().map(|entry| (entry.name.clone(), material(&entry.material))).collect())
}
