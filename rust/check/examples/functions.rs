//! Prints the errors of every function of the core beside its condition.
//!
//!     cargo run --release -p glimt-check --example functions [-- POINTS]

use glimt_check::functions::{FUNCTIONS, Unit};
use rayon::prelude::*;

fn main() {
    let count = std::env::args().nth(1).map_or(1_000_000, |n| n.parse().expect("a number of points"));
    println!("| function | range | budget | worst blame | largest error, ULP | its condition, ULP |");
    println!("|---|---|---|---|---|---|");
    let measured: Vec<_> = FUNCTIONS.par_iter().map(|function| function.measure(count)).collect();
    for (function, worst) in FUNCTIONS.iter().zip(&measured) {
        let unit = if function.unit == Unit::One { " of 1" } else { "" };
        println!(
            "| {} | {} | {} | {:.2} | {:.3e}{unit} | {:.3e} |",
            function.name,
            function.range,
            function.budget,
            worst.blamed.blame(),
            worst.error.ulp,
            worst.error.condition
        );
    }
    for (function, worst) in FUNCTIONS.iter().zip(&measured) {
        println!("\n{}\n  largest error: {}\n  worst blame: {}", function.name, worst.error, worst.blamed);
    }
}
