#pragma once

#include <utility>

#include "microfacet.h"

namespace glimt {

namespace dr = drjit;

/**
 * \brief What an edit makes of a hybrid material, as Dr.Jit traces it
 *
 * The counterpart of rust/core/src/models/edit.rs, in the same forms; the reasons for them stand there. Where nothing
 * is edited, the pair stays as it is and all ratios are 1.
 */
template <typename Float> struct TracedEdit {
    using Vector2f     = mitsuba::Vector<Float, 2>;
    using Vector3f     = mitsuba::Vector<Float, 3>;
    using Color3f      = mitsuba::Color<Float, 3>;
    using FloatStorage = mitsuba::DynamicBuffer<Float>;
    using Mask         = dr::mask_t<Float>;

    /// The analytic part beside which the network was fitted.
    TracedMicrofacet<Float> fitted;

    /// Light and view as the network is asked about them, where the roughness is now \c alpha.
    std::pair<Vector3f, Vector3f> turn(const Vector3f &light, const Vector3f &view, const Vector2f &alpha) const {
        Vector3f half = TracedMicrofacet<Float>::half_vector(light, view);
        Vector2f wider = dr::maximum(alpha - fitted.alpha, 0.f) * Aside;
        Float across = half.x() * half.x() + half.y() * half.y(), height = half.z() * half.z();
        auto tilted = across > 0.f;
        Float inverse = dr::rcp(dr::sqrt(dr::select(tilted, across, 1.f)));
        Float x = dr::select(tilted, half.x() * inverse, 1.f), y = half.y() * inverse;
        Float growth = dr::square(x * wider.x()) + dr::square(y * wider.y());
        Float length = dr::sqrt(across + height), grown = across + height * growth;
        Float scale = dr::rcp(dr::sqrt(height + grown));
        Float sin = root(across) / length, cos = half.z() / length;
        Float sin_grown = root(grown) * scale, cos_grown = half.z() * scale;
        Float sin_turn = sin_grown * cos - cos_grown * sin, cos_turn = cos_grown * cos + sin_grown * sin;
        auto turned = [&](const Vector3f &w) {
            Float along = w.x() * x + w.y() * y;
            Float shift = along * (cos_turn - 1.f) + w.z() * sin_turn;
            return Vector3f(w.x() + shift * x, w.y() + shift * y,
                            dr::maximum(w.z() * cos_turn - along * sin_turn, MinCos));
        };
        auto is_wider = wider.x() + wider.y() > 0.f;
        return { dr::select(is_wider, turned(light), light), dr::select(is_wider, turned(view), view) };
    }

    /// The factor by which a residual ≥ 0 follows the analytic value.
    static Color3f change(const Color3f &from, const Color3f &to, const Color3f &residual) {
        Color3f growth = dr::maximum(to - from, 0.f) / (to + Floor), floor = dr::fmadd(growth, residual, Floor);
        return (to + floor) / (from + floor);
    }

    /// The share of what the network adds that stays: the lesser of those for light and view, interpolated
    /// between \c shares.
    static Float room(const FloatStorage &shares, const Float &cos_light, const Float &cos_view,
                      const Mask &active) {
        using UInt32 = dr::uint32_array_t<Float>;
        const uint32_t steps = (uint32_t) dr::width(shares) - 1;
        auto share = [&](const Float &cos) {
            // See rust/core/src/directions/elevations.rs.
            Float c = dr::clip(dr::detach(cos), 0.f, 1.f);
            Float place = (dr::sqrt(c) + c / (1.f + dr::sqrt(1.f - c))) * (.5f * (float) steps);
            UInt32 knot = dr::minimum(UInt32(place), steps - 1);
            Float from = dr::gather<Float>(shares, knot, active), to = dr::gather<Float>(shares, knot + 1, active);
            return dr::lerp(from, to, place - Float(knot));
        };
        return dr::minimum(share(cos_light), share(cos_view));
    }

private:
    /// √x, with a derivative of 0 instead of ∞ at x = 0.
    static Float root(const Float &x) {
        return dr::select(x > 0.f, dr::sqrt(dr::select(x > 0.f, x, 1.f)), 0.f);
    }

    /// See rust/core/src/models/edit.rs.
    static constexpr float Floor = .05f * dr::InvPi<float>, Aside = .7f, MinCos = 1e-3f;
};

} // namespace glimt
