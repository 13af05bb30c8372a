//! Which file of a folder is which map.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::decode;
use crate::error::{Error, Few};
use crate::finding::{Finding, Map};
use crate::gltf;
use crate::image::{Format, Image};
use crate::maps::{self, Maps, Size};
use crate::names::{self, Green, Name, Role};
use crate::recipe::{Channel, Color, Normals, Recipe, Scalar, is_same_shape};
use crate::source::{Bytes, Files};

/// The memory in bytes that [`Folder::maps`] may take, where nothing speaks against it: 1 GiB.
pub const MEMORY: u64 = 1 << 30;

/// Extensions of the formats that are read.
const READ: [&str; 4] = ["png", "jpg", "jpeg", "exr"];
/// Extensions of other images, which are named as what they are.
const OTHER: [&str; 12] =
    ["tif", "tiff", "tga", "webp", "bmp", "hdr", "psd", "dds", "ktx", "ktx2", "avif", "jxl"];

/// The maps of one material, of which the headers have been read: a folder, a glTF file or one image.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
    /// The glTF file that names the images, where one does.
    gltf: Option<PathBuf>,
    material: String,
    recipe: Recipe,
    findings: Vec<Finding>,
}

impl Folder {
    /// The only material of a folder of images, of a folder with a glTF file, of a `.gltf` or `.glb` file; or an image
    /// of the colour. A folder without images is taken as its subfolder `textures`.
    ///
    /// # Errors
    /// If there is no map of the colour, if there are several materials, or if a map cannot be read or be what its
    /// name says.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, Error> {
        open(path.as_ref(), None)
    }

    /// As [`Folder::open`], for one of several materials: of images the name before that of the map
    /// (`Wood049` of `Wood049_1K-JPG_Color.jpg`), in a glTF file the material's name, or its number if it has none.
    ///
    /// # Errors
    /// As [`Folder::open`], and if there is no such material.
    pub fn open_material(path: impl AsRef<Path>, material: &str) -> Result<Self, Error> {
        open(path.as_ref(), Some(material))
    }

    /// As [`Folder::open`], from names and contents of files that are in memory.
    ///
    /// # Errors
    /// As [`Folder::open`].
    pub fn from_files(
        path: impl AsRef<Path>,
        files: impl IntoIterator<Item = (String, Vec<u8>)>,
    ) -> Result<Self, Error> {
        of_files(path.as_ref(), &Files::in_memory(path.as_ref(), files), None)
    }

    /// Where it was opened.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The material's name.
    #[must_use]
    pub fn material(&self) -> &str {
        &self.material
    }

    /// What was taken, filled in, and left out.
    #[must_use]
    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// The files that the maps come from, each once; a glTF file is one of them.
    #[must_use]
    pub fn files(&self) -> Vec<&Path> {
        let images = self.recipe.images().map(|(_, image)| image.path());
        let heights = self.recipe.normal.heights.iter().map(|image| image.path());
        let mut files: Vec<&Path> = images.chain(heights).chain(self.gltf.as_deref()).collect();
        files.sort();
        files.dedup();
        files
    }

    /// The width and height that maps of this size have.
    #[must_use]
    pub fn size(&self, size: Size) -> [usize; 2] {
        maps::size_of(&self.recipe, size)
    }

    /// Bytes that decoding takes at most, the maps among them.
    #[must_use]
    pub fn memory(&self, size: Size) -> u64 {
        decode::memory(&self.recipe, self.size(size)).1
    }

    /// Decodes the maps, if that takes at most `limit` bytes.
    ///
    /// # Errors
    /// If it takes more, or if an image is broken or no map of what its name says.
    pub fn maps(&self, size: Size, limit: u64) -> Result<Maps, Error> {
        let wanted = self.size(size);
        if wanted.contains(&0) {
            return Err(Error::NoTexels { path: self.path.clone(), size: wanted });
        }
        let (image, bytes) = decode::memory(&self.recipe, wanted);
        if bytes > limit {
            let path = image.map_or(&*self.path, |image| image.path()).to_owned();
            let size = image.map_or([1, 1], |image| image.size);
            return Err(Error::Memory { path, size, wanted, bytes, limit });
        }
        decode::decode(&self.recipe, wanted)
    }
}

fn open(path: &Path, wanted: Option<&str>) -> Result<Folder, Error> {
    let metadata = std::fs::metadata(path).map_err(Error::read(path))?;
    if metadata.is_dir() {
        return of_files(path, &Files::on_disk(path), wanted);
    }
    let parent = path.parent().unwrap_or(Path::new(""));
    let bytes = Bytes::of_file(path)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    if is_gltf(&name) {
        return of_gltf(path, gltf::read(&Files::on_disk(parent), &name, wanted)?);
    }
    of_image(path, bytes)
}

/// One image: the colour alone.
fn of_image(path: &Path, bytes: Bytes) -> Result<Folder, Error> {
    let image = Image::open(bytes)?;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let name = names::parse(&stem);
    if let Some(Name { role, .. }) = &name
        && !matches!(role, Role::BaseColor | Role::Diffuse)
    {
        return Err(Error::NotColor { path: path.to_owned(), found: role.of() });
    }
    let material = name.map(|name| name.material).filter(|material| !material.is_empty()).unwrap_or(stem);
    let mut recipe = Recipe::plain();
    recipe.base_color.image = Some(Arc::new(image));
    let findings = recipe.findings();
    finish(path, material, recipe, findings)
}

fn of_files(path: &Path, files: &Files, wanted: Option<&str>) -> Result<Folder, Error> {
    let images = Images::list(files)?;
    if !images.materials().is_empty() {
        return images.open(path, files, wanted);
    }
    let gltf: Vec<String> = files.names()?.into_iter().filter(|name| is_gltf(name)).collect();
    match gltf.as_slice() {
        [] => {}
        [name] => return of_gltf(path, gltf::read(files, name, wanted)?),
        _ => return Err(Error::SeveralMaterials { path: path.to_owned(), names: gltf }),
    }
    if images.0.is_empty()
        && let Some(textures) = files.textures()?
    {
        let images = Images::list(&textures)?;
        return images.open(path, &textures, wanted);
    }
    images.open(path, files, wanted)
}

fn of_gltf(path: &Path, found: gltf::Found) -> Result<Folder, Error> {
    let gltf::Found { path: gltf, material, recipe, findings } = found;
    Ok(Folder { gltf: Some(gltf), ..finish(path, material, recipe, findings)? })
}

fn finish(path: &Path, material: String, recipe: Recipe, findings: Vec<Finding>) -> Result<Folder, Error> {
    recipe.check()?;
    Ok(Folder { path: path.to_owned(), gltf: None, material, recipe, findings })
}

fn is_gltf(name: &str) -> bool {
    matches!(extension(name).as_str(), "gltf" | "glb")
}

fn extension(name: &str) -> String {
    name.rsplit_once('.').map_or(String::new(), |(_, extension)| extension.to_ascii_lowercase())
}

/// The images of a folder, by their names alone.
struct Images(Vec<Listed>);

struct Listed {
    file: String,
    name: Option<Name>,
    is_read: bool,
}

impl Listed {
    /// The role, if it is of a format that is read.
    fn role(&self) -> Option<Role> {
        self.name.as_ref().filter(|_| self.is_read).map(|name| name.role)
    }

    /// Whether it belongs to a material; a file that names none belongs to any.
    fn is_of(&self, key: &str) -> bool {
        self.name.as_ref().is_some_and(|name| name.material.is_empty() || name.material.to_lowercase() == key)
    }
}

impl Images {
    fn list(files: &Files) -> Result<Self, Error> {
        let mut listed = Vec::new();
        for file in files.names()? {
            let extension = extension(&file);
            let is_read = READ.contains(&extension.as_str());
            if is_read || OTHER.contains(&extension.as_str()) {
                let name = names::parse(&file[..file.len() - extension.len() - 1]);
                listed.push(Listed { file, name, is_read });
            }
        }
        Ok(Images(listed))
    }

    /// The materials that have a map of their colour: names in small letters, and as they are written.
    fn materials(&self) -> BTreeMap<String, String> {
        let colors =
            self.0.iter().filter(|image| matches!(image.role(), Some(Role::BaseColor | Role::Diffuse)));
        let names = colors.filter_map(|image| image.name.as_ref());
        names.map(|name| (name.material.to_lowercase(), name.material.clone())).collect()
    }

    /// What there is in place of a map of the colour.
    fn described(&self) -> String {
        if self.0.is_empty() {
            return "it has no images".to_owned();
        }
        let names: Vec<String> = self.0.iter().map(|image| image.file.clone()).collect();
        let unread = self.0.iter().any(|image| !image.is_read);
        format!(
            "its images are {}{}",
            Few(&names),
            if unread { ", not all of a format that is read" } else { "" }
        )
    }

    fn open(&self, path: &Path, files: &Files, wanted: Option<&str>) -> Result<Folder, Error> {
        let materials = self.materials();
        if materials.is_empty() {
            return Err(Error::NoColor { path: files.folder().to_owned(), found: self.described() });
        }
        let all = || materials.values().cloned().collect();
        let key = match wanted {
            Some(name) => name.to_lowercase(),
            None if materials.len() == 1 => materials.keys().next().cloned().unwrap_or_default(),
            None => return Err(Error::SeveralMaterials { path: path.to_owned(), names: all() }),
        };
        let Some(material) = materials.get(&key) else {
            let name = wanted.unwrap_or_default().to_owned();
            return Err(Error::NoMaterial { path: path.to_owned(), name, names: all() });
        };
        let mut choice = Choice::default();
        let is_of_another = |image: &&Listed| {
            image.name.as_ref().is_some_and(|name| {
                let of = name.material.to_lowercase();
                of != key && !of.is_empty() && materials.contains_key(&of)
            })
        };
        for image in self.0.iter().filter(|image| !is_of_another(image)) {
            choice.add(image, &key, files)?;
        }
        for file in files.names()?.into_iter().filter(|name| is_gltf(name)) {
            choice
                .unused
                .push(Finding::Unused { file, why: "the images are known by their names".to_owned() });
        }
        let material = if material.is_empty() {
            path.file_name().unwrap_or_default().to_string_lossy().into_owned()
        } else {
            material.clone()
        };
        let (recipe, findings) = choice.made(files);
        finish(path, material, recipe, findings)
    }
}

/// An image that can be a map.
struct Candidate {
    role: Role,
    image: Arc<Image>,
    file: String,
}

impl Candidate {
    /// The best comes first: of the right meaning, large, exact.
    fn order(&self) -> impl Ord + use<> {
        let meaning = match self.role {
            Role::BaseColor | Role::Roughness | Role::Metalness | Role::SpecularLevel => 0,
            Role::Normal(Green::Up) => 0,
            Role::Diffuse | Role::Gloss | Role::Normal(Green::Unsaid) => 1,
            Role::Packed | Role::Normal(Green::Down) | Role::Height | Role::Unused(_) => 2,
        };
        let is_exact = self.image.format != Format::Jpeg;
        (meaning, Reverse((self.image.texels(), self.image.depth, is_exact)), self.file.clone())
    }
}

/// The images of one material, of which each map takes the best.
#[derive(Default)]
struct Choice {
    candidates: Vec<Candidate>,
    heights: Vec<String>,
    unused: Vec<Finding>,
}

impl Choice {
    fn add(&mut self, image: &Listed, key: &str, files: &Files) -> Result<(), Error> {
        let why = match (&image.name, image.role()) {
            (None, _) => "its name is that of no map".to_owned(),
            (Some(name), _) if !image.is_of(key) => {
                format!("its material is \"{}\" by its name", name.material.escape_debug())
            }
            (Some(_), None) => "its format is not read".to_owned(),
            (Some(_), Some(Role::Unused(what))) => what.to_owned(),
            (Some(_), Some(role @ Role::Height)) => {
                self.heights.push(image.file.clone());
                role.of().to_owned()
            }
            (Some(_), Some(role)) => {
                let image_of = Arc::new(Image::open(files.get(&image.file)?)?);
                self.candidates.push(Candidate { role, image: image_of, file: image.file.clone() });
                return Ok(());
            }
        };
        self.unused.push(Finding::Unused { file: image.file.clone(), why });
        Ok(())
    }

    /// The best image for a map.
    fn best(&self, map: Map) -> Option<&Candidate> {
        let is_of = |role: Role| match map {
            Map::BaseColor => matches!(role, Role::BaseColor | Role::Diffuse),
            Map::Roughness => matches!(role, Role::Roughness | Role::Gloss | Role::Packed),
            Map::Metalness => matches!(role, Role::Metalness | Role::Packed),
            Map::Normal => matches!(role, Role::Normal(_)),
            Map::Specular => role == Role::SpecularLevel,
        };
        self.candidates
            .iter()
            .filter(|candidate| is_of(candidate.role))
            .min_by_key(|candidate| candidate.order())
    }

    /// Heights of the same shape as the normals. Those that cannot be read are no reason to refuse the others.
    fn heights_of(&self, normals: &Image, files: &Files) -> Option<Arc<Image>> {
        let open = |name: &String| Image::open(files.get(name).ok()?).ok();
        let image = self.heights.iter().find_map(open)?;
        is_same_shape(image.size, normals.size).then(|| Arc::new(image))
    }

    fn made(self, files: &Files) -> (Recipe, Vec<Finding>) {
        let mut recipe = Recipe::plain();
        if let Some(best) = self.best(Map::BaseColor) {
            recipe.base_color = Color { image: Some(best.image.clone()), factor: [1.0; 3] };
        }
        if let Some(best) = self.best(Map::Roughness) {
            recipe.roughness = match best.role {
                Role::Gloss => Scalar { offset: 1.0, ..Scalar::of(best.image.clone(), Channel::Red, -1.0) },
                Role::Packed => Scalar::of(best.image.clone(), Channel::Green, 1.0),
                _ => Scalar::of(best.image.clone(), Channel::Red, 1.0),
            };
        }
        if let Some(best) = self.best(Map::Metalness) {
            let channel = if best.role == Role::Packed { Channel::Blue } else { Channel::Red };
            recipe.metalness = Scalar::of(best.image.clone(), channel, 1.0);
        }
        if let Some(best) = self.best(Map::Normal)
            && let Role::Normal(green) = best.role
        {
            let heights = (green == Green::Unsaid).then(|| self.heights_of(&best.image, files)).flatten();
            recipe.normal = Normals { image: Some(best.image.clone()), green, heights, scale: 1.0 };
        }
        if let Some(best) = self.best(Map::Specular) {
            // Blender's and Disney's: 0.5 is the index of refraction 1.5.
            recipe.specular = Scalar::of(best.image.clone(), Channel::Red, 0.08);
        }
        let mut findings = recipe.findings();
        findings.extend(self.candidates.iter().filter_map(|candidate| candidate.passed_over(&recipe)));
        let heights = recipe.normal.heights.as_ref().map(|heights| heights.file());
        let is_used = |finding: &Finding| match finding {
            Finding::Unused { file, .. } => Some(file) == heights.as_ref(),
            _ => false,
        };
        findings.extend(self.unused.into_iter().filter(|finding| !is_used(finding)));
        (recipe, findings)
    }
}

impl Candidate {
    /// What is said of it, if no map took it.
    fn passed_over(&self, recipe: &Recipe) -> Option<Finding> {
        if recipe.images().any(|(_, image)| Arc::ptr_eq(image, &self.image)) {
            return None;
        }
        let map = match self.role {
            Role::BaseColor | Role::Diffuse => Map::BaseColor,
            Role::Roughness | Role::Gloss | Role::Packed => Map::Roughness,
            Role::Metalness => Map::Metalness,
            Role::Normal(_) => Map::Normal,
            Role::SpecularLevel | Role::Height | Role::Unused(_) => Map::Specular,
        };
        let taken = recipe.images().find(|(taken, _)| *taken == map).map(|(_, image)| image.file());
        let why = format!("{} is taken for the {map}", taken.unwrap_or_default());
        Some(Finding::Unused { file: self.file.clone(), why })
    }
}
