//! Times fits of factor tables to every material of a model library, and shows how they end.
//!
//!     cargo run --release -p glimt-fit --example factor_fit LIB.safetensors [SEED ...]
//!
//! Seeds decide about the random starts of independent G; with several, the spread of the objectives at the end
//! is printed, per channel the largest over the smallest.

use std::time::Instant;

use glimt_core::models::factor::{Interpolation, Variant};
use glimt_core::{Library, Material};
use glimt_fit::{FactorFit, FactorOptions, fit_factor};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let library = Library::open(arguments.next().ok_or("a model library is missing")?)?;
    let seeds: Vec<u64> = arguments.map(|seed| seed.parse()).collect::<Result<_, _>>()?;
    let mut seconds = [const { Vec::new() }; 4];
    for entry in library.entries() {
        println!("{}", entry.name);
        let variants = [Variant::Bivariate, Variant::Naive, Variant::GFromD, Variant::IndependentG];
        for (variant, seconds) in variants.into_iter().zip(&mut seconds) {
            let fit = timed(&entry.material, variant, seeds.first().copied().unwrap_or(0), seconds);
            if variant == Variant::IndependentG && seeds.len() > 1 {
                let others = seeds[1..].iter().map(|&seed| timed(&entry.material, variant, seed, seconds));
                let ends: Vec<[f64; 3]> = std::iter::once(fit).chain(others).map(|fit| ends(&fit)).collect();
                let spread = [0, 1, 2].map(|channel| {
                    let of_channel = ends.iter().map(|ends| ends[channel]);
                    of_channel.clone().fold(0.0, f64::max) / of_channel.fold(f64::INFINITY, f64::min)
                });
                println!("    spread over {} seeds {spread:.4?}", seeds.len());
            }
        }
    }
    for (variant, seconds) in ["bivariate", "naive", "g-from-d", "independent-g"].iter().zip(&mut seconds) {
        seconds.sort_by(f64::total_cmp);
        println!(
            "{variant}: median {:.2} s, at most {:.2} s",
            seconds[seconds.len() / 2],
            seconds[seconds.len() - 1]
        );
    }
    Ok(())
}

fn timed(material: &Material, variant: Variant, seed: u64, seconds: &mut Vec<f64>) -> FactorFit {
    let start = Instant::now();
    let fit = fit_factor(material, &FactorOptions { variant, interpolation: Interpolation::Nearest, seed });
    seconds.push(start.elapsed().as_secs_f64());
    let steps = fit.traces.each_ref().map(|trace| trace.len() - 1);
    let golden = fit.golden_sections;
    println!(
        "  {variant:?} {:.2} s, objectives {:.4?} after {steps:?} steps, {golden:?} by golden section",
        seconds[seconds.len() - 1],
        ends(&fit)
    );
    fit
}

/// The objective of each channel at the end.
fn ends(fit: &FactorFit) -> [f64; 3] {
    fit.traces.each_ref().map(|trace| trace[trace.len() - 1])
}
