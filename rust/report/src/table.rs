//! A study as CSV and JSON.

use std::fmt::Write;

use glimt_disk::printable;
use serde_json::Value;

use crate::study::{Candidate, Case, Study, Subject};

/// What a line of the CSV says, after material and model.
type Column = (&'static str, fn(&Case) -> f64);

const COLUMNS: [Column; 10] = [
    ("smape", |case| case.errors.all.smape),
    ("log_mae", |case| case.errors.all.log_mae),
    ("log_mse", |case| case.errors.all.log_mse),
    ("mae", |case| case.errors.all.mae),
    ("rmse", |case| case.errors.all.rmse),
    ("grazing_smape", |case| case.errors.grazing.smape),
    ("grazing_log_mae", |case| case.errors.grazing.log_mae),
    ("rest_smape", |case| case.errors.rest.smape),
    ("rest_log_mae", |case| case.errors.rest.log_mae),
    ("exchanged_smape", |case| case.errors.exchanged.smape),
];

/// What the head says of every light's images.
const IMAGE_COLUMNS: [&str; 6] = ["mae", "rmse", "psnr", "ssim", "flip", "hdr_flip"];
/// Ways to ask a model, as the head and as the study name them.
const WAYS: [(&str, &str); 5] = [
    ("batch_ns", "batch"),
    ("packet_ns", "packet of 8"),
    ("single_ns", "single"),
    ("sample_ns", "sample"),
    ("pdf_ns", "pdf"),
];

/// One line for each material and model: errors, and the model's cost beside them.
#[must_use]
pub fn csv(study: &Study) -> String {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let mut write = |line: Vec<String>| csv.write_record(line).expect("memory takes lines of as many fields");
    write(head(study));
    for subject in &study.subjects {
        for case in &subject.cases {
            let Some(candidate) = study.candidate(&case.candidate) else { continue };
            write(line(subject, case, candidate));
        }
    }
    let bytes = csv.into_inner().expect("memory takes all");
    String::from_utf8(bytes).expect("fields of text are text")
}

fn head(study: &Study) -> Vec<String> {
    let mut head = ["material", "model", "kind", "net"].map(str::to_owned).to_vec();
    head.extend(COLUMNS.map(|(name, _)| name.to_owned()));
    for light in &study.settings.lights {
        head.extend(IMAGE_COLUMNS.map(|metric| format!("{light}_{metric}")));
    }
    head.extend(["bytes_per_material", "bytes_shared"].map(str::to_owned));
    head.extend(WAYS.map(|(name, _)| name.to_owned()));
    head.push("fit_seconds".to_owned());
    head
}

/// What is not known is empty.
fn line(subject: &Subject, case: &Case, candidate: &Candidate) -> Vec<String> {
    let known = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
    let Candidate { name, kind, net, .. } = candidate;
    let mut line = [&subject.name, name, kind, net].map(String::clone).to_vec();
    line.extend(COLUMNS.map(|(_, value)| value(case).to_string()));
    for image in &case.images {
        let d = &image.difference;
        let values = [d.mae, d.rmse, d.psnr, d.ssim].map(|x| x.to_string());
        line.extend(values);
        line.extend([image.flip, image.hdr_flip].map(|x| x.to_string()));
    }
    line.extend([candidate.own_bytes, candidate.shared_bytes].map(|bytes| bytes.to_string()));
    line.extend(WAYS.map(|(_, way)| known(candidate.times.get(way).map(|time| time.median))));
    line.push(known(candidate.fit_seconds));
    line
}

/// The models as a short table for people.
#[must_use]
pub fn text(study: &Study) -> String {
    let width = study.candidates.iter().map(|c| printable(&c.name).chars().count()).max().unwrap_or(0).max(5);
    let mut text = format!(
        "{:width$} {:>9} {:>9} {:>8} {:>8} {:>9} {:>8}",
        "model", "batch ns", "single ns", "bytes", "SMAPE", "log-MAE", "grazing"
    );
    for light in &study.settings.lights {
        let _ = write!(text, " {:>12}", format!("FLIP {light}"));
    }
    for candidate in &study.candidates {
        let ns = |way: &str| candidate.times.get(way).map_or(f64::NAN, |time| time.median);
        let mean = |figure: fn(&Case) -> f64| study.mean(candidate, figure);
        let _ = write!(
            text,
            "\n{:width$} {:>9.1} {:>9.1} {:>8.0} {:>8.4} {:>9.5} {:>8.4}",
            printable(&candidate.name),
            ns("batch"),
            ns("single"),
            candidate.bytes_per_material(),
            mean(|case| case.errors.all.smape),
            mean(|case| case.errors.all.log_mae),
            mean(|case| case.errors.grazing.smape),
        );
        for i in 0..study.settings.lights.len() {
            let _ = write!(text, " {:>12.4}", study.mean(candidate, |case| case.images[i].flip));
        }
    }
    text + "\n"
}

/// The study as JSON, without its pictures and slices.
#[must_use]
pub fn json(study: &Study) -> String {
    let mut value = serde_json::to_value(study).expect("numbers and strings always serialise");
    strip(&mut value);
    serde_json::to_string_pretty(&value).expect("a value always serialises") + "\n"
}

fn strip(value: &mut Value) {
    match value {
        Value::Object(object) => {
            for key in ["pictures", "spheres", "slices"] {
                object.remove(key);
            }
            object.values_mut().for_each(strip);
        }
        Value::Array(values) => values.iter_mut().for_each(strip),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::tests::small;

    #[test]
    fn the_csv_is_a_line_for_every_case_and_keeps_names_and_figures() {
        let mut study = small();
        "brass, \"raw\"\n".clone_into(&mut study.subjects[0].name);
        let text = csv(&study);
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let head = reader.headers().unwrap().clone();
        // Also refuses lines of another length.
        let lines: Vec<_> = reader.records().map(Result::unwrap).collect();
        assert_eq!(lines.len(), 2);
        let case = &study.subjects[0].cases[0];
        let field = |name: &str| &lines[0][head.iter().position(|other| other == name).unwrap()];
        assert_eq!((field("material"), field("model")), ("brass, \"raw\"\n", &*case.candidate));
        assert_eq!(field("smape").parse(), Ok(case.errors.all.smape));
        assert_eq!(
            field(&format!("{}_hdr_flip", study.settings.lights[1])).parse(),
            Ok(case.images[1].hdr_flip)
        );
    }

    #[test]
    fn json_holds_figures_and_no_pictures() {
        let json = json(&small());
        assert!(json.contains("\"smape\"") && !json.contains("iVBOR"));
        serde_json::from_str::<Value>(&json).unwrap();
    }
}
