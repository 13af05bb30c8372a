//! The kernels that renderers spend their time in, for `cargo bench -p glimt-core`.
//!
//! `glimt bench` holds the same work against the multiply-adds alone; this is for watching a kernel while one
//! changes it.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glimt_core::directions::features::Inputs;
use glimt_core::kernels::network::{Activation, Layer, Network};
use glimt_core::microfacet::Microfacet;
use glimt_core::models::hybrid::{Form, Hybrid};
use glimt_core::{Brdf, SampleBrdf, Vec3};

const PAIRS: usize = 4096;

/// A hybrid of the given width with three hidden layers.
fn hybrid(width: usize) -> glimt_core::Material {
    let form = Form { inputs: Inputs::Isotropic, ..Form::PAPER };
    let sizes = [form.features() + 4, width, width, width, 6];
    let layers = sizes.windows(2).map(|pair| Layer {
        weight: (0..pair[0] * pair[1]).map(|i| (i as f32 * 1.7).sin() / (pair[0] as f32).sqrt()).collect(),
        bias: vec![0.05; pair[1]],
    });
    let network = Network::new(layers.collect(), form.features(), Activation::HardGelu).expect("layers fit");
    let microfacet = Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5; 3], alpha: [0.2; 2] };
    Hybrid::new(form, Arc::new(network), microfacet, vec![0.1; 4], 2.0)
        .expect("parameters are in range")
        .into()
}

fn directions(steps: [f32; 2]) -> Vec<Vec3> {
    let direction = |i: usize| {
        let [z, turn] = steps.map(|step| (i as f32 * step).fract());
        let (r, phi) = ((1.0 - z * z).sqrt(), turn * std::f32::consts::TAU);
        Vec3::new(r * phi.cos(), r * phi.sin(), z)
    };
    (0..PAIRS).map(direction).collect()
}

fn kernels(criterion: &mut Criterion) {
    let (light, view) = (directions([0.856_674_9, 0.733_891_9]), directions([0.628_706_7, 0.538_596_9]));
    let mut f = vec![Vec3::ZERO; PAIRS];
    let mut group = criterion.benchmark_group("hybrid");
    group.throughput(Throughput::Elements(PAIRS as u64));
    for width in [16, 32, 64] {
        let material = hybrid(width);
        group.bench_function(format!("batch {width}x3"), |bencher| {
            bencher.iter(|| material.eval_batch(&light, &view, black_box(&mut f)));
        });
        group.bench_function(format!("single {width}x3"), |bencher| {
            bencher.iter(|| light.iter().zip(&view).map(|(&l, &v)| material.eval(l, v).x).sum::<f32>());
        });
    }
    let material = hybrid(32);
    group.bench_function("sample 32x3", |bencher| {
        bencher.iter(|| view.iter().zip(&light).map(|(&v, &u)| material.sample(v, u.abs()).pdf).sum::<f32>());
    });
    group.finish();
}

criterion_group!(benches, kernels);
criterion_main!(benches);
