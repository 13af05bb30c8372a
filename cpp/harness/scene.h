// A scene as the path tracer sees it.
#pragma once

#include <optional>
#include <string>

#include "bsdf.h"
#include "emitter.h"

namespace harness {

/// A triangle mesh in world space.
struct Mesh {
    std::vector<Vec> positions;
    std::vector<Vec> normals;     ///< one for each vertex, or none: the mesh is flat
    std::vector<std::array<float, 2>> uvs; ///< one for each vertex, or none
    std::vector<std::array<std::uint32_t, 3>> triangles;
};

struct Sphere {
    Vec center;
    float radius = 1;
};

/// A mesh or a sphere with its surface.
struct Shape {
    std::optional<Sphere> sphere;
    Mesh mesh;
    std::shared_ptr<const Bsdf> bsdf;
    Vec radiance; ///< emitted on the side of the normal; 0 if it emits nothing
    bool emits() const { return radiance.max() > 0; }
};

/// A perspective camera that looks along +z of `to_world`, with +y up and +x left.
struct Camera {
    Transform to_world;
    float tan_half_x = 1; ///< of half the horizontal field of view
    int width = 256, height = 256;
};

struct Scene {
    std::vector<Shape> shapes;
    std::optional<Environment> environment;
    Camera camera;
    int max_depth = 6;
    int spp = 64;
};

/// What replaces parts of a scene file.
struct Overrides {
    std::vector<std::pair<std::string, std::string>> parameters; ///< $names of the file
    Fault fault = Fault::none;
};

/// Reads the subset of Mitsuba's scene XML that load.cpp lists. Throws std::runtime_error, with the file and what
/// in it is not understood, or glimt::Error.
Scene load_scene(const std::string &path, const Overrides &overrides);

/// Reads a PLY file, ASCII or binary little-endian. Throws std::runtime_error.
Mesh load_ply(const std::string &path);

} // namespace harness
