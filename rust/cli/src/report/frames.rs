//! Whole frames in Mitsuba: work precision of every model, by `python -m glimt.frames`.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use glimt_report::study::MEASUREMENT;
use glimt_report::study::frames::{Curves, Frames};
use serde_json::{Value, json};

use super::cache::Cache;
use super::opponents::{Model, Opponents, Truth};
use crate::Usage;
use crate::simulated::{PYTHON, python};

/// What [`Frames`] holds.
type Scenes = BTreeMap<String, BTreeMap<String, Curves>>;

/// Renders a material with every model that has it, or takes what was kept.
///
/// # Errors
/// There is no such material, or Python, Mitsuba or the package are missing.
pub fn render(opponents: &Opponents, material: &str, cache: &Cache) -> Result<Frames> {
    let truth = opponents.truth(material).ok_or_else(|| {
        let names: Vec<&str> = opponents.truths.iter().map(|truth| truth.name.as_str()).collect();
        Usage(format!("there is no measurement named \"{material}\"; expected one of {}", names.join(", ")))
    })?;
    let models: Vec<(&Model, String)> =
        opponents.against(truth).map(|(model, entry)| (model, entry.name.clone())).collect();
    let request = request(truth, &models)?;
    let hashes: Vec<&str> = models.iter().map(|(model, _)| model.sha256.as_str()).collect();
    let key = json!(["frames", request, truth.sha256, hashes]);
    let scenes = cache.get(&key, || ask(&request))?;
    Ok(Frames { material: truth.name.clone(), scenes })
}

/// What `glimt.frames` is asked for: the measurement and every model, by their own samplers and by tables.
fn request(truth: &Truth, models: &[(&Model, String)]) -> Result<Value> {
    let absolute = |path: &Path| -> Result<String> {
        let path = path.canonicalize().with_context(|| format!("cannot find {}", path.display()))?;
        let name = path
            .to_str()
            .with_context(|| format!("{} is no name in UTF-8, which Mitsuba needs", path.display()))?;
        Ok(name.to_owned())
    };
    let mut bsdfs: BTreeMap<String, Value> = BTreeMap::new();
    let mut add = |name: &str, file: &Path, material: &str| -> Result<()> {
        let bsdf = json!({"type": "glimt", "filename": absolute(file)?, "material": material});
        let mut by_table = bsdf.clone();
        by_table["sampler"] = json!("table");
        bsdfs.extend([(name.to_owned(), bsdf), (format!("{name}, table"), by_table)]);
        Ok(())
    };
    add(MEASUREMENT, &truth.file, &truth.name)?;
    for (model, material) in models {
        add(&model.name, model.file_of(material), material)?;
    }
    if truth.format == "rgl" {
        bsdfs.insert(
            "Mitsuba's measured".to_owned(),
            json!({"type": "measured", "filename": absolute(&truth.file)?}),
        );
    }
    // A point of reference for time and noise; nobody fitted it.
    let principled = json!({"type": "principled", "roughness": 0.3, "metallic": 0.5});
    bsdfs.insert("Mitsuba's principled".to_owned(), principled);
    Ok(json!({"bsdfs": bsdfs, "reference": MEASUREMENT}))
}

fn ask(request: &Value) -> Result<Scenes> {
    let python = python();
    let mut process = Command::new(&python);
    process.args(["-m", "glimt.frames", "-"]).stdin(Stdio::piped()).stdout(Stdio::piped());
    let cannot_start = || format!("cannot start {} ({PYTHON} names another)", python.display());
    let mut child = process.spawn().with_context(cannot_start)?;
    // A process that ended at once says why below.
    let _ = child.stdin.take().expect("it was asked for").write_all(request.to_string().as_bytes());
    let output = child.wait_with_output()?;
    if !output.status.success() {
        bail!(
            "{} -m glimt.frames ended with {}; it needs the packages glimt and mitsuba, and {PYTHON} names another Python",
            python.display(),
            output.status
        );
    }
    serde_json::from_slice(&output.stdout).context("the renderer answers no JSON")
}
