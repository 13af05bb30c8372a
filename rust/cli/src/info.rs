//! `glimt info`: what a file holds.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use glimt_core::kernels::network::Network;
use glimt_core::library::{Entry, Origin};
use glimt_core::models::maps::{Filter, Texel};
use glimt_core::models::tabulated::Table;
use glimt_core::sampling::Plan;
use glimt_core::surface::{Place, Precision, Wrap};
use glimt_core::{AnyModel, Library, Material, Oddity, Vec3};
use glimt_disk::printable;
use glimt_files::{Samples, Source};
use serde::Serialize;
use serde_json::Value;

use crate::inputs::{self, STANDARD, StandardInput};
use crate::output;

/// Show what files hold: model, materials, bytes, provenance
#[derive(clap::Args)]
pub struct Arguments {
    /// Files, directories or globs; - for the standard input
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// One JSON object per file and line
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    if arguments.files == [Path::new(STANDARD)] {
        let input = StandardInput::read()?;
        let info = Info::new(&input.open()?)?;
        return Info { file: STANDARD.to_owned(), ..info }.print(arguments.json);
    }
    for (i, path) in inputs::expand(&arguments.files, &[])?.into_iter().enumerate() {
        if i > 0 && !arguments.json {
            output::print("\n")?;
        }
        Info::new(&Source::open(&path)?)?.print(arguments.json)?;
    }
    Ok(())
}

/// What a file holds.
#[derive(Serialize)]
struct Info {
    file: String,
    bytes: u64,
    kind: &'static str,
    #[serde(flatten)]
    content: Content,
}

#[derive(Serialize)]
#[serde(untagged)]
enum Content {
    Library {
        /// As the library's header has it.
        #[serde(skip_serializing_if = "Option::is_none")]
        form: Option<Value>,
        /// The form in words.
        described: String,
        #[serde(skip_serializing_if = "Option::is_none")]
        network: Option<NetworkInfo>,
        bytes_per_material: usize,
        shared_bytes: usize,
        /// Of a library of surfaces.
        #[serde(skip_serializing_if = "BTreeMap::is_empty")]
        tensor_bytes: BTreeMap<String, usize>,
        materials: Vec<MaterialInfo>,
    },
    Measured {
        material: String,
        description: String,
        described: String,
        isotropic: bool,
        /// What is odd about the file, and what was made of it.
        odd: Vec<Oddity>,
        sampler: SamplerInfo,
    },
    Samples {
        material: String,
        /// Samples above the horizon.
        samples: usize,
        /// What is odd about the file, and what was made of it.
        odd: Vec<Oddity>,
        /// Largest angle between the normal and a direction, in degrees: of the lights, of the views.
        largest_theta: [f32; 2],
        /// Mean of f.
        mean: [f32; 3],
        /// Largest f.
        largest: [f32; 3],
    },
}

#[derive(Serialize)]
struct SamplerInfo {
    name: &'static str,
    /// Of its tables; 0 for what needs none of its own.
    bytes: usize,
}

#[derive(Serialize)]
struct NetworkInfo {
    /// Values at each layer, inputs first.
    sizes: Vec<usize>,
    activation: &'static str,
}

#[derive(Serialize)]
struct MaterialInfo {
    name: String,
    isotropic: bool,
    reciprocal: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    kd: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    eta: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    alpha: Option<[f32; 2]>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    latent: Vec<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    surface: Option<SurfaceInfo>,
    #[serde(flatten)]
    origin: Origin,
}

/// What a surface is made of.
#[derive(Serialize)]
struct SurfaceInfo {
    /// Width and height of its maps in texels, from the finest.
    levels: Vec<[usize; 2]>,
    /// The same of its latent codes, if it has some.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    latent_levels: Vec<[usize; 2]>,
    wrap: Wrap,
    filter: Filter,
    precision: Precision,
    /// Of all levels of both.
    memory_bytes: usize,
    far: FarField,
}

/// The maps of a surface from afar.
#[derive(Serialize)]
struct FarField {
    kd: [f32; 3],
    f0: [f32; 3],
    /// Mean of the texels.
    texel_alpha: f32,
    /// Along the longer and the shorter axis, with what the filter adds for the normals.
    alpha: [f32; 2],
    normal: [f32; 3],
}

impl SurfaceInfo {
    /// Of a surface; `None` of what is the same everywhere.
    fn new(material: &Material) -> Option<SurfaceInfo> {
        let (maps, latents) = match material.model() {
            AnyModel::Maps(maps) => (maps, None),
            AnyModel::Gated(gated) => (&gated.parts().maps, Some(&gated.parts().latents)),
            _ => return None,
        };
        let Texel { kd, f0, alpha: texel_alpha, .. } = maps.mean();
        let facet = maps.at(&Place::far());
        let far = FarField { kd, f0, texel_alpha, alpha: facet.alpha(), normal: facet.normal().to_array() };
        Some(SurfaceInfo {
            levels: maps.sizes().collect(),
            latent_levels: latents.iter().flat_map(|latents| latents.layout().sizes()).collect(),
            wrap: maps.wrap(),
            filter: maps.filter(),
            precision: maps.precision(),
            memory_bytes: maps.bytes() + latents.map_or(0, |latents| size_of_val(latents.all_texels())),
            far,
        })
    }

    fn text(&self) -> String {
        let sizes = |levels: &[[usize; 2]]| {
            levels.iter().map(|[width, height]| format!("{width}×{height}")).collect::<Vec<_>>().join(" ")
        };
        let numbers = |numbers: &[f32]| {
            numbers.iter().map(|number| format!("{number:.3}")).collect::<Vec<_>>().join(" ")
        };
        let filter = match self.filter {
            Filter::Average => "averages of the maps",
            Filter::Fitted => "fitted to what is seen of the finest level",
            Filter::Moments => "averages, and the variance of slopes as roughness",
        };
        let wrap = match self.wrap {
            Wrap::Repeat => "the maps repeat",
            Wrap::Clamp => "the texels at the edge go on",
        };
        let stored = match self.precision {
            Precision::F32 => "float32",
            Precision::F16 => "float16",
            Precision::U8 => "8 bits",
        };
        let FarField { kd, f0, texel_alpha, alpha, .. } = &self.far;
        let mut text = String::new();
        line(&mut text, &format!("    levels     {}", sizes(&self.levels)));
        if !self.latent_levels.is_empty() {
            line(&mut text, &format!("    latents    {}", sizes(&self.latent_levels)));
        }
        let memory = thousands(self.memory_bytes as u64);
        line(&mut text, &format!("    stored     {stored}; {memory} bytes in memory"));
        line(&mut text, &format!("    filter     {filter}"));
        line(&mut text, &format!("    wrap       {wrap}"));
        line(
            &mut text,
            &format!(
                "    from afar  kd {}  F0 {}  alpha {} (mean of the texels {})",
                numbers(kd),
                numbers(f0),
                numbers(alpha),
                numbers(&[*texel_alpha])
            ),
        );
        text
    }
}

impl Info {
    fn new(source: &Source) -> Result<Info> {
        // JSON holds no other names than those in UTF-8.
        let file = source.path().display().to_string();
        let metadata = std::fs::metadata(source.path()).with_context(|| format!("cannot read {file}"))?;
        let content = match source {
            Source::Library(library) => {
                let Entry { name, material, .. } = library.first()?;
                match material.model() {
                    AnyModel::Tabulated(table) => table_content(name, table.table(), material),
                    _ => library_content(library)?,
                }
            }
            Source::Samples { samples, .. } => samples_content(source.names().remove(0), samples),
        };
        Ok(Info { file, bytes: metadata.len(), kind: source.kind(), content })
    }

    fn print(&self, json: bool) -> Result<()> {
        if json {
            output::print_raw(&(serde_json::to_string(self)? + "\n"))
        } else {
            output::print(&self.text())
        }
    }

    /// For people.
    fn text(&self) -> String {
        let mut text = String::new();
        let head = format!("{}: {}", printable(&self.file), self.kind);
        match &self.content {
            Content::Measured { material, description, described, isotropic, odd, sampler } => {
                line(&mut text, &format!("{head} measurement, {} bytes", thousands(self.bytes)));
                line(&mut text, &format!("  material     {}", printable(material)));
                if !description.is_empty() {
                    line(&mut text, &format!("  description  {}", printable(description)));
                }
                line(&mut text, &format!("  form         {described}"));
                let symmetry = if *isotropic { "isotropic" } else { "anisotropic" };
                line(&mut text, &format!("  symmetry     {symmetry}"));
                odd.iter().for_each(|oddity| line(&mut text, &format!("  odd          {oddity}")));
                line(&mut text, &format!("  sampler      {}", sampler.text()));
            }
            Content::Samples { material, samples, odd, largest_theta, mean, largest } => {
                let samples = thousands(*samples as u64);
                line(&mut text, &format!("{head}, {samples} pairs, {} bytes", thousands(self.bytes)));
                line(&mut text, &format!("  material     {}", printable(material)));
                let [light, view] = largest_theta;
                line(&mut text, &format!("  from normal  light up to {light:.1}°, view up to {view:.1}°"));
                let rgb = |f: &[f32; 3]| f.map(|f| format!("{f:.4}")).join(" ");
                line(&mut text, &format!("  f            mean {}, largest {}", rgb(mean), rgb(largest)));
                odd.iter().for_each(|oddity| line(&mut text, &format!("  odd          {oddity}")));
            }
            Content::Library {
                described,
                network,
                bytes_per_material,
                shared_bytes,
                tensor_bytes,
                materials,
                ..
            } => {
                let count = materials.len();
                let plural = if count == 1 { "" } else { "s" };
                line(
                    &mut text,
                    &format!("{head} models, {count} material{plural}, {} bytes", thousands(self.bytes)),
                );
                if let Some(NetworkInfo { sizes, activation }) = network {
                    let sizes: Vec<String> = sizes.iter().map(usize::to_string).collect();
                    line(&mut text, &format!("  network      {}, {activation}", sizes.join("-")));
                }
                line(&mut text, &format!("  form         {described}"));
                let (own, shared) = (thousands(*bytes_per_material as u64), thousands(*shared_bytes as u64));
                line(&mut text, &format!("  size         {own} bytes per material and {shared} shared"));
                if !tensor_bytes.is_empty() {
                    let part =
                        |(name, bytes): (&String, &usize)| format!("{name} {}", thousands(*bytes as u64));
                    let parts: Vec<String> = tensor_bytes.iter().map(part).collect();
                    line(&mut text, &format!("  parts        {} bytes", parts.join(", ")));
                }
                let width = materials
                    .iter()
                    .map(|material| printable(&material.name).chars().count())
                    .max()
                    .unwrap_or(0);
                for material in materials {
                    line(&mut text, &format!("  {:width$}{}", printable(&material.name), material.text()));
                    text += &material.surface.as_ref().map(SurfaceInfo::text).unwrap_or_default();
                }
            }
        }
        text
    }
}

fn library_content(library: &Library) -> Result<Content> {
    let first = &library.first()?.material;
    let (bytes_per_material, shared_bytes) = library.tensor_bytes()?;
    Ok(Content::Library {
        form: library.form()?,
        described: first.describe(),
        network: first.network().map(NetworkInfo::new),
        bytes_per_material,
        shared_bytes,
        tensor_bytes: if first.is_surface() {
            library.bytes_by_tensor()?.into_iter().collect()
        } else {
            BTreeMap::new()
        },
        materials: library.entries()?.into_iter().map(MaterialInfo::new).collect(),
    })
}

fn table_content(name: &str, table: &dyn Table, sampled: &Material) -> Content {
    Content::Measured {
        material: name.to_owned(),
        description: table.description().to_owned(),
        described: sampled.describe(),
        isotropic: table.is_isotropic(),
        odd: table.oddities().to_vec(),
        sampler: SamplerInfo::new(sampled),
    }
}

fn samples_content(material: String, samples: &Samples) -> Content {
    let lowest = |directions: &[Vec3]| directions.iter().fold(1.0_f32, |z, d| z.min(d.z)).acos().to_degrees();
    let mean = |channel: usize| {
        let sum: f64 = samples.f.iter().map(|f| f64::from(f[channel])).sum();
        (sum / samples.len() as f64) as f32
    };
    Content::Samples {
        material,
        samples: samples.len(),
        odd: samples.oddities(),
        largest_theta: [lowest(&samples.light), lowest(&samples.view)],
        mean: std::array::from_fn(mean),
        largest: samples.f.iter().fold(Vec3::ZERO, |a, &f| a.max(f)).to_array(),
    }
}

impl NetworkInfo {
    fn new(network: &Network) -> NetworkInfo {
        let inputs = network.features() + network.latent();
        let outputs = network.layers().iter().map(|layer| layer.outputs());
        NetworkInfo {
            sizes: std::iter::once(inputs).chain(outputs).collect(),
            activation: network.activation().name(),
        }
    }
}

impl MaterialInfo {
    fn new(entry: &Entry) -> MaterialInfo {
        let microfacet = entry.material.microfacet();
        MaterialInfo {
            name: entry.name.clone(),
            isotropic: entry.material.is_isotropic(),
            reciprocal: entry.material.is_reciprocal(),
            kd: microfacet.map(|m| m.kd),
            eta: microfacet.map(|m| m.eta),
            alpha: microfacet.map(|m| m.alpha),
            latent: entry.material.latent().to_vec(),
            surface: SurfaceInfo::new(&entry.material),
            origin: entry.origin.clone(),
        }
    }

    /// What stands after the name.
    fn text(&self) -> String {
        let mut text = String::new();
        for (name, values) in [
            ("kd", self.kd.as_ref().map(<[f32; 3]>::as_slice)),
            ("eta", self.eta.as_ref().map(<[f32; 3]>::as_slice)),
            ("alpha", self.alpha.as_ref().map(<[f32; 2]>::as_slice)),
        ] {
            if let Some(values) = values {
                let values: Vec<String> = values.iter().map(|value| format!("{value:.3}")).collect();
                write!(text, "  {name} {}", values.join(" ")).expect("a string takes all");
            }
        }
        for (label, name) in [("SMAPE", "smape"), ("log-MAE", "log_mae")] {
            if let Some(value) = self.origin.metrics.get(name) {
                write!(text, "  {label} {value:.4}").expect("a string takes all");
            }
        }
        if !self.origin.source.is_empty() {
            write!(text, "  from {}", printable(&self.origin.source)).expect("a string takes all");
            if !self.origin.files.is_empty() {
                write!(text, " ({} files)", self.origin.files.len()).expect("a string takes all");
            }
        }
        text
    }
}

impl SamplerInfo {
    fn new(material: &Material) -> SamplerInfo {
        let plan = material.plan();
        // Told by its resolution: to make the table takes longer than to read the file.
        let bytes =
            if let Plan::Table(resolution) = plan { resolution.bytes(material.is_isotropic()) } else { 0 };
        SamplerInfo { name: plan.name(), bytes }
    }

    fn text(&self) -> String {
        match self.bytes {
            0 => self.name.to_owned(),
            bytes => format!("{} of {} bytes", self.name, thousands(bytes as u64)),
        }
    }
}

fn line(text: &mut String, line: &str) {
    text.push_str(line);
    text.push('\n');
}

/// A number with commas between its thousands.
fn thousands(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}
