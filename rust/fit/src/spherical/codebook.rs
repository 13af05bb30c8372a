//! Features become primitives and indices (paper, §3.3).

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::SphericalObjective;
use super::turn::turn;
use crate::objective::Objective;
use crate::train::State;

/// How far a row's features go to its primitive whenever primitives are chosen anew. With none of it features
/// drift from what stands for them, with all of it no row ever changes its primitive; between, it matters little.
const PULL: f32 = 0.3;

impl SphericalObjective {
    /// Makes the codebook of the features: they are turned into those in which distances matter alike (see
    /// [`turn`]), and primitives are their means. A row counts as much as the loss has shown to depend on it: by
    /// the mean square of its derivatives, which the optimiser keeps.
    pub(super) fn make_codebook(&self, state: &mut State, seed: u64) {
        turn(self, state);
        let k = self.features();
        let codebook = self.shape.len()..self.shared_len();
        let rows = self.all_features(&state.numbers);
        let squares = self.all_features(&state.moments.second);
        let weights = row_weights(&squares, k);
        let primitives = &mut state.numbers[codebook.clone()];
        means(&rows, &weights, k, primitives, seed);
        let owners = nearest(&rows, primitives, k);
        // A primitive's derivative is the sum of its rows'.
        let primitive_squares = &mut state.moments.second[codebook];
        for (&owner, squares) in owners.iter().zip(squares.chunks_exact(k)) {
            let sums = primitive_squares[owner * k..][..k].iter_mut();
            sums.zip(squares).for_each(|(sum, square)| *sum += square);
        }
        self.set_choices(state, &owners);
    }

    /// Chooses the nearest primitive for every row, and pulls its features there.
    pub(super) fn choose(&self, state: &mut State) {
        let k = self.features();
        let rows = self.all_features(&state.numbers);
        let owners = nearest(&rows, &state.numbers[self.shape.len()..self.shared_len()], k);
        self.set_choices(state, &owners);
        let (shared, own) = state.numbers.split_at_mut(self.shared_len());
        let primitives = &shared[self.shape.len()..];
        let rows =
            own.chunks_exact_mut(self.own_len()).flat_map(|own| own[..self.rows() * k].chunks_exact_mut(k));
        for (row, owner) in rows.zip(owners) {
            row.iter_mut().zip(&primitives[owner * k..]).for_each(|(x, p)| *x += PULL * (p - *x));
        }
    }

    fn set_choices(&self, state: &mut State, owners: &[usize]) {
        let materials = state.numbers[self.shared_len()..].chunks_exact_mut(self.own_len());
        for (own, owners) in materials.zip(owners.chunks_exact(self.rows())) {
            let choices = &mut own[self.rows() * self.features()..];
            choices.iter_mut().zip(owners).for_each(|(choice, &owner)| *choice = owner as f32);
        }
    }

    /// What `numbers` has for the features of all materials, [material][row][k].
    pub(super) fn all_features(&self, numbers: &[f32]) -> Vec<f32> {
        let materials = numbers[self.shared_len()..].chunks_exact(self.own_len());
        materials.flat_map(|own| &own[..self.rows() * self.features()]).copied().collect()
    }
}

/// Sums over rows of k; 1 each if all are 0.
pub(super) fn row_weights(squares: &[f32], k: usize) -> Vec<f32> {
    let mut weights: Vec<f32> = squares.chunks_exact(k).map(|row| row.iter().sum()).collect();
    if weights.iter().all(|&weight| weight == 0.0) {
        weights.fill(1.0);
    }
    weights
}

fn distance(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// The nearest of `means` to each of `rows`.
fn nearest(rows: &[f32], means: &[f32], k: usize) -> Vec<usize> {
    match k {
        4 => nearest_of::<4>(rows, means),
        8 => nearest_of::<8>(rows, means),
        _ => nearest_of::<16>(rows, means),
    }
}

fn nearest_of<const K: usize>(rows: &[f32], means: &[f32]) -> Vec<usize> {
    let (rows, means) = (rows.as_chunks::<K>().0, means.as_chunks::<K>().0);
    let nearest = |row: &[f32; K]| {
        let distances = means.iter().map(|mean| {
            let mut sum = 0.0;
            for j in 0..K {
                sum += (row[j] - mean[j]) * (row[j] - mean[j]);
            }
            sum
        });
        distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).expect("there is at least one mean").0
    };
    // Rows that are worth another thread.
    const ROWS: usize = 64;
    rows.par_iter().with_min_len(ROWS).map(nearest).collect()
}

/// Fills `means` with means of `rows`, which count as `weights` say, by Lloyd's algorithm from rows that are drawn by
/// their distance to those before (k-means++, Arthur & Vassilvitskii 2007). A mean that nothing is nearest to
/// stays where it is.
fn means(rows: &[f32], weights: &[f32], k: usize, means: &mut [f32], seed: u64) {
    const ROUNDS: usize = 30;
    let mut rng = Pcg64::seed_from_u64(seed);
    // Weights times squared distances to the nearest mean; to begin with, the weights alone.
    let mut shares: Vec<f32> = weights.to_vec();
    let mut least = vec![f32::INFINITY; weights.len()];
    for (i, mean) in means.chunks_exact_mut(k).enumerate() {
        let total: f64 = shares.iter().map(|&share| f64::from(share)).sum();
        let mut at = rng.random::<f64>() * total;
        let drawn = shares.iter().position(|&share| {
            at -= f64::from(share);
            at < 0.0
        });
        // Where every row is a mean already, any will do.
        let row = drawn.unwrap_or(i % weights.len());
        mean.copy_from_slice(&rows[row * k..][..k]);
        for (((share, least), weight), row) in
            shares.iter_mut().zip(&mut least).zip(weights).zip(rows.chunks_exact(k))
        {
            *least = least.min(distance(row, mean));
            *share = weight * *least;
        }
    }
    for _ in 0..ROUNDS {
        let owners = nearest(rows, means, k);
        let (mut sums, mut totals) = (vec![0.0f64; means.len()], vec![0.0f64; means.len() / k]);
        for ((row, &owner), &weight) in rows.chunks_exact(k).zip(&owners).zip(weights) {
            totals[owner] += f64::from(weight);
            sums[owner * k..][..k].iter_mut().zip(row).for_each(|(sum, x)| *sum += f64::from(weight * x));
        }
        let sums = sums.chunks_exact(k).zip(totals);
        for (mean, (sum, total)) in means.chunks_exact_mut(k).zip(sums).filter(|(_, (_, total))| *total > 0.0)
        {
            mean.iter_mut().zip(sum).for_each(|(mean, sum)| *mean = (sum / total) as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_those_of_clusters_that_are_far_apart() {
        let centres = [[0.0, 0.0, 0.0, 0.0], [5.0, 0.0, 1.0, 0.0], [0.0, -4.0, 0.0, 3.0f32]];
        let rows: Vec<f32> = (0..300)
            .flat_map(|i| centres[i % 3].map(|x| x + 0.1 * ((i / 3) as f32 * 1.7 + x).sin()))
            .collect();
        let mut found = vec![0.0; 12];
        means(&rows, &vec![1.0; 300], 4, &mut found, 1);
        for (i, centre) in centres.iter().enumerate() {
            let owner = nearest(centre, &found, 4)[0];
            assert!(distance(&found[owner * 4..][..4], centre) < 1e-2, "{centre:?}: {found:?}");
            assert_eq!(nearest(&rows[i * 4..][..4], &found, 4)[0], owner);
        }
    }

    #[test]
    fn rows_that_count_more_draw_means_to_them() {
        let rows: Vec<f32> = (0..8).flat_map(|i| [i as f32, 0.0, 0.0, 0.0]).collect();
        let mut mean = vec![0.0; 4];
        means(&rows, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0], 4, &mut mean, 1);
        assert!((mean[0] - 7.0 * 0.75).abs() < 1e-5, "{mean:?}");
    }

    #[test]
    fn more_means_than_different_rows_are_finite() {
        let rows = [1.0, 2.0, 3.0, 4.0].repeat(5);
        let mut found = vec![0.0; 32];
        means(&rows, &[1.0; 5], 4, &mut found, 1);
        assert_eq!(found, [1.0, 2.0, 3.0, 4.0].repeat(8));
    }
}
