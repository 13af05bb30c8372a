//! What changes when directions are exchanged or turned?

use glam::{Quat, Vec3};

use crate::audit::pair;
use crate::difference::{FLOOR, Worst, relative_rgb};
use crate::pairs::Pairs;
use crate::rounding::{Judged, beyond_rgb, range_of_response};
use crate::subject::{Answer, Part, Subject};
use crate::verdict::{Finding, Measure, Test};

/// Relative difference of f that counts as none: rounding, amplified by narrow lobes.
const LIMIT: f64 = 1e-2;
/// Least cosine at which f is computed from the response.
const MIN_COSINE: f32 = 1e-3;

/// f, given the response.
fn f(response: &[Vec3], light: &[Vec3]) -> Vec<Vec3> {
    response.iter().zip(light).map(|(&response, light)| response / light.z.abs()).collect()
}

/// Pairs on one side of the surface, away from the horizon.
fn reflected(pairs: &Pairs) -> (Vec<Vec3>, Vec<Vec3>) {
    let all = pairs.light.iter().zip(&pairs.view);
    all.filter(|(light, view)| light.z.abs().min(view.z.abs()) > MIN_COSINE && light.z * view.z > 0.0).unzip()
}

/// [`Test::Reciprocity`]: f(light, view) against f(view, light), for reflection. The figure is
/// mean 2|a − b|/(a + b); if reciprocity is promised, the worst pair decides.
///
/// # Errors
/// The subject's.
pub fn reciprocity(subject: &dyn Subject, pairs: &Pairs) -> Answer<Finding> {
    let (light, view) = reflected(pairs);
    let there = f(&subject.response(Part::Whole, &light, &view)?, &light);
    let back = f(&subject.response(Part::Whole, &view, &light)?, &view);
    let mut worst = Worst::none();
    let mut sum = 0.0;
    for (i, (&a, &b)) in there.iter().zip(&back).enumerate() {
        worst.add(relative_rgb(a, b, FLOOR), || format!("{a} against {b} for {}", pair(light[i], view[i])));
        let smape = (0..3).map(|c| f64::from(a[c] - b[c]).abs() / f64::from(a[c] + b[c]).max(1e-8));
        sum += 2.0 * smape.sum::<f64>() / 3.0;
    }
    let smape = sum / there.len().max(1) as f64;
    if subject.claims().reciprocal {
        return Ok(worst.finding(Test::Reciprocity, LIMIT));
    }
    let finding = Finding::new(Test::Reciprocity, Measure::Figure { value: smape });
    Ok(finding.note(format!("not promised; mean 2|a − b|/(a + b) is {smape:.4}")))
}

/// [`Test::Isotropy`]: f for both directions turned about the normal.
///
/// # Errors
/// The subject's.
pub fn isotropy(subject: &dyn Subject, pairs: &Pairs) -> Answer<Finding> {
    if !subject.claims().isotropic {
        return Ok(Finding::new(Test::Isotropy, Measure::LeftOut).note("not promised"));
    }
    let (light, view) = reflected(pairs);
    let turned = |v: &[Vec3]| -> Vec<Vec3> {
        // The golden angle: no two turns alike.
        v.iter().enumerate().map(|(i, &v)| Quat::from_rotation_z(2.399_963 * (i + 1) as f32) * v).collect()
    };
    let before = subject.response(Part::Whole, &light, &view)?;
    let after = subject.response(Part::Whole, &turned(&light), &turned(&view))?;
    let mut worst = Judged::none(LIMIT);
    for (i, (&a, &b)) in before.iter().zip(&after).enumerate() {
        worst.add(
            relative_rgb(a, b, FLOOR),
            || Ok(beyond_rgb(b, range_of_response(subject, Part::Whole, light[i], view[i])?, FLOOR)),
            || format!("{a}, turned {b} for {}", pair(light[i], view[i])),
        )?;
    }
    Ok(worst.finding(Test::Isotropy))
}
