#pragma once

#include <mitsuba/core/vector.h>

#include "microfacet.h"

namespace glimt {

namespace dr = drjit;

/**
 * \brief The sampler of every glimt model as Dr.Jit traces it: a cosine lobe mixed with the visible
 * normals of a GGX distribution
 *
 * The counterpart of rust/core/src/lobes.rs, number for number.
 */
template <typename Float> struct TracedLobes {
    using Vector2f = mitsuba::Vector<Float, 2>;
    using Vector3f = mitsuba::Vector<Float, 3>;
    using Point2f  = mitsuba::Point<Float, 2>;

    /// GGX roughness along x and y.
    Vector2f alpha;
    /// Probability of the GGX lobe.
    Float specular_weight;

    DRJIT_TRAVERSE(TracedLobes, alpha, specular_weight)

    /// Density (sr⁻¹) of \c light, both directions above the horizon.
    Float pdf(const Vector3f &light, const Vector3f &view) const {
        using Microfacet = TracedMicrofacet<Float>;
        Float diffuse = light.z() * dr::InvPi<Float>;
        Float specular = .5f * Microfacet::ndf(Microfacet::half_vector(light, view), alpha) /
                         Microfacet::masking_denominator(view, alpha);
        return (1.f - specular_weight) * diffuse + specular_weight * specular;
    }

    /// Chooses a light direction, which failed where it is below the horizon.
    Vector3f sample(const Vector3f &view, const Float &u_lobe, const Point2f &u) const {
        // Both lobes turn a point of a disc or a cap by the same azimuth, so that one sine serves both.
        auto specular = u_lobe < specular_weight;
        auto [sin_phi, cos_phi] = dr::sincos(dr::TwoPi<Float> * dr::select(specular, u.x(), u.y()));
        return dr::select(specular, visible_normal(view, u.y(), sin_phi, cos_phi),
                          cosine(u.x(), sin_phi, cos_phi));
    }

private:
    static Vector3f cosine(const Float &u, const Float &sin_phi, const Float &cos_phi) {
        Float r = dr::sqrt(u);
        return { r * cos_phi, r * sin_phi, dr::sqrt(dr::maximum(1.f - u, 0.f)) };
    }

    /// Spherical caps: Dupuy & Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps".
    Vector3f visible_normal(const Vector3f &view, const Float &u, const Float &sin_phi,
                            const Float &cos_phi) const {
        Vector3f stretch(alpha.x(), alpha.y(), 1.f);
        Vector3f standard_view = dr::normalize(view * stretch);
        // Without differences that cancel, see the core.
        Float x = standard_view.x(), y = standard_view.y(), above = 1.f + standard_view.z();
        Float height = (1.f - u) * above;
        Float r = dr::sqrt(dr::maximum(u * (x * x + y * y + above * height), 0.f));
        Vector3f sum(r * cos_phi + x, r * sin_phi + y, height);
        Vector3f half = dr::normalize(sum * stretch);
        return 2.f * dr::dot(view, half) * half - view;
    }
};

} // namespace glimt
