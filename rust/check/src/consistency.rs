//! Do the answers of one subject agree with each other?

use glam::Vec3;

use crate::audit::pair;
use crate::difference::{FLOOR, OF_SAMPLE, ROUNDING, Worst, relative, relative_rgb};
use crate::look::Look;
use crate::pairs::Pairs;
use crate::rounding::{Judged, beyond, range_of_pdf};
use crate::subject::{Answer, Part, Subject};
use crate::verdict::{Finding, Measure, Test};
use crate::views::{random, uniform};

/// How far the length of a direction may be from 1.
const LENGTH: f64 = 1e-4;

/// [`Test::EvalPdf`].
///
/// # Errors
/// The subject's.
pub fn combined_call(subject: &dyn Subject, part: Part, pairs: &Pairs) -> Answer<Finding> {
    let response = subject.response(part, &pairs.light, &pairs.view)?;
    let pdf = subject.pdf(part, &pairs.light, &pairs.view)?;
    let both = subject.response_and_pdf(part, &pairs.light, &pairs.view)?;
    let mut worst = Worst::none();
    for i in 0..pairs.light.len() {
        let at = || pair(pairs.light[i], pairs.view[i]);
        worst.add(relative_rgb(response[i], both.0[i], FLOOR), || {
            format!("eval {}, eval_pdf {} for {}", response[i], both.0[i], at())
        });
        worst.add(relative(pdf[i], both.1[i], FLOOR), || {
            format!("pdf {}, eval_pdf {} for {}", pdf[i], both.1[i], at())
        });
    }
    Ok(worst.finding(Test::EvalPdf, ROUNDING))
}

/// Samples that [`deterministic`] draws twice.
const REPEATED: usize = 2048;

/// [`Test::Deterministic`]: the same samples and evaluations once more, in the reverse order.
///
/// # Errors
/// The subject's.
pub fn deterministic(subject: &dyn Subject, pairs: &Pairs, seed: u64) -> Answer<Finding> {
    let mut random = random(seed, u64::MAX);
    let view: Vec<Vec3> = pairs.view.iter().copied().take(REPEATED).collect();
    let light: Vec<Vec3> = pairs.light.iter().copied().take(REPEATED).collect();
    let u: Vec<Vec3> = view.iter().map(|_| uniform(&mut random)).collect();
    let reversed = |v: &[Vec3]| v.iter().rev().copied().collect::<Vec<_>>();
    let first = subject.sample(Part::Whole, &view, &u)?;
    let second = subject.sample(Part::Whole, &reversed(&view), &reversed(&u))?;
    let mut different = 0;
    let mut example = String::new();
    let mut note = |is_same: bool, what: &dyn Fn() -> String| {
        different += usize::from(!is_same);
        if !is_same && example.is_empty() {
            example = what();
        }
    };
    for (i, (a, b)) in first.iter().zip(second.iter().rev()).enumerate() {
        note(a == b, &|| format!("{a:?}, then {b:?} for view {:?}, u {:?}", view[i], u[i]));
    }
    let first = subject.response_and_pdf(Part::Whole, &light, &view)?;
    let second = subject.response_and_pdf(Part::Whole, &reversed(&light), &reversed(&view))?;
    for i in 0..view.len() {
        let (a, b) = ((first.0[i], first.1[i]), (second.0[view.len() - 1 - i], second.1[view.len() - 1 - i]));
        note(a == b, &|| format!("eval_pdf {a:?}, then {b:?} for {}", pair(light[i], view[i])));
    }
    let count = 2 * view.len();
    let all = format!("{different} of {count} answers differ");
    let text = if example.is_empty() { all } else { format!("{all}; first: {example}") };
    Ok(Finding::new(Test::Deterministic, Measure::error(different as f64, 0.0)).note(text))
}

/// [`Test::UnitLength`], [`Test::PdfOfSample`] and [`Test::Weight`] over the samples of a look.
///
/// # Errors
/// The subject's.
pub fn of_samples(subject: &dyn Subject, look: &Look) -> Answer<Vec<Finding>> {
    let (mut length, mut density, mut weight) =
        (Worst::none(), Judged::none(OF_SAMPLE), Judged::none(OF_SAMPLE));
    let view = look.view.direction();
    // Weights are compared relative to their size, but no finer than they matter among all.
    let mean = look.samples.iter().map(|at| at.draw.weight.element_sum() / 3.0).sum::<f32>();
    let floor = 1e-2 * mean / look.samples.len().max(1) as f32;
    for draw in look.samples.iter().map(|at| &at.draw).chain(&look.deltas) {
        length.add(f64::from((draw.light.length() - 1.0).abs()), || format!("{:?}", draw.light));
    }
    for at in &look.samples {
        let draw = &at.draw;
        let place = || pair(draw.light, view);
        let range = || range_of_pdf(subject, look.part, draw.light, view);
        density.add(
            relative(draw.pdf, at.pdf, FLOOR),
            || Ok(beyond(draw.pdf, range()?, FLOOR)),
            || format!("sample says {}, pdf() says {} for {}", draw.pdf, at.pdf, place()),
        )?;
        let expected = |pdf: f32| if pdf > 0.0 { at.response / draw.pdf } else { Vec3::ZERO };
        weight.add(
            relative_rgb(draw.weight, expected(at.pdf), floor),
            || Ok(relative_rgb(draw.weight, expected(range()?[1]), floor)),
            || format!("weight {}, f·cosθ/pdf {} for {}", draw.weight, expected(at.pdf), place()),
        )?;
    }
    let at = |finding: Finding| finding.at(look.view);
    if look.samples.is_empty() && look.deltas.is_empty() {
        return Ok(Vec::new());
    }
    let mut findings = vec![at(length.finding(Test::UnitLength, LENGTH))];
    if !look.samples.is_empty() {
        findings.push(at(density.finding(Test::PdfOfSample)));
        findings.push(at(weight.finding(Test::Weight)));
    }
    Ok(findings)
}
