//! `glimt check`: does a material do what it says?

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::builder::NonEmptyStringValueParser;
use glimt_check::edits::EditLaw;
use glimt_check::{BrdfSubject, Claims, Options, Report};
use glimt_core::Material;
use glimt_core::sampling::SamplerChoice;
use glimt_files::Source;

use crate::edit::{self, Edit};
use crate::output::{Format, Overwrite};
use crate::{inputs, output};

/// Test materials: sampling, weights, energy, symmetry, the horizon
///
/// Every material goes through the same tests: samples against the density by χ², weights against f·cosθ/pdf,
/// the mean weight against an integral that no sampler has touched, and more; docs/check.md explains each.
/// Exit code 1 if one fails. Warnings (an albedo above 1 among them) do not, nor does what a measurement says against
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
    overwrite: Overwrite,
    /// Samples for each view
    #[arg(long, default_value_t = Options::FULL.samples as u32, value_name = "N", value_parser = clap::value_parser!(u32).range(1000..=10_000_000))]
    samples: u32,
    /// Seed of the random numbers
    #[arg(long, default_value_t = Options::FULL.seed, value_name = "SEED")]
    seed: u64,
}

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
    let subjects: Vec<BrdfSubject> = edited
        .iter()
        .map(|(name, material)| BrdfSubject {
            name: name.clone(),
            claims: Claims::of(material),
            brdf: material,
        })
        .collect();
    let bar = output::progress_bar(subjects.len(), "check");
    let mut checked = Vec::new();
    for (i, subject) in bar.wrap_iter(subjects.iter()).enumerate() {
        // A material of a file always answers; the error is for subjects that live elsewhere.
        let mut of_subject = glimt_check::check(subject, &options).map_err(anyhow::Error::from_boxed)?;
        if !arguments.edits.is_empty() {
            of_subject.findings.extend(EditLaw::new(&materials[i].1).findings(&edited[i].1));
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
    }
    if !report.passed() {
        bail!("{} of {} failed: {}", report.failed().len(), subjects.len(), report.failed().join(", "));
    }
    Ok(())
}

/// The materials of a file by name, or the one that was asked for, with the sampler that was.
fn materials_of(source: &Source, arguments: &Arguments) -> Result<Vec<(String, Material)>> {
    // There is nothing between scattered samples that could be tested, and that is the error.
    let library = source.library()?;
    let entries = match &arguments.material {
        Some(name) => std::slice::from_ref(library.entry(Some(name))?),
        None => library.entries(),
    };
    let material = |material: &Material| match arguments.sampler {
        Some(choice) => material.with_sampler(choice),
        None => material.clone(),
    };
    Ok(entries.iter().map(|entry| (entry.name.clone(), material(&entry.material))).collect())
}
