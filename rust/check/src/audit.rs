//! Looks at every answer that a subject gives during a run.

use std::cell::RefCell;

use glam::Vec3;

use crate::subject::{Answer, Claims, Component, Draw, Part, Subject};
use crate::verdict::{Finding, Measure, Test};

/// A subject whose answers are recorded where they are not finite or negative, and replaced by 0 there, so
/// that one bad answer is one finding and does not spoil every statistic.
pub struct Audit<'a> {
    subject: &'a dyn Subject,
    seen: RefCell<Seen>,
}

#[derive(Default)]
struct Seen {
    answers: u64,
    not_finite: Bad,
    negative: Bad,
}

/// Bad answers of one kind.
#[derive(Default)]
struct Bad {
    count: u64,
    first: Option<String>,
}

impl Bad {
    fn add(&mut self, example: impl FnOnce() -> String) {
        self.count += 1;
        if self.first.is_none() {
            self.first = Some(example());
        }
    }

    fn finding(self, test: Test, answers: u64) -> Finding {
        let note = match self.first {
            Some(first) => format!("{} of {answers} answers; first: {first}", self.count),
            None => format!("{answers} answers"),
        };
        Finding::new(test, Measure::error(self.count as f64, 0.0)).note(note)
    }
}

impl<'a> Audit<'a> {
    /// The subject under audit.
    pub fn new(subject: &'a dyn Subject) -> Self {
        Audit { subject, seen: RefCell::default() }
    }

    /// The findings over all answers so far, and their number.
    pub fn findings(self) -> (Vec<Finding>, u64) {
        let Seen { answers, not_finite, negative } = self.seen.into_inner();
        let findings =
            vec![not_finite.finding(Test::Finite, answers), negative.finding(Test::NonNegative, answers)];
        (findings, answers)
    }

    /// Records numbers that are bad and sets them to 0.
    fn clean(&self, numbers: &mut [f32], what: &str, input: impl Fn() -> String) {
        let is_good = |x: f32| x.is_finite() && x >= 0.0;
        if numbers.iter().copied().all(is_good) {
            return;
        }
        let mut seen = self.seen.borrow_mut();
        let example = || format!("{what} {numbers:?} for {}", input());
        if numbers.iter().any(|x| !x.is_finite()) {
            seen.not_finite.add(example);
        } else {
            seen.negative.add(example);
        }
        for x in numbers {
            *x = if is_good(*x) { *x } else { 0.0 };
        }
    }

    fn clean_triples(&self, answers: &mut [Vec3], what: &str, light: &[Vec3], view: &[Vec3]) {
        self.seen.borrow_mut().answers += answers.len() as u64;
        for (i, answer) in answers.iter_mut().enumerate() {
            self.clean(answer.as_mut(), what, || pair(light[i], view[i]));
        }
    }

    fn clean_numbers(&self, answers: &mut [f32], what: &str, light: &[Vec3], view: &[Vec3]) {
        self.seen.borrow_mut().answers += answers.len() as u64;
        for (i, answer) in answers.iter_mut().enumerate() {
            self.clean(std::slice::from_mut(answer), what, || pair(light[i], view[i]));
        }
    }
}

/// A pair of directions as a note names it.
pub fn pair(light: Vec3, view: Vec3) -> String {
    format!("light {light:?}, view {view:?}")
}

impl Subject for Audit<'_> {
    fn name(&self) -> String {
        self.subject.name()
    }

    fn claims(&self) -> Claims {
        self.subject.claims()
    }

    fn components(&self) -> Vec<Component> {
        self.subject.components()
    }

    fn response(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<Vec<Vec3>> {
        let mut response = self.subject.response(part, light, view)?;
        self.clean_triples(&mut response, "eval", light, view);
        Ok(response)
    }

    fn pdf(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<Vec<f32>> {
        let mut pdf = self.subject.pdf(part, light, view)?;
        self.clean_numbers(&mut pdf, "pdf", light, view);
        Ok(pdf)
    }

    fn response_and_pdf(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<(Vec<Vec3>, Vec<f32>)> {
        let (mut response, mut pdf) = self.subject.response_and_pdf(part, light, view)?;
        self.clean_triples(&mut response, "eval", light, view);
        self.clean_numbers(&mut pdf, "pdf", light, view);
        Ok((response, pdf))
    }

    fn sample(&self, part: Part, view: &[Vec3], u: &[Vec3]) -> Answer<Vec<Draw>> {
        let mut draws = self.subject.sample(part, view, u)?;
        self.seen.borrow_mut().answers += draws.len() as u64;
        for (i, draw) in draws.iter_mut().enumerate() {
            let input = || format!("view {:?}, u {:?}", view[i], u[i]);
            let mut numbers = [draw.weight.x, draw.weight.y, draw.weight.z, draw.pdf];
            self.clean(&mut numbers, "sampled weight and pdf", input);
            if draw.pdf > 0.0 && !draw.light.is_finite() {
                let example = || format!("sampled direction {:?} for {}", draw.light, input());
                self.seen.borrow_mut().not_finite.add(example);
                numbers[3] = 0.0;
            }
            draw.weight = Vec3::new(numbers[0], numbers[1], numbers[2]);
            draw.pdf = numbers[3];
            if draw.pdf == 0.0 {
                (draw.light, draw.weight) = (Vec3::Z, Vec3::ZERO);
            }
        }
        Ok(draws)
    }
}
