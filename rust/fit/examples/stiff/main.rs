//! Fits to materials that are hard to fit: the tables of `docs/notes/stiff-fits.md`, and the loss curves.
//!
//!     cargo run --release -p glimt-fit --example stiff -- [STEPS [CROWD]]
//!
//! Every case is fitted with every model and eight seeds, and with ten times and a tenth of the learning
//! rate. The curves go to `out/stiff-curves.csv`. Errors are means over 20,000 cosine-distributed pairs.

#![allow(missing_docs, reason = "a program")]

use std::fmt::Write;

use glimt_core::microfacet::Microfacet;
use glimt_fit::adamw::{AdamW, Moments, clip_norm, cosine_decay};
use glimt_fit::backprop::BLOCK;
use glimt_fit::ggx::GgxObjective;
use glimt_fit::objective::Objective;
use glimt_fit::options::DEFAULT_ANALYTIC_LOSS;
use glimt_fit::pairs::{Drawing, draw, evaluate};
use glimt_fit::{Model, analytic};

mod cases;
mod condition;
mod eigen;

use cases::{Run, cases, models, rate, run};
use condition::gauss_newton;
use eigen::{condition, scaled};

const PAIRS: usize = 20_000;
const SEEDS: u64 = 8;

fn main() -> std::io::Result<()> {
    let mut arguments = std::env::args().skip(1).map(|n| n.parse().expect("a number"));
    let steps = arguments.next().unwrap_or(2000);
    let crowd = arguments.next().unwrap_or(20);
    conditions();
    accumulators();
    fits(steps, crowd as usize)
}

fn conditions() {
    println!("condition of the Hessian of k_d, eta, alpha (squared loss)");
    println!("{:>8} {:>6} {:>8} {:>12} {:>12}", "k_d", "eta", "alpha", "as it is", "scaled");
    for (kd, eta, alpha) in [
        (0.2, 1.5, 0.3),
        (0.2, 1.5, 0.1),
        (0.2, 1.5, 0.01),
        (0.02, 1.5, 1e-3),
        (0.2, 1.02, 0.3),
        (0.2, 8.0, 0.3),
        (1e-3, 1.5, 0.3),
        (0.2, 1.5, 0.9),
    ] {
        let hessian = gauss_newton(&Microfacet { kd: [kd; 3], eta: [eta; 3], alpha: [alpha; 2] });
        let (plain, scaled) = (condition(&hessian), condition(&scaled(&hessian)));
        println!("{kd:>8} {eta:>6} {alpha:>8} {plain:>12.1e} {scaled:>12.1e}");
    }
}

/// The analytic fit with sums over blocks in float32, as it is done, and in float64.
fn accumulators() {
    println!("\nsums over blocks in float32 and in float64: parameters of the analytic fit after 1500 steps");
    for case in &cases(20)[..3] {
        let fits = [false, true].map(|wide| analytic_fit(&*case.materials[0], wide));
        let apart = fits[0].iter().zip(&fits[1]).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f32::max);
        println!("{:16} {:?}, apart at most {apart:.1e}", case.name, fits[0]);
    }
}

fn analytic_fit(brdf: &dyn glimt_core::Brdf, wide: bool) -> Vec<f32> {
    const STEPS: u64 = 1500;
    const BLOCKS: usize = 4;
    let objective = GgxObjective { loss: DEFAULT_ANALYTIC_LOSS, isotropic: true };
    let start = Microfacet { kd: [0.2; 3], eta: [1.5; 3], alpha: [0.05; 2] };
    let mut numbers = analytic::from_parameters(&start, true);
    let mut moments = Moments::new(numbers.len(), 0);
    let pairs = draw(Drawing::Lobes, 1, 0, 256);
    let targets = evaluate(brdf, &pairs);
    let mut workspace = objective.workspace();
    for step in 1..=STEPS {
        let (mut narrow_sum, mut wide_sum) = (vec![0.0_f32; numbers.len()], vec![0.0_f64; numbers.len()]);
        for block in 0..BLOCKS {
            let at = (step as usize * BLOCKS + block) % pairs.len();
            let mut part = objective.zero_gradient();
            objective.block(&mut workspace, &[], &numbers, &pairs[at], &targets[at], &mut part);
            for ((narrow, wide), part) in narrow_sum.iter_mut().zip(&mut wide_sum).zip(part.own) {
                *narrow += part;
                *wide += f64::from(part);
            }
        }
        let mut gradient: Vec<f32> =
            if wide { wide_sum.iter().map(|&g| g as f32).collect() } else { narrow_sum };
        gradient.iter_mut().for_each(|g| *g /= (BLOCKS * BLOCK * 3) as f32);
        clip_norm(&mut gradient, f32::INFINITY);
        let adamw = AdamW { beta2: 0.99, weight_decay: 0.0, ..AdamW::PAPER };
        let rate = cosine_decay(0.05, step - 1, STEPS);
        let means = moments.of(0..gradient.len());
        adamw.update(&mut numbers, &gradient, means, step, rate, |_| false);
    }
    let p = analytic::to_parameters(&numbers);
    vec![p.kd[0], p.eta[0], p.alpha[0]]
}

fn fits(steps: u64, crowd: usize) -> std::io::Result<()> {
    println!(
        "\nfits of {steps} steps; log-MAE: median of {SEEDS} seeds, least to most; rates with the first seed"
    );
    println!(
        "{:16} {:8} {:>9} {:>20} {:>8} {:>10} {:>10} {:>12} {:>8}",
        "case", "model", "log-MAE", "over seeds", "SMAPE", "rate x10", "rate /10", "worst of all", "alpha"
    );
    let mut curves = "case,model,variant,step,loss\n".to_owned();
    for case in cases(crowd) {
        for (name, model) in models() {
            // The analytic fit has a rate and steps of its own.
            let alone = matches!(model, Model::Ggx(_));
            let mut keep = |variant: &str, run: &Run| {
                for (step, loss) in &run.curve {
                    writeln!(curves, "{},{name},{variant},{step},{loss}", case.name).expect("a string");
                }
            };
            let fitted = |seed, factor: f32| run(&case, &model, steps, seed, factor * rate(&model), PAIRS);
            let runs: Vec<Run> = (1..=SEEDS).map(|seed| fitted(seed, 1.0)).collect();
            runs.iter().enumerate().for_each(|(i, run)| keep(&format!("seed {}", i + 1), run));
            if let Some(failure) = runs.iter().find_map(|run| run.failure.as_ref()) {
                println!("{:16} {name:8} {failure}", case.name);
                continue;
            }
            let mut errors: Vec<f64> = runs.iter().map(|run| run.log_mae).collect();
            errors.sort_by(f64::total_cmp);
            let other = |factor: f32| {
                let run = fitted(1, factor);
                let text = run.failure.clone().map_or(format!("{:.5}", run.log_mae), |_| "diverged".into());
                (text, run)
            };
            let [fast, slow] = if alone {
                ["-".to_owned(), "-".to_owned()]
            } else {
                [("rate x10", 10.0), ("rate /10", 0.1)].map(|(variant, factor)| {
                    let (text, run) = other(factor);
                    keep(variant, &run);
                    text
                })
            };
            let last = &runs[0].entries[case.materials.len() - 1].material;
            let alpha = last.microfacet().map_or("-".to_owned(), |p| format!("{:.5}", p.alpha[0]));
            println!(
                "{:16} {name:8} {:>9.5} {:>20} {:>8.4} {fast:>10} {slow:>10} {:>12.5} {alpha:>8}",
                case.name,
                errors[errors.len() / 2],
                format!("{:.5} to {:.5}", errors[0], errors[errors.len() - 1]),
                runs[0].smape,
                runs.iter().map(|run| run.worst).fold(0.0, f64::max)
            );
        }
    }
    std::fs::create_dir_all("out")?;
    std::fs::write("out/stiff-curves.csv", curves)
}
