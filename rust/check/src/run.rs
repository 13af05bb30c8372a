//! One subject through all tests.

use std::time::Instant;

use glam::Vec3;
use rand::RngExt;
use serde::Serialize;

use crate::audit::Audit;
use crate::cells::Resolution;
use crate::energy::Albedo;
use crate::look::Look;
use crate::picture::Picture;
use crate::subject::{Answer, Claims, Component, Draw, Part, Subject};
use crate::verdict::{Finding, Measure, Test};
use crate::views::{View, either_side, few, mirror, random, uniform, upper, views};
use crate::{components, consistency, energy, horizon, sampling, symmetry};

/// How much work a run is, and its random numbers.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Samples for each view.
    pub samples: usize,
    /// How finely the sphere is cut.
    pub resolution: Resolution,
    /// Pairs of directions at which answers are compared with each other.
    pub pairs: usize,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Options {
    /// For subjects that answer in batches. The subject is asked about a million times for each view.
    pub const FULL: Options = Options {
        samples: 200_000,
        resolution: Resolution { rows: 32, evaluations: 600_000 },
        pairs: 20_000,
        seed: 1,
    };

    /// For subjects whose answers take microseconds each, and for quick tests.
    pub const SMALL: Options = Options {
        samples: 10_000,
        resolution: Resolution { rows: 16, evaluations: 60_000 },
        pairs: 1_000,
        seed: 1,
    };
}

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

/// Pairs of directions: a third uniform, a third the subject's own samples, a third around the mirror.
pub struct Pairs {
    /// Directions to the light; on the side of the view, or on either of what transmits.
    pub light: Vec<Vec3>,
    /// Directions to the viewer.
    pub view: Vec<Vec3>,
}

impl Pairs {
    fn new(subject: &dyn Subject, options: &Options) -> Answer<Pairs> {
        let claims = subject.claims();
        let mut random = random(options.seed, u64::MAX - 2);
        let view: Vec<Vec3> = (0..options.pairs)
            .map(|_| {
                let view = upper(&mut random);
                either_side(view, claims.two_sided, &mut random)
            })
            .collect();
        let light = Pairs::lights(subject, &view, &mut random)?;
        Ok(Pairs { light, view })
    }

    /// As many lights for one view.
    fn lights_for(&self, subject: &dyn Subject, view: View) -> Answer<Vec<Vec3>> {
        let views = vec![view.direction(); self.view.len()];
        Pairs::lights(subject, &views, &mut random(0, u64::MAX - 3))
    }

    fn lights(subject: &dyn Subject, view: &[Vec3], random: &mut impl rand::Rng) -> Answer<Vec<Vec3>> {
        let transmits = subject.claims().transmits;
        let u: Vec<Vec3> = view.iter().map(|_| uniform(random)).collect();
        let draws = subject.sample(Part::Whole, view, &u)?;
        let light = |(i, (&view, draw)): (usize, (&Vec3, &Draw))| {
            // Distances from the mirror direction over three decades.
            let distance = 10_f32.powf(-3.0 * random.random::<f32>());
            let uniform = upper(random);
            let light = match i % 3 {
                0 if draw.pdf > 0.0 && !draw.delta => draw.light,
                1 => (mirror(view) + distance * (uniform - Vec3::new(0.0, 0.0, 0.5))).normalize_or(Vec3::Z),
                _ => uniform,
            };
            let on_side_of_view = Vec3::new(light.x, light.y, light.z.abs() * view.z.signum());
            either_side(on_side_of_view, transmits, random)
        };
        Ok(view.iter().zip(&draws).enumerate().map(light).collect())
    }
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
