//! How finely the tables of a material are cut.

/// Bins of √θ_h over 0° to 90°.
pub const HALF_BINS: usize = 90;
/// Bins of θ_d over 0° to 90°.
pub const DIFF_BINS: usize = 90;
/// Bins of φ_d over 0° to 180°.
pub const AZIMUTH_BINS: usize = 180;
/// Knots of G: whole degrees from 0° on.
pub const MASKING_KNOTS: usize = 90;
