//! Time of an evaluation against the time of its multiply-adds alone, on one core.
//!
//!     cargo run --release -p glimt-core --example kernel_time
//!
//! The limit is a loop of fused multiply-adds in registers, as many as the network has with z folded
//! away, in the instruction set that the kernels use (`GLIMT_ISA` chooses another). Rounds alternate;
//! medians are printed. `single` calls depend on each other's results, so that a call's whole latency counts.

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;
use glimt_core::Brdf;
use glimt_core::directions::features::Inputs;
use glimt_core::kernels::network::{Activation, Layer, Network};
use glimt_core::microfacet::Microfacet;
use glimt_core::models::hybrid::{Form, Hybrid};
use glimt_core::simd::{isa_name, multiply_adds};

const PAIRS: usize = 4096;
const ROUNDS: usize = 21;

fn material(inputs: Inputs, width: usize, layers: usize) -> Hybrid {
    let mut state = 7u32;
    let mut next = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    let form = Form { inputs, ..Form::PAPER };
    let mut sizes = vec![width; layers + 2];
    sizes[0] = form.features() + 4;
    sizes[layers + 1] = 6;
    let layers = sizes
        .windows(2)
        .map(|w| Layer {
            weight: (0..w[0] * w[1]).map(|_| next() * 2.0 / (w[0] as f32).sqrt()).collect(),
            bias: (0..w[1]).map(|_| next()).collect(),
        })
        .collect();
    let network = Arc::new(Network::new(layers, form.features(), Activation::HardGelu).unwrap());
    let microfacet = Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5, 1.8, 2.5], alpha: [0.2; 2] };
    Hybrid::new(form, network, microfacet, vec![0.1, -0.2, 0.3, 0.4], 2.0).unwrap()
}

fn direction(u: f32, v: f32) -> Vec3 {
    let (z, phi) = (0.03 + 0.97 * u.fract(), v.fract() * std::f32::consts::TAU);
    let r = (1.0 - z * z).sqrt();
    Vec3::new(r * phi.cos(), r * phi.sin(), z)
}

/// Six components of light and view, [component][pair].
type Sides = [Vec<f32>; 6];

/// All pairs, `width` in a call.
fn packets(material: &Hybrid, width: usize, sides: &Sides, colours: &mut [Vec<f32>; 3]) {
    for start in (0..PAIRS).step_by(width) {
        let side = |first: usize| [0, 1, 2].map(|c| &sides[first + c][start..start + width]);
        let out = colours.each_mut().map(|c| &mut c[start..start + width]);
        material.eval_packet(side(0), side(3), out);
    }
}

fn seconds(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64() / PAIRS as f64
}

fn main() {
    let light: Vec<Vec3> = (0..PAIRS).map(|i| i as f32).map(|i| direction(i * 0.8566, i * 0.7339)).collect();
    let view: Vec<Vec3> = (0..PAIRS).map(|i| i as f32).map(|i| direction(i * 0.6287, i * 0.5386)).collect();
    let mut out = vec![Vec3::ZERO; PAIRS];
    let sides: Sides = [0, 1, 2, 3, 4, 5].map(|c| {
        let side = if c < 3 { &light } else { &view };
        side.iter().map(|v| v[c % 3]).collect()
    });
    let mut colours = [0; 3].map(|_| vec![0.0; PAIRS]);
    println!("{}; ns per evaluation (x limit)", isa_name());
    for inputs in [Inputs::Isotropic, Inputs::Cartesian] {
        for (width, layers) in [(16, 3), (32, 3), (64, 3)] {
            let material = material(inputs, width, layers);
            let count = material.network().multiply_adds() * PAIRS;
            let mut times: [Vec<f64>; 6] = Default::default();
            for _ in 0..ROUNDS {
                let mut sum = 0.0;
                times[0].push(seconds(|| multiply_adds(count, &mut sum)));
                black_box(sum);
                times[1].push(seconds(|| material.eval_batch(&light, &view, &mut out)));
                black_box(&out);
                times[2].push(seconds(|| {
                    let mut last = 0.0;
                    for (&l, &v) in light.iter().zip(&view) {
                        last = material.eval(l, v + Vec3::splat(last * 1e-30)).x;
                    }
                    black_box(last);
                }));
                for (time, width) in times[3..].iter_mut().zip([4, 8, 16]) {
                    time.push(seconds(|| packets(&material, width, &sides, &mut colours)));
                    black_box(&colours);
                }
            }
            let [limit, batch, single, p4, p8, p16] = times.map(|mut times| {
                times.sort_by(f64::total_cmp);
                times[ROUNDS / 2] * 1e9
            });
            println!(
                "{inputs:?} {width}x{layers}: limit {limit:.1}, batch {batch:.1} ({:.2}), single {single:.1} ({:.2}), packets of 4 ({:.2}), 8 ({:.2}), 16 ({:.2})",
                batch / limit,
                single / limit,
                p4 / limit,
                p8 / limit,
                p16 / limit,
            );
        }
    }
}
