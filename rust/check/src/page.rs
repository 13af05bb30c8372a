//! A run as one self-contained HTML page: verdicts, and the pictures behind them.

use maud::{Markup, PreEscaped, html};

use crate::picture::Map;
use crate::report::{Judged, Report, figure, place_and_note};
use crate::run::Sight;
use crate::svg::{self, DECADES, LEVELS, RESIDUAL_RANGE, Shown};
use crate::verdict::{Measure, Severity, Test, Verdict};
use crate::views::View;

/// Style, light and dark.
const STYLE: &str = include_str!("page.css");

/// The page of a report.
#[must_use]
pub fn html(report: &Report) -> String {
    let passed = report.subjects.len() - report.failed().len();
    let page = html! {
        // As the command recognises its pages by.
        (PreEscaped("<!doctype html>"))
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "glimt check" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (chip(report.verdict)) " glimt check" }
                p {
                    (passed) " of " (report.subjects.len()) " passed. " (report.p_values)
                    (format!(" p-values, each a failure below {:.1e}", report.threshold))
                    ": a run over correct BSDFs passes with probability " (1.0 - report.significance) "."
                }
                @if report.subjects.len() > 1 { (matrix(report)) }
                (legend())
                @for (index, subject) in report.subjects.iter().enumerate() {
                    @let is_open = report.subjects.len() == 1 || subject.verdict == Verdict::Fail;
                    (section(subject, index, is_open, report.threshold))
                }
            }
        }
    };
    page.into_string() + "\n"
}

/// CSS class and word of a verdict.
fn spelling(verdict: Verdict) -> (&'static str, &'static str) {
    match verdict {
        Verdict::Fail => ("fail", "FAIL"),
        Verdict::Warning => ("warning", "warning"),
        Verdict::OfTheFile => ("warning", "of the file"),
        Verdict::Pass => ("pass", "pass"),
        Verdict::Figure => ("figure-only", "figure"),
        Verdict::LeftOut => ("left-out", "left out"),
    }
}

fn chip(verdict: Verdict) -> Markup {
    let (class, word) = spelling(verdict);
    html! { span class=(format!("chip {class}")) { (word) } }
}

/// All subjects and tests at a glance.
fn matrix(report: &Report) -> Markup {
    let mut tests: Vec<Test> = report.subjects.iter().flat_map(|s| s.tests.iter().map(|t| t.test)).collect();
    tests.sort();
    tests.dedup();
    html! {
        section.wide {
            table.matrix {
                tr {
                    th {}
                    @for test in &tests { th title=(test.question()) { span { (test.name()) } } }
                }
                @for (index, subject) in report.subjects.iter().enumerate() {
                    tr {
                        td { a class=(spelling(subject.verdict).0) href=(format!("#s{index}")) { (subject.name) } }
                        @for &test in &tests { (sign(subject, test)) }
                    }
                }
            }
        }
    }
}

/// A subject's verdict in a test, as one character.
fn sign(subject: &Judged, test: Test) -> Markup {
    let verdict = subject.test(test).map_or(Verdict::LeftOut, |summary| summary.verdict);
    let (class, word) = spelling(verdict);
    let sign = match verdict {
        Verdict::Pass => "●",
        Verdict::Warning | Verdict::OfTheFile => "▲",
        Verdict::Fail => "✖",
        Verdict::Figure | Verdict::LeftOut => "·",
    };
    html! { td class=(class) title=(format!("{}: {word}", test.name())) { (sign) } }
}

/// What the colours mean.
fn legend() -> Markup {
    let key = |colour: &str| html! { span.key style=(format!("color:var(--{colour})")) {} };
    html! {
        section.legend {
            span { (key("response")) "f·cosθ, mean of the channels" }
            span { (key("pdf")) "pdf" }
            span { "radius: logarithmic, a ring per decade; dashed: the view" }
            span { (scale('d')) "density, logarithmic over " (DECADES) " decades" }
            span {
                (scale('r')) "(observed − expected) / √expected from −" (RESIDUAL_RANGE) " to " (RESIDUAL_RANGE)
            }
            span {
                "discs: the hemisphere of lights from above; the distance to the centre is the angle to the normal"
            }
        }
    }
}

/// The steps of a scale of colours.
fn scale(name: char) -> Markup {
    html! {
        svg viewBox=(format!("0 0 {LEVELS} 8")) preserveAspectRatio="none" {
            @for level in 0..LEVELS {
                path class=(format!("{name}{level}")) stroke-width="8" d=(format!("M{level} 4h1.05")) {}
            }
        }
    }
}

fn section(subject: &Judged, index: usize, is_open: bool, threshold: f64) -> Markup {
    html! {
        details.subject id=(format!("s{index}")) open[is_open] {
            summary { (chip(subject.verdict)) h2 { (subject.name) } }
            p {
                (subject.claims.text())
                (format!(". {:.1} million answers in {:.1} s.", subject.answers as f64 / 1e6, subject.seconds))
            }
            div.wide {
                table.tests {
                    tr { th { "verdict" } th { "test" } th { "checks" } th { "worst" } th { "where" } }
                    @for summary in &subject.tests {
                        tr {
                            td { (chip(summary.verdict)) }
                            td { (summary.test.name()) div.question { (summary.test.question()) } }
                            td { (summary.count) }
                            td.figure { (figure(&summary.worst)) }
                            td.note { (place_and_note(summary)) }
                        }
                    }
                }
            }
            h3 { "Directional albedo" }
            (PreEscaped(svg::albedo(&subject.views)))
            h3 { "Views" }
            div.views { @for sight in &subject.views { (card(subject, sight, threshold)) } }
        }
    }
}

/// One view.
fn card(subject: &Judged, sight: &Sight, threshold: f64) -> Markup {
    let bad = bad_tests(subject, sight.view, threshold);
    html! {
        div.sight.bad[!bad.is_empty()] {
            h4 { "view " (sight.view.to_string()) span { (caption(subject, sight, &bad)) } }
            (PreEscaped(svg::polar(&sight.picture.slice, -sight.view.theta.to_radians())))
            @for map in &sight.picture.maps { (discs(map, sight.picture.maps.len())) }
        }
    }
}

/// A hemisphere, as one of so many.
fn discs(map: &Map, hemispheres: usize) -> Markup {
    let greatest = svg::greatest(map);
    let side = match (hemispheres, map.is_upper) {
        (1, _) => "",
        (_, true) => ", above",
        (_, false) => ", below",
    };
    let kinds = [(Shown::Expected, "expected"), (Shown::Observed, "observed"), (Shown::Residual, "residual")];
    html! {
        div.discs {
            @for (shown, title) in kinds { div { (PreEscaped(svg::disc(map, shown, greatest))) (title) (side) } }
        }
    }
}

/// Tests of the whole that failed at a view.
fn bad_tests(subject: &Judged, view: View, threshold: f64) -> Vec<&'static str> {
    let is_bad = |f: &&crate::verdict::Finding| {
        f.view == Some(view) && f.component.is_none() && f.verdict(threshold) == Verdict::Fail
    };
    let mut names: Vec<_> =
        subject.findings.iter().filter(is_bad).map(|finding| finding.test.name()).collect();
    names.dedup();
    names
}

fn caption(subject: &Judged, sight: &Sight, bad: &[&str]) -> Markup {
    if !bad.is_empty() {
        return html! { b.fail { (bad.join(", ")) } };
    }
    let histogram = subject.findings.iter().find(|f| {
        f.test == Test::ChiSquared
            && f.view == Some(sight.view)
            && f.component.is_none()
            && f.severity == Severity::Failure
    });
    let text = match histogram.map(|finding| finding.measure) {
        Some(Measure::Statistic { p, .. }) => format!("χ² p {p:.3}, ∫pdf {:.3}", sight.pdf_integral),
        _ => format!("∫pdf {:.3}, delta {:.0} %", sight.pdf_integral, 100.0 * sight.delta_share),
    };
    html! { (text) }
}
