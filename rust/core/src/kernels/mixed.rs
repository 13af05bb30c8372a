//! Tiles whose lanes belong to different materials.
//!
//! A renderer that shades many paths side by side meets another surface in every lane. Where materials of a model
//! differ in numbers alone, which can lie in the lanes as directions do, one pass serves all of them. Every lane gets
//! the very value that its material gives alone.

use super::{Kernel, lit_or_zero};
use crate::brdf::lit;
use crate::dispatch;
use crate::simd::{LANES, Lane3, Lanes, Vector};

/// A model of which a tile can have another material in each lane.
pub trait MixedKernel: Kernel {
    /// [`Kernel::eval_lanes`] of a material a lane; the first can share a tile with each of them, as the model says.
    fn eval_mixed<I: Lanes<L>, const L: usize>(
        isa: I,
        materials: &[&Self; L],
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3];
}

dispatch! {
    /// f_r in every lane, of that lane's material.
    pub fn eval_tile[K: MixedKernel](
        isa,
        materials: &[&K; LANES],
        light: &Lane3,
        view: &Lane3,
        out: &mut Lane3,
    ) {
        match I::BATCH {
            4 => parts::<K, I, 4>(isa, materials, light, view, out),
            8 => parts::<K, I, 8>(isa, materials, light, view, out),
            _ => parts::<K, I, 16>(isa, materials, light, view, out),
        }
    }
}

/// A tile, `L` lanes at a time.
#[inline(always)]
fn parts<K: MixedKernel, I: Lanes<L>, const L: usize>(
    isa: I,
    materials: &[&K; LANES],
    light: &Lane3,
    view: &Lane3,
    out: &mut Lane3,
) {
    for (part, materials) in materials.as_chunks::<L>().0.iter().enumerate() {
        let of_part = |side: &Lane3| [0, 1, 2].map(|c| side[c].as_chunks::<L>().0[part]);
        let (light, view) = (Vector::load3(isa, &of_part(light)), Vector::load3(isa, &of_part(view)));
        let is_lit = lit(light, view);
        let mut f = [Vector::new(isa, 0.0); 3];
        if Vector::<I, L>::any(isa, is_lit) {
            f = lit_or_zero(is_lit, K::eval_mixed(isa, materials, light, view));
        }
        for c in 0..3 {
            f[c].store(&mut out[c].as_chunks_mut::<L>().0[part]);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::directions::features::Inputs;
    use crate::kernels::network::{Activation, tests::patterned};
    use crate::microfacet::Microfacet;
    use crate::models::Model;
    use crate::models::ggx::Ggx;
    use crate::models::hybrid::{Composition, Form, Hybrid};
    use crate::{Brdf, Material};

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
                Material::eval_mixed_tile(&of_lane, &light, &view, &mut mixed);
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
    fn hybrids_share_tiles_where_they_share_a_network() {
        let [a, b] = [hybrids(Form::PAPER), hybrids(Form::PAPER)];
        let ggx = |kd| {
            Material::from(Ggx::new(Microfacet { kd: [kd; 3], eta: [1.5; 3], alpha: [0.3; 2] }).unwrap())
        };
        let (dark, bright) = (ggx(0.1), ggx(0.9));
        assert!(
            a[0].shares_tiles_with(&a[1]) && a[2].shares_tiles_with(&a[2]) && dark.shares_tiles_with(&bright)
        );
        assert!(!a[0].shares_tiles_with(&b[0]) && !a[0].shares_tiles_with(&dark));
    }
}
