// What lights a scene.
#pragma once

#include <vector>

#include "image.h"

namespace harness {

/// Light that comes from infinitely far: a constant, or an environment map in latitude and longitude.
class Environment {
public:
    /// The same radiance from everywhere.
    explicit Environment(Vec radiance);
    /// An image whose top is +y of `to_world`, which must be a rotation.
    Environment(Image image, const Transform &to_world, float scale);

    Vec radiance(Vec direction) const;

    struct Sample {
        Vec direction;
        float pdf;
    };
    /// A direction in proportion to the radiance of the map's cells.
    Sample sample(float u, float v) const;
    /// Density of sample(), per solid angle.
    float pdf(Vec direction) const;

private:
    struct Coordinates {
        float u, v;
    };
    Coordinates coordinates(Vec direction) const;

    Vec constant_;
    Image image_;
    Transform to_world_;
    /// Sums of the cells' weights along each row, and of the rows' sums, both ending with 1.
    std::vector<float> rows_;
    std::vector<std::vector<float>> columns_;
};

} // namespace harness
