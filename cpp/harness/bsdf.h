// Surfaces. Directions are in the local frame and point away from the surface.
#pragma once

#include <memory>
#include <optional>

#include <glimt/glimt.hpp>

#include "image.h"

namespace harness {

/// What a path takes from a surface.
struct BsdfSample {
    Vec light;
    float pdf = 0;
    Vec weight; ///< f cosθ / pdf
};

/// A way to break a surface, to see that a comparison of images finds it.
enum class Fault {
    none,
    cosine, ///< the cosine is left out of f
    swap,   ///< light and view are exchanged
    pdf,    ///< the density is that of the cosine, whatever the sampler does
};

/// A surface that reflects on the side of its normal, or on both.
class Bsdf {
public:
    virtual ~Bsdf() = default;

    /// f cosθ_light at the point of the surface with texture coordinates u, v.
    Vec eval(Vec light, Vec view, float u, float v) const;
    /// Density with which sample() chooses light.
    float pdf(Vec light, Vec view) const;
    /// A light direction from three uniform numbers.
    BsdfSample sample(Vec view, float u, float v, std::array<float, 3> numbers) const;

    bool two_sided = false;
    Fault fault = Fault::none;

protected:
    /// f without the cosine; both directions are above the horizon.
    virtual Vec reflectance(Vec light, Vec view, float u, float v) const = 0;
    virtual float density(Vec light, Vec view) const = 0;
    /// A direction; its z is not positive if sampling failed.
    virtual Vec direction(Vec view, std::array<float, 3> numbers) const = 0;

private:
    /// Whether both directions see the same lit side; turns them to it.
    bool to_front(Vec &light, Vec &view) const;
};

/// Lambert's: a constant, or a texture.
class Diffuse : public Bsdf {
public:
    Vec color{0.5f, 0.5f, 0.5f};
    std::shared_ptr<const Image> texture;

protected:
    Vec reflectance(Vec light, Vec view, float u, float v) const override;
    float density(Vec light, Vec view) const override;
    Vec direction(Vec view, std::array<float, 3> numbers) const override;
};

/// A material of glimt.
class Glimt : public Bsdf {
public:
    explicit Glimt(glimt::Material material) : material_(std::move(material)) {}

protected:
    Vec reflectance(Vec light, Vec view, float u, float v) const override;
    float density(Vec light, Vec view) const override;
    Vec direction(Vec view, std::array<float, 3> numbers) const override;

private:
    glimt::Material material_;
};

} // namespace harness
