//! What `glimt bench` prints.

use std::fmt::Write;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Result;
use glimt_core::simd::isa_name;
use serde::Serialize;

use super::cases::Case;

/// All measurements, and where and when they were made.
#[derive(Serialize)]
pub struct Report {
    glimt: &'static str,
    cpu: String,
    instruction_set: &'static str,
    date: String,
    pub measurements: Vec<Measurement>,
}

/// The time of one way, in ns for an evaluation, a sample or a step.
#[derive(Serialize)]
pub struct Measurement {
    model: &'static str,
    net: String,
    way: &'static str,
    threads: usize,
    ns: f64,
    quartiles_ns: [f64; 2],
    #[serde(skip_serializing_if = "Option::is_none")]
    limit_ns: Option<f64>,
    /// Median of the ratios of time and limit, round by round.
    #[serde(skip_serializing_if = "Option::is_none")]
    over_limit: Option<f64>,
}

impl Measurement {
    /// From times and limits in seconds, each of every round; no limit where there are no multiply-adds.
    pub fn new(
        case: &Case,
        way: &'static str,
        threads: usize,
        seconds: &[f64],
        limits: Option<&[f64]>,
    ) -> Self {
        let ns = |q| 1e9 * quantile(seconds, q);
        let ratios = |limits: &[f64]| seconds.iter().zip(limits).map(|(t, l)| t / l).collect::<Vec<_>>();
        Measurement {
            model: case.material.kind().name(),
            net: case.size(),
            way,
            threads,
            ns: ns(0.5),
            quartiles_ns: [ns(0.25), ns(0.75)],
            limit_ns: limits.map(|limits| 1e9 * quantile(limits, 0.5)),
            over_limit: limits.map(|limits| quantile(&ratios(limits), 0.5)),
        }
    }
}

/// By linear interpolation between the two nearest.
pub fn quantile(values: &[f64], q: f64) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    let position = q * (values.len() - 1) as f64;
    let (low, high) = (values[position.floor() as usize], values[position.ceil() as usize]);
    low + position.fract() * (high - low)
}

impl Report {
    pub fn new() -> Self {
        Report {
            glimt: env!("CARGO_PKG_VERSION"),
            cpu: cpu(),
            instruction_set: isa_name(),
            date: today(),
            measurements: Vec::new(),
        }
    }

    pub fn json(&self) -> Result<String> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// The measurements of the last case as lines of a table, with its head before the first.
    pub fn text(&self, first: bool) -> String {
        let mut text = String::new();
        if first {
            let Report { glimt, cpu, instruction_set, date, .. } = self;
            let _ = writeln!(text, "glimt {glimt}, {cpu}, {instruction_set}, {date}; ns\n");
            let _ = writeln!(
                text,
                "{:8} {:6} {:12} {:>7} {:>12} {:>25} {:>12} {:>8}",
                "model", "net", "way", "threads", "median", "quartiles", "limit", "x limit"
            );
        }
        let last = self.measurements.last().map(|m| (m.model, &m.net));
        for m in self.measurements.iter().filter(|m| Some((m.model, &m.net)) == last) {
            let quartiles = m.quartiles_ns.map(number).join(" to ");
            let (limit, over) = match (m.limit_ns, m.over_limit) {
                (Some(limit), Some(over)) => (number(limit), format!("{over:.2}")),
                _ => ("–".into(), "–".into()),
            };
            let (model, net, way, threads, ns) = (m.model, &m.net, m.way, m.threads, number(m.ns));
            let _ = writeln!(
                text,
                "{model:8} {net:6} {way:12} {threads:7} {ns:>12} {quartiles:>25} {limit:>12} {over:>8}"
            );
        }
        text
    }
}

/// As many digits as mean something.
fn number(ns: f64) -> String {
    if ns < 1000.0 { format!("{ns:.1}") } else { format!("{ns:.0}") }
}

/// The processor's name, where the system tells it.
pub fn cpu() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, name)| name.trim().to_owned())
}

/// The date in UTC.
pub fn today() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs());
    let [year, month, day] = civil(seconds / 86_400);
    format!("{year}-{month:02}-{day:02}")
}

/// Year, month and day of a number of days since 1970-01-01 (H. Hinnant, "chrono-Compatible Low-Level Date
/// Algorithms", `civil_from_days`): years begin in March, so that the leap day is the last.
fn civil(days: u64) -> [u64; 3] {
    let days = days + 719_468;
    let (era, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    [year + 400 * era + u64::from(month <= 2), month, day]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        assert_eq!(civil(0), [1970, 1, 1]);
        assert_eq!(civil(59), [1970, 3, 1]);
        assert_eq!(civil(11_016), [2000, 2, 29]);
        assert_eq!(civil(20_779), [2026, 11, 22]);
    }

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), 2.0);
        assert_eq!(quantile(&[1.0, 2.0], 0.25), 1.25);
        assert_eq!(quantile(&[5.0], 0.75), 5.0);
    }
}
