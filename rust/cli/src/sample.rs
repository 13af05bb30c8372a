//! `glimt sample`: light directions for a view direction.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::Result;
use clap::builder::NonEmptyStringValueParser;
use glimt_core::library::Entry;
use glimt_core::sampling::SamplerChoice;
use glimt_core::{Sample, SampleBrdf, Vec3};
use glimt_files::Array;
use rand::{Rng, RngExt};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use crate::inputs;
use crate::output::{Format, Overwrite};
use crate::place::{self, PlaceArguments};

/// Sample light directions for a view direction
///
/// A sample that fell below the horizon has pdf 0 and weight 0. The result depends on the seed only,
/// whatever the number of threads.
#[derive(clap::Args)]
pub struct Arguments {
    /// Model library, measurement or NBRDF weights; - for the standard input
    file: PathBuf,
    /// Name of the material; not needed where the file holds one
    #[arg(long, value_name = "NAME", value_parser = NonEmptyStringValueParser::new())]
    material: Option<String>,
    /// lobes, table, table:paper or table:VIEWSxRINGSxSECTORS [default: the material's own]
    #[arg(long, value_name = "SAMPLER")]
    sampler: Option<SamplerChoice>,
    /// View direction, above the horizon; it is normalised
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    view: View,
    /// Number of samples, at most 100 million (2.8 GB)
    #[arg(short = 'n', long, value_name = "N", value_parser = clap::value_parser!(u32).range(..=100_000_000))]
    count: u32,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 0, value_name = "SEED")]
    seed: u64,
    /// NumPy array (n, 7) of float32 to write: light x y z, pdf (1/sr), weight f·cosθ/pdf r g b; - for the
    /// standard output
    #[arg(short, long, value_name = "S.npy", value_parser = inputs::file_or_output())]
    output: PathBuf,
    #[command(flatten)]
    place: PlaceArguments,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// A direction above the horizon.
#[derive(Clone, Copy)]
struct View(Vec3);

impl FromStr for View {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<f32> = text
            .split(',')
            .map(|number| number.trim().parse().map_err(|_| format!("\"{number}\" is not a number")))
            .collect::<Result<_, _>>()?;
        let [x, y, z] = numbers[..] else {
            return Err(format!("{} numbers, expected x,y,z", numbers.len()));
        };
        let direction = Vec3::new(x, y, z).try_normalize().ok_or("not a direction")?;
        if direction.z > 0.0 { Ok(View(direction)) } else { Err("below the horizon, expected z > 0".into()) }
    }
}

/// Samples that share a stream of random numbers.
const CHUNK: usize = 4096;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    arguments.overwrite.check(&arguments.output, Format::Array)?;
    let source = inputs::open_one(&arguments.file, &arguments.output)?;
    let Entry { name, material, .. } = source.library()?.entry(arguments.material.as_deref())?;
    place::refuse_sampler(name, material, arguments.sampler.is_some())?;
    let material = arguments.sampler.map_or_else(|| material.clone(), |choice| material.with_sampler(choice));
    let count = arguments.count as usize;
    let brdf = arguments.place.look(name, &material)?;
    let samples = sample(&brdf, arguments.view.0, count, arguments.seed);
    let row = |s: Sample| [s.light.to_array().as_slice(), &[s.pdf], &s.weight.to_array()].concat();
    let values = samples.into_iter().flat_map(row).collect();
    Array { shape: vec![count, 7], values }.save(&arguments.output)?;
    Ok(())
}

fn sample(brdf: &dyn SampleBrdf, view: Vec3, count: usize, seed: u64) -> Vec<Sample> {
    let mut samples = vec![Sample::FAILED; count];
    samples.par_chunks_mut(CHUNK).enumerate().for_each(|(stream, samples)| {
        let mut random = Pcg64::new(seed.into(), stream as u128);
        for sample in samples {
            *sample = brdf.sample(view, uniform(&mut random));
        }
    });
    samples
}

/// Three numbers in [0, 1).
fn uniform(random: &mut impl Rng) -> Vec3 {
    Vec3::new(random.random(), random.random(), random.random())
}
