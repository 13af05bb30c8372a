//! A model as a function of numbers.

use crate::gradient::{Gradient, RowGradient, Table};
use crate::pairs::{PairBlock, TargetBlock};

/// A model as a function of numbers: some that all materials share, some that each has for itself.
pub trait Objective: Sync {
    /// Room that one block needs, kept from block to block by a thread.
    type Workspace: Send;

    /// Numbers that all materials share.
    fn shared_len(&self) -> usize;

    /// Numbers of one material, its table among them.
    fn own_len(&self) -> usize;

    /// The last of a material's own numbers, if they are a table of which a block touches few rows.
    ///
    /// The optimiser leaves rows that no block of a step touched as they are. A row's time is the number of steps that
    /// touched it: its means and their correction are those of a fit of these steps alone. Rows do not decay.
    fn table(&self) -> Table {
        Table::NONE
    }

    /// Room for one block.
    fn workspace(&self) -> Self::Workspace;

    /// The loss of one material summed over a block; adds its derivatives to the gradient.
    fn block(
        &self,
        workspace: &mut Self::Workspace,
        shared: &[f32],
        own: &[f32],
        pairs: &PairBlock,
        target: &TargetBlock,
        gradient: &mut Gradient,
    ) -> f64;

    /// Whether weight decay pulls the shared number at `index` to 0.
    fn decays(&self, index: usize) -> bool {
        index < self.shared_len()
    }

    /// A gradient to which nothing was added yet.
    fn zero_gradient(&self) -> Gradient {
        let table = self.table();
        Gradient {
            shared: vec![0.0; self.shared_len()],
            own: vec![0.0; self.own_len() - table.len()],
            rows: RowGradient::new(table.width),
        }
    }
}
