//! Time of a training step against the time of its multiply-adds alone, on one core.
//!
//!     RAYON_NUM_THREADS=1 cargo run --release -p glimt-fit --example step_time
//!
//! A step is twelve materials times 1024 pairs, forward, both losses, backward and AdamW, with the
//! cost of drawing pairs and of the materials' values left in. The limit is a loop of fused
//! multiply-adds in registers, as many as the network's three matrix products have. Rounds alternate;
//! medians are printed.

use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::Instant;

use glimt_core::library::Origin;
use glimt_core::microfacet::Microfacet;
use glimt_core::models::ggx::Ggx;
use glimt_core::simd::{isa_name, multiply_adds};
use glimt_fit::train::Schedule;
use glimt_fit::{HybridOptions, Input, Model, Net, Options, Truth, fit};

const MATERIALS: usize = 12;
const PAIRS: usize = 1024;
const STEPS: u64 = 300;
const ROUNDS: usize = 9;

fn main() {
    let materials: Vec<Ggx> = (1..=MATERIALS)
        .map(|i| Ggx::new(Microfacet { kd: [0.1; 3], eta: [1.5; 3], alpha: [0.05 * i as f32; 2] }).unwrap())
        .collect();
    println!("{}, {MATERIALS} materials x {PAIRS} pairs, one core", isa_name());
    for (width, layers) in [(16, 2), (32, 2), (32, 3), (64, 3)] {
        let network: usize = 10 * width + (layers - 1) * width * width + 6 * width;
        let count = 3 * network * MATERIALS * PAIRS;
        let mut times = [Vec::new(), Vec::new()];
        for _ in 0..ROUNDS {
            let mut sum = 0.0;
            let start = Instant::now();
            multiply_adds(count, &mut sum);
            black_box(sum);
            times[0].push(start.elapsed().as_secs_f64());
            times[1].push(step_time(&materials, Net { width, layers }));
        }
        let [limit, step] = times.map(|mut times| {
            times.sort_by(f64::total_cmp);
            times[ROUNDS / 2]
        });
        println!(
            "{width}x{layers}: limit {:.2} ms, step {:.2} ms = {:.0} steps/s, {:.1} x limit",
            limit * 1e3,
            step * 1e3,
            1.0 / step,
            step / limit
        );
    }
}

/// Seconds of one step, from a fit of [`STEPS`] of them; the start of the fit does not count.
fn step_time(materials: &[Ggx], net: Net) -> f64 {
    let inputs: Vec<Input> = materials
        .iter()
        .enumerate()
        .map(|(i, brdf)| Input {
            name: i.to_string(),
            truth: Truth::Brdf(brdf),
            isotropic: true,
            origin: Origin::default(),
        })
        .collect();
    let options = Options {
        model: Model::Hybrid(HybridOptions::shared(net, 4)),
        schedule: Schedule::standard(STEPS, 1),
    };
    let mut rate = 0.0;
    let outcome = fit(&inputs, &options, None, &mut |progress, _| {
        rate = progress.rate;
        ControlFlow::Continue(())
    });
    assert!(outcome.is_ok());
    1.0 / rate
}
