//! Materials that are hard to fit, and fits to them that are watched closely.

use std::ops::ControlFlow;

use glam::Vec3;
use glimt_core::directions::healpix::Healpix;
use glimt_core::library::{Entry, Origin};
use glimt_core::microfacet::Microfacet;
use glimt_core::models::ggx::Ggx;
use glimt_core::models::spherical::pixelation::Pixelation;
use glimt_core::models::spherical::store::StoreKind;
use glimt_core::models::spherical::tables::{Form, Grids, Interpolation};
use glimt_core::{Brdf, is_lit};
use glimt_fit::options::{DEFAULT_ANALYTIC_LOSS, DEFAULT_LOSS, SPHERICAL_LOSS};
use glimt_fit::train::Schedule;
use glimt_fit::{
    HybridOptions, Input, Model, Net, NeuralOptions, Options, Outcome, SphericalOptions, Truth, fit,
};
use glimt_report::{BrdfError, Protocol};

/// A BRDF that is a function of lit directions.
struct Function<F>(F);

impl<F: Fn(Vec3, Vec3) -> Vec3 + Send + Sync> Brdf for Function<F> {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        if is_lit(light, view) { (self.0)(light, view) } else { Vec3::ZERO }
    }
}

fn function(f: impl Fn(Vec3, Vec3) -> Vec3 + Send + Sync + 'static) -> Box<dyn Brdf> {
    Box::new(Function(f))
}

/// A Gaussian lobe of the half vector over a base, and a sheen that no GGX lobe has.
fn velvet(base: Vec3, lobe: f32, width: f32) -> Box<dyn Brdf> {
    function(move |light, view| {
        let h = (light + view).normalize();
        let lobe = lobe * (-(h.x * h.x + h.y * h.y) / (width * width)).exp();
        base * (1.0 + 3.0 * (1.0 - light.z * view.z).powi(6)) + Vec3::splat(lobe)
    })
}

fn ggx(kd: f32, eta: f32, alpha: f32) -> Box<dyn Brdf> {
    Box::new(Ggx::new(Microfacet { kd: [kd; 3], eta: [eta; 3], alpha: [alpha; 2] }).expect("in range"))
}

/// Some materials that are fitted together.
pub struct Case {
    pub name: &'static str,
    pub materials: Vec<Box<dyn Brdf>>,
    /// Whether they are known at 448 directions alone, as a goniometer gives them.
    pub scattered: bool,
}

/// A value about which nothing is smooth: a hot pixel of a measurement.
const HOT: f32 = 1e4;

/// The catalogue; the crowd is one metal among `crowd` cloths.
pub fn cases(crowd: usize) -> Vec<Case> {
    let base = Vec3::new(0.05, 0.1, 0.2);
    let alone = |name, material| Case { name, materials: vec![material], scattered: false };
    let cloth = move |i: usize| velvet(base * (0.5 + 0.1 * (i % 9) as f32), 0.5, 0.3 + 0.03 * (i % 7) as f32);
    vec![
        alone("easy", velvet(base, 1.0, 0.3)),
        alone("near mirror", ggx(0.02, 1.5, 1e-3)),
        alone("range of 1e7", velvet(Vec3::splat(1e-4), 1e3, 0.02)),
        alone(
            "hot pixel",
            function(move |light, view| {
                let hot = (light - Vec3::new(0.6, 0.0, 0.8)).length() < 0.02
                    && (view - Vec3::new(0.0, 0.6, 0.8)).length() < 0.02;
                base + if hot { Vec3::splat(HOT) } else { Vec3::ZERO }
            }),
        ),
        alone("black channel", velvet(Vec3::new(0.1, 0.0, 0.2), 0.0, 1.0)),
        alone("black", function(|_, _| Vec3::ZERO)),
        alone("constant", function(|_, _| Vec3::splat(0.25))),
        Case { name: "448 samples", materials: vec![velvet(base, 1.0, 0.3)], scattered: true },
        Case { name: "duplicates", materials: (0..4).map(|_| cloth(2)).collect(), scattered: false },
        Case {
            name: "one in a crowd",
            materials: (0..crowd).map(cloth).chain([ggx(0.01, 3.0, 0.03)]).collect(),
            scattered: false,
        },
    ]
}

/// 448 directions: seven views, and 64 lights about each.
pub fn goniometer() -> (Vec<Vec3>, Vec<Vec3>) {
    let direction = |theta: f32, phi: f32| {
        let (theta, phi) = (theta.to_radians(), phi.to_radians());
        Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    };
    let views = (0..7).map(|i| direction(10.0 * i as f32, 180.0));
    let lights = (0..64).map(move |i| direction(5.0 + 10.0 * (i / 8) as f32, 22.5 * (i % 8) as f32));
    views.flat_map(|view| lights.clone().map(move |light| (light, view))).unzip()
}

const NET: Net = Net { width: 16, layers: 2 };

/// The models that are fitted, with glimt's own recipes.
pub fn models() -> [(&'static str, Model); 4] {
    let neural = NeuralOptions { net: NET, latent: 8, loss: DEFAULT_LOSS };
    let spherical = SphericalOptions {
        form: Form {
            grids: Grids::Hd,
            pixelation: Pixelation::Healpix,
            nside: Healpix::try_from(8).expect("a power of two"),
            nodes: 2,
            features: 4,
            interpolation: Interpolation::Bilinear,
        },
        store: StoreKind::I8,
        net: NET,
        clusters: None,
        loss: SPHERICAL_LOSS,
    };
    [
        ("ggx", Model::Ggx(DEFAULT_ANALYTIC_LOSS)),
        ("hybrid", Model::Hybrid(HybridOptions::shared(NET, 4))),
        ("neural", Model::Neural(neural)),
        ("spherical", Model::Spherical(spherical)),
    ]
}

/// Learning rate of the command line for a model.
pub fn rate(model: &Model) -> f32 {
    match model {
        Model::Neural(_) | Model::Spherical(_) => 0.02,
        Model::Ggx(_) | Model::Hybrid(_) => 0.01,
    }
}

/// What came of a fit.
pub struct Run {
    /// Why there is no result.
    pub failure: Option<String>,
    /// The materials.
    pub entries: Vec<Entry>,
    /// Step and loss.
    pub curve: Vec<(u64, f64)>,
    /// Mean over the materials.
    pub log_mae: f64,
    /// Mean over the materials.
    pub smape: f64,
    /// The largest log-MAE of a material.
    pub worst: f64,
}

/// Fits `model` to a case and measures the result over `pairs` pairs that the fit has not seen.
pub fn run(case: &Case, model: &Model, steps: u64, seed: u64, rate: f32, pairs: usize) -> Run {
    let (light, view) = goniometer();
    let values: Vec<Vec<Vec3>> = case
        .materials
        .iter()
        .map(|brdf| light.iter().zip(&view).map(|(&light, &view)| brdf.eval(light, view)).collect())
        .collect();
    let inputs: Vec<Input> = case
        .materials
        .iter()
        .zip(&values)
        .enumerate()
        .map(|(i, (brdf, f))| Input {
            name: format!("{} {i}", case.name),
            truth: match case.scattered {
                true => Truth::Samples { light: &light, view: &view, f },
                false => Truth::Brdf(&**brdf),
            },
            isotropic: case.name != "hot pixel",
            origin: Origin::default(),
        })
        .collect();
    let schedule = Schedule { rate, ..Schedule::standard(steps, seed) };
    let options = Options { model: model.clone(), schedule };
    let mut curve = Vec::new();
    let alone = matches!(model, Model::Ggx(_));
    let outcome = fit(&inputs, &options, None, &mut |progress, state| {
        if alone || state.is_some() {
            curve.push((progress.step, progress.loss));
        }
        ControlFlow::Continue(())
    });
    let none = Run { failure: None, entries: Vec::new(), curve, log_mae: 0.0, smape: 0.0, worst: 0.0 };
    let entries = match outcome {
        Ok(Outcome::Done(entries)) => entries,
        Ok(Outcome::Stopped(_)) => unreachable!("nobody stops it"),
        Err(error) => return Run { failure: Some(error.to_string()), ..none },
    };
    let protocol = Protocol::seeded(9, pairs);
    let errors: Vec<BrdfError> = entries
        .iter()
        .zip(&case.materials)
        .map(|(entry, brdf)| BrdfError::measure(&**brdf, &entry.material, &protocol))
        .collect();
    let mean = |value: fn(&BrdfError) -> f64| errors.iter().map(value).sum::<f64>() / errors.len() as f64;
    Run {
        log_mae: mean(|e| e.log_mae),
        smape: mean(|e| e.smape),
        worst: errors.iter().map(|e| e.log_mae).fold(0.0, f64::max),
        entries,
        ..none
    }
}
