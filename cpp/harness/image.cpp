#include "image.h"

#include <glimt/glimt.hpp>
#include <glimt/image.h>

namespace harness {

Image read_exr(const std::string &path) {
    glimt_image *read = nullptr;
    glimt::detail::check(glimt_image_read(path.c_str(), &read));
    Image image;
    image.width = static_cast<int>(glimt_image_width(read));
    image.height = static_cast<int>(glimt_image_height(read));
    const float *rgb = glimt_image_pixels(read);
    for (std::size_t i = 0; i < static_cast<std::size_t>(image.width) * image.height; ++i)
        image.pixels.push_back({rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]});
    glimt_image_release(read);
    return image;
}

void write_exr(const std::string &path, const Image &image, const Image &variance) {
    static_assert(sizeof(Vec) == 3 * sizeof(float), "pixels are handed to C as they are");
    const char *prefixes[] = {"", "variance."};
    const float *pixels[] = {&image.pixels[0].x, &variance.pixels[0].x};
    glimt::detail::check(glimt_image_write(path.c_str(), static_cast<std::size_t>(image.width),
                                           static_cast<std::size_t>(image.height), 2, prefixes, pixels));
}

Vec lookup_repeated(const Image &image, float u, float v) {
    const float x = u * static_cast<float>(image.width) - 0.5f;
    const float y = v * static_cast<float>(image.height) - 0.5f;
    const float fx = x - std::floor(x), fy = y - std::floor(y);
    const auto wrap = [](int i, int n) { return ((i % n) + n) % n; };
    const int x0 = wrap(static_cast<int>(std::floor(x)), image.width), x1 = wrap(x0 + 1, image.width);
    const int y0 = wrap(static_cast<int>(std::floor(y)), image.height), y1 = wrap(y0 + 1, image.height);
    const Vec top = image.at(x0, y0) * (1 - fx) + image.at(x1, y0) * fx;
    const Vec bottom = image.at(x0, y1) * (1 - fx) + image.at(x1, y1) * fx;
    return top * (1 - fy) + bottom * fy;
}

} // namespace harness
