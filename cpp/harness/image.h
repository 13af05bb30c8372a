// Images and textures. Files go through the core.
#pragma once

#include <string>
#include <vector>

#include "geometry.h"

namespace harness {

struct Image {
    int width = 0, height = 0;
    std::vector<Vec> pixels;

    Vec at(int x, int y) const { return pixels[static_cast<std::size_t>(y) * width + x]; }
};

/// Reads R, G, B of an OpenEXR file. Throws glimt::Error.
Image read_exr(const std::string &path);

/// Writes an image and the variance of its pixels' means. Throws glimt::Error.
void write_exr(const std::string &path, const Image &image, const Image &variance);

/// The image at (u, v), bilinear between the centres of its pixels, repeated beyond [0, 1].
Vec lookup_repeated(const Image &image, float u, float v);

} // namespace harness
