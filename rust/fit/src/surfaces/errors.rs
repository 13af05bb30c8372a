//! How far a surface is from the truth, by level.

use glimt_core::Material;
use rayon::prelude::*;

use super::queries::{Drawing, Field, Footprints, Gaussians, Queries, Samples};
use crate::backprop::{BLOCK, Row, ZERO_ROW};

/// The error of a surface at footprints of one kind, against many samples of the truth: log-MAE, MAE and RMSE of f.
#[derive(Clone, Copy, Debug, Default)]
pub struct Errors {
    /// Mean |Δ ln(1 + cosθ f)|.
    pub log_mae: f64,
    /// Mean |Δ f|.
    pub mae: f64,
    /// √ mean (Δ f)².
    pub rmse: f64,
}

impl Errors {
    /// The mean over levels.
    #[must_use]
    pub fn mean(levels: &[Errors]) -> Errors {
        let n = levels.len() as f64;
        let mean = |of: fn(&Errors) -> f64| levels.iter().map(of).sum::<f64>() / n;
        Errors { log_mae: mean(|e| e.log_mae), mae: mean(|e| e.mae), rmse: mean(|e| e.rmse) }
    }
}

/// Measures `material` at footprints that `drawing` draws, over so many blocks.
fn measure(drawing: &Drawing, blocks: u64, material: &Material) -> Errors {
    let of = |number: u64| {
        let (mut queries, mut samples, mut truth) = (Queries::default(), Samples::default(), [ZERO_ROW; 3]);
        drawing.block(number, &mut queries, &mut truth, &mut samples);
        let mut f = [ZERO_ROW; 3];
        eval_block(material, &queries, &mut f);
        let mut errors = Errors::default();
        for c in 0..3 {
            let cosines = queries.light[2].as_flattened();
            for ((&cos, &truth), &f) in cosines.iter().zip(truth[c].as_flattened()).zip(f[c].as_flattened()) {
                let log = |f: f32| f64::from(cos * f).ln_1p();
                errors.log_mae += (log(f) - log(truth)).abs();
                errors.mae += f64::from(f - truth).abs();
                errors.rmse += f64::from(f - truth).powi(2);
            }
        }
        errors
    };
    let sum = (0..blocks).into_par_iter().map(of).collect::<Vec<_>>().into_iter().fold(
        Errors::default(),
        |a, b| Errors { log_mae: a.log_mae + b.log_mae, mae: a.mae + b.mae, rmse: a.rmse + b.rmse },
    );
    let n = (blocks * BLOCK as u64 * 3) as f64;
    Errors { log_mae: sum.log_mae / n, mae: sum.mae / n, rmse: (sum.rmse / n).sqrt() }
}

/// f of a material at the places of a block.
fn eval_block(material: &Material, queries: &Queries, out: &mut [Row; 3]) {
    let [light, view] =
        [&queries.light, &queries.view].map(|side| side.each_ref().map(|row| row.as_flattened()));
    material.eval_packet_at(&queries.places, light, view, out.each_mut().map(|row| row.as_flattened_mut()));
}

/// Samples of the truth in a footprint.
const SAMPLES: usize = 256;

/// Blocks at a level.
const BLOCKS: u64 = 16;

/// Seed of what errors are measured at: no fit has it.
const SEED: u64 = 0x6c69_6e74;

/// The errors of a surface against the truth at each level of its finest detail, from half a texel's deviation to the
/// whole tile, with footprints that are stretched as the view foreshortens them (eq. 9), against the mean of 256 samples
/// each.
#[must_use]
pub fn by_level(field: &dyn Field, material: &Material) -> Vec<Errors> {
    let [width, height] = field.size();
    let levels = width.max(height).ilog2();
    let of = |level: u32| {
        let footprints = Footprints::Stretched(level as f32);
        let drawing = Drawing { field, gaussians: Gaussians::new(SAMPLES), footprints, seed: SEED };
        measure(&drawing, BLOCKS, material)
    };
    (0..=levels).map(of).collect()
}
