//! Writes any BRDF as an RGL file, so that renderers which read those show it with nothing of ours.
//!
//! The format stores f · cosθ_light = S · D/(4σ) (see [`crate::rgl`]). D is made from the backscattering
//! of the BRDF as Dupuy & Jakob 2018 make it from that of a material (their section 4.1, after Dupuy et al.,
//! *Extracting Microfacet-based BRDF Parameters from Arbitrary Materials with Power Iterations*, 2015):
//! f(ω, ω) cosθ = D(ω)/(4σ(ω)) up to a factor, and σ(ω) = ∫ D(m) ⟨ω, m⟩ dm, which is iterated. S is then
//! whatever makes the product right: a D that is off costs variance and resolution, not correctness.

use std::f32::consts::{FRAC_PI_2, PI};
use std::path::Path;

use glam::{Vec2, Vec3};
use glimt_core::Brdf;

use crate::error::Error;
use crate::file;
use crate::grid::{Blend, Extent, Grid};
use crate::primaries;
use crate::tensor::{Field, TensorFile};
use crate::warp::Warp;

/// Knots of the tables of one material.
struct Layout {
    phi: Vec<f32>,
    theta: Vec<f32>,
    /// Of D and σ.
    normals: Extent,
    /// Of the density of visible normals.
    vndf: Extent,
    /// Of S and its luminance.
    reflectance: Extent,
}

impl Layout {
    /// The database has 8 elevations with 128² and 32² knots each; four times as many elevations and knots
    /// of S keep a fit's error below its own.
    fn new(isotropic: bool) -> Layout {
        let square = |size| Extent { width: size, height: size };
        let theta = |count: usize| (0..count).map(|k| k as f32 / (count - 1) as f32 * FRAC_PI_2).collect();
        if isotropic {
            let normals = Extent { width: 256, height: 2 };
            Layout { phi: vec![0.0], theta: theta(32), normals, vndf: square(128), reflectance: square(64) }
        } else {
            let phi = (0..25).map(|k| (k as f32 / 24.0 * 2.0 - 1.0) * PI).collect();
            let normals = Extent { width: 256, height: 65 };
            Layout { phi, theta: theta(16), normals, vndf: square(96), reflectance: square(48) }
        }
    }
}

/// Where f of the last elevation is taken, as 90° shows nothing.
const LAST_COS: f32 = 2e-3;
/// Steps of the power iteration; the paper finds that four are enough.
const ITERATIONS: usize = 8;
/// Share of a cosine distribution in D: f is S times D and would be lost where D vanishes.
const DIFFUSE_SHARE: f32 = 1e-3;

/// How a file stores colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Colours {
    /// Linear sRGB (`rgb`), which RGB renderers read.
    #[default]
    Rgb,
    /// Spectra (`spectra` and `wavelengths`), made by [`primaries`], which spectral renderers read.
    Spectra,
}

/// Writes `brdf` as a `.bsdf` file. `isotropic` says whether only the difference of the
/// azimuths counts; the file is then a hundredth as long. `description` is a line for people.
///
/// f comes back interpolated between tables: of an isotropic material for 32 elevations of the view, of
/// an anisotropic one for 16 and 24 azimuths.
///
/// # Errors
/// [`Error::Write`] when the operating system refuses.
pub fn write_rgl(
    path: impl AsRef<Path>,
    brdf: &dyn Brdf,
    isotropic: bool,
    colours: Colours,
    description: &str,
) -> Result<(), Error> {
    file::write(path.as_ref(), &rgl_bytes(brdf, isotropic, colours, description))
}

/// The bytes that [`write_rgl`] writes.
#[must_use]
pub fn rgl_bytes(brdf: &dyn Brdf, isotropic: bool, colours: Colours, description: &str) -> Vec<u8> {
    to_file(brdf, &Layout::new(isotropic), colours, description).to_bytes()
}

impl Colours {
    /// The wavelengths of the planes, where they have any, and the weights of red, green and blue in each plane.
    fn planes(self) -> (Option<Vec<f32>>, Vec<Vec3>) {
        match self {
            Colours::Rgb => (None, vec![Vec3::X, Vec3::Y, Vec3::Z]),
            Colours::Spectra => {
                let nodes = primaries::nodes();
                let wavelengths = nodes.iter().map(|node| node.wavelength).collect();
                (Some(wavelengths), nodes.iter().map(|node| node.weights).collect())
            }
        }
    }
}

fn to_file(brdf: &dyn Brdf, layout: &Layout, colours: Colours, description: &str) -> TensorFile<'static> {
    let Layout { phi, theta, normals, vndf: vndf_extent, reflectance } = layout;
    let (ndf, sigma) = normal_distribution(brdf, *normals);
    let tables = Normals { ndf: Grid::new(*normals, ndf.clone()), sigma: Grid::new(*normals, sigma.clone()) };

    let (wavelengths, weights) = colours.planes();
    let (mut vndf, mut luminance, mut planes) = (Vec::new(), Vec::new(), Vec::new());
    for (&phi, &theta) in phi.iter().flat_map(|phi| theta.iter().map(move |theta| (phi, theta))) {
        let view = direction(theta.min(LAST_COS.acos()), phi);
        // Azimuths count from the view's where the material is isotropic, and that is at 0.
        let visible = visible_normals(&tables, *vndf_extent, view);
        let warp = Warp::new(*vndf_extent, &visible);
        vndf.extend(visible);
        let slice = slice(brdf, &tables, &warp, *reflectance, view, theta);
        luminance.extend(slice.iter().map(|s| s.element_sum() / 3.0));
        for weight in &weights {
            planes.extend(slice.iter().map(|s| s.dot(*weight)));
        }
    }
    let views = [phi.len(), theta.len()];
    let plane = |extent: &Extent| [extent.height, extent.width];
    let shape = |tail: &[usize]| [&views[..], tail].concat();
    let mut file = TensorFile {
        fields: vec![
            Field::from_bytes("description", description.as_bytes()),
            Field::from_f32("phi_i", &[phi.len()], phi),
            Field::from_f32("theta_i", &[theta.len()], theta),
            Field::from_f32("sigma", &plane(normals), &sigma),
            Field::from_f32("ndf", &plane(normals), &ndf),
            Field::from_f32("vndf", &shape(&plane(vndf_extent)), &vndf),
            Field::from_f32("luminance", &shape(&plane(reflectance)), &luminance),
            Field::from_bytes("jacobian", &[1]),
        ],
    };
    let name = if wavelengths.is_some() { "spectra" } else { "rgb" };
    let shape = shape(&[weights.len(), reflectance.height, reflectance.width]);
    file.fields.extend(wavelengths.map(|nm| Field::from_f32("wavelengths", &[nm.len()], &nm)));
    file.fields.push(Field::from_f32(name, &shape, &planes));
    file
}

/// D and σ as a reader interpolates them.
struct Normals {
    ndf: Grid<f32>,
    sigma: Grid<f32>,
}

/// The knots of an extent in the unit square, row by row.
fn knots(extent: Extent) -> impl Iterator<Item = Vec2> {
    (0..extent.knots()).map(move |k| {
        let (x, y) = (k % extent.width, k / extent.width);
        Vec2::new(x as f32 / (extent.width - 1) as f32, y as f32 / (extent.height - 1) as f32)
    })
}

/// The direction that a point of the unit square stands for.
fn direction_at(u: Vec2) -> Vec3 {
    direction(u.x * u.x * FRAC_PI_2, (2.0 * u.y - 1.0) * PI)
}

fn direction(theta: f32, phi: f32) -> Vec3 {
    Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
}

/// The point of the unit square for a direction.
fn square_of(d: Vec3) -> Vec2 {
    let theta = d.truncate().length().atan2(d.z);
    Vec2::new((theta / FRAC_PI_2).sqrt(), d.y.atan2(d.x) / (2.0 * PI) + 0.5)
}

/// D (normalised: ∫ D cosθ = 1) and σ at the knots of `extent`.
fn normal_distribution(brdf: &dyn Brdf, extent: Extent) -> (Vec<f32>, Vec<f32>) {
    let directions: Vec<Vec3> = knots(extent).map(direction_at).collect();
    let grazing: Vec<Vec3> = directions.iter().map(|d| d.with_z(d.z.max(LAST_COS)).normalize()).collect();
    let mut f = vec![Vec3::ZERO; grazing.len()];
    brdf.eval_batch(&grazing, &grazing, &mut f);
    let backscattering: Vec<f32> = f.iter().zip(&grazing).map(|(f, d)| f.element_sum() * d.z).collect();

    let mut sigma = vec![1.0; directions.len()];
    let mut ndf = Vec::new();
    for _ in 0..ITERATIONS {
        ndf = backscattering.iter().zip(&sigma).map(|(f, sigma)| f * sigma).collect();
        normalise(&mut ndf, extent, &directions);
        for (ndf, direction) in ndf.iter_mut().zip(&directions) {
            *ndf = (1.0 - DIFFUSE_SHARE) * *ndf + DIFFUSE_SHARE * 1.5 / PI * direction.z.max(LAST_COS);
        }
        sigma = projected_areas(&ndf, extent, &directions);
    }
    (ndf, sigma)
}

/// Scales D to ∫ D cosθ dω = 1; what is black becomes a cosine distribution.
fn normalise(ndf: &mut [f32], extent: Extent, directions: &[Vec3]) {
    let cells = Cells::new(extent);
    let total: f64 =
        cells.solid_angles().map(|(k, w)| f64::from(ndf[k] * directions[k].z.max(0.0)) * w).sum();
    for (ndf, direction) in ndf.iter_mut().zip(directions) {
        *ndf = if total > 0.0 { (f64::from(*ndf) / total) as f32 } else { 1.5 / PI * direction.z };
    }
}

/// σ(ω) = ∫ D(m) max(ω·m, 0) dm at every knot.
fn projected_areas(ndf: &[f32], extent: Extent, directions: &[Vec3]) -> Vec<f32> {
    let normals: Vec<(Vec3, f64)> = Cells::new(extent)
        .around()
        .map(|(k, d, w)| (d, f64::from(ndf[k]) * w))
        .filter(|(_, weight)| *weight > 0.0)
        .collect();
    let area = |view: Vec3| {
        normals.iter().map(|(m, weight)| f64::from(view.dot(*m).max(0.0)) * weight).sum::<f64>() as f32
    };
    let rows = extent.height;
    if rows > 2 {
        return directions.iter().map(|&view| area(view)).collect();
    }
    // Both rows of an isotropic table are the same.
    let row: Vec<f32> = directions[..extent.width].iter().map(|&view| area(view)).collect();
    [row.clone(), row].concat()
}

/// Quadrature over the knots of a table of normals by the trapezoidal rule in u.
struct Cells {
    extent: Extent,
}

/// Azimuths of the quadrature where the table has none of its own.
const AZIMUTHS: usize = 64;

impl Cells {
    fn new(extent: Extent) -> Cells {
        Cells { extent }
    }

    /// Knots and their solid angles, which sum to 2π. The last row is the first one.
    fn solid_angles(&self) -> impl Iterator<Item = (usize, f64)> {
        let Extent { width, height } = self.extent;
        let turns = (height - 1) as f64;
        (0..width * (height - 1)).map(move |k| {
            let x = k % width;
            let edge = |at: f64| {
                let u = (at / (width - 1) as f64).clamp(0.0, 1.0);
                (u * u * std::f64::consts::FRAC_PI_2).cos()
            };
            let ring = edge(x as f64 - 0.5) - edge(x as f64 + 0.5);
            (k, ring * std::f64::consts::TAU / turns)
        })
    }

    /// The same with directions, all around where the table has one azimuth.
    fn around(&self) -> impl Iterator<Item = (usize, Vec3, f64)> {
        let Extent { width, height } = self.extent;
        let turns = if height > 2 { 1 } else { AZIMUTHS };
        self.solid_angles().flat_map(move |(k, w)| {
            (0..turns).map(move |turn| {
                let u_x = (k % width) as f32 / (width - 1) as f32;
                let row = (k / width) as f32 + (turn as f32 + 0.5) / turns as f32 * f32::from(turns > 1);
                (k, direction_at(Vec2::new(u_x, row / (height - 1) as f32)), w / turns as f64)
            })
        })
    }
}

/// Density of the visible normals of `view` over the unit square, up to a factor.
fn visible_normals(tables: &Normals, extent: Extent, view: Vec3) -> Vec<f32> {
    let density = |u: Vec2| {
        let normal = direction_at(u);
        let jacobian = u.x * normal.truncate().length();
        tables.ndf.eval(u, &Blend::SINGLE) * view.dot(normal).max(0.0) * jacobian
    };
    knots(extent).map(density).collect()
}

/// S at the knots of the warped square for the view of a slice.
fn slice(
    brdf: &dyn Brdf,
    tables: &Normals,
    warp: &Warp,
    extent: Extent,
    view: Vec3,
    theta: f32,
) -> Vec<Vec3> {
    let u_view = square_of(direction(theta, view.y.atan2(view.x)));
    let sigma = tables.sigma.eval(u_view, &Blend::SINGLE);
    let (mut lights, mut scales) = (Vec::new(), Vec::new());
    for knot in knots(extent) {
        let (u_half, _) = warp.sample(knot, &Blend::SINGLE);
        let half = direction_at(u_half);
        let light = 2.0 * view.dot(half) * half - view;
        lights.push(light);
        scales.push(light.z.max(0.0) * 4.0 * sigma / tables.ndf.eval(u_half, &Blend::SINGLE));
    }
    let mut f = vec![Vec3::ZERO; lights.len()];
    brdf.eval_batch(&lights, &vec![view; lights.len()], &mut f);
    f.iter().zip(&scales).map(|(f, &scale)| *f * scale).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rgl::Rgl;
    use glimt_core::microfacet::Microfacet;
    use glimt_core::models::ggx::Ggx;
    use glimt_core::models::tabulated::Table;
    use glimt_core::sampling::DirectionSampler;

    fn ggx(alpha: [f32; 2]) -> Ggx {
        Ggx::new(Microfacet { kd: [0.3, 0.1, 0.02], eta: [1.6; 3], alpha }).unwrap()
    }

    fn written(brdf: &dyn Brdf, isotropic: bool) -> Rgl {
        let file = to_file(brdf, &Layout::new(isotropic), Colours::Rgb, "test");
        Rgl::from_bytes(Path::new("test.bsdf"), &file.to_bytes()).unwrap()
    }

    /// Σ |f − g| cosθ over Σ f cosθ, lights drawn by the file's own sampler.
    fn mean_error(brdf: &dyn Brdf, file: &Rgl) -> f64 {
        let (mut error, mut sum) = (0.0, 0.0);
        for i in 0..20_000 {
            let u = |step: f64| (f64::from(i) * step).fract() as f32;
            let view = direction(1.45 * u(0.856_674_883_8), 2.0 * PI * u(0.733_891_856_6));
            let u = Vec3::new(0.0, u(0.628_706_721_0), u(0.538_596_726_1));
            let Some((light, pdf)) = file.sample_direction(view, u) else { continue };
            let (f, g) = (brdf.eval(light, view), file.eval(light, view));
            let weight = f64::from(light.z / pdf);
            error += f64::from((f - g).abs().element_sum()) * weight;
            sum += f64::from(f.element_sum()) * weight;
        }
        error / sum
    }

    #[test]
    fn an_isotropic_brdf_comes_back() {
        for alpha in [0.05, 0.2, 0.6] {
            let brdf = ggx([alpha; 2]);
            let file = written(&brdf, true);
            assert!(file.is_isotropic() && file.oddities().is_empty());
            let error = mean_error(&brdf, &file);
            println!("alpha {alpha}: {error:.2e}");
            assert!(error < 0.02, "alpha {alpha}: {error}");
        }
    }

    #[test]
    fn an_anisotropic_brdf_comes_back() {
        let brdf = ggx([0.15, 0.4]);
        let file = written(&brdf, false);
        assert!(!file.is_isotropic());
        let error = mean_error(&brdf, &file);
        println!("{error:.2e}");
        assert!(error < 0.05, "{error}");
    }

    #[test]
    fn spectra_are_read_as_spectra_and_have_the_colours() {
        let brdf = ggx([0.3; 2]);
        let file = to_file(&brdf, &Layout::new(true), Colours::Spectra, "test");
        let count = file.get("wavelengths").unwrap().shape[0];
        assert_eq!(file.get("spectra").unwrap().shape, [1, 32, count, 64, 64]);
        assert!(file.get("rgb").is_none());
        let spectral = Rgl::from_bytes(Path::new("test.bsdf"), &file.to_bytes()).unwrap();
        assert!(spectral.oddities().is_empty());
        let rgb = written(&brdf, true);
        for k in 0..1000 {
            let u = |step: f32| (k as f32 * step).fract();
            let (light, view) =
                (direction(1.4 * u(0.754_877_7), 6.0 * u(0.3)), direction(1.4 * u(0.569_840_3), 1.0));
            let (f, expected) = (spectral.eval(light, view), rgb.eval(light, view));
            // The observer of the reader is a fit to that of the primaries.
            assert!((f - expected).abs().max_element() < 0.01 * expected.max_element(), "{f} for {expected}");
        }
    }

    #[test]
    fn what_is_black_makes_a_valid_file() {
        struct Black;
        impl Brdf for Black {
            fn eval(&self, _: Vec3, _: Vec3) -> Vec3 {
                Vec3::ZERO
            }
        }
        assert_eq!(written(&Black, true).eval(Vec3::Z, Vec3::Z), Vec3::ZERO);
    }

    #[test]
    fn the_distribution_of_normals_is_that_of_ggx() {
        let brdf = Ggx::new(Microfacet { kd: [0.0; 3], eta: [1.5; 3], alpha: [0.3; 2] }).unwrap();
        let extent = Layout::new(true).normals;
        let (ndf, sigma) = normal_distribution(&brdf, extent);
        assert!((sigma[0] - 1.0).abs() < 0.01, "{}", sigma[0]);
        for x in [0, 40, 100, 160] {
            let cos = direction_at(knots(extent).nth(x).unwrap()).z;
            let alpha2 = 0.09_f32;
            let expected = alpha2 / (PI * (cos * cos * (alpha2 - 1.0) + 1.0).powi(2));
            assert!((ndf[x] / expected - 1.0).abs() < 0.1, "{x}: {} for {expected}", ndf[x]);
        }
    }
}
