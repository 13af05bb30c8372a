//! From coarse tables to fine ones.
//!
//! A point of a fine hemisphere is seen by few of a step's pairs, and the optimiser, whose steps are of one length,
//! makes noise of what they say. A fit therefore begins with coarse hemispheres, whose points all have much to
//! go by, and doubles N_side until it is the form's. Features of the finer points are interpolated between
//! the coarser ones, so that points which few pairs ever fall on are smooth at least.

use std::sync::Arc;

use glimt_core::directions::healpix::Healpix;
use glimt_core::models::spherical::tables::{Form, Layout};

use super::SphericalObjective;
use crate::objective::Objective;
use crate::train::State;

/// N_side of the coarsest hemispheres.
const COARSEST: u16 = 4;

/// The tables of a fit in the order in which it has them; the last are the form's.
///
/// # Errors
/// As [`Form::validate`].
pub(super) fn layouts(form: Form) -> Result<Vec<Arc<Layout>>, String> {
    let mut nsides = vec![form.nside];
    while let Ok(half) = Healpix::try_from(nsides[0].nside() / 2)
        && half.nside() >= COARSEST
    {
        nsides.insert(0, half);
    }
    nsides.into_iter().map(|nside| Layout::new(Form { nside, ..form }).map(Arc::new)).collect()
}

impl SphericalObjective<'_> {
    /// Goes on with `finer` tables.
    pub(super) fn refine(&self, finer: &Layout, state: &mut State) {
        let (k, shared, own) = (self.features(), self.shared_len(), self.own_len());
        state.moments.first[shared..].fill(0.0);
        for numbers in [&mut state.numbers, &mut state.moments.second] {
            numbers[shared..].chunks_exact_mut(own).for_each(|own| refine(self.layout, finer, k, own));
        }
    }
}

/// Makes the numbers of rows of `k`, which are the first of `numbers`, those of the rows of a finer layout.
fn refine(coarse: &Layout, fine: &Layout, k: usize, numbers: &mut [f32]) {
    let before = numbers[..coarse.places().len() * k].to_vec();
    let axes = fine.form().grids.axes();
    let nodes = axes * usize::from(fine.form().nodes);
    // Lists, which come first, are the same.
    for (&(table, place), row) in fine.places().iter().zip(numbers.chunks_exact_mut(k)).skip(nodes) {
        let pixel = coarse.hemisphere().pixel(place.as_vec3().to_array());
        let [p, m]: [f32; 2] = pixel.at;
        let weights = [(1.0 - p) * (1.0 - m), p * (1.0 - m), (1.0 - p) * m, p * m];
        row.fill(0.0);
        for (corner, weight) in pixel.corners.into_iter().zip(weights) {
            let point = nodes + (table - axes) * coarse.hemisphere().points() + corner as usize;
            let of = &before[coarse.rows()[point] as usize * k..][..k];
            row.iter_mut().zip(of).for_each(|(x, y)| *x += weight * y);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glimt_core::models::spherical::pixelation::Pixelation;
    use glimt_core::models::spherical::tables::{Grids, Interpolation};

    #[test]
    fn finer_tables_hold_what_the_coarser_ones_did() {
        const K: usize = 4;
        for (grids, pixelation) in [
            (Grids::Lv, Pixelation::Healpix),
            (Grids::Iso, Pixelation::Healpix),
            (Grids::Iso, Pixelation::LatLong),
            (Grids::Hd, Pixelation::Fibonacci),
        ] {
            let interpolation = Interpolation::InverseDistance;
            let nside = Healpix::try_from(32).unwrap();
            let layouts =
                layouts(Form { grids, pixelation, nside, nodes: 9, features: K as u8, interpolation })
                    .unwrap();
            let nsides: Vec<u16> = layouts.iter().map(|layout| layout.form().nside.nside()).collect();
            assert_eq!(nsides, [4, 8, 16, 32]);
            let fine = &layouts[3];
            let of = |layout: &Layout, row: usize| {
                let (table, place) = layout.places()[row];
                [place.x + 2.0 * place.z, place.y.abs(), table as f64, place.z * place.z].map(|x| x as f32)
            };
            let mut numbers: Vec<f32> =
                (0..layouts[0].places().len()).flat_map(|r| of(&layouts[0], r)).collect();
            numbers.resize(fine.places().len() * K, 0.0);
            layouts.windows(2).for_each(|pair| refine(&pair[0], &pair[1], K, &mut numbers));
            // As far as a coarse pixel is wide, where the points of a lattice have no place in one.
            let limit = if pixelation == Pixelation::Fibonacci { 0.9 } else { 0.2 };
            for (row, x) in numbers.chunks_exact(K).enumerate() {
                for (x, expected) in x.iter().zip(of(fine, row)) {
                    assert!(
                        (x - expected).abs() < limit,
                        "{grids:?} {pixelation:?} {row}: {x}, not {expected}"
                    );
                }
            }
        }
    }
}
