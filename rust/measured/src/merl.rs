//! MERL BRDF database (`.binary`): Matusik, Pfister, Brand & McMillan, *A Data-Driven Reflectance
//! Model*, 2003.
//!
//! Three little-endian int32 (90, 90, 180) and then float64: a plane each for red, green and blue,
//! stored times 1500, 1500/1.15 and 1500/1.66. A plane runs over the bins of Rusinkiewicz' angles,
//! slowest first: √(θ_h/90°) in 90 bins, θ_d in 90 bins of 1°, φ_d in [0°, 180°) in 180 bins of 1°
//! (the other half of φ_d is the same by reciprocity). The values answer for their whole bin in the
//! database's own reader; here they stand at the bins' centres.
//!
//! **Holes.** Bins without data hold −1: those below the horizon, and those that no camera saw. They are filled
//! from their neighbours when the file is read, so that f goes on through a hole and up to the horizon, and
//! [`Brdf::has_data`] says where it did. Other numbers below 0 are noise and taken as 0.

use std::f64::consts::{FRAC_1_PI, FRAC_2_PI, FRAC_PI_2, PI};
use std::ops::{Add, Mul};
use std::path::Path;

use glam::{DVec3, Vec3};
use glimt_core::kernels::Kernel;
use glimt_core::microfacet::MIN_SUM_Z;
use glimt_core::models::tabulated::Table;
use glimt_core::simd::math::angle;
use glimt_core::simd::{Isa, Lanes, Real, Vector};
use glimt_core::{Brdf, Oddity, is_lit};

use crate::error::Error;
use crate::file;
use crate::holes::{self, Axis};

/// Bins of θ_h, θ_d and φ_d.
pub const BINS: [usize; 3] = [90, 90, 180];
/// f is the stored number times this, for red, green and blue.
pub const SCALE: [f64; 3] = [1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0];
/// What stands in a bin that has no data.
const NO_DATA: f64 = -1.0;
/// How far a number may be from that: programs that scale a file back and forth round it.
const NO_DATA_TOLERANCE: f64 = 1e-6;
/// Share of an interpolated value that has to come from bins with data for it to count as measured.
const LEAST_DATA: f32 = 0.5;
const PLANE: usize = BINS[0] * BINS[1] * BINS[2];
const HEADER_SIZE: usize = 12;
/// Bytes of every MERL file.
pub const FILE_SIZE: usize = HEADER_SIZE + 3 * PLANE * 8;

/// How a lookup between bins is answered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interpolation {
    /// The value of the bin, as in the database's own reader: piecewise constant.
    Nearest,
    /// Linear between the centres of the bins in √θ_h, θ_d and φ_d (cyclic).
    #[default]
    Linear,
}

/// A table of the MERL database: isotropic, reciprocal, linear RGB.
#[derive(Clone, Debug)]
pub struct Merl {
    name: String,
    oddities: Vec<Oddity>,
    interpolation: Interpolation,
    /// f per bin, φ_d fastest; holes are filled.
    bins: Vec<Vec3>,
    /// Whether a bin of the file has data.
    has_data: Vec<bool>,
}

impl Merl {
    /// Reads a `.binary` file.
    ///
    /// # Errors
    /// [`Error::Read`], and those of [`Merl::from_bytes`].
    pub fn open(path: impl AsRef<Path>) -> Result<Merl, Error> {
        let path = path.as_ref();
        check_header(path, &file::read_start(path, HEADER_SIZE as u64)?.1)?;
        let (bytes, trailing) = file::read_first(path, FILE_SIZE, SIZE_RULE)?;
        Merl::decode(path, &bytes, trailing)
    }

    /// Decodes the bytes of a `.binary` file; `path` gives the material's name and that in errors.
    ///
    /// # Errors
    /// [`Error::Invalid`] for other dimensions than 90 × 90 × 180, for values that are not finite and for a
    /// table without any data, [`Error::Size`] for a file that is too short.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Merl, Error> {
        check_header(path, bytes)?;
        match bytes.split_at_checked(FILE_SIZE) {
            Some((table, rest)) => Merl::decode(path, table, rest.len()),
            None => Err(Error::size(path, bytes.len(), FILE_SIZE, SIZE_RULE)),
        }
    }

    /// Decodes a header that was checked and the table behind it, after which some bytes are left.
    fn decode(path: &Path, bytes: &[u8], trailing: usize) -> Result<Merl, Error> {
        let Bins { mut f, has_data, negative } = decode_bins(path, &bytes[HEADER_SIZE..])?;
        if !has_data.contains(&true) {
            return Err(Error::invalid(path, "table", "no bin with data", "at least one"));
        }
        let is_above = |bin: usize| lit_centre(bin).is_some();
        let (holes, below_horizon): (Vec<usize>, Vec<usize>) =
            (0..PLANE).filter(|&bin| !has_data[bin]).partition(|&bin| is_above(bin));
        let axis = |axis: usize, is_cyclic| Axis { length: BINS[axis], is_cyclic };
        holes::fill(&mut f, &has_data, [axis(0, false), axis(1, false), axis(2, true)]);
        let oddities = [
            Oddity::NoData { holes: holes.len(), below_horizon: below_horizon.len() },
            Oddity::Negative { what: "f", count: negative },
            Oddity::Trailing { bytes: trailing },
        ];
        Ok(Merl {
            name: file::stem(path),
            oddities: oddities.into_iter().filter(Oddity::is_there).collect(),
            interpolation: Interpolation::default(),
            bins: f,
            has_data,
        })
    }

    /// The same table, answered with another interpolation.
    #[must_use]
    pub fn with_interpolation(self, interpolation: Interpolation) -> Merl {
        Merl { interpolation, ..self }
    }

    /// File name without extension.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// f at a position in units of bins.
    #[inline]
    fn at(&self, position: Vec3) -> Vec3 {
        self.look_up(position, |bin| self.bins[bin])
    }

    /// What the interpolation makes of a value per bin at a position in units of bins.
    #[inline(always)]
    fn look_up<T>(&self, position: Vec3, value: impl Fn(usize) -> T) -> T
    where
        T: Add<Output = T> + Mul<f32, Output = T>,
    {
        match self.interpolation {
            Interpolation::Nearest => value(nearest(position)),
            Interpolation::Linear => linear(position, value),
        }
    }
}

#[inline]
fn bin(theta_half: usize, theta_diff: usize, phi_diff: usize) -> usize {
    (theta_half * BINS[1] + theta_diff) * BINS[2] + phi_diff
}

#[inline]
fn nearest(position: Vec3) -> usize {
    let [theta_half, theta_diff, phi_diff] = position.to_array().map(|x| x as usize);
    bin(theta_half.min(BINS[0] - 1), theta_diff.min(BINS[1] - 1), phi_diff.min(BINS[2] - 1))
}

#[inline(always)]
fn linear<T>(position: Vec3, value: impl Fn(usize) -> T) -> T
where
    T: Add<Output = T> + Mul<f32, Output = T>,
{
    let mix = |a: T, b: T, t: f32| a * (1.0 - t) + b * t;
    let (h0, h1, h) = between(position.x, BINS[0]);
    let (d0, d1, d) = between(position.y, BINS[1]);
    let (p0, p1, p) = between_cyclic(position.z, BINS[2]);
    let along_phi = |h, d| mix(value(bin(h, d, p0)), value(bin(h, d, p1)), p);
    let along_diff = |h| mix(along_phi(h, d0), along_phi(h, d1), d);
    mix(along_diff(h0), along_diff(h1), h)
}

/// The bins of three planes.
#[doc(hidden)]
pub struct Bins {
    /// f, 0 where there is no data.
    pub f: Vec<Vec3>,
    /// Whether all three channels have data.
    pub has_data: Vec<bool>,
    /// How many numbers are negative, the mark of no data apart.
    pub negative: usize,
}

/// The bins of three planes of any length.
#[doc(hidden)]
pub fn decode_bins(path: &Path, planes: &[u8]) -> Result<Bins, Error> {
    let plane = planes.len() / 8 / 3;
    let mut bins = Bins { f: vec![Vec3::ZERO; plane], has_data: vec![true; plane], negative: 0 };
    for (index, value) in file::doubles(path, &planes[..plane * 3 * 8], "table").enumerate() {
        let (channel, bin) = (index / plane, index % plane);
        let value = value?;
        if (value - NO_DATA).abs() <= NO_DATA_TOLERANCE {
            bins.has_data[bin] = false;
            continue;
        }
        bins.negative += usize::from(value < 0.0);
        // A float32 cannot hold every double; room for interpolations, and for weights of samples.
        bins.f[bin][channel] = (value * SCALE[channel]).clamp(0.0, f64::from(f32::MAX) / 64.0) as f32;
    }
    Ok(bins)
}

impl Kernel for Merl {
    #[inline(always)]
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        let mut at = [[0.0; L]; 3];
        for (lanes, coordinate) in at.iter_mut().zip(position(light, view)) {
            coordinate.store(lanes);
        }
        let mut f = [[0.0; L]; 3];
        for lane in 0..L {
            let value = self.at(Vec3::new(at[0][lane], at[1][lane], at[2][lane]));
            for c in 0..3 {
                f[c][lane] = value[c];
            }
        }
        f.map(|channel| Vector::load(isa, &channel))
    }

    #[inline(always)]
    fn eval_one<I: Isa>(&self, _: I, light: Vec3, view: Vec3) -> Vec3 {
        self.at(position(light.to_array(), view.to_array()).into())
    }

    /// Whether at least half of f comes from bins that have data.
    fn has_data(&self, light: Vec3, view: Vec3) -> bool {
        let position = position(light.to_array(), view.to_array()).into();
        self.look_up(position, |bin| f32::from(self.has_data[bin])) >= LEAST_DATA
    }
}

impl Table for Merl {
    fn format(&self) -> &'static str {
        "merl"
    }

    fn grid(&self) -> String {
        let [theta_half, theta_diff, phi_diff] = BINS;
        format!("{theta_half} × {theta_diff} × {phi_diff} bins of θ_h, θ_d and φ_d")
    }

    fn is_isotropic(&self) -> bool {
        true
    }

    fn is_reciprocal(&self) -> bool {
        true
    }

    fn oddities(&self) -> &[Oddity] {
        &self.oddities
    }
}

/// Rusinkiewicz' angles of a pair in units of bins: √(θ_h/90°)·90, θ_d/1°, φ_d/1° in [0, 180].
#[inline(always)]
fn position<F: Real>(light: [F; 3], view: [F; 3]) -> [F; 3] {
    let dot = |a: [F; 3], b: [F; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    // Between opposite directions at the horizon the half vector is the normal rather than nothing.
    let sum = [light[0] + view[0], light[1] + view[1], (light[2] + view[2]).max(light[2].splat(MIN_SUM_Z))];
    let difference = [light[0] - view[0], light[1] - view[1], light[2] - view[2]];
    let length = dot(sum, sum).sqrt();
    let across = (sum[0] * sum[0] + sum[1] * sum[1]).sqrt();
    let theta_half = angle(across, sum[2]);
    let theta_diff = angle(dot(difference, difference).sqrt(), length);

    // The azimuth of the light about the half vector, from the plane of half vector and normal; that
    // plane is y = 0 if the two coincide.
    let zero = length.splat(0.0);
    let is_tilted = zero.lt(across);
    let x = Real::select(is_tilted, sum[0] / across, length.splat(1.0));
    let y = Real::select(is_tilted, sum[1] / across, zero);
    let (sin_half, cos_half) = (across / length, sum[2] / length);
    let along = (light[0] * x + light[1] * y) * cos_half - light[2] * sin_half;
    let beside = light[1] * x - light[0] * y;
    let phi_diff = angle(beside.max(-beside), along.max(-along));
    // The other half of the circle is the same by reciprocity.
    let phi_diff = Real::select((along * beside).lt(zero), -(phi_diff - PI as f32), phi_diff);

    let bins = BINS.map(|bins| bins as f32);
    [
        (theta_half * FRAC_2_PI as f32).sqrt() * bins[0],
        theta_diff * (FRAC_2_PI as f32 * bins[1]),
        phi_diff * (FRAC_1_PI as f32 * bins[2]),
    ]
}

/// The two bins whose centres enclose `x` (the last one alone beyond it) and the weight of the second.
#[inline]
fn between(x: f32, bins: usize) -> (usize, usize, f32) {
    let x = (x - 0.5).clamp(0.0, (bins - 1) as f32);
    let low = (x as usize).min(bins - 2);
    (low, low + 1, x - low as f32)
}

/// The same on a circle.
#[inline]
fn between_cyclic(x: f32, bins: usize) -> (usize, usize, f32) {
    let x = if x < 0.5 { x - 0.5 + bins as f32 } else { x - 0.5 };
    let low = (x as usize).min(bins - 1);
    (low, if low + 1 == bins { 0 } else { low + 1 }, (x - low as f32).clamp(0.0, 1.0))
}

/// Writes `brdf` as a `.binary` file, sampled at the centres of the bins.
///
/// The format knows isotropic and reciprocal materials only: the half vector stays in the plane
/// y = 0, and a bin gets the mean of both orders of light and view. Bins whose centre lies below the
/// horizon hold −1, and so do those for which `brdf` itself has no data.
///
/// # Errors
/// [`Error::Write`] when the operating system refuses.
pub fn write_merl(path: impl AsRef<Path>, brdf: &dyn Brdf) -> Result<(), Error> {
    file::write(path.as_ref(), &to_bytes(brdf))
}

/// The bytes that [`write_merl`] writes.
#[must_use]
pub fn to_bytes(brdf: &dyn Brdf) -> Vec<u8> {
    let mut bytes = vec![0; FILE_SIZE];
    for (word, bins) in bytes.chunks_exact_mut(4).zip(BINS) {
        word.copy_from_slice(&(bins as i32).to_le_bytes());
    }
    for bin in 0..PLANE {
        let value = at_centre(brdf, bin);
        for channel in 0..3 {
            let stored = value.map_or(NO_DATA, |f| f64::from(f[channel]) / SCALE[channel]);
            let at = HEADER_SIZE + (channel * PLANE + bin) * 8;
            bytes[at..at + 8].copy_from_slice(&stored.to_le_bytes());
        }
    }
    bytes
}

/// f at the centre of a bin, if that is above the horizon and `brdf` has data there.
fn at_centre(brdf: &dyn Brdf, bin: usize) -> Option<Vec3> {
    let (light, view) = lit_centre(bin)?;
    let has_data = brdf.has_data(light, view) && brdf.has_data(view, light);
    has_data.then(|| 0.5 * (brdf.eval(light, view) + brdf.eval(view, light)))
}

/// The pair (light, view) at the centre of a bin, if that is above the horizon.
fn lit_centre(bin: usize) -> Option<(Vec3, Vec3)> {
    let centre = |index: usize, bins: usize| (index as f64 + 0.5) / bins as f64;
    let theta_half = centre(bin / (BINS[1] * BINS[2]), BINS[0]).powi(2) * FRAC_PI_2;
    let theta_diff = centre(bin / BINS[2] % BINS[1], BINS[1]) * FRAC_PI_2;
    let phi_diff = centre(bin % BINS[2], BINS[2]) * PI;
    let (light, view) = directions(theta_half, theta_diff, phi_diff);
    is_lit(light, view).then_some((light, view))
}

/// The pair (light, view) with these angles whose half vector has azimuth 0.
fn directions(theta_half: f64, theta_diff: f64, phi_diff: f64) -> (Vec3, Vec3) {
    let half = DVec3::new(theta_half.sin(), 0.0, theta_half.cos());
    let tangent = DVec3::new(theta_half.cos(), 0.0, -theta_half.sin());
    let across = (tangent * phi_diff.cos() + DVec3::Y * phi_diff.sin()) * theta_diff.sin();
    let along = half * theta_diff.cos();
    ((along + across).as_vec3(), (along - across).as_vec3())
}

const SIZE_RULE: &str = "12 bytes of header and 3 x 90 x 90 x 180 float64";

fn check_header(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    if bytes.len() < HEADER_SIZE {
        return Err(Error::size(path, bytes.len(), FILE_SIZE, SIZE_RULE));
    }
    let dimension = |b: &[u8]| i32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let found: Vec<i32> = bytes[..HEADER_SIZE].chunks_exact(4).map(dimension).collect();
    if found != BINS.map(|bins| bins as i32) {
        let found = format!("{found:?}");
        return Err(Error::invalid(path, "MERL dimensions", found, format!("{BINS:?}")));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::sync::LazyLock;

    const PATH: &str = "paint.binary";
    const TAU: f32 = std::f32::consts::TAU;

    /// A diffuse base under GGX of roughness 0.3 with a constant Fresnel term: reciprocal.
    struct Glossy;

    impl Brdf for Glossy {
        fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
            let alpha2 = 0.3_f32.powi(4);
            let half = (light + view).normalize();
            let ndf = alpha2 / (PI as f32 * (half.z * half.z * (alpha2 - 1.0) + 1.0).powi(2));
            let lambda = |z: f32| z + (alpha2 + (1.0 - alpha2) * z * z).sqrt();
            let specular = 0.2 * ndf / (lambda(light.z) * lambda(view.z));
            Vec3::new(0.1, 0.05, 0.02) + specular
        }
    }

    /// An exponential of a smooth function of the directions, as neural BRDFs have it.
    struct Smooth;

    impl Brdf for Smooth {
        fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
            let half = (light + view).normalize();
            let phase = (light - view).y.powi(2);
            (Vec3::new(1.0, 0.5, -0.5) * (4.0 * half.z + phase - 3.0)).map(f32::exp)
        }
    }

    fn written(brdf: &dyn Brdf) -> Merl {
        Merl::from_bytes(Path::new(PATH), &to_bytes(brdf)).unwrap()
    }

    /// f at a position in units of bins.
    fn at(brdf: &dyn Brdf, position: DVec3) -> Vec3 {
        let theta_half = (position.x / 90.0).powi(2) * FRAC_PI_2;
        let (light, view) = directions(theta_half, position.y / 90.0 * FRAC_PI_2, position.z / 180.0 * PI);
        brdf.eval(light, view)
    }

    /// Error bound of trilinear interpolation between bin centres: over the axes, ⅛ of the largest
    /// second derivative in the cell. That is taken from second differences on 27 points of the cell,
    /// with half as much again for what lies between them.
    fn bound(brdf: &dyn Brdf, position: DVec3) -> f32 {
        let cell = (position - 0.5).floor() + 0.5;
        let mut sum = 0.0;
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let curvature = (0..27).map(|k| {
                let point = cell + 0.5 * DVec3::new((k % 3) as f64, (k / 3 % 3) as f64, (k / 9) as f64);
                let step = 0.5 * axis;
                let ends = at(brdf, point + step) + at(brdf, point - step);
                ((ends - 2.0 * at(brdf, point)) / 0.25).abs().max_element()
            });
            sum += curvature.fold(0.0, f32::max) / 8.0;
        }
        1.5 * sum
    }

    fn stays_within_the_bound(brdf: &dyn Brdf) {
        let merl = written(brdf);
        let mut tested = 0;
        for k in 1..8000 {
            let unit = |step: f64| (f64::from(k) * step).fract();
            // Inside the outermost bin centres, beyond which the outermost bin answers.
            let position = DVec3::new(
                1.0 + 88.0 * unit(0.754_877_666),
                1.0 + 88.0 * unit(0.569_840_291),
                180.0 * unit(0.438_579_021),
            );
            let theta_half = (position.x / 90.0).powi(2) * FRAC_PI_2;
            // All bins of the cell have to be above the horizon.
            if theta_half + (position.y + 1.0) / 90.0 * FRAC_PI_2 > 85_f64.to_radians() {
                continue;
            }
            let (light, view) =
                directions(theta_half, position.y / 90.0 * FRAC_PI_2, position.z / 180.0 * PI);
            let (expected, found) = (brdf.eval(light, view), merl.eval(light, view));
            let error = (found - expected).abs().max_element();
            let rounding = 2e-4 * expected.max_element();
            assert!(error <= bound(brdf, position) + rounding, "{position}: {found} for {expected}");
            tested += 1;
        }
        assert!(tested > 2000, "{tested}");
    }

    #[test]
    fn a_written_function_comes_back_within_the_interpolation_error() {
        stays_within_the_bound(&Glossy);
        stays_within_the_bound(&Smooth);
    }

    #[test]
    fn the_bins_centres_come_back_exactly_with_either_interpolation() {
        let linear = written(&Glossy);
        let nearest = linear.clone().with_interpolation(Interpolation::Nearest);
        for bin in (0..PLANE).step_by(977) {
            let Some(expected) = at_centre(&Glossy, bin) else { continue };
            let centre = [bin / 16200, bin / 180 % 90, bin % 180].map(|index| index as f64 + 0.5);
            // The rounding of a position is a fraction of a bin, across which f changes.
            for merl in [&linear, &nearest] {
                let error = (at(merl, centre.into()) - expected).abs().max_element();
                assert!(error <= 1e-3 * expected.max_element(), "{centre:?} {error}");
            }
        }
    }

    #[test]
    fn size_header_and_scale_are_those_of_the_database() {
        struct Constant;
        impl Brdf for Constant {
            fn eval(&self, _: Vec3, _: Vec3) -> Vec3 {
                Vec3::new(0.5, 0.25, 0.125)
            }
        }
        let bytes = to_bytes(&Constant);
        assert_eq!(bytes.len(), 34_992_012);
        assert_eq!(&bytes[..12], [90, 0, 0, 0, 90, 0, 0, 0, 180, 0, 0, 0]);
        for (channel, expected) in [(0, 750.0), (1, 375.0 / 1.15), (2, 187.5 / 1.66)] {
            let start = 12 + channel * 90 * 90 * 180 * 8;
            let stored = f64::from_le_bytes(bytes[start..start + 8].try_into().unwrap());
            assert!((stored - expected).abs() < 1e-9, "{stored}");
        }
        let f = Merl::from_bytes(Path::new(PATH), &bytes).unwrap().eval(Vec3::Z, Vec3::Z);
        assert!((f - Vec3::new(0.5, 0.25, 0.125)).abs().max_element() < 1e-6);
    }

    fn set(bytes: &mut [u8], channel: usize, bin: usize, stored: f64) {
        bytes[HEADER_SIZE + (channel * PLANE + bin) * 8..][..8].copy_from_slice(&stored.to_le_bytes());
    }

    /// A table whose bins hold their own number in red, and less than nothing in blue.
    fn numbered() -> Vec<u8> {
        let mut bytes = to_bytes(&Smooth);
        for bin in 0..PLANE {
            set(&mut bytes, 0, bin, bin as f64 * 1500.0);
            set(&mut bytes, 1, bin, 1.0);
            set(&mut bytes, 2, bin, -0.25);
        }
        bytes
    }

    #[test]
    fn the_square_root_of_theta_half_and_the_differences_number_the_bins() {
        let merl = Merl::from_bytes(Path::new(PATH), &numbered()).unwrap();
        let merl = merl.with_interpolation(Interpolation::Nearest);
        let direction = |theta: f32, phi: f32| {
            let (theta, phi) = (theta.to_radians(), phi.to_radians());
            Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
        };
        let number = |light: Vec3, view: Vec3| merl.eval(light, view).x;
        // Half vector at 23° (√(23/90)·90 = 45.5), light 10.5° further from the normal: φ_d = 0.
        let (near, far) = (direction(12.5, 0.0), direction(33.5, 0.0));
        assert_eq!(number(far, near), ((45 * 90 + 10) * 180) as f32);
        // The same after a rotation about the normal, and with light and view exchanged; there φ_d = 0 may be
        // rounded to a little less, which is the last of its bins.
        assert_eq!(number(direction(33.5, 77.0), direction(12.5, 77.0)) as usize / 180, 45 * 90 + 10);
        assert_eq!(number(near, far) as usize / 180, 45 * 90 + 10);
        // Half vector at the normal: the light's own angles are the differences.
        assert_eq!(number(direction(30.5, 100.5), direction(30.5, 280.5)), (30 * 180 + 100) as f32);
        assert_eq!(number(direction(30.5, 280.5), direction(30.5, 100.5)), (30 * 180 + 100) as f32);
    }

    #[test]
    fn negative_numbers_are_zero_and_counted() {
        let merl = Merl::from_bytes(Path::new(PATH), &numbered()).unwrap();
        let (light, view) = directions(0.1, 0.3, 1.0);
        assert_eq!(merl.eval(light, view).z, 0.0);
        assert_eq!(merl.oddities(), [Oddity::Negative { what: "f", count: PLANE }]);
    }

    const LAMBERT: Vec3 = Vec3::new(0.3, 0.2, 0.1);

    struct Lambert;
    impl Brdf for Lambert {
        fn eval(&self, _: Vec3, _: Vec3) -> Vec3 {
            LAMBERT
        }
    }

    /// Whether a bin is in the holes of [`holed`]: near retroreflection, where the camera hides the lamp, and
    /// where the two are at grazing angles.
    fn is_hole(bin: usize) -> bool {
        let [half, diff, phi] = [bin / 16_200, bin / 180 % 90, bin % 180];
        diff < 4 || (half > 60 && (20..60).contains(&diff) && phi > 120)
    }

    /// The file of a BRDF with holes, of which every third has no data in one channel alone.
    fn holed(brdf: &dyn Brdf) -> Vec<u8> {
        let mut bytes = to_bytes(brdf);
        for bin in (0..PLANE).filter(|&bin| is_hole(bin)) {
            for channel in if bin % 3 == 0 { 1..2 } else { 0..3 } {
                set(&mut bytes, channel, bin, NO_DATA);
            }
        }
        bytes
    }

    #[test]
    fn a_lambertian_file_with_holes_stays_lambertian_up_to_the_horizon() {
        let merl = Merl::from_bytes(Path::new(PATH), &holed(&Lambert)).unwrap();
        for merl in [merl.clone().with_interpolation(Interpolation::Nearest), merl] {
            for k in 0..200_000 {
                let unit = |step: f64| (f64::from(k) * step).fract() as f32;
                let at = |z: f32, phi: f32| {
                    let r = (1.0 - z * z).sqrt();
                    Vec3::new(r * phi.cos(), r * phi.sin(), z)
                };
                // Half of the directions within 2.3° of the horizon.
                let z = |u: f32| if k % 2 == 0 { 0.04 * u + 1e-5 } else { u.max(1e-5) };
                let light = at(z(unit(0.856_674_883)), TAU * unit(0.733_891_856));
                let view = at(z(unit(0.628_706_721)), TAU * unit(0.538_597_253));
                let error = (merl.eval(light, view) / LAMBERT - 1.0).abs().max_element();
                assert!(error < 1e-3, "{light} {view}: {error}");
            }
        }
    }

    #[test]
    fn exports_lose_nothing_at_the_rim() {
        for brdf in [&Glossy as &dyn Brdf, &Lambert] {
            let merl = written(brdf);
            let (mut sum, mut expected) = (0.0, 0.0);
            for (theta, turn) in (0..90).flat_map(|turn| [85.0_f32, 87.0, 89.0, 89.5].map(|t| (t, turn))) {
                let light = Vec3::new(theta.to_radians().sin(), 0.0, theta.to_radians().cos());
                let (sin, cos) = (4.0 * turn as f32).to_radians().sin_cos();
                for view in [20.0_f32, 50.0, 70.0].map(f32::to_radians) {
                    let view = Vec3::new(view.sin() * cos, view.sin() * sin, view.cos());
                    sum += merl.eval(light, view).element_sum();
                    expected += brdf.eval(light, view).element_sum();
                }
            }
            println!("{}", sum / expected);
            assert!((sum / expected - 1.0).abs() < 0.01, "{sum} for {expected}");
        }
    }

    #[test]
    fn holes_are_counted_and_have_no_data_and_are_written_again() {
        let bytes = holed(&Glossy);
        let merl = Merl::from_bytes(Path::new(PATH), &bytes).unwrap();
        let below_horizon = (0..PLANE).filter(|&bin| lit_centre(bin).is_none()).count();
        let holes = (0..PLANE).filter(|&bin| is_hole(bin) && lit_centre(bin).is_some()).count();
        assert_eq!(merl.oddities(), [Oddity::NoData { holes, below_horizon }]);
        for bin in (0..PLANE).step_by(7) {
            let Some((light, view)) = lit_centre(bin) else { continue };
            assert_eq!(Brdf::has_data(&merl, light, view), !is_hole(bin), "bin {bin}");
        }
        let again = Merl::from_bytes(Path::new(PATH), &to_bytes(&merl)).unwrap();
        assert_eq!(again.has_data, merl.has_data);
    }

    #[test]
    fn bytes_after_the_table_are_counted_and_a_table_without_data_is_refused() {
        let mut bytes = to_bytes(&Smooth);
        bytes.extend(b"end");
        let merl = Merl::from_bytes(Path::new(PATH), &bytes).unwrap();
        assert_eq!(merl.oddities()[1..], [Oddity::Trailing { bytes: 3 }]);
        (0..PLANE).for_each(|bin| set(&mut bytes, 1, bin, NO_DATA));
        let message = Merl::from_bytes(Path::new(PATH), &bytes).unwrap_err().to_string();
        assert_eq!(message, "paint.binary: table: found no bin with data, expected at least one");
    }

    #[test]
    fn broken_files_are_named() {
        let error = |bytes: &[u8]| Merl::from_bytes(Path::new(PATH), bytes).unwrap_err().to_string();
        let mut bytes = to_bytes(&Smooth);
        assert_eq!(
            error(&bytes[..1000]),
            "paint.binary: 1000 bytes, expected 34992012 (12 bytes of header and 3 x 90 x 90 x 180 float64)"
        );
        assert!(error(&bytes[..5]).starts_with("paint.binary: 5 bytes, expected 34992012"));
        bytes[12 + 80..12 + 88].copy_from_slice(&f64::NAN.to_le_bytes());
        assert_eq!(error(&bytes), "paint.binary: table: found NaN at index 10, expected finite numbers");
        bytes[8..12].copy_from_slice(&i32::MAX.to_le_bytes());
        assert_eq!(
            error(&bytes),
            "paint.binary: MERL dimensions: found [90, 90, 2147483647], expected [90, 90, 180]"
        );
    }

    static UNIFORM: LazyLock<[Merl; 2]> = LazyLock::new(|| {
        [Interpolation::Nearest, Interpolation::Linear].map(|interpolation| Merl {
            name: String::new(),
            oddities: Vec::new(),
            interpolation,
            bins: vec![Vec3::ONE; PLANE],
            has_data: vec![true; PLANE],
        })
    });

    proptest! {
        #[test]
        fn no_pair_of_directions_panics_or_gives_anything_but_finite_numbers(
            light in prop::array::uniform3(prop::num::f32::ANY),
            view in prop::array::uniform3(prop::num::f32::ANY),
        ) {
            for merl in UNIFORM.iter() {
                let f = merl.eval(light.into(), view.into());
                prop_assert!(f.is_finite() && f.min_element() >= 0.0, "{f}");
            }
        }
    }
}
