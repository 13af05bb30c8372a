//! Tiles whose lanes belong to different materials.
//!
//! A renderer that shades many paths side by side meets another surface in every lane. Materials of one
//! hybrid library share the network, so that one pass through it serves all of them: only what comes before
//! it, the inputs and the first bias with the latent code folded in, is computed for each. Every lane gets
//! the very value that its material gives alone.

use std::sync::Arc;

use crate::brdf::{Brdf, lit};
use crate::dispatch;
use crate::kernels::network::{MAX_WIDTH, Rows};
use crate::material::{AnyModel, Material};
use crate::models::hybrid::{Hybrid, MAX_INPUTS};
use crate::simd::{LANES, Lane3, Lanes, Real, Vector};

/// Whether lanes of `a` and lanes of `b` can be in one tile.
#[must_use]
pub fn together(a: &Material, b: &Material) -> bool {
    match (a.model(), b.model()) {
        _ if std::ptr::eq(a, b) => true,
        (AnyModel::Hybrid(a), AnyModel::Hybrid(b)) => {
            Arc::ptr_eq(a.network(), b.network()) && a.form() == b.form()
        }
        _ => false,
    }
}

/// f_r in every lane, of that lane's material: [`Brdf::eval_tile`] for materials of which each is
/// [`together`] with the first. Fastest where lanes of one material are neighbours.
pub fn eval_tile(materials: &[&Material; LANES], light: &Lane3, view: &Lane3, out: &mut Lane3) {
    match materials[0].model() {
        AnyModel::Hybrid(first) if materials.iter().any(|m| !std::ptr::eq(*m, materials[0])) => {
            let hybrids = materials.map(|m| if let AnyModel::Hybrid(m) = m.model() { m } else { first });
            eval_hybrids(&hybrids, light, view, out);
        }
        _ => materials[0].eval_tile(light, view, out),
    }
}

dispatch! {
    fn eval_hybrids(isa, materials: &[&Hybrid; LANES], light: &Lane3, view: &Lane3, out: &mut Lane3) {
        match I::BATCH {
            4 => parts::<I, 4>(isa, materials, light, view, out),
            8 => parts::<I, 8>(isa, materials, light, view, out),
            _ => parts::<I, 16>(isa, materials, light, view, out),
        }
    }
}

/// A tile, `L` lanes at a time.
#[inline(always)]
fn parts<I: Lanes<L>, const L: usize>(
    isa: I,
    materials: &[&Hybrid; LANES],
    light: &Lane3,
    view: &Lane3,
    out: &mut Lane3,
) {
    for (part, materials) in materials.as_chunks::<L>().0.iter().enumerate() {
        let of_part = |side: &Lane3| [0, 1, 2].map(|c| side[c].as_chunks::<L>().0[part]);
        let f = eval_part(isa, materials, &of_part(light), &of_part(view));
        for c in 0..3 {
            out[c].as_chunks_mut::<L>().0[part] = f[c];
        }
    }
}

#[inline(always)]
fn eval_part<I: Lanes<L>, const L: usize>(
    isa: I,
    materials: &[&Hybrid; L],
    light: &[[f32; L]; 3],
    view: &[[f32; L]; 3],
) -> [[f32; L]; 3] {
    let (light, view) = (Vector::load3(isa, light), Vector::load3(isa, view));
    let mut out = [[0.0; L]; 3];
    let lit = lit(light, view);
    if !Vector::<I, L>::any(isa, lit) {
        return out;
    }
    let mut lanes = BeforeNetwork::default();
    for lane in 0..L {
        // Neighbours of one material take one pass; where it comes again later, so does the pass.
        if lane == 0 || !std::ptr::eq(materials[lane], materials[lane - 1]) {
            lanes.set::<I>(isa, materials[lane], materials, light, view);
        }
    }
    let (form, network) = (materials[0].form(), materials[0].network());
    let mut y = Rows::default();
    network.forward_tile(isa, &lanes.first_bias[..], &lanes.x, &mut y);
    let (bound, zero) = (Vector::load(isa, &lanes.bound), Vector::new(isa, 0.0));
    let is_edited = zero.lt(Vector::load(isa, &lanes.is_edited));
    let has_edits = Vector::<I, L>::any(isa, is_edited);
    // A composition of three outputs has no b.
    let second = y.len() - 3;
    for c in 0..3 {
        let [a, b] = [Vector::load(isa, &y[c]), Vector::load(isa, &y[c + second])];
        let analytic = Vector::load(isa, &lanes.analytic[c]);
        // The lanes have their bounds already.
        let mut f = form.composition.compose(bound.min(a), b, analytic, f32::INFINITY);
        if has_edits {
            let (edited, room) = (Vector::load(isa, &lanes.edited[c]), Vector::load(isa, &lanes.room));
            let whole =
                form.composition.compose_edited(bound.min(a), b, analytic, edited, room, f32::INFINITY);
            f = Real::select(is_edited, whole, f);
        }
        Real::select(lit, f, zero).store(&mut out[c]);
    }
    out
}

/// What materials of one network do not share, for each lane.
struct BeforeNetwork<const L: usize> {
    x: [[f32; L]; MAX_INPUTS],
    analytic: [[f32; L]; 3],
    first_bias: [[f32; L]; MAX_WIDTH],
    bound: [f32; L],
    /// 1 where the material is an edit, and what is then needed besides.
    is_edited: [f32; L],
    edited: [[f32; L]; 3],
    room: [f32; L],
}

impl<const L: usize> Default for BeforeNetwork<L> {
    #[inline(always)]
    fn default() -> Self {
        BeforeNetwork {
            x: [[0.0; L]; MAX_INPUTS],
            analytic: [[0.0; L]; 3],
            first_bias: [[0.0; L]; MAX_WIDTH],
            bound: [0.0; L],
            is_edited: [0.0; L],
            edited: [[0.0; L]; 3],
            room: [0.0; L],
        }
    }
}

impl<const L: usize> BeforeNetwork<L> {
    /// Sets the lanes whose material is `own`.
    #[inline(always)]
    fn set<I: Lanes<L>>(
        &mut self,
        isa: I,
        own: &Hybrid,
        materials: &[&Hybrid; L],
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) {
        let mut is_own = [0.0; L];
        for lane in 0..L {
            is_own[lane] = if std::ptr::eq(materials[lane], own) { 1.0 } else { 0.0 };
        }
        let mask = Vector::new(isa, 0.0).lt(Vector::load(isa, &is_own));
        let mut x = [[0.0; L]; MAX_INPUTS];
        let [asked_light, asked_view] = own.asked(light, view);
        let fitted = own.fitted_microfacet();
        let analytic = own.form().inputs_and_analytic(fitted, asked_light, asked_view, &mut x);
        for i in 0..own.form().features() {
            Real::select(mask, Vector::load(isa, &x[i]), Vector::load(isa, &self.x[i])).store(&mut self.x[i]);
        }
        for c in 0..3 {
            Real::select(mask, analytic[c], Vector::load(isa, &self.analytic[c]))
                .store(&mut self.analytic[c]);
        }
        for (lanes, &bias) in self.first_bias.iter_mut().zip(own.first_bias.as_flattened()) {
            Real::select(mask, Vector::new(isa, bias), Vector::load(isa, lanes)).store(lanes);
        }
        Real::select(mask, Vector::new(isa, own.bound()), Vector::load(isa, &self.bound))
            .store(&mut self.bound);
        if let Some(edit) = own.edit() {
            let edited = own.microfacet.eval(light, view);
            for c in 0..3 {
                Real::select(mask, edited[c], Vector::load(isa, &self.edited[c])).store(&mut self.edited[c]);
            }
            let room = edit.room.share(light, view);
            Real::select(mask, room, Vector::load(isa, &self.room)).store(&mut self.room);
            let yes = Vector::new(isa, 1.0);
            Real::select(mask, yes, Vector::load(isa, &self.is_edited)).store(&mut self.is_edited);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::directions::features::Inputs;
    use crate::kernels::network::{Activation, tests::patterned};
    use crate::microfacet::Microfacet;
    use crate::models::Model;
    use crate::models::ggx::Ggx;
    use crate::models::hybrid::{Composition, Form};

    fn hybrids(form: Form) -> Vec<Material> {
        let sizes = [form.features() + 4, 32, 32, 32, form.composition.outputs()];
        let network = Arc::new(patterned(&sizes, form.features(), Activation::HardGelu));
        (1..=5)
            .map(|i| {
                let t = i as f32 / 5.0;
                let microfacet =
                    Microfacet { kd: [t, 0.2, 0.1], eta: [1.5, 1.5 + t, 2.5], alpha: [0.3 * t; 2] };
                let latent = (0..4).map(|k| (k as f32 + 3.0 * t).sin()).collect();
                let material = Hybrid::new(form, network.clone(), microfacet, latent, 2.0 + t).unwrap();
                // Two of them are edits.
                let alpha = [if i % 2 == 0 { 0.5 } else { microfacet.alpha[0] }; 2];
                material.with_microfacet(Microfacet { alpha, ..microfacet }).unwrap().into()
            })
            .collect()
    }

    #[test]
    fn mixed_lanes_are_those_of_their_own_materials() {
        let direction = |i: usize, step: f32| {
            let (z, phi) = (1.05 * (i as f32 * step).fract() - 0.05, i as f32 * 2.4);
            let r = (1.0 - z * z).sqrt();
            [r * phi.cos(), r * phi.sin(), z]
        };
        let forms = [
            Form::PAPER,
            Form { inputs: Inputs::IsotropicReciprocal, analytic_input: true, ..Form::PAPER },
            Form { composition: Composition::Additive, ..Form::PAPER },
        ];
        for form in forms {
            let materials = hybrids(form);
            for tile in 0..50 {
                let mut directions = [[[0.0; LANES]; 3]; 2];
                for (d, step) in directions.iter_mut().zip([0.754_877_7, 0.569_840_3]) {
                    for lane in 0..LANES {
                        let w = direction(tile * LANES + lane, step);
                        (0..3).for_each(|c| d[c][lane] = w[c]);
                    }
                }
                let [light, view] = directions;
                let of_lane: [&Material; LANES] = std::array::from_fn(|i| &materials[(i / 2 * 7 + tile) % 5]);
                let mut mixed = [[0.0; LANES]; 3];
                eval_tile(&of_lane, &light, &view, &mut mixed);
                for (lane, material) in of_lane.iter().enumerate() {
                    let mut own = [[0.0; LANES]; 3];
                    material.eval_tile(&light, &view, &mut own);
                    for c in 0..3 {
                        assert_eq!(mixed[c][lane].to_bits(), own[c][lane].to_bits(), "{form:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn materials_are_together_where_they_share_a_network() {
        let [a, b] = [hybrids(Form::PAPER), hybrids(Form::PAPER)];
        let ggx = |kd| {
            Material::from(Ggx::new(Microfacet { kd: [kd; 3], eta: [1.5; 3], alpha: [0.3; 2] }).unwrap())
        };
        let (dark, bright) = (ggx(0.1), ggx(0.9));
        assert!(together(&a[0], &a[1]) && together(&a[2], &a[2]) && together(&dark, &dark));
        assert!(!together(&a[0], &b[0]) && !together(&a[0], &dark) && !together(&dark, &bright));
    }
}
