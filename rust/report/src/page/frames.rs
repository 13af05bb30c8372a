//! Work precision in Mitsuba, as plots and as a table at equal time.

use maud::{Markup, html};

use super::plot::{Axes, Curve, Mark, lines};
use super::{Plot, cell, class_of, file_name, marks, plots_section, truth_mark};
use crate::study::frames::{Curves, Frame, Frames, equal_seconds, frame_at};
use crate::study::{MEASUREMENT, Study};

/// Error and noise of whole frames against their seconds, two plots for each scene and variant.
pub fn plots(study: &Study) -> Vec<Plot> {
    let Some(frames) = &study.frames else { return Vec::new() };
    let mut plots = Vec::new();
    for (scene, variant, curves) in each(frames) {
        let of = [
            ("error", "RMSE to the measurement", (|frame| frame.rmse) as fn(&Frame) -> f64),
            ("noise", "noise alone, RMSE", |frame| frame.noise),
        ];
        for (key, name, figure) in of {
            let drawn = drawn(study, curves, figure);
            let spp: Vec<String> =
                curves.values().next().into_iter().flatten().map(|frame| frame.spp.to_string()).collect();
            plots.push(Plot {
                name: format!("frames-{}-{}-{key}", file_name(scene), file_name(variant)),
                svg: lines(&drawn, ["seconds a frame, one thread", name], Axes::Logarithmic),
                caption: format!(
                    "{}, {scene}, {variant}: {} samples a pixel",
                    frames.material,
                    spp.join(", ")
                ),
                legend: drawn.into_iter().map(|(mark, _)| mark).collect(),
            });
        }
    }
    plots
}

/// The section of a page; empty where no frames were asked for.
pub fn section(study: &Study) -> Markup {
    let Some(frames) = &study.frames else { return Markup::default() };
    html! {
        (plots_section(
            study,
            "Work precision",
            "Rendered by Mitsuba: the sphere stands on a floor under an even sky and a lamp; the room is closed, its floor and two \
             spheres have the material, and light is reflected up to five times. The error falls with the noise and \
             then stays at what the model cannot do. “table” is the same reflectance with a table sampler. \
             principled is fitted to nothing and stands for time and noise.",
            &plots(study),
        ))
        section {
            h2 { "At equal time" }
            p {
                "Samples a pixel that fit into the time, error and noise after it, between the frames of the curves \
                 above. A dash: the first frame takes longer."
            }
            div.wide {
                @for (scene, variant, curves) in each(frames) { (equal_time(scene, variant, curves)) }
            }
        }
    }
}

fn each(frames: &Frames) -> impl Iterator<Item = (&str, &str, &Curves)> {
    frames.scenes.iter().flat_map(|(scene, variants)| {
        variants.iter().map(move |(variant, curves)| (scene.as_str(), variant.as_str(), curves))
    })
}

/// Curves with their marks: a model has its colour, and its table sampler the same, dashed; what is no model has
/// the colours after theirs.
fn drawn(study: &Study, curves: &Curves, figure: fn(&Frame) -> f64) -> Vec<Curve> {
    let marks = marks(study);
    let mut others = marks.len()..;
    let mut class = |name: &str| {
        let (model, sampler) = name.split_once(", ").unwrap_or((name, ""));
        let of_model = marks.iter().find(|mark| mark.name == model).cloned();
        match if model == MEASUREMENT { Some(truth_mark()) } else { of_model } {
            Some(mark) if sampler.is_empty() => mark.class,
            Some(mark) => format!("{} dashed", mark.class),
            None => class_of(others.next().expect("numbers do not end")),
        }
    };
    let points = |frames: &Vec<Frame>| frames.iter().map(|frame| [frame.seconds, figure(frame)]).collect();
    let curve = |(name, frames): (&String, &Vec<Frame>)| {
        (Mark { class: class(name), name: name.clone() }, points(frames))
    };
    curves.iter().map(curve).collect()
}

fn equal_time(scene: &str, variant: &str, curves: &Curves) -> Markup {
    let seconds = equal_seconds(curves);
    html! {
        table {
            tr {
                th { (scene) ", " (variant) (format!(", {seconds:.2} s")) }
                th { "samples" } th { "RMSE to the measurement" } th { "noise" }
            }
            @for (name, frames) in curves {
                @let frame = frame_at(frames, seconds);
                tr {
                    td { (name) }
                    td { (cell(frame.map(|frame| frame.spp), 1)) }
                    td { (cell(frame.map(|frame| frame.rmse), 3)) }
                    td { (cell(frame.map(|frame| frame.noise), 3)) }
                }
            }
        }
    }
}
