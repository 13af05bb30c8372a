//! A run over one or many subjects, for people and machines.

use std::fmt::Write;

use glimt_disk::printable;
use serde::Serialize;

use crate::run::{Checked, Sight};
use crate::subject::{Claims, Component};
use crate::verdict::{Finding, Measure, Summary, Test, Verdict, common_threshold, summaries};

/// Probability that a run over correct subjects fails by chance.
pub const SIGNIFICANCE: f64 = 0.01;

/// The result of a run, judged.
#[derive(Debug, Serialize)]
pub struct Report {
    /// The greatest of all verdicts.
    pub verdict: Verdict,
    /// Probability that the run fails by chance if all is well.
    pub significance: f64,
    /// Number of p-values among all findings.
    pub p_values: usize,
    /// A p-value below this is a violation: Šidák's correction for all of them.
    pub threshold: f64,
    /// In the order of the run.
    pub subjects: Vec<Judged>,
}

/// One subject, judged.
#[derive(Debug, Serialize)]
pub struct Judged {
    /// For people.
    pub name: String,
    /// The greatest of its verdicts.
    pub verdict: Verdict,
    /// What it promises.
    pub claims: Claims,
    /// Its components, if it has masks for them.
    pub components: Vec<Component>,
    /// Answers that it gave.
    pub answers: u64,
    /// Time that its run took.
    pub seconds: f64,
    /// One for each test.
    pub tests: Vec<Summary>,
    /// What was seen from every view.
    pub views: Vec<Sight>,
    /// All findings.
    pub findings: Vec<Finding>,
}

impl Report {
    /// Judges all subjects of a run together, at [`SIGNIFICANCE`].
    #[must_use]
    pub fn new(checked: Vec<Checked>) -> Report {
        let all = checked.iter().flat_map(|checked| &checked.findings);
        let (p_values, threshold) = common_threshold(all, SIGNIFICANCE);
        let subjects: Vec<Judged> =
            checked.into_iter().map(|checked| Judged::new(checked, threshold)).collect();
        let verdict = subjects.iter().map(|subject| subject.verdict).max().unwrap_or(Verdict::Pass);
        Report { verdict, significance: SIGNIFICANCE, p_values, threshold, subjects }
    }

    /// Whether no subject failed.
    #[must_use]
    pub fn passed(&self) -> bool {
        self.verdict != Verdict::Fail
    }

    /// Names of the subjects that failed.
    #[must_use]
    pub fn failed(&self) -> Vec<&str> {
        self.subjects.iter().filter(|s| s.verdict == Verdict::Fail).map(|s| s.name.as_str()).collect()
    }

    /// For machines.
    #[must_use]
    pub fn json(&self) -> String {
        serde_json::to_string_pretty(self).expect("plain data with string keys")
    }

    /// For people: a table for each subject, and a line for the run.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = String::new();
        for subject in &self.subjects {
            text += &subject.text();
            text.push('\n');
        }
        let failed = self.failed().len();
        let count = self.subjects.len();
        let plural = if count == 1 { "" } else { "s" };
        let result = if failed == 0 { "passed".to_owned() } else { format!("{failed} FAILED") };
        let (p_values, threshold) = (self.p_values, self.threshold);
        writeln!(
            text,
            "{count} subject{plural}: {result}. {p_values} p-values, each a failure below {threshold:.1e}: \
             a correct run passes with probability {}.",
            1.0 - self.significance
        )
        .expect("a string takes all");
        text
    }
}

impl Judged {
    fn new(checked: Checked, threshold: f64) -> Judged {
        let tests = summaries(&checked.findings, threshold);
        let verdict = tests.iter().map(|test| test.verdict).max().unwrap_or(Verdict::Pass);
        // Figures and what is left out do not make a subject worse or better.
        let verdict = verdict.max(Verdict::Pass);
        let Checked { name, claims, components, findings, sights: views, answers, seconds } = checked;
        Judged { name, verdict, claims, components, answers, seconds, tests, views, findings }
    }

    /// The summary of one test.
    #[must_use]
    pub fn test(&self, test: Test) -> Option<&Summary> {
        self.tests.iter().find(|summary| summary.test == test)
    }

    /// The greatest albedo over views and channels, and where.
    #[must_use]
    pub fn greatest_albedo(&self) -> Option<&Sight> {
        self.views.iter().max_by(|a, b| a.albedo.greatest().total_cmp(&b.albedo.greatest()))
    }

    fn text(&self) -> String {
        let verdict = match self.verdict {
            Verdict::Fail => "FAIL",
            Verdict::OfTheFile => "pass, but for what is of the file",
            Verdict::Warning => "pass, with warnings",
            _ => "pass",
        };
        let promises = self.claims.text();
        let mut text = format!(
            "{}: {verdict} ({:.1} million answers, {:.1} s; {promises})\n",
            printable(&self.name),
            self.answers as f64 / 1e6,
            self.seconds
        );
        for summary in &self.tests {
            let (name, count) = (summary.test.name(), summary.count);
            let (verdict, figure) = (summary.verdict.name(), figure(&summary.worst));
            writeln!(text, "  {verdict:8} {name:16} {count:4}  {figure:22} {}", place_and_note(summary))
                .expect("a string takes all");
        }
        text
    }
}

impl Claims {
    /// In words.
    #[must_use]
    pub fn text(&self) -> String {
        let surface = match (self.transmits, self.two_sided) {
            (true, _) => "transmits",
            (false, true) => "opaque, two-sided",
            (false, false) => "opaque, one-sided",
        };
        let mut text = surface.to_owned();
        for (is_promised, promise) in [
            (self.reciprocal, "reciprocal"),
            (self.isotropic, "isotropic"),
            (self.conserving, "conserving"),
            (self.tilted, "normals of its own"),
            (self.measured, "a measurement"),
        ] {
            if is_promised {
                text = format!("{text}, {promise}");
            }
        }
        text
    }
}

/// The number of a finding.
#[must_use]
pub fn figure(finding: &Finding) -> String {
    match finding.measure {
        Measure::Statistic { p, .. } => format!("p {}", short(p)),
        Measure::Error { value, limit: 0.0 } => short(value),
        Measure::Error { value, limit } => format!("{} of {}", short(value), short(limit)),
        Measure::Figure { value } => short(value),
        Measure::LeftOut => "left out".to_owned(),
    }
}

/// Where the worst finding is, and its note. Of a comparison that holds, the worst pair is nobody's business.
#[must_use]
pub fn place_and_note(summary: &Summary) -> String {
    let Summary { worst, verdict, .. } = summary;
    let is_comparison = matches!(worst.measure, Measure::Error { .. });
    let is_dull = *verdict == Verdict::Pass && is_comparison && !COUNTING.contains(&worst.test);
    let note = if is_dull { String::new() } else { worst.note.clone() };
    let view = worst.view.map(|view| format!("view {view}"));
    let parts = [worst.component.clone(), view, Some(note)];
    parts.into_iter().flatten().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(": ")
}

/// Tests whose note says how many answers they saw.
const COUNTING: [Test; 3] = [Test::Finite, Test::NonNegative, Test::Deterministic];

/// A number with few digits.
fn short(x: f64) -> String {
    if x == 0.0 || (1e-3..1e5).contains(&x.abs()) {
        let text = format!("{x:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        format!("{x:.1e}")
    }
}
