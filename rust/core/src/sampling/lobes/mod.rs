//! The sampler that every model shares: a mixture of a cosine lobe and GGX distributions of visible
//! normals, whose shares follow the view. It needs no network, and its density is known exactly.
//!
//! A material has [`GGX_LOBES`] roughnesses for all views. The shares of the lobes stand in a table over
//! views, about as many degrees apart and closer near grazing, and are linear in between. [`Lobes::fit`] chooses both for
//! any BRDF by the variance that they give.

use std::f32::consts::{FRAC_1_PI, PI, TAU};

use glam::Vec3;

use crate::brdf::is_lit;
use crate::directions::elevations;
use crate::microfacet::{Half, Roughness, masking_denominator};

mod fit;

pub use fit::candidates;

/// GGX lobes of a mixture.
pub const GGX_LOBES: usize = 4;
/// Where the cosine lobe stands among the shares, after the GGX lobes.
pub const COSINE: usize = GGX_LOBES;
/// Views at which shares are kept, see [`elevations`].
pub const KNOTS: usize = 16;

/// Probability of each lobe: the GGX lobes, then the cosine lobe. The sum is 1.
pub type Shares = [f32; GGX_LOBES + 1];

/// The light that a GGX distribution reflects by the normals that the view sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibleNormals {
    /// GGX roughness along x and y, as in [`Microfacet`](crate::microfacet::Microfacet).
    pub alpha: [f32; 2],
}

impl VisibleNormals {
    /// Density (sr⁻¹) of `light` given `view`.
    #[must_use]
    pub fn pdf(self, light: Vec3, view: Vec3) -> f32 {
        if is_lit(light, view) { visible_normal_pdf(self.alpha, light, view) } else { 0.0 }
    }

    /// The light direction of two numbers in [0, 1); `None` where it falls below the horizon.
    #[must_use]
    pub fn sample_direction(self, view: Vec3, u: [f32; 2]) -> Option<Vec3> {
        if !is_lit(view, view) || !u.iter().all(|u| u.is_finite()) {
            return None;
        }
        let light = sample_visible_normal(self.alpha, view, u[0], u[1]);
        is_lit(light, view).then_some(light)
    }
}

/// GGX lobes and a cosine lobe, mixed.
#[derive(Clone, Debug, PartialEq)]
pub struct Lobes {
    alpha: [[f32; 2]; GGX_LOBES],
    shares: [Shares; KNOTS],
    densities: Densities,
}

impl Lobes {
    /// The mixture of lobes of these roughnesses (along x and y), with these shares at each view of the table.
    #[must_use]
    pub fn new(alpha: [[f32; 2]; GGX_LOBES], shares: [Shares; KNOTS]) -> Lobes {
        Lobes { alpha, shares, densities: Densities::new(alpha) }
    }

    /// Roughnesses of the GGX lobes.
    #[must_use]
    pub fn alpha(&self) -> &[[f32; 2]; GGX_LOBES] {
        &self.alpha
    }

    /// Shares at the views of the table.
    #[must_use]
    pub fn shares(&self) -> &[Shares; KNOTS] {
        &self.shares
    }

    /// Shares at a view.
    #[inline]
    #[must_use]
    pub fn shares_at(&self, cos_view: f32) -> Shares {
        let place = elevations::place(cos_view) * (KNOTS - 1) as f32;
        let knot = (place as usize).min(KNOTS - 2);
        let t = place - knot as f32;
        let (below, above) = (&self.shares[knot], &self.shares[knot + 1]);
        std::array::from_fn(|i| below[i] + t * (above[i] - below[i]))
    }

    /// Density (sr⁻¹) of `light` given `view`.
    #[must_use]
    pub fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        if is_lit(light, view) { self.pdf_lit(light, view, &self.shares_at(view.z)) } else { 0.0 }
    }

    /// [`Lobes::pdf`] where both directions are known to be above the horizon.
    #[inline]
    fn pdf_lit(&self, light: Vec3, view: Vec3, shares: &Shares) -> f32 {
        let densities = self.densities.at(light, view);
        let specular: f32 = shares.iter().zip(densities).map(|(share, density)| share * density).sum();
        let pdf = specular + shares[COSINE] * light.z * FRAC_1_PI;
        // At the horizon it can be less than float32 holds, and must not be 0 where f is not.
        pdf.max(f32::MIN_POSITIVE)
    }

    /// Chooses a light direction, and says its density; `None` where it falls below the horizon.
    /// Arguments as in [`SampleBrdf::sample`](crate::SampleBrdf::sample).
    #[must_use]
    pub fn sample_direction(&self, view: Vec3, u: Vec3) -> Option<(Vec3, f32)> {
        if !is_lit(view, view) || !u.is_finite() {
            return None;
        }
        let shares = self.shares_at(view.z);
        let light = match choose(&shares, u.x) {
            COSINE => sample_cosine(u.y, u.z),
            lobe => sample_visible_normal(self.alpha[lobe], view, u.y, u.z),
        };
        is_lit(light, view).then(|| (light, self.pdf_lit(light, view, &shares)))
    }
}

/// The lobe that a number in [0, 1) selects.
#[inline]
fn choose(shares: &Shares, u: f32) -> usize {
    let mut below = 0.0;
    for (lobe, share) in shares.iter().enumerate() {
        below += share;
        if u < below {
            return lobe;
        }
    }
    COSINE
}

/// A number of each GGX lobe.
type Row = [f32; GGX_LOBES];

/// What the densities of the GGX lobes need of their roughnesses, side by side: four lobes are one vector.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Densities {
    /// α² along x and y.
    square: [Row; 2],
    /// 1/α² along x and y.
    inverse_square: [Row; 2],
    /// 1/(2π α_x α_y).
    scale: Row,
}

impl Densities {
    fn new(alpha: [[f32; 2]; GGX_LOBES]) -> Densities {
        Densities {
            square: [alpha.map(|[x, _]| x * x), alpha.map(|[_, y]| y * y)],
            inverse_square: [alpha.map(|[x, _]| 1.0 / (x * x)), alpha.map(|[_, y]| 1.0 / (y * y))],
            scale: alpha.map(|[x, y]| 1.0 / (2.0 * PI * x * y)),
        }
    }

    /// Density of each lobe, [`visible_normal_pdf`].
    #[inline]
    fn at(&self, light: Vec3, view: Vec3) -> Row {
        let half = Half::new(<[f32; 3]>::from(light), view.into());
        let view_squared = view * view;
        std::array::from_fn(|i| {
            let slope = half.tangential[0] * self.inverse_square[0][i]
                + half.tangential[1] * self.inverse_square[1][i];
            let r = half.length_squared / (slope + half.height).max(f32::MIN_POSITIVE);
            let stretched = view_squared.x * self.square[0][i] + view_squared.y * self.square[1][i];
            let masking = view.z + (view_squared.z + stretched).sqrt();
            r * r * self.scale[i] / masking.max(f32::MIN_POSITIVE)
        })
    }
}

/// Cosine-distributed direction, by the polar map.
pub(crate) fn sample_cosine(u1: f32, u2: f32) -> Vec3 {
    let (r, phi) = (u1.sqrt(), TAU * u2);
    Vec3::new(r * phi.cos(), r * phi.sin(), (1.0 - u1).max(0.0).sqrt())
}

/// Light reflected by a visible normal of the GGX distribution.
///
/// Sampling by spherical caps, Dupuy & Benyoub 2023, *Sampling Visible GGX Normals with Spherical
/// Caps*, algorithm 3.
pub(crate) fn sample_visible_normal(alpha: [f32; 2], view: Vec3, u1: f32, u2: f32) -> Vec3 {
    let stretch = Vec3::new(alpha[0], alpha[1], 1.0);
    let standard_view = (view * stretch).normalize();
    // The cap's z is uniform on [−v_z, 1]. Only z + v_z and 1 − z² are needed, and written as here
    // they have no difference that cancels: at grazing views, or near either end of the range.
    let (x, y) = (standard_view.x, standard_view.y);
    let above = 1.0 + standard_view.z;
    let height = (1.0 - u2) * above;
    let r = (u2 * (x * x + y * y + above * height)).max(0.0).sqrt();
    let phi = TAU * u1;
    let sum = Vec3::new(r * phi.cos() + x, r * phi.sin() + y, height);
    let half = (sum * stretch).normalize();
    2.0 * view.dot(half) * half - view
}

/// Density of [`sample_visible_normal`]: D_v(h)/(4 cosθ_d) = G₁(v) D(h) / (4 cosθ_v).
pub(crate) fn visible_normal_pdf(alpha: [f32; 2], light: Vec3, view: Vec3) -> f32 {
    let view: [f32; 3] = view.into();
    0.5 * Half::new(light.into(), view).ndf(&Roughness::new(alpha)) / masking_denominator(view, alpha)
}

/// The same sampler in float64, written as the papers print it. What tests compare against.
pub mod reference {
    use super::{COSINE, KNOTS, Lobes};
    use crate::microfacet::reference::{g1, ndf};
    use glam::{DVec2, DVec3};
    use std::f64::consts::{PI, TAU};

    /// Shares at a view.
    #[must_use]
    pub fn shares(lobes: &Lobes, cos_view: f64) -> [f64; COSINE + 1] {
        let cos = cos_view.min(1.0);
        let place = (1.0 + cos.sqrt() - (1.0 - cos).sqrt()) * 0.5 * (KNOTS - 1) as f64;
        let knot = (place.floor() as usize).min(KNOTS - 2);
        let t = place - knot as f64;
        std::array::from_fn(|i| {
            let [below, above] = [knot, knot + 1].map(|knot| f64::from(lobes.shares[knot][i]));
            (1.0 - t) * below + t * above
        })
    }

    /// Density of `light`, both directions above the horizon.
    #[must_use]
    pub fn pdf(lobes: &Lobes, light: DVec3, view: DVec3) -> f64 {
        let shares = shares(lobes, view.z);
        let half = (light + view).normalize();
        let specular = lobes.alpha.iter().zip(&shares).map(|(alpha, share)| {
            let alpha = alpha.map(f64::from);
            share * g1(view.into(), alpha) * ndf(half.into(), alpha) / (4.0 * view.z)
        });
        specular.sum::<f64>() + shares[COSINE] * light.z / PI
    }

    /// The direction that [`Lobes::sample_direction`] chooses within `lobe`, also where it is below the horizon.
    #[must_use]
    pub fn sample_direction(lobes: &Lobes, lobe: usize, view: DVec3, u: [f64; 2]) -> DVec3 {
        if lobe == COSINE {
            return (u[0].sqrt() * DVec2::from_angle(TAU * u[1])).extend((1.0 - u[0]).sqrt());
        }
        let stretch = DVec2::from_array(lobes.alpha[lobe].map(f64::from)).extend(1.0);
        let standard_view = (view * stretch).normalize();
        let z = (1.0 - u[1]) * (1.0 + standard_view.z) - standard_view.z;
        let cap = ((1.0 - z * z).sqrt() * DVec2::from_angle(TAU * u[0])).extend(z);
        let half = ((cap + standard_view) * stretch).normalize();
        2.0 * view.dot(half) * half - view
    }
}

#[cfg(test)]
mod tests;
