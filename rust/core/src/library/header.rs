//! The JSON object in a library's metadata.

use std::borrow::Cow;
use std::collections::HashSet;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use serde_json::value::RawValue;

use super::{FORMAT_VERSION, Origin};

pub(super) const COLOR_SPACE: &str = "linear sRGB";

/// The JSON object in the file's metadata.
#[derive(Serialize, Deserialize)]
pub(super) struct Header<M> {
    pub format: u32,
    pub kind: String,
    pub color_space: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub form: Option<Value>,
    /// The activation of the networks, where the model has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub activation: Option<String>,
    /// [`Library::digest`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub digest: Option<String>,
    pub materials: Vec<M>,
}

#[derive(Serialize, Deserialize)]
pub(super) struct MaterialHeader {
    pub name: String,
    #[serde(flatten)]
    pub origin: Origin,
}

/// What is read of a [`MaterialHeader`] until the material is asked for.
#[derive(Deserialize)]
struct Named<'a> {
    #[serde(borrow)]
    name: Cow<'a, str>,
}

/// The JSON object in a file's metadata, checked, and the names of its materials.
pub(super) fn read(json: &str) -> Result<(Header<Box<RawValue>>, Vec<String>), String> {
    let header: Header<Box<RawValue>> = from_json(json).or_else(|broken| {
        // A later version may be another object altogether.
        let version: FormatVersion = from_json(json)?;
        Err(if version.format == FORMAT_VERSION { broken } else { other_version(version.format) })
    })?;
    if header.format != FORMAT_VERSION {
        return Err(other_version(header.format));
    }
    if header.color_space != COLOR_SPACE {
        return Err(format!("its colour space is \"{}\", expected \"{COLOR_SPACE}\"", header.color_space));
    }
    if header.materials.is_empty() {
        return Err("it holds no material".into());
    }
    let mut names = Vec::with_capacity(header.materials.len());
    for material in &header.materials {
        names.push(from_json::<Named>(material.get())?.name.into_owned());
    }
    check_names(names.iter().map(String::as_str))?;
    Ok((header, names))
}

pub(super) fn from_json<'a, T: Deserialize<'a>>(json: &'a str) -> Result<T, String> {
    serde_json::from_str(json).map_err(|e| format!("its \"glimt\" metadata is broken: {e}"))
}

fn other_version(found: u32) -> String {
    format!("it has format version {found}, expected {FORMAT_VERSION}")
}

/// The part of the header that is read first: a later version may change the rest.
#[derive(Deserialize)]
struct FormatVersion {
    format: u32,
}

pub(super) fn check_names<'a>(names: impl Iterator<Item = &'a str>) -> Result<(), String> {
    let mut known = HashSet::new();
    for name in names {
        if name.is_empty() {
            return Err("a material's name is empty".into());
        }
        if !known.insert(name) {
            return Err(format!("two materials are named \"{name}\""));
        }
    }
    Ok(())
}
