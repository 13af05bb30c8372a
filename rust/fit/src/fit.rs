//! From materials to a model library.

use std::borrow::Cow;
use std::ops::ControlFlow;
use std::sync::Arc;

use glimt_core::Material;
use glimt_core::kernels::network::Network;
use glimt_core::library::{Entry, Origin};
use glimt_core::microfacet::Microfacet;
use glimt_core::models::ggx::Ggx;
use glimt_core::models::hybrid::{Composition, Hybrid};
use glimt_core::models::neural::{Neural, Shared};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::analytic;
use crate::checkpoint::Checkpoint;
use crate::error::Error;
use crate::ggx::GgxObjective;
use crate::hybrid::{HybridObjective, Sharing};
use crate::loss::Loss;
use crate::neural::NeuralObjective;
use crate::objective::Objective;
use crate::options::{Model, Options, Recipe};
use crate::pairs::{self, Drawing, PairBlock, TargetBlock};
use crate::spherical::stages::{SphericalEnd, fit_spherical};
use crate::train::{End, MAX_BLOCKS, Progress, Schedule, State, train};
use crate::truth::Truth;

/// A material to fit to.
pub struct Input<'a> {
    /// Its name in the library.
    pub name: String,
    /// Its reflectance: a function, or scattered samples of one.
    pub truth: Truth<'a>,
    /// Whether it is the same in every azimuth.
    pub isotropic: bool,
    /// Where it came from.
    pub origin: Origin,
}

/// How a fit ended.
pub enum Outcome {
    /// Every step is done.
    Done(Vec<Entry>),
    /// It was stopped, and can go on from here; `None` if there is nothing yet to go on from.
    Stopped(Option<Checkpoint>),
}

/// Looks at a fit as it goes and may stop it. The state is what a [`Checkpoint`] keeps; there is none in
/// the fit of the analytic part that comes before.
pub type Watch<'a> = dyn FnMut(&Progress, Option<&State>) -> ControlFlow<()> + 'a;

/// Fits one library to all `inputs`; goes on from `resume` if it is given.
///
/// # Errors
/// [`Error::Options`] for options that make no sense or a checkpoint of another fit,
/// [`Error::Material`], [`Error::Diverged`].
pub fn fit(
    inputs: &[Input],
    options: &Options,
    resume: Option<Checkpoint>,
    watch: &mut Watch,
) -> Result<Outcome, Error> {
    check(inputs, options)?;
    let truths: Vec<Truth> = inputs.iter().map(|input| input.truth).collect();
    let isotropic = inputs.iter().all(|input| input.isotropic);
    let materials = identities(inputs);
    if let Some(checkpoint) = &resume {
        if checkpoint.options != *options {
            return Err(Error::Options(
                "the checkpoint was made with other options; use the same ones".into(),
            ));
        }
        if checkpoint.materials != materials {
            return Err(Error::Options(
                "the checkpoint was made with other materials; use the same files".into(),
            ));
        }
    }
    let resumed = resume.map(|checkpoint| checkpoint.state);
    let fits = |len: usize| match &resumed {
        Some(state) if state.numbers.len() != len || state.moments.first.len() != len => {
            let found = state.numbers.len();
            Err(Error::Options(format!("the checkpoint holds {found} numbers, expected {len}; fit anew")))
        }
        _ => Ok(()),
    };
    let stopped = |state: Option<State>| {
        Ok(Outcome::Stopped(state.map(|state| Checkpoint::new(inputs, options, state))))
    };
    let schedule = &options.schedule;
    let made = match &options.model {
        Model::Ggx(loss) => {
            let Some(p) = fit_analytic(&truths, *loss, isotropic, schedule, watch)? else {
                return stopped(None);
            };
            p.iter().map(|p| Ggx::new(analytic::to_parameters(p)).map(Material::from)).collect()
        }
        Model::Hybrid(hybrid) => {
            let objective = hybrid.objective(isotropic);
            fits(objective.shared_len() + inputs.len() * objective.own_len())?;
            let mut state = match resumed {
                Some(state) => state,
                None => {
                    let loss = hybrid.analytic_loss.unwrap_or(hybrid.loss);
                    let Some(p) = fit_analytic(&truths, loss, isotropic, schedule, watch)? else {
                        return stopped(None);
                    };
                    State::new(start(&objective, &p, schedule.seed))
                }
            };
            let mut whole = |progress: &Progress, state: &State| watch(progress, Some(state));
            if !run(&objective, &truths, schedule, &mut state, &mut whole)? {
                return stopped(Some(state));
            }
            hybrid_materials(&objective, &truths, &state.numbers, schedule)
        }
        Model::Neural(neural) => {
            let objective = neural.objective();
            fits(objective.shared_len() + inputs.len() * objective.own_len())?;
            let initial = || State::new(objective.initial(schedule.seed, inputs.len()));
            let mut state = resumed.unwrap_or_else(initial);
            let mut whole = |progress: &Progress, state: &State| watch(progress, Some(state));
            if !run(&objective, &truths, schedule, &mut state, &mut whole)? {
                return stopped(Some(state));
            }
            neural_materials(&objective, &truths, &state.numbers, schedule)
        }
        Model::Spherical(spherical) => match fit_spherical(spherical, &truths, schedule, resumed, watch)? {
            SphericalEnd::Stopped(state) => return stopped(Some(state)),
            SphericalEnd::Done(made) => Ok(made.into_iter().map(Material::from).collect()),
        },
    };
    let materials: Vec<Material> = made.map_err(|_| Error::Diverged { step: schedule.steps })?;
    let recipe = match &options.model {
        Model::Hybrid(hybrid) => Some(to_json(&hybrid.recipe())),
        Model::Ggx(_) | Model::Neural(_) | Model::Spherical(_) => None,
    };
    let entries = inputs.iter().zip(materials).map(|(input, material)| {
        let origin = Origin {
            seed: Some(schedule.seed),
            steps: Some(schedule.steps),
            recipe: recipe.clone(),
            ..input.origin.clone()
        };
        Entry { name: input.name.clone(), material, origin }
    });
    Ok(Outcome::Done(entries.collect()))
}

pub(crate) fn to_json(recipe: &Recipe) -> serde_json::Value {
    serde_json::to_value(recipe).expect("numbers always serialise")
}

pub(crate) fn identities(inputs: &[Input]) -> Vec<(String, String)> {
    inputs.iter().map(|input| (input.name.clone(), input.origin.sha256.clone())).collect()
}

fn check(inputs: &[Input], options: &Options) -> Result<(), Error> {
    let Schedule { blocks, rate, .. } = options.schedule;
    if !(1..=MAX_BLOCKS).contains(&blocks) {
        return Err(Error::Options(format!("a step has {blocks} blocks, expected 1 to {MAX_BLOCKS}")));
    }
    if !(rate > 0.0 && rate.is_finite()) {
        return Err(Error::Options(format!("the learning rate is {rate}, expected a positive number")));
    }
    let net = match &options.model {
        Model::Ggx(_) => None,
        Model::Hybrid(hybrid) => Some((hybrid.net, hybrid.latent)),
        Model::Neural(neural) => Some((neural.net, neural.latent)),
        Model::Spherical(spherical) => {
            spherical.check(inputs).map_err(Error::Options)?;
            Some((spherical.net, 0))
        }
    };
    if let Some((net, latent)) = net {
        if !net.is_supported() {
            let found = format!("{}x{}", net.width, net.layers);
            return Err(Error::Options(format!(
                "the network is {found}, expected 16, 32 or 64 times 2 or 3"
            )));
        }
        const MOST_LATENT: usize = 32;
        if latent > MOST_LATENT {
            return Err(Error::Options(format!(
                "the latent code has {latent} numbers, expected at most {MOST_LATENT}"
            )));
        }
    }
    let needs_code = match &options.model {
        Model::Ggx(_) | Model::Spherical(_) => false,
        Model::Hybrid(hybrid) => hybrid.sharing == Sharing::Library && inputs.len() > 1,
        Model::Neural(_) => true,
    };
    if needs_code && matches!(net, Some((_, 0))) {
        let reason = "a latent code of 0 numbers cannot tell the materials of one network apart";
        return Err(Error::Options(reason.into()));
    }
    check_materials(inputs)
}

pub(crate) fn check_materials(inputs: &[Input]) -> Result<(), Error> {
    if inputs.is_empty() {
        return Err(Error::Options("there is no material to fit to".into()));
    }
    inputs.iter().try_for_each(|input| {
        input.truth.check().map_err(|reason| Error::Material { name: input.name.clone(), reason })
    })
}

/// [`train`], and whether it came to its end.
fn run<O: Objective>(
    objective: &O,
    truths: &[Truth],
    schedule: &Schedule,
    state: &mut State,
    watch: &mut dyn FnMut(&Progress, &State) -> ControlFlow<()>,
) -> Result<bool, Error> {
    match train(objective, truths, schedule, state, watch) {
        End::Finished => Ok(true),
        End::Stopped => Ok(false),
        End::Diverged => Err(Error::Diverged { step: state.step }),
    }
}

/// Roughnesses from which the analytic fit starts; the best end is kept.
const START_ALPHAS: [f32; 3] = [0.05, 0.2, 0.5];

/// The unbounded numbers of the best analytic fit of every material; `None` if it was stopped.
pub(crate) fn fit_analytic(
    truths: &[Truth],
    loss: Loss,
    isotropic: bool,
    schedule: &Schedule,
    watch: &mut Watch,
) -> Result<Option<Vec<Vec<f32>>>, Error> {
    let objective = GgxObjective { loss, isotropic };
    let starts = START_ALPHAS.map(|alpha| {
        let p = Microfacet { kd: [0.2; 3], eta: [1.5; 3], alpha: [alpha; 2] };
        analytic::from_parameters(&p, isotropic)
    });
    let candidates = vec![starts.to_vec(); truths.len()];
    let schedule = Schedule::analytic(schedule.drawing, schedule.seed);
    best_of(&objective, &[], truths, candidates, &schedule, watch)
}

/// Trains every material's own numbers from each of its candidates at once, and keeps the best.
pub(crate) fn best_of<O: Objective>(
    objective: &O,
    shared: &[f32],
    truths: &[Truth],
    candidates: Vec<Vec<Vec<f32>>>,
    schedule: &Schedule,
    watch: &mut Watch,
) -> Result<Option<Vec<Vec<f32>>>, Error> {
    let owners: Vec<usize> =
        candidates.iter().enumerate().flat_map(|(i, starts)| starts.iter().map(move |_| i)).collect();
    let repeated: Vec<Truth> = owners.iter().map(|&i| truths[i]).collect();
    let numbers = shared.iter().copied().chain(candidates.into_iter().flatten().flatten()).collect();
    let mut state = State::new(numbers);
    if !run(objective, &repeated, schedule, &mut state, &mut |progress, _| watch(progress, None))? {
        return Ok(None);
    }
    let judge = Judge::new(schedule.drawing, schedule.seed, JUDGE_BLOCKS);
    let mut best = vec![(f64::INFINITY, Vec::new()); truths.len()];
    for (&owner, own) in owners.iter().zip(state.numbers[shared.len()..].chunks_exact(objective.own_len())) {
        let loss = total_loss(objective, shared, own, truths[owner], &judge);
        if loss < best[owner].0 {
            best[owner] = (loss, own.to_vec());
        }
    }
    if best.iter().any(|(loss, _)| !loss.is_finite()) {
        return Err(Error::Diverged { step: schedule.steps });
    }
    Ok(Some(best.into_iter().map(|(_, own)| own).collect()))
}

/// Blocks of fresh pairs on which candidates are compared and bounds are taken.
pub(crate) const JUDGE_BLOCKS: usize = 64;

/// Fresh pairs, or all samples in a random order.
pub(crate) struct Judge {
    seed: u64,
    drawn: Vec<PairBlock>,
}

impl Judge {
    pub fn new(drawing: Drawing, seed: u64, blocks: usize) -> Judge {
        Judge { seed: !seed, drawn: pairs::draw(drawing, !seed, 0, blocks) }
    }

    pub fn look(&self, truth: Truth) -> (Cow<'_, [PairBlock]>, Vec<TargetBlock>) {
        truth.look(&self.drawn, self.seed, 0)
    }
}

pub(crate) fn total_loss<O: Objective>(
    objective: &O,
    shared: &[f32],
    own: &[f32],
    truth: Truth,
    judge: &Judge,
) -> f64 {
    let mut workspace = objective.workspace();
    let (mut unused_shared, mut unused_own) = (vec![0.0; shared.len()], vec![0.0; own.len()]);
    let (pairs, targets) = judge.look(truth);
    targets
        .iter()
        .zip(pairs.iter())
        .map(|(target, pairs)| {
            objective.block(&mut workspace, shared, own, pairs, target, &mut unused_shared, &mut unused_own)
        })
        .sum()
}

/// The first numbers of a hybrid fit: random weights and codes, and the analytic fits.
fn start(objective: &HybridObjective, p: &[Vec<f32>], seed: u64) -> Vec<f32> {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut numbers = Vec::new();
    if objective.sharing == Sharing::Library {
        numbers.extend(random_network(objective, &mut rng));
    }
    for p in p {
        if objective.sharing == Sharing::Material {
            numbers.extend(random_network(objective, &mut rng));
        }
        numbers.extend(p);
        numbers.extend((0..objective.latent).map(|_| 0.5 * symmetric(&mut rng)));
    }
    numbers
}

fn symmetric(rng: &mut Pcg64) -> f32 {
    2.0 * rng.random::<f32>() - 1.0
}

/// Weights and biases uniform in ±1/√inputs (PyTorch's default), and outputs that leave the
/// analytic part nearly as it is: a small residual and an open gate.
fn random_network(objective: &HybridObjective, rng: &mut Pcg64) -> Vec<f32> {
    const RESIDUAL: f32 = -3.0;
    const GATE: f32 = 1.0;
    let shape = &objective.shape;
    let mut numbers = Vec::with_capacity(shape.len());
    for layer in 0..shape.layers() {
        let (inputs, outputs) = shape.layer(layer);
        let bound = 1.0 / (inputs as f32).sqrt();
        numbers.extend((0..(inputs + 1) * outputs).map(|_| bound * symmetric(rng)));
    }
    let (_, bias) = shape.split_mut(&mut numbers, shape.layers() - 1);
    if objective.form.composition == Composition::GatedResidual {
        for c in 0..3 {
            bias[c] += RESIDUAL;
            bias[c + 3] += GATE;
        }
    }
    numbers
}

/// Room above the largest residual that the fit saw, for pairs between those it saw.
pub(crate) const BOUND_MARGIN: f32 = 0.1;

pub(crate) fn hybrid_materials(
    objective: &HybridObjective,
    truths: &[Truth],
    numbers: &[f32],
    schedule: &Schedule,
) -> Result<Vec<Material>, String> {
    let (shared, own) = numbers.split_at(objective.shared_len());
    let network = |numbers: &[f32]| {
        let layers = objective.shape.to_layers(numbers);
        Network::new(layers, objective.form.features(), objective.shape.activation()).map(Arc::new)
    };
    let library = match objective.sharing {
        Sharing::Library => Some(network(shared)?),
        Sharing::Material => None,
    };
    let judge = Judge::new(schedule.drawing, schedule.seed, JUDGE_BLOCKS);
    own.chunks_exact(objective.own_len())
        .zip(truths)
        .map(|(own, &truth)| {
            let parts = objective.split(shared, own);
            let network = library.clone().map_or_else(|| network(parts.network), Ok)?;
            let bound = objective.largest_residual(shared, own, &judge.look(truth).0) + BOUND_MARGIN;
            let p = analytic::to_parameters(parts.p);
            Hybrid::new(objective.form, network, p, parts.z.to_vec(), bound).map(Material::from)
        })
        .collect()
}

fn neural_materials(
    objective: &NeuralObjective,
    truths: &[Truth],
    numbers: &[f32],
    schedule: &Schedule,
) -> Result<Vec<Material>, String> {
    let (shared, own) = numbers.split_at(objective.shared_len());
    let judge = Judge::new(schedule.drawing, schedule.seed, JUDGE_BLOCKS);
    let made: Arc<Shared> = Arc::new(objective.to_shared(shared)?);
    own.chunks_exact(objective.own_len())
        .zip(truths)
        .map(|(z, &truth)| {
            let bound = objective.largest_output(shared, z, &judge.look(truth).0) + BOUND_MARGIN;
            Neural::new(made.clone(), z.to_vec(), bound).map(Material::from)
        })
        .collect()
}
