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

use crate::c_api::glimt_status::{self, *};
use crate::c_api::{call, fail, hand_out, missing, string};

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
        if image.is_null() {
            return missing("image");
        }
        // SAFETY: the header asks for strings that end with a zero byte.
        let path = match unsafe { string(path, "path") } {
            Ok(path) => path,
            Err(status) => return status,
        };
        match Exr::open(path, "").and_then(|exr| Image::hold(&exr)) {
            // SAFETY: the header asks for pointers that can be written; NULL was refused above.
            Ok(read) => unsafe { hand_out(image, glimt_image { image: read }) },
            Err(error) => fail(GLIMT_ERROR_READ, error.to_string()),
        }
    })
}

/// Width of an image in pixels; 0 for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_image_width(image: *const glimt_image) -> usize {
    // SAFETY: the caller promises an image or NULL.
    unsafe { image.as_ref() }.map_or(0, |image| image.image.size()[0])
}

/// Height of an image in pixels; 0 for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_image_height(image: *const glimt_image) -> usize {
    // SAFETY: the caller promises an image or NULL.
    unsafe { image.as_ref() }.map_or(0, |image| image.image.size()[1])
}

/// Linear r, g, b of each pixel, row by row from the top; NULL for NULL. The image owns them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_image_pixels(image: *const glimt_image) -> *const f32 {
    // SAFETY: the caller promises an image or NULL.
    unsafe { image.as_ref() }.map_or(std::ptr::null(), |image| image.image.pixels().as_ptr().cast())
}

/// Releases an image; NULL is let pass.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn glimt_image_release(image: *mut glimt_image) {
    if !image.is_null() {
        // SAFETY: the caller promises an image that was read here and is used no more.
        drop(unsafe { Box::from_raw(image) });
    }
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
        if prefixes.is_null() || pixels.is_null() {
            return missing(if prefixes.is_null() { "prefixes" } else { "pixels" });
        }
        if width == 0 || height == 0 || count == 0 {
            return fail(GLIMT_ERROR_ARGUMENT, "width, height and count must not be 0");
        }
        // SAFETY: the header asks for strings that end with a zero byte.
        let path = match unsafe { string(path, "path") } {
            Ok(path) => path,
            Err(status) => return status,
        };
        let mut images = Vec::with_capacity(count);
        for i in 0..count {
            // SAFETY: the header asks for `count` strings and images.
            let (prefix, image) = unsafe { (string(*prefixes.add(i), "a prefix"), *pixels.add(i)) };
            match prefix {
                Ok(_) if image.is_null() => return missing("an image"),
                Ok(prefix) => {
                    // SAFETY: the header asks for width × height pixels.
                    let image = unsafe { std::slice::from_raw_parts(image.cast(), width * height) };
                    images.push((prefix, Image::new(width, image.to_vec())));
                }
                Err(status) => return status,
            }
        }
        let images: Vec<(&str, &Image)> = images.iter().map(|(prefix, image)| (*prefix, image)).collect();
        match exr::write(Path::new(path), &images) {
            Ok(()) => GLIMT_OK,
            Err(error) => fail(GLIMT_ERROR_WRITE, error.to_string()),
        }
    })
}
