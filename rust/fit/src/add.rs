//! New materials for a finished library: the network stays, z, k_d, η and α are fitted (the paper,
//! §4.2, "sparse training").

use glimt_core::directions::features::Inputs;
use glimt_core::library::{Entry, Library, Origin};
use glimt_core::models::hybrid::Hybrid;
use glimt_core::{AnyModel, Material};
use serde::Deserialize;

use crate::analytic;
use crate::backprop::Shape;
use crate::error::Error;
use crate::fit::{
    Input, Judge, Watch, best_of, check_materials, fit_analytic, hybrid_materials, to_json, total_loss,
};
use crate::hybrid::{HybridObjective, Sharing};
use crate::options::{HybridOptions, Net, Recipe};
use crate::pairs::Drawing;
use crate::train::Schedule;
use crate::truth::Truth;

/// Steps of [`add`] when the caller has no other wish.
pub const ADD_STEPS: u64 = 1500;

/// Most codes of the library from which the code of a new material starts.
const ADD_STARTS: usize = 4;

/// The entries for new materials of a hybrid library whose network stays as it is: only z, k_d, η
/// and α are fitted. `None` if it was stopped.
///
/// # Errors
/// [`Error::Options`] if the library is not a hybrid one with a shared network, or if a material is
/// anisotropic and the library is not; [`Error::Material`], [`Error::Diverged`].
pub fn add(
    library: &Library,
    inputs: &[Input],
    steps: u64,
    seed: u64,
    watch: &mut Watch,
) -> Result<Option<Vec<Entry>>, Error> {
    let first = match library.entries()[0].material.model() {
        AnyModel::Hybrid(material) if !material.latent().is_empty() && library.shares_network() => material,
        _ => {
            let kind = library.kind();
            let reason = format!(
                "{} holds {kind} materials without a shared network and latent codes, so none can be added; fit them anew",
                library.path().display()
            );
            return Err(Error::Options(reason));
        }
    };
    let form = first.form();
    if let Some(input) = inputs.iter().find(|input| !input.isotropic && form.inputs.is_isotropic()) {
        let reason = format!(
            "\"{}\" is anisotropic, but the network of {} is isotropic by construction",
            input.name,
            library.path().display()
        );
        return Err(Error::Options(reason));
    }
    if let Some(input) = inputs.iter().find(|input| library.entry(Some(&input.name)).is_ok()) {
        let reason = format!("{} already has a material \"{}\"", library.path().display(), input.name);
        return Err(Error::Options(reason));
    }
    let recipe = recipe(library, form.inputs)?;
    let isotropic = inputs.iter().all(|input| input.isotropic);
    let layers = first.network().layers();
    let hidden: Vec<usize> = layers[..layers.len() - 1].iter().map(|layer| layer.outputs()).collect();
    let objective = HybridObjective {
        sharing: Sharing::Library,
        form,
        shape: Shape::new(
            layers[0].inputs(),
            &hidden,
            form.composition.outputs(),
            first.network().activation(),
        ),
        latent: first.latent().len(),
        isotropic,
        loss: recipe.loss,
        analytic_loss: recipe.analytic_loss,
        joint: recipe.joint,
    };
    let schedule = Schedule { rate: 0.02, freeze_shared: true, ..Schedule::standard(steps, seed) };
    let truths: Vec<Truth> = inputs.iter().map(|input| input.truth).collect();
    check_materials(inputs)?;
    let shared = Shape::from_layers(layers);
    let loss = objective.analytic_loss.unwrap_or(objective.loss);
    let Some(p) = fit_analytic(&truths, loss, isotropic, &schedule, watch)? else { return Ok(None) };
    let judge = Judge::new(Drawing::Lobes, seed, 4);
    let candidates = p
        .iter()
        .zip(&truths)
        .map(|(p, &truth)| nearest_codes(&objective, &shared, p, library, truth, &judge));
    let Some(own) = best_of(&objective, &shared, &truths, candidates.collect(), &schedule, watch)? else {
        return Ok(None);
    };
    let numbers = [shared, own.concat()].concat();
    let materials = hybrid_materials(&objective, &truths, &numbers, &schedule);
    let materials = materials.map_err(|_| Error::Diverged { step: steps })?;
    let entry = |(input, material): (&Input, Material)| {
        // The library's own network, not an equal one: the file then stores it once.
        let AnyModel::Hybrid(made) = material.model() else { unreachable!("hybrid_materials makes hybrids") };
        let material = Hybrid::new(
            form,
            first.network().clone(),
            *made.microfacet(),
            made.latent().to_vec(),
            made.bound(),
        )
        .expect("the same network and numbers made a material before");
        let recipe = Some(to_json(&recipe));
        let origin = Origin { seed: Some(seed), steps: Some(steps), recipe, ..input.origin.clone() };
        Entry { name: input.name.clone(), material: material.into(), origin }
    };
    Ok(Some(inputs.iter().zip(materials).map(entry).collect()))
}

/// How many numbers [`add`] fits for each of `inputs`.
#[must_use]
pub fn numbers_each(library: &Library, inputs: &[Input]) -> usize {
    let isotropic = inputs.iter().all(|input| input.isotropic);
    analytic::len(isotropic) + library.entries()[0].material.latent().len()
}

/// What the library was fitted with; for one that does not say, the paper's recipe if it has the paper's
/// inputs, and else glimt's own.
fn recipe(library: &Library, inputs: Inputs) -> Result<Recipe, Error> {
    if let Some(recipe) = &library.entries()[0].origin.recipe {
        return Recipe::deserialize(recipe).map_err(|e| {
            let path = library.path().display();
            Error::Options(format!("the recipe in {path} is of another version of glimt: {e}"))
        });
    }
    let (net, latent) = (Net { width: 0, layers: 0 }, 0);
    let options = match inputs {
        Inputs::Cartesian => HybridOptions::paper(net, latent),
        _ => HybridOptions::shared(net, latent),
    };
    Ok(options.recipe())
}

/// Starts for a new material: its analytic fit with the codes of the library that suit it best.
fn nearest_codes(
    objective: &HybridObjective,
    shared: &[f32],
    p: &[f32],
    library: &Library,
    truth: Truth,
    judge: &Judge,
) -> Vec<Vec<f32>> {
    let mut starts: Vec<(f64, Vec<f32>)> = library
        .entries()
        .iter()
        .map(|entry| {
            let own = [p, entry.material.latent()].concat();
            (total_loss(objective, shared, &own, truth, judge), own)
        })
        .collect();
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    starts.into_iter().take(ADD_STARTS).map(|(_, own)| own).collect()
}
