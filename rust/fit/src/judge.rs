//! Which of several fits is the best, by pairs of directions that none of them was trained on.

use std::borrow::Cow;

use crate::error::Error;
use crate::objective::Objective;
use crate::pairs::{self, Drawing, PairBlock, TargetBlock};
use crate::train::{End, Schedule, State, Watch, train};
use crate::truth::Truth;

/// Blocks of fresh pairs on which candidates are compared and bounds are taken.
pub(crate) const JUDGE_BLOCKS: usize = 64;

/// Room above the largest output of a network that the fit saw, for pairs between those it saw.
pub(crate) const BOUND_MARGIN: f32 = 0.1;

/// Fresh pairs, or all samples in a random order.
pub struct Judge {
    seed: u64,
    drawn: Vec<PairBlock>,
}

impl Judge {
    pub(crate) fn new(drawing: Drawing, seed: u64, blocks: usize) -> Judge {
        Judge { seed: !seed, drawn: pairs::draw(drawing, !seed, 0, blocks) }
    }

    /// The pairs at which a material is looked at, and its values there.
    #[must_use]
    pub fn look(&self, truth: Truth) -> (Cow<'_, [PairBlock]>, Vec<TargetBlock>) {
        truth.look(&self.drawn, self.seed, 0)
    }

    /// The loss of a material over all pairs.
    pub(crate) fn loss(&self, objective: &impl Objective, shared: &[f32], own: &[f32], truth: Truth) -> f64 {
        let mut workspace = objective.workspace();
        let mut unused = objective.zero_gradient();
        let (pairs, targets) = self.look(truth);
        targets
            .iter()
            .zip(pairs.iter())
            .map(|(target, pairs)| objective.block(&mut workspace, shared, own, pairs, target, &mut unused))
            .sum()
    }
}

/// Trains every material's own numbers from each of its candidates at once, and keeps the best; `None` if it was
/// stopped.
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
    let mut state = State::of(objective, owners.len(), numbers);
    match train(objective, &repeated, schedule, &mut state, &mut |progress, _| watch(progress, None)) {
        End::Finished => {}
        End::Stopped => return Ok(None),
        End::Diverged => return Err(Error::Diverged { step: state.step }),
    }
    let judge = Judge::new(schedule.drawing, schedule.seed, JUDGE_BLOCKS);
    let mut best = vec![(f64::INFINITY, Vec::new()); truths.len()];
    for (&owner, own) in owners.iter().zip(state.numbers[shared.len()..].chunks_exact(objective.own_len())) {
        let loss = judge.loss(objective, shared, own, truths[owner]);
        if loss < best[owner].0 {
            best[owner] = (loss, own.to_vec());
        }
    }
    if best.iter().any(|(loss, _)| !loss.is_finite()) {
        return Err(Error::Diverged { step: schedule.steps });
    }
    Ok(Some(best.into_iter().map(|(_, own)| own).collect()))
}
