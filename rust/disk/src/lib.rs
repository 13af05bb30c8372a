//! What every writer of files needs: a file is whole or as it was, two processes take turns, and names do not
//! command a terminal.

mod claim;
mod names;
mod whole;

pub use claim::{Claim, Exclusion};
pub use names::{is_printable, printable, printable_lines};
pub use whole::{Place, STANDARD_OUTPUT, probe, write_whole};

use std::path::Path;

/// Whether two paths lead to one file, through links of any kind; a path that leads nowhere is no other's.
#[must_use]
pub fn is_same(a: &Path, b: &Path) -> bool {
    same_file::is_same_file(a, b).unwrap_or(false)
}
