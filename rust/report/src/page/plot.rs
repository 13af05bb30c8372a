//! Plots as SVG whose colours are CSS classes: in a page they follow its theme.

use std::fmt::Write;

use maud::Render;

use crate::study::pareto::front;

/// Size of a plot, in its own units.
const SIZE: [f64; 2] = [420.0, 270.0];
/// Room for numbers and names: left, right, top, bottom.
const MARGINS: [f64; 4] = [56.0, 14.0, 16.0, 40.0];

/// A scale from values to places, logarithmic or linear.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    range: [f64; 2],
    is_logarithmic: bool,
    places: [f64; 2],
}

impl Scale {
    /// Over the positive values, a little wider than they are.
    fn logarithmic(values: impl Iterator<Item = f64>, places: [f64; 2]) -> Scale {
        let positive = values.filter(|x| *x > 0.0 && x.is_finite());
        let [low, high] = positive.fold([f64::INFINITY, 0.0], |[low, high], x| [x.min(low), x.max(high)]);
        let [low, high] = if low <= high { [low, high] } else { [0.1, 10.0] };
        // At least a factor of four, so that the axis has two numbers.
        let slack = (high / low).powf(0.08).max(2.0 / (high / low).sqrt()).max(1.08);
        Scale { range: [low / slack, high * slack], is_logarithmic: true, places }
    }

    fn linear(range: [f64; 2], places: [f64; 2]) -> Scale {
        Scale { range, is_logarithmic: false, places }
    }

    /// Where a value stands; what is beyond the range stands at its end.
    fn at(&self, value: f64) -> f64 {
        let [low, high] = self.range;
        let share = if self.is_logarithmic {
            (value.max(low) / low).ln() / (high / low).ln()
        } else {
            (value - low) / (high - low)
        };
        self.places[0] + share.clamp(0.0, 1.0) * (self.places[1] - self.places[0])
    }

    fn ticks(&self) -> Vec<f64> {
        let [low, high] = self.range;
        if self.is_logarithmic {
            let decades = (low.log10().floor() as i32)..=(high.log10().ceil() as i32);
            let within = |steps: &[f64]| -> Vec<f64> {
                let of = |decade: i32| steps.iter().map(move |step| step * 10_f64.powi(decade));
                decades.clone().flat_map(of).filter(|x| (low..=high).contains(x)).collect()
            };
            // Decades alone where there are many of them.
            [&[1.0][..], &[1.0, 3.0], &[1.0, 2.0, 5.0], &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0]]
                .into_iter()
                .map(within)
                .find(|ticks| ticks.len() >= 3)
                .unwrap_or_else(|| vec![low, high])
        } else {
            let step = 10_f64.powf(((high - low) / 5.0).log10().ceil());
            let step = [0.2, 0.5, 1.0]
                .map(|x| x * step)
                .into_iter()
                .find(|x| (high - low) / x <= 6.0)
                .unwrap_or(step);
            let first = (low / step).ceil() as i64;
            (first..).map(|i| i as f64 * step).take_while(|x| *x <= high + 1e-9 * step).collect()
        }
    }
}

/// A number as an axis shows it.
#[must_use]
pub fn short(x: f64) -> String {
    let text = match x.abs() {
        0.0 => "0".into(),
        size if size >= 1e6 => format!("{}M", trim(x / 1e6)),
        size if size >= 1e4 => format!("{}k", trim(x / 1e3)),
        size if size >= 1e-2 => trim(x),
        _ => format!("{x:.1e}").replace(".0e", "e"),
    };
    text.replace('-', "−")
}

/// Three significant digits, without zeros at the end.
fn trim(x: f64) -> String {
    let decimals = (2 - x.abs().log10().floor() as i32).clamp(0, 6) as usize;
    let text = format!("{x:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Something with a colour: the class of CSS and the name.
#[derive(Clone, Debug)]
pub struct Mark {
    /// `truth`, or `c` and the number of a model.
    pub class: String,
    /// What it is called.
    pub name: String,
}

/// Text as SVG, between tags or in double quotes.
fn escape(text: &str) -> String {
    text.render().into_string()
}

fn add(text: &mut String, part: std::fmt::Arguments) {
    text.write_fmt(part).expect("a string takes all");
}

/// The frame of a plot: opening tag, grid, numbers and names of the axes.
fn axes(x: &Scale, y: &Scale, names: [&str; 2]) -> String {
    let [width, height] = SIZE;
    let mut svg = format!(
        "<svg class='plot' viewBox='0 0 {width} {height}' role='img' aria-label=\"{} against {}\">",
        escape(names[1]),
        escape(names[0])
    );
    for tick in x.ticks() {
        add(
            &mut svg,
            format_args!(
                "<path class='grid' d='M{0:.1} {1:.1}V{2:.1}'/><text x='{0:.1}' y='{3:.1}' text-anchor='middle'>{4}</text>",
                x.at(tick),
                y.places[1],
                y.places[0],
                y.places[0] + 14.0,
                short(tick)
            ),
        );
    }
    for tick in y.ticks() {
        add(
            &mut svg,
            format_args!(
                "<path class='grid' d='M{0:.1} {1:.1}H{2:.1}'/><text x='{3:.1}' y='{4:.1}' text-anchor='end'>{5}</text>",
                x.places[0],
                y.at(tick),
                x.places[1],
                x.places[0] - 5.0,
                y.at(tick) + 3.5,
                short(tick)
            ),
        );
    }
    add(
        &mut svg,
        format_args!(
            "<text class='name' x='{0:.1}' y='{1:.1}' text-anchor='middle'>{2}</text>\
             <text class='name' transform='translate(11 {3:.1}) rotate(-90)' text-anchor='middle'>{4}</text>",
            (x.places[0] + x.places[1]) / 2.0,
            SIZE[1] - 6.0,
            escape(names[0]),
            (y.places[0] + y.places[1]) / 2.0,
            escape(names[1])
        ),
    );
    svg
}

fn places() -> [[f64; 2]; 2] {
    let [left, right, top, bottom] = MARGINS;
    [[left, SIZE[0] - right], [SIZE[1] - bottom, top]]
}

/// A point of a [`scatter`].
#[derive(Clone, Debug)]
pub struct Point {
    /// What it is.
    pub mark: Mark,
    /// Cost and error.
    pub at: [f64; 2],
    /// Whether it is a mean over some of the materials only: it is drawn hollow, and cannot be on the front.
    pub is_partial: bool,
}

/// Points on logarithmic axes, with the front that no point beats, and a dashed line at `noise` where there is one.
#[must_use]
pub fn scatter(points: &[Point], names: [&str; 2], noise: Option<f64>) -> String {
    let has_place = |point: &&Point| point.at.iter().all(|x| x.is_finite() && *x > 0.0);
    let shown: Vec<&Point> = points.iter().filter(has_place).collect();
    let [across, up] = places();
    let x = Scale::logarithmic(shown.iter().map(|point| point.at[0]), across);
    let y = Scale::logarithmic(shown.iter().map(|point| point.at[1]).chain(noise), up);
    let mut svg = axes(&x, &y, names);
    if let Some(noise) = noise {
        add(
            &mut svg,
            format_args!(
                "<path class='noise' d='M{:.1} {1:.1}H{2:.1}'/><text x='{2:.1}' y='{3:.1}' text-anchor='end'>noise of the measurement</text>",
                across[0],
                y.at(noise),
                across[1],
                y.at(noise) - 4.0
            ),
        );
    }
    let values: Vec<[f64; 2]> = shown.iter().filter(|p| !p.is_partial).map(|p| p.at).collect();
    let mut path = String::new();
    for i in front(&values) {
        let [px, py] = [x.at(values[i][0]), y.at(values[i][1])];
        // A step: until the next point costs this much, this is the least error to be had.
        let step = if path.is_empty() { format!("M{px:.1} {py:.1}") } else { format!("H{px:.1}V{py:.1}") };
        path += &step;
    }
    if !path.is_empty() {
        add(&mut svg, format_args!("<path class='front' d='{path}H{:.1}'/>", across[1]));
    }
    let mut labels: Vec<([f64; 2], &Point)> =
        shown.iter().map(|&point| ([x.at(point.at[0]), y.at(point.at[1])], point)).collect();
    labels.sort_by(|a, b| a.0[1].total_cmp(&b.0[1]));
    // Start, end and line of every text; names stay clear of each other and of the noise's.
    const NOISE_WIDTH: f64 = 150.0;
    const LINE: f64 = 12.0;
    // Less than a line by what rounding takes of it: a name that has moved below another one is clear of it.
    const TOUCHING: f64 = LINE - 0.1;
    let mut taken: Vec<[f64; 3]> =
        noise.iter().map(|noise| [across[1] - NOISE_WIDTH, across[1], y.at(*noise) - 4.0]).collect();
    for (place, Point { mark, is_partial, .. }) in labels {
        let [px, py] = place;
        let hollow = if *is_partial { " hollow" } else { "" };
        add(
            &mut svg,
            format_args!("<circle class='{}{hollow}' cx='{px:.1}' cy='{py:.1}' r='4.5'/>", mark.class),
        );
        // About the width of the text.
        let width = 6.6 * mark.name.chars().count() as f64 + 10.0;
        let is_left = px + width > across[1];
        let start = if is_left { px - width } else { px };
        // Above the point: at its height the front may run through it.
        let mut line = py - 7.0;
        while let Some(other) =
            taken.iter().find(|[s, e, l]| (l - line).abs() < TOUCHING && *s < start + width && start < *e)
        {
            line = other[2] + LINE;
        }
        taken.push([start, start + width, line]);
        let (anchor, text_x) = if is_left { ("end", px + 4.0) } else { ("start", px - 4.0) };
        add(
            &mut svg,
            format_args!(
                "<text class='label' x='{text_x:.1}' y='{line:.1}' text-anchor='{anchor}'>{}</text>",
                escape(&mark.name)
            ),
        );
    }
    svg + "</svg>"
}

/// How the axes of [`lines`] are divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axes {
    /// Both from 0 or less.
    Linear,
    /// Both logarithmic.
    Logarithmic,
}

/// A curve with its points.
pub type Curve = (Mark, Vec<[f64; 2]>);

/// Curves.
#[must_use]
pub fn lines(curves: &[Curve], names: [&str; 2], axes_kind: Axes) -> String {
    let [across, up] = places();
    let all = |i: usize| curves.iter().flat_map(move |(_, points)| points.iter().map(move |p| p[i]));
    let (x, y) = match axes_kind {
        Axes::Logarithmic => (Scale::logarithmic(all(0), across), Scale::logarithmic(all(1), up)),
        Axes::Linear => {
            let highest = all(1).fold(0.0, f64::max).max(1e-6) * 1.05;
            (Scale::linear([0.0, all(0).fold(1e-9, f64::max)], across), Scale::linear([0.0, highest], up))
        }
    };
    let mut svg = axes(&x, &y, names);
    for (mark, points) in curves {
        add(&mut svg, format_args!("<path class='curve {}' d='{}'/>", mark.class, path(points, &x, &y)));
    }
    svg + "</svg>"
}

fn path(points: &[[f64; 2]], x: &Scale, y: &Scale) -> String {
    let mut path = String::new();
    for (i, point) in points.iter().filter(|point| point[1].is_finite()).enumerate() {
        let command = if i == 0 { 'M' } else { 'L' };
        add(&mut path, format_args!("{command}{:.1} {:.1}", x.at(point[0]), y.at(point[1])));
    }
    path
}

/// Decades that the radius of a polar plot covers.
pub const DECADES: f64 = 6.0;
const RADIUS: f64 = 190.0;

/// A slice of several BRDFs around the plane of incidence, the radius logarithmic over [`DECADES`].
#[must_use]
pub fn polar(angles: &[f64], curves: &[(Mark, &[f32])], view_degrees: f64) -> String {
    let greatest = curves.iter().flat_map(|(_, curve)| curve.iter()).fold(0.0_f32, |a, b| a.max(*b));
    let greatest = f64::from(greatest.max(f32::MIN_POSITIVE));
    let at = |angle: f64, radius: f64| [radius * angle.sin(), -radius * angle.cos()];
    let mut svg = format!(
        "<svg class='plot polar' viewBox='{:.0} {:.0} {:.0} {:.0}' role='img' aria-label='f cosθ seen from {view_degrees}°'>",
        -RADIUS - 8.0,
        -RADIUS - 24.0,
        2.0 * RADIUS + 16.0,
        RADIUS + 34.0
    );
    for ring in 1..=DECADES as usize {
        let r = RADIUS * ring as f64 / DECADES;
        add(&mut svg, format_args!("<path class='grid' d='M{:.1} 0A{r:.1} {r:.1} 0 0 1 {r:.1} 0'/>", -r));
    }
    let [vx, vy] = at(-view_degrees.to_radians(), RADIUS);
    add(
        &mut svg,
        format_args!(
            "<path class='axis' d='M{:.0} 0H{RADIUS:.0}'/><path class='view' d='M0 0L{vx:.1} {vy:.1}'/>",
            -RADIUS
        ),
    );
    for (mark, curve) in curves {
        let mut path = String::new();
        for (i, (&angle, &value)) in angles.iter().zip(*curve).enumerate() {
            let share = 1.0 + (f64::from(value) / greatest).max(1e-30).log10() / DECADES;
            let [x, y] = at(angle, RADIUS * share.clamp(0.0, 1.0));
            add(&mut path, format_args!("{}{x:.1} {y:.1}", if i == 0 { 'M' } else { 'L' }));
        }
        add(&mut svg, format_args!("<path class='curve {}' d='{path}'/>", mark.class));
    }
    add(
        &mut svg,
        format_args!(
            "<text x='{:.0}' y='{:.0}'>view {view_degrees}°</text><text x='{RADIUS:.0}' y='{1:.0}' text-anchor='end'>outer ring {2} sr⁻¹</text>",
            -RADIUS,
            -RADIUS - 8.0,
            short(greatest)
        ),
    );
    svg + "</svg>"
}

/// A plot as a file of its own: with its style, and below it who made it.
#[must_use]
pub fn standalone(svg: &str, style: &str, legend: &[Mark], notes: &[String]) -> String {
    let head = svg.find("viewBox='").expect("every plot has a view box") + "viewBox='".len();
    let end = head + svg[head..].find('\'').expect("an attribute ends");
    let numbers: Vec<f64> = svg[head..end].split(' ').filter_map(|x| x.parse().ok()).collect();
    let [x, y, width, height] = numbers[..] else { return svg.to_owned() };
    let (line, rows) = (11.0, legend.len().div_ceil(2));
    let below = (rows + notes.len()) as f64 * line + 14.0;
    let mut foot = String::new();
    for (i, mark) in legend.iter().enumerate() {
        let (left, top) = (x + 10.0 + (i % 2) as f64 * width / 2.0, y + height + 8.0 + (i / 2) as f64 * line);
        add(
            &mut foot,
            format_args!(
                "<path class='curve {}' d='M{left:.1} {top:.1}h14'/><text x='{:.1}' y='{:.1}'>{}</text>",
                mark.class,
                left + 18.0,
                top + 3.5,
                escape(&mark.name)
            ),
        );
    }
    for (i, note) in notes.iter().enumerate() {
        let top = y + height + (rows + i) as f64 * line + 12.0;
        add(
            &mut foot,
            format_args!("<text class='note' x='{:.1}' y='{top:.1}'>{}</text>", x + 6.0, escape(note)),
        );
    }
    let body = &svg[svg.find('>').expect("a tag ends") + 1..svg.len() - "</svg>".len()];
    format!(
        "<svg xmlns='http://www.w3.org/2000/svg' class='plot' width='840' viewBox='{x} {y} {width} {}'><style>{style}</style>\
         <rect x='{x}' y='{y}' width='100%' height='100%' class='back'/>{body}{foot}</svg>\n",
        height + below
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mark(i: usize) -> Mark {
        Mark { class: format!("c{i}"), name: format!("model {i}") }
    }

    #[test]
    fn scales_place_their_ends_and_show_some_numbers() {
        let x = Scale::logarithmic([3.0, 900.0].into_iter(), [0.0, 100.0]);
        assert!(x.at(3.0) > 0.0 && x.at(900.0) < 100.0 && x.at(-1.0) == 0.0);
        for range in [[0.01, 0.011], [3.0, 900.0], [1e-5, 7e3]] {
            let count = Scale::logarithmic(range.into_iter(), [0.0, 1.0]).ticks().len();
            assert!((2..=12).contains(&count), "{count} for {range:?}");
        }
        let linear = Scale::linear([0.0, 1.05], [0.0, 1.0]).ticks();
        assert_eq!(linear.first(), Some(&0.0));
        assert!((4..=7).contains(&linear.len()), "{linear:?}");
    }

    #[test]
    fn numbers_are_short() {
        let shown = [0.0, 0.05, 1.0, 12.5, 123_456.0, 2.5e6, 3e-4].map(short);
        assert_eq!(shown, ["0", "0.05", "1", "12.5", "123k", "2.5M", "3e−4"]);
    }

    #[test]
    fn names_of_points_that_lie_together_end_up_a_line_apart() {
        // At many heights: with some of them a line below another is less than a line away, by rounding.
        for height in 1..100 {
            let point = |(i, y)| Point { mark: mark(i), at: [10.0, y], is_partial: false };
            // The first and the last span the scale.
            let places = [1000.0, 0.01].into_iter().chain([0.03 * f64::from(height); 5]);
            let points: Vec<Point> = places.enumerate().map(point).collect();
            let svg = scatter(&points, ["ns", "error"], None);
            let mut lines: Vec<f64> = svg
                .split("<text class='label' ")
                .skip(1)
                .map(|text| text.split("y='").nth(1).unwrap().split('\'').next().unwrap().parse().unwrap())
                .collect();
            lines.sort_by(f64::total_cmp);
            assert!(lines.windows(2).all(|pair| pair[1] - pair[0] > 11.7), "{lines:?}");
        }
    }

    #[test]
    fn a_scatter_shows_every_point_that_has_a_place() {
        let point = |i, at| Point { mark: mark(i), at, is_partial: i == 3 };
        let points = [[1.0, 2.0], [2.0, 1.0], [f64::NAN, 1.0], [0.5, 0.5]];
        let points: Vec<Point> = points.into_iter().enumerate().map(|(i, at)| point(i, at)).collect();
        let svg = scatter(&points, ["ns", "a < b"], Some(0.5));
        assert_eq!(svg.matches("<circle").count(), 3);
        assert_eq!(svg.matches(" hollow").count(), 1);
        assert!(svg.contains("a &lt; b") && svg.contains("class='front'") && svg.contains("class='noise'"));
        let file = standalone(&svg, "", &[mark(0)], &["glimt report".into()]);
        assert!(file.starts_with("<svg xmlns") && file.contains("glimt report</text>"));
    }
}
