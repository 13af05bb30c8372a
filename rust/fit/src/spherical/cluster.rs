//! Which materials share a codebook and a network (paper, §3.3): those whose reflectance is alike.
//!
//! The paper clusters the codes of an autoencoder of the measurements. Here the code is ln(1 + f/0.003),
//! the network's own scale, at the same few hundred pairs for all, which needs no training.

use glimt_core::models::spherical::OUTPUT_SCALE;

use crate::backprop::BLOCK;
use crate::pairs::{self, Drawing};
use crate::truth::Truth;

/// The materials of each of `count` clusters: k-means from starts that are far apart. Clusters are in the
/// order of their first material. Materials that are known at samples alone are alike.
pub(crate) fn clusters(truths: &[Truth], count: usize) -> Vec<Vec<usize>> {
    const ROUNDS: usize = 20;
    if count >= truths.len() {
        return (0..truths.len()).map(|i| vec![i]).collect();
    }
    let codes: Vec<Vec<f32>> = truths.iter().map(code).collect();
    let distance = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
    let nearest = |code: &[f32], means: &[Vec<f32>]| {
        let distances = means.iter().map(|mean| distance(code, mean)).enumerate();
        distances.min_by(|a, b| a.1.total_cmp(&b.1)).expect("there is at least one mean")
    };
    let mut means = vec![codes[0].clone()];
    while means.len() < count {
        let furthest = codes.iter().max_by(|a, b| nearest(a, &means).1.total_cmp(&nearest(b, &means).1));
        means.push(furthest.expect("there is at least one material").clone());
    }
    let mut owners = Vec::new();
    for _ in 0..ROUNDS {
        owners = codes.iter().map(|code| nearest(code, &means).0).collect();
        for (i, mean) in means.iter_mut().enumerate() {
            let own: Vec<&Vec<f32>> =
                codes.iter().zip(&owners).filter(|&(_, &owner)| owner == i).map(|(code, _)| code).collect();
            if !own.is_empty() {
                *mean = (0..mean.len())
                    .map(|j| own.iter().map(|code| code[j]).sum::<f32>() / own.len() as f32)
                    .collect();
            }
        }
    }
    let mut clusters: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (material, &owner) in owners.iter().enumerate() {
        clusters[owner].push(material);
    }
    clusters.retain(|cluster| !cluster.is_empty());
    clusters.sort_by_key(|cluster| cluster[0]);
    clusters
}

/// What a material is compared by.
fn code(truth: &Truth) -> Vec<f32> {
    match truth {
        Truth::Samples { .. } => vec![0.0; 3 * BLOCK],
        Truth::Brdf(brdf) => {
            let targets = pairs::evaluate(*brdf, &pairs::draw(Drawing::Lobes, 0, 0, 1));
            let values = targets.as_flattened().as_flattened().as_flattened();
            values.iter().map(|f| (1.0 + f / OUTPUT_SCALE).ln()).collect()
        }
    }
}
