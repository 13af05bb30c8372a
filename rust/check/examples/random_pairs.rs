//! Looks for violations on random pairs that visit the extremes, over every material of the catalogue.
//!
//!     cargo run --release -p glimt-check --example random_pairs [-- PAIRS]

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use glimt_check::extremes::parts;
use glimt_check::random_pairs::{BLOCK, violations};
use rayon::prelude::*;

/// Pairs between two lines of progress.
const PROGRESS: u64 = 10_000_000;

fn main() {
    let count: u64 = std::env::args().nth(1).map_or(1_000_000_000, |n| n.parse().expect("a number of pairs"));
    let cases: Vec<_> = parts().iter().flat_map(|part| (part.cases)()).collect();
    let (done, found, start) = (AtomicU64::new(0), AtomicU64::new(0), Instant::now());
    (0..count.div_ceil(BLOCK as u64)).into_par_iter().for_each(|block| {
        for violation in violations(&cases[block as usize % cases.len()], block) {
            if found.fetch_add(1, Ordering::Relaxed) < 20 {
                println!("{violation}");
            }
        }
        let before = done.fetch_add(BLOCK as u64, Ordering::Relaxed);
        if before / PROGRESS != (before + BLOCK as u64) / PROGRESS {
            let [done, found] = [&done, &found].map(|n| n.load(Ordering::Relaxed));
            println!("{done} pairs, {found} violations, {:.0} s", start.elapsed().as_secs_f64());
        }
    });
    let [done, found] = [done, found].map(AtomicU64::into_inner);
    println!(
        "{done} pairs over {} materials, {found} violations, {:.0} s",
        cases.len(),
        start.elapsed().as_secs_f64()
    );
    std::process::exit(i32::from(found > 0));
}
