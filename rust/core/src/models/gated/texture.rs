//! Angular textures H and D: matrices, or vectors, over a disk in polar coordinates (§3).

use super::FEATURES;
use crate::error::Invalid;
use crate::simd::{Lanes, Real, Vector};

/// Rings and sectors of a texture. The first ring is the centre, one texel for all sectors; the last is the rim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Disk {
    /// Texels from the centre to the rim.
    pub rings: usize,
    /// Texels around.
    pub sectors: usize,
}

impl Disk {
    /// Texels.
    #[must_use]
    pub fn texels(self) -> usize {
        1 + (self.rings - 1) * self.sectors
    }

    /// At least two rings and one sector.
    ///
    /// # Errors
    /// [`Invalid::Parts`].
    pub fn check(self) -> Result<(), Invalid> {
        const MOST: usize = 1 << 10;
        let Disk { rings, sectors } = self;
        if (2..=MOST).contains(&rings) && (1..=MOST).contains(&sectors) {
            Ok(())
        } else {
            let expected = format!("expected 2 to {MOST} rings and 1 to {MOST} sectors");
            Err(Invalid::Parts(format!(
                "an angular texture has {rings} rings of {sectors} sectors, {expected}"
            )))
        }
    }

    /// The four texels around a place, and how far it is from the first ring to the next and the first sector to the
    /// next: `[ring][sector]`.
    #[inline(always)]
    #[must_use]
    pub fn corners(self, ring: f32, sector: f32) -> ([[usize; 2]; 2], [f32; 2]) {
        let inner = (ring as usize).min(self.rings - 2);
        let first = (sector as usize).min(self.sectors - 1);
        let second = if first + 1 == self.sectors { 0 } else { first + 1 };
        let outer = 1 + inner * self.sectors;
        let inside =
            if inner == 0 { [0, 0] } else { [outer - self.sectors + first, outer - self.sectors + second] };
        ([inside, [outer + first, outer + second]], [ring - inner as f32, sector - first as f32])
    }

    /// Coordinates of a warped radius and an azimuth in turns, in rings and sectors.
    #[inline(always)]
    #[must_use]
    pub fn coordinates<F: Real>(self, radius: F, turn: F) -> [F; 2] {
        [radius * (self.rings - 1) as f32, turn * self.sectors as f32]
    }
}

/// Weights of the corners of [`Disk::corners`].
#[inline(always)]
#[must_use]
pub fn weights([ring, sector]: [f32; 2]) -> [[f32; 2]; 2] {
    [[(1.0 - ring) * (1.0 - sector), (1.0 - ring) * sector], [ring * (1.0 - sector), ring * sector]]
}

/// A texture whose texels are `columns` vectors of [`FEATURES`] numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    disk: Disk,
    columns: usize,
    /// `[texel][column][feature]`.
    numbers: Vec<[f32; FEATURES]>,
}

impl Texture {
    /// Of its numbers, `[texel][column][feature]`.
    ///
    /// # Errors
    /// [`Invalid::Parts`] if there are more or less than the texels have.
    pub fn new(disk: Disk, columns: usize, numbers: Vec<[f32; FEATURES]>) -> Result<Texture, Invalid> {
        disk.check()?;
        let expected = disk.texels() * columns;
        if numbers.len() != expected {
            let found = numbers.len();
            return Err(Invalid::Parts(format!(
                "an angular texture has {found} columns, expected {expected}"
            )));
        }
        Ok(Texture { disk, columns, numbers })
    }

    /// Its rings and sectors.
    #[must_use]
    pub fn disk(&self) -> Disk {
        self.disk
    }

    /// `[texel][column][feature]`.
    #[must_use]
    pub fn numbers(&self) -> &[[f32; FEATURES]] {
        &self.numbers
    }

    /// Σ over columns of a factor times the column, between texels.
    #[inline(always)]
    pub(super) fn fetch<I: Lanes<FEATURES>>(
        &self,
        isa: I,
        place: [f32; 2],
        factors: &[f32],
    ) -> [f32; FEATURES] {
        let (corners, between) = self.disk.corners(place[0], place[1]);
        let weights = weights(between);
        let mut sum = Vector::new(isa, 0.0);
        for ring in 0..2 {
            for sector in 0..2 {
                let texel = &self.numbers[corners[ring][sector] * self.columns..][..self.columns];
                let mut seen = Vector::new(isa, 0.0);
                for (column, &factor) in texel.iter().zip(factors) {
                    seen = Vector::load(isa, column).fma(Vector::new(isa, factor), seen);
                }
                sum = seen.fma(Vector::new(isa, weights[ring][sector]), sum);
            }
        }
        sum.to_array()
    }
}
