//! Every material of the catalogue on every pair of the catalogue, or on any others: what must hold
//! for all of them, and how far the results are from float64.

use glam::Vec3;
use glimt_core::kernels::network::{Layer, Network};
use glimt_core::sampling::Plan;
use glimt_core::simd::{LANES, Lane3};
use glimt_core::{Brdf, Material, Sample, SampleBrdf, is_lit};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::accuracy::{Worst, condition};
use crate::extremes::{self, Case, Family, Pair};

/// What a material answered that it must not, or `None`.
///
/// f is finite and ≥ 0; f and pdf are 0 for what is no pair of directions above the horizon; the pdf
/// is finite and ≥ 0, and > 0 where f is; a sample is valid or failed. The warp that a measurement brings along has
/// the zeros that it has: where its tables are 0, and at exact mirror pairs, where its square has no area.
#[must_use]
pub fn violation(material: &Material, (light, view): Pair, f: Vec3, u: Vec3) -> Option<String> {
    let pdf = material.pdf(light, view);
    let reaches_all = !matches!(material.plan(), Plan::Warp(_));
    let wrong = if !f.is_finite() || f.min_element() < 0.0 {
        format!("f is {f}")
    } else if !pdf.is_finite() || pdf < 0.0 {
        format!("the pdf is {pdf}")
    } else if !is_lit(light, view) && (f != Vec3::ZERO || pdf != 0.0) {
        format!("f is {f} and the pdf {pdf} where nothing is lit")
    } else if f != Vec3::ZERO && pdf == 0.0 && reaches_all {
        format!("f is {f} and the pdf 0")
    } else {
        wrong_sample(view, material.sample(view, u))?
    };
    Some(format!("{wrong} at light {light:?}, view {view:?}, u {u:?}"))
}

/// What is wrong with a sample, or `None`.
fn wrong_sample(view: Vec3, sample: Sample) -> Option<String> {
    /// A direction sampled for a view of unit length is a unit vector to within this.
    const LENGTH_TOLERANCE: f32 = 2e-6;
    let Sample { light, pdf, weight } = sample;
    if pdf == 0.0 {
        return (sample != Sample::FAILED).then(|| format!("a failed sample is {sample:?}"));
    }
    let off_length = (light.length() - 1.0).abs() - (view.length() - 1.0).abs();
    let is_valid = is_lit(light, view)
        && pdf.is_finite()
        && pdf > 0.0
        && weight.is_finite()
        && weight.min_element() >= 0.0
        && off_length <= LENGTH_TOLERANCE;
    (!is_valid).then(|| format!("the sample is {sample:?}"))
}

/// f of all pairs by batch.
#[must_use]
pub fn eval_batch(material: &Material, pairs: &[Pair]) -> Vec<Vec3> {
    let (light, view): (Vec<Vec3>, Vec<Vec3>) = pairs.iter().copied().unzip();
    let mut f = vec![Vec3::splat(f32::NAN); pairs.len()];
    material.eval_batch(&light, &view, &mut f);
    f
}

/// Where the ways to evaluate many pairs differ, or `None`: tiles, packets of any width, and batches of
/// any length that begin anywhere have the bits of `expected`, which is [`eval_batch`] of all.
#[must_use]
pub fn disagreement(material: &Material, pairs: &[Pair], expected: &[Vec3]) -> Option<String> {
    let bits = |f: &[Vec3]| f.iter().map(|f| f.to_array().map(f32::to_bits)).collect::<Vec<_>>();
    for range in [0..0, 0..1, 1..2, 0..LANES.min(pairs.len()), 3..pairs.len(), 1..pairs.len() - 1] {
        let batch = eval_batch(material, &pairs[range.clone()]);
        if bits(&batch) != bits(&expected[range.clone()]) {
            return Some(format!("the batch {range:?} differs from the whole"));
        }
    }
    let of = [|pair: &Pair| pair.0, |pair: &Pair| pair.1];
    for width in [1, 4, 7, 8, LANES] {
        for (chunk, expected) in pairs.chunks_exact(width).zip(expected.chunks_exact(width)) {
            let [light, view] =
                of.map(|of| [0, 1, 2].map(|c| chunk.iter().map(|pair| of(pair)[c]).collect::<Vec<f32>>()));
            let mut f = [0, 1, 2].map(|_| vec![f32::NAN; width]);
            let [red, green, blue] = &mut f;
            let [light, view] = [&light, &view].map(|v| v.each_ref().map(Vec::as_slice));
            material.eval_packet(light, view, [red, green, blue]);
            let f: Vec<Vec3> = (0..width).map(|i| Vec3::new(f[0][i], f[1][i], f[2][i])).collect();
            if bits(&f) != bits(expected) {
                return Some(format!("a packet of {width} differs from the batch: {f:?}, {expected:?}"));
            }
        }
    }
    for (chunk, expected) in pairs.chunks_exact(LANES).zip(expected.chunks_exact(LANES)) {
        let [light, view]: [Lane3; 2] =
            of.map(|of| std::array::from_fn(|c| std::array::from_fn(|lane| of(&chunk[lane])[c])));
        let mut tile = [[f32::NAN; LANES]; 3];
        material.eval_tile(&light, &view, &mut tile);
        let tile: Vec<Vec3> = (0..LANES).map(|lane| Vec3::from_array(tile.map(|c| c[lane]))).collect();
        if bits(&tile) != bits(expected) {
            return Some(format!("a tile differs from the batch: {tile:?}, {expected:?}"));
        }
    }
    None
}

/// The catalogue's answers for one material.
pub struct Outcome {
    /// What must not be.
    pub violations: Vec<String>,
    /// Errors of f by family, in the order of [`extremes::families`].
    pub errors: Vec<Worst>,
}

/// Runs a material on all families.
#[must_use]
pub fn run(case: &Case, families: &[Family]) -> Outcome {
    let material = &case.material;
    let neighbours = neighbours(material);
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let mut outcome = Outcome { violations: Vec::new(), errors: Vec::new() };
    for family in families {
        let mut worst = Worst::default();
        let batch = eval_batch(material, &family.pairs);
        for (&(light, view), &in_batch) in family.pairs.iter().zip(&batch) {
            let u = Vec3::new(rng.random(), rng.random(), rng.random());
            const LAST: f32 = 1.0 - f32::EPSILON / 2.0;
            for f in [in_batch, material.eval(light, view)] {
                for u in [u, Vec3::ZERO, Vec3::splat(LAST), Vec3::new(0.0, u.y, LAST)] {
                    outcome.violations.extend(violation(material, (light, view), f, u));
                }
                if is_lit(light, view) {
                    compare(material, &neighbours, (light, view), f, &mut worst);
                }
            }
        }
        outcome.violations.extend(disagreement(material, &family.pairs, &batch));
        outcome.errors.push(worst);
    }
    let name = |wrong| format!("{} ({}): {wrong}", material.kind(), case.name);
    outcome.violations = outcome.violations.into_iter().map(name).collect();
    outcome
}

/// Adds the errors of f at a lit pair.
fn compare(material: &Material, neighbours: &[Material], (light, view): Pair, f: Vec3, worst: &mut Worst) {
    let (l, v) = (light.as_dvec3(), view.as_dvec3());
    let Some(exact) = extremes::reference(material, l, v) else { return };
    for channel in 0..3 {
        let moved = || {
            let inputs = [light.x, light.y, light.z, view.x, view.y, view.z];
            let by_directions = condition(inputs, |[a, b, c, x, y, z]| {
                extremes::reference(material, [a, b, c].into(), [x, y, z].into()).map_or(0.0, |f| f[channel])
            });
            let by_parameters = neighbours
                .iter()
                .filter_map(|other| extremes::reference(other, l, v))
                .map(|moved| (moved[channel] - exact[channel]).abs())
                .fold(0.0, f64::max);
            by_directions + by_parameters
        };
        let inputs =
            || format!("light {:?}, view {:?}, channel {channel}", light.to_array(), view.to_array());
        worst.add(f[channel], exact[channel], exact[channel], moved, inputs);
    }
}

/// The material with all its numbers moved by half an ULP up or down, several times at random.
///
/// Together they show what its parameters contribute to the condition: the sums of a network are
/// rounded as if its weights had moved so.
fn neighbours(material: &Material) -> Vec<Material> {
    const COUNT: u64 = 8;
    (0..COUNT)
        .filter_map(|seed| {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            extremes::nudged(material, &mut |x| {
                // Half an ULP is no float32; a whole one, half of the time, is as much.
                match rng.random_range(0..4) {
                    0 => x.next_up(),
                    1 => x.next_down(),
                    _ => x,
                }
            })
        })
        .collect()
}

/// A network with every weight and bias put through `nudge`.
pub fn nudged_network(network: &Network, nudge: &mut dyn FnMut(f32) -> f32) -> Network {
    let layers = network.layers().iter().map(|layer| nudged_layer(layer, nudge)).collect();
    Network::new(layers, network.features(), network.activation()).expect("the shape is that of a network")
}

/// [`nudged_network`] for one layer.
pub fn nudged_layer(layer: &Layer, nudge: &mut dyn FnMut(f32) -> f32) -> Layer {
    let mut nudge = |values: &[f32]| values.iter().map(|&x| nudge(x)).collect();
    Layer { weight: nudge(&layer.weight), bias: nudge(&layer.bias) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extremes::{Part, families, parts};
    use crate::random_pairs;
    use rayon::prelude::*;

    fn all_cases() -> Vec<Case> {
        parts().iter().flat_map(|part| (part.cases)()).collect()
    }

    #[test]
    fn every_material_keeps_its_promises_on_the_catalogue() {
        let families = families();
        for Part { kind, cases, budget } in parts() {
            cases().par_iter().for_each(|case| {
                let outcome = run(case, &families);
                assert_eq!(outcome.violations.first(), None, "one of {}", outcome.violations.len());
                for (family, worst) in families.iter().zip(outcome.errors) {
                    let blame = worst.blamed.blame();
                    let name = &case.name;
                    assert!(
                        blame <= budget,
                        "{kind} ({name}), {}: {blame:.1} times the condition: {}",
                        family.name,
                        worst.blamed
                    );
                }
            });
        }
    }

    #[test]
    fn the_catalogue_has_materials_of_every_kind_under_its_name() {
        for Part { kind, cases, .. } in parts() {
            let cases = cases();
            assert!(!cases.is_empty(), "{kind}");
            for case in cases {
                assert_eq!(case.material.kind(), kind, "{}", case.name);
            }
        }
    }

    /// Random pairs over all materials, in parallel: how many violations, and the first.
    fn violations_of(count: usize) -> (usize, Option<String>) {
        let cases = all_cases();
        let blocks = count.div_ceil(random_pairs::BLOCK);
        (0..blocks)
            .into_par_iter()
            .map(|block| {
                let found = random_pairs::violations(&cases[block % cases.len()], block as u64);
                (found.len(), found.into_iter().next())
            })
            .reduce(|| (0, None), |a, b| (a.0 + b.0, a.1.or(b.1)))
    }

    #[test]
    fn ten_million_random_pairs_violate_nothing() {
        assert_eq!(violations_of(10_000_000), (0, None));
    }

    #[test]
    #[ignore = "long: 10⁹ pairs, half an hour on two cores"]
    fn a_billion_random_pairs_violate_nothing() {
        assert_eq!(violations_of(1_000_000_000), (0, None));
    }
}
