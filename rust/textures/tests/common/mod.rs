//! Small images, encoded.

#![allow(dead_code, reason = "every test file is a crate of its own and uses a part")]

use std::io::Cursor;

use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, WritableImage};
use glimt_textures::{Error, Folder, MEMORY, Maps, Size};

pub type Files = Vec<(String, Vec<u8>)>;

/// A PNG of 8 bits from the channels of each texel.
pub fn png<const N: usize>(size: [usize; 2], texel: impl Fn(usize, usize) -> [u8; N]) -> Vec<u8> {
    let data: Vec<u8> = all(size).flat_map(|(x, y)| texel(x, y)).collect();
    encode(size, N, png::BitDepth::Eight, &data)
}

/// A PNG of 16 bits.
pub fn png16<const N: usize>(size: [usize; 2], texel: impl Fn(usize, usize) -> [u16; N]) -> Vec<u8> {
    let data: Vec<u8> = all(size).flat_map(|(x, y)| texel(x, y)).flat_map(u16::to_be_bytes).collect();
    encode(size, N, png::BitDepth::Sixteen, &data)
}

fn all([width, height]: [usize; 2]) -> impl Iterator<Item = (usize, usize)> {
    (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)))
}

fn encode(size: [usize; 2], channels: usize, depth: png::BitDepth, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size[0] as u32, size[1] as u32);
    encoder.set_color(match channels {
        1 => png::ColorType::Grayscale,
        2 => png::ColorType::GrayscaleAlpha,
        3 => png::ColorType::Rgb,
        _ => png::ColorType::Rgba,
    });
    encoder.set_depth(depth);
    encoder.write_header().unwrap().write_image_data(data).unwrap();
    bytes
}

/// The header of a PNG of any size, and the start of its data.
pub fn png_that_claims(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().unwrap();
    writer.write_chunk(png::chunk::IDAT, &[0x78, 0x9c, 0, 0]).unwrap();
    drop(writer);
    bytes
}

/// A JPEG of one colour, or grey.
pub fn jpeg(size: [usize; 2], color: [u8; 3], is_progressive: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, 100);
    encoder.set_progressive(is_progressive);
    let data: Vec<u8> = all(size).flat_map(|_| color).collect();
    encoder.encode(&data, size[0] as u16, size[1] as u16, jpeg_encoder::ColorType::Rgb).unwrap();
    bytes
}

pub fn grey_jpeg(size: [usize; 2], grey: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let data = vec![grey; size[0] * size[1]];
    let encoder = jpeg_encoder::Encoder::new(&mut bytes, 100);
    encoder.encode(&data, size[0] as u16, size[1] as u16, jpeg_encoder::ColorType::Luma).unwrap();
    bytes
}

/// An OpenEXR file of these channels.
pub fn exr(size: [usize; 2], channels: &[(&str, FlatSamples)]) -> Vec<u8> {
    encoded_exr(Encoding::default(), size, channels)
}

/// An OpenEXR file of any compression, in scan lines or tiles.
pub fn encoded_exr(encoding: Encoding, size: [usize; 2], channels: &[(&str, FlatSamples)]) -> Vec<u8> {
    let channels = channels.iter().map(|(name, samples)| AnyChannel::new(*name, samples.clone())).collect();
    let mut image = exr::image::Image::from_channels((size[0], size[1]), AnyChannels::sort(channels));
    image.layer_data.encoding = encoding;
    let mut file = Cursor::new(Vec::new());
    image.write().to_buffered(&mut file).unwrap();
    file.into_inner()
}

pub fn floats(values: &[f32]) -> FlatSamples {
    FlatSamples::F32(values.to_vec())
}

pub fn halves(values: &[f32]) -> FlatSamples {
    FlatSamples::F16(values.iter().map(|&x| exr::prelude::f16::from_f32(x)).collect())
}

/// A PNG of one colour.
pub fn flat(size: [usize; 2], color: [u8; 3]) -> Vec<u8> {
    png(size, |_, _| color)
}

pub fn files(files: &[(&str, Vec<u8>)]) -> Files {
    files.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.clone())).collect()
}

pub fn open(list: &[(&str, Vec<u8>)]) -> Result<Folder, Error> {
    Folder::from_files("wood", files(list))
}

pub fn maps(list: &[(&str, Vec<u8>)]) -> Maps {
    open(list).unwrap().maps(Size::Own, MEMORY).unwrap()
}

/// What a folder is refused with, wherever that happens.
pub fn refusal(list: &[(&str, Vec<u8>)]) -> String {
    let maps = open(list).and_then(|folder| folder.maps(Size::Own, MEMORY));
    let message = maps.map(|maps| maps.findings).expect_err("it should be refused").to_string();
    assert!(!message.contains('\n'), "one line: {message}");
    message
}

/// Findings in words.
pub fn said(folder: &Folder) -> String {
    folder.findings().iter().map(|finding| format!("{finding}\n")).collect()
}
