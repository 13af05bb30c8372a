//! Materials of glTF 2.0 files, `.gltf` and `.glb`.
//!
//! Only what a material needs is read, and nothing is said of the rest of the file: its meshes may use extensions
//! that no reader of textures has to know.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use percent_encoding::percent_decode_str;
use serde::Deserialize;

use crate::Error;
use crate::error::Few;
use crate::finding::Finding;
use crate::image::Image;
use crate::names::Green;
use crate::recipe::{Channel, Color, Normals, Recipe, Scalar};
use crate::source::{Bytes, Files};

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Document {
    #[serde(default)]
    materials: Vec<Material>,
    #[serde(default)]
    textures: Vec<Texture>,
    #[serde(default)]
    images: Vec<ImageOf>,
    #[serde(default)]
    buffer_views: Vec<View>,
    #[serde(default)]
    buffers: Vec<Buffer>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Material {
    name: Option<String>,
    #[serde(default)]
    pbr_metallic_roughness: MetallicRoughness,
    normal_texture: Option<Slot>,
    #[serde(default)]
    extensions: Extensions,
}

#[derive(Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct MetallicRoughness {
    base_color_factor: [f32; 4],
    base_color_texture: Option<Slot>,
    metallic_factor: f32,
    roughness_factor: f32,
    metallic_roughness_texture: Option<Slot>,
}

impl Default for MetallicRoughness {
    fn default() -> Self {
        MetallicRoughness {
            base_color_factor: [1.0; 4],
            base_color_texture: None,
            metallic_factor: 1.0,
            roughness_factor: 1.0,
            metallic_roughness_texture: None,
        }
    }
}

/// A reference to a texture.
#[derive(Deserialize)]
struct Slot {
    index: usize,
    /// Of normal maps.
    #[serde(default = "one")]
    scale: f32,
    #[serde(default)]
    extensions: SlotExtensions,
}

fn one() -> f32 {
    1.0
}

#[derive(Default, Deserialize)]
struct SlotExtensions {
    #[serde(rename = "KHR_texture_transform")]
    transform: Option<serde::de::IgnoredAny>,
}

#[derive(Default, Deserialize)]
struct Extensions {
    #[serde(rename = "KHR_materials_ior")]
    ior: Option<Ior>,
    #[serde(rename = "KHR_materials_specular")]
    specular: Option<Specular>,
}

#[derive(Deserialize)]
struct Ior {
    #[serde(default = "glass")]
    ior: f32,
}

fn glass() -> f32 {
    1.5
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Specular {
    #[serde(default = "one")]
    specular_factor: f32,
    specular_texture: Option<Slot>,
    specular_color_factor: Option<serde::de::IgnoredAny>,
    specular_color_texture: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
struct Texture {
    source: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct ImageOf {
    uri: Option<String>,
    buffer_view: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct View {
    buffer: usize,
    #[serde(default)]
    byte_offset: u64,
    byte_length: u64,
}

#[derive(Deserialize)]
struct Buffer {
    uri: Option<String>,
}

/// What a material of a file says: its name, and how its parameters come from images.
pub(crate) struct Found {
    /// The glTF file.
    pub(crate) path: PathBuf,
    pub(crate) material: String,
    pub(crate) recipe: Recipe,
    pub(crate) findings: Vec<Finding>,
}

/// The material `wanted`, or the only one, of the file `name`.
pub(crate) fn read(files: &Files, name: &str, wanted: Option<&str>) -> Result<Found, Error> {
    let bytes = files.get(name)?;
    let path = bytes.path().to_owned();
    let (json, binary) = parts(&bytes)?;
    let document: Document = serde_json::from_slice(&json).map_err(|e| broken(&path, e.to_string()))?;
    let names: Vec<String> = document.materials.iter().enumerate().map(|(i, m)| m.called(i)).collect();
    let chosen = choose(&path, &names, wanted)?;
    let mut reader = Reader { files, path: &path, document: &document, binary, images: HashMap::new() };
    let recipe = reader.recipe(&document.materials[chosen])?;
    if recipe.images().next().is_none() {
        return Err(broken(&path, format!("its material {} has no textures", Few(&names[chosen..=chosen]))));
    }
    let why = ignored(&document.materials[chosen]);
    let unused = |why: &str| Finding::Unused { file: name.to_owned(), why: why.to_owned() };
    let mut findings = recipe.findings();
    findings.extend(why.into_iter().map(unused));
    Ok(Found { material: names[chosen].clone(), recipe, findings, path: path.clone() })
}

fn choose(path: &Path, names: &[String], wanted: Option<&str>) -> Result<usize, Error> {
    let all = || names.to_vec();
    match (wanted, names.len()) {
        (_, 0) => Err(broken(path, "it has no materials".to_owned())),
        (None, 1) => Ok(0),
        (None, _) => Err(Error::SeveralMaterials { path: path.to_owned(), names: all() }),
        (Some(wanted), _) => names.iter().position(|name| name == wanted).ok_or_else(|| Error::NoMaterial {
            path: path.to_owned(),
            name: wanted.to_owned(),
            names: all(),
        }),
    }
}

/// The JSON, and the binary chunk of a `.glb` file.
fn parts(bytes: &Bytes) -> Result<(Vec<u8>, Option<Bytes>), Error> {
    const HEADER: u64 = 12;
    let head = bytes.head(HEADER + 8)?;
    if !head.starts_with(b"glTF") {
        return Ok((bytes.all()?, None));
    }
    let failed = |reason: &str| broken(bytes.path(), reason.to_owned());
    let number = |at: usize| {
        let four = head.get(at..at + 4).ok_or_else(|| failed("it ends in its header"))?;
        Ok(u32::from_le_bytes([four[0], four[1], four[2], four[3]]))
    };
    let version = number(4)?;
    if version != 2 {
        return Err(failed(&format!("it is of version {version}, expected 2")));
    }
    let length = u64::from(number(12)?);
    if head.get(16..20) != Some(b"JSON") {
        return Err(failed("its first chunk is not JSON"));
    }
    let json = bytes.part(HEADER + 8, length).ok_or_else(|| failed("it ends in its first chunk"))?;
    let start = HEADER + 8 + length + 8;
    let binary = bytes.length().checked_sub(start).and_then(|rest| bytes.part(start, rest));
    Ok((json.all()?, binary))
}

fn broken(path: &Path, reason: String) -> Error {
    Error::Format { path: path.to_owned(), format: "a glTF file", reason }
}

impl Material {
    fn called(&self, i: usize) -> String {
        self.name.clone().unwrap_or_else(|| i.to_string())
    }
}

/// What is in the material, and has no effect.
fn ignored(material: &Material) -> Vec<&'static str> {
    let pbr = &material.pbr_metallic_roughness;
    let specular = material.extensions.specular.as_ref();
    let slots = [
        pbr.base_color_texture.as_ref(),
        pbr.metallic_roughness_texture.as_ref(),
        material.normal_texture.as_ref(),
        specular.and_then(|specular| specular.specular_texture.as_ref()),
    ];
    let is_moved = slots.into_iter().flatten().any(|slot| slot.extensions.transform.is_some());
    let is_colored =
        specular.is_some_and(|s| s.specular_color_factor.is_some() || s.specular_color_texture.is_some());
    let mut all = Vec::new();
    if is_moved {
        all.push("its transform of texture coordinates, which belongs to the mesh");
    }
    if is_colored {
        all.push("its specular colour");
    }
    all
}

struct Reader<'a> {
    files: &'a Files,
    path: &'a Path,
    document: &'a Document,
    binary: Option<Bytes>,
    /// By their numbers: roughness and metalness are one.
    images: HashMap<usize, Arc<Image>>,
}

impl Reader<'_> {
    fn recipe(&mut self, material: &Material) -> Result<Recipe, Error> {
        let pbr = &material.pbr_metallic_roughness;
        let [r, g, b, _] = pbr.base_color_factor;
        let base_color = Color { image: self.image(pbr.base_color_texture.as_ref())?, factor: [r, g, b] };
        let packed = self.image(pbr.metallic_roughness_texture.as_ref())?;
        let scalar = |channel, factor| match &packed {
            Some(image) => Scalar::of(image.clone(), channel, factor),
            None => Scalar::constant(factor),
        };
        let (roughness, metalness) =
            (scalar(Channel::Green, pbr.roughness_factor), scalar(Channel::Blue, pbr.metallic_factor));
        let slot = material.normal_texture.as_ref();
        let scale = slot.map_or(1.0, |slot| slot.scale);
        let normal = Normals { image: self.image(slot)?, green: Green::Up, heights: None, scale };
        let specular = self.specular(&material.extensions)?;
        Ok(Recipe { base_color, roughness, metalness, normal, specular })
    }

    /// `KHR_materials_ior` says the reflectance, and `KHR_materials_specular` what it is multiplied by.
    fn specular(&mut self, extensions: &Extensions) -> Result<Scalar, Error> {
        let reflectance = extensions.ior.as_ref().map_or(crate::recipe::SPECULAR, |ior| {
            let root = (ior.ior - 1.0) / (ior.ior + 1.0);
            root * root
        });
        let Some(specular) = &extensions.specular else { return Ok(Scalar::constant(reflectance)) };
        let scale = reflectance * specular.specular_factor;
        Ok(match self.image(specular.specular_texture.as_ref())? {
            Some(image) => Scalar::of(image, Channel::Alpha, scale),
            None => Scalar::constant(scale),
        })
    }

    fn image(&mut self, slot: Option<&Slot>) -> Result<Option<Arc<Image>>, Error> {
        let Some(slot) = slot else { return Ok(None) };
        let texture = self.get(&self.document.textures, slot.index, "texture")?;
        let Some(number) = texture.source else {
            return Err(self.broken(format!("its texture {} has no PNG or JPEG image", slot.index)));
        };
        if let Some(image) = self.images.get(&number) {
            return Ok(Some(image.clone()));
        }
        let image = self.get(&self.document.images, number, "image")?;
        let bytes = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => self.named(uri)?,
            (None, Some(view)) => self.view(view)?,
            (None, None) => return Err(self.broken(format!("its image {number} is nowhere"))),
        };
        let image = Arc::new(Image::open(bytes)?);
        self.images.insert(number, image.clone());
        Ok(Some(image))
    }

    /// A part of a buffer.
    fn view(&self, number: usize) -> Result<Bytes, Error> {
        let view = self.get(&self.document.buffer_views, number, "buffer view")?;
        let buffer = self.get(&self.document.buffers, view.buffer, "buffer")?;
        let bytes = match (&buffer.uri, &self.binary) {
            (Some(uri), _) => self.named(uri)?,
            (None, Some(binary)) => binary.clone(),
            (None, None) => return Err(self.broken(format!("its buffer {} is nowhere", view.buffer))),
        };
        bytes.part(view.byte_offset, view.byte_length).ok_or_else(|| {
            self.broken(format!(
                "its buffer view {number} reaches beyond the end of {}",
                bytes.path().display()
            ))
        })
    }

    /// A file beside this one, or what is written in the name itself.
    fn named(&self, uri: &str) -> Result<Bytes, Error> {
        if let Some(data) = uri.strip_prefix("data:") {
            let text = data.split_once(";base64,").map(|(_, text)| text);
            let bytes = text.and_then(|text| BASE64_STANDARD.decode(text).ok());
            let bytes = bytes.ok_or_else(|| self.broken("a data: URI in it is not base64".to_owned()))?;
            return Ok(Bytes::held(self.path, bytes.into()));
        }
        if uri.contains(':') {
            return Err(self.broken(format!("it names \"{}\", expected a file", uri.escape_debug())));
        }
        self.files.get(&percent_decode_str(uri).decode_utf8_lossy())
    }

    fn get<'b, T>(&self, list: &'b [T], number: usize, what: &str) -> Result<&'b T, Error> {
        list.get(number)
            .ok_or_else(|| self.broken(format!("it has {} of what it calls {what} {number}", list.len())))
    }

    fn broken(&self, reason: String) -> Error {
        broken(self.path, reason)
    }
}
