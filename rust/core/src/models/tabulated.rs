//! Measured reflectance as a material: a table is looked up, nothing is fitted.
//!
//! The tables themselves are read elsewhere (`glimt-measured`); here is what a renderer needs of them.

use std::fmt;
use std::sync::Arc;

use glam::Vec3;

use crate::brdf::Brdf;
use crate::models::Model;
use crate::oddity::Oddity;
use crate::sampling::table::Resolution;
use crate::sampling::{DirectionSampler, Plan};
use crate::simd::Lane3;

/// A table of measured reflectance.
pub trait Table: Brdf + fmt::Debug {
    /// The format's name as commands spell it: `merl`, `rgl` or `utia`.
    fn format(&self) -> &'static str;

    /// How many values it has along which axes, in a few words.
    fn grid(&self) -> String;

    /// What the file says about the material; empty for the formats that say nothing.
    fn description(&self) -> &str {
        ""
    }

    /// Whether f depends on the difference of the azimuths only.
    fn is_isotropic(&self) -> bool;

    /// Whether f(l, v) = f(v, l) by construction.
    fn is_reciprocal(&self) -> bool;

    /// What is odd about the file that it was read from, and what was made of it.
    fn oddities(&self) -> &[Oddity];
}

/// A measured material: the table, which its copies share, and the warp that may come with it.
///
/// ```
/// use std::sync::Arc;
///
/// use glimt_core::models::tabulated::{Table, Tabulated};
/// use glimt_core::{Brdf, Kind, Material, Oddity, SampleBrdf, Vec3, is_lit};
///
/// /// A table of one number.
/// #[derive(Debug)]
/// struct Grey;
///
/// impl Brdf for Grey {
///     fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
///         if is_lit(light, view) { Vec3::splat(0.1) } else { Vec3::ZERO }
///     }
/// }
///
/// impl Table for Grey {
///     fn format(&self) -> &'static str {
///         "merl"
///     }
///
///     fn grid(&self) -> String {
///         "1 value".to_owned()
///     }
///
///     fn is_isotropic(&self) -> bool {
///         true
///     }
///
///     fn is_reciprocal(&self) -> bool {
///         true
///     }
///
///     fn oddities(&self) -> &[Oddity] {
///         &[]
///     }
/// }
///
/// let material = Material::from(Tabulated::new(Arc::new(Grey), None));
/// assert_eq!(material.kind(), Kind::Tabulated);
/// assert!(material.pdf(Vec3::Z, Vec3::Z) > 0.0);
/// ```
#[derive(Clone, Debug)]
pub struct Tabulated {
    table: Arc<dyn Table>,
    warp: Option<Arc<dyn DirectionSampler>>,
}

impl Tabulated {
    /// A material of `table`, sampled by the measurement's own `warp` or else by a
    /// [`TableSampler`](crate::sampling::table::TableSampler).
    #[must_use]
    pub fn new(table: Arc<dyn Table>, warp: Option<Arc<dyn DirectionSampler>>) -> Tabulated {
        Tabulated { table, warp }
    }

    /// The table.
    #[must_use]
    pub fn table(&self) -> &dyn Table {
        &*self.table
    }
}

impl Model for Tabulated {
    const KIND: &'static str = "tabulated";

    fn describe(&self) -> String {
        self.table.grid()
    }

    fn plan(&self) -> Plan {
        self.warp.clone().map_or(Plan::Table(Resolution::DEFAULT), Plan::Warp)
    }

    fn is_isotropic(&self) -> bool {
        self.table.is_isotropic()
    }

    fn is_reciprocal(&self) -> bool {
        self.table.is_reciprocal()
    }
}

impl Brdf for Tabulated {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        self.table.eval(light, view)
    }

    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        self.table.eval_tile(light, view, out);
    }

    fn eval_packet(&self, light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        self.table.eval_packet(light, view, out);
    }

    fn eval_batch(&self, light: &[Vec3], view: &[Vec3], out: &mut [Vec3]) {
        self.table.eval_batch(light, view, out);
    }

    fn has_data(&self, light: Vec3, view: Vec3) -> bool {
        self.table.has_data(light, view)
    }
}
