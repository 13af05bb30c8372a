// Prints the directional albedo of every material of a library, by importance sampling.
//
//     albedo LIBRARY.safetensors

#include <cmath>
#include <cstdio>
#include <random>

#include <glimt/glimt.hpp>

namespace {

/// Mean weight of samples for a view at `theta` radians from the normal.
glimt::Vec3 albedo(const glimt::Material &material, float theta, int samples) {
    const glimt::Vec3 view{std::sin(theta), 0.0f, std::cos(theta)};
    std::mt19937 random(1);
    std::uniform_real_distribution<float> uniform(0.0f, std::nextafter(1.0f, 0.0f));
    glimt::Vec3 sum{};
    for (int i = 0; i < samples; ++i) {
        const glimt::Vec3 u{uniform(random), uniform(random), uniform(random)};
        const glimt::Sample sample = material.sample(view, u);
        for (std::size_t channel = 0; channel < 3; ++channel)
            sum[channel] += sample.weight[channel];
    }
    for (float &channel : sum)
        channel /= static_cast<float>(samples);
    return sum;
}

} // namespace

int main(int argc, char **argv) {
    if (argc != 2) {
        std::fprintf(stderr, "usage: %s LIBRARY.safetensors\n", argv[0]);
        return 2;
    }
    try {
        const glimt::Library library(argv[1]);
        std::printf("%s, %zu materials\n", library.kind().c_str(), library.size());
        for (const std::string &name : library.names()) {
            const glimt::Material material = library.material(name);
            for (const float degrees : {0.0f, 45.0f, 75.0f}) {
                const glimt::Vec3 a = albedo(material, degrees * 3.14159265f / 180.0f, 10000);
                std::printf("%s at %2.0f degrees: %.4f %.4f %.4f\n", name.c_str(), degrees, a[0], a[1], a[2]);
            }
        }
    } catch (const glimt::Error &error) {
        std::fprintf(stderr, "error: %s\n", error.what());
        return 1;
    }
    return 0;
}
