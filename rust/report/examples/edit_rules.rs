//! What an edit of α could do with a network's correction, as pictures: docs/edit-rules.png.
//!
//! ```sh
//! cargo run --release -p glimt-report --example edit_rules -- scenes/models/rgl.safetensors docs/edit-rules.png
//! ```
//!
//! For each material one row a rule, from narrow to wide lobes. Only the last rule is what glimt does; the others are
//! written down here, for one pair at a time, and nowhere else. None of the first four looks after the energy.

use std::fs::File;
use std::io::BufWriter;

use glam::{Quat, Vec3};
use glimt_core::directions::features::MAX_FEATURES;
use glimt_core::microfacet::Microfacet;
use glimt_core::models::edit::FLOOR;
use glimt_core::models::hybrid::Hybrid;
use glimt_core::simd::math::{exp, sigmoid};
use glimt_core::{AnyModel, Brdf, Library, Material, is_lit};
use glimt_report::study::light::Light;
use glimt_report::study::sphere::LitSphere;

const MATERIALS: [&str; 2] = ["chm_orange", "chm_light_blue"];
const ALPHAS: [f32; 6] = [0.02, 0.05, 0.1, 0.2, 0.4, 0.8];
const SIZE: usize = 80;
const DIRECTIONS: usize = 512;

#[derive(Clone, Copy)]
enum Rule {
    /// The network sees the features of the edited roughness.
    EditedFeatures,
    /// It sees the fitted ones, and its residual stays as it is.
    ResidualStays,
    /// The residual goes with the analytic part.
    ResidualFollows,
    /// It also asks the network at the place in the fitted lobe that the pair has in the edited one.
    Carried,
    /// What glimt does.
    Glimt,
}

/// An edit of `fitted` by one of the rules but the last.
struct Edited<'a> {
    fitted: &'a Hybrid,
    microfacet: Microfacet,
    rule: Rule,
}

impl Edited<'_> {
    /// The network's outputs for a pair, and f_a beside which it was fitted.
    fn outputs(&self, light: Vec3, view: Vec3, alpha: [f32; 2]) -> ([f32; 6], [f32; 3]) {
        let (form, network) = (self.fitted.form(), self.fitted.network());
        let features: [f32; MAX_FEATURES] = form.inputs.compute(light.into(), view.into(), alpha);
        let x: Vec<f64> = features[..form.inputs.count()].iter().map(|&x| x.into()).collect();
        let latent: Vec<f64> = self.fitted.latent().iter().map(|&z| z.into()).collect();
        let y = glimt_core::kernels::network::reference::forward(network, &x, &latent);
        let outputs = std::array::from_fn(|i| y[i] as f32);
        (outputs, self.fitted.microfacet().eval(light.into(), view.into()))
    }

    /// The pair turned so that its half vector lies where it would in the fitted lobe.
    fn carried(&self, light: Vec3, view: Vec3) -> (Vec3, Vec3) {
        const MIN_COS: f32 = 1e-3;
        let half = (light + view).normalize();
        let scale = self.fitted.microfacet().alpha[0] / self.microfacet.alpha[0];
        let turn = Quat::from_rotation_arc(half, (half * Vec3::new(scale, scale, 1.0)).normalize());
        let above = |w: Vec3| w.with_z(w.z.max(MIN_COS));
        (above(turn * light), above(turn * view))
    }
}

impl Brdf for Edited<'_> {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        if !is_lit(light, view) {
            return Vec3::ZERO;
        }
        let (asked, alpha) = match self.rule {
            Rule::EditedFeatures => ((light, view), self.microfacet.alpha),
            Rule::Carried => (self.carried(light, view), self.fitted.microfacet().alpha),
            _ => ((light, view), self.fitted.microfacet().alpha),
        };
        let (y, fitted) = self.outputs(asked.0, asked.1, alpha);
        let edited: [f32; 3] = self.microfacet.eval(light.into(), view.into());
        let channel = |c: usize| {
            let change = match self.rule {
                Rule::EditedFeatures | Rule::ResidualStays => 1.0,
                _ => (edited[c] + FLOOR) / (fitted[c] + FLOOR),
            };
            exp(y[c].min(self.fitted.bound())) * change + sigmoid(y[c + 3]) * edited[c]
        };
        Vec3::new(channel(0), channel(1), channel(2))
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(library), Some(picture)) = (arguments.next(), arguments.next()) else {
        return Err("expected a library and the picture to write".into());
    };
    let library = Library::open(library)?;
    let rules =
        [Rule::EditedFeatures, Rule::ResidualStays, Rule::ResidualFollows, Rule::Carried, Rule::Glimt];
    let width = SIZE * (ALPHAS.len() + 1);
    let mut pixels = Vec::new();
    for name in MATERIALS {
        let material = library.material(Some(name))?;
        let AnyModel::Hybrid(fitted) = material.model() else {
            return Err(format!("{name} is no hybrid").into());
        };
        for rule in rules {
            let mut row = vec![[0u8; 3]; SIZE * width];
            let mut show = |column: usize, brdf: &Material, shown: &dyn Brdf| {
                let sphere = LitSphere::new(brdf, &Light::studio(), SIZE, DIRECTIONS, 1);
                for (i, pixel) in sphere.render(shown).pixels().iter().enumerate() {
                    row[i / SIZE * width + column * SIZE + i % SIZE] = pixel.map(srgb);
                }
            };
            show(0, material, material);
            for (i, &alpha) in ALPHAS.iter().enumerate() {
                let microfacet = Microfacet { alpha: [alpha; 2], ..*fitted.microfacet() };
                let edited = material.with_microfacet(microfacet)?;
                match rule {
                    Rule::Glimt => show(i + 1, &edited, &edited),
                    rule => show(i + 1, &edited, &Edited { fitted, microfacet, rule }),
                }
            }
            pixels.extend(row);
        }
    }
    let height = pixels.len() / width;
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(picture)?), width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header()?.write_image_data(pixels.as_flattened())?;
    Ok(())
}

/// As a display shows it; the background, which is NaN, is black.
fn srgb(x: f32) -> u8 {
    let x = if x.is_nan() { 0.0 } else { x.clamp(0.0, 1.0) };
    let shown = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (shown * 255.0).round() as u8
}
