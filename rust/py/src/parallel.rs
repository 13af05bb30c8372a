//! Large batches in parallel.

use std::sync::OnceLock;

use rayon::prelude::*;

/// Rows that one task computes; smaller batches stay in the calling thread.
const CHUNK: usize = 4096;

/// Calls `compute` for pieces of `out`, each with the index of its first row.
pub fn chunks<T: Send>(out: &mut [T], compute: impl Fn(usize, &mut [T]) + Sync) {
    if out.len() <= CHUNK || is_forked() {
        for (i, piece) in out.chunks_mut(CHUNK).enumerate() {
            compute(i * CHUNK, piece);
        }
    } else {
        out.par_chunks_mut(CHUNK).enumerate().for_each(|(i, piece)| compute(i * CHUNK, piece));
    }
}

/// Whether the process is a fork of the one that started the threads, as Python's `multiprocessing`
/// makes: the threads did not come along, and waiting for them would take forever. Asked before threads are first
/// used.
pub fn is_forked() -> bool {
    static STARTED_IN: OnceLock<u32> = OnceLock::new();
    let process = std::process::id();
    *STARTED_IN.get_or_init(|| process) != process
}
