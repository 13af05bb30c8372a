// Vectors, frames, affine maps and random numbers.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

namespace harness {

constexpr float pi = 3.14159265358979f;

struct Vec {
    float x = 0, y = 0, z = 0;

    Vec operator+(Vec b) const { return {x + b.x, y + b.y, z + b.z}; }
    Vec operator-(Vec b) const { return {x - b.x, y - b.y, z - b.z}; }
    Vec operator-() const { return {-x, -y, -z}; }
    Vec operator*(Vec b) const { return {x * b.x, y * b.y, z * b.z}; }
    Vec operator*(float s) const { return {x * s, y * s, z * s}; }
    Vec operator/(float s) const { return {x / s, y / s, z / s}; }
    Vec &operator+=(Vec b) { return *this = *this + b; }
    float max() const { return std::max(x, std::max(y, z)); }
};

inline float dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec cross(Vec a, Vec b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline float length(Vec v) { return std::sqrt(dot(v, v)); }
inline Vec normalize(Vec v) { return v / length(v); }

/// A right-handed orthonormal frame around a normal.
struct Frame {
    Vec s, t, n;

    /// With `along` in the plane of s and n; any frame around n if `along` does not tell.
    Frame(Vec normal, Vec along) : n(normal) {
        Vec tangent = along - n * dot(n, along);
        if (dot(tangent, tangent) < 1e-12f)
            tangent = std::abs(n.x) > 0.7f ? Vec{-n.z, 0, n.x} : Vec{0, n.z, -n.y};
        s = normalize(tangent);
        t = cross(n, s);
    }

    Vec to_local(Vec v) const { return {dot(s, v), dot(t, v), dot(n, v)}; }
    Vec to_world(Vec v) const { return s * v.x + t * v.y + n * v.z; }
};

/// An affine map of space.
struct Transform {
    /// Rows of the matrix, the translation last.
    std::array<std::array<float, 4>, 3> m = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};

    Vec vector(Vec v) const {
        return {m[0][0] * v.x + m[0][1] * v.y + m[0][2] * v.z,
                m[1][0] * v.x + m[1][1] * v.y + m[1][2] * v.z,
                m[2][0] * v.x + m[2][1] * v.y + m[2][2] * v.z};
    }
    Vec point(Vec p) const { return vector(p) + Vec{m[0][3], m[1][3], m[2][3]}; }

    /// The map of normals: cofactors, which are the inverse transposed times the determinant.
    Vec normal(Vec n) const {
        const Vec a{m[0][0], m[0][1], m[0][2]}, b{m[1][0], m[1][1], m[1][2]}, c{m[2][0], m[2][1], m[2][2]};
        const Vec v{dot(cross(b, c), n), dot(cross(c, a), n), dot(cross(a, b), n)};
        return normalize(dot(cross(a, b), c) < 0 ? -v : v);
    }

    /// The map that does `first` and then this.
    Transform after(const Transform &first) const {
        Transform result;
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 4; ++j) {
                result.m[i][j] = j == 3 ? m[i][3] : 0;
                for (int k = 0; k < 3; ++k)
                    result.m[i][j] += m[i][k] * first.m[k][j];
            }
        return result;
    }

    /// A direction taken back by a map that is a rotation.
    Vec rotate_back(Vec v) const {
        return {m[0][0] * v.x + m[1][0] * v.y + m[2][0] * v.z,
                m[0][1] * v.x + m[1][1] * v.y + m[2][1] * v.z,
                m[0][2] * v.x + m[1][2] * v.y + m[2][2] * v.z};
    }
};

/// Uniform numbers: O'Neill 2014, PCG-XSH-RR 64/32. Every pixel has a sequence of its own, so that an image does
/// not depend on the threads; it begins at a state that is mixed well (Steele et al. 2014, SplitMix64), since
/// sequences from neighbouring states are alike.
class Random {
public:
    Random(std::uint64_t pixel, std::uint64_t seed) : state_(mix(pixel + mix(seed))) {}

    /// In [0, 1).
    float uniform() { return static_cast<float>(next() >> 8) * 0x1p-24f; }

private:
    static std::uint64_t mix(std::uint64_t z) {
        z += 0x9e3779b97f4a7c15ULL;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
        return z ^ (z >> 31);
    }

    std::uint32_t next() {
        const std::uint64_t old = state_;
        state_ = old * 6364136223846793005ULL + 1442695040888963407ULL;
        const auto shifted = static_cast<std::uint32_t>(((old >> 18) ^ old) >> 27);
        const auto turn = static_cast<std::uint32_t>(old >> 59);
        return (shifted >> turn) | (shifted << ((-turn) & 31));
    }

    std::uint64_t state_;
};

/// A cosine-distributed direction around +z (Malley's method).
inline Vec cosine_direction(float u, float v) {
    const float r = std::sqrt(u), phi = 2 * pi * v;
    return {r * std::cos(phi), r * std::sin(phi), std::sqrt(std::max(0.f, 1 - u))};
}

} // namespace harness
