//! `glimt eval`: f for pairs of directions.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail};
use clap::builder::NonEmptyStringValueParser;
use glimt_core::library::Entry;
use glimt_core::{SampleBrdf, Vec3};
use glimt_files::Array;
use rayon::prelude::*;

use crate::Usage;
use crate::inputs::{self, STANDARD};
use crate::output::{Format, Overwrite};
use crate::place::PlaceArguments;

/// Evaluate f for pairs of directions
///
/// Pairs below the horizon and pairs that hold a NaN get 0.
#[derive(clap::Args)]
pub struct Arguments {
    /// Model library, measurement or NBRDF weights; - for the standard input
    file: PathBuf,
    /// Name of the material; not needed where the file holds one
    #[arg(long, value_name = "NAME", value_parser = NonEmptyStringValueParser::new())]
    material: Option<String>,
    /// NumPy array (n, 6) of numbers: light x y z, view x y z; - for the standard input
    #[arg(long, value_name = "PAIRS.npy")]
    pairs: PathBuf,
    /// NumPy array (n, 3) of float32 to write: f, linear RGB; - for the standard output
    #[arg(short, long, value_name = "F.npy", value_parser = inputs::file_or_output())]
    output: PathBuf,
    #[command(flatten)]
    place: PlaceArguments,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// Pairs that one task evaluates.
const CHUNK: usize = 4096;
/// How far the length of a direction may be from 1.
const LENGTH_TOLERANCE: f32 = 1e-3;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let (pairs, output) = (&arguments.pairs, &arguments.output);
    if pairs == Path::new(STANDARD) && arguments.file == Path::new(STANDARD) {
        return Err(Usage("the standard input can be the file or the pairs, not both".into()).into());
    }
    arguments.overwrite.check(output, Format::Array)?;
    inputs::keep_apart([pairs.as_path()], &[output])?;
    let source = inputs::open_one(&arguments.file, output)?;
    let Entry { name, material, .. } = source.library()?.entry(arguments.material.as_deref())?;
    let brdf = arguments.place.look(name, material)?;
    let pairs = read_pairs(pairs)?;
    let f = eval(&brdf, &pairs);
    let shape = vec![pairs.len(), 3];
    Ok(Array { shape, values: f.into_iter().flat_map(|f| f.to_array()).collect() }.save(output)?)
}

fn eval(brdf: &dyn SampleBrdf, pairs: &[[Vec3; 2]]) -> Vec<Vec3> {
    let mut f = vec![Vec3::ZERO; pairs.len()];
    f.par_chunks_mut(CHUNK).zip(pairs.par_chunks(CHUNK)).for_each(|(f, pairs)| {
        let (light, view): (Vec<Vec3>, Vec<Vec3>) = pairs.iter().map(|&[light, view]| (light, view)).unzip();
        brdf.eval_batch(&light, &view, f);
    });
    f
}

/// Pairs (light, view).
fn read_pairs(path: &Path) -> Result<Vec<[Vec3; 2]>> {
    let array = if path == Path::new(STANDARD) {
        let broken = |reason| anyhow!("the standard input is not a NumPy array (.npy): {reason}");
        Array::from_bytes(&inputs::read_standard_input()?).map_err(broken)?
    } else {
        Array::open(path)?
    };
    if array.shape.len() != 2 || array.shape[1] != 6 {
        bail!("{} has the shape {:?}, expected [n, 6]: light x y z, view x y z", path.display(), array.shape);
    }
    let pair = |(row, v): (usize, &[f32])| {
        let pair = [Vec3::new(v[0], v[1], v[2]), Vec3::new(v[3], v[4], v[5])];
        for (name, direction) in ["light", "view"].into_iter().zip(pair) {
            let length = direction.length();
            // A NaN passes: f is 0 there.
            if (length - 1.0).abs() > LENGTH_TOLERANCE {
                bail!("{}: the {name} of row {row} has length {length}, expected 1", path.display());
            }
        }
        Ok(pair)
    };
    array.values.chunks_exact(6).enumerate().map(pair).collect()
}
