//! A study as CSV and JSON.

use std::fmt::Write;

use glimt_disk::printable;
use serde_json::Value;

use crate::study::{Case, Study};

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

/// One line for each material and model: errors, and the model's cost beside them.
#[must_use]
pub fn csv(study: &Study) -> String {
    let mut csv = String::from("material,model,kind,net");
    for (name, _) in COLUMNS {
        csv = csv + "," + name;
    }
    for light in &study.settings.lights {
        for metric in ["mae", "rmse", "psnr", "ssim", "flip", "hdr_flip"] {
            csv += &format!(",{}_{metric}", field(light));
        }
    }
    csv += ",bytes_per_material,bytes_shared,batch_ns,packet_ns,single_ns,sample_ns,pdf_ns,fit_seconds\n";
    for subject in &study.subjects {
        for case in &subject.cases {
            let Some(candidate) = study.candidate(&case.candidate) else { continue };
            let (name, model) = (field(&subject.name), field(&candidate.name));
            csv += &format!("{name},{model},{},{}", candidate.kind, candidate.net);
            for (_, value) in COLUMNS {
                let _ = write!(csv, ",{}", value(case));
            }
            for image in &case.images {
                let d = &image.difference;
                for value in [d.mae, d.rmse, d.psnr, d.ssim, image.flip, image.hdr_flip] {
                    let _ = write!(csv, ",{value}");
                }
            }
            let _ = write!(csv, ",{},{}", candidate.own_bytes, candidate.shared_bytes);
            for way in ["batch", "packet of 8", "single", "sample", "pdf"] {
                csv += &candidate.times.get(way).map_or(",".into(), |time| format!(",{}", time.median));
            }
            csv += &candidate.fit_seconds.map_or(",\n".into(), |seconds| format!(",{seconds}\n"));
        }
    }
    csv
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

/// A field of a CSV file (RFC 4180).
fn field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
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
    fn every_line_has_as_many_fields_as_the_head() {
        let csv = csv(&small());
        let fields = |line: &str| line.split(',').count();
        let lines: Vec<&str> = csv.lines().collect();
        assert_eq!(lines.len(), 3);
        assert!(lines.iter().all(|line| fields(line) == fields(lines[0])), "{csv}");
        assert_eq!(field("a, \"b\""), "\"a, \"\"b\"\"\"");
    }

    #[test]
    fn json_holds_figures_and_no_pictures() {
        let json = json(&small());
        assert!(json.contains("\"smape\"") && !json.contains("iVBOR"));
        serde_json::from_str::<Value>(&json).unwrap();
    }
}
