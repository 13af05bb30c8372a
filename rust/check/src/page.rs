//! A run as one self-contained HTML page: verdicts, and the pictures behind them.

use std::fmt::Write;

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
    let mut page = format!(
        "<!doctype html><html lang=en><meta charset=utf-8>\
         <meta name=viewport content='width=device-width, initial-scale=1'>\
         <title>glimt check</title><style>{STYLE}</style>\n<h1>{} glimt check</h1>\n",
        chip(report.verdict)
    );
    let failed = report.failed().len();
    add(
        &mut page,
        format_args!(
            "<p>{} of {} passed. {} p-values, each a failure below {:.1e}: a run over correct BSDFs passes with \
             probability {}.</p>\n",
            report.subjects.len() - failed,
            report.subjects.len(),
            report.p_values,
            report.threshold,
            1.0 - report.significance
        ),
    );
    if report.subjects.len() > 1 {
        page += &matrix(report);
    }
    page += &legend();
    for (index, subject) in report.subjects.iter().enumerate() {
        let is_open = report.subjects.len() == 1 || subject.verdict == Verdict::Fail;
        page += &section(subject, index, is_open, report.threshold);
    }
    page + "</html>\n"
}

fn add(page: &mut String, text: std::fmt::Arguments) {
    page.write_fmt(text).expect("a string takes all");
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

fn chip(verdict: Verdict) -> String {
    let (class, word) = spelling(verdict);
    format!("<span class='chip {class}'>{word}</span>")
}

/// Text as HTML.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('\'', "&#39;")
        .replace('"', "&quot;")
}

/// All subjects and tests at a glance.
fn matrix(report: &Report) -> String {
    let mut tests: Vec<Test> = report.subjects.iter().flat_map(|s| s.tests.iter().map(|t| t.test)).collect();
    tests.sort();
    tests.dedup();
    let mut page = String::from("<section class=wide><table class=matrix><tr><th>");
    for test in &tests {
        add(&mut page, format_args!("<th title='{}'><span>{}</span>", escape(test.question()), test.name()));
    }
    for (index, subject) in report.subjects.iter().enumerate() {
        let (class, _) = spelling(subject.verdict);
        let name = escape(&subject.name);
        add(&mut page, format_args!("<tr><td><a class={class} href='#s{index}'>{name}</a>"));
        for test in &tests {
            let verdict = subject.test(*test).map_or(Verdict::LeftOut, |summary| summary.verdict);
            let (class, word) = spelling(verdict);
            let sign = match verdict {
                Verdict::Pass => "●",
                Verdict::Warning | Verdict::OfTheFile => "▲",
                Verdict::Fail => "✖",
                Verdict::Figure | Verdict::LeftOut => "·",
            };
            add(&mut page, format_args!("<td class={class} title='{}: {word}'>{sign}", test.name()));
        }
    }
    page + "</table></section>\n"
}

/// What the colours mean.
fn legend() -> String {
    let scale = |name: char| {
        let step = |level: usize| format!("<path class={name}{level} stroke-width=8 d='M{level} 4h1.05'/>");
        let steps: String = (0..LEVELS).map(step).collect();
        format!("<svg viewBox='0 0 {LEVELS} 8' preserveAspectRatio=none>{steps}</svg>")
    };
    format!(
        "<section class=legend><span><span class=key style='color:var(--response)'></span>f·cosθ, mean of the \
         channels</span><span><span class=key style='color:var(--pdf)'></span>pdf</span>\
         <span>radius: logarithmic, a ring per decade; dashed: the view</span>\
         <span>{}density, logarithmic over {DECADES} decades</span>\
         <span>{}(observed − expected) / √expected from −{RESIDUAL_RANGE} to {RESIDUAL_RANGE}</span>\
         <span>discs: the hemisphere of lights from above; the distance to the centre is the angle to the \
         normal</span></section>\n",
        scale('d'),
        scale('r')
    )
}

fn section(subject: &Judged, index: usize, is_open: bool, threshold: f64) -> String {
    let open = if is_open { " open" } else { "" };
    let mut page = format!(
        "<details class=subject id=s{index}{open}><summary>{}<h2>{}</h2></summary><p>{}. {:.1} million answers in \
         {:.1} s.</p><div class=wide><table class=tests><tr><th>verdict<th>test<th>checks<th>worst<th>where\n",
        chip(subject.verdict),
        escape(&subject.name),
        subject.claims.text(),
        subject.answers as f64 / 1e6,
        subject.seconds
    );
    for summary in &subject.tests {
        add(
            &mut page,
            format_args!(
                "<tr><td>{}<td>{}<div class=question>{}</div><td>{}<td class=figure>{}<td class=note>{}\n",
                chip(summary.verdict),
                summary.test.name(),
                summary.test.question(),
                summary.count,
                figure(&summary.worst),
                escape(&place_and_note(summary))
            ),
        );
    }
    add(&mut page, format_args!("</table></div><h3>Directional albedo</h3>{}", svg::albedo(&subject.views)));
    page += "<h3>Views</h3><div class=views>";
    for sight in &subject.views {
        page += &card(subject, sight, threshold);
    }
    page + "</div></details>\n"
}

/// One view.
fn card(subject: &Judged, sight: &Sight, threshold: f64) -> String {
    let bad = bad_tests(subject, sight.view, threshold);
    let class = if bad.is_empty() { "sight" } else { "sight bad" };
    let mut page = format!(
        "<div class='{class}'><h4>view {}<span>{}</span></h4>{}",
        sight.view,
        caption(subject, sight, &bad),
        svg::polar(&sight.picture.slice, -sight.view.theta.to_radians())
    );
    for map in &sight.picture.maps {
        let greatest = svg::greatest(map);
        let side = match (sight.picture.maps.len(), map.is_upper) {
            (1, _) => "",
            (_, true) => ", above",
            (_, false) => ", below",
        };
        page += "<div class=discs>";
        for (shown, title) in
            [(Shown::Expected, "expected"), (Shown::Observed, "observed"), (Shown::Residual, "residual")]
        {
            add(&mut page, format_args!("<div>{}{title}{side}</div>", svg::disc(map, shown, greatest)));
        }
        page += "</div>";
    }
    page + "</div>"
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

fn caption(subject: &Judged, sight: &Sight, bad: &[&str]) -> String {
    if !bad.is_empty() {
        return format!("<b class=fail>{}</b>", bad.join(", "));
    }
    let histogram = subject.findings.iter().find(|f| {
        f.test == Test::ChiSquared
            && f.view == Some(sight.view)
            && f.component.is_none()
            && f.severity == Severity::Failure
    });
    match histogram.map(|finding| finding.measure) {
        Some(Measure::Statistic { p, .. }) => format!("χ² p {p:.3}, ∫pdf {:.3}", sight.pdf_integral),
        _ => format!("∫pdf {:.3}, delta {:.0} %", sight.pdf_integral, 100.0 * sight.delta_share),
    }
}
