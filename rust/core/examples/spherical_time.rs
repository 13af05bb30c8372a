//! Time of the spherical model, on one core: the look-up by itself, and evaluations against their
//! multiply-adds.
//!
//!     cargo run --release -p glimt-core --example spherical_time [TEXT]
//!
//! measures what has TEXT in its name, and without it everything.
//!
//! "Layers" is the network of a batch by itself, and "look-up" what a batch takes besides: directions to
//! features, and f from the network's output; it is small or negative where the first layer is in the tables. The
//! limit, the rounds and `single` are those of `kernel_time`.

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;
use glimt_core::kernels::network::{Activation, Layer, MAX_WIDTH, Network, Rows};
use glimt_core::models::spherical::pixelation::Pixelation::{self, Healpix, LatLong};
use glimt_core::models::spherical::store::{Codebook, Store};
use glimt_core::models::spherical::tables::Grids::{Hd, Iso, Lv};
use glimt_core::models::spherical::tables::Interpolation::{Bilinear, Constant, InverseDistance};
use glimt_core::models::spherical::tables::{Form, Grids, Interpolation, Layout};
use glimt_core::models::spherical::{Features, Spherical};
use glimt_core::simd::{Lane, Lanes, isa_name, multiply_adds};
use glimt_core::{Brdf, dispatch};
use half::f16;

const PAIRS: usize = 4096;
const ROUNDS: usize = 15;

/// Grids, points, N, k, weights of corners, width of the hidden layers, and bits of an index where there is a
/// codebook.
type Case = (Grids, Pixelation, u16, u8, Interpolation, usize, Option<u8>);

const CASES: [Case; 13] = [
    (Iso, Healpix, 32, 16, Bilinear, 16, None),
    (Iso, Healpix, 32, 16, Bilinear, 32, None),
    (Iso, Healpix, 32, 16, Bilinear, 64, None),
    (Iso, Healpix, 16, 8, Bilinear, 32, None),
    (Iso, Healpix, 32, 16, InverseDistance, 64, None),
    (Iso, Healpix, 32, 16, Constant, 64, None),
    (Iso, LatLong, 32, 16, Bilinear, 64, None),
    (Hd, Healpix, 32, 16, Bilinear, 64, None),
    (Lv, Healpix, 16, 16, Bilinear, 64, None),
    (Lv, Healpix, 64, 16, Bilinear, 64, None),
    (Lv, Healpix, 64, 16, Bilinear, 64, Some(9)),
    (Lv, Healpix, 64, 16, InverseDistance, 64, Some(9)),
    (Lv, Healpix, 64, 16, Constant, 64, Some(9)),
];

/// Random numbers within ±½.
fn random() -> impl FnMut() -> f32 {
    let mut state = 7u32;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    }
}

/// A material with two layers of this width between features and colours.
fn material(layout: &Arc<Layout>, width: usize, codebook: Option<u8>) -> Spherical {
    let form = layout.form();
    let mut next = random();
    let sizes = [form.inputs(), width, width, 3];
    let layers = sizes
        .windows(2)
        .map(|w| Layer {
            weight: (0..w[0] * w[1]).map(|_| next() * 2.0 / (w[0] as f32).sqrt()).collect(),
            bias: (0..w[1]).map(|_| next()).collect(),
        })
        .collect();
    let network = Arc::new(Network::new(layers, form.inputs(), Activation::HardGelu).unwrap());
    let (rows, k) = (layout.places().len(), usize::from(form.features));
    let store = match codebook {
        None => Store::F32((0..rows * k).map(|_| next()).collect()),
        Some(bits) => {
            let primitives = (0..k << bits).map(|_| f16::from_f32(next())).collect();
            let indices = (0..rows).map(|_| ((next() + 0.5) * f32::from(1u16 << bits)) as u16).collect();
            Store::Indexed { bits, indices, codebook: Arc::new(Codebook { primitives }) }
        }
    };
    Spherical::new(Arc::clone(layout), network, Features { store, links: None }, 5.0).unwrap()
}

dispatch! {
    /// The network for as many pairs as a batch has, in as many lanes as a batch.
    fn layers(isa, network: &Network, bias: &[Lane], sum: &mut f32) {
        match I::BATCH {
            4 => layers_of_lanes::<I, 4>(isa, network, bias, sum),
            8 => layers_of_lanes::<I, 8>(isa, network, bias, sum),
            16 => layers_of_lanes::<I, 16>(isa, network, bias, sum),
            _ => layers_of_lanes::<I, 32>(isa, network, bias, sum),
        }
    }
}

#[inline(always)]
fn layers_of_lanes<I: Lanes<L>, const L: usize>(isa: I, network: &Network, bias: &[Lane], sum: &mut f32) {
    let mut x = [[0.5; L]; MAX_WIDTH];
    for _ in 0..PAIRS / L {
        let mut y = Rows::default();
        network.forward_tile(isa, bias.as_flattened(), &x, &mut y);
        // The next ones wait for these, and are others.
        x[0][0] = y[0][0] * 1e-30;
        *sum += y[0][L - 1];
    }
}

fn direction(u: f32, v: f32) -> Vec3 {
    let (z, phi) = (0.03 + 0.97 * u.fract(), v.fract() * std::f32::consts::TAU);
    let r = (1.0 - z * z).sqrt();
    Vec3::new(r * phi.cos(), r * phi.sin(), z)
}

/// Six components of light and view, [component][pair].
type Sides = [Vec<f32>; 6];

/// All pairs, `width` in a call.
fn packets(material: &Spherical, width: usize, sides: &Sides, colours: &mut [Vec<f32>; 3]) {
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
    let chosen = std::env::args().nth(1).unwrap_or_default();
    println!("{}; ns per evaluation (x limit)", isa_name());
    for (grids, pixelation, nside, features, interpolation, width, codebook) in CASES {
        let table = codebook.map_or("f32".into(), |bits| format!("codebook {bits}"));
        let name =
            format!("{grids:?} {pixelation:?} N {nside} k {features} {table} {interpolation:?} {width}x2");
        if !name.contains(&chosen) {
            continue;
        }
        let nside = nside.try_into().unwrap();
        let form = Form { grids, pixelation, nside, nodes: 64, features, interpolation };
        let layout = Arc::new(Layout::new(form).unwrap());
        let material = material(&layout, width, codebook);
        let network = material.network();
        let bias = network.fold(&[]);
        let count = material.network().multiply_adds() * PAIRS;
        let mut times: [Vec<f64>; 6] = Default::default();
        for _ in 0..ROUNDS {
            let mut sum = 0.0;
            times[0].push(seconds(|| multiply_adds(count, &mut sum)));
            times[1].push(seconds(|| layers(network, &bias, &mut sum)));
            black_box(sum);
            times[2].push(seconds(|| material.eval_batch(&light, &view, &mut out)));
            black_box(&out);
            times[3].push(seconds(|| {
                let mut last = 0.0;
                for (&l, &v) in light.iter().zip(&view) {
                    last = material.eval(l, v + Vec3::splat(last * 1e-30)).x;
                }
                black_box(last);
            }));
            for (time, width) in times[4..].iter_mut().zip([8, 16]) {
                time.push(seconds(|| packets(&material, width, &sides, &mut colours)));
                black_box(&colours);
            }
        }
        let [limit, layers, batch, single, p8, p16] = times.map(|mut times| {
            times.sort_by(f64::total_cmp);
            times[ROUNDS / 2] * 1e9
        });
        println!(
            "{name}: limit {limit:.1}, batch {batch:.1} ({:.2}) = layers {layers:.1} + look-up {:.1}, \
             single {single:.1} ({:.2}), packets of 8 ({:.2}), 16 ({:.2})",
            batch / limit,
            batch - layers,
            single / limit,
            p8 / limit,
            p16 / limit,
        );
    }
}
