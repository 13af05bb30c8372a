//! Drawings of a page, as inline SVG whose colours are CSS classes: they follow the page's theme.

use std::f64::consts::PI;
use std::fmt::Write;

use crate::picture::{MAP_SIZE, Map, Pixel, SlicePoint};
use crate::run::Sight;

/// Steps of the colour scales.
pub const LEVELS: usize = 10;
/// Decades of a density that the logarithmic scales show.
pub const DECADES: f64 = 4.0;
/// Residual in standard deviations at the ends of its scale.
pub const RESIDUAL_RANGE: f64 = 5.0;
/// Radius of a polar plot.
const RADIUS: f64 = 100.0;

/// Response and density around the plane of incidence, the radius logarithmic over [`DECADES`].
#[must_use]
pub fn polar(slice: &[SlicePoint], view_angle: f64) -> String {
    let greatest = slice.iter().map(|point| point.response.max(point.pdf)).fold(0.0, f64::max);
    let has_below = slice.iter().any(|point| point.angle.abs() > PI / 2.0);
    let has_above = slice.iter().any(|point| point.angle.abs() < PI / 2.0);
    let (top, bottom) = (if has_above { -RADIUS } else { 0.0 }, if has_below { RADIUS } else { 0.0 });
    let margin = 12.0;
    let mut svg = format!(
        "<svg class=polar viewBox='{} {} {} {}' role=img aria-label='polar plot of response and density'>",
        -RADIUS - margin,
        top - margin,
        2.0 * (RADIUS + margin),
        bottom - top + 2.0 * margin
    );
    for ring in 1..=DECADES as usize {
        let r = RADIUS * ring as f64 / DECADES;
        let arc = |x: f64, sweep: u8, to: f64| format!("M{x:.0} 0A{r:.0} {r:.0} 0 0 {sweep} {to:.0} 0");
        let upper = if has_above { arc(-r, 1, r) } else { String::new() };
        let lower = if has_below { arc(-r, 0, r) } else { String::new() };
        write!(svg, "<path class=grid d='{upper}{lower}'/>").expect("a string takes all");
    }
    write!(svg, "<path class=axis d='M{0:.0} 0H{1:.0}'/>", -RADIUS, RADIUS).expect("a string takes all");
    let (x, y) = at(view_angle, RADIUS);
    write!(svg, "<path class=view d='M0 0L{x:.1} {y:.1}'/>").expect("a string takes all");
    for (class, value) in [("pdf", (|p| p.pdf) as fn(&SlicePoint) -> f64), ("response", |p| p.response)] {
        let path = curve(slice, greatest, value);
        write!(svg, "<path class={class} d='{path}'/>").expect("a string takes all");
    }
    if greatest > 0.0 {
        let (x, y) = (RADIUS + margin - 2.0, top - 2.0);
        write!(svg, "<text x={x:.0} y={y:.0} text-anchor=end>outer ring {greatest:.3} sr⁻¹</text>")
            .expect("a string takes all");
    }
    svg + "</svg>"
}

/// The point at an angle to the normal; the mirror direction is to the right.
fn at(angle: f64, radius: f64) -> (f64, f64) {
    (radius * angle.sin(), -radius * angle.cos())
}

fn curve(slice: &[SlicePoint], greatest: f64, value: impl Fn(&SlicePoint) -> f64) -> String {
    let mut path = String::new();
    let mut last = f64::NAN;
    for point in slice {
        let radius = RADIUS * logarithmic(value(point), greatest);
        let (x, y) = at(point.angle, radius);
        // A gap where a half of the sphere ends.
        let command = if (point.angle - last).abs() < 0.1 { 'L' } else { 'M' };
        write!(path, "{command}{x:.1} {y:.1}").expect("a string takes all");
        last = point.angle;
    }
    path
}

/// Where a value stands on the logarithmic scale from 0, [`DECADES`] below `greatest`, to 1.
fn logarithmic(value: f64, greatest: f64) -> f64 {
    if value > 0.0 && greatest > 0.0 {
        (1.0 + (value / greatest).log10() / DECADES).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

/// What a disc shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// Density by quadrature.
    Expected,
    /// Density by the histogram.
    Observed,
    /// Their difference in standard deviations.
    Residual,
}

/// A hemisphere from above; `greatest` is the density at the end of the scale.
#[must_use]
pub fn disc(map: &Map, shown: Shown, greatest: f64) -> String {
    let last = LEVELS as f64 - 1.0;
    let level = |pixel: &Pixel| {
        let scaled = match shown {
            Shown::Expected => logarithmic(pixel.expected, greatest),
            Shown::Observed => logarithmic(pixel.observed, greatest),
            Shown::Residual => 0.5 + 0.5 * (pixel.residual / RESIDUAL_RANGE).clamp(-1.0, 1.0),
        };
        (scaled * last).round() as usize
    };
    let mut paths = vec![String::new(); LEVELS];
    for (row, pixels) in map.pixels.chunks_exact(MAP_SIZE).enumerate() {
        let levels: Vec<Option<usize>> = pixels.iter().map(|pixel| pixel.as_ref().map(level)).collect();
        let mut column = 0;
        for run in levels.chunk_by(|a, b| a == b) {
            if let Some(level) = run[0] {
                write!(paths[level], "M{column} {row}.5h{}", run.len()).expect("a string takes all");
            }
            column += run.len();
        }
    }
    let scale = if shown == Shown::Residual { 'r' } else { 'd' };
    let mut svg =
        format!("<svg class=disc viewBox='0 0 {MAP_SIZE} {MAP_SIZE}' role=img aria-label='{shown:?}'>");
    for (level, path) in paths.iter().enumerate().filter(|(_, path)| !path.is_empty()) {
        write!(svg, "<path class={scale}{level} d='{path}'/>").expect("a string takes all");
    }
    svg + "</svg>"
}

/// The greatest density that a map expects.
#[must_use]
pub fn greatest(map: &Map) -> f64 {
    map.pixels.iter().flatten().map(|pixel| pixel.expected).fold(0.0, f64::max)
}

/// Directional albedo over the angle of the view, with the line that energy must not cross.
#[must_use]
pub fn albedo(views: &[Sight]) -> String {
    let (width, height, left, bottom) = (420.0, 150.0, 34.0, 22.0);
    let top = views.iter().map(|sight| sight.albedo.greatest()).fold(1.0, f64::max) * 1.08;
    let x = |theta: f64| left + (theta % 180.0) / 90.0 * (width - left - 8.0);
    let y = |albedo: f64| height - bottom - albedo / top * (height - bottom - 6.0);
    let mut svg = format!("<svg class=albedo viewBox='0 0 {width} {height}' role=img aria-label='albedo'>");
    for theta in [0.0, 30.0, 60.0, 90.0] {
        write!(
            svg,
            "<path class=grid d='M{0:.1} 4V{1:.1}'/><text x={0:.1} y={2:.0} text-anchor=middle>{theta}°</text>",
            x(theta),
            height - bottom,
            height - 7.0
        )
        .expect("a string takes all");
    }
    for (albedo, class) in [(0.0, "axis"), (1.0, "limit")] {
        write!(
            svg,
            "<path class={class} d='M{left:.1} {0:.1}H{1:.1}'/><text x={2:.1} y={3:.1} text-anchor=end>{albedo}</text>",
            y(albedo),
            width - 8.0,
            left - 5.0,
            y(albedo) + 3.5
        )
        .expect("a string takes all");
    }
    for (channel, class) in ["red", "green", "blue"].into_iter().enumerate() {
        for sight in views {
            // Views from below are drawn at the same angle to the surface as those from above, hollow.
            let is_below = sight.view.theta > 90.0;
            let theta = if is_below { 180.0 - sight.view.theta } else { sight.view.theta };
            let side = if is_below { " below" } else { "" };
            let (mean, error) = (sight.albedo.mean[channel], sight.albedo.error[channel]);
            write!(
                svg,
                "<path class='bar {class}' d='M{0:.1} {1:.1}V{2:.1}'/><circle class='{class}{side}' cx={0:.1} cy={3:.1} r=2.6 />",
                x(theta),
                y(mean + error),
                y((mean - error).max(0.0)),
                y(mean)
            )
            .expect("a string takes all");
        }
    }
    svg + "</svg>"
}
