//! RGL files of every kind, written from functions that are known.

use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;

use glam::{DVec2, DVec3, Vec2};
use glimt_core::models::tabulated::Table;
use glimt_core::{Brdf, Oddity, SampleBrdf, Vec3};
use glimt_measured::grid::{Directions, Extent};
use glimt_measured::spectrum;
use glimt_measured::tensor::{Field, TensorFile};
use glimt_measured::warp::Warp;
use glimt_measured::{Measured, Rgl};

/// Samples a function of the unit square at the knots of an extent, row by row.
fn table(extent: Extent, value: impl Fn(DVec2) -> f64) -> Vec<f32> {
    let knots = (0..extent.knots()).map(|k| (k % extent.width, k / extent.width));
    knots
        .map(|(x, y)| {
            let u = DVec2::new(x as f64 / (extent.width - 1) as f64, y as f64 / (extent.height - 1) as f64);
            value(u) as f32
        })
        .collect()
}

fn square(size: usize) -> Extent {
    Extent { width: size, height: size }
}

/// Half vector and view angles to the unit square, as the paper maps them.
fn unit_square(theta: f64, phi: f64) -> DVec2 {
    let y = phi / (2.0 * PI) + 0.5;
    DVec2::new((theta / FRAC_PI_2).sqrt(), y - y.floor())
}

fn angles(d: DVec3) -> (f64, f64) {
    (d.truncate().length().atan2(d.z), d.y.atan2(d.x))
}

fn direction(theta: f64, phi: f64) -> DVec3 {
    DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
}

/// Tables that are linear in each coordinate, which bilinear interpolation gives back exactly.
mod multilinear {
    use super::*;

    pub fn ndf(u: DVec2) -> f64 {
        (1.0 + u.x) * (2.0 - u.y)
    }

    pub fn sigma(u: DVec2) -> f64 {
        (0.5 + u.x) * (1.0 + 0.2 * u.y)
    }

    pub fn reflectance(phi: f64, theta: f64, channel: f64, u: DVec2) -> f64 {
        (4.0 + phi) * (0.5 + theta) * (1.0 + channel) * (0.3 + u.x) * (1.2 - u.y)
    }
}

struct Layout {
    phi: Vec<f32>,
    theta: Vec<f32>,
    ndf: Extent,
    sigma: Extent,
    vndf: Extent,
    reflectance: Extent,
}

impl Layout {
    fn anisotropic(phi: Vec<f32>) -> Layout {
        Layout {
            phi,
            theta: vec![0.0, 0.3, 0.9, 1.2, FRAC_PI_2 as f32],
            ndf: Extent { width: 40, height: 30 },
            sigma: Extent { width: 10, height: 12 },
            vndf: square(64),
            reflectance: square(48),
        }
    }

    fn isotropic() -> Layout {
        let two_rows = Extent { width: 64, height: 2 };
        let theta = vec![0.0, 0.7, FRAC_PI_2 as f32];
        Layout {
            phi: vec![0.0],
            theta,
            ndf: two_rows,
            sigma: two_rows,
            vndf: square(128),
            reflectance: square(64),
        }
    }

    /// A file of the multilinear tables with a uniform `vndf`: the warp is then the identity.
    /// `wavelengths` makes it spectral, with the wavelength's number as channel.
    fn file(&self, wavelengths: Option<&[f32]>, jacobian: bool) -> TensorFile<'static> {
        let slices: Vec<(f32, f32)> =
            self.phi.iter().flat_map(|&phi| self.theta.iter().map(move |&theta| (phi, theta))).collect();
        let uniform =
            |extent: Extent| (0..slices.len()).flat_map(|_| table(extent, |_| 2.5)).collect::<Vec<f32>>();
        let channels = wavelengths.map_or(3, <[f32]>::len);
        let reflectance: Vec<f32> = slices
            .iter()
            .flat_map(|&(phi, theta)| (0..channels).map(move |channel| (phi, theta, channel)))
            .flat_map(|(phi, theta, channel)| {
                table(self.reflectance, |u| {
                    multilinear::reflectance(phi.into(), theta.into(), channel as f64, u)
                })
            })
            .collect();
        let (n_phi, n_theta) = (self.phi.len(), self.theta.len());
        let conditional = |extent: Extent| [n_phi, n_theta, extent.height, extent.width];
        let plane = |extent: Extent| [extent.height, extent.width];
        let spectra = [n_phi, n_theta, channels, self.reflectance.height, self.reflectance.width];
        let mut fields = vec![
            Field::from_bytes("description", "Prüfmuster".as_bytes()),
            Field::from_f32("phi_i", &[n_phi], &self.phi),
            Field::from_f32("theta_i", &[n_theta], &self.theta),
            Field::from_f32("sigma", &plane(self.sigma), &table(self.sigma, multilinear::sigma)),
            Field::from_f32("ndf", &plane(self.ndf), &table(self.ndf, multilinear::ndf)),
            Field::from_f32("vndf", &conditional(self.vndf), &uniform(self.vndf)),
            Field::from_f32("luminance", &conditional(self.reflectance), &uniform(self.reflectance)),
            Field::from_bytes("jacobian", &[jacobian.into()]),
        ];
        match wavelengths {
            Some(wavelengths) => {
                fields.push(Field::from_f32("wavelengths", &[channels], wavelengths));
                fields.push(Field::from_f32("spectra", &spectra, &reflectance));
            }
            None => fields.push(Field::from_f32("rgb", &spectra, &reflectance)),
        }
        TensorFile { fields }
    }
}

fn read(file: &TensorFile) -> Rgl {
    Rgl::from_bytes(Path::new("dir/sample_rgb.bsdf"), &file.to_bytes()).unwrap()
}

/// Pairs of directions all over the hemispheres, not close to the horizon nor to the tables' seam.
fn pairs() -> impl Iterator<Item = (DVec3, DVec3)> {
    let unit = |k: u32, step: f64| (f64::from(k) * step).fract();
    (1..600).map(move |k| {
        let light = direction(1.5 * unit(k, 0.8567), 2.0 * PI * unit(k, 0.7339));
        let view = direction(1.5 * unit(k, 0.6287), 2.0 * PI * unit(k, 0.5386));
        (light, view)
    })
}

/// f of the multilinear tables for one channel; `view` within the measured azimuths.
fn expected(light: DVec3, view: DVec3, channel: f64, isotropic: bool, jacobian: bool) -> f64 {
    let (theta, phi) = angles(view);
    let (theta_half, phi_half) = angles((light + view).normalize());
    let u = unit_square(theta_half, if isotropic { phi_half - phi } else { phi_half });
    let slice_phi = if isotropic { 0.0 } else { phi };
    let reflectance = multilinear::reflectance(slice_phi, theta, channel, u);
    let scale = multilinear::ndf(u) / (4.0 * multilinear::sigma(unit_square(theta, phi)));
    reflectance * if jacobian { scale } else { 1.0 } / light.z
}

fn agrees(brdf: &Rgl, light: DVec3, view: DVec3, expected: DVec3) {
    let found = brdf.eval(light.as_vec3(), view.as_vec3()).as_dvec3();
    // Float32 rounds angles to 1e-7; near the normal the tables are steep in √θ.
    let error = ((found - expected) / expected).abs().max_element();
    assert!(error < 2e-4, "{light} {view}: {found} for {expected}");
}

fn rgb(value: impl Fn(f64) -> f64) -> DVec3 {
    DVec3::new(value(0.0), value(1.0), value(2.0))
}

fn grid_of_phi(from: f64, to: f64) -> Vec<f32> {
    (0..9).map(|k| (from + (to - from) * f64::from(k) / 8.0) as f32).collect()
}

#[test]
fn an_anisotropic_file_over_the_whole_circle() {
    for jacobian in [true, false] {
        let file = Layout::anisotropic(grid_of_phi(-PI, PI)).file(None, jacobian);
        let brdf = read(&file);
        assert!(!brdf.is_isotropic());
        for (light, view) in pairs() {
            agrees(&brdf, light, view, rgb(|c| expected(light, view, c, false, jacobian)));
        }
    }
}

#[test]
fn an_anisotropic_file_over_the_half_circle_repeats_after_a_half_turn() {
    let brdf = read(&Layout::anisotropic(grid_of_phi(-PI, 0.0)).file(None, true));
    let half_turn = DVec3::new(-1.0, -1.0, 1.0);
    for (light, view) in pairs() {
        let fold = if view.y > 0.0 { half_turn } else { DVec3::ONE };
        agrees(&brdf, light, view, rgb(|c| expected(light * fold, view * fold, c, false, true)));
    }
}

#[test]
fn an_anisotropic_file_over_a_quadrant_is_mirrored() {
    let brdf = read(&Layout::anisotropic(grid_of_phi(-PI, -FRAC_PI_2)).file(None, true));
    for (light, view) in pairs() {
        let fold = DVec3::new(-view.x.signum(), -view.y.signum(), 1.0);
        agrees(&brdf, light, view, rgb(|c| expected(light * fold, view * fold, c, false, true)));
    }
}

#[test]
fn a_spectral_isotropic_file_is_converted_to_srgb() {
    let wavelengths = [400.0, 450.0, 520.0, 580.0, 650.0, 700.0];
    let brdf = read(&Layout::isotropic().file(Some(&wavelengths), true));
    assert!(brdf.is_isotropic());
    let weights = spectrum::to_srgb(&wavelengths);
    for (light, view) in pairs() {
        let channels = weights.iter().enumerate();
        let f = channels
            .map(|(k, weight)| weight.as_dvec3() * expected(light, view, k as f64, true, true))
            .sum::<DVec3>();
        agrees(&brdf, light, view, f.max(DVec3::ZERO));
    }
}

#[test]
fn the_azimuth_of_an_isotropic_file_is_that_between_light_and_view() {
    let brdf = read(&Layout::isotropic().file(None, false));
    for (light, view) in pairs() {
        let f = rgb(|c| expected(light, view, c, true, false));
        for turn in [0.0, 1.0, 2.5, -2.0] {
            let rotate = |d: DVec3| {
                let (theta, phi) = angles(d);
                direction(theta, phi + turn)
            };
            agrees(&brdf, rotate(light), rotate(view), f);
        }
    }
}

#[test]
fn name_and_description_and_negative_values() {
    let mut file = Layout::isotropic().file(None, true);
    assert_eq!((read(&file).name(), read(&file).description()), ("sample", "Prüfmuster"));
    let rgb = file.fields.iter_mut().find(|field| field.name == "rgb").unwrap();
    let negative: Vec<f32> = rgb.data.chunks_exact(4).map(|_| -1.0).collect();
    *rgb = Field::from_f32("rgb", &rgb.shape, &negative);
    let brdf = read(&file);
    assert_eq!(brdf.oddities(), [Oddity::Negative { what: "rgb", count: 3 * 3 * 64 * 64 }]);
    assert_eq!(brdf.eval(Vec3::Z, Vec3::Z), Vec3::ZERO);
}

/// The Beckmann distribution of roughness 0.5.
fn beckmann(theta: f64) -> f64 {
    let alpha2 = 0.25;
    (-theta.tan().powi(2) / alpha2).exp() / (PI * alpha2 * theta.cos().powi(4))
}

const F: f64 = 0.3;

/// An isotropic file of the constant BRDF `F`, parameterized by microfacets: its visible normals are
/// not uniform, so the reflectance table is all in the warp.
fn constant_over_microfacets(size: usize) -> TensorFile<'static> {
    let theta: Vec<f32> = (0..24).map(|k| (f64::from(k) / 23.0 * FRAC_PI_2) as f32).collect();
    let (extent, strip) = (square(size), Extent { width: size, height: 2 });
    // Any positive density will do for the visible normals: half vectors facing the view, and a floor.
    let visible = |theta_view: f32, u: DVec2| {
        let normal = direction(u.x * u.x * FRAC_PI_2, (2.0 * u.y - 1.0) * PI);
        let facing = normal.dot(direction(theta_view.into(), 0.0)).max(0.0);
        (beckmann(angles(normal).0) * facing + 0.1) * (0.2 + u.x)
    };
    let vndf: Vec<f32> = theta.iter().flat_map(|&t| table(extent, |u| visible(t, u))).collect();
    let warp = Warp::new(extent, &vndf);
    let directions = Directions::new(vec![0.0], theta.clone());
    let sigma = 0.8;
    let reflectance: Vec<f32> = theta
        .iter()
        .flat_map(|&theta_view| {
            let blend = directions.blend(0.0, theta_view);
            let view = direction(theta_view.into(), 0.0);
            let table = table(extent, |sample| {
                let (u, _) = warp.sample(Vec2::new(sample.x as f32, sample.y as f32), &blend);
                let theta_half = f64::from(u.x * u.x) * FRAC_PI_2;
                let half = direction(theta_half, (2.0 * f64::from(u.y) - 1.0) * PI);
                let cos_light = (2.0 * half.dot(view) * half - view).z;
                F * cos_light * 4.0 * sigma / beckmann(theta_half).max(1e-9)
            });
            [table.clone(), table.clone(), table].concat()
        })
        .collect();
    let conditional = [1, theta.len(), size, size];
    let ndf = table(strip, |u| beckmann((u.x * u.x * FRAC_PI_2).min(1.56)));
    TensorFile {
        fields: vec![
            Field::from_bytes("description", b"constant"),
            Field::from_f32("phi_i", &[1], &[0.0]),
            Field::from_f32("theta_i", &[theta.len()], &theta),
            Field::from_f32("sigma", &[2, size], &table(strip, |_| sigma)),
            Field::from_f32("ndf", &[2, size], &ndf),
            Field::from_f32("vndf", &conditional, &vndf),
            Field::from_f32("luminance", &conditional, &vec![1.0; vndf.len()]),
            Field::from_bytes("jacobian", &[1]),
            Field::from_f32("rgb", &[1, theta.len(), 3, size, size], &reflectance),
        ],
    }
}

/// Mean relative difference from the constant where both directions are within 45° of the normal.
fn mean_error(size: usize) -> f64 {
    let brdf = read(&constant_over_microfacets(size));
    let near: Vec<_> = pairs().filter(|(light, view)| light.z > 0.7 && view.z > 0.7).collect();
    let error = |&(light, view): &(DVec3, DVec3)| {
        (f64::from(brdf.eval(light.as_vec3(), view.as_vec3()).x) / F - 1.0).abs()
    };
    near.iter().map(error).sum::<f64>() / near.len() as f64
}

#[test]
fn a_constant_brdf_comes_back_through_the_warp_and_closer_with_finer_tables() {
    let (coarse, fine) = (mean_error(48), mean_error(96));
    println!("mean relative error: {coarse:.2e} at 48², {fine:.2e} at 96²");
    assert!(fine < 5e-3 && fine < coarse / 2.0, "{coarse} {fine}");
}

#[test]
fn sampling_follows_the_density_and_the_weight_is_f_cos_over_it() {
    let files = [
        constant_over_microfacets(48),
        Layout::anisotropic(grid_of_phi(-PI, 0.0)).file(None, true),
        Layout::anisotropic(grid_of_phi(-PI, -FRAC_PI_2)).file(None, true),
    ];
    for (brdf, view) in files.iter().map(|file| Measured::Rgl(read(file)).into_material()).flat_map(|brdf| {
        [direction(0.4, 0.7), direction(1.1, -2.0)].map(|view| (brdf.clone(), view.as_vec3()))
    }) {
        // The mean of g·cosθ over samples, and the integral of that times the density.
        let g = |light: Vec3| f64::from(1.0 + light.x + 2.0 * light.y);
        let (n, mut sampled, mut lit) = (160_000, 0.0, 0);
        for k in 0..n {
            let u =
                Vec3::new(0.5, (k as f32 + 0.5) / n as f32, (f64::from(k) * 0.618_033_988).fract() as f32);
            let sample = brdf.sample(view, u);
            if sample.pdf == 0.0 {
                continue;
            }
            let pdf = brdf.pdf(sample.light, view);
            // Near the normal the rounding of the light is a large part of the half vector's elevation.
            let is_steep = (sample.light + view).normalize().truncate().length() < 1e-4;
            assert!(is_steep || (pdf / sample.pdf - 1.0).abs() < 1e-2, "{} {pdf}", sample.pdf);
            let weight = brdf.eval(sample.light, view) * (sample.light.z / sample.pdf);
            assert!((weight - sample.weight).abs().max_element() <= 1e-6 * weight.max_element());
            sampled += g(sample.light) * f64::from(sample.light.z);
            lit += 1;
        }
        // Over half vectors, θ = u²·90°: the density is singular at the mirror direction.
        let (rows, columns) = (400, 400);
        let (mut integral, mut mass) = (0.0, 0.0);
        for cell in 0..rows * columns {
            let u = (f64::from(cell / columns) + 0.5) / f64::from(rows);
            let phi = (f64::from(cell % columns) + 0.5) / f64::from(columns) * 2.0 * PI;
            let theta = u * u * FRAC_PI_2;
            let half = direction(theta, phi);
            let cos_view_half = half.dot(view.as_dvec3());
            let light = (2.0 * cos_view_half * half - view.as_dvec3()).as_vec3();
            if cos_view_half <= 0.0 || light.z <= 0.0 {
                continue;
            }
            let solid_angle = theta.sin() * (PI * u / f64::from(rows)) * (2.0 * PI / f64::from(columns));
            let density = f64::from(brdf.pdf(light, view)) * solid_angle * 4.0 * cos_view_half;
            integral += g(light) * f64::from(light.z) * density;
            mass += density;
        }
        let (found, share) = (sampled / f64::from(n), f64::from(lit) / f64::from(n));
        println!("{view}: {found:.4} {integral:.4}, above the horizon {share:.4} {mass:.4}");
        assert!((found - integral).abs() < 1e-3 && (share - mass).abs() < 1e-3);
    }
}
