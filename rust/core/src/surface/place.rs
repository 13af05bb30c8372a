//! A place on a surface, and how much of the surface around it one looks at.

use crate::simd::Real;

/// How much of a surface is seen: a Gaussian, whose standard deviations are lengths in uv.
///
/// A pixel whose centre moves by `d` in uv from one to the next sees about `d/2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Footprint {
    /// A point.
    Point,
    /// The same in all directions.
    Isotropic(f32),
    /// Along two axes, which need not be at right angles: what they make of a round Gaussian.
    Axes([[f32; 2]; 2]),
}

/// A place on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Texture coordinates: u to the right, v up; a tile is [0, 1)².
    pub uv: [f32; 2],
    /// How much is seen around it.
    pub footprint: Footprint,
}

impl Place {
    /// A point of the surface.
    #[must_use]
    pub fn point(uv: [f32; 2]) -> Place {
        Place { uv, footprint: Footprint::Point }
    }

    /// The whole of the surface, seen from afar.
    #[must_use]
    pub fn far() -> Place {
        Place { uv: [0.5; 2], footprint: Footprint::Isotropic(f32::INFINITY) }
    }
}

/// A footprint by its principal axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ellipse {
    /// The longer standard deviation.
    pub major: f32,
    /// The shorter one.
    pub minor: f32,
    /// Cosine and sine of twice the angle of the longer one.
    twice: [f32; 2],
}

/// Cosine and sine of an angle in (−π/2, π/2] of those of its double.
#[inline(always)]
pub(crate) fn halved<F: Real>([cos, sin]: [F; 2]) -> [F; 2] {
    // Of the two the larger by its square, the other by the product: no difference of close numbers.
    let is_flat = cos.splat(0.0).lt(cos);
    let larger = ((cos.abs() + 1.0) * 0.5).sqrt();
    let smaller = sin * 0.5 / larger;
    [F::select(is_flat, larger, smaller), F::select(is_flat, smaller, larger)]
}

impl Ellipse {
    /// Of a footprint in units that are `scale` times as many as those of uv. What is no number is no extent.
    pub fn new(footprint: Footprint, scale: [f32; 2]) -> Ellipse {
        let axes = match footprint {
            Footprint::Point => [[0.0; 2]; 2],
            Footprint::Isotropic(sigma) => [[sigma, 0.0], [0.0, sigma]],
            Footprint::Axes(axes) => axes,
        };
        // Beyond this every surface is far away, and squares are still finite.
        const MOST: f32 = 1e9;
        let of = |axis: [f32; 2], i: usize| {
            let extent = axis[i] * scale[i];
            if extent.is_nan() { 0.0 } else { extent.clamp(-MOST, MOST) }
        };
        let [[a, c], [b, d]] = axes.map(|axis| [of(axis, 0), of(axis, 1)]);
        // Σ Σᵀ = [p q; q r], whose eigenvalues are the squares of the standard deviations.
        let (p, q, r) = (a * a + b * b, a * c + b * d, c * c + d * d);
        let (middle, half) = (0.5 * (p + r), 0.5 * (p - r));
        let spread = half.hypot(q);
        let major = (middle + spread).sqrt();
        // The product of the two is |det Σ|, without the difference of close numbers.
        let minor = if major > 0.0 { ((a * d - b * c).abs() / major).min(major) } else { 0.0 };
        let twice = if spread > 0.0 { [half / spread, q / spread] } else { [1.0, 0.0] };
        Ellipse { major, minor, twice }
    }

    /// Direction of the longer axis, of unit length.
    pub fn direction(&self) -> [f32; 2] {
        halved(self.twice)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_round_footprint_is_scaled_by_its_axes() {
        let ellipse = Ellipse::new(Footprint::Isotropic(0.1), [200.0, 100.0]);
        assert!((ellipse.major - 20.0).abs() < 1e-4 && (ellipse.minor - 10.0).abs() < 1e-4);
        assert!(ellipse.direction()[0].abs() > 0.999);
        let point = Ellipse::new(Footprint::Point, [100.0; 2]);
        assert_eq!((point.major, point.minor), (0.0, 0.0));
    }

    #[test]
    fn what_is_no_number_is_no_extent_and_infinity_is_everything() {
        let nothing = Ellipse::new(Footprint::Isotropic(f32::NAN), [100.0; 2]);
        assert_eq!((nothing.major, nothing.minor), (0.0, 0.0));
        let all = Ellipse::new(Footprint::Isotropic(f32::INFINITY), [100.0; 2]);
        assert!(all.minor > 1e8 && all.major.is_finite());
    }

    proptest! {
        #[test]
        fn principal_axes_make_the_same_gaussian(
            axes in prop::array::uniform2(prop::array::uniform2(-1.0..1.0f32))
        ) {
            let ellipse = Ellipse::new(Footprint::Axes(axes), [1.0; 2]);
            let (Ellipse { major, minor, .. }, [x, y]) = (ellipse, ellipse.direction());
            let (m, n) = (major * major, minor * minor);
            let made = [m * x * x + n * y * y, (m - n) * x * y, m * y * y + n * x * x];
            let [a, b] = axes;
            let given = [a[0] * a[0] + b[0] * b[0], a[0] * a[1] + b[0] * b[1], a[1] * a[1] + b[1] * b[1]];
            for (made, given) in made.into_iter().zip(given) {
                prop_assert!((made - given).abs() < 1e-5, "{} {}", made, given);
            }
            prop_assert!(minor <= major);
        }
    }
}
