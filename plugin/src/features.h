#pragma once

#include <vector>

#include <mitsuba/core/vector.h>

#include "glimt-mitsuba/src/bridge.rs.h"
#include "microfacet.h"

namespace glimt {

namespace dr = drjit;

/**
 * \brief What a network sees of a pair of directions, as Dr.Jit traces it
 *
 * The counterpart of rust/core/src/directions/features.rs, in the same forms; the reasons for them stand there.
 */
template <typename Float> class TracedFeatures {
public:
    using Vector2f = mitsuba::Vector<Float, 2>;
    using Vector3f = mitsuba::Vector<Float, 3>;

    /// The features of one pair above the horizon.
    static std::vector<Float> compute(core::Inputs inputs, const Vector3f &light, const Vector3f &view,
                                      const Vector2f &alpha) {
        if (inputs == core::Inputs::Cartesian)
            return { light.x(), light.y(), light.z(), view.x(), view.y(), view.z() };

        TracedFeatures p(light, view);
        Float lobe = p.lobe(alpha);
        Float sum = light.z() + view.z() - 1.f, product = centre(light.z() * view.z());
        Float cos_2_phi = p.cos_phi_d * p.cos_phi_d - p.sin_phi_d * p.sin_phi_d,
              sin_2_phi = 2.f * p.cos_phi_d * p.sin_phi_d;
        Float x = p.azimuth_h.x() * p.root_h, y = p.azimuth_h.y() * p.root_h;
        switch (inputs) {
            case core::Inputs::Isotropic:
                return { centre(p.root_h),  centre(p.cos_d),  p.cos_phi_d,
                         centre(light.z()), centre(view.z()), lobe };
            case core::Inputs::IsotropicReciprocal:
                return { centre(p.root_h), centre(p.cos_d), cos_2_phi, sum, product, lobe };
            case core::Inputs::Anisotropic:
                return { x,           y,                 centre(p.cos_d),  p.cos_phi_d,
                         p.sin_phi_d, centre(light.z()), centre(view.z()), lobe };
            default: // AnisotropicReciprocal
                return { x, y, centre(p.cos_d), cos_2_phi, sin_2_phi, sum, product, lobe };
        }
    }

private:
    /// Half vector and difference.
    TracedFeatures(const Vector3f &light, const Vector3f &view) {
        Vector3f h = TracedMicrofacet<Float>::half_vector(light, view), d = light - view;
        tangential = Vector2f(h.x() * h.x(), h.y() * h.y());
        height = h.z() * h.z();
        Float across_squared = tangential.x() + tangential.y();
        Float length_squared = across_squared + height;
        Float length = dr::sqrt(length_squared);
        Float one_minus_cos = across_squared / (length_squared + length * h.z());
        Float inverse_across = inverse_or_zero(across_squared);
        azimuth_h = Vector2f(h.x(), h.y()) * inverse_across;
        Float outward = d.x() * azimuth_h.x() + d.y() * azimuth_h.y();
        Float along = (h.z() * outward - root(across_squared) * d.z()) / length;
        Float beside = d.y() * azimuth_h.x() - d.x() * azimuth_h.y();
        Float inverse_d = inverse_or_zero(along * along + beside * beside);
        root_h = root(root(one_minus_cos));
        cos_d = dr::minimum(.5f * length, 1.f);
        cos_phi_d = along * inverse_d;
        sin_phi_d = beside * inverse_d;
    }

    /// ln(1 + tan²θ_h/α²), scaled.
    Float lobe(const Vector2f &alpha) const {
        Float slope = tangential.x() / (alpha.x() * alpha.x()) + tangential.y() / (alpha.y() * alpha.y());
        return LobeScale * dr::log(1.f + dr::minimum(slope / height, MaxSlope));
    }

    static Float centre(const Float &x) { return 2.f * x - 1.f; }

    /// √x, with a derivative of 0 instead of ∞ at x = 0.
    static Float root(const Float &x) {
        return dr::select(x > 0.f, dr::sqrt(dr::select(x > 0.f, x, 1.f)), 0.f);
    }

    /// 1/√x, or 0 where √x is too small for a direction to be scaled by it.
    static Float inverse_or_zero(const Float &x) {
        auto sound = x > MinLength * MinLength;
        return dr::select(sound, dr::rcp(dr::sqrt(dr::select(sound, x, 1.f))), 0.f);
    }

    static constexpr float LobeScale = .2f, MaxSlope = 1e20f, MinLength = 1e-9f;

    /// (1 − cosθ_h)^¼.
    Float root_h;
    /// cos φ_h, sin φ_h.
    Vector2f azimuth_h;
    Float cos_d;
    /// Azimuth of the light about h.
    Float cos_phi_d, sin_phi_d;
    /// h_x², h_y² and h_z² of the half vector that is not normalised.
    Vector2f tangential;
    Float height;
};

} // namespace glimt
