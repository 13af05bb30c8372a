#pragma once

#include <limits>

#include <mitsuba/core/spectrum.h>
#include <mitsuba/core/vector.h>

namespace glimt {

namespace dr = drjit;

/**
 * \brief The analytic BRDF as Dr.Jit traces it: k_d/π + F D G / (4 cosθ_l cosθ_v)
 *
 * The counterpart of rust/core/src/microfacet.rs, in the same forms; the reasons for them stand there.
 */
template <typename Float> struct TracedMicrofacet {
    using Vector2f = mitsuba::Vector<Float, 2>;
    using Vector3f = mitsuba::Vector<Float, 3>;
    using Color3f  = mitsuba::Color<Float, 3>;

    /// Diffuse albedo.
    Color3f kd;
    /// Relative index of refraction.
    Color3f eta;
    /// GGX roughness along x and y.
    Vector2f alpha;

    /// f_a for two directions above the horizon.
    Color3f eval(const Vector3f &light, const Vector3f &view) const {
        Vector3f half = half_vector(light, view);
        Float cos_d = dr::minimum(.5f * dr::norm(half), 1.f);
        Float specular = ndf(half, alpha) /
                         (masking_denominator(light, alpha) * masking_denominator(view, alpha));
        return dr::fmadd(kd, dr::InvPi<Float>, fresnel(cos_d, eta) * specular);
    }

    /// The half vector, not normalised.
    static Vector3f half_vector(const Vector3f &light, const Vector3f &view) {
        Vector3f sum = light + view;
        return { sum.x(), sum.y(), dr::maximum(sum.z(), MinSumZ) };
    }

    /// D of the GGX distribution; \c half need not have unit length.
    static Float ndf(const Vector3f &half, const Vector2f &alpha) {
        Float x = half.x() / alpha.x(), y = half.y() / alpha.y(), z = half.z();
        Float r = dr::squared_norm(half) / dr::maximum(x * x + y * y + z * z, Tiny);
        return r * r / (dr::Pi<Float> * alpha.x() * alpha.y());
    }

    /// cosθ + √(cos²θ + (α_x x)² + (α_y y)²): Smith's G₁ is 2 cosθ over this.
    static Float masking_denominator(const Vector3f &direction, const Vector2f &alpha) {
        Float x = direction.x() * alpha.x(), y = direction.y() * alpha.y(), z = direction.z();
        return dr::maximum(z + dr::sqrt(z * z + x * x + y * y), Tiny);
    }

    /// Reflectance of a smooth dielectric of index \c eta ≥ 1 from outside.
    static Color3f fresnel(const Float &cos, const Color3f &eta) {
        Color3f excess = (eta - 1.f) * (eta + 1.f);
        Color3f sum = dr::maximum(dr::sqrt(excess + cos * cos) + cos, Tiny);
        Color3f difference = excess / sum;
        Color3f ratio = difference / sum;
        Color3f parallel = (cos * sum - 1.f) / (cos * difference + 1.f);
        return .5f * ratio * ratio * (1.f + parallel * parallel);
    }

private:
    static constexpr float Tiny = std::numeric_limits<float>::min(), MinSumZ = 1e-18f;
};

} // namespace glimt
