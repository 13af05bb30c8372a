// Ray casting with Embree.
#pragma once

#include <memory>

#include "scene.h"

namespace harness {

struct Ray {
    Vec origin, direction;
};

/// A point of a surface that a ray has met.
struct Hit {
    const Shape *shape = nullptr;
    std::size_t shape_index = 0;
    float distance = 0;
    Vec position;
    Vec normal;   ///< of the surface itself
    Frame shading{{0, 0, 1}, {}}; ///< of the interpolated normal, along the first texture coordinate
    float u = 0, v = 0;

    /// A ray that leaves the surface.
    Ray spawn(Vec direction) const;
};

/// The shapes of a scene, ready to be met by rays.
class Tracer {
public:
    explicit Tracer(const Scene &scene);
    ~Tracer();

    std::optional<Hit> closest(const Ray &ray) const;
    /// Whether anything lies between the ray's origin and `distance` along it.
    bool blocked(const Ray &ray, float distance) const;

private:
    struct Embree;
    const Scene &scene_;
    std::unique_ptr<Embree> embree_;
};

} // namespace harness
