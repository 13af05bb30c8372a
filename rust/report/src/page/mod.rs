//! A study as one HTML page that needs nothing else, and its plots as files.

mod frames;
pub mod plot;

use maud::{Markup, PreEscaped, html};

use crate::brdf_error::GRAZING_DEGREES;
use crate::study::curves::{ALBEDO_VIEWS, SLICE_VIEWS, slice_angles};
use crate::study::noise::SAMPLE_COUNTS;
use crate::study::{Candidate, Case, DIFFERENCE_SCALE, Errors, MEASUREMENT, Study, Subject};
use plot::{Axes, Curve, Mark, Point, lines, polar, scatter, short, standalone};

/// Style of plots, in a page and in a file.
const PLOT_STYLE: &str = include_str!("plot.css");
/// Style of the page, light and dark.
const STYLE: &str = include_str!("page.css");
/// Colours that the style has for models, and for what is none.
const COLORS: usize = 10;
const SAMPLER_COLORS: usize = 4;

/// A plot with what it shows.
pub struct Plot {
    /// Name of its file, without the ending.
    pub name: String,
    svg: String,
    caption: String,
    /// What has a colour in it and no name.
    legend: Vec<Mark>,
}

impl Plot {
    /// The plot as a file of its own.
    #[must_use]
    pub fn file(&self, study: &Study) -> String {
        let notes = [self.caption.clone()].into_iter().chain(made(study)).collect::<Vec<_>>();
        standalone(&self.svg, PLOT_STYLE, &self.legend, &notes)
    }
}

/// How, where and when the study was made, in a few lines.
fn made(study: &Study) -> [String; 2] {
    let (made, settings) = (&study.made, &study.settings);
    [
        format!(
            "glimt {}, {}, {}, {}; seed {}, {} pairs, {} directions a pixel",
            made.glimt,
            made.cpu,
            made.instruction_set,
            made.date,
            settings.seed,
            settings.pairs,
            settings.directions
        ),
        made.command.clone(),
    ]
}

/// A number of a case or a subject.
type Figure<T> = Box<dyn Fn(&T) -> f64>;

/// How many materials there are, in words.
fn materials_of(study: &Study) -> String {
    match study.subjects.len() {
        1 => "1 material".to_owned(),
        count => format!("{count} materials"),
    }
}

/// An error that a study knows of every case.
struct Metric {
    /// In file names.
    key: String,
    /// For people.
    name: String,
    figure: Figure<Case>,
    /// The same of the measurement itself.
    noise: Option<Figure<Subject>>,
}

fn metrics(study: &Study) -> Vec<Metric> {
    let mut metrics = vec![
        Metric {
            key: "log-mae".into(),
            name: "log-MAE".into(),
            figure: Box::new(|case| case.errors.all.log_mae),
            noise: Some(Box::new(|subject| subject.noise.all.log_mae)),
        },
        Metric {
            key: "smape".into(),
            name: "SMAPE".into(),
            figure: Box::new(|case| case.errors.all.smape),
            noise: Some(Box::new(|subject| subject.noise.all.smape)),
        },
    ];
    for (i, light) in study.settings.lights.iter().enumerate() {
        metrics.push(Metric {
            key: format!("flip-{}", file_name(light)),
            name: format!("FLIP, {light}"),
            figure: Box::new(move |case| case.images[i].flip),
            noise: None,
        });
    }
    metrics
}

/// Text as part of a file's name.
fn file_name(text: &str) -> String {
    text.chars().map(|c| if c.is_alphanumeric() || c == '-' || c == '_' { c } else { '-' }).collect()
}

/// The mark of a candidate by its place in the study.
fn marks(study: &Study) -> Vec<Mark> {
    let mark =
        |(i, candidate): (usize, &Candidate)| Mark { class: class_of(i), name: candidate.name.clone() };
    study.candidates.iter().enumerate().map(mark).collect()
}

/// The class of the colour of number `i`.
fn class_of(i: usize) -> String {
    format!("c{}", i % COLORS)
}

fn truth_mark() -> Mark {
    Mark { class: "truth".into(), name: MEASUREMENT.into() }
}

/// Error against every cost, means over the materials.
fn trade_offs(study: &Study) -> [Vec<Plot>; 2] {
    let noise_of = |metric: &Metric| {
        let noise = metric.noise.as_ref()?;
        Some(study.subjects.iter().map(noise).sum::<f64>() / study.subjects.len() as f64)
    };
    let plot = |metric: &Metric, cost: &dyn Fn(&Candidate) -> f64, key: &str, name: &str| {
        let point = |(mark, candidate): (Mark, &Candidate)| {
            let count = study.cases(candidate).count();
            let is_partial = count < study.subjects.len();
            let name = if is_partial { format!("{} ({count} materials)", mark.name) } else { mark.name };
            let mark = Mark { name, ..mark };
            Point { mark, at: [cost(candidate), study.mean(candidate, &metric.figure)], is_partial }
        };
        let points: Vec<Point> = marks(study).into_iter().zip(&study.candidates).map(point).collect();
        Plot {
            name: format!("{}-{key}", metric.key),
            svg: scatter(&points, [name, &metric.name], noise_of(metric)),
            caption: format!(
                "{} against {name}, means over {}; the line is the Pareto front of the models that have all of them",
                metric.name,
                materials_of(study)
            ),
            legend: Vec::new(),
        }
    };
    let time = |way: &'static str| move |c: &Candidate| c.times.get(way).map_or(f64::NAN, |time| time.median);
    let metrics = metrics(study);
    let times = metrics.iter().flat_map(|metric| {
        [("batch", "ns for a pair, in batches, one core"), ("single", "ns for a pair, one by one, one core")]
            .map(|(way, name)| plot(metric, &time(way), way, name))
    });
    let bytes = metrics.iter().map(|metric| {
        plot(
            metric,
            &Candidate::bytes_per_material,
            "bytes",
            "bytes a material, its share of what is shared included",
        )
    });
    [times.collect(), bytes.collect()]
}

/// Variance against samples, over all materials or of one.
fn variance(study: &Study, subjects: &[Subject], key: &str, of_what: &str) -> Plot {
    let mean = |values: &[&Vec<f64>]| -> Vec<[f64; 2]> {
        let at = |i: usize| {
            let logs = values.iter().map(|v| v[i].max(f64::MIN_POSITIVE).ln());
            [SAMPLE_COUNTS[i] as f64, (logs.sum::<f64>() / values.len() as f64).exp()]
        };
        (0..SAMPLE_COUNTS.len()).map(at).collect()
    };
    let mut curves: Vec<Curve> = Vec::new();
    let names: std::collections::BTreeSet<&String> =
        subjects.iter().flat_map(|s| s.variance.keys()).collect();
    for (i, name) in names.into_iter().enumerate() {
        let values: Vec<&Vec<f64>> = subjects.iter().filter_map(|s| s.variance.get(name)).collect();
        let mark = Mark {
            class: format!("sampler s{}", i % SAMPLER_COLORS),
            name: format!("measurement by {name}"),
        };
        curves.push((mark, mean(&values)));
    }
    for mark in marks(study) {
        let of = |case: &&Case| case.candidate == mark.name;
        let values: Vec<&Vec<f64>> =
            subjects.iter().flat_map(|s| &s.cases).filter(of).map(|case| &case.variance).collect();
        if !values.is_empty() {
            curves.push((mark, mean(&values)));
        }
    }
    Plot {
        name: key.to_owned(),
        svg: lines(&curves, ["samples a pixel", "variance / mean²"], Axes::Logarithmic),
        caption: format!(
            "Variance of a sphere in the studio against samples, {of_what}: the measurement under several samplers \
             (dashed), and every model under its own"
        ),
        legend: curves.into_iter().map(|(mark, _)| mark).collect(),
    }
}

/// The curves of one material.
fn curves(study: &Study, subject: &Subject) -> Vec<Plot> {
    let marks = marks(study);
    let mark_of = |case: &Case| marks.iter().find(|mark| mark.name == case.candidate).cloned();
    let angles = slice_angles();
    let name = file_name(&subject.name);
    let known = || subject.cases.iter().filter_map(|case| Some((mark_of(case)?, case)));
    let legend: Vec<Mark> = known().map(|(mark, _)| mark).chain([truth_mark()]).collect();
    let mut plots = Vec::new();
    for (i, view) in SLICE_VIEWS.into_iter().enumerate() {
        let mut slices: Vec<(Mark, &[f32])> =
            known().map(|(mark, case)| (mark, &case.slices[i][..])).collect();
        slices.push((truth_mark(), &subject.slices[i]));
        plots.push(Plot {
            name: format!("{name}-slice-{view:.0}"),
            svg: polar(&angles, &slices, view),
            caption: format!(
                "{}: f cosθ in the plane of incidence, seen from {view:.0}°; a ring is a decade",
                subject.name
            ),
            legend: legend.clone(),
        });
    }
    let over_views = |albedo: &[f64]| ALBEDO_VIEWS.into_iter().zip(albedo).map(|(x, y)| [x, *y]).collect();
    let mut albedos: Vec<Curve> = known().map(|(mark, case)| (mark, over_views(&case.albedo))).collect();
    albedos.push((truth_mark(), over_views(&subject.albedo)));
    plots.push(Plot {
        name: format!("{name}-albedo"),
        svg: lines(&albedos, ["angle of the view to the normal, °", "directional albedo"], Axes::Linear),
        caption: format!("{}: directional albedo, mean of the channels", subject.name),
        legend,
    });
    plots.push(variance(study, std::slice::from_ref(subject), &format!("{name}-variance"), &subject.name));
    plots
}

/// All plots of a study.
#[must_use]
pub fn plots(study: &Study) -> Vec<Plot> {
    let mut plots: Vec<Plot> = trade_offs(study).into_iter().flatten().collect();
    plots.push(variance(study, &study.subjects, "variance", "geometric means over the materials"));
    plots.extend(frames::plots(study));
    plots.extend(study.subjects.iter().flat_map(|subject| curves(study, subject)));
    plots
}

/// The page of a study.
#[must_use]
pub fn html(study: &Study) -> String {
    let [times, bytes] = trade_offs(study);
    let noise = variance(study, &study.subjects, "variance", "geometric means over the materials");
    let [made, command] = made(study);
    let page = html! {
        // As the command recognises its pages by.
        (PreEscaped("<!doctype html>"))
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                link rel="icon" href="data:,";
                title { "glimt report" }
                style { (PreEscaped(STYLE)) (PreEscaped(PLOT_STYLE)) }
            }
            body {
                h1 { "glimt report" }
                p {
                    (study.candidates.len()) " models against " (materials_of(study)) ". " (made)
                }
                p { code { (command) } }
                (plots_section(
                    study,
                    "Error against run time",
                    "Lower and further left is better. No model above or to the right of the line is worth its time.",
                    &times,
                ))
                (plots_section(
                    study,
                    "Error against memory",
                    "Bytes of a material's own tensors and of its share of the network, for as many materials as the \
                     library holds.",
                    &bytes,
                ))
                (models(study))
                (materials(study))
                (plots_section(study, "Noise", "What a renderer sees that samples the BRDF alone.", &[noise]))
                (frames::section(study))
                @for (i, subject) in study.subjects.iter().enumerate() { (section(study, subject, i)) }
                (method(study))
            }
        }
    };
    page.into_string() + "\n"
}

fn plots_section(study: &Study, title: &str, text: &str, plots: &[Plot]) -> Markup {
    html! {
        section {
            h2 { (title) }
            p { (text) }
            div.plots { @for plot in plots { (figure(study, plot)) } }
        }
    }
}

fn figure(study: &Study, plot: &Plot) -> Markup {
    let [where_and_when, command] = made(study);
    html! {
        figure {
            (PreEscaped(&plot.svg))
            @if !plot.legend.is_empty() { (legend(&plot.legend)) }
            figcaption {
                (plot.caption)
                details {
                    summary { "how it was made" }
                    (where_and_when) br; code { (command) }
                }
            }
        }
    }
}

fn legend(marks: &[Mark]) -> Markup {
    html! {
        div.legend {
            @for mark in marks {
                span {
                    svg.plot viewBox="0 0 20 8" { path class=(format!("curve {}", mark.class)) d="M0 4h20" {} }
                    (mark.name)
                }
            }
        }
    }
}

/// A number in a table; a dash for what is not known.
fn cell(value: Option<f64>, decimals: usize) -> String {
    value.filter(|x| x.is_finite()).map_or("–".into(), |x| format!("{x:.decimals$}"))
}

/// The table of the models.
fn models(study: &Study) -> Markup {
    let ways = ["batch", "packet of 8", "single", "sample", "pdf"];
    html! {
        section {
            h2 { "Models" }
            p {
                "Times in ns for one pair on one core, medians of interleaved rounds; errors are means over the \
                 materials; grazing: either direction beyond " (GRAZING_DEGREES) "°."
            }
            div.wide {
                table {
                    tr {
                        th { "model" } th { "bytes a material" } th { "shared" } th { "fit, s" }
                        @for way in ways { th { (way) } }
                        th { "SMAPE" } th { "grazing" } th { "rest" } th { "exchanged" } th { "log-MAE" br; "×10³" }
                        @for light in &study.settings.lights {
                            th { "FLIP" br; (light) }
                            th { "PSNR" br; (light) }
                        }
                    }
                    @for candidate in &study.candidates { (model(study, candidate, &ways)) }
                }
            }
        }
    }
}

fn model(study: &Study, candidate: &Candidate, ways: &[&str]) -> Markup {
    let mean = |figure: &dyn Fn(&Case) -> f64| Some(study.mean(candidate, figure));
    html! {
        tr {
            td { (candidate.name) }
            td { (candidate.own_bytes) }
            td { (candidate.shared_bytes) }
            td { (cell(candidate.fit_seconds, 0)) }
            @for &way in ways { td { (cell(candidate.times.get(way).map(|t| t.median), 1)) } }
            td { (cell(mean(&|case| case.errors.all.smape), 4)) }
            td { (cell(mean(&|case| case.errors.grazing.smape), 4)) }
            td { (cell(mean(&|case| case.errors.rest.smape), 4)) }
            td { (cell(mean(&|case| case.errors.exchanged.smape), 4)) }
            td { (cell(mean(&|case| 1e3 * case.errors.all.log_mae), 2)) }
            @for i in 0..study.settings.lights.len() {
                td { (cell(mean(&|case| case.images[i].flip), 4)) }
                td { (cell(mean(&|case| case.images[i].difference.psnr), 1)) }
            }
        }
    }
}

/// The table of the materials.
fn materials(study: &Study) -> Markup {
    html! {
        section {
            h2 { "Materials" }
            p {
                "SMAPE, and log-MAE × 10³ in small; the best of a row in green. Noise of the measurement: \
                 f(light, view) against f(view, light)."
            }
            div.wide {
                table {
                    tr {
                        th { "material" } th { "noise" }
                        @for candidate in &study.candidates { th { (candidate.name) } }
                    }
                    @for (i, subject) in study.subjects.iter().enumerate() { (material(study, subject, i)) }
                }
            }
        }
    }
}

fn material(study: &Study, subject: &Subject, place: usize) -> Markup {
    let two = |errors: &Errors| {
        html! { (format!("{:.3} ", errors.all.smape)) small { (format!("{:.2}", 1e3 * errors.all.log_mae)) } }
    };
    let least = subject.cases.iter().map(|case| case.errors.all.smape).fold(f64::INFINITY, f64::min);
    let case_of = |model: &Candidate| subject.cases.iter().find(|case| case.candidate == model.name);
    html! {
        tr {
            td { a href=(format!("#m{place}")) { (subject.name) } }
            td { (two(&subject.noise)) }
            @for candidate in &study.candidates {
                @match case_of(candidate) {
                    Some(case) => { td class=[(case.errors.all.smape == least).then_some("best")] { (two(&case.errors)) } }
                    None => { td { "–" } }
                }
            }
        }
    }
}

/// A material with its pictures and curves.
fn section(study: &Study, subject: &Subject, place: usize) -> Markup {
    html! {
        details.subject id=(format!("m{place}")) open[place == 0] {
            summary { h2 { (subject.name) } }
            p { (subject.format) ", " (subject.file) ". SHA-256 " code { (subject.sha256) } }
            @for (light, name) in study.settings.lights.iter().enumerate() {
                h3 { (name) }
                (spheres(subject, light))
            }
            h3 { "Curves" }
            div.plots { @for plot in &curves(study, subject) { (figure(study, plot)) } }
        }
    }
}

/// The spheres of a material under one of the lights.
fn spheres(subject: &Subject, light: usize) -> Markup {
    let noise = &subject.image_noise[light];
    html! {
        p {
            "From above: the sphere, |difference| × " (DIFFERENCE_SCALE) " as shown, and the FLIP map " span.map {}
            " from 0 to 1. Another seed changes the measurement's image by RMSE " (short(noise.difference.rmse))
            ", FLIP " (format!("{:.4}", noise.flip)) "; its mean is " (short(noise.difference.mean)) "."
        }
        div.spheres {
            figure {
                span { img alt="measurement" src=(subject.spheres[light].source()); }
                b { "measurement" }
                figcaption { "exposure " (short(f64::from(noise.difference.exposure))) }
            }
            @for case in &subject.cases { (sphere(case, light)) }
        }
    }
}

fn sphere(case: &Case, light: usize) -> Markup {
    let (name, image) = (&case.candidate, &case.images[light]);
    let [sphere, difference, map] = case.pictures[light].each_ref().map(|picture| picture.source());
    html! {
        figure {
            span {
                img alt=(name) src=(sphere);
                img alt=(format!("difference of {name}")) src=(difference);
                img alt=(format!("FLIP map of {name}")) src=(map);
            }
            b { (name) }
            figcaption {
                (format!("FLIP {:.4}, HDR {:.4}", image.flip, image.hdr_flip)) br;
                (format!("PSNR {:.1} dB, SSIM {:.4}", image.difference.psnr, image.difference.ssim)) br;
                "MAE " (short(image.difference.mae)) ", RMSE " (short(image.difference.rmse))
            }
        }
    }
}

/// How everything was measured.
fn method(study: &Study) -> Markup {
    let settings = &study.settings;
    html! {
        section {
            h2 { "How this was measured" }
            p {
                "Errors in BRDF space over " (settings.pairs) " pairs of directions, both cosine-distributed. \
                 SMAPE: mean of 2|f − g|/(|f| + |g|), from 0 to 2. log-MAE: mean of \
                 |ln(1 + cosθ f) − ln(1 + cosθ g)|. Exchanged: the same pairs with light and view exchanged."
            }
            p {
                "Spheres of " (settings.size) " pixels, directly lit, computed by the core without a renderer: lamps \
                 exactly; other lights with " (settings.directions) " directions a pixel, drawn for the measurement \
                 and the same for all models. Errors of images are of the pixels on the sphere; PSNR, SSIM and FLIP \
                 as shown, at an exposure that brings 95 % of the measurement's values below 1; the others of linear \
                 radiance."
            }
            div.wide {
                table {
                    tr { th { "model" } th { "made by" } }
                    @for candidate in &study.candidates {
                        tr {
                            td { (candidate.name) }
                            td { code { (candidate.command) } " " small { (candidate.file) } }
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::tests::small;

    #[test]
    fn a_page_holds_every_model_and_material_and_asks_for_nothing() {
        let page = html(&small());
        assert!(page.contains("brass &lt;raw&gt;") && !page.contains("<raw>"));
        assert!(page.contains("a &amp; b"));
        for outside in ["http://", "https://", "<script", "<link rel=stylesheet", "NaN", "inf<"] {
            let inside = page.replace("http://www.w3.org/2000/svg", "");
            assert!(!inside.contains(outside), "{outside}");
        }
        // A truth and two models under two lights; three pictures of a model.
        assert_eq!(page.matches("<img ").count(), 2 * (1 + 2 * 3));
    }

    #[test]
    fn every_plot_has_a_file_of_its_own_that_says_who_made_it() {
        let study = small();
        let plots = plots(&study);
        let names: std::collections::BTreeSet<_> = plots.iter().map(|plot| plot.name.clone()).collect();
        assert_eq!(names.len(), plots.len());
        for plot in &plots {
            let file = plot.file(&study);
            assert!(file.contains("a processor") && file.contains("2000-02-29") && file.contains("seed 1"));
        }
    }
}
