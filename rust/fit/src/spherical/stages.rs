//! From materials to spherical models: clusters, the stages of a fit, and what is kept in the end.

use std::ops::ControlFlow;
use std::sync::Arc;

use glimt_core::network::{Layer, Network};
use glimt_core::spherical::store::{Codebook, Store, StoreKind, scales};
use glimt_core::spherical::tables::Layout;
use glimt_core::spherical::{Features, Spherical};
use half::f16;
use rayon::prelude::*;

use super::cluster::clusters;
use super::prune::prune;
use super::{CANDIDATES, SphericalObjective, Stage};
use crate::adamw::Moments;
use crate::backprop::Shape;
use crate::error::Error;
use crate::fit::{BOUND_MARGIN, JUDGE_BLOCKS, Judge, Watch};
use crate::objective::Objective;
use crate::options::SphericalOptions;
use crate::train::{End, Progress, Schedule, State, train};
use crate::truth::Truth;

/// Share of the steps before features are rounded or chosen, …
const FREE_SHARE: f64 = 0.5;
/// … and before choices are final.
const SOFT_SHARE: f64 = 0.8;
/// Steps between new candidates: a multiple of those between reports.
const CHOICE_STEPS: u64 = 250;

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
    let layout = Arc::new(Layout::new(options.form).map_err(Error::Options)?);
    let shape = Shape::new(options.form.inputs(), &options.net.hidden(), 3, SphericalObjective::ACTIVATION);
    let mut objective = SphericalObjective {
        layout: &layout,
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
        let end = run_stages(&mut objective, &truths, schedule, &mut part, &mut report);
        keep(&mut state, &part);
        match end {
            End::Finished => {}
            End::Stopped => return Ok(SphericalEnd::Stopped(state)),
            End::Diverged => return Err(Error::Diverged { step: state.step }),
        }
        let diverged = |_| Error::Diverged { step: state.step };
        let materials = materials(&objective, &layout, &truths, &part.numbers, schedule).map_err(diverged)?;
        for (&i, material) in of.iter().zip(materials) {
            made[i] = Some(material);
        }
    }
    Ok(SphericalEnd::Done(made.into_iter().map(|m| m.expect("every material is in a cluster")).collect()))
}

/// The step at which a share of a schedule's steps is done, where candidates may be renewed.
fn boundary(schedule: &Schedule, share: f64) -> u64 {
    (schedule.steps as f64 * share / CHOICE_STEPS as f64).round() as u64 * CHOICE_STEPS
}

/// [`train`], stage after stage.
fn run_stages(
    objective: &mut SphericalObjective,
    truths: &[Truth],
    schedule: &Schedule,
    state: &mut State,
    watch: &mut dyn FnMut(&Progress, &State) -> ControlFlow<()>,
) -> End {
    let (free, soft) = (boundary(schedule, FREE_SHARE), boundary(schedule, SOFT_SHARE));
    loop {
        let step = state.step;
        let until = match objective.store {
            StoreKind::F32 | StoreKind::F16 => schedule.steps,
            _ if step < free => free,
            StoreKind::I8 | StoreKind::I4 => schedule.steps,
            StoreKind::Codebook(_) if step < soft => (step / CHOICE_STEPS + 1) * CHOICE_STEPS,
            StoreKind::Codebook(_) => schedule.steps,
        };
        objective.stage = match (objective.store, objective.store.largest()) {
            (StoreKind::F32 | StoreKind::F16, _) => Stage::Free,
            _ if step < free => Stage::Free,
            (_, Some(largest)) => Stage::Rounded(largest),
            _ if step < soft => Stage::Soft,
            _ => Stage::Chosen,
        };
        if step == free {
            objective.enter_kept(&mut state.numbers);
        }
        if objective.codebook_len() > 0 && step >= free && step.is_multiple_of(CHOICE_STEPS) && step <= soft {
            objective.choose(&mut state.numbers);
        }
        let mut stopped = false;
        let end = train(objective, truths, schedule, state, &mut |progress, state| {
            stopped = watch(progress, state).is_break();
            let done = stopped || (progress.step >= until && until < schedule.steps);
            if done { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        if end != End::Stopped || stopped {
            return end;
        }
    }
}

impl SphericalObjective<'_> {
    /// Sets scales or codebook from the features as they are.
    pub(super) fn enter_kept(&self, numbers: &mut [f32]) {
        let k = self.features();
        let (shared, own) = numbers.split_at_mut(self.shared_len());
        let kept = self.layout.places().len() * k;
        let features: Vec<f32> =
            own.chunks_exact(self.own_len()).flat_map(|own| own[..kept].iter().copied()).collect();
        let (scale_numbers, codebook) = shared[self.shape.len()..].split_at_mut(self.scales_len());
        if !scale_numbers.is_empty() {
            let tables = self.row_tables();
            let tables: Vec<usize> = tables.iter().copied().cycle().take(features.len() / k).collect();
            scale_numbers.copy_from_slice(&scales(self.store, &features, k, &tables));
        }
        if !codebook.is_empty() {
            means(&features, k, codebook);
        }
    }

    fn row_tables(&self) -> Vec<usize> {
        self.layout.places().iter().map(|&(table, _)| table).collect()
    }

    /// Sets every row's candidates to the primitives nearest to its features.
    pub(super) fn choose(&self, numbers: &mut [f32]) {
        let k = self.features();
        let (shared, own) = numbers.split_at_mut(self.shared_len());
        let codebook = &shared[self.shape.len() + self.scales_len()..];
        for own in own.chunks_exact_mut(self.own_len()) {
            let (features, candidates) = own.split_at_mut(self.layout.places().len() * k);
            let rows = features.par_chunks_exact(k).zip(candidates.par_chunks_exact_mut(CANDIDATES));
            rows.for_each(|(features, candidates)| {
                let mut best = [(f32::INFINITY, 0); CANDIDATES];
                for (i, primitive) in codebook.chunks_exact(k).enumerate() {
                    let mut entry = (distance(features, primitive), i);
                    for best in &mut best {
                        if entry.0 < best.0 {
                            std::mem::swap(best, &mut entry);
                        }
                    }
                }
                for (candidate, (_, i)) in candidates.iter_mut().zip(best) {
                    *candidate = i as f32;
                }
            });
        }
    }
}

fn distance(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// Means of `features`, rows of `k`, by Lloyd's algorithm, as many as `means` has room for; a mean that
/// nothing is nearest to moves to the row that is furthest from its own.
fn means(features: &[f32], k: usize, means: &mut [f32]) {
    const ROUNDS: usize = 12;
    let (rows, count) = (features.len() / k, means.len() / k);
    // A stride through the rows that visits all tables evenly.
    for (i, mean) in means.chunks_exact_mut(k).enumerate() {
        mean.copy_from_slice(&features[i * rows / count * k..][..k]);
    }
    for _ in 0..ROUNDS {
        let nearest: Vec<(usize, f32)> = features
            .par_chunks_exact(k)
            .map(|row| {
                let distances = means.chunks_exact(k).map(|mean| distance(row, mean));
                let best = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
                best.expect("there is at least one mean")
            })
            .collect();
        let (mut sums, mut counts) = (vec![0.0f64; means.len()], vec![0u32; count]);
        for (row, &(mean, _)) in features.chunks_exact(k).zip(&nearest) {
            counts[mean] += 1;
            sums[mean * k..][..k].iter_mut().zip(row).for_each(|(sum, &x)| *sum += f64::from(x));
        }
        let mut furthest: Vec<usize> = (0..rows).collect();
        furthest.sort_by(|&a, &b| nearest[b].1.total_cmp(&nearest[a].1));
        let mut furthest = furthest.into_iter();
        for (i, mean) in means.chunks_exact_mut(k).enumerate() {
            if counts[i] > 0 {
                let sums = sums[i * k..][..k].iter();
                mean.iter_mut().zip(sums).for_each(|(mean, sum)| *mean = (sum / f64::from(counts[i])) as f32);
            } else if let Some(row) = furthest.next() {
                mean.copy_from_slice(&features[row * k..][..k]);
            }
        }
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
                    indices: rows.iter().map(|row| parts.candidates[row * CANDIDATES] as u16).collect(),
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
