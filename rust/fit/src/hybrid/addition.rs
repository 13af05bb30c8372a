//! New materials for a finished library: the network stays, z, k_d, η and α are fitted (the paper,
//! §4.2, "sparse training").

use glimt_core::directions::features::Inputs;
use glimt_core::library::{Entry, Library};
use glimt_core::models::hybrid::Hybrid;
use glimt_core::{AnyModel, Invalid, Material};
use serde::Deserialize;

use super::{HybridObjective, HybridOptions, Recipe, Sharing};
use crate::backprop::Shape;
use crate::error::Error;
use crate::fittable::Fittable;
use crate::input::Input;
use crate::judge::{Judge, best_of};
use crate::net::Net;
use crate::objective::Objective;
use crate::pairs::Drawing;
use crate::train::{Schedule, Watch};
use crate::truth::Truth;

/// Most codes of the library from which the code of a new material starts.
const ADD_STARTS: usize = 4;

/// A library whose network is shared, and what its materials were fitted with.
pub(crate) struct Addition<'a> {
    library: &'a Library,
    first: &'a Hybrid,
    recipe: Recipe,
}

impl<'a> Addition<'a> {
    /// To `library`.
    ///
    /// # Errors
    /// [`Error::Options`] if it is not a hybrid one with a shared network; [`Error::Library`].
    pub(crate) fn new(library: &'a Library) -> Result<Addition<'a>, Error> {
        let entry = library.first()?;
        match entry.material.model() {
            AnyModel::Hybrid(first) if !first.latent().is_empty() && library.shares_network()? => {
                Ok(Addition { library, first, recipe: recipe(library, entry, first)? })
            }
            _ => Err(no_addition(library)),
        }
    }

    /// How many numbers are fitted for each material.
    pub(crate) fn own_len(&self, isotropic: bool) -> usize {
        self.objective_of(isotropic).own_len()
    }

    fn objective_of(&self, isotropic: bool) -> HybridObjective {
        let (form, network) = (self.first.form(), self.first.network());
        let layers = network.layers();
        let hidden: Vec<usize> = layers[..layers.len() - 1].iter().map(|layer| layer.outputs()).collect();
        HybridObjective {
            sharing: Sharing::Library,
            form,
            shape: Shape::new(layers[0].inputs(), &hidden, form.composition.outputs(), network.activation()),
            latent: self.first.latent().len(),
            isotropic,
            loss: self.recipe.loss,
            analytic_loss: self.recipe.analytic_loss,
            joint: self.recipe.joint,
        }
    }
}

/// It is over when it has started: the shared numbers stay, and each material takes the best of several starts.
impl Fittable for Addition<'_> {
    type Objective = HybridObjective;

    fn check(&self, inputs: &[Input]) -> Result<(), String> {
        let path = self.library.path().display();
        let is_isotropic = self.first.form().inputs.is_isotropic();
        if let Some(Input { name, .. }) = inputs.iter().find(|input| !input.isotropic && is_isotropic) {
            return Err(format!(
                "\"{name}\" is anisotropic, but the network of {path} is isotropic by construction"
            ));
        }
        let taken = self.library.names();
        if let Some(Input { name, .. }) = inputs.iter().find(|input| taken.contains(&input.name)) {
            return Err(format!("{path} already has a material \"{name}\""));
        }
        Ok(())
    }

    fn objective(&self, isotropic: bool) -> Result<HybridObjective, String> {
        Ok(self.objective_of(isotropic))
    }

    fn start(
        &self,
        objective: &HybridObjective,
        truths: &[Truth],
        schedule: &Schedule,
        watch: &mut Watch,
    ) -> Result<Option<Vec<f32>>, Error> {
        let shared = Shape::from_layers(self.first.network().layers());
        let Some(p) = objective.fit_analytic(truths, schedule, watch)? else { return Ok(None) };
        let judge = Judge::new(Drawing::Lobes, schedule.seed, 4);
        let entries = self.library.entries()?;
        let candidates = p
            .iter()
            .zip(truths)
            .map(|(p, &truth)| nearest_codes(objective, &shared, p, &entries, truth, &judge));
        let own = best_of(objective, &shared, truths, candidates.collect(), schedule, watch)?;
        Ok(own.map(|own| [shared, own.concat()].concat()))
    }

    fn steps(&self, _: &Schedule) -> u64 {
        0
    }

    fn finish(
        &self,
        objective: &HybridObjective,
        numbers: &[f32],
        truths: &[Truth],
        judge: &Judge,
    ) -> Result<Vec<Material>, Invalid> {
        let (shared, own) = numbers.split_at(objective.shared_len());
        let materials = own.chunks_exact(objective.own_len()).zip(truths);
        // The library's own network, not an equal one: the file then stores it once.
        let material = |(own, &truth): (&[f32], &Truth)| {
            objective.material(self.first.network().clone(), shared, own, truth, judge)
        };
        materials.map(material).collect()
    }

    fn recipe_json(&self) -> Option<serde_json::Value> {
        Some(self.recipe.to_json())
    }
}

/// Starts for a new material: its analytic fit with the codes of the library that suit it best.
fn nearest_codes(
    objective: &HybridObjective,
    shared: &[f32],
    p: &[f32],
    entries: &[&Entry],
    truth: Truth,
    judge: &Judge,
) -> Vec<Vec<f32>> {
    let start = |entry: &&Entry| {
        let own = [p, entry.material.latent()].concat();
        (judge.loss(objective, shared, &own, truth), own)
    };
    let mut starts: Vec<(f64, Vec<f32>)> = entries.iter().map(start).collect();
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    starts.into_iter().take(ADD_STARTS).map(|(_, own)| own).collect()
}

fn no_addition(library: &Library) -> Error {
    Error::Options(format!(
        "{} holds {} materials without a shared network and latent codes, so none can be added; fit them anew",
        library.path().display(),
        library.kind()
    ))
}

/// What the library was fitted with; for one that does not say, the paper's recipe if it has the paper's
/// inputs, and else glimt's own.
fn recipe(library: &Library, entry: &Entry, first: &Hybrid) -> Result<Recipe, Error> {
    if let Some(recipe) = &entry.origin.recipe {
        return Recipe::deserialize(recipe).map_err(|e| {
            let path = library.path().display();
            Error::Options(format!("the recipe in {path} is of another version of glimt: {e}"))
        });
    }
    let (net, latent) = (Net { width: 0, layers: 0 }, 0);
    let options = match first.form().inputs {
        Inputs::Cartesian => HybridOptions::paper(net, latent),
        _ => HybridOptions::shared(net, latent),
    };
    Ok(options.recipe())
}
