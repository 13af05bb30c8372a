//! Pruning (paper, §3.2.1): what no sample supervises takes its features from the parent pixel.

use std::collections::HashMap;

use glimt_core::directions::healpix::Healpix;
use glimt_core::models::spherical::tables::{Layout, MAX_TABLES, Taps};
use glimt_core::simd::{Portable, Vector};

use crate::truth::Truth;

/// For each row of the tables, the kept row that it takes its features from, and the rows that are kept;
/// `None` where all are.
///
/// A row is kept if any sample has weight on it. Every other row on a hemisphere belongs to a pixel of the
/// grid of half the N_side, one of a quarter, and so on; in the smallest of these that has kept rows, it takes
/// the nearest of them. On a list it takes the nearest kept node.
pub(crate) fn prune(layout: &Layout, truth: Truth) -> Option<(Vec<u32>, Vec<usize>)> {
    let Truth::Samples { light, view, .. } = truth else { return None };
    let places = layout.places();
    let mut supervised = vec![false; places.len()];
    for (l, v) in light.iter().zip(view) {
        let mut taps = [Taps::<4>::EMPTY; MAX_TABLES];
        let [l, v] = [*l, *v].map(|w| w.to_array().map(|x| Vector::new(Portable, x)));
        layout.taps(Portable, l, v, &mut taps);
        for (table, taps) in taps.iter().take(layout.form().grids.tables()).enumerate() {
            for tap in (0..layout.tap_count(table)).filter(|&tap| taps.weights[tap][0] > 0.0) {
                supervised[layout.rows()[taps.points[tap][0] as usize] as usize] = true;
            }
        }
    }
    if supervised.iter().all(|&is| is) {
        return None;
    }
    let kept: Vec<usize> = (0..places.len()).filter(|&row| supervised[row]).collect();
    let mut number = vec![0; places.len()];
    for (i, &row) in kept.iter().enumerate() {
        number[row] = i as u32;
    }
    // The kept rows in every pixel of every coarser grid; the whole table is the coarsest.
    let levels: Vec<Option<Healpix>> =
        std::iter::successors(Some(layout.form().nside.nside() / 2), |n| Some(n / 2))
            .take_while(|&n| n > 0)
            .map(|n| Healpix::try_from(n).ok())
            .chain([None])
            .collect();
    let is_list = |table: usize| layout.tap_count(table) == 2;
    let pixel = |row: usize, level: Option<Healpix>| {
        let (table, place) = places[row];
        let level = level.filter(|_| !is_list(table));
        (table, level.map(|grid| grid.pixel(place.as_vec3().to_array()).corners))
    };
    let inside: Vec<HashMap<_, Vec<usize>>> = levels
        .iter()
        .map(|&level| {
            let mut rows: HashMap<_, Vec<usize>> = HashMap::new();
            kept.iter().for_each(|&row| rows.entry(pixel(row, level)).or_default().push(row));
            rows
        })
        .collect();
    let parent = |row: usize| {
        let known = |(&level, inside): (&Option<Healpix>, &HashMap<_, Vec<usize>>)| {
            let rows = inside.get(&pixel(row, level))?;
            let distance = |&other: &usize| places[other].1.distance_squared(places[row].1);
            rows.iter().copied().min_by(|a, b| distance(a).total_cmp(&distance(b)))
        };
        levels.iter().zip(&inside).find_map(known).expect("every sample has weight in every table")
    };
    let links = (0..places.len()).map(|row| number[if supervised[row] { row } else { parent(row) }]);
    Some((links.collect(), kept))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use glimt_core::models::spherical::pixelation::Pixelation;
    use glimt_core::models::spherical::tables::{Form, Grids, Interpolation};

    fn layout(grids: Grids) -> Layout {
        let nside = Healpix::try_from(8).unwrap();
        let pixelation = Pixelation::Healpix;
        let interpolation = Interpolation::Bilinear;
        Layout::new(Form { grids, pixelation, nside, nodes: 24, features: 4, interpolation }).unwrap()
    }

    #[test]
    fn unsupervised_rows_take_a_near_supervised_row_of_their_own_table() {
        let direction = |i: usize| {
            let (z, phi) = (0.3 + 0.7 * (i as f32 * 0.754_877_7).fract(), i as f32 * 2.399);
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z)
        };
        let light: Vec<Vec3> = (0..40).map(direction).collect();
        let view: Vec<Vec3> = (0..40).map(|i| direction(3 * i + 7)).collect();
        let f = vec![Vec3::ONE; 40];
        for grids in [Grids::Lv, Grids::Hd, Grids::Iso] {
            let layout = layout(grids);
            let truth = Truth::Samples { light: &light, view: &view, f: &f };
            let (links, kept) = prune(&layout, truth).unwrap();
            assert!(
                kept.len() < links.len() && kept.len() > 40,
                "{grids:?}: {} of {}",
                kept.len(),
                links.len()
            );
            for (row, &link) in links.iter().enumerate() {
                let source = kept[link as usize];
                assert_eq!(layout.places()[row].0, layout.places()[source].0);
                if kept.binary_search(&row).is_ok() {
                    assert_eq!(source, row);
                }
            }
        }
    }

    #[test]
    fn what_is_known_everywhere_is_not_pruned() {
        let material = glimt_core::models::ggx::Ggx::new(glimt_core::microfacet::Microfacet {
            kd: [0.2; 3],
            eta: [1.5; 3],
            alpha: [0.3; 2],
        });
        assert!(prune(&layout(Grids::Iso), Truth::Brdf(&material.unwrap())).is_none());
    }
}
