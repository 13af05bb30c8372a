/* Images of glimt: OpenEXR files for programs that render with it. What glimt.h says of pointers, strings and
   errors holds here.

   Generated from rust/ffi/src/image_api.rs. */

#ifndef GLIMT_IMAGE_H
#define GLIMT_IMAGE_H

#include <stddef.h>
#include "glimt.h"

/**
 * An image in memory. Immutable: any number of threads may use it at once.
 */
typedef struct glimt_image glimt_image;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * Reads the channels R, G and B of an OpenEXR file of one layer.
 *
 * \param path   File name, UTF-8.
 * \param image  Receives the image, to be released with glimt_image_release().
 *
 * \return GLIMT_OK; GLIMT_ERROR_READ if the file cannot be read or is no such image; GLIMT_ERROR_ARGUMENT.
 */
glimt_status glimt_image_read(const char *path,
                              struct glimt_image **image);

/**
 * Width of an image in pixels; 0 for NULL.
 */
size_t glimt_image_width(const struct glimt_image *image);

/**
 * Height of an image in pixels; 0 for NULL.
 */
size_t glimt_image_height(const struct glimt_image *image);

/**
 * Linear r, g, b of each pixel, row by row from the top; NULL for NULL. The image owns them.
 */
const float *glimt_image_pixels(const struct glimt_image *image);

/**
 * Releases an image; NULL is ignored.
 */
void glimt_image_release(struct glimt_image *image);

/**
 * Writes images of one size as channels of an OpenEXR file.
 *
 * \param path      File name, UTF-8.
 * \param width     Width in pixels, at least 1.
 * \param height    Height in pixels, at least 1.
 * \param count     Number of images, at least 1.
 * \param prefixes  `count` strings: image i is written as the channels prefixes[i]R, prefixes[i]G, prefixes[i]B.
 * \param pixels    `count` images: r, g, b of each pixel, row by row from the top.
 *
 * \return GLIMT_OK; GLIMT_ERROR_WRITE if the file cannot be written; GLIMT_ERROR_ARGUMENT.
 */
glimt_status glimt_image_write(const char *path,
                               size_t width,
                               size_t height,
                               size_t count,
                               const char *const *prefixes,
                               const float *const *pixels);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* GLIMT_IMAGE_H */
