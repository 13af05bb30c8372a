//! The pairs of directions that a fit looks at, and the material's values there.
//!
//! Errors are reported over cosine-distributed pairs, but few of those fall into a narrow lobe. Half
//! of the lights are therefore drawn from GGX lobes of several widths about the mirror direction,
//! and every pair carries the weight that makes sums over the mixture equal sums over the cosine
//! distribution: lobes are seen often, and count what they should. To that weight comes a small
//! constant, without which the tip of a narrow lobe, which renders as a highlight, counts next to
//! nothing.

use std::f32::consts::{FRAC_1_PI, TAU};

use glam::Vec3;
use glimt_core::Brdf;
use glimt_core::sampling::lobes::VisibleNormals;
use glimt_core::simd::{LANES, Lane3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::backprop::{BLOCK, Row, ZERO_ROW};

/// A block of pairs, structure of arrays.
#[derive(Clone)]
pub struct PairBlock {
    /// Directions to the light, [component].
    pub light: [Row; 3],
    /// Directions to the viewer, [component].
    pub view: [Row; 3],
    /// Weight of each pair: its density under the cosine distribution over that under the mixture,
    /// and a little more, see above.
    pub weight: Row,
}

/// One column of a block.
#[inline(always)]
#[must_use]
pub fn lanes(rows: &[Row; 3], column: usize) -> Lane3 {
    [rows[0][column], rows[1][column], rows[2][column]]
}

/// f of one material for a block of pairs, [channel].
pub type TargetBlock = [Row; 3];

/// How lights are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Drawing {
    /// By the cosine alone, as in the paper.
    Cosine,
    /// By the cosine and by lobes, weighted.
    Lobes,
    /// Likewise, and some of the views near the normal, of which the cosine draws few: for models whose
    /// numbers are each for a small part of the directions.
    NearNormal,
}

/// Roughnesses of the lobes that lights are drawn from.
const LOBE_ALPHAS: [f32; 4] = [0.01, 0.03, 0.1, 0.3];

/// Share of views that are drawn with √sinθ uniform: 1.9 % of all pairs then have a view within 2° of the normal
/// instead of 0.1 %.
const NEAR_NORMAL_SHARE: f32 = 0.1;

/// What every pair of a mixture counts besides its weight. On the reference materials it halved the
/// RMSE at no cost in log-MAE; four times as much cost a tenth of log-MAE.
const TIP_WEIGHT: f32 = 0.005;

/// `count` blocks of pairs, by seed and epoch alone: the same whatever ran before.
///
/// The points are a Kronecker sequence with the generalised golden ratio of five dimensions
/// (Roberts 2018), shifted at random, so that every block covers the hemispheres evenly.
#[must_use]
pub fn draw(drawing: Drawing, seed: u64, epoch: u64, count: usize) -> Vec<PairBlock> {
    let mut rng = Pcg64::seed_from_u64(mix(seed, epoch));
    let shift: [f64; 5] = std::array::from_fn(|_| rng.random());
    // Rounding to float32 may reach 1, which is no longer in [0, 1).
    const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;
    // The root of x⁶ = x + 1.
    const GOLDEN: f64 = 1.134_724_138_401_519_5;
    let point = |n: usize| -> [f32; 5] {
        std::array::from_fn(|d| {
            ((shift[d] + n as f64 * GOLDEN.powi(-(d as i32) - 1)).fract() as f32).min(BELOW_ONE)
        })
    };
    let blocks = 0..count;
    blocks
        .into_par_iter()
        .map(|block| {
            let mut pairs = PairBlock { light: [ZERO_ROW; 3], view: [ZERO_ROW; 3], weight: ZERO_ROW };
            for i in 0..BLOCK {
                let (light, view, weight) = pair(drawing, point(block * BLOCK + i));
                let (column, lane) = (i / LANES, i % LANES);
                for c in 0..3 {
                    pairs.light[c][column][lane] = light[c];
                    pairs.view[c][column][lane] = view[c];
                }
                pairs.weight[column][lane] = weight;
            }
            pairs
        })
        .collect()
}

/// Another seed for every number.
pub(crate) fn mix(seed: u64, number: u64) -> u64 {
    seed ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15)
}

/// A pair and its weight from five numbers in [0, 1).
fn pair(drawing: Drawing, u: [f32; 5]) -> (Vec3, Vec3, f32) {
    let (view, view_weight) = match drawing {
        Drawing::Cosine | Drawing::Lobes => (cosine(u[0], u[1]), 1.0),
        Drawing::NearNormal => near_normal(u[0], u[1]),
    };
    let share = match drawing {
        Drawing::Cosine => 0.0,
        Drawing::Lobes | Drawing::NearNormal => 0.5,
    };
    let light = if u[2] < share {
        let turn = ((u[2] / share * LOBE_ALPHAS.len() as f32) as usize).min(LOBE_ALPHAS.len() - 1);
        let lobe = VisibleNormals { alpha: [LOBE_ALPHAS[turn]; 2] };
        // A light below the horizon carries nothing; the pair counts 0.
        match lobe.sample_direction(view, [u[3], u[4]]) {
            Some(light) => light,
            None => return (Vec3::Z, view, 0.0),
        }
    } else {
        cosine(u[3], u[4])
    };
    if share == 0.0 {
        return (light, view, 1.0);
    }
    let diffuse = light.z * FRAC_1_PI;
    let specular: f32 = LOBE_ALPHAS.iter().map(|&a| VisibleNormals { alpha: [a; 2] }.pdf(light, view)).sum();
    let pdf = (1.0 - share) * diffuse + share * specular / LOBE_ALPHAS.len() as f32;
    (light, view, view_weight * diffuse / pdf + TIP_WEIGHT)
}

/// A view of [`Drawing::NearNormal`], and its density under the cosine distribution over that under the mixture.
fn near_normal(u1: f32, u2: f32) -> (Vec3, f32) {
    // In r = sinθ the cosine distribution has the density 2r, and √r uniform the density 1/(2√r).
    let r = match u1 / NEAR_NORMAL_SHARE {
        t if t < 1.0 => t * t,
        _ => ((u1 - NEAR_NORMAL_SHARE) / (1.0 - NEAR_NORMAL_SHARE)).sqrt(),
    };
    let density = (1.0 - NEAR_NORMAL_SHARE) * 2.0 * r + NEAR_NORMAL_SHARE * 0.5 / r.sqrt();
    (cosine(r * r, u2), 2.0 * r / density)
}

fn cosine(u1: f32, u2: f32) -> Vec3 {
    // A hair above the horizon, so that no pair is exactly grazing.
    const LEAST_COS: f32 = 1e-4;
    let (r, phi) = (u1.sqrt(), TAU * u2);
    Vec3::new(r * phi.cos(), r * phi.sin(), (1.0 - u1).max(0.0).sqrt().max(LEAST_COS))
}

/// Blocks that are evaluated in one call: where a material lives in another process, every call costs.
const BATCH: usize = 32;

/// The material's values for every block.
#[must_use]
pub fn evaluate(brdf: &dyn Brdf, blocks: &[PairBlock]) -> Vec<TargetBlock> {
    blocks.par_chunks(BATCH).flat_map_iter(|blocks| evaluate_batch(brdf, blocks)).collect()
}

fn evaluate_batch(brdf: &dyn Brdf, blocks: &[PairBlock]) -> Vec<TargetBlock> {
    let vectors = |rows: fn(&PairBlock) -> &[Row; 3]| -> Vec<Vec3> {
        let at = |[x, y, z]: &[Row; 3], i: usize| {
            let (column, lane) = (i / LANES, i % LANES);
            Vec3::new(x[column][lane], y[column][lane], z[column][lane])
        };
        blocks.iter().flat_map(|block| (0..BLOCK).map(move |i| at(rows(block), i))).collect()
    };
    let (light, view) = (vectors(|block| &block.light), vectors(|block| &block.view));
    let mut f = vec![Vec3::ZERO; light.len()];
    brdf.eval_batch(&light, &view, &mut f);
    let target = |f: &[Vec3]| {
        let mut target = [ZERO_ROW; 3];
        for (i, f) in f.iter().enumerate() {
            for (c, row) in target.iter_mut().enumerate() {
                row[i / LANES][i % LANES] = f[c];
            }
        }
        target
    };
    f.chunks_exact(BLOCK).map(target).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(blocks: &[PairBlock], constant: f32, value: impl Fn(Vec3, Vec3) -> f64) -> f64 {
        let mut sum = 0.0;
        for b in blocks {
            for i in 0..BLOCK {
                let (c, l) = (i / LANES, i % LANES);
                let at = |rows: &[Row; 3]| Vec3::new(rows[0][c][l], rows[1][c][l], rows[2][c][l]);
                sum += f64::from((b.weight[c][l] - constant).max(0.0)) * value(at(&b.light), at(&b.view));
            }
        }
        sum / (blocks.len() * BLOCK) as f64
    }

    #[test]
    fn weighted_pairs_of_mixtures_have_the_means_of_cosine_pairs() {
        let cosine = draw(Drawing::Cosine, 1, 0, 400);
        let mixtures = [Drawing::Lobes, Drawing::NearNormal].map(|drawing| draw(drawing, 1, 0, 400));
        let sharp = |l: Vec3, v: Vec3| f64::from((l + v).normalize().z).powi(200);
        for (name, value) in [
            ("1", (|_, _| 1.0) as fn(Vec3, Vec3) -> f64),
            ("cos light", |l, _| l.z.into()),
            ("cos view · x", |l, v| f64::from(v.z * l.x * l.x)),
        ] {
            for mixture in &mixtures {
                let (a, b) = (mean(&cosine, 0.0, value), mean(mixture, TIP_WEIGHT, value));
                assert!((a - b).abs() < 4e-3 * a.abs().max(0.1), "{name}: {a} and {b}");
            }
        }
        for mixture in &mixtures {
            let (a, b) = (mean(&cosine, 0.0, sharp), mean(mixture, TIP_WEIGHT, sharp));
            assert!((a / b - 1.0).abs() < 0.05, "sharp lobe: {a} and {b}");
        }
    }

    #[test]
    fn a_seed_and_an_epoch_are_all_that_pairs_depend_on() {
        let a = draw(Drawing::Lobes, 5, 3, 4);
        let b = draw(Drawing::Lobes, 5, 3, 2);
        assert_eq!(a[1].light, b[1].light);
        assert_ne!(draw(Drawing::Lobes, 5, 4, 1)[0].light, a[0].light);
        assert_ne!(draw(Drawing::Lobes, 6, 3, 1)[0].light, a[0].light);
    }
}
