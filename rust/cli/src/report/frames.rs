//! Whole frames in Mitsuba: work precision of every model, by `python -m glimt.frames`.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use glimt_report::study::{Frame, Frames, MEASUREMENT};
use serde_json::{Value, json};

use super::cache::Cache;
use super::opponents::{Model, Opponents, Truth};
use crate::Usage;
use crate::simulated::{PYTHON, python};

/// What [`Frames`] holds.
type Variants = BTreeMap<String, BTreeMap<String, Vec<Frame>>>;

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
    let variants = cache.get(&key, || ask(&request))?;
    Ok(Frames { material: truth.name.clone(), variants })
}

/// What `glimt.frames` is asked for: the measurement by its own sampler, and every model.
fn request(truth: &Truth, models: &[(&Model, String)]) -> Result<Value> {
    let absolute = |path: &Path| -> Result<String> {
        let path = path.canonicalize().with_context(|| format!("cannot find {}", path.display()))?;
        Ok(path.to_string_lossy().into_owned())
    };
    let glimt = |file: &Path, material: &str| -> Result<Value> {
        Ok(json!({"type": "glimt", "filename": absolute(file)?, "material": material}))
    };
    let mut bsdfs: BTreeMap<&str, Value> = BTreeMap::new();
    bsdfs.insert(MEASUREMENT, glimt(&truth.file, &truth.name)?);
    if truth.format == "rgl" {
        bsdfs.insert("Mitsuba's measured", json!({"type": "measured", "filename": absolute(&truth.file)?}));
    }
    // A point of reference for time and noise; nobody fitted it.
    bsdfs.insert("Mitsuba's principled", json!({"type": "principled", "roughness": 0.3, "metallic": 0.5}));
    for (model, material) in models {
        bsdfs.insert(&model.name, glimt(model.file_of(material), material)?);
    }
    Ok(json!({"bsdfs": bsdfs, "reference": MEASUREMENT}))
}

fn ask(request: &Value) -> Result<Variants> {
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
