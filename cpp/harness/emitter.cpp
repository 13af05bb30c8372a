#include "emitter.h"

namespace harness {

namespace {

/// The cumulative sums of `weights`, divided by the last.
std::vector<float> cumulative(const std::vector<float> &weights) {
    std::vector<float> sums;
    double sum = 0;
    for (const float weight : weights)
        sums.push_back(static_cast<float>(sum += weight));
    for (float &value : sums)
        value = sum > 0 ? static_cast<float>(value / sum) : 1.f;
    return sums;
}

struct Chosen {
    std::size_t index;
    float probability;
    float rest; ///< the number used, spread over [0, 1) again
};

Chosen choose(const std::vector<float> &sums, float u) {
    auto at = std::upper_bound(sums.begin(), sums.end(), u);
    if (at == sums.end())
        --at;
    const float below = at == sums.begin() ? 0 : *(at - 1);
    const float probability = *at - below;
    return {static_cast<std::size_t>(at - sums.begin()), probability, std::min((u - below) / probability, 0.999999f)};
}

float probability(const std::vector<float> &sums, std::size_t i) { return sums[i] - (i > 0 ? sums[i - 1] : 0); }

} // namespace

Environment::Environment(Vec radiance) : constant_(radiance) {}

Environment::Environment(Image image, const Transform &to_world, float scale)
    : image_(std::move(image)), to_world_(to_world) {
    for (Vec &pixel : image_.pixels)
        pixel = pixel * scale;
    // Cells lie between rows of pixels, as the map runs from pole to pole in its rows, and around pixels in a
    // row. A cell weighs as much as its brightest corner, so that no light within it is missed.
    std::vector<float> sums;
    for (int y = 0; y + 1 < image_.height; ++y) {
        const float theta = pi * (static_cast<float>(y) + 0.5f) / static_cast<float>(image_.height - 1);
        std::vector<float> weights;
        float sum = 0;
        for (int x = 0; x < image_.width; ++x) {
            float brightest = 0;
            for (int dx = -1; dx <= 1; ++dx)
                for (int dy = 0; dy <= 1; ++dy) {
                    const Vec p = image_.at((x + dx + image_.width) % image_.width, y + dy);
                    brightest = std::max(brightest, p.x + p.y + p.z);
                }
            weights.push_back(brightest * std::sin(theta));
            sum += weights.back();
        }
        columns_.push_back(cumulative(weights));
        sums.push_back(sum);
    }
    rows_ = cumulative(sums);
}

Environment::Coordinates Environment::coordinates(Vec direction) const {
    const Vec d = to_world_.rotate_back(direction);
    const float u = std::atan2(d.x, -d.z) / (2 * pi);
    return {u - std::floor(u), std::acos(std::clamp(d.y, -1.f, 1.f)) / pi};
}

Vec Environment::radiance(Vec direction) const {
    if (image_.pixels.empty())
        return constant_;
    const Coordinates at = coordinates(direction);
    // Pixels sit at the centres of columns and, from pole to pole, on the rows themselves.
    const float x = at.u * static_cast<float>(image_.width) - 0.5f;
    const float y = at.v * static_cast<float>(image_.height - 1);
    const int x0 = (static_cast<int>(std::floor(x)) + image_.width) % image_.width;
    const int x1 = (x0 + 1) % image_.width;
    const int y0 = std::min(static_cast<int>(y), image_.height - 2);
    const float fx = x - std::floor(x), fy = y - static_cast<float>(y0);
    return (image_.at(x0, y0) * (1 - fx) + image_.at(x1, y0) * fx) * (1 - fy) +
           (image_.at(x0, y0 + 1) * (1 - fx) + image_.at(x1, y0 + 1) * fx) * fy;
}

Environment::Sample Environment::sample(float u, float v) const {
    if (image_.pixels.empty()) {
        const float z = 1 - 2 * u, r = std::sqrt(std::max(0.f, 1 - z * z)), phi = 2 * pi * v;
        return {{r * std::cos(phi), r * std::sin(phi), z}, 1 / (4 * pi)};
    }
    const Chosen row = choose(rows_, u);
    const Chosen column = choose(columns_[row.index], v);
    const float phi = 2 * pi * (static_cast<float>(column.index) + column.rest) / static_cast<float>(image_.width);
    const float theta = pi * (static_cast<float>(row.index) + row.rest) / static_cast<float>(image_.height - 1);
    const Vec d{std::sin(phi) * std::sin(theta), std::cos(theta), -std::cos(phi) * std::sin(theta)};
    const Vec direction = to_world_.vector(d);
    return {direction, pdf(direction)};
}

float Environment::pdf(Vec direction) const {
    if (image_.pixels.empty())
        return 1 / (4 * pi);
    const Coordinates at = coordinates(direction);
    const auto cell = [](float x, int n) { return std::min(static_cast<std::size_t>(x * static_cast<float>(n)), static_cast<std::size_t>(n - 1)); };
    const std::size_t x = cell(at.u, image_.width), y = cell(at.v, image_.height - 1);
    const float cells = static_cast<float>(image_.width) * static_cast<float>(image_.height - 1);
    const float sin_theta = std::sin(pi * at.v);
    if (sin_theta <= 0)
        return 0;
    return probability(rows_, y) * probability(columns_[y], x) * cells / (2 * pi * pi * sin_theta);
}

} // namespace harness
