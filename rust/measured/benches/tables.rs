//! What looking f up costs, for `cargo bench -p glimt-measured`: measurements, and `factor` tables in batches and
//! pair by pair. The pairs are few enough for the caches and the same in every round.

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glimt_core::microfacet::Microfacet;
use glimt_core::models::factor::{
    Curve, DIFF_BINS, Factor, Factors, HALF_BINS, Interpolation as Between, Product,
};
use glimt_core::models::ggx::Ggx;
use glimt_core::{Brdf, SampleBrdf, Vec3};
use glimt_measured::Measured;
use glimt_measured::merl::{Interpolation, Merl};

const PAIRS: usize = 4096;

fn directions(steps: [f32; 2]) -> Vec<Vec3> {
    let direction = |i: usize| {
        let [z, turn] = steps.map(|step| (i as f32 * step).fract());
        let (r, phi) = ((1.0 - z * z).sqrt(), turn * std::f32::consts::TAU);
        Vec3::new(r * phi.cos(), r * phi.sin(), z)
    };
    (0..PAIRS).map(direction).collect()
}

/// A glossy material in every variant.
fn factors() -> [(&'static str, Factors); 4] {
    fn curve<const N: usize>(at: fn(f32) -> f32) -> Curve<N> {
        [std::array::from_fn(|i| at((i as f32 + 0.5) / N as f32)); 3]
    }
    let product = Product {
        diffuse: [0.05, 0.04, 0.03],
        specular: [2.0, 1.5, 1.0],
        ndf: curve(|x| (-20.0 * x.powi(4)).exp()),
        fresnel: curve(|x| 0.1 + 0.9 * x.powi(5)),
    };
    let (masking, azimuth) = (curve(|x| 1.0 - x.powi(4)), curve(|x| 0.8 + 0.2 * x));
    [
        ("independent-g", Factors::IndependentG { product: product.clone(), masking }),
        ("g-from-d", Factors::GFromD(product.clone())),
        ("naive", Factors::Naive { product, azimuth }),
        ("bivariate", Factors::Bivariate(vec![[0.1, 0.2, 0.3]; HALF_BINS * DIFF_BINS])),
    ]
}

fn tables(criterion: &mut Criterion) {
    let (light, view) = (directions([0.856_674_9, 0.733_891_9]), directions([0.628_706_7, 0.538_596_9]));
    let mut group = criterion.benchmark_group("tables");
    group.throughput(Throughput::Elements(PAIRS as u64));
    let mut f = vec![Vec3::ZERO; PAIRS];
    let mut measure = |name: &str, brdf: &dyn Brdf| {
        group.bench_function(format!("{name}, batch"), |bencher| {
            bencher.iter(|| brdf.eval_batch(&light, &view, black_box(&mut f)));
        });
        group.bench_function(format!("{name}, single"), |bencher| {
            bencher.iter(|| light.iter().zip(&view).map(|(&l, &v)| brdf.eval(l, v).x).sum::<f32>());
        });
    };
    for between in [Between::Nearest, Between::Linear] {
        for (name, factors) in factors() {
            let material = Factor::new(factors, between).expect("numbers are in range");
            measure(&format!("factor {name} {between:?}"), &material);
        }
    }
    let microfacet = Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5; 3], alpha: [0.2; 2] };
    let ggx = Ggx::new(microfacet).expect("parameters are in range");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [merl, rgl] = ["table.binary", "table.bsdf"].map(|name| folder.path().join(name));
    glimt_measured::write_merl(&merl, &ggx).expect("a file is written");
    glimt_measured::write_rgl(&rgl, &ggx, true, Default::default(), "").expect("a file is written");
    let open = |path: &Path| Merl::open(path).expect("it was just written");
    measure("merl nearest", &open(&merl).with_interpolation(Interpolation::Nearest));
    measure("merl linear", &open(&merl).with_interpolation(Interpolation::Linear));
    let material = Measured::open(&rgl).expect("it was just written").into_material();
    measure("rgl", &material);
    for (name, path) in [("merl, table", &merl), ("rgl, warp", &rgl)] {
        let material = Measured::open(path).expect("it was just written").into_material();
        group.bench_function(format!("sample of {name}"), |bencher| {
            bencher.iter(|| {
                view.iter().zip(&light).map(|(&v, &u)| material.sample(v, u.abs()).pdf).sum::<f32>()
            });
        });
    }
    group.finish();
}

criterion_group!(benches, tables);
criterion_main!(benches);
