//! NumPy's `.npy` format: versions 1 to 3, numbers of every type, either byte order, C or Fortran order.
//!
//! Specification: `numpy.lib.format`. A file is the magic, a version, the length of the header, the
//! header (a Python dictionary with `descr`, `fortran_order` and `shape`), and the numbers.

use std::path::Path;

use glimt_disk::write_whole;
use glimt_measured::file::read_regular;
use half::f16;

use crate::error::{Error, excerpt};

/// First bytes of a `.npy` file.
pub const MAGIC: &[u8; 6] = b"\x93NUMPY";

/// The numbers of a file start at a multiple of this, as the specification asks.
const ALIGNMENT: usize = 64;

/// Most axes of an array, as in NumPy.
const MAX_AXES: usize = 64;

/// An array of float32.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Length of each axis.
    pub shape: Vec<usize>,
    /// The numbers in C order: the last axis varies fastest.
    pub values: Vec<f32>,
}

impl Array {
    /// Reads a `.npy` file of numbers, which are kept as float32.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for a file that is broken or holds other types.
    pub fn open(path: impl AsRef<Path>) -> Result<Array, Error> {
        let path = path.as_ref();
        let bytes = read_regular(path).map_err(Error::read(path))?;
        Array::from_bytes(&bytes).map_err(|reason| Error::Format {
            path: path.to_owned(),
            format: "a NumPy array (.npy) of numbers",
            reason,
        })
    }

    /// Decodes the bytes of a `.npy` file; bytes after the array are ignored, as NumPy does.
    ///
    /// # Errors
    /// In words, what was found and what was expected.
    pub fn from_bytes(bytes: &[u8]) -> Result<Array, String> {
        Array::from_start(bytes).map(|(array, _)| array)
    }

    /// The array at the start of `bytes`, and how many bytes follow it.
    pub(crate) fn from_start(bytes: &[u8]) -> Result<(Array, usize), String> {
        let (header, data) = split(bytes)?;
        let kind = header_value(header, "descr")?;
        let shape = shape(header_value(header, "shape")?)?;
        let number = Number::of(kind.trim_matches(['\'', '"'])).ok_or_else(|| {
            format!("its type is {}, expected numbers: floats or integers", excerpt(kind.trim_matches('\'')))
        })?;
        let length = shape.iter().try_fold(number.size, |n: usize, &axis| n.checked_mul(axis));
        let Some((data, rest)) = length.and_then(|length| data.split_at_checked(length)) else {
            return Err(format!("{} bytes of numbers do not fill its shape {shape:?}", data.len()));
        };
        let values: Vec<f32> = data.chunks_exact(number.size).map(|bytes| number.decode(bytes)).collect();
        let values = match header_value(header, "fortran_order")? {
            "False" => values,
            "True" => from_fortran_order(&shape, &values),
            other => return Err(format!("fortran_order is {}, expected True or False", excerpt(other))),
        };
        Ok((Array { shape, values }, rest.len()))
    }

    /// Writes the array as float32 in C order: whole, or not at all.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), Error> {
        let path = path.as_ref();
        write_whole(path, &self.to_bytes()).map_err(|source| Error::Write { path: path.to_owned(), source })
    }

    /// The bytes of a `.npy` file, version 1.0.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let shape = match &self.shape[..] {
            [only] => format!("({only},)"),
            axes => format!("({})", axes.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
        };
        let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
        // Magic, version and length of the header come before it, and a line feed ends it.
        let before = MAGIC.len() + 2 + 2;
        let padding = (before + header.len() + 1).next_multiple_of(ALIGNMENT) - (before + header.len() + 1);
        header.push_str(&" ".repeat(padding));
        header.push('\n');

        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.into_bytes());
        bytes.extend(self.values.iter().flat_map(|value| value.to_le_bytes()));
        bytes
    }
}

/// A type of numbers.
struct Number {
    kind: NumberKind,
    /// Bytes of a number.
    size: usize,
    is_big_endian: bool,
}

#[derive(Clone, Copy)]
enum NumberKind {
    Float,
    Signed,
    Unsigned,
}

impl Number {
    /// The type that NumPy spells like this: `<f4`, `>i8`, `|u1` …
    fn of(descr: &str) -> Option<Number> {
        let (order, name) = descr.split_at_checked(1)?;
        let (kind, sizes): (_, &[usize]) = match name.get(..1)? {
            "f" => (NumberKind::Float, &[2, 4, 8]),
            "i" => (NumberKind::Signed, &[1, 2, 4, 8]),
            "u" => (NumberKind::Unsigned, &[1, 2, 4, 8]),
            _ => return None,
        };
        let size = name[1..].parse().ok().filter(|size| sizes.contains(size))?;
        let is_big_endian = match order {
            "<" => false,
            ">" => true,
            "|" if size == 1 => false,
            _ => return None,
        };
        Some(Number { kind, size, is_big_endian })
    }

    fn decode(&self, bytes: &[u8]) -> f32 {
        let mut little = [0; 8];
        little[..self.size].copy_from_slice(bytes);
        if self.is_big_endian {
            little[..self.size].reverse();
        }
        let bits = u64::from_le_bytes(little);
        match (self.kind, self.size) {
            (NumberKind::Float, 2) => f16::from_bits(bits as u16).to_f32(),
            (NumberKind::Float, 4) => f32::from_bits(bits as u32),
            (NumberKind::Float, _) => f64::from_bits(bits) as f32,
            (NumberKind::Unsigned, _) => bits as f32,
            // The sign is that of the highest bit of as many bytes as there are.
            (NumberKind::Signed, size) => {
                let unused = 64 - 8 * size as u32;
                ((bits << unused) as i64 >> unused) as f32
            }
        }
    }
}

/// Header and numbers.
fn split(bytes: &[u8]) -> Result<(&str, &[u8]), String> {
    let cut = || "it ends within its header".to_owned();
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| {
        format!(
            "it begins with \"{}\", expected \"{}\"",
            bytes[..bytes.len().min(6)].escape_ascii(),
            MAGIC.escape_ascii()
        )
    })?;
    let (version, rest) = rest.split_at_checked(2).ok_or_else(cut)?;
    let width = match version[0] {
        1 => 2,
        2 | 3 => 4,
        other => return Err(format!("its version is {other}, expected 1, 2 or 3")),
    };
    let (length, rest) = rest.split_at_checked(width).ok_or_else(cut)?;
    let length = length.iter().rev().fold(0, |n, &byte| n << 8 | usize::from(byte));
    let (header, data) = rest.split_at_checked(length).ok_or_else(cut)?;
    Ok((std::str::from_utf8(header).map_err(|_| "its header is not text")?, data))
}

/// The text of one value in the header's dictionary.
fn header_value<'a>(header: &'a str, key: &str) -> Result<&'a str, String> {
    let missing = || format!("its header has no {key}: {}", excerpt(header.trim_end()));
    let quoted = [format!("'{key}'"), format!("\"{key}\"")];
    let (_, rest) = quoted.iter().find_map(|key| header.split_once(key.as_str())).ok_or_else(missing)?;
    let rest = rest.trim_start().strip_prefix(':').ok_or_else(missing)?.trim_start();
    // A tuple ends with its parenthesis; anything else with a comma or the dictionary.
    let end = if rest.starts_with('(') { rest.find(')').map(|at| at + 1) } else { rest.find([',', '}']) };
    Ok(rest[..end.ok_or_else(missing)?].trim())
}

fn shape(tuple: &str) -> Result<Vec<usize>, String> {
    let bad = || format!("its shape is {}, expected a tuple of at most {MAX_AXES} lengths", excerpt(tuple));
    let inner = tuple.strip_prefix('(').and_then(|t| t.strip_suffix(')')).ok_or_else(bad)?;
    let axes = inner.split(',').map(str::trim).filter(|axis| !axis.is_empty());
    let shape: Vec<usize> =
        axes.take(MAX_AXES + 1).map(|axis| axis.parse().map_err(|_| bad())).collect::<Result<_, _>>()?;
    if shape.len() > MAX_AXES { Err(bad()) } else { Ok(shape) }
}

/// Reorders numbers whose first axis varies fastest.
fn from_fortran_order(shape: &[usize], values: &[f32]) -> Vec<f32> {
    let mut strides = vec![1; shape.len()];
    for axis in 1..shape.len() {
        strides[axis] = strides[axis - 1] * shape[axis - 1];
    }
    let position = |mut index: usize| {
        let mut at = 0;
        for axis in (0..shape.len()).rev() {
            at += index % shape[axis] * strides[axis];
            index /= shape[axis];
        }
        at
    };
    (0..values.len()).map(|index| values[position(index)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A file as NumPy writes it.
    fn file(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.bytes());
        bytes.extend(data);
        bytes
    }

    fn doubles(values: &[f64]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    #[test]
    fn written_as_numpy_writes_it() {
        let array = Array { shape: vec![2, 3], values: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0] };
        let bytes = array.to_bytes();
        assert_eq!(bytes.len(), 128 + 24);
        assert!(bytes.starts_with(
            b"\x93NUMPY\x01\x00v\x00{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }  "
        ));
        assert_eq!(bytes[127], b'\n');
        assert_eq!(Array::from_bytes(&bytes), Ok(array));
        let line = Array { shape: vec![2], values: vec![1.0, 2.0] };
        assert_eq!(Array::from_bytes(&line.to_bytes()), Ok(line));
        let number = Array { shape: vec![], values: vec![7.0] };
        assert_eq!(Array::from_bytes(&number.to_bytes()), Ok(number));
    }

    #[test]
    fn doubles_and_fortran_order_are_read() {
        let header = "{'descr': '<f8', 'fortran_order': True, 'shape': (2, 3), }\n";
        let array = Array::from_bytes(&file(header, &doubles(&[0.0, 3.0, 1.0, 4.0, 2.0, 5.0]))).unwrap();
        assert_eq!(array, Array { shape: vec![2, 3], values: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0] });
        let header = "{'descr': '>f4', 'fortran_order': False, 'shape': (1,), }";
        assert_eq!(Array::from_bytes(&file(header, &1.5f32.to_be_bytes())).unwrap().values, [1.5]);
    }

    #[test]
    fn what_numpy_loads_is_read() {
        let read = |descr: &str, bytes: &[u8]| {
            let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (2,), }}");
            Array::from_start(&file(&header, bytes)).unwrap()
        };
        let values = |descr: &str, bytes: &[u8]| read(descr, bytes).0.values;
        assert_eq!(values("|u1", &[1, 255]), [1.0, 255.0]);
        assert_eq!(values("|i1", &[1, 255]), [1.0, -1.0]);
        assert_eq!(values("<i2", &[0, 1, 0xfe, 0xff]), [256.0, -2.0]);
        assert_eq!(values(">u4", &[0, 0, 0, 7, 0x80, 0, 0, 0]), [7.0, 2_147_483_648.0]);
        assert_eq!(values("<i8", &[-3_i64, 5].map(i64::to_le_bytes).concat()), [-3.0, 5.0]);
        assert_eq!(values("<f2", &[0, 0x3c, 0, 0xc0]), [1.0, -2.0]);
        assert_eq!(read("<f4", &[0; 11]), (Array { shape: vec![2], values: vec![0.0; 2] }, 3));
    }

    #[test]
    fn what_does_not_fit_is_refused_in_words() {
        let message = |header: &str| Array::from_bytes(&file(header, &[0; 24])).unwrap_err();
        let complex = "{'descr': '<c16', 'fortran_order': False, 'shape': (3,), }";
        assert!(message(complex).contains("its type is <c16, expected numbers"));
        let disordered = "{'descr': '|f4', 'fortran_order': False, 'shape': (3,), }";
        assert!(message(disordered).contains("its type is |f4"));
        let large = "{'descr': '<f4', 'fortran_order': False, 'shape': (7,), }";
        assert!(message(large).contains("24 bytes of numbers do not fill its shape [7]"));
        let huge = "{'descr': '<f8', 'fortran_order': False, 'shape': (4294967296, 4294967296), }";
        assert!(message(huge).contains("do not fill"));
        assert!(message("{'descr': '<f4'}").contains("no shape"));
        assert!(Array::from_bytes(b"PK\x03\x04").unwrap_err().contains("begins with \"PK"));
        assert!(Array::from_bytes(b"\x93NUMPY\x01\x00\xff\xff{").unwrap_err().contains("ends within"));
    }

    proptest! {
        #[test]
        fn mutated_files_never_panic(at in 0..200usize, byte in any::<u8>(), cut in 0..200usize) {
            let whole = Array { shape: vec![2, 5], values: vec![1.0; 10] }.to_bytes();
            let (length, mut bytes) = (whole.len(), whole.clone());
            bytes[at % length] = byte;
            let _ = Array::from_bytes(&bytes);
            // With another header length, numbers may begin so early that enough of them are left.
            let _ = Array::from_bytes(&bytes[..cut % length]);
            prop_assert!(Array::from_bytes(&whole[..cut % length]).is_err());
        }
    }
}
