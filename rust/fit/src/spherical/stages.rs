//! Spherical fits: their options, clusters, what changes between steps, and what is kept in the end.

use std::sync::Arc;

use glimt_core::Invalid;
use glimt_core::Material;
use glimt_core::kernels::network::{Layer, Network};
use glimt_core::models::spherical::store::{Codebook, Store, StoreKind, scales};
use glimt_core::models::spherical::tables::{Form, Grids};
use glimt_core::models::spherical::{Features, Spherical};
use half::f16;
use serde::{Deserialize, Serialize};

use super::cluster::clusters;
use super::prune::prune;
use super::refine::layouts;
use super::{Parts, SphericalObjective, Stage};
use crate::backprop::Shape;
use crate::error::Error;
use crate::fittable::Fittable;
use crate::input::Input;
use crate::judge::{BOUND_MARGIN, Judge};
use crate::loss::Loss;
use crate::net::Net;
use crate::objective::Objective;
use crate::pairs::Drawing;
use crate::train::{REPORT_EVERY, Schedule, State, Watch};
use crate::truth::Truth;

/// A spherical fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SphericalOptions {
    /// The tables.
    pub form: Form,
    /// How features are kept.
    pub store: StoreKind,
    /// Hidden layers.
    pub net: Net,
    /// Clusters of materials that share network and codebook; `None`: every material has its own.
    pub clusters: Option<usize>,
    /// Loss of f.
    pub loss: Loss,
}

/// Loss of glimt's spherical fits.
pub const SPHERICAL_LOSS: Loss = Loss { absolute: 1.0, squared: 1.0, relative: 0.02 };

impl Schedule {
    /// glimt's schedule for the spherical model. On three RGL materials rates of 0.01 and 0.04 ended worse.
    #[must_use]
    pub fn spherical(steps: u64, seed: u64) -> Self {
        Schedule { rate: 0.02, drawing: Drawing::NearNormal, ..Self::standard(steps, seed) }
    }
}

/// Share of the steps with tables that are coarser than the form's; features are rounded thereafter.
const COARSE_SHARE: f64 = 0.6;
/// The same with a codebook, whose choices take their time, too, …
const COARSE_SHARE_OF_CODEBOOKS: f64 = 0.3;
/// … before they are final.
const CHOSEN_AFTER: f64 = 0.9;
/// Steps between choices.
const CHOICE_STEPS: u64 = REPORT_EVERY;

impl Fittable for SphericalOptions {
    type Objective = SphericalObjective;

    fn check(&self, inputs: &[Input]) -> Result<(), String> {
        self.form.validate()?;
        self.store.validate()?;
        if let Some(input) = inputs.iter().find(|input| !input.isotropic && self.form.grids == Grids::Iso) {
            return Err(format!(
                "\"{}\" is anisotropic, but the grids iso are not; fit it with hd",
                input.name
            ));
        }
        match self.clusters {
            Some(count) if count == 0 || count > inputs.len() => {
                Err(format!("{count} clusters of {0} materials; expected 1 to {0}", inputs.len()))
            }
            _ => self.net.check(0),
        }
    }

    fn objective(&self, _isotropic: bool) -> Result<SphericalObjective, String> {
        let activation = SphericalObjective::ACTIVATION;
        Ok(SphericalObjective {
            layouts: layouts(self.form)?,
            level: 0,
            shape: Shape::new(self.form.inputs(), &self.net.hidden(), 3, activation),
            loss: self.loss,
            store: self.store,
            stage: Stage::Free,
        })
    }

    fn groups(&self, truths: &[Truth]) -> Vec<Vec<usize>> {
        clusters(truths, self.clusters.unwrap_or(truths.len()))
    }

    fn start(
        &self,
        objective: &SphericalObjective,
        truths: &[Truth],
        schedule: &Schedule,
        _: &mut Watch,
    ) -> Result<Option<Vec<f32>>, Error> {
        Ok(Some(objective.initial(schedule.seed, truths.len())))
    }

    fn turns(&self, objective: &SphericalObjective, steps: u64) -> Vec<u64> {
        let mut turns: Vec<u64> = objective.plan(steps).into_iter().map(|(step, _)| step).collect();
        turns.sort_unstable();
        turns.dedup();
        turns
    }

    fn turn(
        &self,
        step: u64,
        schedule: &Schedule,
        objective: &mut SphericalObjective,
        mut state: Option<&mut State>,
    ) {
        for (_, event) in objective.plan(schedule.steps).into_iter().filter(|&(of, _)| of == step) {
            objective.pass(event, state.as_deref_mut(), schedule.seed);
        }
    }

    fn finish(
        &self,
        objective: &SphericalObjective,
        numbers: &[f32],
        truths: &[Truth],
        judge: &Judge,
    ) -> Result<Vec<Material>, Invalid> {
        let (shared, own) = numbers.split_at(objective.shared_len());
        let network = objective.network(shared)?;
        let parts = objective.parts(shared, &own[..objective.own_len()]);
        let codebook =
            Arc::new(Codebook { primitives: parts.codebook.iter().map(|&x| f16::from_f32(x)).collect() });
        let materials = own.chunks_exact(objective.own_len()).zip(truths);
        let material = |(own, &truth): (&[f32], &Truth)| {
            let layout = objective.finest().clone();
            let features = objective.kept(&objective.parts(shared, own), &codebook, truth);
            let bound = objective.largest_output(shared, own, &judge.look(truth).0) + BOUND_MARGIN;
            Spherical::new(layout, network.clone(), features, bound).map(Material::from)
        };
        materials.map(material).collect()
    }

    fn numbers_each(&self, _materials: usize, _isotropic: bool) -> Option<usize> {
        None
    }
}

/// What a fit does between steps.
#[derive(Clone, Copy)]
enum Event {
    /// It goes on with finer tables, those of this number.
    Finer(usize),
    /// It sets how features will be kept, and goes on with what that makes of them.
    Keep,
    /// It chooses primitives anew.
    Choose,
    /// Choices are final.
    Settle,
}

impl SphericalObjective {
    /// Events and the steps that are done before them; those of one step in their order.
    fn plan(&self, steps: u64) -> Vec<(u64, Event)> {
        let after = |share: f64| (steps as f64 * share / REPORT_EVERY as f64).round() as u64 * REPORT_EVERY;
        let coarse = match self.store {
            StoreKind::Codebook(_) => COARSE_SHARE_OF_CODEBOOKS,
            _ => COARSE_SHARE,
        };
        let finest = self.layouts.len() - 1;
        let finer = |i: usize| (after(coarse * i as f64 / finest as f64), Event::Finer(i));
        let mut plan: Vec<(u64, Event)> = (1..=finest).map(finer).collect();
        match self.store {
            StoreKind::F32 | StoreKind::F16 => {}
            StoreKind::I8 | StoreKind::I4 => plan.push((after(coarse), Event::Keep)),
            StoreKind::Codebook(_) => {
                let (first, last) = (after(coarse), after(CHOSEN_AFTER));
                plan.push((first, Event::Keep));
                let choices = (first..last).step_by(CHOICE_STEPS as usize).skip(1);
                plan.extend(choices.map(|step| (step, Event::Choose)));
                plan.push((last, Event::Settle));
            }
        }
        plan
    }

    /// Changes to what it is after an event, and `state` with it if the event is now.
    fn pass(&mut self, event: Event, state: Option<&mut State>, seed: u64) {
        match event {
            Event::Finer(level) => {
                if let Some(state) = state {
                    self.refine(&self.layouts[level], state);
                }
                self.level = level;
            }
            Event::Keep => {
                if let Some(state) = state {
                    self.enter_kept(state, seed);
                }
                self.stage = self.store.largest().map_or(Stage::Choosing, Stage::Rounded);
            }
            Event::Choose => {
                if let Some(state) = state {
                    self.choose(state);
                }
            }
            Event::Settle => self.stage = Stage::Chosen,
        }
    }

    /// Sets scales or codebook from the features as they are.
    fn enter_kept(&self, state: &mut State, seed: u64) {
        if self.codebook_len() > 0 {
            return self.make_codebook(state, seed);
        }
        let features = self.all_features(&state.numbers);
        let tables = self.row_tables();
        let tables: Vec<usize> =
            tables.iter().copied().cycle().take(features.len() / self.features()).collect();
        let scales = scales(self.store, &features, self.features(), &tables);
        state.numbers[self.shape.len()..][..self.scales_len()].copy_from_slice(&scales);
    }

    /// The network as it is kept: in halves for all but those who want every bit.
    fn network(&self, shared: &[f32]) -> Result<Arc<Network>, Invalid> {
        let halves = self.store != StoreKind::F32;
        let round = |x: &f32| if halves { f16::from_f32(*x).to_f32() } else { *x };
        let layers = self.shape.to_layers(shared).into_iter().map(|layer| Layer {
            weight: layer.weight.iter().map(round).collect(),
            bias: layer.bias.iter().map(round).collect(),
        });
        Network::new(layers.collect(), self.shape.inputs(), SphericalObjective::ACTIVATION).map(Arc::new)
    }

    /// A material's features as they are kept.
    fn kept(&self, parts: &Parts<&[f32]>, codebook: &Arc<Codebook>, truth: Truth) -> Features {
        let (k, tables) = (self.features(), self.row_tables());
        let (links, rows) = match prune(self.finest(), truth) {
            Some((links, kept)) => (Some(links), kept),
            None => (None, (0..tables.len()).collect()),
        };
        let features: Vec<f32> =
            rows.iter().flat_map(|row| &parts.features[row * k..][..k]).copied().collect();
        let tables: Vec<usize> = rows.iter().map(|&row| tables[row]).collect();
        let store = match self.store {
            StoreKind::Codebook(bits) => Store::Indexed {
                bits,
                indices: rows.iter().map(|&row| parts.choices[row] as u16).collect(),
                codebook: codebook.clone(),
            },
            kind if self.stage == Stage::Free => Store::new(kind, &features, k, &tables),
            kind => Store::scaled(kind, &features, parts.scales.to_vec(), k, &tables),
        };
        Features { store, links }
    }

    fn row_tables(&self) -> Vec<usize> {
        self.layout().places().iter().map(|&(table, _)| table).collect()
    }
}
