//! The C interface of images, `cpp/include/glimt/image.h`. The comments here are those of the header, which is
//! generated from this file; `tests/c_header.rs` says how.

// Types are spelled as in C.
#![allow(non_camel_case_types)]
// The header says once what every pointer must be, and that is the promise that the calls rely on.
#![allow(clippy::missing_safety_doc)]

use std::ffi::c_char;
use std::path::Path;

use ::glimt_image::exr::{self, Exr};
use ::glimt_image::{Image, Rows};

use crate::pointer::{Held, In, Out};
use crate::status::glimt_status::{self, *};
use crate::status::{call, fail};

/// An image in memory. Immutable: any number of threads may use it at once.
pub struct glimt_image {
    image: Image,
}

/// Reads the channels R, G and B of an OpenEXR file of one layer.
///
/// \param path   File name, UTF-8.
/// \param image  Receives the image, to be released with glimt_image_release().
///
/// \return GLIMT_OK; GLIMT_ERROR_READ if the file cannot be read or is no such image; GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_image_read(path: *const c_char, image: *mut *mut glimt_image) -> glimt_status {
    call(|| {
        let image = Out(image).empty("image")?;
        let path = In(path).str("path")?;
        let read = Exr::open(path, "").and_then(|exr| Image::hold(&exr));
        let read = read.map_err(|error| fail(GLIMT_ERROR_READ, error.to_string()))?;
        image.give(glimt_image { image: read }, "image")
    })
}

/// Width of an image in pixels; 0 for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_image_width(image: *const glimt_image) -> usize {
    In(image).optional().map_or(0, |image| image.image.size()[0])
}

/// Height of an image in pixels; 0 for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_image_height(image: *const glimt_image) -> usize {
    In(image).optional().map_or(0, |image| image.image.size()[1])
}

/// Linear r, g, b of each pixel, row by row from the top; NULL for NULL. The image owns them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_image_pixels(image: *const glimt_image) -> *const f32 {
    In(image).optional().map_or(std::ptr::null(), |image| image.image.pixels().as_ptr().cast())
}

/// Releases an image; NULL is ignored.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_image_release(image: *mut glimt_image) {
    Held(image).release();
}

/// Writes images of one size as channels of an OpenEXR file.
///
/// \param path      File name, UTF-8.
/// \param width     Width in pixels, at least 1.
/// \param height    Height in pixels, at least 1.
/// \param count     Number of images, at least 1.
/// \param prefixes  `count` strings: image i is written as the channels prefixes[i]R, prefixes[i]G, prefixes[i]B.
/// \param pixels    `count` images: r, g, b of each pixel, row by row from the top.
///
/// \return GLIMT_OK; GLIMT_ERROR_WRITE if the file cannot be written; GLIMT_ERROR_ARGUMENT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_image_write(
    path: *const c_char,
    width: usize,
    height: usize,
    count: usize,
    prefixes: *const *const c_char,
    pixels: *const *const f32,
) -> glimt_status {
    call(|| {
        if width == 0 || height == 0 || count == 0 {
            return Err(fail(GLIMT_ERROR_ARGUMENT, "width, height and count must not be 0"));
        }
        let size = width.checked_mul(height);
        let size = size.ok_or_else(|| fail(GLIMT_ERROR_ARGUMENT, "an image has more pixels than memory"))?;
        let path = In(path).str("path")?;
        let prefixes = In(prefixes).slice(count, "prefixes")?;
        let mut images = Vec::with_capacity(count);
        for (&prefix, &pixels) in prefixes.iter().zip(In(pixels).slice(count, "pixels")?) {
            let pixels = In(pixels).arrays::<3>().slice(size, "an image")?;
            images.push((In(prefix).str("a prefix")?, Image::new(width, pixels.to_vec())));
        }
        let images: Vec<(&str, &Image)> = images.iter().map(|(prefix, image)| (*prefix, image)).collect();
        exr::write(Path::new(path), &images).map_err(|error| fail(GLIMT_ERROR_WRITE, error.to_string()))
    })
}
