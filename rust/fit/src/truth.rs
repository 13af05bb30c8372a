//! Where a material's values come from.
//!
//! A BRDF is asked for as many pairs of directions as a fit likes. A material that is known at scattered
//! samples alone is looked at there: every sample counts the same, and the order is another one each time
//! round. Whoever measured densely where the material shines has said by that what matters.

use std::borrow::Cow;

use glam::Vec3;
use glimt_core::simd::LANES;
use glimt_core::{Brdf, is_lit};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use crate::backprop::{BLOCK, COLUMNS, Row, ZERO_ROW};
use crate::pairs::{Drawing, PairBlock, TargetBlock, draw, evaluate, mix};

/// Where a material's values come from.
#[derive(Clone, Copy)]
pub enum Truth<'a> {
    /// They are known for every pair of directions.
    Brdf(&'a dyn Brdf),
    /// They are known at these pairs alone: as many lights as views and values of f, at least one, finite
    /// and above the horizon.
    Samples {
        /// Unit directions to the light.
        light: &'a [Vec3],
        /// Unit directions to the viewer.
        view: &'a [Vec3],
        /// f in sr⁻¹, linear RGB.
        f: &'a [Vec3],
    },
}

/// Blocks that are looked at to find out whether a BRDF can be fitted to.
const PROBE_BLOCKS: usize = 4;

impl Truth<'_> {
    /// Whether a fit can use it; if not, why.
    pub(crate) fn check(&self) -> Result<(), String> {
        const NOT_FINITE: &str = "it has values that are not finite";
        match *self {
            Truth::Brdf(brdf) => {
                let targets = evaluate(brdf, &draw(Drawing::Lobes, 0, 0, PROBE_BLOCKS));
                let mut values = targets.as_flattened().as_flattened().as_flattened().iter();
                if values.all(|f| f.is_finite()) { Ok(()) } else { Err(NOT_FINITE.into()) }
            }
            Truth::Samples { light, view, f } => {
                if light.len() != f.len() || view.len() != f.len() {
                    let (lights, views) = (light.len(), view.len());
                    return Err(format!("{lights} lights, {views} views and {} values of f", f.len()));
                }
                if f.is_empty() {
                    return Err("there is no sample".into());
                }
                if let Some(i) = (0..f.len()).find(|&i| !is_lit(light[i], view[i])) {
                    return Err(format!("sample {i} is below the horizon or holds no unit vector"));
                }
                if f.iter().all(|f| f.is_finite()) { Ok(()) } else { Err(NOT_FINITE.into()) }
            }
        }
    }

    /// Whether all values are 0 where a fit looks first, or all samples.
    pub(crate) fn is_black(&self) -> bool {
        match *self {
            Truth::Brdf(brdf) => {
                let targets = evaluate(brdf, &draw(Drawing::Lobes, 0, 0, PROBE_BLOCKS));
                targets.as_flattened().as_flattened().as_flattened().iter().all(|&f| f == 0.0)
            }
            Truth::Samples { f, .. } => f.iter().all(|&f| f == Vec3::ZERO),
        }
    }

    /// The pairs that a fit looks at in an epoch, and the values there. `drawn` is what [`draw`] gives for
    /// the same seed and epoch; a BRDF is evaluated there, samples are taken in as many blocks.
    #[must_use]
    pub fn look<'p>(
        &self,
        drawn: &'p [PairBlock],
        seed: u64,
        epoch: u64,
    ) -> (Cow<'p, [PairBlock]>, Vec<TargetBlock>) {
        match *self {
            Truth::Brdf(brdf) => {
                let pairs = with_data(brdf, drawn);
                let targets = evaluate(brdf, &pairs);
                (pairs, targets)
            }
            Truth::Samples { light, view, f } => {
                let order = shuffled(f.len(), seed, epoch, drawn.len() * BLOCK);
                let blocks = order.chunks_exact(BLOCK).map(|order| take(order, light, view, f));
                let (pairs, targets): (Vec<_>, Vec<_>) = blocks.unzip();
                (Cow::Owned(pairs), targets)
            }
        }
    }
}

/// The pairs for which `brdf` has data. The others give way to a pair at the normal that counts nothing, as those
/// below the horizon do.
fn with_data<'p>(brdf: &dyn Brdf, drawn: &'p [PairBlock]) -> Cow<'p, [PairBlock]> {
    let mut pairs = Cow::Borrowed(drawn);
    for (block, (column, lane)) in
        (0..drawn.len()).flat_map(|block| places().map(move |place| (block, place)))
    {
        let vector = |rows: &[Row; 3]| Vec3::from_array(rows.map(|row| row[column][lane]));
        if !brdf.has_data(vector(&drawn[block].light), vector(&drawn[block].view)) {
            let block = &mut pairs.to_mut()[block];
            for c in 0..3 {
                block.light[c][column][lane] = Vec3::Z[c];
                block.view[c][column][lane] = Vec3::Z[c];
            }
            block.weight[column][lane] = 0.0;
        }
    }
    pairs
}

/// Column and lane of every pair of a block.
fn places() -> impl Iterator<Item = (usize, usize)> {
    (0..BLOCK).map(|i| (i / LANES, i % LANES))
}

/// Which of `count` samples to keep from a fit, so that it can be measured on what it has not seen: that share of
/// them at random, rounded down, so that few samples are all fitted to.
#[must_use]
pub fn held_out(count: usize, share: f64, seed: u64) -> Vec<bool> {
    // Another stream than that of the epochs.
    const STREAM: u64 = 1 << 32;
    let mut is_held = vec![false; count];
    let held = (share * count as f64) as usize;
    if held > 0 {
        shuffled(count, mix(seed, STREAM), 0, held).into_iter().for_each(|i| is_held[i] = true);
    }
    is_held
}

/// The part of an endless sequence that belongs to an epoch: all numbers below `n` in random order, and
/// again in another one.
fn shuffled(n: usize, seed: u64, epoch: u64, count: usize) -> Vec<usize> {
    let first = epoch * count as u64;
    let mut numbers = Vec::with_capacity(count + n);
    let mut round = first / n as u64;
    let skip = (first % n as u64) as usize;
    while numbers.len() < skip + count {
        let start = numbers.len();
        numbers.extend(0..n);
        numbers[start..].shuffle(&mut Pcg64::seed_from_u64(mix(seed, round)));
        round += 1;
    }
    numbers.drain(..skip);
    numbers.truncate(count);
    numbers
}

/// One block of samples.
fn take(order: &[usize], light: &[Vec3], view: &[Vec3], f: &[Vec3]) -> (PairBlock, TargetBlock) {
    let mut pairs = PairBlock { light: [ZERO_ROW; 3], view: [ZERO_ROW; 3], weight: [[1.0; LANES]; COLUMNS] };
    let mut target = [ZERO_ROW; 3];
    for ((column, lane), &sample) in places().zip(order) {
        for c in 0..3 {
            pairs.light[c][column][lane] = light[sample][c];
            pairs.view[c][column][lane] = view[sample][c];
            target[c][column][lane] = f[sample][c];
        }
    }
    (pairs, target)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_of_the_samples_is_held_out_by_the_seed() {
        let held = |count, share, seed| held_out(count, share, seed).iter().filter(|&&held| held).count();
        assert_eq!(
            [held(1000, 0.1, 3), held(448, 0.1, 3), held(9, 0.1, 3), held(50, 0.0, 3)],
            [100, 44, 0, 0]
        );
        assert_eq!(held_out(50, 0.2, 1), held_out(50, 0.2, 1));
        assert_ne!(held_out(50, 0.2, 1), held_out(50, 0.2, 2));
        assert!(held_out(0, 0.5, 0).is_empty());
    }

    #[test]
    fn every_round_goes_once_through_all_samples() {
        let order = |epoch| shuffled(10, 3, epoch, 25);
        let all = [order(0), order(1)].concat();
        for round in all.chunks(10) {
            let mut sorted = round.to_vec();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..10).collect::<Vec<_>>());
        }
        assert_ne!(all[..10], all[10..20]);
        assert_eq!(order(1), order(1));
    }

    #[test]
    fn samples_come_with_their_values_and_equal_weight() {
        let directions: Vec<Vec3> =
            (1..40).map(|i| Vec3::new(0.02 * i as f32, 0.1, 1.0).normalize()).collect();
        let f: Vec<Vec3> = directions.iter().map(|d| Vec3::new(d.x, 2.0 * d.x, 3.0)).collect();
        let truth = Truth::Samples { light: &directions, view: &directions, f: &f };
        let drawn = draw(Drawing::Lobes, 1, 0, 2);
        let (pairs, targets) = truth.look(&drawn, 1, 0);
        assert_eq!((pairs.len(), targets.len()), (2, 2));
        for (pairs, target) in pairs.iter().zip(&targets) {
            assert_eq!(pairs.light, pairs.view);
            assert_eq!(pairs.weight, [[1.0; LANES]; COLUMNS]);
            assert_eq!(target[0], pairs.light[0]);
        }
    }

    #[test]
    fn pairs_without_data_count_nothing() {
        /// Known where the light is on one side, and far off elsewhere.
        struct Half;
        impl Brdf for Half {
            fn eval(&self, light: Vec3, _: Vec3) -> Vec3 {
                Vec3::splat(if light.x > 0.0 { 1.0 } else { 1e6 })
            }

            fn has_data(&self, light: Vec3, _: Vec3) -> bool {
                light.x > 0.0
            }
        }
        let drawn = draw(Drawing::Lobes, 1, 0, 4);
        let (pairs, targets) = Truth::Brdf(&Half).look(&drawn, 1, 0);
        let mut known = 0;
        for (block, target) in targets.iter().enumerate() {
            for (column, lane) in places() {
                let has_data = drawn[block].light[0][column][lane] > 0.0;
                let weight = if has_data { drawn[block].weight[column][lane] } else { 0.0 };
                assert_eq!(pairs[block].weight[column][lane], weight);
                assert!(!has_data || target[0][column][lane] == 1.0);
                known += usize::from(has_data);
            }
        }
        assert!((BLOCK..3 * BLOCK).contains(&known), "{known}");
    }

    #[test]
    fn samples_that_no_fit_can_use_are_named() {
        let (up, down) = ([Vec3::Z], [-Vec3::Z]);
        let check = |light, view, f| Truth::Samples { light, view, f }.check();
        assert_eq!(check(&up, &up, &[Vec3::ONE]), Ok(()));
        assert!(check(&[], &[], &[]).unwrap_err().contains("no sample"));
        assert!(check(&up, &[], &[Vec3::ONE]).unwrap_err().contains("1 lights, 0 views and 1 values"));
        assert!(check(&up, &down, &[Vec3::ONE]).unwrap_err().contains("sample 0 is below the horizon"));
        assert!(check(&up, &up, &[Vec3::NAN]).unwrap_err().contains("not finite"));
    }
}
