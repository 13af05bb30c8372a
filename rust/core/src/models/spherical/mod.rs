//! `spherical`: Dou, Zheng, Jin, Ni, Chen, Ke, *Real-Time Neural BRDF with Spherically Distributed
//! Primitives*.
//!
//! f = m(ψ(l, v)): features are looked up in tables on hemispheres, interpolated, concatenated (eq. 1),
//! and decoded by a small network m (eq. 2). Features are kept as they are, or as indices into a codebook
//! of neural reflectance primitives (eq. 3), which several materials may share with the network (§3.3).
//!
//! The paper's tables are a hemisphere of lights and one of views. [`tables::Grids`] has others that come
//! far nearer to the same measurements at the same size, and [`tables::Interpolation`] one that is
//! continuous where the paper's run time is not.
//!
//! The network yields y with f = 0.003 (eʸ − 1), so that it works on a scale on which dark values and
//! lobes are both of the order of 1. y is limited to a little more than the fit saw.

mod look_up;
pub mod pixelation;
mod products;
pub mod store;
pub mod tables;

use std::sync::Arc;

use glam::Vec3;

use crate::error::Invalid;
use crate::kernels::network::{Network, One, Rows};
use crate::kernels::{Kernel, splat3};
use crate::models::{Model, spelled};
use crate::simd::math::exp;
use crate::simd::{Isa, Lane, Lanes, Real, Vector};
use look_up::MAX_INPUTS;
use products::{FirstLayer, Products};
use store::Store;
use tables::{Form, Grids, Layout, MAX_TABLES, Taps};

/// Where f turns from linear to exponential in the network's output.
pub const OUTPUT_SCALE: f32 = 0.003;

/// Largest bound of the network's output: f is then far above any measured lobe, and its square finite.
pub const MAX_BOUND: f32 = 30.0;

/// f of one channel from the network's output.
#[inline(always)]
#[must_use]
pub fn from_output<F: Real>(y: F, bound: f32) -> F {
    ((exp(y.at_most(bound)) - 1.0) * OUTPUT_SCALE).max(y.splat(0.0))
}

/// The features of one material.
#[derive(Clone, Debug)]
pub struct Features {
    /// What is kept.
    pub store: Store,
    /// The kept row that each row of the layout takes its features from, where some were pruned; otherwise
    /// every row has its own.
    pub links: Option<Vec<u32>>,
}

impl Features {
    /// The table that each kept row belongs to.
    ///
    /// # Errors
    /// In words, that links point nowhere, from two tables to one row, or that a row is kept for nothing.
    fn tables(&self, layout: &Layout) -> Result<Vec<usize>, Invalid> {
        let places = layout.places();
        let kept = self.store.rows(layout.form().features.into());
        let Some(links) = &self.links else {
            return if kept == places.len() {
                Ok(places.iter().map(|&(table, _)| table).collect())
            } else {
                Err(format!("it keeps {kept} rows of features, expected {}", places.len()).into())
            };
        };
        if links.len() != places.len() {
            return Err(format!("it links {} rows, expected {}", links.len(), places.len()).into());
        }
        let mut tables = vec![None; kept];
        for (&link, &(table, _)) in links.iter().zip(places) {
            let known = tables.get_mut(link as usize).ok_or_else(|| {
                format!("a row is linked to the kept row {link}, expected less than {kept}")
            })?;
            if *known.get_or_insert(table) != table {
                return Err(format!("rows of two tables are linked to the kept row {link}").into());
            }
        }
        let unused = |row| format!("nothing is linked to the kept row {row}");
        tables.iter().enumerate().map(|(row, table)| table.ok_or_else(|| unused(row).into())).collect()
    }
}

/// One material of the spherical model.
#[derive(Clone, Debug)]
pub struct Spherical {
    layout: Arc<Layout>,
    network: Arc<Network>,
    features: Features,
    bound: f32,
    /// What can be pointed to, [entry][k], …
    values: Vec<f32>,
    /// … and the entry of every point.
    entries: Vec<u32>,
    /// The first layer of each, where that is worth its memory.
    products: Option<Products>,
    first_bias: Vec<Lane>,
}

impl Spherical {
    /// A material; `bound` is the largest network output that the fit saw.
    ///
    /// # Errors
    /// In words, if tables, features and network do not fit together.
    pub fn new(
        layout: Arc<Layout>,
        network: Arc<Network>,
        features: Features,
        bound: f32,
    ) -> Result<Self, Invalid> {
        let k = usize::from(layout.form().features);
        if network.features() != layout.form().inputs() || network.latent() != 0 || network.outputs() != 3 {
            return Err(format!(
                "the network maps {} features to {} values, expected {} to 3",
                network.layers()[0].inputs(),
                network.outputs(),
                layout.form().inputs()
            )
            .into());
        }
        if bound > MAX_BOUND || !bound.is_finite() {
            return Err(format!("the bound of the output is {bound}, expected at most {MAX_BOUND}").into());
        }
        let (values, of_row) = features.store.decode(k, &features.tables(&layout)?);
        if !values.iter().all(|x| x.is_finite()) {
            return Err("its features are not finite".into());
        }
        if let Some(entry) = of_row.iter().find(|&&entry| entry as usize >= values.len() / k) {
            let found = values.len() / k;
            return Err(format!("an index is {entry}, but the codebook has {found} primitives").into());
        }
        let kept = |row: u32| features.links.as_ref().map_or(row, |links| links[row as usize]);
        let entries: Vec<u32> = layout.rows().iter().map(|&row| of_row[kept(row) as usize]).collect();
        let first_bias = network.fold(&[]);
        let products = Products::new(&layout, &network, &values, &entries);
        Ok(Spherical { layout, network, features, bound, values, entries, products, first_bias })
    }

    /// The tables.
    #[must_use]
    pub fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    /// The decoder m.
    #[must_use]
    pub fn network(&self) -> &Arc<Network> {
        &self.network
    }

    /// The features as they are kept.
    #[must_use]
    pub fn features(&self) -> &Features {
        &self.features
    }

    /// The largest output that counts.
    #[must_use]
    pub fn bound(&self) -> f32 {
        self.bound
    }
}

impl Model for Spherical {
    const KIND: &'static str = "spherical";

    fn describe(&self) -> String {
        let Form { grids, pixelation, nside, nodes, features, interpolation } = self.layout.form();
        let lists = if grids == Grids::Iso { format!(", {nodes} nodes") } else { String::new() };
        format!(
            "grids {}, {} of N_side {}{lists}, {features} features as {}, {}",
            grids.name(),
            spelled(&pixelation),
            nside.nside(),
            self.features.store.kind(),
            spelled(&interpolation)
        )
    }

    fn is_isotropic(&self) -> bool {
        self.layout.form().grids == Grids::Iso
    }

    fn network(&self) -> Option<&Network> {
        Some(&self.network)
    }
}

impl Kernel for Spherical {
    #[inline(always)]
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        let mut taps = [Taps::EMPTY; MAX_TABLES];
        self.layout.taps(isa, light, view, &mut taps);
        let (mut x, mut y) = (Rows::default(), Rows::default());
        if let Some(products) = &self.products {
            isa.run(FirstLayer { products, material: self, taps: &taps, y: &mut x });
            self.network.forward_tile_from(isa, &x, &mut y);
        } else {
            isa.run(look_up::Features { material: self, taps: &taps, x: &mut x });
            self.network.forward_tile(isa, self.first_bias.as_flattened(), &x, &mut y);
        }
        let y = Vector::load3(isa, &[y[0], y[1], y[2]]);
        [from_output(y[0], self.bound), from_output(y[1], self.bound), from_output(y[2], self.bound)]
    }

    #[inline(always)]
    fn eval_one<I: Isa>(&self, isa: I, light: Vec3, view: Vec3) -> Vec3 {
        let mut taps = [Taps::EMPTY; MAX_TABLES];
        self.layout.taps::<I, 4>(isa, splat3(isa, light), splat3(isa, view), &mut taps);
        let (mut x, mut y) = ([0.0; MAX_INPUTS], One::default());
        if let Some(products) = &self.products {
            products.first_layer_of_one(isa, self, &taps, &mut x);
            self.network.forward_one_from(isa, &x, &mut y);
        } else {
            self.features_of_one(isa, &taps, &mut x);
            self.network.forward_one(isa, &self.first_bias, &x, &mut y);
        }
        let f = from_output(Vector::<I, 4>::load(isa, y.four_from::<0>()), self.bound).to_array();
        Vec3::new(f[0], f[1], f[2])
    }
}

/// The same model in float64, by the definitions. What tests compare against.
pub mod reference {
    use super::{OUTPUT_SCALE, Spherical, tables};
    use crate::kernels::network;
    use glam::DVec3;

    /// f for directions above the horizon.
    #[must_use]
    pub fn eval(material: &Spherical, light: DVec3, view: DVec3) -> [f64; 3] {
        let k = usize::from(material.layout.form().features);
        let feature = |taps: &[(usize, f64)], j: usize| -> f64 {
            let value = |point: usize| f64::from(material.values[material.entries[point] as usize * k + j]);
            taps.iter().map(|&(point, weight)| weight * value(point)).sum()
        };
        let taps = tables::reference::taps(&material.layout, light, view);
        let x: Vec<f64> = taps.iter().flat_map(|taps| (0..k).map(|j| feature(taps, j))).collect();
        let y = network::reference::forward(&material.network, &x, &[]);
        std::array::from_fn(|c| {
            (f64::from(OUTPUT_SCALE) * (y[c].min(material.bound.into()).exp() - 1.0)).max(0.0)
        })
    }
}

#[cfg(test)]
pub(crate) mod tests;
