//! In how many bits the numbers of texels are kept in files.

use half::f16;
use serde::{Deserialize, Serialize};

/// How numbers of texels are kept in files. At run time all are float32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// float32.
    #[default]
    F32,
    /// float16.
    F16,
    /// 256 steps from the least number of a channel to the greatest.
    U8,
}

impl Precision {
    /// Every one.
    pub const ALL: [Precision; 3] = [Precision::F32, Precision::F16, Precision::U8];

    /// What is read from a file to which these rows are written.
    #[must_use]
    pub fn rounded<const C: usize>(self, rows: &[[f32; C]]) -> Vec<[f32; C]> {
        match self {
            Precision::F32 => rows.to_vec(),
            Precision::F16 => rows.iter().map(|row| row.map(|x| f16::from_f32(x).to_f32())).collect(),
            Precision::U8 => {
                let range = Precision::range(rows);
                rows.iter().map(|row| range.decode(&range.encode(row))).collect()
            }
        }
    }

    /// What the channels of these rows range over; nothing where there are none.
    #[must_use]
    pub fn range<const C: usize>(rows: &[[f32; C]]) -> Range<C> {
        let first = rows.first().copied().unwrap_or([0.0; C]);
        let mut range = Range { least: first, greatest: first };
        for row in rows {
            for c in 0..C {
                range.least[c] = range.least[c].min(row[c]);
                range.greatest[c] = range.greatest[c].max(row[c]);
            }
        }
        range
    }
}

/// What 8 bits stand for in each channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range<const C: usize> {
    /// 0.
    pub least: [f32; C],
    /// 255.
    pub greatest: [f32; C],
}

impl<const C: usize> Range<C> {
    /// The nearest steps.
    #[must_use]
    pub fn encode(&self, row: &[f32; C]) -> [u8; C] {
        std::array::from_fn(|c| {
            let extent = self.greatest[c] - self.least[c];
            if extent > 0.0 { (255.0 * ((row[c] - self.least[c]) / extent)).round() as u8 } else { 0 }
        })
    }

    /// The numbers of steps. Both ends are exact, so that encoding again yields the same range.
    #[must_use]
    pub fn decode(&self, row: &[u8; C]) -> [f32; C] {
        std::array::from_fn(|c| {
            let t = f32::from(row[c]) / 255.0;
            self.least[c] * (1.0 - t) + self.greatest[c] * t
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_rounded_once_stays_to_the_bit() {
        let rows: Vec<[f32; 2]> = (0..999).map(|i| [(i as f32).sin() * 3.7, 0.1 + 1e-3 * i as f32]).collect();
        for precision in Precision::ALL {
            let once = precision.rounded(&rows);
            assert_eq!(precision.rounded(&once), once, "{precision:?}");
            let steps = if precision == Precision::U8 { 255.0 } else { 1000.0 };
            for (row, rounded) in rows.iter().zip(&once) {
                assert!((row[0] - rounded[0]).abs() <= 7.4 / steps, "{precision:?}");
            }
        }
    }

    #[test]
    fn a_channel_without_extent_is_its_number() {
        assert_eq!(Precision::U8.rounded(&[[0.3], [0.3]]), [[0.3], [0.3]]);
    }
}
