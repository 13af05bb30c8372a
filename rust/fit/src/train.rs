//! The training loop: the same for every objective.

use std::borrow::Cow;
use std::ops::{ControlFlow, Range};
use std::time::Instant;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::adamw::{AdamW, Moments, clip_norm, cosine_decay};
use crate::backprop::BLOCK;
use crate::gradient::{Gradient, add};
use crate::objective::Objective;
use crate::pairs::{self, Drawing, PairBlock, TargetBlock};
use crate::truth::Truth;

/// How long and how fast.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Schedule {
    /// Steps of the optimiser.
    pub steps: u64,
    /// Blocks of [`BLOCK`] pairs in a step, for every material.
    pub blocks: usize,
    /// Seed of directions and first numbers.
    pub seed: u64,
    /// Learning rate at the start; a cosine brings it to 0.
    pub rate: f32,
    /// Largest norm of a step's gradient.
    pub clip: f32,
    /// The optimiser.
    pub adamw: AdamW,
    /// How lights are drawn.
    pub drawing: Drawing,
    /// Whether the shared numbers stay as they are, and only the materials' own move.
    pub freeze_shared: bool,
}

impl Schedule {
    /// glimt's own schedule.
    #[must_use]
    pub fn standard(steps: u64, seed: u64) -> Self {
        Schedule {
            steps,
            blocks: 4,
            seed,
            rate: 1e-2,
            clip: 0.02,
            adamw: AdamW { weight_decay: 0.0, ..AdamW::PAPER },
            drawing: Drawing::Lobes,
            freeze_shared: false,
        }
    }

    /// The paper's schedule (§3.3): 1024 cosine-distributed pairs a step, gradients clipped at 0.01.
    #[must_use]
    pub fn paper(steps: u64, seed: u64) -> Self {
        Schedule {
            rate: 5e-3,
            clip: 0.01,
            adamw: AdamW::PAPER,
            drawing: Drawing::Cosine,
            ..Self::standard(steps, seed)
        }
    }
}

/// Blocks that are drawn and evaluated at a time.
const POOL_BLOCKS: usize = 256;
/// Most blocks in a step.
pub const MAX_BLOCKS: usize = POOL_BLOCKS;
/// How often every block of a pool is used. Evaluating a measurement costs as much as a step on it;
/// on the reference materials, 32 passes end where 8 do.
const POOL_PASSES: usize = 32;

/// Where a fit is: all that is needed to go on.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Shared numbers, then each material's own.
    pub numbers: Vec<f32>,
    /// The optimiser's means.
    pub moments: Moments,
    /// Steps that are done.
    pub step: u64,
}

impl State {
    /// The start of a fit from its first numbers, among which there is no table.
    #[must_use]
    pub fn new(numbers: Vec<f32>) -> Self {
        State { moments: Moments::new(numbers.len(), 0), numbers, step: 0 }
    }

    /// The start of a fit of `materials` from its first numbers.
    #[must_use]
    pub fn of(objective: &impl Objective, materials: usize, numbers: Vec<f32>) -> Self {
        let rows = materials * objective.table().rows;
        State { moments: Moments::new(numbers.len(), rows), numbers, step: 0 }
    }
}

/// What a fit reports as it goes.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Steps that are done.
    pub step: u64,
    /// Steps in all.
    pub steps: u64,
    /// Loss per pair and channel, mean over the materials and the steps since the last report.
    pub loss: f64,
    /// Steps per second of this run.
    pub rate: f64,
}

/// Looks at a fit as it goes and may stop it. The state is what a checkpoint keeps; there is none in what comes
/// before the first numbers, such as the fit of an analytic part.
pub type Watch<'a> = dyn FnMut(&Progress, Option<&State>) -> ControlFlow<()> + 'a;

/// Steps between reports.
pub const REPORT_EVERY: u64 = 50;

/// How [`train`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Every step is done.
    Finished,
    /// The report broke it off.
    Stopped,
    /// The gradient was no longer finite; the state is that before the step.
    Diverged,
}

/// Runs `state` to the end of `schedule`, or until `report` breaks.
///
/// On machines of one instruction set, the result depends on the schedule and the materials alone: not
/// on the number of threads, nor on how often the fit was interrupted.
///
/// # Panics
/// If the schedule has no blocks in a step, or more than [`MAX_BLOCKS`].
pub fn train<O: Objective>(
    objective: &O,
    materials: &[Truth],
    schedule: &Schedule,
    state: &mut State,
    report: &mut dyn FnMut(&Progress, &State) -> ControlFlow<()>,
) -> End {
    let epoch_steps = (POOL_BLOCKS * POOL_PASSES / schedule.blocks) as u64;
    let mut pool = Pool { epoch: u64::MAX, drawn: Vec::new(), samples: Vec::new(), targets: Vec::new() };
    let (start, first) = (Instant::now(), state.step);
    let mut loss = 0.0;
    while state.step < schedule.steps {
        let epoch = state.step / epoch_steps;
        if pool.epoch != epoch {
            pool = Pool::new(materials, schedule, epoch);
        }
        let blocks = pool.batch(schedule, state.step % epoch_steps);
        let (step_loss, mut gradient) = gradient(objective, &state.numbers, &pool, &blocks);
        loss += step_loss / materials.len() as f64;
        if schedule.freeze_shared {
            gradient.values[..objective.shared_len()].fill(0.0);
        }
        if !clip_norm(&mut gradient.values, schedule.clip).is_finite() {
            return End::Diverged;
        }
        step(objective, schedule, &gradient, state);

        if state.step.is_multiple_of(REPORT_EVERY) || state.step == schedule.steps {
            let done = (state.step - 1) % REPORT_EVERY + 1;
            let progress = Progress {
                step: state.step,
                steps: schedule.steps,
                loss: loss / done as f64,
                rate: (state.step - first) as f64 / start.elapsed().as_secs_f64(),
            };
            loss = 0.0;
            if report(&progress, state).is_break() {
                return End::Stopped;
            }
        }
    }
    End::Finished
}

/// Pairs of one epoch and every material's values there.
struct Pool {
    epoch: u64,
    /// Pairs for all materials that are known everywhere.
    drawn: Vec<PairBlock>,
    /// A material's own pairs, where it is known at these alone.
    samples: Vec<Option<Vec<PairBlock>>>,
    /// [material][block].
    targets: Vec<Vec<TargetBlock>>,
}

impl Pool {
    fn new(materials: &[Truth], schedule: &Schedule, epoch: u64) -> Self {
        let drawn = pairs::draw(schedule.drawing, schedule.seed, epoch, POOL_BLOCKS);
        let looks = materials.iter().map(|material| {
            let (pairs, targets) = material.look(&drawn, schedule.seed, epoch);
            let own = match pairs {
                Cow::Borrowed(_) => None,
                Cow::Owned(pairs) => Some(pairs),
            };
            (own, targets)
        });
        let (samples, targets) = looks.unzip();
        Pool { epoch, drawn, samples, targets }
    }

    fn pairs(&self, material: usize, block: usize) -> &PairBlock {
        &self.samples[material].as_ref().unwrap_or(&self.drawn)[block]
    }

    /// The blocks of a step: every pass goes through the pool in another order.
    fn batch(&self, schedule: &Schedule, step: u64) -> Vec<usize> {
        let first = step as usize * schedule.blocks;
        (first..first + schedule.blocks)
            .map(|i| {
                let (pass, position) = (i / POOL_BLOCKS, i % POOL_BLOCKS);
                // An odd stride visits every block of a pool whose size is a power of two.
                (position * (2 * pass + 1) * STRIDE + pass) % POOL_BLOCKS
            })
            .collect()
    }
}

/// Odd, and far from any simple fraction of the pool.
const STRIDE: usize = 79;

/// The gradient of a step by all numbers but the rows that it does not touch.
struct StepGradient {
    /// In the order of the numbers, without gaps.
    values: Vec<f32>,
    /// Which numbers the values are by.
    spans: Vec<Span>,
}

/// Numbers that follow each other.
struct Span {
    numbers: Range<usize>,
    /// If they are a row of a table, which one of those of all materials.
    row: Option<usize>,
}

impl StepGradient {
    fn push(&mut self, start: usize, row: Option<usize>, values: &[f32]) {
        self.spans.push(Span { numbers: start..start + values.len(), row });
        self.values.extend_from_slice(values);
    }
}

/// Loss per pair and channel summed over the materials, and its gradient.
fn gradient<O: Objective>(
    objective: &O,
    numbers: &[f32],
    pool: &Pool,
    blocks: &[usize],
) -> (f64, StepGradient) {
    let (shared, own) = numbers.split_at(objective.shared_len());
    let own_len = objective.own_len();
    let materials = pool.targets.len();
    let work: Vec<(usize, usize)> =
        (0..materials).flat_map(|material| blocks.iter().map(move |&block| (material, block))).collect();
    let parts: Vec<(f64, Gradient)> = work
        .par_iter()
        .map_init(
            || objective.workspace(),
            |workspace, &(material, block)| {
                let mut gradient = objective.zero_gradient();
                let loss = objective.block(
                    workspace,
                    shared,
                    &own[material * own_len..][..own_len],
                    pool.pairs(material, block),
                    &pool.targets[material][block],
                    &mut gradient,
                );
                (loss, gradient)
            },
        )
        .collect();
    // Added up in the order of the work, whichever thread did it.
    let mut total = 0.0;
    let Gradient { shared: mut by_shared, own, rows } = objective.zero_gradient();
    let mut sums = vec![(own, rows); materials];
    for (&(material, _), (loss, part)) in work.iter().zip(&parts) {
        total += loss;
        add(&mut by_shared, &part.shared);
        let (by_own, by_rows) = &mut sums[material];
        add(by_own, &part.own);
        part.rows.iter().for_each(|(row, values)| add(by_rows.row(row), values));
    }
    let mut gradient = StepGradient { values: Vec::new(), spans: Vec::new() };
    gradient.push(0, None, &by_shared);
    let table = objective.table();
    for (material, (by_own, by_rows)) in sums.iter().enumerate() {
        let start = shared.len() + material * own_len;
        gradient.push(start, None, by_own);
        for (row, values) in by_rows.iter() {
            let start = start + by_own.len() + row * table.width;
            gradient.push(start, Some(material * table.rows + row), values);
        }
    }
    let scale = 1.0 / (blocks.len() * BLOCK * 3) as f32;
    gradient.values.iter_mut().for_each(|g| *g *= scale);
    (total * f64::from(scale), gradient)
}

/// Moves all numbers but the rows that the step does not touch.
fn step(objective: &impl Objective, schedule: &Schedule, gradient: &StepGradient, state: &mut State) {
    let rate = cosine_decay(schedule.rate, state.step, schedule.steps);
    state.step += 1;
    let mut rest = &gradient.values[..];
    for Span { numbers, row } in &gradient.spans {
        let (values, others) = rest.split_at(numbers.len());
        rest = others;
        let step = match *row {
            None => state.step,
            Some(row) => {
                let touched = &mut state.moments.touched[row];
                *touched = touched.saturating_add(1);
                (*touched).into()
            }
        };
        let decays = |i| !schedule.freeze_shared && objective.decays(numbers.start + i);
        let moved = &mut state.numbers[numbers.clone()];
        schedule.adamw.update(moved, values, state.moments.of(numbers.clone()), step, rate, decays);
    }
}
