//! What is fitted, and how: the one list of models.

use serde::{Deserialize, Serialize};

use crate::fittable::AnyFittable;
use crate::ggx::GgxOptions;
use crate::hybrid::HybridOptions;
use crate::neural::NeuralOptions;
use crate::spherical::SphericalOptions;
use crate::train::Schedule;

pub use crate::loss::{DEFAULT_ANALYTIC_LOSS, DEFAULT_LOSS};
pub use crate::spherical::SPHERICAL_LOSS;

/// A fit, in full: the same options on the same materials give the same library.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// What is fitted.
    pub model: Model,
    /// How long and how fast.
    pub schedule: Schedule,
}

/// Makes [`Model`] from the list of models and their options, each of which is a
/// [`Fittable`](crate::fittable::Fittable).
macro_rules! models {
    ($($(#[$doc:meta])* $model:ident($options:ty),)+) => {
        /// What is fitted.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub enum Model {$(
            $(#[$doc])*
            $model($options),
        )+}

        impl Model {
            pub(crate) fn fittable(&self) -> &dyn AnyFittable {
                match self {$(Model::$model(options) => options,)+}
            }
        }
    };
}

models! {
    /// The analytic BRDF alone.
    Ggx(GgxOptions),
    /// The hybrid model.
    Hybrid(HybridOptions),
    /// The network-only baseline.
    Neural(NeuralOptions),
    /// Features in tables on hemispheres, and a network.
    Spherical(SphericalOptions),
}

impl Options {
    /// How many numbers each of so many materials has, its part of those that they share included; `None` for
    /// models that take as many as the samples allow.
    #[must_use]
    pub fn numbers_each(&self, materials: usize, isotropic: bool) -> Option<usize> {
        self.model.fittable().count_numbers(materials, isotropic)
    }
}
