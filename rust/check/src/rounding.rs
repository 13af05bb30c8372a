//! What the rounding of directions explains.
//!
//! Directions are float32. Where a density or f is steep, such as at exact mirror pairs of a measurement whose map of
//! samples is singular there, the answer within rounding of a pair may be anything in a range. Two answers in one range
//! do not contradict each other: neither is wrong.

use glam::Vec3;

use crate::difference::{Worst, relative, relative_rgb};
use crate::subject::{Answer, Part, Subject};
use crate::verdict::{Finding, Test};

/// How far a component of a direction that was computed in float32 may be off: an ULP of 1.
const STEP: f32 = f32::EPSILON;

/// The pair, and the pairs with one component of one direction moved by [`STEP`], either way; those that are steps
/// of the light in a plane too, as both angles of a direction are rounded.
fn neighbours(light: Vec3, view: Vec3) -> (Vec<Vec3>, Vec<Vec3>) {
    let mut pairs = vec![(light, view)];
    for step in [-STEP, STEP] {
        for axis in Vec3::AXES {
            pairs.extend([(light + step * axis, view), (light, view + step * axis)]);
        }
        for other in [-STEP, STEP] {
            pairs.push((light + Vec3::new(step, other, 0.0), view));
        }
    }
    pairs.into_iter().unzip()
}

/// Least and greatest density within rounding of a pair.
///
/// # Errors
/// The subject's.
pub fn range_of_pdf(subject: &dyn Subject, part: Part, light: Vec3, view: Vec3) -> Answer<[f32; 2]> {
    let (lights, views) = neighbours(light, view);
    let pdf = subject.pdf(part, &lights, &views)?;
    Ok(pdf.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], &pdf| [low.min(pdf), high.max(pdf)]))
}

/// Least and greatest response within rounding of a pair, channel by channel.
///
/// # Errors
/// The subject's.
pub fn range_of_response(subject: &dyn Subject, part: Part, light: Vec3, view: Vec3) -> Answer<[Vec3; 2]> {
    let (lights, views) = neighbours(light, view);
    let responses = subject.response(part, &lights, &views)?;
    let start = [Vec3::INFINITY, Vec3::NEG_INFINITY];
    Ok(responses.iter().fold(start, |[low, high], &response| [low.min(response), high.max(response)]))
}

/// [`relative`] distance of `value` from a range.
#[must_use]
pub fn beyond(value: f32, [low, high]: [f32; 2], floor: f32) -> f64 {
    relative(value, value.clamp(low, high), floor)
}

/// [`relative_rgb`] distance of `value` from a range.
#[must_use]
pub fn beyond_rgb(value: Vec3, [low, high]: [Vec3; 2], floor: f32) -> f64 {
    relative_rgb(value, value.clamp(low, high), floor)
}

/// The worst of many comparisons: of those that rounding does not explain, and of those beyond the limit that it does.
pub struct Judged {
    limit: f64,
    plain: Worst,
    rounded: Worst,
}

impl Judged {
    /// No comparison yet.
    #[must_use]
    pub fn none(limit: f64) -> Judged {
        Judged { limit, plain: Worst::none(), rounded: Worst::none() }
    }

    /// Takes an error; `unexplained` is asked for what is left of one beyond the limit when rounding is allowed for.
    ///
    /// # Errors
    /// Those of `unexplained`.
    pub fn add(
        &mut self,
        error: f64,
        unexplained: impl FnOnce() -> Answer<f64>,
        place: impl FnOnce() -> String,
    ) -> Answer<()> {
        if error > self.limit && unexplained()? <= self.limit {
            self.rounded.add(error, place);
        } else {
            self.plain.add(error, place);
        }
        Ok(())
    }

    /// As a finding: what rounding explains is a warning, where nothing else is beyond the limit.
    #[must_use]
    pub fn finding(self, test: Test) -> Finding {
        if self.plain.value() > self.limit || self.rounded.value() == 0.0 {
            return self.plain.finding(test, self.limit);
        }
        let finding = self.rounded.finding(test, self.limit).warning();
        let note = format!("undetermined within the rounding of the directions: {}", finding.note);
        finding.note(note)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Errors of 5 % at a limit of 1 %, of which rounding explains `explained`.
    fn judged(explained: f64) -> Finding {
        let mut judged = Judged::none(0.01);
        judged.add(0.001, || unreachable!("within the limit"), String::new).unwrap();
        judged.add(0.05, || Ok(0.05 - explained), || "here".into()).unwrap();
        judged.finding(Test::PdfOfSample)
    }

    #[test]
    fn only_what_rounding_explains_is_excused() {
        use crate::verdict::Verdict;
        assert_eq!(judged(0.03).verdict(0.0), Verdict::Fail);
        let excused = judged(0.045);
        assert_eq!(excused.verdict(0.0), Verdict::Warning);
        assert!(excused.note.contains("rounding") && excused.note.ends_with("here"), "{}", excused.note);
    }
}
