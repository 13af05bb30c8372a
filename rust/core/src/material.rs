//! The closed set of models, as one type that a renderer holds.

use std::sync::Arc;

use glam::Vec3;

use crate::brdf::{Brdf, Sample, SampleBrdf};
use crate::ggx::Ggx;
use crate::hybrid::Hybrid;
use crate::lobes::Lobes;
use crate::microfacet::Microfacet;
use crate::nbrdf::Nbrdf;
use crate::network::Network;
use crate::neural::Neural;
use crate::simd::Lane3;

/// A material of any model.
#[derive(Clone, Debug)]
pub enum Material {
    /// See [`crate::ggx`].
    Ggx(Ggx),
    /// See [`crate::hybrid`].
    Hybrid(Hybrid),
    /// See [`crate::neural`].
    Neural(Neural),
    /// See [`crate::nbrdf`].
    Nbrdf(Nbrdf),
}

impl Material {
    /// The model's name as files and commands spell it.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Material::Ggx(_) => "ggx",
            Material::Hybrid(_) => "hybrid",
            Material::Neural(_) => "neural",
            Material::Nbrdf(_) => "nbrdf",
        }
    }

    /// k_d, η, α of the models that have an analytic part.
    #[must_use]
    pub fn microfacet(&self) -> Option<&Microfacet> {
        match self {
            Material::Ggx(m) => Some(m.microfacet()),
            Material::Hybrid(m) => Some(m.microfacet()),
            Material::Neural(_) | Material::Nbrdf(_) => None,
        }
    }

    /// z; empty for models that have none.
    #[must_use]
    pub fn latent(&self) -> &[f32] {
        match self {
            Material::Hybrid(m) => m.latent(),
            Material::Neural(m) => m.latent(),
            Material::Ggx(_) | Material::Nbrdf(_) => &[],
        }
    }

    /// The network of the models that have one, before anything is folded into it.
    #[must_use]
    pub fn network(&self) -> Option<&Network> {
        match self {
            Material::Ggx(_) => None,
            Material::Hybrid(m) => Some(m.network()),
            Material::Neural(m) => Some(&m.shared().network),
            Material::Nbrdf(m) => Some(m.network()),
        }
    }

    /// The sampler.
    #[must_use]
    pub fn lobes(&self) -> Lobes {
        match self {
            Material::Ggx(m) => m.lobes(),
            Material::Hybrid(m) => m.lobes(),
            Material::Neural(m) => m.lobes(),
            Material::Nbrdf(m) => m.lobes(),
        }
    }

    /// Whether f is the same in every azimuth by construction.
    #[must_use]
    pub fn is_isotropic(&self) -> bool {
        match self {
            Material::Ggx(m) => m.microfacet().is_isotropic(),
            Material::Hybrid(m) => m.form().inputs.is_isotropic() && m.microfacet().is_isotropic(),
            Material::Neural(_) => false,
            Material::Nbrdf(_) => true,
        }
    }

    /// Whether f(l, v) = f(v, l) by construction.
    #[must_use]
    pub fn is_reciprocal(&self) -> bool {
        match self {
            Material::Ggx(_) => true,
            Material::Hybrid(m) => m.form().inputs.is_reciprocal(),
            Material::Neural(_) | Material::Nbrdf(_) => false,
        }
    }

    /// The same material with other k_d, η and α, and a sampler for them.
    ///
    /// # Errors
    /// In words, a parameter out of range, or that the model has no analytic part.
    pub fn with_microfacet(&self, microfacet: Microfacet) -> Result<Material, String> {
        match self {
            Material::Ggx(_) => Ggx::new(microfacet).map(Material::Ggx),
            Material::Hybrid(m) => {
                Hybrid::new(m.form(), m.network().clone(), microfacet, m.latent().to_vec(), m.bound())
                    .map(Material::Hybrid)
            }
            Material::Neural(_) | Material::Nbrdf(_) => {
                Err(format!("a {} material has no kd, eta or alpha to edit", self.kind()))
            }
        }
    }

    /// The same material with another latent code, and a sampler for it.
    ///
    /// # Errors
    /// In words, a code of another length or not finite, or that the model has none.
    pub fn with_latent(&self, latent: Vec<f32>) -> Result<Material, String> {
        match self {
            Material::Hybrid(m) => {
                Hybrid::new(m.form(), m.network().clone(), *m.microfacet(), latent, m.bound())
                    .map(Material::Hybrid)
            }
            Material::Neural(m) => {
                Neural::new(Arc::clone(m.shared()), latent, m.bound()).map(Material::Neural)
            }
            Material::Ggx(_) | Material::Nbrdf(_) => {
                Err(format!("a {} material has no latent code", self.kind()))
            }
        }
    }
}

impl Brdf for Material {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        match self {
            Material::Ggx(m) => m.eval(light, view),
            Material::Hybrid(m) => m.eval(light, view),
            Material::Neural(m) => m.eval(light, view),
            Material::Nbrdf(m) => m.eval(light, view),
        }
    }

    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        match self {
            Material::Ggx(m) => m.eval_tile(light, view, out),
            Material::Hybrid(m) => m.eval_tile(light, view, out),
            Material::Neural(m) => m.eval_tile(light, view, out),
            Material::Nbrdf(m) => m.eval_tile(light, view, out),
        }
    }
}

impl SampleBrdf for Material {
    fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        self.lobes().pdf(light, view)
    }

    fn sample(&self, view: Vec3, u: Vec3) -> Sample {
        self.lobes().sample(self, view, u)
    }
}
