//! A study as one HTML page that needs nothing else, and its plots as files.

mod frames;
pub mod plot;

use crate::brdf_error::GRAZING_DEGREES;
use crate::study::curves::{ALBEDO_VIEWS, SLICE_VIEWS, slice_angles};
use crate::study::noise::SAMPLE_COUNTS;
use crate::study::{Candidate, Case, DIFFERENCE_SCALE, MEASUREMENT, Study, Subject};
use plot::{Axes, Curve, Mark, Point, escape, lines, polar, scatter, short, standalone};

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
    let mut page = format!(
        "<!doctype html><html lang=en><meta charset=utf-8>\
         <meta name=viewport content='width=device-width, initial-scale=1'>\
         <link rel=icon href='data:,'><title>glimt report</title><style>{STYLE}{PLOT_STYLE}</style>\n\
         <h1>glimt report</h1>\n<p>{} models against {}. {}</p><p><code>{}</code></p>\n",
        study.candidates.len(),
        materials_of(study),
        escape(&made(study)[0]),
        escape(&study.made.command)
    );
    let [times, bytes] = trade_offs(study);
    page += &plots_section(
        study,
        "Error against run time",
        "Lower and further left is better. No model above or to the right of the line is worth its time.",
        &times,
    );
    page += &plots_section(
        study,
        "Error against memory",
        "Bytes of a material's own tensors and of its share of the network, for as many materials as the library holds.",
        &bytes,
    );
    page += &models(study);
    page += &materials(study);
    let noise = variance(study, &study.subjects, "variance", "geometric means over the materials");
    page += &plots_section(study, "Noise", "What a renderer sees that samples the BRDF alone.", &[noise]);
    page += &frames::section(study);
    for (i, subject) in study.subjects.iter().enumerate() {
        page += &section(study, subject, i == 0);
    }
    page + &method(study) + "</html>\n"
}

fn plots_section(study: &Study, title: &str, text: &str, plots: &[Plot]) -> String {
    let figures: String = plots.iter().map(|plot| figure(study, plot)).collect();
    format!("<section><h2>{title}</h2><p>{text}</p><div class=plots>{figures}</div></section>\n")
}

fn figure(study: &Study, plot: &Plot) -> String {
    let [where_and_when, command] = made(study).map(|line| escape(&line));
    format!(
        "<figure>{}{}<figcaption>{}<details><summary>how it was made</summary>{where_and_when}<br>\
         <code>{command}</code></details></figcaption></figure>",
        plot.svg,
        legend(&plot.legend),
        escape(&plot.caption)
    )
}

fn legend(marks: &[Mark]) -> String {
    if marks.is_empty() {
        return String::new();
    }
    let entry = |mark: &Mark| {
        format!(
            "<span><svg class=plot viewBox='0 0 20 8'><path class='curve {}' d='M0 4h20'/></svg>{}</span>",
            mark.class,
            escape(&mark.name)
        )
    };
    format!("<div class=legend>{}</div>", marks.iter().map(entry).collect::<String>())
}

/// A number in a table; a dash for what is not known.
fn cell(value: Option<f64>, decimals: usize) -> String {
    value.filter(|x| x.is_finite()).map_or("–".into(), |x| format!("{x:.decimals$}"))
}

/// The table of the models.
fn models(study: &Study) -> String {
    let ways = ["batch", "packet of 8", "single", "sample", "pdf"];
    let mut page = format!(
        "<section><h2>Models</h2><p>Times in ns for one pair on one core, medians of interleaved rounds; errors are means \
         over the materials; grazing: either direction beyond {GRAZING_DEGREES}°.</p><div class=wide><table><tr><th>model\
         <th>bytes a material<th>shared<th>fit, s"
    );
    for way in ways {
        page += &format!("<th>{way}");
    }
    page += "<th>SMAPE<th>grazing<th>rest<th>exchanged<th>log-MAE<br>×10³";
    for light in &study.settings.lights {
        let light = escape(light);
        page += &format!("<th>FLIP<br>{light}<th>PSNR<br>{light}");
    }
    for candidate in &study.candidates {
        page += &format!(
            "<tr><td>{}<td>{}<td>{}<td>{}",
            escape(&candidate.name),
            candidate.own_bytes,
            candidate.shared_bytes,
            cell(candidate.fit_seconds, 0)
        );
        for way in ways {
            page += &format!("<td>{}", cell(candidate.times.get(way).map(|t| t.median), 1));
        }
        let mean = |figure: &dyn Fn(&Case) -> f64| Some(study.mean(candidate, figure));
        page += &format!(
            "<td>{}<td>{}<td>{}<td>{}<td>{}",
            cell(mean(&|case| case.errors.all.smape), 4),
            cell(mean(&|case| case.errors.grazing.smape), 4),
            cell(mean(&|case| case.errors.rest.smape), 4),
            cell(mean(&|case| case.errors.exchanged.smape), 4),
            cell(mean(&|case| 1e3 * case.errors.all.log_mae), 2)
        );
        for i in 0..study.settings.lights.len() {
            page += &format!(
                "<td>{}<td>{}",
                cell(mean(&|case| case.images[i].flip), 4),
                cell(mean(&|case| case.images[i].difference.psnr), 1)
            );
        }
    }
    page + "</table></div></section>\n"
}

/// The table of the materials.
fn materials(study: &Study) -> String {
    let mut page = String::from(
        "<section><h2>Materials</h2><p>SMAPE, and log-MAE × 10³ in small; the best of a row in green. Noise of the \
         measurement: f(light, view) against f(view, light).</p><div class=wide><table><tr><th>material<th>noise",
    );
    for candidate in &study.candidates {
        page += &format!("<th>{}", escape(&candidate.name));
    }
    for (i, subject) in study.subjects.iter().enumerate() {
        let two = |errors: &crate::study::Errors| {
            format!("{:.3} <small>{:.2}</small>", errors.all.smape, 1e3 * errors.all.log_mae)
        };
        page += &format!("<tr><td><a href='#m{i}'>{}</a><td>{}", escape(&subject.name), two(&subject.noise));
        let least = subject.cases.iter().map(|case| case.errors.all.smape).fold(f64::INFINITY, f64::min);
        for candidate in &study.candidates {
            page += &match subject.cases.iter().find(|case| case.candidate == candidate.name) {
                Some(case) if case.errors.all.smape == least => {
                    format!("<td class=best>{}", two(&case.errors))
                }
                Some(case) => format!("<td>{}", two(&case.errors)),
                None => "<td>–".to_owned(),
            };
        }
    }
    page + "</table></div></section>\n"
}

/// A material with its pictures and curves.
fn section(study: &Study, subject: &Subject, is_open: bool) -> String {
    let place = study.subjects.iter().position(|other| std::ptr::eq(other, subject)).unwrap_or_default();
    let mut page = format!(
        "<details class=subject id=m{place}{}><summary><h2>{}</h2></summary><p>{}, {}. SHA-256 <code>{}</code></p>",
        if is_open { " open" } else { "" },
        escape(&subject.name),
        escape(&subject.format),
        escape(&subject.file),
        escape(&subject.sha256)
    );
    for (light, name) in study.settings.lights.iter().enumerate() {
        let noise = &subject.image_noise[light];
        page += &format!(
            "<h3>{}</h3><p>From above: the sphere, |difference| × {DIFFERENCE_SCALE} as shown, and the FLIP map \
             <span class=map></span> from 0 to 1. Another seed changes the measurement's image by RMSE {}, FLIP {:.4}; \
             its mean is {}.</p><div class=spheres><figure><span><img alt='measurement' src='{}'></span><b>measurement</b>\
             <figcaption>exposure {}</figcaption></figure>",
            escape(name),
            short(noise.difference.rmse),
            noise.flip,
            short(noise.difference.mean),
            subject.spheres[light].source(),
            short(f64::from(noise.difference.exposure))
        );
        for case in &subject.cases {
            let image = &case.images[light];
            let [sphere, difference, map] = case.pictures[light].each_ref().map(|picture| picture.source());
            page += &format!(
                "<figure><span><img alt='{0}' src='{sphere}'><img alt='difference of {0}' src='{difference}'>\
                 <img alt='FLIP map of {0}' src='{map}'></span><b>{0}</b><figcaption>FLIP {1:.4}, HDR {2:.4}<br>\
                 PSNR {3:.1} dB, SSIM {4:.4}<br>MAE {5}, RMSE {6}</figcaption></figure>",
                escape(&case.candidate),
                image.flip,
                image.hdr_flip,
                image.difference.psnr,
                image.difference.ssim,
                short(image.difference.mae),
                short(image.difference.rmse)
            );
        }
        page += "</div>";
    }
    let figures: String = curves(study, subject).iter().map(|plot| figure(study, plot)).collect();
    page + "<h3>Curves</h3><div class=plots>" + &figures + "</div></details>\n"
}

/// How everything was measured.
fn method(study: &Study) -> String {
    let settings = &study.settings;
    let mut page = format!(
        "<section><h2>How this was measured</h2><p>Errors in BRDF space over {} pairs of directions, both \
         cosine-distributed. SMAPE: mean of 2|f − g|/(|f| + |g|), from 0 to 2. log-MAE: mean of |ln(1 + cosθ f) − ln(1 + cosθ g)|. \
         Exchanged: the same pairs with light and view exchanged.</p><p>Spheres of {} pixels, directly lit, computed by the \
         core without a renderer: lamps exactly; other lights with {} directions a pixel, drawn for the measurement and the same \
         for all models. Errors of images are of the pixels on the sphere; PSNR, SSIM and FLIP as shown, at an exposure that brings \
         95 % of the measurement's values below 1; the others of linear radiance.</p><div class=wide><table><tr><th>model<th>made by",
        settings.pairs, settings.size, settings.directions
    );
    for candidate in &study.candidates {
        page += &format!(
            "<tr><td>{}<td><code>{}</code> <small>{}</small>",
            escape(&candidate.name),
            escape(&candidate.command),
            escape(&candidate.file)
        );
    }
    page + "</table></div></section>"
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
