//! OpenEXR files, read some rows at a time.

use std::fs::File;
use std::io::{BufReader, Cursor};
use std::ops::Range;
use std::path::{Path, PathBuf};

use exr::block::reader::ChunksReader;
use exr::meta::attribute::SampleType;
use exr::prelude::{AnyChannel, AnyChannels, FlatSamples, WritableImage, f16};
use glimt_disk::write_whole;
use smallvec::SmallVec;

use crate::{Error, Image, Rgb, Rows};

/// Three channels of an OpenEXR file of one layer, in scan lines or tiles of any compression.
#[derive(Clone, Debug)]
pub struct Exr {
    path: PathBuf,
    size: [usize; 2],
    /// Positions of the three channels in the file's list.
    channels: [usize; 3],
}

impl Exr {
    /// The channels `{prefix}R`, `{prefix}G` and `{prefix}B` of a file: the prefix is empty for the image itself.
    ///
    /// # Errors
    /// [`Error::Read`] if the file cannot be read, or has several layers or no such channels.
    pub fn open(path: impl AsRef<Path>, prefix: &str) -> Result<Self, Error> {
        let path = path.as_ref().to_path_buf();
        let broken = |reason: String| Error::Read { path: path.clone(), reason };
        let reader = reader(&path)?;
        let [header] = reader.headers() else {
            return Err(broken(format!("it has {} layers, expected one", reader.headers().len())));
        };
        let names: Vec<String> =
            header.channels.list.iter().map(|channel| channel.name.to_string()).collect();
        let position = |component: &str| {
            let wanted = format!("{prefix}{component}");
            names.iter().position(|name| *name == wanted).ok_or_else(|| {
                broken(format!("it has no channel \"{wanted}\"; its channels are {}", names.join(", ")))
            })
        };
        let channels = [position("R")?, position("G")?, position("B")?];
        let size = [header.layer_size.0, header.layer_size.1];
        Ok(Exr { path: path.clone(), size, channels })
    }
}

fn reader(path: &Path) -> Result<exr::block::reader::Reader<BufReader<File>>, Error> {
    let broken = |reason: String| Error::Read { path: path.to_path_buf(), reason };
    let file = File::open(path).map_err(|e| broken(e.to_string()))?;
    exr::block::read(BufReader::new(file), false).map_err(|e| broken(e.to_string()))
}

impl Rows for Exr {
    fn size(&self) -> [usize; 2] {
        self.size
    }

    fn read(&self, rows: Range<usize>) -> Result<Vec<Rgb>, Error> {
        let broken = |e: exr::error::Error| Error::Read { path: self.path.clone(), reason: e.to_string() };
        let reader = reader(&self.path)?;
        let list = reader.headers()[0].channels.clone();
        let chunks = reader
            .filter_chunks(false, |_, _, block| {
                let top = block.pixel_position.y();
                block.level == exr::math::Vec2(0, 0)
                    && top < rows.end
                    && top + block.pixel_size.y() > rows.start
            })
            .map_err(broken)?;
        let outside = || Error::Read {
            path: self.path.clone(),
            reason: "it has a block that lies outside of the image".to_owned(),
        };
        let width = self.size[0];
        let mut pixels = vec![[0.0; 3]; rows.len() * width];
        let mut blocks = chunks.sequential_decompressor(false);
        while let Some(block) = blocks.decompress_next_block() {
            let block = block.map_err(broken)?;
            for line in block.lines(&list) {
                let (x, y) = (line.location.position.x(), line.location.position.y());
                let Some(component) = self.channels.iter().position(|&c| c == line.location.channel) else {
                    continue;
                };
                if !rows.contains(&y) {
                    continue;
                }
                let row = &mut pixels[(y - rows.start) * width..][..width];
                let row = row.get_mut(x..).and_then(|row| row.get_mut(..line.location.sample_count));
                let row = row.ok_or_else(outside)?;
                match list.list[line.location.channel].sample_type {
                    SampleType::F32 => fill(row, component, line.read_samples::<f32>()).map_err(broken)?,
                    SampleType::F16 => {
                        let samples = line.read_samples::<f16>().map(|x| x.map(f32::from));
                        fill(row, component, samples).map_err(broken)?;
                    }
                    SampleType::U32 => {
                        let samples = line.read_samples::<u32>().map(|x| x.map(|x| x as f32));
                        fill(row, component, samples).map_err(broken)?;
                    }
                }
            }
        }
        Ok(pixels)
    }
}

fn fill(
    row: &mut [Rgb],
    component: usize,
    samples: impl Iterator<Item = exr::error::Result<f32>>,
) -> exr::error::Result<()> {
    for (pixel, sample) in row.iter_mut().zip(samples) {
        pixel[component] = sample?;
    }
    Ok(())
}

/// Writes images of one size as one layer of float32 channels; each image has a prefix of its channels' names,
/// empty for the image itself. The file is whole or as it was.
///
/// # Errors
/// [`Error::Write`].
///
/// # Panics
/// If the images differ in size, or there is none.
pub fn write(path: &Path, images: &[(&str, &Image)]) -> Result<(), Error> {
    let [width, height] = images[0].1.size();
    let mut channels = SmallVec::new();
    for (prefix, image) in images {
        assert!(image.size() == [width, height], "images of one size");
        for (i, component) in ["R", "G", "B"].into_iter().enumerate() {
            let samples = image.pixels().iter().map(|pixel| pixel[i]).collect();
            let name = format!("{prefix}{component}");
            channels.push(AnyChannel::new(name.as_str(), FlatSamples::F32(samples)));
        }
    }
    let image = exr::image::Image::from_channels((width, height), AnyChannels::sort(channels));
    let failed = |reason: String| Error::Write { path: path.to_path_buf(), reason };
    let mut file = Cursor::new(Vec::new());
    image.write().to_buffered(&mut file).map_err(|e| failed(e.to_string()))?;
    write_whole(path, file.get_ref()).map_err(|e| failed(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient(width: usize, height: usize) -> Image {
        let pixel = |i: usize| [i as f32, 0.5 * i as f32, -(i as f32)];
        Image::new(width, (0..width * height).map(pixel).collect())
    }

    #[test]
    fn any_rows_come_back_as_they_were_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("image.exr");
        let (image, variance) = (gradient(37, 101), gradient(37, 101));
        write(&path, &[("", &image), ("variance.", &variance)]).unwrap();
        for prefix in ["", "variance."] {
            let exr = Exr::open(&path, prefix).unwrap();
            assert_eq!(exr.size(), [37, 101]);
            for rows in [0..101, 0..1, 100..101, 13..57] {
                assert_eq!(exr.read(rows.clone()).unwrap(), image.read(rows).unwrap());
            }
        }
    }

    #[test]
    fn what_is_no_image_is_refused_with_its_name_and_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("broken.exr");
        let refused = |prefix: &str| Exr::open(&path, prefix).unwrap_err().to_string();
        assert!(refused("").contains("broken.exr"));
        std::fs::write(&path, b"no image at all").unwrap();
        assert!(refused("").contains("broken.exr"));
        write(&path, &[("", &gradient(3, 2))]).unwrap();
        assert!(refused("variance.").contains("no channel \"variance.R\"; its channels are B, G, R"));
        let message = write(&folder.path().join("none/a.exr"), &[("", &gradient(3, 2))]).unwrap_err();
        assert!(message.to_string().contains("cannot write"));
    }

    /// Every byte of a small file, changed in turn: an error or an image, but no panic.
    #[test]
    fn damaged_files_are_an_error_or_an_image() {
        let folder = tempfile::tempdir().unwrap();
        let (whole, path) = (folder.path().join("whole.exr"), folder.path().join("damaged.exr"));
        write(&whole, &[("", &gradient(5, 20))]).unwrap();
        let bytes = std::fs::read(&whole).unwrap();
        let mut refused = 0;
        for at in 0..bytes.len() {
            for change in [1, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] ^= change;
                std::fs::write(&path, damaged).unwrap();
                let read = Exr::open(&path, "").and_then(|exr| exr.read(0..exr.size()[1].min(20)));
                refused += usize::from(read.is_err());
            }
        }
        assert!(refused > bytes.len() / 4, "{refused} of {} refused", 3 * bytes.len());
    }
}
