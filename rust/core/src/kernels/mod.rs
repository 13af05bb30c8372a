//! From a model's formulas for pairs side by side to every way in which pairs come: one, a packet of the
//! caller's width, a tile, a batch of any length.

pub mod mixed;
pub mod network;
pub mod placed;

use glam::Vec3;

use crate::brdf::{Brdf, check_lengths, is_lit, lit};
use crate::dispatch;
use crate::simd::{Isa, Lane3, Lanes, Real, Vector};

/// Largest difference of a pair that comes alone from the same pair in a packet or batch, relative to f's
/// largest channel: 16 ULP. One pair's sums are added in another order, which takes half the time. In packets and
/// batches of any width, length and alignment, a pair has the same bits.
pub const ONE_MAX_RELATIVE_DIFFERENCE: f32 = 16.0 * f32::EPSILON;

/// A model as kernels evaluate it. Whatever implements this is a [`Brdf`].
pub trait Kernel: Send + Sync {
    /// f of pairs above the horizon side by side. What other pairs get is not looked at.
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3];

    /// f of one pair above the horizon, as fast as one can be.
    #[inline(always)]
    fn eval_one<I: Isa>(&self, isa: I, light: Vec3, view: Vec3) -> Vec3 {
        let f = self.eval_lanes::<I, 4>(isa, splat3(isa, light), splat3(isa, view));
        Vec3::new(f[0].first(), f[1].first(), f[2].first())
    }

    /// See [`Brdf::has_data`].
    fn has_data(&self, _light: Vec3, _view: Vec3) -> bool {
        true
    }
}

/// One vector in every lane.
#[inline(always)]
pub(crate) fn splat3<I: Lanes<L>, const L: usize>(isa: I, v: Vec3) -> [Vector<I, L>; 3] {
    [Vector::new(isa, v.x), Vector::new(isa, v.y), Vector::new(isa, v.z)]
}

impl<K: Kernel> Brdf for K {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        let mut f = Vec3::ZERO;
        if is_lit(light, view) {
            one(self, light, view, &mut f);
        }
        f
    }

    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        packet(
            self,
            light.each_ref().map(|x| &x[..]),
            view.each_ref().map(|x| &x[..]),
            out.each_mut().map(|x| &mut x[..]),
        );
    }

    fn eval_packet(&self, light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        check_lengths(&light, &view, &out);
        packet(self, light, view, out);
    }

    fn eval_batch(&self, light: &[Vec3], view: &[Vec3], out: &mut [Vec3]) {
        assert!(light.len() == out.len() && view.len() == out.len(), "as many lights as views and results");
        batch(self, light, view, out);
    }

    fn has_data(&self, light: Vec3, view: Vec3) -> bool {
        Kernel::has_data(self, light, view)
    }
}

dispatch! {
    fn one[K: Kernel](isa, model: &K, light: Vec3, view: Vec3, f: &mut Vec3) {
        *f = model.eval_one(isa, light, view);
    }
}

dispatch! {
    fn packet[K: Kernel](isa, model: &K, light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        // Nested, so that lanes which an instruction set does not use are not compiled for it.
        match I::BATCH {
            4 => packets::<K, I, 4>(isa, model, light, view, out),
            8 => match out[0].len() {
                0..=4 => packets::<K, I, 4>(isa, model, light, view, out),
                _ => packets::<K, I, 8>(isa, model, light, view, out),
            },
            _ => match out[0].len() {
                0..=8 => packets::<K, I, 8>(isa, model, light, view, out),
                _ => packets::<K, I, 16>(isa, model, light, view, out),
            },
        }
    }
}

dispatch! {
    fn batch[K: Kernel](isa, model: &K, light: &[Vec3], view: &[Vec3], out: &mut [Vec3]) {
        match I::BATCH {
            4 => batches::<K, I, 4>(isa, model, light, view, out),
            8 => batches::<K, I, 8>(isa, model, light, view, out),
            16 => batches::<K, I, 16>(isa, model, light, view, out),
            _ => batches::<K, I, 32>(isa, model, light, view, out),
        }
    }
}

/// f of pairs side by side; 0 where a pair is not lit, and at no cost where none is.
#[inline(always)]
fn eval_lit<K: Kernel, I: Lanes<L>, const L: usize>(
    isa: I,
    model: &K,
    light: [Vector<I, L>; 3],
    view: [Vector<I, L>; 3],
) -> [Vector<I, L>; 3] {
    let zero = Vector::new(isa, 0.0);
    let lit = lit(light, view);
    if !Vector::any(isa, lit) {
        return [zero; 3];
    }
    lit_or_zero(lit, model.eval_lanes(isa, light, view))
}

/// f where the mask holds, 0 elsewhere.
#[inline(always)]
fn lit_or_zero<F: Real>(lit: F::Mask, f: [F; 3]) -> [F; 3] {
    let zero = f[0].splat(0.0);
    [Real::select(lit, f[0], zero), Real::select(lit, f[1], zero), Real::select(lit, f[2], zero)]
}

/// `L` pairs at a time; those beyond the end are zeros, which are not lit.
#[inline(always)]
fn packets<K: Kernel, I: Lanes<L>, const L: usize>(
    isa: I,
    model: &K,
    light: [&[f32]; 3],
    view: [&[f32]; 3],
    out: [&mut [f32]; 3],
) {
    let n = out[0].len();
    let mut start = 0;
    while start < n {
        let end = n.min(start + L);
        let mut sides = [[[0.0; L]; 3]; 2];
        for c in 0..3 {
            sides[0][c][..end - start].copy_from_slice(&light[c][start..end]);
            sides[1][c][..end - start].copy_from_slice(&view[c][start..end]);
        }
        let f = eval_lit(isa, model, Vector::load3(isa, &sides[0]), Vector::load3(isa, &sides[1]));
        for c in 0..3 {
            out[c][start..end].copy_from_slice(&f[c].to_array()[..end - start]);
        }
        start = end;
    }
}

/// `L` pairs at a time, from and to vectors of three.
#[inline(always)]
fn batches<K: Kernel, I: Lanes<L>, const L: usize>(
    isa: I,
    model: &K,
    light: &[Vec3],
    view: &[Vec3],
    out: &mut [Vec3],
) {
    let (lights, last_light) = bytemuck::cast_slice::<Vec3, [f32; 3]>(light).as_chunks::<L>();
    let (views, last_view) = bytemuck::cast_slice::<Vec3, [f32; 3]>(view).as_chunks::<L>();
    let (outs, last_out) = bytemuck::cast_slice_mut::<Vec3, [f32; 3]>(out).as_chunks_mut::<L>();
    for ((light, view), out) in lights.iter().zip(views).zip(outs) {
        triples(isa, model, light, view, out);
    }
    if !last_out.is_empty() {
        // Lanes beyond the end stay 0, which is not lit.
        let mut padded = [[[0.0; 3]; L]; 3];
        let [light, view, out] = &mut padded;
        light[..last_light.len()].copy_from_slice(last_light);
        view[..last_view.len()].copy_from_slice(last_view);
        triples(isa, model, light, view, out);
        last_out.copy_from_slice(&out[..last_out.len()]);
    }
}

#[inline(always)]
fn triples<K: Kernel, I: Lanes<L>, const L: usize>(
    isa: I,
    model: &K,
    light: &[[f32; 3]; L],
    view: &[[f32; 3]; L],
    out: &mut [[f32; 3]; L],
) {
    let f = eval_lit(isa, model, Vector::load_triples(isa, light), Vector::load_triples(isa, view));
    let [red, green, blue] = [f[0].to_array(), f[1].to_array(), f[2].to_array()];
    for (lane, out) in out.iter_mut().enumerate() {
        *out = [red[lane], green[lane], blue[lane]];
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use glam::DVec3;

    /// Compares a material with its float64 `reference` at pairs of every elevation, alone and in a batch; `allowed`
    /// is the largest difference from a value. Returns f of the pairs.
    pub fn assert_is_the_reference(
        material: &impl Brdf,
        reference: impl Fn(DVec3, DVec3) -> [f64; 3],
        allowed: impl Fn(f64) -> f64,
    ) -> Vec<Vec3> {
        let direction = |i: usize| {
            let (z, phi) = (0.05 + 0.95 * (i as f32 * 0.754_877_7).fract(), i as f32 * 2.399);
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z)
        };
        let light: Vec<_> = (0..150).map(direction).collect();
        let view: Vec<_> = (0..150).map(|i| direction(i * 7 + 3)).collect();
        let mut batch = vec![Vec3::ZERO; light.len()];
        material.eval_batch(&light, &view, &mut batch);
        for i in 0..light.len() {
            let difference = (batch[i] - material.eval(light[i], view[i])).abs().max_element();
            assert!(difference <= ONE_MAX_RELATIVE_DIFFERENCE * batch[i].max_element() + 1e-6);
            let truth = reference(light[i].as_dvec3(), view[i].as_dvec3());
            for (f, truth) in batch[i].to_array().into_iter().zip(truth) {
                assert!((f64::from(f) - truth).abs() < allowed(truth), "{f} against {truth}");
            }
        }
        batch
    }
}
