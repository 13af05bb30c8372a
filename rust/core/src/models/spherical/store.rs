//! The numbers that features are kept as, in memory and in a file.

use crate::error::Invalid;
use std::fmt;
use std::sync::Arc;

use half::f16;
use serde::{Deserialize, Serialize};

/// How features are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StoreKind {
    /// As float32.
    F32,
    /// As float16.
    F16,
    /// As 8-bit integers times a scale for each feature of each table.
    I8,
    /// As 4-bit integers, likewise.
    I4,
    /// As an index of so many bits, 1 to 12, into a codebook (paper, §3.3).
    Codebook(u8),
}

/// As commands spell it, and people read it.
impl fmt::Display for StoreKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            StoreKind::F32 => f.write_str("f32"),
            StoreKind::F16 => f.write_str("f16"),
            StoreKind::I8 => f.write_str("i8"),
            StoreKind::I4 => f.write_str("i4"),
            StoreKind::Codebook(bits) => write!(f, "{bits}-bit indices into a codebook"),
        }
    }
}

/// Most bits of an index.
pub const MAX_BITS: u8 = 12;

impl StoreKind {
    /// Largest integer of those that are scaled.
    #[must_use]
    pub fn largest(self) -> Option<i8> {
        match self {
            StoreKind::I8 => Some(127),
            StoreKind::I4 => Some(7),
            StoreKind::F32 | StoreKind::F16 | StoreKind::Codebook(_) => None,
        }
    }

    /// Whether the kind exists.
    ///
    /// # Errors
    /// In words, that an index has no such number of bits.
    pub fn validate(self) -> Result<(), Invalid> {
        match self {
            StoreKind::Codebook(bits) if !(1..=MAX_BITS).contains(&bits) => {
                Err(format!("an index has {bits} bits, expected 1 to {MAX_BITS}").into())
            }
            _ => Ok(()),
        }
    }
}

/// Neural reflectance primitives: rows of k features that indices point to.
#[derive(Clone, Debug, PartialEq)]
pub struct Codebook {
    /// [2^b][k].
    pub primitives: Vec<f16>,
}

/// The features of one material's rows.
#[derive(Clone, Debug, PartialEq)]
pub enum Store {
    /// [row][k].
    F32(Vec<f32>),
    /// [row][k].
    F16(Vec<f16>),
    /// 8 or 4 bits.
    Scaled {
        /// [`StoreKind::I8`] or [`StoreKind::I4`].
        kind: StoreKind,
        /// [row][k].
        integers: Vec<i8>,
        /// [table][k].
        scales: Vec<f32>,
    },
    /// Indices.
    Indexed {
        /// Bits of an index.
        bits: u8,
        /// [row].
        indices: Vec<u16>,
        /// What they point to.
        codebook: Arc<Codebook>,
    },
}

impl Store {
    /// Features, [row][k], as nearly as numbers of a `kind` without codebook can keep them; `tables` says
    /// which table each row belongs to.
    ///
    /// # Panics
    /// If `kind` has a codebook.
    #[must_use]
    pub fn new(kind: StoreKind, features: &[f32], k: usize, tables: &[usize]) -> Store {
        match kind {
            StoreKind::F32 => Store::F32(features.to_vec()),
            StoreKind::F16 => Store::F16(features.iter().map(|&x| f16::from_f32(x)).collect()),
            StoreKind::I8 | StoreKind::I4 => {
                Store::scaled(kind, features, scales(kind, features, k, tables), k, tables)
            }
            StoreKind::Codebook(_) => panic!("indices are chosen by the fit"),
        }
    }

    /// Features as a `kind` of integers times scales that are given, [table][k].
    ///
    /// # Panics
    /// If `kind` has no scales.
    #[must_use]
    pub fn scaled(kind: StoreKind, features: &[f32], scales: Vec<f32>, k: usize, tables: &[usize]) -> Store {
        let largest = f32::from(kind.largest().expect("scaled kinds have one"));
        let integer = |(row, features): (usize, &[f32])| {
            let scales = &scales[tables[row] * k..][..k];
            let pairs = features.iter().zip(scales);
            pairs.map(|(x, s)| (x / s).round().clamp(-largest, largest) as i8).collect::<Vec<_>>()
        };
        let integers = features.chunks_exact(k).enumerate().flat_map(integer).collect();
        Store::Scaled { kind, integers, scales }
    }

    /// How the features are kept.
    #[must_use]
    pub fn kind(&self) -> StoreKind {
        match self {
            Store::F32(_) => StoreKind::F32,
            Store::F16(_) => StoreKind::F16,
            Store::Scaled { kind, .. } => *kind,
            Store::Indexed { bits, .. } => StoreKind::Codebook(*bits),
        }
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self, k: usize) -> usize {
        match self {
            Store::F32(features) => features.len() / k,
            Store::F16(features) => features.len() / k,
            Store::Scaled { integers, .. } => integers.len() / k,
            Store::Indexed { indices, .. } => indices.len(),
        }
    }

    /// The features that can be pointed to, [entry][k], and the entry of each row.
    #[must_use]
    pub fn decode(&self, k: usize, tables: &[usize]) -> (Vec<f32>, Vec<u32>) {
        let own = |features: Vec<f32>| {
            let entries = (0..(features.len() / k) as u32).collect();
            (features, entries)
        };
        match self {
            Store::F32(features) => own(features.clone()),
            Store::F16(features) => own(features.iter().map(|x| x.to_f32()).collect()),
            Store::Scaled { integers, scales, .. } => {
                let rows = integers.chunks_exact(k).zip(tables);
                let scale = |(row, &table): (&[i8], &usize)| {
                    let pairs = row.iter().zip(&scales[table * k..][..k]);
                    pairs.map(|(&i, &s)| f32::from(i) * s).collect::<Vec<_>>()
                };
                own(rows.flat_map(scale).collect())
            }
            Store::Indexed { indices, codebook, .. } => (
                codebook.primitives.iter().map(|x| x.to_f32()).collect(),
                indices.iter().map(|&i| i.into()).collect(),
            ),
        }
    }
}

/// For each feature of each table, [table][k], the step in which a `kind` of scaled integers reaches the
/// largest.
#[must_use]
pub fn scales(kind: StoreKind, features: &[f32], k: usize, tables: &[usize]) -> Vec<f32> {
    let largest = f32::from(kind.largest().unwrap_or(1));
    let mut scales = vec![f32::MIN_POSITIVE; (tables.iter().max().map_or(0, |&t| t) + 1) * k];
    for (row, &table) in features.chunks_exact(k).zip(tables) {
        for (scale, &x) in scales[table * k..][..k].iter_mut().zip(row) {
            *scale = scale.max(x.abs() / largest);
        }
    }
    scales
}

/// Indices of `bits` bits, one after the other from the lowest bit of the first byte.
#[must_use]
pub fn pack(indices: &[u16], bits: u8) -> Vec<u8> {
    let mut bytes = vec![0; (indices.len() * usize::from(bits)).div_ceil(8)];
    for (i, &index) in indices.iter().enumerate() {
        let first = i * usize::from(bits);
        for bit in 0..usize::from(bits) {
            let at = first + bit;
            bytes[at / 8] |= ((index >> bit & 1) as u8) << (at % 8);
        }
    }
    bytes
}

/// What [`pack`] packed: `count` indices.
///
/// # Panics
/// If there are fewer bytes than that takes.
#[must_use]
pub fn unpack(bytes: &[u8], bits: u8, count: usize) -> Vec<u16> {
    (0..count)
        .map(|i| {
            (0..usize::from(bits)).fold(0, |index, bit| {
                let at = i * usize::from(bits) + bit;
                index | u16::from(bytes[at / 8] >> (at % 8) & 1) << bit
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_of_every_width_survive_packing() {
        for bits in 1..=MAX_BITS {
            let indices: Vec<u16> =
                (0..1001u32).map(|i| ((i * 2_654_435) >> 7) as u16 & ((1 << bits) - 1)).collect();
            let bytes = pack(&indices, bits);
            assert_eq!(bytes.len(), (1001 * usize::from(bits)).div_ceil(8));
            assert_eq!(unpack(&bytes, bits, 1001), indices);
        }
    }

    #[test]
    fn stored_features_are_as_near_as_their_numbers_allow() {
        let features: Vec<f32> = (0..160).map(|i| (i as f32 * 0.37).sin() * (1.0 + (i % 8) as f32)).collect();
        let tables: Vec<usize> = (0..20).map(|row| usize::from(row >= 12)).collect();
        for (kind, step) in [
            (StoreKind::F32, 0.0),
            (StoreKind::F16, 1e-3),
            (StoreKind::I8, 1.0 / 127.0),
            (StoreKind::I4, 1.0 / 7.0),
        ] {
            let store = Store::new(kind, &features, 8, &tables);
            assert_eq!((store.kind(), store.rows(8)), (kind, 20));
            let (decoded, entries) = store.decode(8, &tables);
            assert_eq!(entries, (0..20).collect::<Vec<u32>>());
            for (i, (a, b)) in decoded.iter().zip(&features).enumerate() {
                let size = 1.0 + (i % 8) as f32;
                assert!((a - b).abs() <= 0.5001 * step * size, "{kind:?} {i}: {a} {b}");
            }
        }
    }
}
