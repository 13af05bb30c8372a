//! `ggx`: the analytic BRDF alone, as a material.

use glam::Vec3;

use crate::brdf::{Brdf, is_lit, mask_unlit};
use crate::dispatch;
use crate::lobes::Lobes;
use crate::microfacet::Microfacet;
use crate::model::Model;
use crate::simd::{LANES, Lane3};

/// A material that is [`Microfacet`] and nothing else. Reciprocal.
#[derive(Clone, Debug, PartialEq)]
pub struct Ggx {
    microfacet: Microfacet,
    lobes: Lobes,
}

impl Ggx {
    /// A material with these parameters.
    ///
    /// # Errors
    /// See [`Microfacet::validate`].
    pub fn new(microfacet: Microfacet) -> Result<Self, String> {
        microfacet.validate()?;
        let mut ggx = Ggx { microfacet, lobes: Lobes { alpha: microfacet.alpha, specular_weight: 0.5 } };
        ggx.lobes = Lobes::fit(&ggx, &[microfacet.alpha]);
        Ok(ggx)
    }

    /// The material's parameters.
    #[must_use]
    pub fn microfacet(&self) -> &Microfacet {
        &self.microfacet
    }
}

impl Model for Ggx {
    const KIND: &'static str = "ggx";

    fn lobes(&self) -> Lobes {
        self.lobes
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

    fn with_microfacet(&self, microfacet: Microfacet) -> Result<Self, String> {
        Ggx::new(microfacet)
    }
}

impl Brdf for Ggx {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        if is_lit(light, view) { self.microfacet.eval(light.into(), view.into()).into() } else { Vec3::ZERO }
    }

    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        eval_tile(&self.microfacet, light, view, out);
        mask_unlit(light, view, out);
    }
}

dispatch! {
    fn eval_tile(_isa, microfacet: &Microfacet, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        microfacet.eval_lanes(light, view, out);
    }
}

impl Microfacet {
    /// [`Microfacet::eval`] in every lane.
    #[inline(always)]
    pub(crate) fn eval_lanes(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        for lane in 0..LANES {
            let f = self.eval(
                [light[0][lane], light[1][lane], light[2][lane]],
                [view[0][lane], view[1][lane], view[2][lane]],
            );
            for (out, f) in out.iter_mut().zip(f) {
                out[lane] = f;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
