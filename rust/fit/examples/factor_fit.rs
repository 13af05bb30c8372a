//! Times fits of factor tables to every material of a model library, and shows how they end.
//!
//!     cargo run --release -p glimt-fit --example factor_fit LIB.safetensors [SEED ...]

use std::time::Instant;

use glimt_core::Library;
use glimt_core::factor::{Interpolation, Variant};
use glimt_fit::{FactorOptions, fit_factor};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let library = Library::open(arguments.next().ok_or("a model library is missing")?)?;
    let seeds: Vec<u64> = arguments.map(|seed| seed.parse()).collect::<Result<_, _>>()?;
    let seeds = if seeds.is_empty() { vec![0] } else { seeds };
    for entry in library.entries() {
        println!("{}", entry.name);
        for variant in [Variant::Bivariate, Variant::Naive, Variant::GFromD, Variant::IndependentG] {
            for &seed in &seeds[..if variant == Variant::IndependentG { seeds.len() } else { 1 }] {
                let start = Instant::now();
                let options = FactorOptions { variant, interpolation: Interpolation::Nearest, seed };
                let fit = fit_factor(&entry.material, &options);
                let seconds = start.elapsed().as_secs_f64();
                let ends = fit.traces.each_ref().map(|trace| trace[trace.len() - 1]);
                let steps = fit.traces.each_ref().map(|trace| trace.len() - 1);
                println!("  {variant:?} {seconds:.2} s, objectives {ends:.4?} after {steps:?} steps");
                for starts in fit.starts.iter().filter(|starts| starts.len() > 1) {
                    println!("    starts {starts:.4?}");
                }
            }
        }
    }
    Ok(())
}
