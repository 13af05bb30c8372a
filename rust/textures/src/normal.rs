//! Normals as texels, vectors and slopes.

/// The steepest slope that is kept, 86°: quotients of small numbers of 8 bits say nothing beyond.
pub(crate) const STEEPEST: f32 = 16.0;

/// What the channels of a texel stand for.
pub(crate) fn vector_of(color: [f32; 3]) -> [f32; 3] {
    color.map(|x| 2.0 * x - 1.0)
}

pub(crate) fn length([x, y, z]: [f32; 3]) -> f32 {
    (x * x + y * y + z * z).sqrt()
}

/// n_x/n_z and n_y/n_z, at most as steep as [`STEEPEST`].
pub(crate) fn slope_of(vector: [f32; 3]) -> [f32; 2] {
    let z = vector[2].max(length(vector) / STEEPEST);
    [vector[0] / z, vector[1] / z]
}

pub(crate) fn bounded(slope: f32) -> f32 {
    // 0/0 of a vector of no length.
    if slope.is_nan() { 0.0 } else { slope.clamp(-STEEPEST, STEEPEST) }
}

/// The unit vector of a slope.
pub(crate) fn normal_of([x, y]: [f32; 2]) -> [f32; 3] {
    let length = (1.0 + f64::from(x) * f64::from(x) + f64::from(y) * f64::from(y)).sqrt();
    [(f64::from(x) / length) as f32, (f64::from(y) / length) as f32, (1.0 / length) as f32]
}

/// Averaged normals are shorter than 1: those of ambientCG's Wood047 are 0.84 in the mean.
pub(crate) fn is_no_normal(vector: [f32; 3]) -> bool {
    !(0.3..1.5).contains(&length(vector)) || vector[2] <= 0.0
}
