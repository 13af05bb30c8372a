//! The model in float64 by its definition. What tests compare against.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DMat3, DVec3};

use super::{AZIMUTH_BINS, DIFF_BINS, Factor, Factors, HALF_BINS, Interpolation, MIN_COS, Product};
use crate::models::factor::smith;

/// √θ_h, θ_d and φ_d in units of bins, by Rusinkiewicz' rotations.
#[must_use]
pub fn position(light: DVec3, view: DVec3) -> [f64; 3] {
    let half = (light + view).normalize();
    let (theta_h, phi_h) = (half.truncate().length().atan2(half.z), half.y.atan2(half.x));
    let d = DMat3::from_rotation_y(-theta_h) * (DMat3::from_rotation_z(-phi_h) * light);
    let theta_d = (light - view).length().atan2((light + view).length());
    let phi_d = d.y.atan2(d.x).rem_euclid(PI);
    [
        (theta_h / FRAC_PI_2).sqrt() * HALF_BINS as f64,
        theta_d / FRAC_PI_2 * DIFF_BINS as f64,
        phi_d / PI * AZIMUTH_BINS as f64,
    ]
}

/// f for directions above the horizon.
#[must_use]
pub fn eval(material: &Factor, light: DVec3, view: DVec3) -> [f64; 3] {
    let [half, diff, azimuth] = position(light, view);
    let bin = |bins: &[f32], position: f64| match material.interpolation {
        Interpolation::Nearest => f64::from(bins[(position as usize).min(bins.len() - 1)]),
        Interpolation::Linear => knot(&bins.iter().map(|&x| x.into()).collect::<Vec<_>>(), position - 0.5),
    };
    let product = |p: &Product, c: usize, rest: f64| {
        let specular = f64::from(p.specular[c]) * bin(&p.ndf[c], half) * bin(&p.fresnel[c], diff);
        f64::from(p.diffuse[c]) + specular * rest
    };
    let masking = |knots: &[f64], direction: DVec3| {
        let theta = direction.truncate().length().atan2(direction.z).min(89f64.to_radians());
        knot(knots, theta.to_degrees()) / direction.z.max(MIN_COS.into())
    };
    std::array::from_fn(|c| match &*material.factors {
        Factors::IndependentG { product: p, masking: g } => {
            let g = g[c].map(f64::from);
            product(p, c, masking(&g, light) * masking(&g, view))
        }
        Factors::GFromD(p) => {
            let g = smith::masking(&p.ndf[c]);
            product(p, c, masking(&g, light) * masking(&g, view))
        }
        Factors::Naive { product: p, azimuth: h } => {
            product(p, c, h[c][(azimuth as usize).min(AZIMUTH_BINS - 1)].into())
        }
        Factors::Bivariate(table) => {
            let rows: Vec<f32> = (0..HALF_BINS)
                .map(|h| {
                    let row: Vec<f32> = table[h * DIFF_BINS..][..DIFF_BINS].iter().map(|f| f[c]).collect();
                    bin(&row, diff) as f32
                })
                .collect();
            bin(&rows, half)
        }
    })
}

/// Linear between knots at 0, 1, 2 …, the ends beyond them.
fn knot(knots: &[f64], position: f64) -> f64 {
    let position = position.clamp(0.0, (knots.len() - 1) as f64);
    let low = (position as usize).min(knots.len() - 2);
    let t = position - low as f64;
    knots[low] * (1.0 - t) + knots[low + 1] * t
}
