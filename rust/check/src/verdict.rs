//! What is asked of a subject, what was found, and what that means.

use serde::Serialize;

use crate::statistics::threshold;
use crate::subject::Claims;
use crate::views::View;

/// The questions, in the order of the tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Test {
    /// Every answer of the run.
    Finite,
    /// Every answer of the run.
    NonNegative,
    /// Below the horizon, and on the other side of what is opaque.
    Horizon,
    /// Just above the horizon.
    HorizonLimit,
    /// The same question twice.
    Deterministic,
    /// The combined call.
    EvalPdf,
    /// Lengths of sampled directions.
    UnitLength,
    /// The density that comes with a sample.
    PdfOfSample,
    /// The weight that comes with a sample.
    Weight,
    /// Histogram of samples.
    ChiSquared,
    /// What the density sums to.
    PdfIntegral,
    /// Mean weight.
    Unbiased,
    /// Where nothing is ever sampled.
    Coverage,
    /// Component masks of eval.
    ComponentsEval,
    /// Component masks of pdf.
    ComponentsPdf,
    /// Exchange of light and view.
    Reciprocity,
    /// Rotation about the normal.
    Isotropy,
    /// Directional albedo.
    Energy,
    /// Directional albedo of an edited material.
    EditEnergy,
}

impl Test {
    /// As tables and JSON spell it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Test::Finite => "finite",
            Test::NonNegative => "non-negative",
            Test::Horizon => "horizon",
            Test::HorizonLimit => "horizon-limit",
            Test::Deterministic => "deterministic",
            Test::EvalPdf => "eval-pdf",
            Test::UnitLength => "unit-length",
            Test::PdfOfSample => "pdf-of-sample",
            Test::Weight => "weight",
            Test::ChiSquared => "chi-squared",
            Test::PdfIntegral => "pdf-integral",
            Test::Unbiased => "unbiased",
            Test::Coverage => "coverage",
            Test::ComponentsEval => "components-eval",
            Test::ComponentsPdf => "components-pdf",
            Test::Reciprocity => "reciprocity",
            Test::Isotropy => "isotropy",
            Test::Energy => "energy",
            Test::EditEnergy => "edit-energy",
        }
    }

    /// What it asks, in a sentence.
    #[must_use]
    pub fn question(self) -> &'static str {
        match self {
            Test::Finite => "Is every answer of the run free of NaN and infinity?",
            Test::NonNegative => "Is no answer of the run negative?",
            Test::Horizon => "Is everything 0 below the horizon, and behind what is opaque?",
            Test::HorizonLimit => "Does f·cosθ vanish as the light sinks to the horizon?",
            Test::Deterministic => "Does the same question get the same answer, in any order?",
            Test::EvalPdf => "Does eval_pdf answer what eval and pdf answer?",
            Test::UnitLength => "Are sampled directions of unit length?",
            Test::PdfOfSample => "Is the density that comes with a sample that of pdf()?",
            Test::Weight => "Is the weight of a sample f·cosθ/pdf?",
            Test::ChiSquared => "Do samples fall where pdf() says, by a χ² test of their histogram?",
            Test::PdfIntegral => "Does the density integrate to the share of samples that succeed?",
            Test::Unbiased => "Is the mean weight the integral of f·cosθ, which no sampler has touched?",
            Test::Coverage => "Is there a density wherever there is a response?",
            Test::ComponentsEval => "Do the responses of the components add up to the whole?",
            Test::ComponentsPdf => {
                "Is the density of the whole a mixture of the components' with fixed shares?"
            }
            Test::Reciprocity => "Is f(light, view) = f(view, light)?",
            Test::Isotropy => "Is f the same when both directions turn about the normal?",
            Test::Energy => "Does no more energy leave than arrives?",
            Test::EditEnergy => {
                "Does no more leave than before the edit, than from the edited analytic part, and than arrives?"
            }
        }
    }
}

/// What was measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "measure", rename_all = "kebab-case")]
pub enum Measure {
    /// A test of a hypothesis.
    Statistic {
        /// χ², or z in standard deviations.
        statistic: f64,
        /// Probability of a statistic at least as extreme if all is well.
        p: f64,
    },
    /// A number that must not exceed a limit.
    Error {
        /// The worst found.
        value: f64,
        /// Most that is allowed.
        limit: f64,
    },
    /// A number without a verdict.
    Figure {
        /// The number.
        value: f64,
    },
    /// The test does not apply; the note says why.
    LeftOut,
}

impl Measure {
    /// [`Measure::Error`].
    #[must_use]
    pub fn error(value: f64, limit: f64) -> Measure {
        Measure::Error { value, limit }
    }
}

/// What a violation means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// The subject is broken.
    Failure,
    /// Worth knowing; correct subjects may do it.
    Warning,
    /// A property of the measurement, which is answered as it is.
    OfTheFile,
}

/// The meaning of one or many findings; a greater one prevails.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Not tested.
    LeftOut,
    /// A figure without a verdict.
    Figure,
    /// As it should be.
    Pass,
    /// Worth knowing.
    Warning,
    /// Against physics, and what the measurement says.
    OfTheFile,
    /// Broken.
    Fail,
}

impl Verdict {
    /// As tables spell it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Verdict::LeftOut => "-",
            Verdict::Figure => "figure",
            Verdict::Pass => "ok",
            Verdict::Warning => "warning",
            Verdict::OfTheFile => "of file",
            Verdict::Fail => "FAIL",
        }
    }
}

/// One answer to one question.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// The question.
    pub test: Test,
    /// The component, if it is not about the whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub component: Option<String>,
    /// The view, if it is about one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view: Option<View>,
    /// What was measured.
    #[serde(flatten)]
    pub measure: Measure,
    /// What a violation means.
    pub severity: Severity,
    /// Where, how much, why.
    pub note: String,
}

impl Finding {
    /// A finding about the whole at no view in particular.
    #[must_use]
    pub fn new(test: Test, measure: Measure) -> Finding {
        let severity = Severity::Failure;
        Finding { test, component: None, view: None, measure, severity, note: String::new() }
    }

    /// The same with a note.
    #[must_use]
    pub fn note(self, note: impl Into<String>) -> Finding {
        Finding { note: note.into(), ..self }
    }

    /// The same about one view.
    #[must_use]
    pub fn at(self, view: View) -> Finding {
        Finding { view: Some(view), ..self }
    }

    /// A test whose quadrature did not settle within its budget: nobody knows.
    #[must_use]
    pub fn unsettled(test: Test, view: View) -> Finding {
        Finding::new(test, Measure::error(1.0, 0.0))
            .warning()
            .at(view)
            .note("inconclusive: the quadrature did not settle within its budget")
    }

    /// The same with a violation as a warning.
    #[must_use]
    pub fn warning(self) -> Finding {
        Finding { severity: Severity::Warning, ..self }
    }

    /// The same about a law of physics: a measurement as it is owes it nothing.
    #[must_use]
    pub fn law(self, claims: &Claims) -> Finding {
        let severity = if claims.measured { Severity::OfTheFile } else { self.severity };
        Finding { severity, ..self }
    }

    /// What it means where a p-value below `threshold` is a violation.
    #[must_use]
    pub fn verdict(&self, threshold: f64) -> Verdict {
        let is_violated = match self.measure {
            Measure::Statistic { p, .. } => p.is_nan() || p < threshold,
            Measure::Error { value, limit } => value.is_nan() || value > limit,
            Measure::Figure { .. } => return Verdict::Figure,
            Measure::LeftOut => return Verdict::LeftOut,
        };
        match (is_violated, self.severity) {
            (false, _) => Verdict::Pass,
            (true, Severity::Warning) => Verdict::Warning,
            (true, Severity::OfTheFile) => Verdict::OfTheFile,
            (true, Severity::Failure) => Verdict::Fail,
        }
    }

    /// How bad it is among findings of one test and one verdict.
    fn badness(&self) -> f64 {
        match self.measure {
            Measure::Statistic { statistic, p } => -p + 1e-9 * statistic.abs().min(1e6),
            Measure::Error { value, limit } => value / limit.max(f64::MIN_POSITIVE),
            Measure::Figure { value } => value,
            Measure::LeftOut => 0.0,
        }
    }
}

/// The findings of one test about one subject.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The question.
    pub test: Test,
    /// The greatest of its verdicts.
    pub verdict: Verdict,
    /// Number of findings with a measure.
    pub count: usize,
    /// The worst finding.
    pub worst: Finding,
}

/// The summaries of `findings`, in the order of the tests.
#[must_use]
pub fn summaries(findings: &[Finding], threshold: f64) -> Vec<Summary> {
    let mut tests: Vec<Test> = findings.iter().map(|finding| finding.test).collect();
    tests.sort();
    tests.dedup();
    let summary = |test: Test| {
        let of_test = || findings.iter().filter(move |finding| finding.test == test);
        let rank = |finding: &&Finding| finding.verdict(threshold);
        let verdict = of_test().map(|f| rank(&f)).max().expect("one at least");
        let worst = of_test()
            .filter(|finding| rank(finding) == verdict)
            .max_by(|a, b| a.badness().total_cmp(&b.badness()))
            .expect("one at least");
        let count = of_test().filter(|finding| finding.measure != Measure::LeftOut).count();
        Summary { test, verdict, count, worst: worst.clone() }
    };
    tests.into_iter().map(summary).collect()
}

/// The threshold for every p-value among `findings`, at the significance of all together.
#[must_use]
pub fn common_threshold<'a>(findings: impl Iterator<Item = &'a Finding>, significance: f64) -> (usize, f64) {
    let count = findings.filter(|f| matches!(f.measure, Measure::Statistic { .. })).count();
    (count, threshold(significance, count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_measurement_says_against_physics_is_of_the_file_and_of_others_a_failure() {
        let broken = || Finding::new(Test::HorizonLimit, Measure::error(0.2, 0.1));
        let kept = || Finding::new(Test::HorizonLimit, Measure::error(0.05, 0.1));
        let measured = Claims { measured: true, ..Claims::NONE };
        assert_eq!(broken().law(&Claims::NONE).verdict(0.0), Verdict::Fail);
        assert_eq!(broken().law(&measured).verdict(0.0), Verdict::OfTheFile);
        assert_eq!(kept().law(&measured).verdict(0.0), Verdict::Pass);
        // Only a failure ends the command with an error.
        assert!(Verdict::Warning < Verdict::OfTheFile && Verdict::OfTheFile < Verdict::Fail);
    }
}
