//! One subject through all tests.

use std::time::Instant;

use glam::Vec3;
use serde::Serialize;

use crate::audit::Audit;
use crate::energy::Albedo;
use crate::look::Look;
use crate::options::Options;
use crate::pairs::Pairs;
use crate::picture::Picture;
use crate::subject::{Answer, Claims, Component, Part, Subject};
use crate::verdict::{Finding, Measure, Test};
use crate::views::{View, few, mirror, views};
use crate::{components, consistency, energy, horizon, sampling, symmetry};

/// A subject after all tests.
#[derive(Clone, Debug)]
pub struct Checked {
    /// For people.
    pub name: String,
    /// What it promises.
    pub claims: Claims,
    /// Its components, if it has masks for them.
    pub components: Vec<Component>,
    /// All findings.
    pub findings: Vec<Finding>,
    /// What was seen from every view.
    pub sights: Vec<Sight>,
    /// Answers that the subject gave.
    pub answers: u64,
    /// Time that the run took.
    pub seconds: f64,
}

/// What was seen from one view.
#[derive(Clone, Debug, Serialize)]
pub struct Sight {
    /// From where.
    pub view: View,
    /// Directional albedo.
    pub albedo: Albedo,
    /// ∫ pdf.
    pub pdf_integral: f64,
    /// Share of samples that succeeded, delta ones left out.
    pub share: f64,
    /// Share of samples of delta components.
    pub delta_share: f64,
    /// What a page shows.
    #[serde(skip)]
    pub picture: Picture,
}

/// Puts a subject through all tests that apply to it.
///
/// # Errors
/// Where the subject cannot answer at all.
pub fn check(subject: &dyn Subject, options: &Options) -> Answer<Checked> {
    let start = Instant::now();
    let audit = Audit::new(subject);
    let claims = audit.claims();
    let parts = audit.components();
    let views = views(&claims);
    let mut findings = Vec::new();

    ask_at_corners(&audit, &claims, &views)?;
    let pairs = Pairs::new(&audit, options)?;
    findings.push(horizon::nothing_beyond(&audit, &pairs, options.seed)?);
    findings.push(horizon::vanishing(&audit, &views, options.seed)?);
    findings.push(consistency::deterministic(&audit, &pairs, options.seed)?);
    findings.push(consistency::combined_call(&audit, Part::Whole, &pairs)?);
    findings.push(symmetry::reciprocity(&audit, &pairs)?);
    findings.push(symmetry::isotropy(&audit, &pairs)?);

    let mut sights = Vec::new();
    for (i, &view) in views.iter().enumerate() {
        let look = Look::new(&audit, Part::Whole, view, i as u64, options)?;
        findings.extend(of_look(&audit, &look)?);
        let albedo = energy::albedo(&look);
        findings.push(energy::conservation(&look, &albedo, claims.conserving).law(&claims));
        sights.push(Sight {
            view,
            albedo,
            pdf_integral: look.cells.total().pdf,
            share: look.share(),
            delta_share: look.deltas.len() as f64 / look.count as f64,
            picture: Picture::new(&audit, &look)?,
        });
    }
    findings.extend(of_components(&audit, &parts, &views, &pairs, options)?);
    let (of_all, answers) = audit.findings();
    findings.splice(0..0, of_all);
    Ok(Checked {
        name: subject.name(),
        claims,
        components: parts,
        findings,
        sights,
        answers,
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// The tests that every part and view takes.
fn of_look(subject: &dyn Subject, look: &Look) -> Answer<Vec<Finding>> {
    let mut findings = consistency::of_samples(subject, look)?;
    findings.push(sampling::histogram(look));
    findings.push(sampling::integral(look));
    findings.push(energy::unbiased(look));
    findings.push(energy::coverage(look));
    Ok(findings)
}

/// Components against the whole, and each by itself from a few views.
fn of_components(
    subject: &dyn Subject,
    parts: &[Component],
    views: &[View],
    pairs: &Pairs,
    options: &Options,
) -> Answer<Vec<Finding>> {
    if parts.len() < 2 {
        let left_out = |test| Finding::new(test, Measure::LeftOut).note("one component");
        return Ok([Test::ComponentsEval, Test::ComponentsPdf].map(left_out).into());
    }
    let mut findings = vec![components::eval(subject, pairs)?];
    for (v, view) in few(views).into_iter().enumerate() {
        let lights = pairs.lights_for(subject, view)?;
        findings.push(components::pdf(subject, view, &lights)?);
        for (i, component) in parts.iter().enumerate().filter(|(_, component)| !component.delta) {
            let stream = (1000 * (i + 1) + v) as u64;
            let look = Look::new(subject, Part::Component(i), view, stream, options)?;
            let mut of_part = of_look(subject, &look)?;
            for finding in &mut of_part {
                finding.component = Some(component.name.clone());
            }
            findings.extend(of_part);
        }
    }
    Ok(findings)
}

/// Cosines at which formulas like to break.
const SPECIAL_COSINES: [f32; 8] =
    [1.0, 0.866_025_4, std::f32::consts::FRAC_1_SQRT_2, 0.5, 0.1, 1e-3, 1e-6, 0.0];
/// Azimuths of special directions: the axes, opposite ones, and one between.
const SPECIAL_AZIMUTHS: [f32; 6] = [
    0.0,
    0.9,
    std::f32::consts::FRAC_PI_2,
    std::f32::consts::PI,
    0.9 + std::f32::consts::PI,
    -std::f32::consts::FRAC_PI_2,
];
/// The ends of the range of random numbers, and its middle.
const SPECIAL_NUMBERS: [f32; 3] = [0.0, 0.5, 1.0 - f32::EPSILON / 2.0];

/// Asks for every pair of special directions, exact mirror and equal pairs among them, and for samples from
/// the corners of the random numbers. What is not finite or negative is in the audit.
fn ask_at_corners(subject: &dyn Subject, claims: &Claims, views: &[View]) -> Answer<()> {
    let mut special: Vec<Vec3> = views.iter().map(|view| view.direction()).collect();
    for z in SPECIAL_COSINES {
        let r = (1.0 - z * z).sqrt();
        special.extend(SPECIAL_AZIMUTHS.map(|phi| Vec3::new(r * phi.cos(), r * phi.sin(), z)));
    }
    special.extend(special.clone().into_iter().map(mirror));
    let below = special.iter().map(|v| Vec3::new(v.x, v.y, -v.z));
    let lights: Vec<Vec3> = special.iter().copied().chain(below.clone()).collect();
    let views: Vec<Vec3> =
        if claims.two_sided { special.iter().copied().chain(below).collect() } else { special.clone() };
    let (mut light, mut view) = (Vec::new(), Vec::new());
    for &v in &views {
        for &l in &lights {
            light.push(l);
            view.push(v);
        }
    }
    subject.response(Part::Whole, &light, &view)?;
    subject.pdf(Part::Whole, &light, &view)?;
    subject.response_and_pdf(Part::Whole, &light, &view)?;
    let (mut view, mut u) = (Vec::new(), Vec::new());
    for &v in &views {
        for x in SPECIAL_NUMBERS {
            for y in SPECIAL_NUMBERS {
                for z in SPECIAL_NUMBERS {
                    view.push(v);
                    u.push(Vec3::new(x, y, z));
                }
            }
        }
    }
    subject.sample(Part::Whole, &view, &u)?;
    Ok(())
}
