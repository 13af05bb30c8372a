//! From materials to spherical models: clusters, the stages of a fit, and what is kept in the end.

use std::ops::ControlFlow;
use std::sync::Arc;

use glimt_core::kernels::network::{Layer, Network};
use glimt_core::models::spherical::store::{Codebook, Store, StoreKind, scales};
use glimt_core::models::spherical::tables::Layout;
use glimt_core::models::spherical::{Features, Spherical};
use half::f16;

use super::cluster::clusters;
use super::prune::prune;
use super::refine::layouts;
use super::{SphericalObjective, Stage};
use crate::adamw::Moments;
use crate::backprop::Shape;
use crate::error::Error;
use crate::fit::{BOUND_MARGIN, JUDGE_BLOCKS, Judge, Watch};
use crate::objective::Objective;
use crate::options::SphericalOptions;
use crate::train::{End, Progress, REPORT_EVERY, Schedule, State, train};
use crate::truth::Truth;

/// Share of the steps with tables that are coarser than the form's; features are rounded thereafter.
const COARSE_SHARE: f64 = 0.6;
/// The same with a codebook, whose choices take their time, too, …
const COARSE_SHARE_OF_CODEBOOKS: f64 = 0.3;
/// … before they are final.
const CHOSEN_AFTER: f64 = 0.9;
/// Steps between choices.
const CHOICE_STEPS: u64 = REPORT_EVERY;

/// How a fit ended.
pub(crate) enum SphericalEnd {
    Done(Vec<Spherical>),
    Stopped(State),
}

/// Fits `truths`; goes on from `resumed` if it is given.
pub(crate) fn fit_spherical(
    options: &SphericalOptions,
    truths: &[Truth],
    schedule: &Schedule,
    resumed: Option<State>,
    watch: &mut Watch,
) -> Result<SphericalEnd, Error> {
    let layouts = layouts(options.form).map_err(Error::Options)?;
    let layout = layouts.last().expect("the form's own");
    let shape = Shape::new(options.form.inputs(), &options.net.hidden(), 3, SphericalObjective::ACTIVATION);
    let mut objective = SphericalObjective {
        layout: &layouts[0],
        rows: layout.places().len(),
        shape,
        loss: options.loss,
        store: options.store,
        stage: Stage::Free,
    };
    let clusters = clusters(truths, options.clusters.unwrap_or(truths.len()));
    let lengths: Vec<usize> =
        clusters.iter().map(|of| objective.shared_len() + of.len() * objective.own_len()).collect();
    let expected: usize = lengths.iter().sum();
    let mut state = match resumed {
        Some(state) if state.numbers.len() != expected || state.moments.first.len() != expected => {
            let found = state.numbers.len();
            return Err(Error::Options(format!(
                "the checkpoint holds {found} numbers, expected {expected}; fit anew"
            )));
        }
        Some(state) => state,
        None => {
            let initial = |of: &Vec<usize>| objective.initial(schedule.seed, of.len());
            State::new(clusters.iter().flat_map(initial).collect())
        }
    };

    // Clusters are fitted one after the other; the state is that of all.
    let mut made: Vec<Option<Spherical>> = vec![None; truths.len()];
    let mut first = 0;
    for (cluster, (of, &length)) in clusters.iter().zip(&lengths).enumerate() {
        let range = first..first + length;
        first += length;
        let before = cluster as u64 * schedule.steps;
        let truths: Vec<Truth> = of.iter().map(|&i| truths[i]).collect();
        let mut part = State {
            numbers: state.numbers[range.clone()].to_vec(),
            moments: Moments {
                first: state.moments.first[range.clone()].to_vec(),
                second: state.moments.second[range.clone()].to_vec(),
            },
            step: state.step.saturating_sub(before).min(schedule.steps),
        };
        let total = schedule.steps * clusters.len() as u64;
        let keep = |state: &mut State, part: &State| {
            state.numbers[range.clone()].copy_from_slice(&part.numbers);
            state.moments.first[range.clone()].copy_from_slice(&part.moments.first);
            state.moments.second[range.clone()].copy_from_slice(&part.moments.second);
            state.step = state.step.max(before + part.step);
        };
        let mut report = |progress: &Progress, part: &State| {
            keep(&mut state, part);
            let progress = Progress { step: progress.step + before, steps: total, ..*progress };
            watch(&progress, Some(&state))
        };
        let end = run_stages(&mut objective, &layouts, &truths, schedule, &mut part, &mut report);
        keep(&mut state, &part);
        match end {
            End::Finished => {}
            End::Stopped => return Ok(SphericalEnd::Stopped(state)),
            End::Diverged => return Err(Error::Diverged { step: state.step }),
        }
        let diverged = |_| Error::Diverged { step: state.step };
        let materials = materials(&objective, layout, &truths, &part.numbers, schedule).map_err(diverged)?;
        for (&i, material) in of.iter().zip(materials) {
            made[i] = Some(material);
        }
    }
    Ok(SphericalEnd::Done(made.into_iter().map(|m| m.expect("every material is in a cluster")).collect()))
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

/// Events and the steps that are done before them, in order.
fn plan(store: StoreKind, layouts: usize, steps: u64) -> Vec<(u64, Event)> {
    let after = |share: f64| (steps as f64 * share / REPORT_EVERY as f64).round() as u64 * REPORT_EVERY;
    let coarse = match store {
        StoreKind::Codebook(_) => COARSE_SHARE_OF_CODEBOOKS,
        _ => COARSE_SHARE,
    };
    let finest = layouts - 1;
    let finer = |i: usize| (after(coarse * i as f64 / finest as f64), Event::Finer(i));
    let mut plan: Vec<(u64, Event)> = (1..layouts).map(finer).collect();
    match store {
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

/// [`train`], event after event.
fn run_stages<'a>(
    objective: &mut SphericalObjective<'a>,
    layouts: &'a [Arc<Layout>],
    truths: &[Truth],
    schedule: &Schedule,
    state: &mut State,
    watch: &mut dyn FnMut(&Progress, &State) -> ControlFlow<()>,
) -> End {
    let plan = plan(objective.store, layouts.len(), schedule.steps);
    (objective.layout, objective.stage) = (&layouts[0], Stage::Free);
    loop {
        // A state is kept before the events of its step.
        let now = state.step;
        for &(step, event) in plan.iter().take_while(|(step, _)| *step <= now) {
            let is_due = step == now;
            match event {
                Event::Finer(i) => {
                    if is_due {
                        objective.refine(&layouts[i], state);
                    }
                    objective.layout = &layouts[i];
                }
                Event::Keep => {
                    if is_due {
                        objective.enter_kept(state, schedule.seed);
                    }
                    objective.stage = objective.store.largest().map_or(Stage::Choosing, Stage::Rounded);
                }
                Event::Choose if is_due => objective.choose(state),
                Event::Choose => {}
                Event::Settle => objective.stage = Stage::Chosen,
            }
        }
        let next = plan.iter().map(|&(step, _)| step).find(|&step| step > now);
        let mut stopped = false;
        let end = train(objective, truths, schedule, state, &mut |progress, state| {
            stopped = watch(progress, state).is_break();
            let is_over = stopped || next == Some(progress.step);
            if is_over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        if end != End::Stopped || stopped {
            return end;
        }
    }
}

impl SphericalObjective<'_> {
    /// Sets scales or codebook from the features as they are.
    pub(super) fn enter_kept(&self, state: &mut State, seed: u64) {
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

    fn row_tables(&self) -> Vec<usize> {
        self.layout.places().iter().map(|&(table, _)| table).collect()
    }
}

/// The materials of a cluster.
fn materials(
    objective: &SphericalObjective,
    layout: &Arc<Layout>,
    truths: &[Truth],
    numbers: &[f32],
    schedule: &Schedule,
) -> Result<Vec<Spherical>, String> {
    let (shared, own) = numbers.split_at(objective.shared_len());
    let k = objective.features();
    // Halves for all but those who want every bit.
    let halves = objective.store != StoreKind::F32;
    let round = |x: &f32| if halves { f16::from_f32(*x).to_f32() } else { *x };
    let layers = objective.shape.to_layers(shared).into_iter().map(|layer| Layer {
        weight: layer.weight.iter().map(round).collect(),
        bias: layer.bias.iter().map(round).collect(),
    });
    let network =
        Arc::new(Network::new(layers.collect(), objective.shape.inputs(), SphericalObjective::ACTIVATION)?);
    let parts = objective.parts(shared, &own[..objective.own_len()]);
    let codebook =
        Arc::new(Codebook { primitives: parts.codebook.iter().map(|&x| f16::from_f32(x)).collect() });
    let tables = objective.row_tables();
    let judge = Judge::new(schedule.drawing, schedule.seed, JUDGE_BLOCKS);
    own.chunks_exact(objective.own_len())
        .zip(truths)
        .map(|(own, &truth)| {
            let parts = objective.parts(shared, own);
            let (links, rows) = match prune(layout, truth) {
                Some((links, kept)) => (Some(links), kept),
                None => (None, (0..tables.len()).collect()),
            };
            let features: Vec<f32> =
                rows.iter().flat_map(|row| &parts.features[row * k..][..k]).copied().collect();
            let tables: Vec<usize> = rows.iter().map(|&row| tables[row]).collect();
            let store = match objective.store {
                StoreKind::Codebook(bits) => Store::Indexed {
                    bits,
                    indices: rows.iter().map(|&row| parts.choices[row] as u16).collect(),
                    codebook: codebook.clone(),
                },
                kind if objective.stage == Stage::Free => Store::new(kind, &features, k, &tables),
                kind => Store::scaled(kind, &features, parts.scales.to_vec(), k, &tables),
            };
            let bound = objective.largest_output(shared, own, &judge.look(truth).0) + BOUND_MARGIN;
            Spherical::new(layout.clone(), network.clone(), Features { store, links }, bound)
        })
        .collect()
}
