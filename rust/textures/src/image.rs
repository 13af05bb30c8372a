//! One image: its header first, its texels when they are wanted.

use std::fmt;
use std::path::Path;

use exr::block::reader::ChunksReader;
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::MetaData;
use exr::meta::attribute::SampleType;
use exr::prelude::f16;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::Error;
use crate::source::{Bytes, Input};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Format {
    Png,
    Jpeg,
    Exr,
}

impl Format {
    fn article(self) -> &'static str {
        match self {
            Format::Png => "a whole PNG image",
            Format::Jpeg => "a whole JPEG image",
            Format::Exr => "a whole OpenEXR image",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Format::Png => "PNG",
            Format::Jpeg => "JPEG",
            Format::Exr => "OpenEXR",
        })
    }
}

/// How a sample is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Depth {
    Bits8,
    Bits16,
    Half,
    Float,
}

impl fmt::Display for Depth {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Depth::Bits8 => "8 bits",
            Depth::Bits16 => "16 bits",
            Depth::Half => "half floats",
            Depth::Float => "floats",
        })
    }
}

/// How an image's numbers become linear.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Curve {
    Linear,
    Srgb,
}

/// An image whose header has been read.
#[derive(Clone, Debug)]
pub(crate) struct Image {
    bytes: Bytes,
    pub(crate) format: Format,
    pub(crate) size: [usize; 2],
    /// 1 or 2: grey without or with alpha; 3 or 4: colour.
    pub(crate) channels: usize,
    pub(crate) depth: Depth,
    /// Positions of the channels in an OpenEXR file's list.
    layout: Vec<usize>,
    /// What decoding takes, the result among it.
    memory: u64,
}

impl Image {
    /// Reads the header.
    pub(crate) fn open(bytes: Bytes) -> Result<Self, Error> {
        let head = bytes.head(8)?;
        let format = if head.starts_with(b"\x89PNG\r\n\x1a\n") {
            Format::Png
        } else if head.starts_with(&[0xff, 0xd8, 0xff]) {
            Format::Jpeg
        } else if head.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
            Format::Exr
        } else {
            return Err(Error::Format {
                path: bytes.path().to_owned(),
                format: "an image",
                reason: unknown(&head),
            });
        };
        let image = match format {
            Format::Png => png_header(bytes)?,
            Format::Jpeg => jpeg_header(bytes)?,
            Format::Exr => exr_header(bytes)?,
        };
        if image.size.contains(&0) {
            return Err(image.broken("it has no texels".to_owned()));
        }
        Ok(image)
    }

    pub(crate) fn path(&self) -> &Path {
        self.bytes.path()
    }

    /// The file's name alone, for findings.
    pub(crate) fn file(&self) -> String {
        self.path().file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    pub(crate) fn texels(&self) -> u64 {
        self.size[0] as u64 * self.size[1] as u64
    }

    pub(crate) fn memory(&self) -> u64 {
        self.memory
    }

    /// The channels in words.
    pub(crate) fn kind(&self) -> &'static str {
        match self.channels {
            1 => "one grey channel",
            2 => "one grey channel and alpha",
            3 => "three channels",
            _ => "three channels and alpha",
        }
    }

    pub(crate) fn is_grey(&self) -> bool {
        self.channels < 3
    }

    fn broken(&self, reason: String) -> Error {
        broken(&self.bytes, self.format, reason)
    }

    /// All texels. The caller has compared [`Image::memory`] with what it may take.
    pub(crate) fn decode(&self, curve: Curve) -> Result<Texels, Error> {
        let samples = match self.format {
            Format::Png => self.decode_png()?,
            Format::Jpeg => self.decode_jpeg()?,
            Format::Exr => self.decode_exr()?,
        };
        let table = match &samples {
            Samples::Bits8(_) => table(1 << 8, curve),
            Samples::Bits16(_) => table(1 << 16, curve),
            // OpenEXR is linear whatever it holds.
            Samples::Floats(_) => Vec::new(),
        };
        Ok(Texels { channels: self.channels, samples, table })
    }

    fn decode_png(&self) -> Result<Samples, Error> {
        let failed = |e: png::DecodingError| self.broken(e.to_string());
        let mut reader = png_decoder(self.bytes.open()?).read_info().map_err(failed)?;
        let length = self.texels() as usize * self.channels;
        let expected = length * if self.depth == Depth::Bits16 { 2 } else { 1 };
        if reader.output_buffer_size() != Some(expected) {
            return Err(self.broken("it changed while it was read".to_owned()));
        }
        let mut bytes = vec![0_u8; expected];
        reader.next_frame(&mut bytes).map_err(failed)?;
        reader.finish().map_err(failed)?;
        if self.depth == Depth::Bits8 {
            return Ok(Samples::Bits8(bytes));
        }
        for pair in bytes.chunks_exact_mut(2) {
            let sample = u16::from_be_bytes([pair[0], pair[1]]);
            pair.copy_from_slice(&sample.to_ne_bytes());
        }
        Ok(Samples::Bits16(bytes))
    }

    fn decode_jpeg(&self) -> Result<Samples, Error> {
        let data = self.bytes.all()?;
        if !ends_after_its_scans(&data) {
            return Err(self.broken("it ends before the end of the image".to_owned()));
        }
        // Strict: damage is an error, and no grey rest of an image.
        let space = if self.is_grey() { ColorSpace::Luma } else { ColorSpace::RGB };
        let options = jpeg_options().set_strict_mode(true).jpeg_set_out_colorspace(space);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&data), options);
        let failed = |e: zune_jpeg::errors::DecodeErrors| self.broken(in_words(&e));
        decoder.decode_headers().map_err(failed)?;
        let expected = self.texels() as usize * self.channels;
        if decoder.output_buffer_size() != Some(expected) {
            return Err(self.broken("it changed while it was read".to_owned()));
        }
        let mut samples = vec![0; expected];
        decoder.decode_into(&mut samples).map_err(failed)?;
        Ok(Samples::Bits8(samples))
    }

    /// Block by block, since a damaged file may have blocks that lie anywhere.
    fn decode_exr(&self) -> Result<Samples, Error> {
        let failed = |e: exr::error::Error| self.broken(e.to_string());
        let reader = exr::block::read(self.bytes.open()?, false).map_err(failed)?;
        let list = reader.headers()[0].channels.clone();
        let is_largest = |level: Vec2<usize>| level == Vec2(0, 0);
        let chunks = reader.filter_chunks(false, |_, _, block| is_largest(block.level)).map_err(failed)?;
        let mut samples = vec![0.0_f32; self.texels() as usize * self.channels];
        let mut missing = samples.len();
        let mut blocks = chunks.sequential_decompressor(false);
        while let Some(block) = blocks.decompress_next_block() {
            let block = block.map_err(failed)?;
            for line in block.lines(&list) {
                let at = line.location;
                let Some(channel) = self.layout.iter().position(|&position| position == at.channel) else {
                    continue;
                };
                let is_inside = is_largest(at.level)
                    && at.position.y() < self.size[1]
                    && at.position.x().saturating_add(at.sample_count) <= self.size[0];
                if !is_inside || at.sample_count > missing {
                    return Err(self.broken("it has blocks that overlap, or lie outside".to_owned()));
                }
                missing -= at.sample_count;
                let first = at.position.y() * self.size[0] + at.position.x();
                let into = samples[first * self.channels + channel..].iter_mut().step_by(self.channels);
                match list.list[at.channel].sample_type {
                    SampleType::F16 => fill(into, line.read_samples::<f16>().map(|x| x.map(f32::from))),
                    SampleType::F32 => fill(into, line.read_samples::<f32>()),
                    SampleType::U32 => fill(into, line.read_samples::<u32>().map(|x| x.map(|x| x as f32))),
                }
                .map_err(failed)?;
            }
        }
        if missing > 0 {
            return Err(self.broken(format!("{missing} of its {} samples are missing", samples.len())));
        }
        Ok(Samples::Floats(samples))
    }
}

fn fill<'a>(
    into: impl Iterator<Item = &'a mut f32>,
    samples: impl Iterator<Item = exr::error::Result<f32>>,
) -> exr::error::Result<()> {
    for (into, sample) in into.zip(samples) {
        *into = sample?;
    }
    Ok(())
}

fn broken(bytes: &Bytes, format: Format, reason: String) -> Error {
    Error::Format { path: bytes.path().to_owned(), format: format.article(), reason }
}

/// What stands at the start of a file that is no image.
fn unknown(head: &[u8]) -> String {
    if head.is_empty() {
        return "it is empty".to_owned();
    }
    let text = String::from_utf8_lossy(head);
    format!("it begins with \"{}\", expected PNG, JPEG or OpenEXR", text.escape_debug())
}

fn png_decoder(input: Box<dyn Input>) -> png::Decoder<Box<dyn Input>> {
    let mut decoder = png::Decoder::new(input);
    // Palettes become colours, and samples of fewer than 8 bits get them.
    decoder.set_transformations(png::Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    decoder
}

fn png_header(bytes: Bytes) -> Result<Image, Error> {
    let reader = png_decoder(bytes.open()?).read_info();
    let reader = reader.map_err(|e| broken(&bytes, Format::Png, e.to_string()))?;
    let (color, depth) = reader.output_color_type();
    let size = [reader.info().width as usize, reader.info().height as usize];
    let channels = color.samples();
    let depth = if depth == png::BitDepth::Sixteen { Depth::Bits16 } else { Depth::Bits8 };
    let of_texel = channels as u64 * if depth == Depth::Bits16 { 2 } else { 1 };
    let memory = memory(size, of_texel);
    Ok(Image { bytes, format: Format::Png, size, channels, depth, layout: Vec::new(), memory })
}

/// Whether the marker of a JPEG file's end comes after that of its last scan: within a scan there is none, and a
/// decoder may take a file that was cut off for one whose last blocks repeat.
fn ends_after_its_scans(data: &[u8]) -> bool {
    let last = |marker: [u8; 2]| data.windows(2).rposition(|pair| pair == marker);
    last([0xff, 0xd9]) > last([0xff, 0xda])
}

fn jpeg_options() -> DecoderOptions {
    DecoderOptions::default().set_max_width(usize::MAX).set_max_height(usize::MAX)
}

fn jpeg_header(bytes: Bytes) -> Result<Image, Error> {
    let data = bytes.all()?;
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&data), jpeg_options());
    decoder.decode_headers().map_err(|e| broken(&bytes, Format::Jpeg, in_words(&e)))?;
    let (Some((width, height)), Some(space)) = (decoder.dimensions(), decoder.input_colorspace()) else {
        return Err(broken(&bytes, Format::Jpeg, "it has no size".to_owned()));
    };
    let channels = if space == ColorSpace::Luma { 1 } else { 3 };
    // A progressive file's coefficients have 2 bytes, in up to four channels, beside the texels.
    let memory = memory([width, height], channels + 8).saturating_add(bytes.length());
    Ok(Image {
        bytes,
        format: Format::Jpeg,
        size: [width, height],
        channels: channels as usize,
        depth: Depth::Bits8,
        layout: Vec::new(),
        memory,
    })
}

/// The decoder's errors are written for programmers.
fn in_words(error: &zune_jpeg::errors::DecodeErrors) -> String {
    let text = error.to_string();
    let line = text.lines().next().unwrap_or_default();
    line.trim_start_matches("Error parsing image.").trim().to_owned()
}

fn exr_header(bytes: Bytes) -> Result<Image, Error> {
    let failed = |reason: String| broken(&bytes, Format::Exr, reason);
    let meta = MetaData::read_from_buffered(bytes.open()?, false).map_err(|e| failed(e.to_string()))?;
    let [header] = meta.headers.as_slice() else {
        return Err(failed(format!("it has {} layers, expected one", meta.headers.len())));
    };
    if header.deep {
        return Err(failed("it is deep, expected one sample a pixel".to_owned()));
    }
    if matches!(header.compression, Compression::B44 | Compression::B44A) {
        // The decoder's arithmetic overflows: a panic where that is checked.
        return Err(failed("it is compressed as B44, which is not read; save it with ZIP".to_owned()));
    }
    let list = &header.channels.list;
    if list.iter().any(|channel| channel.sampling != Vec2(1, 1)) {
        return Err(failed("its channels have different sizes, expected one sample each a pixel".to_owned()));
    }
    let names: Vec<String> = list.iter().map(|channel| channel.name.to_string()).collect();
    let layout = exr_layout(&names).ok_or_else(|| {
        failed(format!("its channels are {}, expected R, G and B, or one", crate::error::Few(&names)))
    })?;
    let size = [header.layer_size.0, header.layer_size.1];
    let is_float = layout.iter().any(|&position| list[position].sample_type != SampleType::F16);
    let depth = if is_float { Depth::Float } else { Depth::Half };
    let (channels, memory) = (layout.len(), memory(size, 4 * layout.len() as u64));
    Ok(Image { bytes, format: Format::Exr, size, channels, depth, layout, memory })
}

/// Positions of red, green, blue and alpha, or of the only channel that is not alpha, and alpha.
fn exr_layout(names: &[String]) -> Option<Vec<usize>> {
    let position = |wanted: &str| names.iter().position(|name| name == wanted);
    let mut layout = match (position("R"), position("G"), position("B")) {
        (Some(r), Some(g), Some(b)) => vec![r, g, b],
        _ => {
            let mut others = (0..names.len()).filter(|&i| names[i] != "A");
            let only = others.next()?;
            if others.next().is_some() {
                return None;
            }
            vec![only]
        }
    };
    layout.extend(position("A"));
    Some(layout)
}

fn memory(size: [usize; 2], bytes_of_texel: u64) -> u64 {
    (size[0] as u64).saturating_mul(size[1] as u64).saturating_mul(bytes_of_texel)
}

/// The linear values of all integers below `count`.
fn table(count: usize, curve: Curve) -> Vec<f32> {
    let most = (count - 1) as f64;
    let value = |i: usize| match curve {
        Curve::Linear => (i as f64 / most) as f32,
        Curve::Srgb => linear_of_srgb(i as f64 / most) as f32,
    };
    (0..count).map(value).collect()
}

/// IEC 61966-2-1.
fn linear_of_srgb(x: f64) -> f64 {
    if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

/// The texels of an image as they are stored, row by row from the top.
#[derive(Debug)]
pub(crate) struct Texels {
    channels: usize,
    samples: Samples,
    /// What each integer is worth.
    table: Vec<f32>,
}

#[derive(Debug)]
enum Samples {
    Bits8(Vec<u8>),
    /// In the machine's order of bytes.
    Bits16(Vec<u8>),
    Floats(Vec<f32>),
}

impl Texels {
    fn sample(&self, texel: usize, channel: usize) -> f32 {
        let at = texel * self.channels + channel;
        match &self.samples {
            Samples::Bits8(bytes) => self.table[bytes[at] as usize],
            Samples::Bits16(bytes) => {
                self.table[u16::from_ne_bytes([bytes[2 * at], bytes[2 * at + 1]]) as usize]
            }
            Samples::Floats(floats) => floats[at],
        }
    }

    /// Red, green and blue; grey thrice.
    pub(crate) fn color(&self, texel: usize) -> [f32; 3] {
        if self.channels < 3 {
            [self.sample(texel, 0); 3]
        } else {
            [0, 1, 2].map(|channel| self.sample(texel, channel))
        }
    }

    /// Linear whatever the curve of the colours; 1 where there is none.
    pub(crate) fn alpha(&self, texel: usize) -> f32 {
        if self.channels % 2 == 1 {
            return 1.0;
        }
        let at = (texel + 1) * self.channels - 1;
        match &self.samples {
            Samples::Bits8(bytes) => f32::from(bytes[at]) / 255.0,
            Samples::Bits16(bytes) => {
                f32::from(u16::from_ne_bytes([bytes[2 * at], bytes[2 * at + 1]])) / 65535.0
            }
            Samples::Floats(floats) => floats[at],
        }
    }
}
