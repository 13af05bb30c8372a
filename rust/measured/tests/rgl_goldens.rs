//! Real RGL measurements against RGL's own reader (`*.pow.txt`) and Mitsuba's `measured` (`*.mi.txt`).

use std::path::{Path, PathBuf};

use glimt_core::sampling::DirectionSampler;
use glimt_core::{Brdf, Vec3};
use glimt_measured::Rgl;

/// Where the half vector is the normal its azimuth, which the tables depend on, is rounding noise.
const MIRROR: f64 = 1e-6;
const MEDIAN: f64 = 1e-6;
const PERCENTILE_95: f64 = 1e-4;
/// The references' smallest values are rounding noise of interpolated zeros.
const TINY: f64 = 1e-7;

struct Query {
    theta_view: f64,
    theta_light: f64,
    dphi: f64,
}

impl Query {
    fn directions(&self) -> (Vec3, Vec3) {
        let direction = |theta: f64, phi: f64| {
            let (sin, cos) = theta.sin_cos();
            Vec3::new((sin * phi.cos()) as f32, (sin * phi.sin()) as f32, cos as f32)
        };
        (direction(self.theta_light, self.dphi), direction(self.theta_view, 0.0))
    }

    fn is_mirror_pair(&self) -> bool {
        (self.theta_view - self.theta_light).abs() < MIRROR
            && (self.dphi - std::f64::consts::PI).abs() < MIRROR
    }
}

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/rgl")
}

fn rows<const N: usize>(path: &Path) -> Vec<[f64; N]> {
    let text = std::fs::read_to_string(path).unwrap();
    let row = |line: &str| {
        let numbers: Vec<f64> = line.split_whitespace().map(|word| word.parse().unwrap()).collect();
        <[f64; N]>::try_from(numbers).unwrap()
    };
    text.lines().map(row).collect()
}

fn queries(data: &Path) -> Vec<Query> {
    let query = |[theta_view, theta_light, dphi]: [f64; 3]| Query { theta_view, theta_light, dphi };
    rows(&data.join("queries.txt")).into_iter().map(query).collect()
}

fn materials(data: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(data).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> =
        entries.filter(|path| path.extension().is_some_and(|e| e == "bsdf")).collect();
    files.sort();
    files
}

/// Relative differences of f (three channels) and of the pdf, away from mirror pairs.
fn differences(data: &Path, file: &Path, reader: &str) -> (Vec<f64>, Vec<f64>) {
    let brdf = Rgl::open(file).unwrap();
    let goldens: Vec<[f64; 4]> = rows(&file.with_extension(format!("{reader}.txt")));
    let queries = queries(data);
    assert_eq!(queries.len(), goldens.len());
    let relative = |found: f64, expected: f64| (found - expected).abs() / expected.abs().max(TINY);
    let (mut f, mut pdf) = (Vec::new(), Vec::new());
    for (query, golden) in queries.iter().zip(&goldens).filter(|(query, _)| !query.is_mirror_pair()) {
        let (light, view) = query.directions();
        let factor = if reader == "pow" { f64::from(light.z) } else { 1.0 };
        let found = brdf.eval(light, view).to_array().map(|x| f64::from(x) * factor);
        // Mitsuba returns negative interpolated reflectances as they are; RGL's reader and this one clamp.
        f.extend((0..3).map(|channel| relative(found[channel], golden[channel].max(0.0))));
        pdf.push(relative(f64::from(brdf.pdf(light, view)), golden[3]));
    }
    f.sort_by(f64::total_cmp);
    pdf.sort_by(f64::total_cmp);
    (f, pdf)
}

fn agrees_with(reader: &str) {
    let data = data();
    let files = materials(&data);
    assert!(!files.is_empty());
    for file in files {
        let name = file.file_stem().unwrap().to_string_lossy().into_owned();
        let (f, pdf) = differences(&data, &file, reader);
        for (what, sorted) in [("f", f), ("pdf", pdf)] {
            let at = |quantile: f64| sorted[((sorted.len() - 1) as f64 * quantile) as usize];
            let (median, p95, worst) = (at(0.5), at(0.95), at(1.0));
            println!("{name:28} {reader} {what:3}: median {median:.1e}, 95% {p95:.1e}, max {worst:.1e}");
            assert!(median <= MEDIAN && p95 <= PERCENTILE_95, "{name} {what}");
        }
    }
}

mod reference_data {
    use super::agrees_with;

    #[test]
    #[ignore = "reads reference data from ../shared/data, which is not part of the project"]
    fn agrees_with_the_databases_own_reader() {
        agrees_with("pow");
    }

    #[test]
    #[ignore = "reads reference data from ../shared/data, which is not part of the project"]
    fn agrees_with_mitsuba() {
        agrees_with("mi");
    }
}
