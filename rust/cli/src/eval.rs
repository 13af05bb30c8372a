//! `glimt eval`: f for pairs of directions.

use std::path::PathBuf;

use anyhow::{Result, bail};
use glimt_core::{SampleBrdf, Vec3};
use glimt_files::{Array, Source};
use rayon::prelude::*;

use crate::output;

/// Evaluate f for pairs of directions
///
/// Pairs below the horizon and pairs that hold a NaN get 0.
#[derive(clap::Args)]
pub struct Arguments {
    /// Model library, measurement or NBRDF weights
    file: PathBuf,
    /// Name of the material; not needed where the file holds one
    #[arg(long, value_name = "NAME")]
    material: Option<String>,
    /// NumPy array (n, 6) of numbers: light x y z, view x y z
    #[arg(long, value_name = "PAIRS.npy")]
    pairs: PathBuf,
    /// NumPy array (n, 3) of float32 to write: f, linear RGB
    #[arg(short, long, value_name = "F.npy")]
    output: PathBuf,
}

/// Pairs that one task evaluates.
const CHUNK: usize = 4096;
/// How far the length of a direction may be from 1.
const LENGTH_TOLERANCE: f32 = 1e-3;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    output::check_writable(&arguments.output)?;
    let source = Source::open(&arguments.file)?;
    let brdf = source.brdf(arguments.material.as_deref())?;
    let pairs = read_pairs(&arguments.pairs)?;
    let f = eval(brdf, &pairs);
    let shape = vec![pairs.len(), 3];
    Array { shape, values: f.into_iter().flat_map(|f| f.to_array()).collect() }.save(&arguments.output)?;
    Ok(())
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
fn read_pairs(path: &std::path::Path) -> Result<Vec<[Vec3; 2]>> {
    let array = Array::open(path)?;
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
