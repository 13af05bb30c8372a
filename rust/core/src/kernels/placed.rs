//! Packets whose lanes lie at different places of a surface.

use super::lit_or_zero;
use crate::brdf::lit;
use crate::dispatch;
use crate::simd::{Lanes, Vector};
use crate::surface::Place;

/// A surface, evaluated at a place a lane.
pub trait PlacedKernel: Send + Sync {
    /// f of pairs above the horizon side by side. What other pairs get is not looked at.
    fn eval_placed<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        places: &[Place; L],
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3];
}

dispatch! {
    /// f_r of every pair at its place; the slices have one length.
    pub fn eval_packet[K: PlacedKernel](
        isa,
        surface: &K,
        places: &[Place],
        light: [&[f32]; 3],
        view: [&[f32]; 3],
        out: [&mut [f32]; 3],
    ) {
        match I::BATCH {
            4 => parts::<K, I, 4>(isa, surface, places, light, view, out),
            _ => parts::<K, I, 8>(isa, surface, places, light, view, out),
        }
    }
}

/// `L` pairs at a time; those beyond the end are zeros, which are not lit.
#[inline(always)]
fn parts<K: PlacedKernel, I: Lanes<L>, const L: usize>(
    isa: I,
    surface: &K,
    places: &[Place],
    light: [&[f32]; 3],
    view: [&[f32]; 3],
    out: [&mut [f32]; 3],
) {
    let n = places.len();
    let mut start = 0;
    while start < n {
        let end = n.min(start + L);
        let count = end - start;
        let mut sides = [[[0.0; L]; 3]; 2];
        for c in 0..3 {
            sides[0][c][..count].copy_from_slice(&light[c][start..end]);
            sides[1][c][..count].copy_from_slice(&view[c][start..end]);
        }
        let mut there = [Place::far(); L];
        there[..count].copy_from_slice(&places[start..end]);
        let (light, view) = (Vector::load3(isa, &sides[0]), Vector::load3(isa, &sides[1]));
        let is_lit = lit(light, view);
        let mut f = [Vector::new(isa, 0.0); 3];
        if Vector::<I, L>::any(isa, is_lit) {
            f = lit_or_zero(is_lit, surface.eval_placed(isa, &there, light, view));
        }
        for c in 0..3 {
            out[c][start..end].copy_from_slice(&f[c].to_array()[..count]);
        }
        start = end;
    }
}
