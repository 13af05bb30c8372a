//! The container of the RGL material database: named tensors behind a header.
//!
//! All numbers are little-endian:
//! ```text
//! "tensor_file\0"  u8 major = 1  u8 minor = 0  u32 number of fields
//! per field:       u16 length of name, name, u16 rank, u8 type, u64 offset, u64 shape[rank]
//! the data:        each tensor at its offset (from the start of the file), row-major, aligned to 8
//! ```
//! The layout is that of the files published with Dupuy & Jakob, *An Adaptive Parameterization for
//! Efficient Material Acquisition and Rendering*, 2018. Type numbers follow Mitsuba's `Struct::Type`.

use std::borrow::Cow;
use std::path::Path;

use crate::error::Error;
use crate::file;

/// First bytes of every tensor file.
pub const MAGIC: &[u8; 12] = b"tensor_file\0";
const VERSION: [u8; 2] = [1, 0];
const ALIGNMENT: usize = 8;
/// A field with an empty name and rank 0: lengths, type and offset.
const SMALLEST_FIELD: usize = 2 + 2 + 1 + 8;
/// Most axes of a tensor: those of the database have five.
const MAX_RANK: usize = 8;
/// Bytes of a name that an error quotes.
const QUOTED: usize = 40;

/// Element type of a tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs)]
pub enum DType {
    UInt8 = 1,
    Int8 = 2,
    UInt16 = 3,
    Int16 = 4,
    UInt32 = 5,
    Int32 = 6,
    UInt64 = 7,
    Int64 = 8,
    Float16 = 9,
    Float32 = 10,
    Float64 = 11,
}

impl DType {
    const ALL: [DType; 11] = [
        DType::UInt8,
        DType::Int8,
        DType::UInt16,
        DType::Int16,
        DType::UInt32,
        DType::Int32,
        DType::UInt64,
        DType::Int64,
        DType::Float16,
        DType::Float32,
        DType::Float64,
    ];

    fn from_code(code: u8) -> Option<DType> {
        Self::ALL.into_iter().find(|dtype| *dtype as u8 == code)
    }

    /// Bytes of one element.
    #[must_use]
    pub fn size(self) -> usize {
        match self {
            DType::UInt8 | DType::Int8 => 1,
            DType::UInt16 | DType::Int16 | DType::Float16 => 2,
            DType::UInt32 | DType::Int32 | DType::Float32 => 4,
            DType::UInt64 | DType::Int64 | DType::Float64 => 8,
        }
    }
}

/// One named tensor; the data are the file's bytes, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Field<'a> {
    /// Name, unique within the file, at most 65,535 bytes.
    pub name: String,
    /// Element type.
    pub dtype: DType,
    /// Extent of each dimension, slowest first.
    pub shape: Vec<usize>,
    /// Little-endian elements: product of `shape` times the size of `dtype` bytes.
    pub data: Cow<'a, [u8]>,
}

impl Field<'_> {
    /// A tensor of floats.
    #[must_use]
    pub fn from_f32(name: &str, shape: &[usize], values: &[f32]) -> Field<'static> {
        debug_assert_eq!(shape.iter().product::<usize>(), values.len());
        let data: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Field { name: name.to_owned(), dtype: DType::Float32, shape: shape.to_vec(), data: data.into() }
    }

    /// A vector of bytes: a flag, a text, a bit mask.
    #[must_use]
    pub fn from_bytes(name: &str, values: &[u8]) -> Field<'static> {
        Field {
            name: name.to_owned(),
            dtype: DType::UInt8,
            shape: vec![values.len()],
            data: values.to_vec().into(),
        }
    }

    /// The elements of a float32 tensor.
    pub(crate) fn to_f32(&self) -> Vec<f32> {
        let decode = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        self.data.chunks_exact(4).map(decode).collect()
    }
}

/// The tensors of a file in the order of its header.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TensorFile<'a> {
    /// The tensors.
    pub fields: Vec<Field<'a>>,
}

impl<'a> TensorFile<'a> {
    /// Decodes the bytes of a file, and says how many of them follow the last tensor; `path` serves the error
    /// messages only.
    ///
    /// Nothing is allocated that a claim in the header could make larger than the file itself.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a wrong magic, version, type or name, [`Error::Size`] where header and
    /// length of the file disagree.
    pub fn parse(path: &Path, bytes: &'a [u8]) -> Result<(TensorFile<'a>, usize), Error> {
        let mut header = Cursor { path, bytes, at: 0 };
        let magic = header.take(MAGIC.len(), "magic")?;
        if magic != MAGIC {
            let found = format!("{:?}", String::from_utf8_lossy(magic));
            return Err(Error::invalid(path, "magic", found, "\"tensor_file\\0\""));
        }
        let version = header.take(2, "version")?;
        if version != VERSION {
            let found = format!("{}.{}", version[0], version[1]);
            return Err(Error::invalid(path, "tensor file version", found, "1.0"));
        }
        let count = header.u32("number of fields")? as usize;
        let most = (bytes.len() - header.at) / SMALLEST_FIELD;
        if count > most {
            let expected = format!("at most {most} in a file of {} bytes", bytes.len());
            return Err(Error::invalid(path, "number of fields", count, expected));
        }
        let mut fields: Vec<Field> = Vec::with_capacity(count);
        let mut end = 0;
        for _ in 0..count {
            let (field, field_end) = header.field()?;
            if fields.iter().any(|other| other.name == field.name) {
                let found = format!("`{}` twice", field.name);
                return Err(Error::invalid(path, "field names", found, "each name once"));
            }
            fields.push(field);
            end = end.max(field_end);
        }
        // Tensors that share their bytes would be more in memory than the file.
        let total: usize = fields.iter().map(|field| field.data.len()).sum();
        if total > bytes.len() {
            let expected = format!("at most the file's {} bytes", bytes.len());
            return Err(Error::invalid(path, "tensors", format!("{total} bytes"), expected));
        }
        Ok((TensorFile { fields }, bytes.len() - end.max(header.at)))
    }

    /// The tensor called `name`.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Field<'a>> {
        self.fields.iter().find(|field| field.name == name)
    }

    /// The bytes of the file that holds these tensors.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let header_size: usize = MAGIC.len()
            + VERSION.len()
            + size_of::<u32>()
            + self.fields.iter().map(|f| SMALLEST_FIELD + f.name.len() + 8 * f.shape.len()).sum::<usize>();
        let mut out = Vec::with_capacity(header_size);
        out.extend_from_slice(MAGIC);
        out.extend_from_slice(&VERSION);
        out.extend_from_slice(&(self.fields.len() as u32).to_le_bytes());
        let mut offset = header_size;
        for field in &self.fields {
            offset = offset.next_multiple_of(ALIGNMENT);
            out.extend_from_slice(&(field.name.len() as u16).to_le_bytes());
            out.extend_from_slice(field.name.as_bytes());
            out.extend_from_slice(&(field.shape.len() as u16).to_le_bytes());
            out.push(field.dtype as u8);
            out.extend_from_slice(&(offset as u64).to_le_bytes());
            for &extent in &field.shape {
                out.extend_from_slice(&(extent as u64).to_le_bytes());
            }
            offset += field.data.len();
        }
        for field in &self.fields {
            out.resize(out.len().next_multiple_of(ALIGNMENT), 0);
            out.extend_from_slice(&field.data);
        }
        out
    }

    /// Writes the tensors to `path`.
    ///
    /// # Errors
    /// [`Error::Write`] when the operating system refuses.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), Error> {
        file::write(path.as_ref(), &self.to_bytes())
    }
}

/// Reads the header from front to back.
struct Cursor<'a, 'p> {
    path: &'p Path,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a, '_> {
    fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], Error> {
        let rest = &self.bytes[self.at..];
        if rest.len() < count {
            let expected = self.at + count;
            return Err(Error::size(
                self.path,
                self.bytes.len(),
                expected,
                &format!("at least, to hold the {what}"),
            ));
        }
        self.at += count;
        Ok(&rest[..count])
    }

    fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], Error> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N, what)?);
        Ok(out)
    }

    fn u16(&mut self, what: &str) -> Result<u16, Error> {
        self.array(what).map(u16::from_le_bytes)
    }

    fn u32(&mut self, what: &str) -> Result<u32, Error> {
        self.array(what).map(u32::from_le_bytes)
    }

    fn u64(&mut self, what: &str) -> Result<u64, Error> {
        self.array(what).map(u64::from_le_bytes)
    }

    /// Decodes one field; returns it and where its data end.
    fn field(&mut self) -> Result<(Field<'a>, usize), Error> {
        let name_length = self.u16("length of a field's name")? as usize;
        let name = self.take(name_length, "name of a field")?;
        let name = str::from_utf8(name)
            .map_err(|_| {
                let found = name[..name.len().min(QUOTED)].escape_ascii();
                Error::invalid(self.path, "name of a field", found, "UTF-8")
            })?
            .to_owned();
        let rank = self.u16("rank of a field")? as usize;
        if rank > MAX_RANK {
            return Err(Error::invalid(self.path, "rank of a field", rank, format!("at most {MAX_RANK}")));
        }
        let [code] = self.array("type of a field")?;
        let dtype = DType::from_code(code)
            .ok_or_else(|| Error::invalid(self.path, format!("type of field `{name}`"), code, "1 to 11"))?;
        let offset = self.u64("offset of a field")?;
        let shape = self.take(rank * 8, "shape of a field")?;
        let shape: Vec<u64> = shape
            .chunks_exact(8)
            .map(|b| u64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]))
            .collect();
        let range = shape
            .iter()
            .try_fold(dtype.size() as u64, |size, &extent| size.checked_mul(extent))
            .and_then(|size| Some(offset..offset.checked_add(size)?))
            .filter(|range| range.end <= self.bytes.len() as u64);
        let Some(range) = range else {
            let found = format!("shape {shape:?} of {dtype:?} at offset {offset}");
            let expected = format!("data that end within the file's {} bytes", self.bytes.len());
            return Err(Error::invalid(self.path, format!("field `{name}`"), found, expected));
        };
        let data = &self.bytes[range.start as usize..range.end as usize];
        let shape = shape.into_iter().map(|extent| extent as usize).collect();
        Ok((Field { name, dtype, shape, data: data.into() }, range.end as usize))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn file() -> TensorFile<'static> {
        TensorFile {
            fields: vec![
                Field::from_bytes("description", b"felt"),
                Field::from_f32("theta_i", &[3], &[0.0, 0.5, 1.5]),
                Field::from_f32("ndf", &[2, 2], &[1.0, 2.0, 3.0, 4.0]),
            ],
        }
    }

    #[test]
    fn tensors_that_share_their_bytes_and_tensors_of_many_axes_are_refused() {
        let numbers = [0.5; 100];
        let field = |name: &str| Field::from_f32(name, &[100], &numbers);
        let mut bytes = TensorFile { fields: vec![field("a"), field("b"), field("c")] }.to_bytes();
        // An entry ends with the field's offset and its only extent. All fields are where the first is.
        let entry = 2 + 1 + 2 + 1 + 8 + 8;
        let offset = |field: usize| MAGIC.len() + VERSION.len() + size_of::<u32>() + (field + 1) * entry - 16;
        let first: [u8; 8] = bytes[offset(0)..][..8].try_into().unwrap();
        for field in 1..3 {
            bytes[offset(field)..][..8].copy_from_slice(&first);
        }
        bytes.truncate(u64::from_le_bytes(first) as usize + 400);
        let message = parse(&bytes).unwrap_err().to_string();
        assert!(message.contains("1200 bytes"), "{message}");
        let deep = TensorFile { fields: vec![Field::from_f32("a", &[1; 9], &[0.5])] }.to_bytes();
        let message = parse(&deep).unwrap_err().to_string();
        assert!(message.contains("rank of a field: found 9, expected at most 8"), "{message}");
    }

    fn parse(bytes: &[u8]) -> Result<TensorFile<'_>, Error> {
        TensorFile::parse(Path::new("felt.bsdf"), bytes).map(|(file, _)| file)
    }

    /// The bytes of a file with one float32 field `x` that claims this shape and offset.
    fn claim(shape: &[u64], offset: u64) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0, 1, 0, 0, 0, 1, 0, b'x']);
        bytes.extend((shape.len() as u16).to_le_bytes());
        bytes.push(DType::Float32 as u8);
        bytes.extend(offset.to_le_bytes());
        bytes.extend(shape.iter().flat_map(|extent| extent.to_le_bytes()));
        bytes
    }

    #[test]
    fn what_is_written_is_read_back() {
        let bytes = file().to_bytes();
        assert_eq!(parse(&bytes).unwrap(), file());
        assert_eq!(parse(&bytes).unwrap().get("ndf").unwrap().to_f32(), [1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn the_layout_is_that_of_the_database() {
        let bytes = file().to_bytes();
        assert_eq!(&bytes[..18], b"tensor_file\0\x01\0\x03\0\0\0");
        // First field: name, rank 1, uint8, its offset (the header's 108 bytes aligned to 8), 4 elements.
        assert_eq!(&bytes[18..20], [11, 0]);
        assert_eq!(&bytes[20..31], b"description");
        assert_eq!(&bytes[31..34], [1, 0, 1]);
        assert_eq!(&bytes[34..50], [112, 0, 0, 0, 0, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(&bytes[112..116], b"felt");
        assert_eq!(bytes.len(), 136 + 16);
    }

    #[test]
    fn every_truncation_is_an_error_and_bytes_after_the_end_are_counted() {
        let mut bytes = file().to_bytes();
        for length in 0..bytes.len() {
            assert!(parse(&bytes[..length]).is_err(), "{length}");
        }
        bytes.extend([0; 3]);
        let (read, trailing) = TensorFile::parse(Path::new("felt.bsdf"), &bytes).unwrap();
        assert_eq!((read, trailing), (file(), 3));
    }

    #[test]
    fn a_wrong_magic_version_type_or_name_is_named() {
        let bytes = file().to_bytes();
        for (at, value, expected) in [
            (0, b'T', "felt.bsdf: magic: found \"Tensor_file\\0\", expected \"tensor_file\\0\""),
            (12, 2, "felt.bsdf: tensor file version: found 2.0, expected 1.0"),
            (14, 200, "felt.bsdf: number of fields: found 200, expected at most 10 in a file of 152 bytes"),
            (33, 12, "felt.bsdf: type of field `description`: found 12, expected 1 to 11"),
        ] {
            let mut bytes = bytes.clone();
            bytes[at] = value;
            assert_eq!(parse(&bytes).unwrap_err().to_string(), expected);
        }
        let mut twice = file();
        twice.fields[2].name = "theta_i".to_owned();
        assert!(parse(&twice.to_bytes()).unwrap_err().to_string().contains("`theta_i` twice"));
    }

    #[test]
    fn claims_beyond_the_file_are_refused_before_anything_is_allocated() {
        for (shape, offset) in [
            (&[1_u64 << 40][..], 0),
            (&[1 << 32, 1 << 32], 0),
            (&[u64::MAX, u64::MAX], 0),
            (&[1], u64::MAX),
            (&[1 << 62], 8),
        ] {
            let message = parse(&claim(shape, offset)).unwrap_err().to_string();
            assert!(message.contains("expected data that end within the file"), "{message}");
        }
    }

    proptest! {
        #[test]
        fn no_mutation_panics(at in 0_usize..152, value: u8, cut in 0_usize..153) {
            let mut bytes = file().to_bytes();
            bytes[at] = value;
            let _ = parse(&bytes);
            let _ = parse(&bytes[..cut]);
        }
    }
}
