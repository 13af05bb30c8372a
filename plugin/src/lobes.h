#pragma once

#include <limits>

#include <mitsuba/core/vector.h>

#include "glimt-mitsuba/src/bridge.rs.h"
#include "microfacet.h"

namespace glimt {

namespace dr = drjit;

/**
 * \brief The sampler of every glimt model as Dr.Jit traces it: the visible normals of GGX distributions and a
 * cosine lobe, mixed in shares that follow the view
 *
 * The counterpart of rust/core/src/sampling/lobes, number for number.
 */
template <typename Float> struct TracedLobes {
    using Mask     = dr::mask_t<Float>;
    using UInt32   = dr::uint32_array_t<Float>;
    using Vector2f = mitsuba::Vector<Float, 2>;
    using Vector3f = mitsuba::Vector<Float, 3>;
    using Point2f  = mitsuba::Point<Float, 2>;
    using Storage  = mitsuba::DynamicBuffer<Float>;

    /// Number of GGX lobes; the cosine lobe comes after them.
    static constexpr size_t GgxLobes = 4;
    /// Probability of each lobe.
    using Shares = dr::Array<Float, GgxLobes + 1>;

    TracedLobes() = default;

    /// The lobes that the core chose, as it hands them over.
    explicit TracedLobes(const core::Lobes &lobes)
        : m_shares(dr::load<Storage>(lobes.shares.data(), lobes.shares.size())),
          m_last_knot((uint32_t) (lobes.shares.size() / (GgxLobes + 1)) - 1) {
        for (size_t i = 0; i < 2 * GgxLobes; ++i)
            m_alpha[i] = lobes.alpha[i];
        // Values that are not literals, so that a change of them compiles no new kernel.
        dr::make_opaque(m_alpha, m_shares);
    }

    /// Density (sr⁻¹) of \c light, both directions above the horizon.
    Float pdf(const Vector3f &light, const Vector3f &view, const Mask &active) const {
        return pdf(light, view, shares(view, active));
    }

    /// Chooses a light direction, which failed where it is below the horizon. Also, its density.
    std::pair<Vector3f, Float> sample(const Vector3f &view, const Float &u_lobe, const Point2f &u,
                                      const Mask &active) const {
        Shares share = shares(view, active);
        Vector2f chosen = alpha(0);
        Float below = share[0];
        for (size_t i = 1; i < GgxLobes; ++i) {
            chosen = dr::select(u_lobe < below, chosen, alpha(i));
            below += share[i];
        }
        Mask specular = u_lobe < below;
        // All lobes turn a point of a disc or a cap by the same azimuth, so that one sine serves them.
        auto [sin_phi, cos_phi] = dr::sincos(dr::TwoPi<Float> * dr::select(specular, u.x(), u.y()));
        Vector3f light = dr::select(specular, visible_normal(chosen, view, u.y(), sin_phi, cos_phi),
                                    cosine(u.x(), sin_phi, cos_phi));
        return { light, pdf(light, view, share) };
    }

private:
    /// Roughness of a GGX lobe along x and y.
    Vector2f alpha(size_t lobe) const { return { m_alpha[2 * lobe], m_alpha[2 * lobe + 1] }; }

    /// The shares at a view, linear between the knots.
    Shares shares(const Vector3f &view, const Mask &active) const {
        // Not the root of 0, which has no derivative.
        Float cosine = dr::clip(view.z(), Tiny, 1.f), rest_root = dr::sqrt(dr::maximum(1.f - view.z(), Tiny));
        // 1 − √(1 − cosθ) is written so that grazing views keep their digits.
        Float place = (dr::sqrt(cosine) + cosine / (1.f + rest_root)) * (.5f * (float) m_last_knot);
        UInt32 knot = dr::minimum(UInt32(place), m_last_knot - 1);
        Float t = place - Float(knot);
        Shares below = dr::gather<Shares>(m_shares, knot, active),
               above = dr::gather<Shares>(m_shares, knot + 1, active);
        return dr::fmadd(t, above - below, below);
    }

    Float pdf(const Vector3f &light, const Vector3f &view, const Shares &share) const {
        using Microfacet = TracedMicrofacet<Float>;
        Vector3f half = Microfacet::half_vector(light, view);
        Float density = share[GgxLobes] * light.z() * dr::InvPi<Float>;
        for (size_t i = 0; i < GgxLobes; ++i)
            density += share[i] * .5f * Microfacet::ndf(half, alpha(i)) /
                       Microfacet::masking_denominator(view, alpha(i));
        // At the horizon it can be less than float32 holds, and must not be 0 where f is not.
        return dr::maximum(density, Tiny);
    }

    static Vector3f cosine(const Float &u, const Float &sin_phi, const Float &cos_phi) {
        Float r = dr::sqrt(u);
        return { r * cos_phi, r * sin_phi, dr::sqrt(dr::maximum(1.f - u, 0.f)) };
    }

    /// Spherical caps: Dupuy & Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps".
    static Vector3f visible_normal(const Vector2f &alpha, const Vector3f &view, const Float &u,
                                   const Float &sin_phi, const Float &cos_phi) {
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

    static constexpr float Tiny = std::numeric_limits<float>::min();

    /// Roughnesses of the GGX lobes, each along x and y.
    dr::Array<Float, 2 * GgxLobes> m_alpha;
    /// Shares at every knot.
    Storage m_shares;
    uint32_t m_last_knot = 1;

public:
    DRJIT_TRAVERSE(TracedLobes, m_alpha, m_shares)
};

} // namespace glimt
