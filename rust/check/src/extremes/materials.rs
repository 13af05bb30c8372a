//! Materials at the edges of what their numbers can be, a list for each kind.

use std::sync::Arc;

use glam::DVec3;
use glimt_core::directions::features::Inputs;
use glimt_core::directions::healpix::Healpix;
use glimt_core::kernels::network::{Activation, Layer, Network};
use glimt_core::microfacet::{self, ETA_RANGE, MIN_ALPHA, Microfacet};
use glimt_core::models::analytic::{Analytic, Parameters, Specular};
use glimt_core::models::factor::{self, Factor, Factors, Interpolation, Product, Variant};
use glimt_core::models::gated::texture::{Disk, Texture};
use glimt_core::models::gated::{self, Angles, Base, FEATURES, Gated, LATENT, Linear};
use glimt_core::models::ggx::Ggx;
use glimt_core::models::hybrid::{self, Composition, Form, Hybrid, MAX_BOUND};
use glimt_core::models::maps::{Filter, MAX_SLOPE, Maps, Texel};
use glimt_core::models::nbrdf::{self, Nbrdf};
use glimt_core::models::neural::{self, Neural, Shared};
use glimt_core::models::spherical::pixelation::Pixelation;
use glimt_core::models::spherical::store::Store;
use glimt_core::models::spherical::tables::{self, Grids, Layout};
use glimt_core::models::spherical::{self, Features, Spherical};
use glimt_core::models::tabulated::Tabulated;
use glimt_core::surface::{Layout as Levels, Pyramid, Wrap};

use super::pairs::direction;
use super::{Case, Extreme, measurements};

impl Extreme for Ggx {
    const BUDGET: f64 = 4.0;

    fn cases() -> Vec<Case> {
        let mut cases = Vec::new();
        let mut add = |name: String, microfacet| {
            let material = Ggx::new(microfacet).expect("parameters are in their ranges").into();
            cases.push(Case::new(name, material));
        };
        for alpha in [MIN_ALPHA, 1e-3, 1e-2, 0.1, 1.0] {
            for eta in [1.0, 1.0 + f32::EPSILON, 1.5, ETA_RANGE[1]] {
                let name = format!("alpha {alpha:e}, eta {eta}");
                add(name, Microfacet { kd: [0.0, 0.5, 1.0], eta: [eta; 3], alpha: [alpha; 2] });
            }
        }
        for alpha in [[MIN_ALPHA, 1.0], [1.0, MIN_ALPHA], [1e-3, 0.1]] {
            let name = format!("alpha {:e} by {:e}", alpha[0], alpha[1]);
            add(name, Microfacet { kd: [0.0; 3], eta: [1.0 + 1e-3, 2.0, 5.0], alpha });
        }
        // The narrowest lobe, and the narrowest in one direction.
        let narrow = [0, cases.len() - 3].map(|i| cases[i].sampled("table"));
        cases.extend(narrow);
        cases
    }

    fn reference(&self, light: DVec3, view: DVec3) -> Option<[f64; 3]> {
        Some(microfacet::reference::eval(self.microfacet(), light.into(), view.into()))
    }

    fn nudged(&self, nudge: &mut dyn FnMut(f32) -> f32) -> Option<Self> {
        Some(Ggx::new(nudged_microfacet(self.microfacet(), nudge)).expect(IN_RANGE))
    }
}

/// What may be extreme about a network.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Weights {
    /// Nothing.
    Ordinary,
    /// The latent code is a thousand times what fits find.
    LargeLatent,
    /// Every weight is the largest number of float16, of either sign.
    LargestHalf,
    /// Every weight is the smallest number of float16, of either sign.
    SmallestHalf,
    /// The exponent is far above its bound everywhere.
    AboveBound,
    /// The exponent is far below what exp can return everywhere.
    BelowFloor,
}

const WEIGHTS: [Weights; 6] = [
    Weights::Ordinary,
    Weights::LargeLatent,
    Weights::LargestHalf,
    Weights::SmallestHalf,
    Weights::AboveBound,
    Weights::BelowFloor,
];

impl Weights {
    /// A network of these sizes.
    fn network(self, sizes: &[usize], features: usize, activation: Activation) -> Network {
        let mut layers: Vec<Layer> = sizes
            .windows(2)
            .map(|w| {
                let scale = 2.0 / (w[0] as f32).sqrt();
                Layer { weight: self.numbers(w[0] * w[1], scale), bias: self.numbers(w[1], 1.0) }
            })
            .collect();
        let shift = match self {
            Weights::AboveBound => 1e4,
            Weights::BelowFloor => -1e4,
            _ => 0.0,
        };
        let last = layers.last_mut().expect("networks have layers");
        last.bias.iter_mut().for_each(|bias| *bias += shift);
        Network::new(layers, features, activation).expect("the sizes fit together")
    }

    /// Numbers of both signs that follow a fixed pattern.
    fn numbers(self, count: usize, scale: f32) -> Vec<f32> {
        const LARGEST_HALF: f32 = 65_504.0;
        const SMALLEST_HALF: f32 = 5.960_464_5e-8;
        // A linear congruential generator (Numerical Recipes, §7.1); its upper bits.
        let mut state = count as u32;
        (0..count)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let x = (state >> 8) as f32 / (1 << 24) as f32 - 0.5;
                match self {
                    Weights::LargestHalf => LARGEST_HALF.copysign(x),
                    Weights::SmallestHalf => SMALLEST_HALF.copysign(x),
                    _ => x * scale,
                }
            })
            .collect()
    }

    fn latent(self, size: usize) -> Vec<f32> {
        let scale = if self == Weights::LargeLatent { 1e3 } else { 1.0 };
        (0..size).map(|i| scale * (1.3 * i as f32).sin()).collect()
    }

    fn bound(self) -> f32 {
        if self == Weights::Ordinary { 2.0 } else { MAX_BOUND }
    }
}

/// A texel, and a tile whose facets are as different as facets can be; without a place, both are seen from afar.
impl Extreme for Maps {
    const BUDGET: f64 = 0.0;

    fn cases() -> Vec<Case> {
        let steep = Texel {
            kd: [0.0, 0.5, 1.0],
            f0: [0.0, 0.5, 1.0],
            alpha: MIN_ALPHA,
            slope: [MAX_SLOPE, -MAX_SLOPE],
        };
        let maps = |name: &str, texels: &[Texel], filter| {
            let maps = Maps::new(1, texels.iter().copied(), Wrap::Repeat, filter).expect("rows of one texel");
            Case::new(name.into(), maps.into())
        };
        vec![
            maps("one texel", &[PLAIN], Filter::Moments),
            maps("a steep texel", &[steep], Filter::Average),
            maps("steep and flat, averaged", &[steep, PLAIN, PLAIN], Filter::Average),
            maps("steep and flat, by moments", &[steep, PLAIN, PLAIN], Filter::Moments),
        ]
    }
}

/// Surfaces of one texel whose codes, textures, frames, warps and network are extreme; on maps, and alone.
impl Extreme for Gated {
    const BUDGET: f64 = 0.0;

    fn cases() -> Vec<Case> {
        let case = |base: Base, angles: Angles, weights: Weights| {
            let outputs = if base == Base::Maps { 6 } else { 3 };
            let disk = Disk { rings: 3, sectors: 2 };
            let texture = || {
                let numbers = weights.numbers(disk.texels() * angles.columns() * FEATURES, 1.0);
                Texture::new(disk, angles.columns(), numbers.as_chunks().0.to_vec()).expect(IN_RANGE)
            };
            let parts = gated::Parts {
                base,
                angles,
                maps: Maps::new(1, [PLAIN], Wrap::Repeat, Filter::Moments).expect("a texel"),
                latents: Pyramid::of_levels(
                    Levels::new([1, 1], Wrap::Repeat),
                    weights.latent(LATENT).as_chunks().0.to_vec(),
                )
                .expect("a texel"),
                frames: Some(linear(weights)),
                warps: Some(linear(weights)),
                half: texture(),
                difference: texture(),
                network: weights.network(
                    &[angles.inputs(), 16, outputs],
                    angles.inputs(),
                    Activation::HardGelu,
                ),
                bound: weights.bound(),
            };
            let material = Gated::new(parts).expect("the parts fit together");
            Case::new(format!("{base:?}, {angles:?}, {weights:?}"), material.into())
        };
        let forms = [(Base::Maps, Angles::Matrices), (Base::None, Angles::Vectors)];
        forms
            .into_iter()
            .flat_map(|(base, angles)| WEIGHTS.map(|weights| case(base, angles, weights)))
            .collect()
    }
}

fn linear<const N: usize>(weights: Weights) -> Linear<N> {
    let numbers = weights.numbers(N * (LATENT + 1), 0.5);
    let (rows, bias) = numbers.split_at(N * LATENT);
    Linear {
        weight: std::array::from_fn(|i| std::array::from_fn(|k| rows[i * LATENT + k])),
        bias: std::array::from_fn(|i| bias[i]),
    }
}

/// Grey plastic.
const PLAIN: Texel = Texel { kd: [0.3; 3], f0: [0.04; 3], alpha: 0.3, slope: [0.0; 2] };

impl Extreme for Hybrid {
    const BUDGET: f64 = 8.0;

    fn cases() -> Vec<Case> {
        const ALL_INPUTS: [Inputs; 5] = [
            Inputs::Cartesian,
            Inputs::Isotropic,
            Inputs::IsotropicReciprocal,
            Inputs::Anisotropic,
            Inputs::AnisotropicReciprocal,
        ];
        let isotropic = Form { inputs: Inputs::Isotropic, ..Form::PAPER };
        let mut cases = Vec::new();
        let mut add = |name: String, form: Form, weights: Weights, alpha: f32, eta: f32| {
            let features = form.features();
            let network = weights.network(
                &[features + 4, 16, 16, form.composition.outputs()],
                features,
                Activation::HardGelu,
            );
            let wide = if form.inputs.is_isotropic() { alpha } else { (2.0 * alpha).min(1.0) };
            let microfacet = Microfacet { kd: [0.0, 0.3, 1.0], eta: [eta; 3], alpha: [alpha, wide] };
            let material =
                Hybrid::new(form, Arc::new(network), microfacet, weights.latent(4), weights.bound());
            cases.push(Case::new(name, material.expect("the parts fit together").into()));
        };
        for inputs in ALL_INPUTS {
            add(format!("{inputs:?}"), Form { inputs, ..Form::PAPER }, Weights::Ordinary, 0.2, 1.5);
            add(
                format!("{inputs:?}, alpha 1e-4"),
                Form { inputs, ..Form::PAPER },
                Weights::Ordinary,
                MIN_ALPHA,
                10.0,
            );
        }
        for composition in [Composition::Additive, Composition::LogMultiplicative] {
            add(format!("{composition:?}"), Form { composition, ..isotropic }, Weights::Ordinary, 0.1, 1.5);
        }
        for weights in WEIGHTS {
            add(
                format!("{weights:?}, analytic input"),
                Form { analytic_input: true, ..isotropic },
                weights,
                1e-3,
                2.0,
            );
        }
        for weights in &WEIGHTS[1..] {
            for composition in
                [Composition::GatedResidual, Composition::Additive, Composition::LogMultiplicative]
            {
                add(
                    format!("{weights:?}, {composition:?}"),
                    Form { composition, ..isotropic },
                    *weights,
                    0.05,
                    1.5,
                );
            }
        }
        // Weights at the limit of float16: f as uneven as it can be.
        let uneven =
            cases.iter().find(|case| case.name.starts_with("LargestHalf")).map(|case| case.sampled("table"));
        cases.extend(uneven);
        cases
    }

    fn reference(&self, light: DVec3, view: DVec3) -> Option<[f64; 3]> {
        Some(hybrid::reference::eval(self, light, view))
    }

    fn nudged(&self, nudge: &mut dyn FnMut(f32) -> f32) -> Option<Self> {
        let network = Arc::new(nudged_network(self.network(), nudge));
        let microfacet = nudged_microfacet(self.microfacet(), nudge);
        let latent = self.latent().iter().map(|&z| nudge(z)).collect();
        Some(Hybrid::new(self.form(), network, microfacet, latent, self.bound()).expect(IN_RANGE))
    }
}

impl Extreme for Neural {
    const BUDGET: f64 = 4.0;

    fn cases() -> Vec<Case> {
        let case = |weights: Weights| {
            let sizes = [neural::FEATURES + 12, 16, 16, 3];
            let network = weights.network(&sizes, neural::FEATURES, Activation::HardGelu);
            let frames = Layer {
                weight: weights.numbers(neural::FRAME_OUTPUTS * 12, 0.3),
                bias: weights.numbers(neural::FRAME_OUTPUTS, 0.3),
            };
            let shared = Arc::new(Shared { network, frames });
            let material = Neural::new(shared, weights.latent(12), weights.bound());
            Case::new(format!("{weights:?}"), material.expect("the parts fit together").into())
        };
        WEIGHTS.map(case).into()
    }

    fn reference(&self, light: DVec3, view: DVec3) -> Option<[f64; 3]> {
        Some(neural::reference::eval(self, light, view))
    }

    fn nudged(&self, nudge: &mut dyn FnMut(f32) -> f32) -> Option<Self> {
        let network = nudged_network(&self.shared().network, nudge);
        let shared = Shared { network, frames: nudged_layer(&self.shared().frames, nudge) };
        let latent = self.latent().iter().map(|&z| nudge(z)).collect();
        Some(Neural::new(Arc::new(shared), latent, self.bound()).expect(IN_RANGE))
    }
}

impl Extreme for Nbrdf {
    const BUDGET: f64 = 4.0;

    fn cases() -> Vec<Case> {
        let case = |weights: Weights| {
            let sizes = [nbrdf::FEATURES, nbrdf::WIDTH, nbrdf::WIDTH, 3];
            let network = weights.network(&sizes, nbrdf::FEATURES, Activation::Relu);
            let material = Nbrdf::new(Arc::new(network)).expect("the parts fit together");
            Case::new(format!("{weights:?}"), material.into())
        };
        // These have no latent code.
        WEIGHTS.into_iter().filter(|&weights| weights != Weights::LargeLatent).map(case).collect()
    }

    fn reference(&self, light: DVec3, view: DVec3) -> Option<[f64; 3]> {
        Some(nbrdf::reference::eval(self, light, view))
    }

    fn nudged(&self, nudge: &mut dyn FnMut(f32) -> f32) -> Option<Self> {
        Some(Nbrdf::new(Arc::new(nudged_network(self.network(), nudge))).expect(IN_RANGE))
    }
}

impl Extreme for Factor {
    // A place among 90 bins takes 6 of a float's 24 bits.
    const BUDGET: f64 = 32.0;

    fn cases() -> Vec<Case> {
        /// The largest that the model takes.
        const MAX_SCALE: f32 = 1e12;
        fn curve<const N: usize>(at: fn(f32) -> f32) -> factor::Curve<N> {
            [std::array::from_fn(|i| at(i as f32 / N as f32)); 3]
        }
        let mut cases = Vec::new();
        let mut add = |name: &str, factors: Factors| {
            for interpolation in [Interpolation::Linear, Interpolation::Nearest] {
                let name = format!("{:?}, {interpolation:?}, {name}", factors.variant());
                let material =
                    Factor::new(factors.clone(), interpolation).expect("numbers are in their ranges");
                cases.push(Case::new(name, material.into()));
            }
        };
        let lobe = |x: f32| (-20.0 * x * x).exp();
        let specular = [MAX_SCALE, 0.0, 1.0];
        let product =
            Product { diffuse: [0.0, 0.1, MAX_SCALE], specular, ndf: curve(lobe), fresnel: curve(|x| x * x) };
        let black = Product { diffuse: [0.0; 3], specular, ndf: curve(|_| 0.0), fresnel: curve(|_| 0.0) };
        for (name, product) in [("largest", product), ("all zeros", black)] {
            add(name, Factors::GFromD(product.clone()));
            add(name, Factors::Naive { product: product.clone(), azimuth: curve(|x| 1.0 - x) });
            add(name, Factors::IndependentG { product, masking: curve(|x| 1.0 - x) });
        }
        let bins = factor::HALF_BINS * factor::DIFF_BINS;
        add(
            "steep",
            Factors::Bivariate((0..bins).map(|i| [MAX_SCALE * lobe(i as f32 / 500.0), 0.0, 1e-30]).collect()),
        );
        let tables: Vec<Case> = cases.iter().step_by(6).map(|case| case.sampled("table")).collect();
        cases.extend(tables);
        cases
    }

    /// Tables that are constant in each bin have none: their error at an edge is that of the bin.
    fn reference(&self, light: DVec3, view: DVec3) -> Option<[f64; 3]> {
        let form = self.form();
        let has_steps = form.variant == Variant::Naive || form.interpolation == Interpolation::Nearest;
        (!has_steps).then(|| factor::reference::eval(self, light, view))
    }
}

/// Evaluated in float64 itself.
impl Extreme for Analytic {
    const BUDGET: f64 = 0.0;

    fn cases() -> Vec<Case> {
        let scale = [1e6, 0.0, 1.0];
        let (tiny, large) = (f64::from(MIN_ALPHA), 1e6);
        let lobes = [
            Specular::CookTorrance { scale, reflectance: 0.0, roughness: tiny },
            Specular::CookTorrance { scale, reflectance: 1.0, roughness: large },
            Specular::Ward { scale, roughness: tiny },
            Specular::Ward { scale, roughness: large },
            Specular::AshikhminShirley { scale, reflectance: 0.04, sharpness: large },
            Specular::AshikhminShirley { scale, reflectance: 0.04, sharpness: 0.0 },
            Specular::LowMicrofacet { scale, slope: large, falloff: 5.0, eta: 1.0 },
            Specular::LowMicrofacet { scale, slope: large, falloff: -5.0, eta: 10.0 },
            Specular::ShiftedGamma {
                scale,
                alpha: [tiny, 1.0, large],
                power: [0.5, 50.0, -50.0],
                fresnel: [[0.04, 1.0, 0.0], [0.0, 1.0, -1.0]],
                norm: [1.0, large, 1.0],
                masking: [[1.0, 0.0, 5.0], [-1.0, 0.0, 300.0], [2.0, 0.0, -2.0], [0.5, 0.0, 0.0]],
            },
        ];
        lobes
            .into_iter()
            .map(|specular| {
                let name = format!("{specular:?}");
                let material = Analytic::new(Parameters { diffuse: [0.0, 0.5, 1.0], specular });
                Case::new(name, material.expect("parameters are in their ranges").into())
            })
            .collect()
    }
}

/// The pixel of a direction is found in float32. Beside an edge, where catalogues look, a reference may be in the next
/// one, where f is as good but not the same; away from edges the model's own tests compare them.
impl Extreme for Spherical {
    const BUDGET: f64 = 0.0;

    fn cases() -> Vec<Case> {
        let mut cases = Vec::new();
        let mut add = |name: String, form: tables::Form, weights: Weights| {
            let layout = Arc::new(Layout::new(form).expect("the form exists"));
            let network = weights.network(&[form.inputs(), 16, 16, 3], form.inputs(), Activation::HardGelu);
            // Smooth, as fits leave them.
            let row = |&(_, place): &(usize, DVec3)| {
                (0..form.features)
                    .map(move |j| (3.0 * place.dot(direction(0.5, f64::from(j)).as_dvec3())).sin() as f32)
            };
            let features =
                Features { store: Store::F32(layout.places().iter().flat_map(row).collect()), links: None };
            let bound = if weights == Weights::Ordinary { 6.0 } else { spherical::MAX_BOUND };
            let material = Spherical::new(layout, Arc::new(network), features, bound);
            cases.push(Case::new(name, material.expect("the parts fit together").into()));
        };
        let form = tables::Form {
            grids: Grids::Iso,
            pixelation: Pixelation::Healpix,
            nside: Healpix::try_from(8).expect("a power of two"),
            nodes: 40,
            features: 4,
            interpolation: tables::Interpolation::Bilinear,
        };
        for grids in [Grids::Lv, Grids::Hd, Grids::Iso] {
            for interpolation in [
                tables::Interpolation::Bilinear,
                tables::Interpolation::InverseDistance,
                tables::Interpolation::Constant,
            ] {
                let form = tables::Form { grids, interpolation, ..form };
                add(format!("{grids:?}, {interpolation:?}"), form, Weights::Ordinary);
            }
            // These have no latent code.
            for weights in WEIGHTS.into_iter().skip(2) {
                add(format!("{grids:?}, {weights:?}"), tables::Form { grids, ..form }, weights);
            }
        }
        add("LatLong".into(), tables::Form { pixelation: Pixelation::LatLong, ..form }, Weights::Ordinary);
        cases
    }
}

/// A measurement is the table that it is, and evaluated in float64 itself.
impl Extreme for Tabulated {
    const BUDGET: f64 = 0.0;

    fn cases() -> Vec<Case> {
        measurements::cases()
    }
}

/// What a nudge by an ULP leaves true.
const IN_RANGE: &str = "numbers stay in their ranges";

fn nudged_microfacet(p: &Microfacet, nudge: &mut dyn FnMut(f32) -> f32) -> Microfacet {
    Microfacet {
        kd: p.kd.map(&mut *nudge).map(|kd| kd.clamp(0.0, 1.0)),
        eta: p.eta.map(&mut *nudge).map(|eta| eta.clamp(ETA_RANGE[0], ETA_RANGE[1])),
        alpha: p.alpha.map(&mut *nudge).map(|alpha| alpha.clamp(MIN_ALPHA, 1.0)),
    }
}

/// A network with every weight and bias put through `nudge`.
fn nudged_network(network: &Network, nudge: &mut dyn FnMut(f32) -> f32) -> Network {
    let layers = network.layers().iter().map(|layer| nudged_layer(layer, nudge)).collect();
    Network::new(layers, network.features(), network.activation()).expect("the shape is that of a network")
}

/// [`nudged_network`] for one layer.
fn nudged_layer(layer: &Layer, nudge: &mut dyn FnMut(f32) -> f32) -> Layer {
    let mut nudge = |values: &[f32]| values.iter().map(|&x| nudge(x)).collect();
    Layer { weight: nudge(&layer.weight), bias: nudge(&layer.bias) }
}
