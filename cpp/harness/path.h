// The path integrator: next-event estimation and BSDF sampling, combined by multiple importance sampling.
#pragma once

#include "trace.h"

namespace harness {

/// The mean of `spp` paths in each pixel, and the variance of that mean.
struct Rendering {
    Image mean, variance;
};

/// Renders a scene with all of the machine's threads. The image depends on the seed alone.
Rendering render(const Scene &scene, int spp, std::uint64_t seed);

} // namespace harness
