//! The C interface, `cpp/include/glimt/glimt.h`. The comments here are those of the header, which
//! is generated from this file; `tests/c_header.rs` says how.

// Types are spelled as in C.
#![allow(non_camel_case_types)]
// The header says once what every pointer must be, and that is the promise that the calls rely on.
#![allow(clippy::missing_safety_doc)]

use std::ffi::{CStr, CString, c_char};
use std::fmt::Display;
use std::ptr;

use glimt_core::microfacet::Microfacet;
use glimt_core::surface::{Footprint, Place};
use glimt_core::{Brdf, Error, Kind, Library, Material, Sample, SampleBrdf, Vec3};
use glimt_files::Source;

use crate::pointer::{Held, In, Out};
pub use crate::status::glimt_status;
use crate::status::glimt_status::*;
use crate::status::{call, fail, last_error};

/// The model of a material.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum glimt_kind {
    /// The analytic BRDF alone: a Lambertian lobe under a GGX lobe.
    GLIMT_KIND_GGX = 0,
    /// The analytic BRDF, corrected by a network.
    GLIMT_KIND_HYBRID = 1,
    /// A network with learned shading frames.
    GLIMT_KIND_NEURAL = 2,
    /// A network of one material, as Sztrajman et al. 2021.
    GLIMT_KIND_NBRDF = 3,
    /// Tables over single angles, as Bagher et al. 2016.
    GLIMT_KIND_FACTOR = 4,
    /// A measured table as it is.
    GLIMT_KIND_TABULATED = 5,
    /// A published analytic model: Cook and Torrance, Ward, Ashikhmin and Shirley, Low, Bagher.
    GLIMT_KIND_ANALYTIC = 6,
    /// Features in tables on hemispheres and a network, as Dou et al.
    GLIMT_KIND_SPHERICAL = 7,
    /// Texture maps: a surface that is another at every place.
    GLIMT_KIND_MAPS = 8,
    /// A surface whose reflectance at every scale is learned, as Timonen et al.
    GLIMT_KIND_GATED = 9,
}
use glimt_kind::*;

/// A model library in memory. Immutable: any number of threads may use it at once.
pub struct glimt_library {
    library: Library,
    names: Vec<CString>,
    kind: CString,
}

/// A material. Immutable: any number of threads may use it at once. It does not depend on the
/// library that it came from, which may be closed before it.
pub struct glimt_material {
    name: CString,
    material: Material,
}

/// What a material is made of.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct glimt_material_info {
    /// The name, UTF-8; valid as long as the material.
    pub name: *const c_char,
    /// The model.
    pub kind: glimt_kind,
    /// Whether the material is a surface: another at every place, for which glimt_eval_at() and its like ask.
    pub is_surface: bool,
    /// Whether the model has an analytic part. If not, kd, eta and alpha are 0.
    pub has_microfacet: bool,
    /// Diffuse albedo, linear RGB, in [0, 1].
    pub kd: [f32; 3],
    /// Relative index of refraction per channel, in [1, 10].
    pub eta: [f32; 3],
    /// GGX roughness along x and y, in [0.0001, 1].
    pub alpha: [f32; 2],
    /// The latent code, or NULL; valid as long as the material.
    pub latent: *const f32,
    /// Length of the latent code, 0 for models that have none.
    pub latent_size: usize,
}

/// A sampled light direction. A sample that failed has pdf 0 and weight 0.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct glimt_light_sample {
    /// Unit direction towards the light.
    pub light: [f32; 3],
    /// Density of the direction, in 1/sr.
    pub pdf: f32,
    /// f cos(theta_light) / pdf, linear RGB.
    pub weight: [f32; 3],
}

impl From<Sample> for glimt_light_sample {
    fn from(Sample { light, pdf, weight }: Sample) -> Self {
        glimt_light_sample { light: light.to_array(), pdf, weight: weight.to_array() }
    }
}

/// A place on a surface, and how much of the surface around it is seen: a Gaussian.
///
/// The axes of the footprint are what uv changes by over one standard deviation along each of two directions on the
/// screen. A pixel sees about half of what uv changes by from it to the next. Four zeros are a point, and infinity is
/// the whole surface; a number that is NaN counts as 0. A tile of the texture is [0, 1)^2, u to the right and v up.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct glimt_place {
    /// Texture coordinate to the right.
    pub u: f32,
    /// Texture coordinate up.
    pub v: f32,
    /// u of the first axis of the footprint.
    pub dudx: f32,
    /// v of the first axis.
    pub dvdx: f32,
    /// u of the second axis.
    pub dudy: f32,
    /// v of the second axis.
    pub dvdy: f32,
}

impl From<glimt_place> for Place {
    fn from(glimt_place { u, v, dudx, dvdx, dudy, dvdy }: glimt_place) -> Place {
        Place { uv: [u, v], footprint: Footprint::Axes([[dudx, dvdx], [dudy, dvdy]]) }
    }
}

fn fail_with(error: Error) -> glimt_status {
    let status = match error {
        Error::Read { .. } => GLIMT_ERROR_READ,
        Error::Write { .. } => GLIMT_ERROR_WRITE,
        Error::Format { .. } => GLIMT_ERROR_FORMAT,
        Error::UnknownMaterial { .. } | Error::MaterialNotNamed { .. } => GLIMT_ERROR_MATERIAL,
        Error::Parameter { .. } | Error::Mix { .. } => GLIMT_ERROR_PARAMETER,
    };
    fail(status, error.to_string())
}

/// An error of opening a file.
fn fail_to_open(error: glimt_files::Error) -> glimt_status {
    use glimt_files::Error as Files;
    let status = match error {
        Files::Library(error) => return fail_with(error),
        Files::Read { .. } | Files::Measured(glimt_measured::Error::Read { .. }) => GLIMT_ERROR_READ,
        Files::Write { .. } => GLIMT_ERROR_WRITE,
        _ => GLIMT_ERROR_FORMAT,
    };
    fail(status, error.to_string())
}

/// Version of glimt, as "major.minor.patch". A string that is always valid.
#[unsafe(no_mangle)]
pub extern "C" fn glimt_version() -> *const c_char {
    const VERSION: &CStr =
        match CStr::from_bytes_with_nul(concat!(env!("CARGO_PKG_VERSION"), "\0").as_bytes()) {
            Ok(version) => version,
            Err(_) => panic!("the version holds no zero byte"),
        };
    VERSION.as_ptr()
}

/// Message of the last error in the calling thread, UTF-8, one line; empty if there was none.
///
/// It names the file, what was found and what was expected. Valid until the next error in the same
/// thread. Never NULL. A call that succeeds leaves the message as it is.
#[unsafe(no_mangle)]
pub extern "C" fn glimt_last_error() -> *const c_char {
    last_error()
}

/// Reads a model library (.safetensors), a measurement (RGL .bsdf, MERL .binary, UTIA .bin), the weights
/// of a neural BRDF (.h5, .npz, .npy) or published analytic fits (.fit). A measurement and the weights are
/// libraries of one material.
///
/// \param path     File name, UTF-8.
/// \param library  Receives the library, to be closed with glimt_library_close(); NULL on error.
///
/// \return GLIMT_OK; GLIMT_ERROR_READ if the file cannot be read; GLIMT_ERROR_FORMAT if it is not a
/// valid library; GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_library_open(
    path: *const c_char,
    library: *mut *mut glimt_library,
) -> glimt_status {
    call(|| {
        let library = Out(library).empty("library")?;
        let path = In(path).str("path")?;
        let opened = Source::open(path).and_then(|source| source.library().cloned()).map_err(fail_to_open)?;
        let names = opened.names().iter().map(|name| c_string(name)).collect();
        let kind = c_string(opened.kind().name());
        library.give(glimt_library { library: opened, names, kind }, "library")
    })
}

/// A name for C, which cannot hold zero bytes.
fn c_string(text: &str) -> CString {
    CString::new(text.replace('\0', "")).unwrap_or_default()
}

/// Closes a library. Its materials stay valid; its names do not. NULL is ignored.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_library_close(library: *mut glimt_library) {
    Held(library).release();
}

/// Number of materials in a library; 0 for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_library_size(library: *const glimt_library) -> usize {
    In(library).optional().map_or(0, |library| library.names.len())
}

/// Name of a material, UTF-8; valid until the library is closed.
///
/// \param index  0 to glimt_library_size() - 1, in the file's order; the result is NULL for others.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_library_name(library: *const glimt_library, index: usize) -> *const c_char {
    let name = In(library).optional().and_then(|library| library.names.get(index));
    name.map_or(ptr::null(), |name| name.as_ptr())
}

/// The model of the library's materials as files and commands spell it: "ggx", "hybrid", "neural",
/// "nbrdf", "factor", "analytic", "spherical", "maps" or "gated", and "tabulated" for a measurement; valid until
/// the library is closed. NULL for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_library_kind(library: *const glimt_library) -> *const c_char {
    In(library).optional().map_or(ptr::null(), |library| library.kind.as_ptr())
}

/// A material of a library.
///
/// \param name      Name, UTF-8; NULL for the only material of a library that holds one.
/// \param material  Receives the material, to be released with glimt_material_release(); NULL on error.
///
/// \return GLIMT_OK; GLIMT_ERROR_MATERIAL if there is no such material, and glimt_last_error() then
/// says which names are near; GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_library_material(
    library: *const glimt_library,
    name: *const c_char,
    material: *mut *mut glimt_material,
) -> glimt_status {
    call(|| {
        let material = Out(material).empty("material")?;
        let library = &In(library).get("library")?.library;
        let name = if name.is_null() { None } else { Some(In(name).str("name")?) };
        let entry = library.entry(name).map_err(fail_with)?;
        let found = glimt_material { name: c_string(&entry.name), material: entry.material.clone() };
        material.give(found, "material")
    })
}

/// A material between two of a library: for the models whose materials share a network, and ggx.
///
/// \param a, b      Names, UTF-8.
/// \param weight    Share of the second, in [0, 1].
/// \param material  Receives the material, to be released with glimt_material_release(); NULL on error.
///
/// \return GLIMT_OK; GLIMT_ERROR_MATERIAL if there is no such material; GLIMT_ERROR_PARAMETER if the two cannot be
/// mixed, or for a weight outside [0, 1]; GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_library_mix(
    library: *const glimt_library,
    a: *const c_char,
    b: *const c_char,
    weight: f32,
    material: *mut *mut glimt_material,
) -> glimt_status {
    call(|| {
        let material = Out(material).empty("material")?;
        let library = &In(library).get("library")?.library;
        let (a, b) = (In(a).str("a")?, In(b).str("b")?);
        let mix = library.mix(a, b, weight).map_err(fail_with)?;
        let name = c_string(&glimt_core::library::mix_name(a, b, weight));
        material.give(glimt_material { name, material: mix }, "material")
    })
}

/// Releases a material. NULL is ignored.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_material_release(material: *mut glimt_material) {
    Held(material).release();
}

/// What a material is made of.
///
/// \param info  Receives it. Its pointers are valid until the material is released.
///
/// \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_material_get_info(
    material: *const glimt_material,
    info: *mut glimt_material_info,
) -> glimt_status {
    call(|| {
        let material = In(material).get("material")?;
        let microfacet = material.material.microfacet();
        let latent = material.material.latent();
        let answer = glimt_material_info {
            name: material.name.as_ptr(),
            kind: material.material.kind().into(),
            is_surface: material.material.is_surface(),
            has_microfacet: microfacet.is_some(),
            kd: microfacet.map_or([0.0; 3], |m| m.kd),
            eta: microfacet.map_or([0.0; 3], |m| m.eta),
            alpha: microfacet.map_or([0.0; 2], |m| m.alpha),
            latent: if latent.is_empty() { ptr::null() } else { latent.as_ptr() },
            latent_size: latent.len(),
        };
        Out(info).set(answer, "info")
    })
}

impl From<Kind> for glimt_kind {
    fn from(kind: Kind) -> glimt_kind {
        match kind {
            Kind::Ggx => GLIMT_KIND_GGX,
            Kind::Hybrid => GLIMT_KIND_HYBRID,
            Kind::Neural => GLIMT_KIND_NEURAL,
            Kind::Nbrdf => GLIMT_KIND_NBRDF,
            Kind::Factor => GLIMT_KIND_FACTOR,
            Kind::Tabulated => GLIMT_KIND_TABULATED,
            Kind::Analytic => GLIMT_KIND_ANALYTIC,
            Kind::Spherical => GLIMT_KIND_SPHERICAL,
            Kind::Maps => GLIMT_KIND_MAPS,
            Kind::Gated => GLIMT_KIND_GATED,
        }
    }
}

/// A copy of a material with other parameters of its analytic part. The sampler follows them.
///
/// \param kd     Three numbers in [0, 1], or NULL to keep them.
/// \param eta    Three numbers in [1, 10], or NULL to keep them.
/// \param alpha  Two numbers in [0.0001, 1], or NULL to keep them.
/// \param edited Receives the copy, to be released with glimt_material_release(); NULL on error.
///
/// \return GLIMT_OK; GLIMT_ERROR_PARAMETER for a number out of its range or a model without an
/// analytic part; GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_material_edit(
    material: *const glimt_material,
    kd: *const f32,
    eta: *const f32,
    alpha: *const f32,
    edited: *mut *mut glimt_material,
) -> glimt_status {
    call(|| {
        let edited = Out(edited).empty("edited")?;
        let material = In(material).get("material")?;
        let refused = |reason: &dyn Display| {
            let name = material.name.to_string_lossy();
            fail(GLIMT_ERROR_PARAMETER, format!("material \"{name}\": {reason}"))
        };
        let kind = material.material.kind();
        let fitted = material.material.microfacet();
        let fitted =
            fitted.ok_or_else(|| refused(&format!("{kind} materials have no kd, eta or alpha to edit")))?;
        let changed = material.material.with_microfacet(Microfacet {
            kd: *In(kd).arrays().optional().unwrap_or(&fitted.kd),
            eta: *In(eta).arrays().optional().unwrap_or(&fitted.eta),
            alpha: *In(alpha).arrays().optional().unwrap_or(&fitted.alpha),
        });
        let changed = changed.map_err(|reason| refused(&reason))?;
        edited.give(glimt_material { name: material.name.clone(), material: changed }, "edited")
    })
}

/// A place, as C hands it in.
fn at_place(place: *const glimt_place) -> Result<Place, glimt_status> {
    In(place).get("place").map(|&place| place.into())
}

/// A direction or three random numbers, as C hands them in.
fn vector(numbers: *const f32, argument: &str) -> Result<Vec3, glimt_status> {
    In(numbers).arrays().get(argument).map(|&numbers| Vec3::from_array(numbers))
}

/// `n` of them.
fn vectors<'a>(numbers: *const f32, n: usize, argument: &str) -> Result<&'a [Vec3], glimt_status> {
    In(numbers).arrays::<3>().slice(n, argument).map(bytemuck::cast_slice)
}

/// Evaluates f_r(light, view) in 1/sr, linear RGB, without the cosine.
///
/// Directions are unit vectors in the local frame, whose normal is +z, and point away from the
/// surface: light to where the energy comes from, view to where it goes. Below the horizon on
/// either side, and where a direction holds a NaN, f is 0. f is finite and never negative.
/// Allocates no memory. Not guaranteed: f(light, view) = f(view, light).
///
/// A surface (is_surface of glimt_material_info) is what it is from afar here and in every function that takes no
/// place: glimt_eval_at() asks for one.
///
/// \param f  Receives three numbers.
///
/// \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_eval(
    material: *const glimt_material,
    light: *const f32,
    view: *const f32,
    f: *mut f32,
) -> glimt_status {
    call(|| {
        let material = &In(material).get("material")?.material;
        let value = material.eval(vector(light, "light")?, vector(view, "view")?);
        Out(f.cast::<[f32; 3]>()).set(value.to_array(), "f")
    })
}

/// Density in 1/sr (solid angle of light) with which glimt_sample() chooses light for view.
///
/// Directions as for glimt_eval(). Below the horizon on either side, and where a direction holds a NaN,
/// it is 0; elsewhere it may be positive where f is 0. Allocates no memory, but in the first call of a
/// density or sample of a material, which makes its sampler in some milliseconds.
///
/// \param pdf  Receives one number.
///
/// \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_pdf(
    material: *const glimt_material,
    light: *const f32,
    view: *const f32,
    pdf: *mut f32,
) -> glimt_status {
    call(|| {
        let material = &In(material).get("material")?.material;
        let density = material.pdf(vector(light, "light")?, vector(view, "view")?);
        Out(pdf).set(density, "pdf")
    })
}

/// Chooses a light direction for a view direction.
///
/// A direction that falls below the horizon is a failed sample: pdf 0 and weight 0, and GLIMT_OK.
/// Allocates no memory but in the first call, as glimt_pdf().
///
/// \param view  Unit vector, as for glimt_eval().
/// \param u     Three random numbers in [0, 1): the first selects the lobe, the others a direction.
/// \param sample  Receives the direction, its density and its weight.
///
/// \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_sample(
    material: *const glimt_material,
    view: *const f32,
    u: *const f32,
    sample: *mut glimt_light_sample,
) -> glimt_status {
    call(|| {
        let material = &In(material).get("material")?.material;
        let chosen = material.sample(vector(view, "view")?, vector(u, "u")?);
        Out(sample).set(chosen.into(), "sample")
    })
}

/// glimt_eval() at a place of a surface. A material that is no surface is the same at every place, and place is
/// not looked at but for NULL.
///
/// Allocates no memory.
///
/// \param place  Where, and how much is seen around it.
/// \param f      Receives three numbers.
///
/// \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_eval_at(
    material: *const glimt_material,
    place: *const glimt_place,
    light: *const f32,
    view: *const f32,
    f: *mut f32,
) -> glimt_status {
    call(|| {
        let material = &In(material).get("material")?.material;
        let at = material.at(&at_place(place)?);
        let value = at.eval(vector(light, "light")?, vector(view, "view")?);
        Out(f.cast::<[f32; 3]>()).set(value.to_array(), "f")
    })
}

/// glimt_pdf() at a place: the density with which glimt_sample_at() chooses light there.
///
/// Allocates no memory for a surface, and what glimt_pdf() does for any other material.
///
/// \param place  As for glimt_eval_at().
/// \param pdf    Receives one number.
///
/// \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_pdf_at(
    material: *const glimt_material,
    place: *const glimt_place,
    light: *const f32,
    view: *const f32,
    pdf: *mut f32,
) -> glimt_status {
    call(|| {
        let material = &In(material).get("material")?.material;
        let at = material.at(&at_place(place)?);
        Out(pdf).set(at.pdf(vector(light, "light")?, vector(view, "view")?), "pdf")
    })
}

/// glimt_sample() at a place. Memory as glimt_pdf_at().
///
/// \param place   As for glimt_eval_at().
/// \param view    Unit vector, as for glimt_eval().
/// \param u       Three random numbers in [0, 1).
/// \param sample  Receives the direction, its density and its weight.
///
/// \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_sample_at(
    material: *const glimt_material,
    place: *const glimt_place,
    view: *const f32,
    u: *const f32,
    sample: *mut glimt_light_sample,
) -> glimt_status {
    call(|| {
        let material = &In(material).get("material")?.material;
        let at = material.at(&at_place(place)?);
        Out(sample).set(at.sample(vector(view, "view")?, vector(u, "u")?).into(), "sample")
    })
}

/// glimt_eval() for n pairs. Much faster than n calls.
///
/// f differs from that of glimt_eval() by rounding only: by no more than 16 ULP of f's largest channel, as one pair's
/// sums are added in another order. A pair has the same bits in every batch, wherever it stands there.
///
/// Runs in the calling thread. Allocates no memory.
///
/// \param light  n directions, one after the other: 3 n numbers.
/// \param view   As many directions.
/// \param f      Receives 3 n numbers; must not overlap with light or view.
///
/// \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_eval_batch(
    material: *const glimt_material,
    n: usize,
    light: *const f32,
    view: *const f32,
    f: *mut f32,
) -> glimt_status {
    call(|| {
        if n == 0 {
            return Ok(());
        }
        let material = &In(material).get("material")?.material;
        let f: &mut [Vec3] = bytemuck::cast_slice_mut(Out(f.cast::<[f32; 3]>()).slice(n, "f")?);
        material.eval_batch(vectors(light, n, "light")?, vectors(view, n, "view")?, f);
        Ok(())
    })
}

/// glimt_eval_at() for n pairs, each at a place of its own. A surface gives the bits of glimt_eval_at(), any other
/// material those of glimt_eval_batch().
///
/// Runs in the calling thread. Allocates no memory.
///
/// \param place  n places.
/// \param light  n directions, one after the other: 3 n numbers.
/// \param view   As many directions.
/// \param f      Receives 3 n numbers; must not overlap with place, light or view.
///
/// \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_eval_at_batch(
    material: *const glimt_material,
    n: usize,
    place: *const glimt_place,
    light: *const f32,
    view: *const f32,
    f: *mut f32,
) -> glimt_status {
    call(|| {
        if n == 0 {
            return Ok(());
        }
        let material = &In(material).get("material")?.material;
        let places = In(place).slice(n, "place")?.iter().map(|&place| place.into());
        let f: &mut [Vec3] = bytemuck::cast_slice_mut(Out(f.cast::<[f32; 3]>()).slice(n, "f")?);
        material.eval_batch_at(places, vectors(light, n, "light")?, vectors(view, n, "view")?, f);
        Ok(())
    })
}

/// glimt_pdf() for n pairs.
///
/// Runs in the calling thread. Allocates no memory but in the first call, as glimt_pdf().
///
/// \param light  n directions, one after the other: 3 n numbers.
/// \param view   As many directions.
/// \param pdf    Receives n numbers; must not overlap with light or view.
///
/// \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_pdf_batch(
    material: *const glimt_material,
    n: usize,
    light: *const f32,
    view: *const f32,
    pdf: *mut f32,
) -> glimt_status {
    call(|| {
        if n == 0 {
            return Ok(());
        }
        let sampler = In(material).get("material")?.material.sampler();
        let pairs = vectors(light, n, "light")?.iter().zip(vectors(view, n, "view")?);
        for (pdf, (&light, &view)) in Out(pdf).slice(n, "pdf")?.iter_mut().zip(pairs) {
            *pdf = sampler.pdf(light, view);
        }
        Ok(())
    })
}

/// glimt_sample() for n view directions.
///
/// Runs in the calling thread. Allocates no memory but in the first call, as glimt_pdf().
///
/// \param view     n directions, one after the other: 3 n numbers.
/// \param u        3 n random numbers in [0, 1).
/// \param samples  Receives n samples.
///
/// \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_sample_batch(
    material: *const glimt_material,
    n: usize,
    view: *const f32,
    u: *const f32,
    samples: *mut glimt_light_sample,
) -> glimt_status {
    call(|| {
        if n == 0 {
            return Ok(());
        }
        let material = &In(material).get("material")?.material;
        let arguments = vectors(view, n, "view")?.iter().zip(vectors(u, n, "u")?);
        for (sample, (&view, &u)) in Out(samples).slice(n, "samples")?.iter_mut().zip(arguments) {
            *sample = material.sample(view, u).into();
        }
        Ok(())
    })
}
