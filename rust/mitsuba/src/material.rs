//! A material as the plugin holds it, and files that are opened once for all of its materials.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::SystemTime;

use glimt_core::Library;
use glimt_core::library::{Entry, mix_name};
use glimt_core::sampling::SamplerChoice;
use glimt_disk::printable;
use glimt_files::Source;

/// A material as C++ holds it.
pub struct Material {
    pub name: String,
    pub material: glimt_core::Material,
    /// Kept so that the next BSDF of the scene finds it open.
    pub library: Arc<Library>,
    /// A number that no other has, not even one that takes its memory later.
    pub number: u64,
}

impl Material {
    pub fn new(name: String, material: glimt_core::Material, library: Arc<Library>) -> Material {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        Material { name, material, library, number: NEXT.fetch_add(1, Ordering::Relaxed) }
    }
}

/// What `f` returns, or `fallback` where it panics: a panic that reached C++ would end the process.
pub fn guarded<T>(fallback: T, f: impl FnOnce() -> T) -> T {
    catch_unwind(AssertUnwindSafe(f)).unwrap_or(fallback)
}

/// What `f` returns; a panic becomes an error, for the same reason.
pub fn guarded_result<T>(f: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    let answer = guarded(Err("internal error (a panic, see the standard error stream)".into()), f);
    // Mitsuba writes it to a terminal.
    answer.map_err(|message| printable(&message).into_owned())
}

pub fn open(path: &str, name: &str, sampler: &str) -> Result<Box<Material>, String> {
    guarded_result(|| {
        let library = shared_library(path)?;
        let name = (!name.is_empty()).then_some(name);
        let Entry { name, material, .. } = library.entry(name).map_err(|e| e.to_string())?;
        let (name, material) = (name.clone(), with_sampler(material, sampler)?);
        Ok(Box::new(Material::new(name, material, library)))
    })
}

pub fn mixed(path: &str, a: &str, b: &str, weight: f32, sampler: &str) -> Result<Box<Material>, String> {
    guarded_result(|| {
        let library = shared_library(path)?;
        let mix = library.mix(a, b, weight).map_err(|e| e.to_string())?;
        let (name, material) = (mix_name(a, b, weight), with_sampler(&mix, sampler)?);
        Ok(Box::new(Material::new(name, material, library)))
    })
}

/// `material` with the sampler of that name; with its own if the name is empty.
fn with_sampler(material: &glimt_core::Material, sampler: &str) -> Result<glimt_core::Material, String> {
    let choice = (!sampler.is_empty()).then(|| sampler.parse::<SamplerChoice>()).transpose()?;
    Ok(choice.map_or_else(|| material.clone(), |choice| material.with_sampler(choice)))
}

/// The library at `path`, which is opened once for all BSDFs of a scene: that their materials share one
/// network in memory is what lets a packet of them be evaluated in one go.
fn shared_library(path: &str) -> Result<Arc<Library>, String> {
    /// A file as it was when it was opened: one that changed since is opened anew.
    type State = (PathBuf, Option<SystemTime>, u64);
    static OPEN: Mutex<Vec<(State, Weak<Library>)>> = Mutex::new(Vec::new());

    let state =
        std::fs::metadata(path).ok().map(|file| (PathBuf::from(path), file.modified().ok(), file.len()));
    // A panic while the list was locked left it whole: it is changed by single calls.
    let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
    open.retain(|(_, library)| library.strong_count() > 0);
    let found = open.iter().find(|(other, _)| Some(other) == state.as_ref());
    if let Some(library) = found.and_then(|(_, library)| library.upgrade()) {
        return Ok(library);
    }
    let source = Source::open(path).map_err(|e| e.to_string())?;
    let library = Arc::new(source.library().map_err(|e| e.to_string())?.clone());
    open.extend(state.map(|state| (state, Arc::downgrade(&library))));
    Ok(library)
}
