//! The catalogue of extreme inputs: pairs of directions and materials at the edges of what they can
//! be, by name. Every model and every face is run on all of it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec3, Vec3};
use glimt_core::analytic::{Analytic, Parameters, Specular};
use glimt_core::factor::{self, Factor, Factors, Interpolation, Product, Variant};
use glimt_core::features::Inputs;
use glimt_core::ggx::Ggx;
use glimt_core::healpix::Healpix;
use glimt_core::hybrid::{self, Composition, Form, Hybrid, MAX_BOUND};
use glimt_core::library::{Entry, Origin};
use glimt_core::microfacet::{self, ETA_RANGE, MIN_ALPHA, Microfacet};
use glimt_core::nbrdf::{self, Nbrdf};
use glimt_core::network::{Activation, Layer, Network};
use glimt_core::neural::{self, Neural, Shared};
use glimt_core::sampler::SamplerChoice;
use glimt_core::spherical::pixelation::Pixelation;
use glimt_core::spherical::store::Store;
use glimt_core::spherical::tables::{self, Grids, Layout};
use glimt_core::spherical::{self, Features, Spherical};
use glimt_core::tabulated::Tabulated;
use glimt_core::{Library, Material, Model};

use crate::measurements;
use crate::stability::{nudged_layer, nudged_network};

/// A light and a view.
pub type Pair = (Vec3, Vec3);

/// Pairs that are extreme in the same way.
pub struct Family {
    /// What is extreme about them.
    pub name: &'static str,
    /// The pairs.
    pub pairs: Vec<Pair>,
}

/// A material that is extreme in some way.
#[derive(Clone)]
pub struct Case {
    /// What is extreme about it.
    pub name: String,
    /// The material.
    pub material: Material,
    /// Its sampler as commands and scenes ask for it; empty for the one that it comes with.
    pub sampler: &'static str,
    /// The file of a measurement; models are saved as libraries.
    pub file: Option<MeasuredFile>,
}

/// A measurement's file.
#[derive(Clone)]
pub struct MeasuredFile {
    /// That of its name, by which the format is told where its content does not.
    pub extension: &'static str,
    /// Its content.
    pub bytes: Vec<u8>,
}

impl Case {
    /// A material with its own sampler.
    #[must_use]
    pub fn new(name: String, material: Material) -> Case {
        Case { name, material, sampler: "", file: None }
    }

    /// The same material with another sampler, see [`SamplerChoice`].
    ///
    /// # Panics
    /// If there is no such sampler.
    #[must_use]
    pub fn sampled(&self, sampler: &'static str) -> Case {
        let choice: SamplerChoice = sampler.parse().expect("the name of a sampler");
        let name = format!("{}, sampled by {sampler}", self.name);
        Case { name, material: self.material.with_sampler(choice), sampler, file: self.file.clone() }
    }
}

/// A kind of model.
pub struct Kind {
    /// As files and commands spell it.
    pub name: &'static str,
    /// Its materials of the catalogue.
    pub cases: fn() -> Vec<Case>,
    /// Largest [`blame`](crate::accuracy::Comparison::blame) that it is allowed.
    pub budget: f64,
}

/// Every kind of model. A new one is covered by a line here and its reference in [`reference`].
pub const KINDS: [Kind; 8] = [
    Kind { name: Ggx::KIND, cases: ggx_cases, budget: 4.0 },
    Kind { name: Hybrid::KIND, cases: hybrid_cases, budget: 8.0 },
    Kind { name: Neural::KIND, cases: neural_cases, budget: 4.0 },
    Kind { name: Nbrdf::KIND, cases: nbrdf_cases, budget: 4.0 },
    // A place among 90 bins takes 6 of a float's 24 bits.
    Kind { name: Factor::KIND, cases: factor_cases, budget: 32.0 },
    Kind { name: Analytic::KIND, cases: analytic_cases, budget: 0.0 },
    Kind { name: Spherical::KIND, cases: spherical_cases, budget: 0.0 },
    Kind { name: Tabulated::KIND, cases: measurements::cases, budget: 0.0 },
];

/// f of a pair above the horizon by the model's float64 reference; `None` for kinds that have
/// none, and tables that are constant in each bin, whose error at an edge is that of the bin.
#[must_use]
pub fn reference(material: &Material, light: DVec3, view: DVec3) -> Option<[f64; 3]> {
    let f = match material {
        Material::Ggx(m) => microfacet::reference::eval(m.microfacet(), light.into(), view.into()),
        Material::Hybrid(m) => hybrid::reference::eval(m, light, view),
        Material::Neural(m) => neural::reference::eval(m, light, view),
        Material::Nbrdf(m) => nbrdf::reference::eval(m, light, view),
        Material::Factor(m) => {
            let form = m.form();
            if form.variant == Variant::Naive || form.interpolation == Interpolation::Nearest {
                return None;
            }
            factor::reference::eval(m, light, view)
        }
        // The pixel of a direction is found in float32. Beside an edge, where catalogues look, the reference may be
        // in the next one, where f is as good but not the same; away from edges the model's own tests compare them.
        Material::Spherical(_) => return None,
        // A measurement is the table that it is, and these are evaluated in float64 themselves.
        Material::Tabulated(_) | Material::Analytic(_) => return None,
    };
    Some(f)
}

/// The material with each of its numbers put through `nudge`, which moves them by an ULP; `None` for
/// a model whose numbers do not enter sums.
#[must_use]
pub fn nudged(material: &Material, nudge: &mut dyn FnMut(f32) -> f32) -> Option<Material> {
    let nudged_microfacet = |m: &Microfacet, nudge: &mut dyn FnMut(f32) -> f32| Microfacet {
        kd: m.kd.map(&mut *nudge).map(|kd| kd.clamp(0.0, 1.0)),
        eta: m.eta.map(&mut *nudge).map(|eta| eta.clamp(ETA_RANGE[0], ETA_RANGE[1])),
        alpha: m.alpha.map(&mut *nudge).map(|alpha| alpha.clamp(MIN_ALPHA, 1.0)),
    };
    let nudged: Result<Material, String> = match material {
        Material::Ggx(m) => Ggx::new(nudged_microfacet(m.microfacet(), nudge)).map(Material::from),
        Material::Hybrid(m) => {
            let network = Arc::new(nudged_network(m.network(), nudge));
            let microfacet = nudged_microfacet(m.microfacet(), nudge);
            let latent = m.latent().iter().map(|&z| nudge(z)).collect();
            Hybrid::new(m.form(), network, microfacet, latent, m.bound()).map(Material::from)
        }
        Material::Neural(m) => {
            let network = nudged_network(&m.shared().network, nudge);
            let shared = Shared { network, frames: nudged_layer(&m.shared().frames, nudge) };
            let latent = m.latent().iter().map(|&z| nudge(z)).collect();
            Neural::new(Arc::new(shared), latent, m.bound()).map(Material::from)
        }
        Material::Nbrdf(m) => Nbrdf::new(Arc::new(nudged_network(m.network(), nudge))).map(Material::from),
        Material::Factor(_) | Material::Analytic(_) | Material::Tabulated(_) | Material::Spherical(_) => {
            return None;
        }
    };
    Some(nudged.expect("numbers stay in their ranges"))
}

/// Writes every material of the catalogue to `directory` as a file of its own, which it names: a measurement
/// in its format, a model as a library. Its sampler is not in the file.
///
/// # Errors
/// [`glimt_core::Error::Write`].
pub fn save_files(directory: &Path) -> Result<Vec<(PathBuf, Case)>, glimt_core::Error> {
    let mut saved = Vec::new();
    for kind in KINDS {
        for (i, case) in (kind.cases)().into_iter().enumerate() {
            let path = directory.join(format!("{}-{i}", kind.name));
            let path = if let Some(MeasuredFile { extension, bytes }) = &case.file {
                let path = path.with_extension(extension);
                let written = std::fs::write(&path, bytes);
                written.map_err(|source| glimt_core::Error::Write { path: path.clone(), source })?;
                path
            } else {
                let path = path.with_extension("safetensors");
                let (name, material) = (case.name.clone(), case.material.clone());
                Library::new(&path, vec![Entry { name, material, origin: Origin::default() }])?.save()?;
                path
            };
            saved.push((path, case));
        }
    }
    Ok(saved)
}

/// Cosines from the normal to the horizon: the last are the smallest normal number and denormals.
const COSINES: [f32; 17] = [
    1.0,
    0.999_999_9,
    0.999,
    0.5,
    0.1,
    1e-2,
    1e-3,
    1e-4,
    1e-5,
    1e-7,
    1e-10,
    1e-15,
    1e-20,
    1e-30,
    f32::MIN_POSITIVE,
    1e-42,
    1e-45,
];

/// Azimuths on the axes, between them, and where neither component is exact.
const AZIMUTHS: [f64; 5] = [0.0, 0.25, 0.7, std::f64::consts::FRAC_PI_2, 4.0];

/// Angles between the half vector and the normal, around the narrowest lobe.
const TILTS: [f64; 9] = [1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 1e-2, 0.1];

/// The direction of a cosine and an azimuth, rounded to float32.
fn direction(cos: f32, azimuth: f64) -> Vec3 {
    let z = f64::from(cos);
    let r = ((1.0 - z) * (1.0 + z)).sqrt();
    let v = DVec3::new(r * azimuth.cos(), r * azimuth.sin(), z).as_vec3();
    // The cosine as it is: rounding the vector must not move it.
    Vec3::new(v.x, v.y, cos)
}

/// `v` mirrored at the normal, exactly.
fn mirrored(v: Vec3) -> Vec3 {
    Vec3::new(-v.x, -v.y, v.z)
}

/// Directions of the whole hemisphere, evenly.
fn hemisphere(count: usize) -> Vec<Vec3> {
    // The R2 sequence (Roberts 2018).
    let point = |i: usize| {
        let i = i as f64 + 0.5;
        ((i * 0.754_877_666) % 1.0, (i * 0.569_840_291) % 1.0)
    };
    (0..count).map(point).map(|(z, phi)| direction(z as f32, phi * std::f64::consts::TAU)).collect()
}

/// The families of pairs.
#[must_use]
pub fn families() -> Vec<Family> {
    let family = |name, pairs| Family { name, pairs };
    vec![
        family("ordinary", ordinary()),
        family("grazing", grazing()),
        family("mirror pairs", mirror_pairs()),
        family("near mirror pairs", near_mirror_pairs()),
        family("light = view", retro_pairs()),
        family("light = -view", opposite_pairs()),
        family("no half vector", without_half_vector()),
        family("poles", poles()),
        family("lengths off by 1e-3", off_lengths()),
        family("denormals", denormals()),
        family("signed zeros", signed_zeros()),
        family("infinities", specials(&[f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN])),
        family("NaN", specials(&[f32::NAN, -f32::NAN])),
        family("no directions", no_directions()),
    ]
}

fn ordinary() -> Vec<Pair> {
    let directions = hemisphere(24);
    directions.iter().enumerate().map(|(i, &l)| (l, directions[(7 * i + 3) % 24])).collect()
}

fn grazing() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for light in COSINES.map(|cos| direction(cos, 0.4)) {
        for view in
            COSINES.into_iter().zip(AZIMUTHS.into_iter().cycle()).map(|(cos, phi)| direction(cos, phi))
        {
            pairs.push((light, view));
        }
        pairs.push((light, Vec3::new(0.6, 0.8, 0.0)));
        pairs.push((Vec3::new(0.6, 0.8, 0.0), light));
    }
    pairs
}

fn mirror_pairs() -> Vec<Pair> {
    let views = COSINES.into_iter().flat_map(|cos| AZIMUTHS.map(|phi| direction(cos, phi)));
    views.map(|view| (mirrored(view), view)).collect()
}

fn near_mirror_pairs() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for cos in [0.999_f32, 0.7, 0.1, 1e-2, 1e-4] {
        for tilt in TILTS {
            for phi in [0.0, 1.2] {
                let view = direction(cos, 0.3).as_dvec3();
                let half = DVec3::new(tilt.sin() * f64::cos(phi), tilt.sin() * f64::sin(phi), tilt.cos());
                let light = 2.0 * view.dot(half) * half - view;
                pairs.push((light.as_vec3(), view.as_vec3()));
            }
        }
    }
    pairs
}

fn retro_pairs() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for view in COSINES.into_iter().flat_map(|cos| AZIMUTHS.map(|phi| direction(cos, phi))) {
        pairs.push((view, view));
        // The neighbour in float32.
        pairs.push((Vec3::new(view.x.next_up(), view.y, view.z), view));
        pairs.push((Vec3::new(view.x, view.y, view.z.next_down()), view));
    }
    pairs
}

fn opposite_pairs() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for view in COSINES.into_iter().flat_map(|cos| AZIMUTHS.map(|phi| direction(cos, phi))) {
        pairs.push((-view, view));
        pairs.push((view, -view));
        // As nearly opposite as two directions above the horizon can be.
        for z in [1e-3, 1e-20, f32::MIN_POSITIVE, 1e-45] {
            pairs.push((Vec3::new(-view.x, -view.y, z), view));
        }
    }
    pairs
}

fn without_half_vector() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for phi in AZIMUTHS {
        let horizon = Vec3::new(phi.cos() as f32, phi.sin() as f32, 0.0);
        // The sum is zero, or its square is.
        for z in [0.0, -0.0, 1e-45, f32::MIN_POSITIVE, 1e-30, 1e-23, 1e-19] {
            for w in [0.0, z, 2.0 * z, 1e-20] {
                pairs.push((horizon.with_z(z), (-horizon).with_z(w)));
            }
        }
    }
    pairs
}

fn poles() -> Vec<Pair> {
    let near = [1e-45, 1e-38, 1e-23, 1e-10, 1e-7, 1e-4].map(|x| Vec3::new(x, 0.0, 1.0));
    let mut views = vec![Vec3::Z, -Vec3::Z, Vec3::X, Vec3::Y, -Vec3::X, -Vec3::Y];
    views.extend(near);
    views.extend(near.map(|v| Vec3::new(0.0, -v.x, 1.0)));
    views.extend([Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.0, 0.8, 0.6)]);
    views.iter().flat_map(|&l| views.iter().map(move |&v| (l, v))).collect()
}

fn off_lengths() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for (l, v) in ordinary().into_iter().chain(mirror_pairs().into_iter().step_by(3)) {
        for (a, b) in [(1.001, 1.0), (1.0, 0.999), (1.001, 0.999), (0.999, 0.999)] {
            pairs.push((l * a, v * b));
        }
    }
    pairs
}

fn denormals() -> Vec<Pair> {
    let tiny = [1e-45, -1e-45, 1e-40, f32::MIN_POSITIVE, -1e-39];
    let mut views = Vec::new();
    for t in tiny {
        views.extend([
            Vec3::new(t, 0.6, 0.8),
            Vec3::new(t, t, 1.0),
            Vec3::new(1.0, t, t.abs()),
            Vec3::new(t, -1.0, t.abs()),
        ]);
    }
    views.iter().flat_map(|&l| views.iter().map(move |&v| (l, v))).collect()
}

fn signed_zeros() -> Vec<Pair> {
    let zeros = [0.0, -0.0];
    let mut views = Vec::new();
    for a in zeros {
        for b in zeros {
            views.extend([
                Vec3::new(a, b, 1.0),
                Vec3::new(1.0, a, b),
                Vec3::new(0.6, a, 0.8),
                Vec3::new(b, -0.6, 0.8),
            ]);
        }
    }
    views.iter().flat_map(|&l| views.iter().map(move |&v| (l, v))).collect()
}

/// Each value in each component of either direction.
fn specials(values: &[f32]) -> Vec<Pair> {
    let good = Vec3::new(0.48, 0.36, 0.8);
    let mut pairs = Vec::new();
    for &value in values {
        let mut broken = vec![Vec3::splat(value)];
        for component in 0..3 {
            let mut v = good;
            v[component] = value;
            broken.push(v);
        }
        for v in broken {
            pairs.extend([(v, good), (good, v), (v, v), (v, Vec3::Z)]);
        }
    }
    pairs
}

fn no_directions() -> Vec<Pair> {
    let good = Vec3::new(0.48, 0.36, 0.8);
    [0.0, 1e-45, 1e-20, 0.4, 2.1, 1e10, 3e38]
        .into_iter()
        .flat_map(|s| [(good * s, good), (good, good * s)])
        .collect()
}

fn ggx_cases() -> Vec<Case> {
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

fn hybrid_cases() -> Vec<Case> {
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
        let material = Hybrid::new(form, Arc::new(network), microfacet, weights.latent(4), weights.bound());
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
        for composition in [Composition::GatedResidual, Composition::Additive, Composition::LogMultiplicative]
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

fn neural_cases() -> Vec<Case> {
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

fn nbrdf_cases() -> Vec<Case> {
    let case = |weights: Weights| {
        let sizes = [nbrdf::FEATURES, nbrdf::WIDTH, nbrdf::WIDTH, 3];
        let network = weights.network(&sizes, nbrdf::FEATURES, Activation::Relu);
        let material = Nbrdf::new(Arc::new(network)).expect("the parts fit together");
        Case::new(format!("{weights:?}"), material.into())
    };
    // These have no latent code.
    WEIGHTS.into_iter().filter(|&weights| weights != Weights::LargeLatent).map(case).collect()
}

fn factor_cases() -> Vec<Case> {
    /// The largest that the model takes.
    const MAX_SCALE: f32 = 1e12;
    fn curve<const N: usize>(at: fn(f32) -> f32) -> factor::Curve<N> {
        [std::array::from_fn(|i| at(i as f32 / N as f32)); 3]
    }
    let mut cases = Vec::new();
    let mut add = |name: &str, factors: Factors| {
        for interpolation in [Interpolation::Linear, Interpolation::Nearest] {
            let name = format!("{:?}, {interpolation:?}, {name}", factors.variant());
            let material = Factor::new(factors.clone(), interpolation).expect("numbers are in their ranges");
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

fn analytic_cases() -> Vec<Case> {
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

fn spherical_cases() -> Vec<Case> {
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
