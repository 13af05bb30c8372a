//! Runs every material of the catalogue of extreme inputs on all of its pairs, and prints the worst
//! errors by family and model.
//!
//!     cargo run --release -p glimt-check --example catalogue

use glimt_check::accuracy::Worst;
use glimt_check::extremes::{Part, families, parts};
use glimt_check::stability::run;
use rayon::prelude::*;

fn main() {
    let families = families();
    let (mut violations, mut firsts) = (0, Vec::new());
    let mut details = Vec::new();
    println!("| model | family | values | largest error, ULP | relative | condition, ULP | worst blame |");
    println!("|---|---|---|---|---|---|---|");
    for Part { kind, cases, .. } in parts() {
        let outcomes: Vec<_> = cases().into_par_iter().map(|case| run(&case, &families)).collect();
        let mut worst = vec![Worst::default(); families.len()];
        for outcome in outcomes {
            firsts.extend(outcome.violations.first().cloned());
            violations += outcome.violations.len();
            worst.iter_mut().zip(outcome.errors).for_each(|(worst, errors)| worst.merge(errors));
        }
        for (family, worst) in families.iter().zip(worst).filter(|(_, worst)| worst.count > 0) {
            let Worst { count, error, blamed } = &worst;
            println!(
                "| {} | {} | {count} | {:.2e} | {:.1e} | {:.2e} | {:.2} |",
                kind,
                family.name,
                error.ulp,
                error.relative,
                error.condition,
                blamed.blame()
            );
            details.push(format!(
                "{}, {}\n  largest error: {error}\n  worst blame: {blamed}",
                kind, family.name
            ));
        }
    }
    println!("\n{}\n", details.join("\n"));
    println!("{violations} violations");
    for first in &firsts {
        println!("  {first}");
    }
    std::process::exit(i32::from(violations > 0));
}
