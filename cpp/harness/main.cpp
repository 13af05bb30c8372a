// harness: renders a scene file with glimt's materials in a renderer that is not Mitsuba.
//
//     harness SCENE.xml -o IMAGE.exr [--spp N] [--seed N] [-D name=value]... [--fault cosine|swap|pdf]
//
// A small path tracer, linked against the C++ header as any renderer would be. The image holds the variance of
// each pixel's mean, so that `glimt compare` can tell noise from error. --fault breaks the materials of glimt, to
// see that a comparison finds it.

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "path.h"

namespace {

[[noreturn]] void usage() {
    std::fprintf(stderr, "usage: harness SCENE.xml -o IMAGE.exr [--spp N] [--seed N] [-D name=value]... [--fault cosine|swap|pdf]\n");
    std::exit(2);
}

harness::Fault fault(const std::string &name) {
    if (name == "cosine")
        return harness::Fault::cosine;
    if (name == "swap")
        return harness::Fault::swap;
    if (name == "pdf")
        return harness::Fault::pdf;
    usage();
}

} // namespace

int main(int argc, char **argv) {
    std::string scene_path, image_path;
    harness::Overrides overrides;
    int spp = 0;
    std::uint64_t seed = 0;
    for (int i = 1; i < argc; ++i) {
        const std::string argument = argv[i];
        const auto value = [&]() -> std::string {
            if (++i >= argc)
                usage();
            return argv[i];
        };
        if (argument == "-o")
            image_path = value();
        else if (argument == "--spp")
            spp = std::atoi(value().c_str());
        else if (argument == "--seed")
            seed = std::strtoull(value().c_str(), nullptr, 10);
        else if (argument == "--fault")
            overrides.fault = fault(value());
        else if (argument == "-D") {
            const std::string pair = value();
            const std::size_t equals = pair.find('=');
            if (equals == std::string::npos)
                usage();
            overrides.parameters.emplace_back(pair.substr(0, equals), pair.substr(equals + 1));
        } else if (scene_path.empty() && argument[0] != '-')
            scene_path = argument;
        else
            usage();
    }
    if (scene_path.empty() || image_path.empty() || spp < 0)
        usage();
    try {
        const harness::Scene scene = harness::load_scene(scene_path, overrides);
        const auto start = std::chrono::steady_clock::now();
        const harness::Rendering rendering = harness::render(scene, spp > 0 ? spp : scene.spp, seed);
        const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
        harness::write_exr(image_path, rendering.mean, rendering.variance);
        std::printf("%s: %d x %d pixels, %d spp, %.2f s\n", image_path.c_str(), scene.camera.width,
                    scene.camera.height, spp > 0 ? spp : scene.spp, seconds.count());
    } catch (const std::exception &error) {
        std::fprintf(stderr, "error: %s\n", error.what());
        return 1;
    }
    return 0;
}
