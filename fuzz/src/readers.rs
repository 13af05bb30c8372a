//! Every reader of glimt on bytes that may be anything: it must answer with an error or with a material
//! that keeps its promises, and use no more memory than such a file is worth.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;

use glimt_core::{Library, Material, SampleBrdf, Vec3};
use glimt_files::{Array, Samples, merl_fits, nbrdf};
use glimt_fit::checkpoint::Checkpoint;
use glimt_measured::utia::Encoding;
use glimt_measured::{Measured, Merl, Rgl, Utia, merl, utia};
use glimt_textures::{Folder, Maps, Size};

/// Name in errors; no file is opened.
const PATH: &str = "hostile";

/// A reader's name and what runs it: whether the bytes were accepted.
pub type Reader = (&'static str, fn(&[u8]) -> bool);

/// All of them, by the names of their folders in the corpus.
pub const READERS: [Reader; 10] = [
    ("library", library),
    ("merl", merl_file),
    ("utia", utia_file),
    ("rgl", rgl),
    ("npy", npy),
    ("nbrdf", nbrdf_file),
    ("samples", samples),
    ("checkpoint", checkpoint),
    ("fit", fit),
    ("textures", textures),
];

/// Model libraries.
pub fn library(bytes: &[u8]) -> bool {
    let Some(library) = within(JSON, bytes, || Library::from_bytes(PATH, bytes)) else { return false };
    let entries = library.entries();
    entries.iter().flatten().for_each(|entry| promises(&entry.material));
    entries.is_ok()
}

/// MERL tables: the header and length of any bytes, and any numbers in a table.
pub fn merl_file(bytes: &[u8]) -> bool {
    within(BINARY, bytes, || Merl::from_bytes(Path::new(PATH), bytes));
    within(BINARY, bytes, || merl::decode_bins(Path::new(PATH), bytes)).is_some()
}

/// UTIA tables: the length of any bytes, and any numbers in a table.
pub fn utia_file(bytes: &[u8]) -> bool {
    let encoding = if bytes.len().is_multiple_of(2) { Encoding::Reflectance } else { Encoding::Raw };
    within(BINARY, bytes, || Utia::from_bytes(Path::new(PATH), bytes, encoding));
    within(BINARY, bytes, || utia::decode_pairs(Path::new(PATH), bytes, encoding)).is_some()
}

/// RGL tensor files.
pub fn rgl(bytes: &[u8]) -> bool {
    let Some(rgl) = within(BINARY, bytes, || Rgl::from_bytes(Path::new(PATH), bytes)) else { return false };
    promises(&Measured::Rgl(rgl).into_material());
    true
}

/// NumPy arrays.
pub fn npy(bytes: &[u8]) -> bool {
    let Some(array) = within(BINARY, bytes, || Array::from_bytes(bytes)) else { return false };
    assert_eq!(array.shape.iter().product::<usize>(), array.values.len());
    true
}

/// NBRDF weights, `.npz` and `.h5`.
pub fn nbrdf_file(bytes: &[u8]) -> bool {
    let material = within(ARCHIVE, bytes, || nbrdf::from_bytes(Path::new(PATH), bytes));
    let Some(material) = material else { return false };
    promises(&Material::from(material));
    true
}

/// Scattered samples, `.csv` and `.npy`.
pub fn samples(bytes: &[u8]) -> bool {
    let Some(samples) = within(TEXT, bytes, || Samples::from_bytes(bytes)) else { return false };
    assert!(!samples.is_empty());
    assert!(samples.light.len() == samples.len() && samples.view.len() == samples.len());
    for direction in samples.light.iter().chain(&samples.view) {
        assert!(direction.z > 0.0 && (direction.length() - 1.0).abs() < 1e-5, "{direction}");
    }
    assert!(samples.f.iter().all(|f| f.is_finite() && f.cmpge(Vec3::ZERO).all()));
    true
}

/// Checkpoints of interrupted fits.
pub fn checkpoint(bytes: &[u8]) -> bool {
    let Some(checkpoint) = within(JSON, bytes, || Checkpoint::from_bytes(bytes)) else { return false };
    assert!(checkpoint.state.numbers.iter().all(|x| x.is_finite()));
    true
}

/// Published analytic fits.
pub fn fit(bytes: &[u8]) -> bool {
    let Some(materials) = within(JSON, bytes, || merl_fits::materials(bytes)) else { return false };
    for (_, material) in materials {
        promises(&Material::from(material));
    }
    true
}

/// Folders of texture maps.
pub fn textures(bytes: &[u8]) -> bool {
    const LIMIT: usize = 1 << 20;
    let maps = within(IMAGES, bytes, || {
        let folder = Folder::from_files(PATH, packed_files(bytes))?;
        // A claim of many texels is refused here, and of a moderate number there.
        let _ = folder.maps(Size::Own, LIMIT as u64 / 4)?;
        folder.maps(Size::LongestSide(5), LIMIT as u64)
    });
    let Some(maps) = maps else { return false };
    promises_of_maps(&maps);
    true
}

/// Files one after another: the length of the name in one byte, the name, the length of the contents in two bytes of
/// which the first is the lower one, the contents. The last may end early.
fn packed_files(mut bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    fn take<'a>(bytes: &mut &'a [u8], length: usize) -> &'a [u8] {
        let (taken, rest) = bytes.split_at(length.min(bytes.len()));
        *bytes = rest;
        taken
    }
    let mut files = Vec::new();
    while !bytes.is_empty() {
        let length = usize::from(take(&mut bytes, 1)[0]);
        let name = String::from_utf8_lossy(take(&mut bytes, length)).into_owned();
        let length =
            take(&mut bytes, 2).iter().rev().fold(0, |length, &byte| length << 8 | usize::from(byte));
        files.push((name, take(&mut bytes, length).to_vec()));
    }
    files
}

/// Numbers are from 0 to 1, and normals are unit vectors above the surface.
fn promises_of_maps(maps: &Maps) {
    let texels = maps.size[0] * maps.size[1];
    assert!(maps.base_color.len() == texels && maps.normal.len() == texels);
    for scalars in [&maps.roughness, &maps.metalness, &maps.specular] {
        assert!(scalars.len() == texels && scalars.iter().all(|x| (0.0..=1.0).contains(x)), "{scalars:?}");
    }
    assert!(maps.base_color.iter().flatten().all(|x| (0.0..=1.0).contains(x)), "{:?}", maps.base_color);
    assert!(maps.variance.len() == texels && maps.variance.iter().all(|x| x.is_finite() && *x >= 0.0));
    for &[x, y, z] in &maps.normal {
        assert!((x * x + y * y + z * z - 1.0).abs() < 1e-5 && z > 0.04, "normal ({x}, {y}, {z})");
    }
}

/// f is finite and ≥ 0 and the density is that of the sampler, wherever one looks.
fn promises(material: &dyn SampleBrdf) {
    let directions = [
        Vec3::Z,
        Vec3::new(0.6, 0.0, 0.8),
        Vec3::new(-0.36, 0.48, 0.8),
        Vec3::new(0.0, -0.999_999_5, 1e-3),
        Vec3::new(1.0, 0.0, 1e-30),
        Vec3::new(0.0, 0.6, -0.8),
    ];
    for light in directions {
        for view in directions {
            let (f, pdf) = (material.eval(light, view), material.pdf(light, view));
            assert!(f.is_finite() && f.cmpge(Vec3::ZERO).all(), "f({light}, {view}) = {f}");
            assert!(pdf.is_finite() && pdf >= 0.0, "pdf({light}, {view}) = {pdf}");
        }
    }
    for view in directions {
        let sample = material.sample(view, Vec3::new(0.4, 0.7, 0.3));
        assert!(sample.pdf.is_finite() && sample.pdf >= 0.0, "{sample:?}");
        assert!(sample.weight.is_finite() && sample.weight.cmpge(Vec3::ZERO).all(), "{sample:?}");
    }
}

/// Memory that reading a file may take, beside the file itself.
struct Budget {
    /// Times the file's length.
    factor: usize,
    /// Bytes on top: tables of the formats, and messages.
    slack: usize,
}

/// Numbers that are as long in memory as in the file.
const BINARY: Budget = Budget { factor: 2, slack: 16 << 10 };
/// The shortest line of nine numbers has 18 bytes, and is 36 in memory.
const TEXT: Budget = Budget { factor: 2, slack: 16 << 10 };
/// The numbers of JSON and its names are longer in memory than as text; and what the choice of a sampler
/// needs for a while, whatever the material.
const JSON: Budget = Budget { factor: 24, slack: 256 << 10 };
/// Compressed arrays of at most what a network needs, the state of the decompression, and the 65,535 messages
/// for which the HDF5 reader makes room at every object before it looks for them: 9.4 MB of addresses, of which it
/// touches what the file has.
const ARCHIVE: Budget = Budget { factor: 2, slack: 64 << 20 };

/// Texels up to the limit that the target asks for; the decoders' own buffers, such as the window of a PNG; and a JSON
/// document of glTF.
const IMAGES: Budget = Budget { factor: 24, slack: 4 << 20 };

/// What `read` gives, if that is no error; fails if it took more than its budget.
fn within<T, E: std::fmt::Debug>(
    budget: Budget,
    bytes: &[u8],
    read: impl FnOnce() -> Result<T, E>,
) -> Option<T> {
    let (result, used) = with_peak(read);
    let most = budget.factor * bytes.len() + budget.slack;
    assert!(used <= most as isize, "reading {} bytes took {used} bytes of memory", bytes.len());
    result.ok()
}

/// What `run` gives, and the most memory in bytes that this thread held meanwhile beyond what it held before.
pub fn with_peak<T>(run: impl FnOnce() -> T) -> (T, isize) {
    let before = LIVE.with(Cell::get);
    PEAK.with(|peak| peak.set(before));
    let result = run();
    (result, PEAK.with(Cell::get).saturating_sub(before))
}

/// Counts what this thread holds, and the most that it held.
struct Counting;

thread_local! {
    static LIVE: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
}

fn count(change: isize) {
    // A thread that ends may free when its counters are gone.
    let _ = LIVE.try_with(|live| {
        live.set(live.get() + change);
        let _ = PEAK.try_with(|peak| peak.set(peak.get().max(live.get())));
    });
}

// SAFETY: everything is left to the system's allocator; counting does not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller's promise.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as isize));
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Old and new may both be there while it is copied.
        count(size as isize);
        count(-(layout.size() as isize));
        // SAFETY: the caller's promise.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;
