//! UTIA BRDF database (`.bin`): Filip & Vávra, *Template-Based Sampling of Anisotropic BRDFs*, 2014.
//!
//! No header: little-endian float64, a plane each for red, green and blue, each a square of
//! 288 × 288. Rows are light directions and columns view directions, both numbered θ-major:
//! θ = 0°, 15° … 75° and φ = 0°, 7.5° … 352.5°.
//!
//! **Scale.** The format does not say what unit the numbers v have, and its public readers differ.
//! Dupuy's `dj_brdf`, with a constant from the database's author, takes f = 100 · sRGB⁻¹(v / 140) in
//! sr⁻¹, which for v below 5.7 is 0.0553 v; ports of the author's sample code return v itself.
//! [`Encoding::Reflectance`] is the former and the default, [`Encoding::Raw`] the latter. Values are
//! decoded before they are interpolated (`dj_brdf` decodes after: the same for v below 5.7).
//!
//! **Interpolation** is linear in the four angles, cyclic in φ. Above 75° it goes on along the last
//! interval, as in all of these, but never below 0.

use std::f32::consts::{FRAC_PI_2, TAU};
use std::ops::Range;
use std::path::Path;

use glam::{DVec3, Vec3};
use glimt_core::models::tabulated::Table;
use glimt_core::{Brdf, Oddity, is_lit};

use crate::error::Error;
use crate::file;

/// Number of elevations, 15° apart from 0°.
pub const THETAS: usize = 6;
/// Number of azimuths, 7.5° apart from 0°.
pub const PHIS: usize = 48;
const DIRECTIONS: usize = THETAS * PHIS;
const PLANE: usize = DIRECTIONS * DIRECTIONS;
/// Bytes of every UTIA file.
pub const FILE_SIZE: usize = 3 * PLANE * 8;
const SIZE_RULE: &str = "3 planes of 288 x 288 float64";
/// Lengths of files that are read: without a header, the length tells the format, and less than one more number
/// can only be something that was appended.
pub const FILE_SIZES: Range<usize> = FILE_SIZE..FILE_SIZE + size_of::<f64>();

const THETA_STEP: f32 = FRAC_PI_2 / 6.0;
const PHI_STEP: f32 = TAU / PHIS as f32;

/// What the numbers of a file mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encoding {
    /// f = 100 · sRGB⁻¹(v / 140) in sr⁻¹.
    #[default]
    Reflectance,
    /// f = v.
    Raw,
}

impl Encoding {
    /// f of a stored number that is not negative.
    fn decode(self, stored: f64) -> f64 {
        match self {
            Encoding::Reflectance => GAIN * srgb_to_linear(stored / RANGE),
            Encoding::Raw => stored,
        }
    }

    /// The number that is stored for f.
    fn encode(self, f: f64) -> f64 {
        match self {
            Encoding::Reflectance => RANGE * linear_to_srgb(f / GAIN),
            Encoding::Raw => f,
        }
    }
}

/// The constants of `dj_brdf` (see the module).
const RANGE: f64 = 140.0;
const GAIN: f64 = 100.0;

/// The sRGB transfer function, IEC 61966-2-1; its power law goes on above 1.
fn srgb_to_linear(x: f64) -> f64 {
    if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

fn linear_to_srgb(x: f64) -> f64 {
    if x <= 0.04045 / 12.92 { x * 12.92 } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// A table of the UTIA database: anisotropic, not exactly reciprocal, RGB.
#[derive(Clone, Debug)]
pub struct Utia {
    name: String,
    oddities: Vec<Oddity>,
    /// f for each pair of directions, view fastest.
    pairs: Vec<Vec3>,
}

impl Utia {
    /// Reads a `.bin` file.
    ///
    /// # Errors
    /// [`Error::Read`], and those of [`Utia::from_bytes`].
    pub fn open(path: impl AsRef<Path>, encoding: Encoding) -> Result<Utia, Error> {
        let path = path.as_ref();
        let (size, bytes) = file::read_start(path, FILE_SIZES.end as u64)?;
        if bytes.len() < FILE_SIZES.end {
            return Utia::from_bytes(path, &bytes, encoding);
        }
        Err(Error::Size {
            path: path.to_owned(),
            found: size,
            expected: FILE_SIZE as u64,
            what: SIZE_RULE.into(),
        })
    }

    /// Decodes the bytes of a `.bin` file; `path` gives the material's name and that in errors.
    ///
    /// # Errors
    /// [`Error::Size`] for a file of another length, [`Error::Invalid`] for values that are not finite.
    pub fn from_bytes(path: &Path, bytes: &[u8], encoding: Encoding) -> Result<Utia, Error> {
        if !FILE_SIZES.contains(&bytes.len()) {
            return Err(Error::size(path, bytes.len(), FILE_SIZE, SIZE_RULE));
        }
        let (table, rest) = bytes.split_at(FILE_SIZE);
        let (pairs, negative) = decode_pairs(path, table, encoding)?;
        let oddities =
            [Oddity::Negative { what: "f", count: negative }, Oddity::Trailing { bytes: rest.len() }];
        let oddities = oddities.into_iter().filter(Oddity::is_there).collect();
        Ok(Utia { name: file::stem(path), oddities, pairs })
    }

    /// File name without extension.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }
}

impl Table for Utia {
    fn format(&self) -> &'static str {
        "utia"
    }

    fn grid(&self) -> String {
        format!("{THETAS} × {PHIS} lights and as many views")
    }

    fn is_isotropic(&self) -> bool {
        false
    }

    fn is_reciprocal(&self) -> bool {
        false
    }

    fn oddities(&self) -> &[Oddity] {
        &self.oddities
    }
}

/// f per pair from three planes of any length, and the number of negative values.
#[doc(hidden)]
pub fn decode_pairs(path: &Path, planes: &[u8], encoding: Encoding) -> Result<(Vec<Vec3>, usize), Error> {
    let plane = planes.len() / 8 / 3;
    let mut pairs = vec![Vec3::ZERO; plane];
    let mut clamped = 0;
    for (index, value) in file::doubles(path, &planes[..plane * 3 * 8], "table").enumerate() {
        let (channel, pair) = (index / plane, index % plane);
        let value = value?;
        clamped += usize::from(value < 0.0);
        let f = encoding.decode(value.max(0.0));
        // Room for the sums of an extrapolation.
        pairs[pair][channel] = f.min(f64::from(f32::MAX) / 64.0) as f32;
    }
    Ok((pairs, clamped))
}

/// The four measured directions around a direction, with their weights (which sum to 1).
struct Stencil {
    directions: [usize; 4],
    weights: [f32; 4],
}

impl Stencil {
    #[inline]
    fn new(direction: Vec3) -> Stencil {
        let theta = direction.truncate().length().atan2(direction.z) / THETA_STEP;
        let row = (theta as usize).min(THETAS - 2);
        let t = theta - row as f32;

        let azimuth = direction.y.atan2(direction.x) / PHI_STEP;
        let phi = if azimuth < 0.0 { azimuth + PHIS as f32 } else { azimuth };
        let low = (phi as usize).min(PHIS - 1);
        let high = if low + 1 == PHIS { 0 } else { low + 1 };
        let s = phi - low as f32;

        let (first, second) = (row * PHIS, (row + 1) * PHIS);
        Stencil {
            directions: [first + low, first + high, second + low, second + high],
            weights: [(1.0 - t) * (1.0 - s), (1.0 - t) * s, t * (1.0 - s), t * s],
        }
    }
}

impl Brdf for Utia {
    #[inline]
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        if !is_lit(light, view) {
            return Vec3::ZERO;
        }
        let (light, view) = (Stencil::new(light), Stencil::new(view));
        let mut f = Vec3::ZERO;
        for (row, light_weight) in light.directions.into_iter().zip(light.weights) {
            let row = &self.pairs[row * DIRECTIONS..(row + 1) * DIRECTIONS];
            for (column, view_weight) in view.directions.into_iter().zip(view.weights) {
                f += row[column] * (light_weight * view_weight);
            }
        }
        f.max(Vec3::ZERO)
    }
}

/// Writes `brdf` as a `.bin` file, sampled at the database's directions.
///
/// # Errors
/// [`Error::Write`] when the operating system refuses.
pub fn write_utia(path: impl AsRef<Path>, brdf: &dyn Brdf, encoding: Encoding) -> Result<(), Error> {
    file::write(path.as_ref(), &to_bytes(brdf, encoding))
}

/// The bytes that [`write_utia`] writes.
#[must_use]
pub fn to_bytes(brdf: &dyn Brdf, encoding: Encoding) -> Vec<u8> {
    let mut bytes = vec![0; FILE_SIZE];
    for pair in 0..PLANE {
        let f = brdf.eval(direction(pair / DIRECTIONS), direction(pair % DIRECTIONS));
        for channel in 0..3 {
            let stored = encoding.encode(f64::from(f[channel]));
            let at = (channel * PLANE + pair) * 8;
            bytes[at..at + 8].copy_from_slice(&stored.to_le_bytes());
        }
    }
    bytes
}

/// Measured direction number `index`.
fn direction(index: usize) -> Vec3 {
    let theta = (15.0 * (index / PHIS) as f64).to_radians();
    let phi = (7.5 * (index % PHIS) as f64).to_radians();
    DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()).as_vec3()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PATH: &str = "cloth.bin";

    /// Smooth and anisotropic: a broad lobe about a tilted thread, over a diffuse base.
    struct Cloth;

    impl Brdf for Cloth {
        fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
            let half = (light + view).normalize();
            let along = half.dot(Vec3::new(0.8, 0.5, 0.33).normalize());
            Vec3::new(0.1, 0.2, 0.05) + Vec3::new(0.3, 0.2, 0.4) * (-2.0 * along * along).exp() * light.z
        }
    }

    fn written(brdf: &dyn Brdf) -> Utia {
        let bytes = to_bytes(brdf, Encoding::default());
        Utia::from_bytes(Path::new(PATH), &bytes, Encoding::default()).unwrap()
    }

    fn at(theta: f64, phi: f64) -> Vec3 {
        DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()).as_vec3()
    }

    /// Angles θ_light, φ_light, θ_view, φ_view in units of the steps.
    fn f(brdf: &dyn Brdf, steps: [f64; 4]) -> Vec3 {
        let [theta_light, phi_light, theta_view, phi_view] = steps;
        let (theta, phi) = (f64::from(THETA_STEP), f64::from(PHI_STEP));
        brdf.eval(at(theta_light * theta, phi_light * phi), at(theta_view * theta, phi_view * phi))
    }

    /// Error bound of linear interpolation in four angles: ⅛ of the largest second derivative in the
    /// cell per axis, from second differences at 81 points of it; half as much again for what lies
    /// between them.
    fn bound(brdf: &dyn Brdf, steps: [f64; 4]) -> f32 {
        let mut sum = 0.0;
        for axis in 0..4 {
            let curvature = (0..81).map(|k| {
                let offset = [k % 3, k / 3 % 3, k / 9 % 3, k / 27].map(|third| 0.5 * f64::from(third));
                let point: [f64; 4] = std::array::from_fn(|i| steps[i].floor() + offset[i]);
                let moved = |by: f64| {
                    let mut point = point;
                    point[axis] += by;
                    f(brdf, point)
                };
                ((moved(0.25) + moved(-0.25) - 2.0 * moved(0.0)) / 0.0625).abs().max_element()
            });
            sum += curvature.fold(0.0, f32::max) / 8.0;
        }
        1.5 * sum
    }

    #[test]
    fn a_written_function_comes_back_within_the_interpolation_error() {
        let utia = written(&Cloth);
        for k in 1..2000 {
            let unit = |step: f64| (f64::from(k) * step).fract();
            let steps = [
                5.0 * unit(0.856_674_883),
                48.0 * unit(0.733_891_856),
                5.0 * unit(0.628_706_721),
                48.0 * unit(0.538_597_253),
            ];
            let error = (f(&utia, steps) - f(&Cloth, steps)).abs().max_element();
            assert!(error <= bound(&Cloth, steps) + 1e-5, "{steps:?} {error}");
        }
    }

    #[test]
    fn measured_directions_come_back_exactly() {
        let utia = written(&Cloth);
        for pair in (0..PLANE).step_by(97) {
            let (light, view) = (direction(pair / DIRECTIONS), direction(pair % DIRECTIONS));
            let error = (utia.eval(light, view) - Cloth.eval(light, view)).abs().max_element();
            assert!(error < 1e-5, "{light} {view} {error}");
        }
    }

    #[test]
    fn rows_are_lights_planes_are_colours_and_140_is_100_per_steradian() {
        let mut bytes = vec![0; 1_990_656];
        // Green, light at 30° and 15°, view at 45° and 352.5°.
        let index = 288 * 288 + (2 * 48 + 2) * 288 + 3 * 48 + 47;
        bytes[index * 8..index * 8 + 8].copy_from_slice(&140.0_f64.to_le_bytes());
        let eval = |encoding| {
            let utia = Utia::from_bytes(Path::new(PATH), &bytes, encoding).unwrap();
            f(&utia, [2.0, 2.0, 3.0, 47.0])
        };
        assert!((eval(Encoding::Reflectance) - Vec3::new(0.0, 100.0, 0.0)).abs().max_element() < 1e-2);
        assert!((eval(Encoding::Raw) - Vec3::new(0.0, 140.0, 0.0)).abs().max_element() < 1e-2);
    }

    #[test]
    fn the_scale_of_small_numbers_is_that_of_dj_brdf() {
        // 100 / (140 · 12.92), and the power law above it.
        assert!((Encoding::Reflectance.decode(1.0) - 0.055_285_3).abs() < 1e-6);
        assert!((Encoding::Reflectance.decode(70.0) - 21.404_1).abs() < 1e-3);
        for f in [0.0, 0.1, 0.313, 0.314, 2.0, 150.0] {
            let back = Encoding::Reflectance.decode(Encoding::Reflectance.encode(f));
            assert!((back - f).abs() <= 1e-4 * f, "{f} {back}");
        }
    }

    #[test]
    fn azimuths_wrap_around_without_a_step() {
        let utia = written(&Cloth);
        let just_below = f(&utia, [2.5, 48.0 - 1e-4, 1.5, 10.2]);
        let just_above = f(&utia, [2.5, 1e-4, 1.5, 10.2]);
        assert!((just_below - just_above).abs().max_element() < 1e-4);
    }

    #[test]
    fn above_75_degrees_it_goes_on_linearly_but_never_below_zero() {
        struct Fading;
        impl Brdf for Fading {
            fn eval(&self, light: Vec3, _: Vec3) -> Vec3 {
                let steps = light.z.acos() / THETA_STEP;
                Vec3::new(1.0 + steps, (5.5 - steps).max(0.0), 1.0)
            }
        }
        let utia = written(&Fading);
        let grazing = f(&utia, [5.9, 0.0, 1.0, 0.0]);
        assert!((grazing - Vec3::new(6.9, 0.0, 1.0)).abs().max_element() < 1e-4, "{grazing}");
        let fading = f(&utia, [5.25, 0.0, 1.0, 0.0]);
        assert!((fading - Vec3::new(6.25, 0.25, 1.0)).abs().max_element() < 1e-4, "{fading}");
        let at_75 = (f(&utia, [5.0 - 1e-5, 0.0, 1.0, 0.0]), f(&utia, [5.0 + 1e-5, 0.0, 1.0, 0.0]));
        assert!((at_75.0 - at_75.1).abs().max_element() < 1e-3);
    }

    #[test]
    fn negative_numbers_are_zero_and_counted_and_so_are_bytes_after_the_table() {
        let mut bytes = to_bytes(&Cloth, Encoding::Raw);
        bytes[..8].copy_from_slice(&(-3.0_f64).to_le_bytes());
        bytes.push(b'\n');
        let utia = Utia::from_bytes(Path::new(PATH), &bytes, Encoding::Raw).unwrap();
        assert_eq!(utia.eval(Vec3::Z, Vec3::Z).x, 0.0);
        assert_eq!(
            utia.oddities(),
            [Oddity::Negative { what: "f", count: 1 }, Oddity::Trailing { bytes: 1 }]
        );
    }

    #[test]
    fn broken_files_are_named() {
        let error =
            |bytes: &[u8]| Utia::from_bytes(Path::new(PATH), bytes, Encoding::Raw).unwrap_err().to_string();
        let mut bytes = to_bytes(&Cloth, Encoding::Raw);
        assert_eq!(
            error(&bytes[1..]),
            "cloth.bin: 1990655 bytes, expected 1990656 (3 planes of 288 x 288 float64)"
        );
        bytes[16..24].copy_from_slice(&f64::INFINITY.to_le_bytes());
        assert_eq!(error(&bytes), "cloth.bin: table: found inf at index 2, expected finite numbers");
    }

    proptest! {
        #[test]
        fn no_pair_of_directions_panics_or_gives_anything_but_finite_numbers(
            light in prop::array::uniform3(prop::num::f32::ANY),
            view in prop::array::uniform3(prop::num::f32::ANY),
            stored in 0.0..f64::MAX,
        ) {
            let f = Encoding::Raw.decode(stored).min(f64::from(f32::MAX) / 64.0) as f32;
            let utia = Utia { name: String::new(), oddities: Vec::new(), pairs: vec![Vec3::splat(f); PLANE] };
            let f = utia.eval(light.into(), view.into());
            prop_assert!(f.is_finite() && f.min_element() >= 0.0, "{f}");
        }
    }
}
