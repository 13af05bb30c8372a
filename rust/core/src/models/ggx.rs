//! `ggx`: the analytic BRDF alone, as a material.

use crate::error::Invalid;
use crate::kernels::Kernel;
use crate::kernels::mixed::{self, MixedKernel};
use crate::microfacet::{Microfacet, Terms};
use crate::models::Model;
use crate::simd::{LANES, Lane3, Lanes, Vector};

/// A material that is [`Microfacet`] and nothing else. Reciprocal.
///
/// ```
/// use glimt_core::microfacet::Microfacet;
/// use glimt_core::models::ggx::Ggx;
/// use glimt_core::{Brdf, Material, SampleBrdf, Vec3};
///
/// let plastic = Ggx::new(Microfacet { kd: [0.2; 3], eta: [1.5; 3], alpha: [0.1; 2] }).unwrap();
/// let (light, view) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.36, 0.48, 0.8));
/// assert_eq!(plastic.eval(light, view), plastic.eval(view, light));
///
/// let material = Material::from(plastic);
/// assert!(material.pdf(light, view) > 0.0);
/// ```
#[derive(Clone, Debug)]
pub struct Ggx {
    microfacet: Microfacet,
    terms: Terms,
}

impl Ggx {
    /// A material with these parameters.
    ///
    /// # Errors
    /// See [`Microfacet::validate`].
    pub fn new(microfacet: Microfacet) -> Result<Self, Invalid> {
        microfacet.validate()?;
        Ok(Ggx { microfacet, terms: microfacet.terms() })
    }

    /// The material's parameters.
    #[must_use]
    pub fn microfacet(&self) -> &Microfacet {
        &self.microfacet
    }
}

impl Model for Ggx {
    const KIND: &'static str = "ggx";

    fn describe(&self) -> String {
        "Lambert and GGX with exact Fresnel".to_owned()
    }

    fn is_isotropic(&self) -> bool {
        self.microfacet.is_isotropic()
    }

    fn is_reciprocal(&self) -> bool {
        true
    }

    fn microfacet(&self) -> Option<&Microfacet> {
        Some(&self.microfacet)
    }

    fn with_microfacet(&self, microfacet: Microfacet) -> Result<Self, Invalid> {
        Ggx::new(microfacet)
    }

    fn shares_tiles_with(&self, _: &Self) -> bool {
        true
    }

    fn eval_mixed_tile(materials: &[&Self; LANES], light: &Lane3, view: &Lane3, out: &mut Lane3) {
        mixed::eval_tile(materials, light, view, out);
    }

    fn mix(&self, other: &Self, t: f32) -> Result<Self, Invalid> {
        Ggx::new(self.microfacet.mix(&other.microfacet, t))
    }
}

impl Kernel for Ggx {
    #[inline(always)]
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        _isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        self.terms.eval(light, view)
    }
}

impl MixedKernel for Ggx {
    #[inline(always)]
    fn eval_mixed<I: Lanes<L>, const L: usize>(
        isa: I,
        materials: &[&Self; L],
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        let mut rows = [[0.0; Terms::COUNT.next_multiple_of(4)]; L];
        for lane in 0..L {
            rows[lane][..Terms::COUNT].copy_from_slice(&materials[lane].terms.to_row());
        }
        let [terms @ .., _] = Vector::transpose(isa, &rows);
        Terms::from_row(terms).eval(light, view)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Brdf;
    use glam::Vec3;

    #[test]
    fn batch_and_single_agree_to_the_bit() {
        let ggx =
            Ggx::new(Microfacet { kd: [0.1, 0.2, 0.3], eta: [1.5, 2.0, 3.0], alpha: [0.1, 0.3] }).unwrap();
        let pairs: Vec<(Vec3, Vec3)> = (0..37)
            .map(|i| {
                let angle = i as f32 * 0.7;
                (
                    Vec3::new(angle.cos(), angle.sin(), 0.5 - 0.02 * i as f32).normalize(),
                    Vec3::new(0.6, 0.0, 0.8),
                )
            })
            .collect();
        let (light, view): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
        let mut batch = vec![Vec3::ONE; light.len()];
        ggx.eval_batch(&light, &view, &mut batch);
        for i in 0..light.len() {
            assert_eq!(batch[i], ggx.eval(light[i], view[i]));
            assert_eq!(batch[i] == Vec3::ZERO, light[i].z <= 0.0);
        }
    }
}
