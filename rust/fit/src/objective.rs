//! What a model must offer to be fitted.

use crate::pairs::{PairBlock, TargetBlock};

/// A model as a function of numbers: some that all materials share, some that each has for itself.
pub trait Objective: Sync {
    /// Room that one block needs, kept from block to block by a thread.
    type Workspace: Send;

    /// Numbers that all materials share.
    fn shared_len(&self) -> usize;

    /// Numbers of one material.
    fn own_len(&self) -> usize;

    /// Room for one block.
    fn workspace(&self) -> Self::Workspace;

    /// The loss of one material summed over a block; adds its derivatives to the two gradients.
    #[allow(clippy::too_many_arguments)]
    fn block(
        &self,
        workspace: &mut Self::Workspace,
        shared: &[f32],
        own: &[f32],
        pairs: &PairBlock,
        target: &TargetBlock,
        shared_gradient: &mut [f32],
        own_gradient: &mut [f32],
    ) -> f64;

    /// Whether weight decay pulls the shared number at `index` to 0.
    fn decays(&self, index: usize) -> bool {
        index < self.shared_len()
    }
}
