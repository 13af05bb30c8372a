//! Where nothing may be: below the horizon, and behind what is opaque.

use glam::Vec3;

use crate::audit::pair;
use crate::difference::Worst;
use crate::pairs::Pairs;
use crate::subject::{Answer, Part, Subject};
use crate::verdict::{Finding, Measure, Test};
use crate::views::{View, direction, random, uniform, upper};

/// [`Test::Horizon`]: every pair of directions with one or both sent to the other side, and samples.
///
/// Light may be where the view is; on the other side only of what transmits; and the view above the horizon
/// only, unless the subject has two sides.
///
/// # Errors
/// The subject's.
pub fn nothing_beyond(subject: &dyn Subject, pairs: &Pairs, seed: u64) -> Answer<Finding> {
    let claims = subject.claims();
    let is_allowed = |light: Vec3, view: Vec3| {
        let same_side = (light.z > 0.0) == (view.z > 0.0);
        (claims.two_sided || view.z > 0.0) && (claims.transmits || same_side)
    };
    let flipped = |v: Vec3| Vec3::new(v.x, v.y, -v.z);
    let mut worst = Worst::none();
    let (mut lights, mut views) = (Vec::new(), Vec::new());
    for (&light, &view) in pairs.light.iter().zip(&pairs.view) {
        for (light, view) in [(flipped(light), view), (light, flipped(view)), (flipped(light), flipped(view))]
        {
            if !is_allowed(light, view) {
                lights.push(light);
                views.push(view);
            }
        }
    }
    if !lights.is_empty() {
        let (response, pdf) = subject.response_and_pdf(Part::Whole, &lights, &views)?;
        for i in 0..lights.len() {
            let place = || pair(lights[i], views[i]);
            let response = response[i];
            worst.add(f64::from(response.max_element()), || format!("eval {response} for {}", place()));
            worst.add(f64::from(pdf[i]), || format!("pdf {} for {}", pdf[i], place()));
        }
    }
    let mut random = random(seed, u64::MAX - 1);
    let views: Vec<Vec3> = pairs.view.iter().flat_map(|&view| [view, flipped(view)]).collect();
    let u: Vec<Vec3> = views.iter().map(|_| uniform(&mut random)).collect();
    for (i, draw) in subject.sample(Part::Whole, &views, &u)?.iter().enumerate() {
        if draw.pdf > 0.0 && !is_allowed(draw.light, views[i]) {
            worst.add(f64::from(draw.weight.max_element()), || {
                format!("sampled with weight {}: {}", draw.weight, pair(draw.light, views[i]))
            });
        }
    }
    Ok(worst.finding(Test::Horizon, 0.0))
}

/// Cosine of the lights of [`vanishing`].
const SINKING: f64 = 1e-5;
/// Lights around the horizon, and over the hemisphere, for each view.
const LIGHTS: usize = 256;
/// Views up to this angle in degrees: nearer to grazing, a mirror is as bright as its horizon is near.
const STEEP: f64 = 76.0;
/// Most that is left at the horizon of the mean over the hemisphere. Without its cosine a diffuse surface has 1.
const LEFT: f64 = 0.1;

/// [`Test::HorizonLimit`]: the mean response just above the horizon against that over the hemisphere. As f is
/// finite, f·cosθ vanishes; who forgets the cosine, or divides by it, is found here. Of normals that are not the
/// surface's it is a figure.
///
/// # Errors
/// The subject's.
pub fn vanishing(subject: &dyn Subject, views: &[View], seed: u64) -> Answer<Finding> {
    let mut random = random(seed, u64::MAX - 4);
    let (mut lights, mut directions) = (Vec::new(), Vec::new());
    for view in views.iter().filter(|view| view.theta < STEEP) {
        for i in 0..LIGHTS {
            let phi = std::f64::consts::TAU * i as f64 / LIGHTS as f64;
            lights.extend([direction(SINKING.acos(), phi), upper(&mut random)]);
            directions.extend([view.direction(); 2]);
        }
    }
    let response = subject.response(Part::Whole, &lights, &directions)?;
    let mut worst = (0.0, None);
    for (pairs, view) in response.chunks_exact(2 * LIGHTS).zip(views.iter().filter(|v| v.theta < STEEP)) {
        let sum =
            |first: usize| pairs.iter().skip(first).step_by(2).map(|r| f64::from(r.element_sum())).sum();
        let (at_horizon, over_hemisphere): (f64, f64) = (sum(0), sum(1));
        if at_horizon > worst.0 * over_hemisphere {
            worst = (at_horizon / over_hemisphere.max(f64::MIN_POSITIVE), Some(*view));
        }
    }
    let (ratio, view) = worst;
    let note = "response just above the horizon over its mean";
    let claims = subject.claims();
    let measure = if claims.tilted { Measure::Figure { value: ratio } } else { Measure::error(ratio, LEFT) };
    let finding = Finding::new(Test::HorizonLimit, measure).note(note);
    Ok(Finding { view, ..finding.law(&claims) })
}
