//! Reflectance spectra to linear sRGB.
//!
//! A spectrum r(λ) becomes the colour that it shows under CIE illuminant D65 to the CIE 1931 2°
//! observer, relative to a perfect white: XYZ = ∫ r·D65·(x̄, ȳ, z̄) dλ, then the sRGB matrix, then each
//! channel over its value for r = 1. D65 is the white of sRGB, so r = 1 is (1, 1, 1) with no chromatic
//! adaptation (an equal-energy integral would need one), and a renderer that multiplies the result by
//! an sRGB light of (1, 1, 1) shows the material's colour in daylight. Mitsuba converts reflectance
//! spectra for its RGB variants with D65 too.
//!
//! Saturated colours lie outside sRGB and give a negative channel; the caller decides about those.

use glam::{DMat3, DVec3, Vec3};

use crate::grid::interval;

/// Range of the integral in nm: where the observer sees anything. Spectra that end earlier continue
/// with their last value.
pub const VISIBLE: (u16, u16) = (360, 830);

/// The linear map from spectra tabulated at `wavelengths` (nm, strictly increasing, not empty) and
/// linear between them to linear sRGB: rgb = Σ weight\[k\] · spectrum\[k\].
#[must_use]
pub fn to_srgb(wavelengths: &[f32]) -> Vec<Vec3> {
    let mut weights = vec![DVec3::ZERO; wavelengths.len()];
    for nm in VISIBLE.0..=VISIBLE.1 {
        let rgb = xyz_to_srgb() * (observer(f64::from(nm)) * d65(f64::from(nm)));
        let (k, t) = interval(wavelengths, f32::from(nm));
        weights[k] += rgb * (1.0 - f64::from(t));
        if let Some(next) = weights.get_mut(k + 1) {
            *next += rgb * f64::from(t);
        }
    }
    let white: DVec3 = weights.iter().sum();
    weights.into_iter().map(|weight| (weight / white).as_vec3()).collect()
}

/// The CIE 1931 2° colour-matching functions at a wavelength in nm: the multi-lobe fit of Wyman,
/// Sloan & Shirley, *Simple Analytic Approximations to the CIE XYZ Color Matching Functions*, 2013. It
/// departs from the tables by up to 0.015, 0.010 and 0.034 (of peaks of 1.06, 1.00 and 1.78), which
/// moves the colour of a smooth reflectance by less than 0.007.
fn observer(nm: f64) -> DVec3 {
    let lobe = |peak: f64, left: f64, right: f64| {
        let t = (nm - peak) / if nm < peak { left } else { right };
        (-0.5 * t * t).exp()
    };
    DVec3::new(
        1.056 * lobe(599.8, 37.9, 31.0) + 0.362 * lobe(442.0, 16.0, 26.7) - 0.065 * lobe(501.1, 20.4, 26.2),
        0.821 * lobe(568.8, 46.9, 40.5) + 0.286 * lobe(530.9, 16.3, 31.1),
        1.217 * lobe(437.0, 11.8, 36.0) + 0.681 * lobe(459.0, 26.0, 13.8),
    )
}

/// XYZ to linear sRGB, IEC 61966-2-1.
fn xyz_to_srgb() -> DMat3 {
    DMat3::from_cols_array_2d(&[
        [3.2406, -0.9689, 0.0557],
        [-1.5372, 1.8758, -0.2040],
        [-0.4986, 0.0415, 1.0570],
    ])
}

/// Relative spectral power of CIE standard illuminant D65 (ISO 11664-2), linear between the
/// tabulated wavelengths as that standard says.
fn d65(nm: f64) -> f64 {
    let position = ((nm - D65_FIRST) / D65_STEP).clamp(0.0, (D65.len() - 1) as f64);
    let index = (position as usize).min(D65.len() - 2);
    let t = position - index as f64;
    D65[index] * (1.0 - t) + D65[index + 1] * t
}

const D65_FIRST: f64 = 360.0;
const D65_STEP: f64 = 10.0;
const D65: [f64; 48] = [
    46.6383, 52.0891, 49.9755, 54.6482, 82.7549, 91.4860, 93.4318, 86.6823, 104.865, 117.008, 117.812,
    114.861, 115.923, 108.811, 109.354, 107.802, 104.790, 107.689, 104.405, 104.046, 100.000, 96.3342,
    95.7880, 88.6856, 90.0062, 89.5991, 87.6987, 83.2886, 83.6992, 80.0268, 80.2146, 82.2778, 78.2842,
    69.7213, 71.6091, 74.3490, 61.6040, 69.8856, 75.0870, 63.5927, 46.4182, 66.8054, 63.3828, 64.3040,
    59.4519, 51.9590, 57.4406, 60.3125,
];

#[cfg(test)]
mod tests {
    use super::*;

    fn wavelengths() -> Vec<f32> {
        (0..195).map(|k| 360.0 + k as f32 * 640.0 / 194.0).collect()
    }

    fn rgb(wavelengths: &[f32], spectrum: impl Fn(f32) -> f32) -> Vec3 {
        let weights = to_srgb(wavelengths);
        wavelengths.iter().zip(weights).map(|(&nm, weight)| weight * spectrum(nm)).sum()
    }

    #[test]
    fn a_perfect_white_is_one() {
        for wavelengths in [wavelengths(), vec![400.0, 550.0, 700.0], vec![550.0]] {
            let white = rgb(&wavelengths, |_| 1.0);
            assert!((white - 1.0).abs().max_element() < 1e-5, "{white}");
        }
    }

    #[test]
    fn the_white_point_is_that_of_d65() {
        let mut xyz = DVec3::ZERO;
        for nm in VISIBLE.0..=VISIBLE.1 {
            xyz += observer(f64::from(nm)) * d65(f64::from(nm));
        }
        // Chromaticity of D65, CIE 15; the tolerance is the error of the observer's fit.
        let chromaticity = xyz / xyz.element_sum();
        assert!((chromaticity.x - 0.3127).abs() < 1.5e-3, "{chromaticity}");
        assert!((chromaticity.y - 0.3290).abs() < 1.5e-3, "{chromaticity}");
    }

    #[test]
    fn step_spectra_have_the_colours_of_their_names() {
        let wavelengths = wavelengths();
        let band =
            |from: f32, to: f32| rgb(&wavelengths, |nm| if (from..to).contains(&nm) { 1.0 } else { 0.0 });
        let (blue, green, red) = (band(360.0, 490.0), band(490.0, 580.0), band(580.0, 1001.0));
        assert_eq!((blue.max_position(), green.max_position(), red.max_position()), (2, 1, 0));
        assert!((blue + green + red - 1.0).abs().max_element() < 1e-5);
    }

    #[test]
    fn a_reflectance_has_the_colour_that_mitsuba_gives_it() {
        // Mitsuba 3.9.1, scalar_rgb: mi.load_dict({"type": "spectrum", "value": [(nm, r), …]}) of the
        // same polyline at every nm, which integrates the CIE tables under D65.
        let mitsuba = Vec3::new(0.510_186, 0.631_013, 0.199_852);
        let (nm, values) = ([360.0, 450.0, 550.0, 650.0, 830.0], [0.1, 0.2, 0.7, 0.4, 0.6]);
        let found: Vec3 = to_srgb(&nm).into_iter().zip(values).map(|(weight, r)| weight * r).sum();
        assert!((found - mitsuba).abs().max_element() < 3e-3, "{found}");
    }
}
