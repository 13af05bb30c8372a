#pragma once

#include <utility>

#include <mitsuba/core/transform.h>
#include <mitsuba/core/vector.h>

#include "glimt-mitsuba/src/bridge.rs.h"

namespace glimt {

namespace dr = drjit;

/// A place on a texture, and the axes of the Gaussian around it that is seen.
template <typename Value> struct TexturePlace {
    using Point2f  = mitsuba::Point<Value, 2>;
    using Vector2f = mitsuba::Vector<Value, 2>;

    Point2f uv;
    Vector2f along, across;

    /// The same place without any extent.
    TexturePlace point() const { return { uv, dr::zeros<Vector2f>(), dr::zeros<Vector2f>() }; }
};

/// The frame of a texture, x along u and y along v, beside that of a shading point. The two share the normal.
template <typename Value> struct TextureFrame {
    using Vector2f = mitsuba::Vector<Value, 2>;
    using Vector3f = mitsuba::Vector<Value, 3>;

    /// The direction of u.
    Vector2f u;
    /// Is the texture seen as it is (1) or mirrored (-1)?
    Value side;

    Vector3f to_texture(const Vector3f &w) const {
        return { u.x() * w.x() + u.y() * w.y(), side * (u.x() * w.y() - u.y() * w.x()), w.z() };
    }

    Vector3f to_shading(const Vector3f &w) const {
        Value y = side * w.y();
        return { u.x() * w.x() - u.y() * y, u.y() * w.x() + u.x() * y, w.z() };
    }
};

/**
 * \brief How a texture lies on a shape, and how much of it a pixel sees
 *
 * Mitsuba's BSDFs are told of no footprint by most integrators: `path` drops the differentials of rays at once, and
 * `duv_dx` stays 0 in all JIT variants. Where it is 0 the footprint follows from the length of the last segment of the
 * path, the inclination of the surface, and the angle between two pixels. After a reflection that is too little, which
 * leaves noise; too much would blur, which no number of samples takes back. Nothing here carries derivatives.
 */
template <typename Float> class Texturing {
public:
    using Value     = dr::detached_t<Float>;
    using Point2f   = mitsuba::Point<Value, 2>;
    using Vector2f  = mitsuba::Vector<Value, 2>;
    using Vector3f  = mitsuba::Vector<Value, 3>;
    using Scalar    = dr::scalar_t<Float>;
    using Transform = mitsuba::AffineTransform<mitsuba::Point<Scalar, 3>>;

    Texturing() = default;

    /// \c to_uv must have an inverse.
    explicit Texturing(const Transform &to_uv) : m_to_uv(to_uv), m_from_uv(to_uv.inverse()) { }

    const Transform &to_uv() const { return m_to_uv; }

    /// Where \c si is on the texture, seen in pixels that are \c pixel_angle (radians) apart.
    template <typename SurfaceInteraction>
    TexturePlace<Value> place(const SurfaceInteraction &si, const Float &pixel_angle) const {
        const auto &tm = m_to_uv.matrix;
        auto turned = [&](const Vector2f &d) {
            // A pixel reaches two standard deviations of the Gaussian that Mitsuba makes images of.
            return Vector2f(.5f * (tm.entry(0, 0) * d.x() + tm.entry(0, 1) * d.y()),
                            .5f * (tm.entry(1, 0) * d.x() + tm.entry(1, 1) * d.y()));
        };
        Vector2f given_x = dr::detach<false>(si.duv_dx), given_y = dr::detach<false>(si.duv_dy);
        auto is_given = dr::any(given_x != 0.f) || dr::any(given_y != 0.f);
        auto [duv_dx, duv_dy] = pixel(si, dr::detach<false>(pixel_angle));
        return { m_to_uv * Point2f(dr::detach<false>(si.uv)), turned(dr::select(is_given, given_x, duv_dx)),
                 turned(dr::select(is_given, given_y, duv_dy)) };
    }

    /// How the texture lies at \c si.
    template <typename SurfaceInteraction> TextureFrame<Value> frame(const SurfaceInteraction &si) const {
        Tangents tangents(si);
        const auto &tm = m_from_uv.matrix;
        const bool is_mirrored = tm.entry(0, 0) * tm.entry(1, 1) < tm.entry(0, 1) * tm.entry(1, 0);
        Value as_is(is_mirrored ? -1.f : 1.f);
        Value side = dr::select(tangents.det < 0.f, -as_is, as_is);
        // The tangent of a shading frame is along dp_du.
        if (tm.entry(1, 0) == 0.f)
            return { Vector2f(tm.entry(0, 0) < 0.f ? -1.f : 1.f, 0.f), side };
        Vector2f u = tangents.u * tm.entry(0, 0) + tangents.v * tm.entry(1, 0);
        Value length = dr::norm(u);
        auto is_sound = length > 0.f;
        return { dr::select(is_sound, u / dr::select(is_sound, length, 1.f), Vector2f(1, 0)), side };
    }

private:
    /// dp_du and dp_dv in the tangent plane.
    struct Tangents {
        Vector2f u, v;
        Value det;

        template <typename SurfaceInteraction> explicit Tangents(const SurfaceInteraction &si) {
            Vector3f s(dr::detach<false>(si.sh_frame.s)), t(dr::detach<false>(si.sh_frame.t));
            auto within = [&](const Vector3f &d) { return Vector2f(dr::dot(d, s), dr::dot(d, t)); };
            u   = within(Vector3f(dr::detach<false>(si.dp_du)));
            v   = within(Vector3f(dr::detach<false>(si.dp_dv)));
            det = u.x() * v.y() - u.y() * v.x();
        }

        /// What uv changes by over \c step, or nothing where u and v do not span the plane.
        Vector2f uv_of(const Vector2f &step) const {
            auto spans = dr::abs(det) > MinSpan * dr::sqrt(dr::squared_norm(u) * dr::squared_norm(v));
            Value inverse = dr::select(spans, dr::rcp(det), 0.f);
            return Vector2f(v.y() * step.x() - v.x() * step.y(), u.x() * step.y() - u.y() * step.x()) * inverse;
        }
    };

    /// What uv changes by from one pixel to the next: away from the viewer, and across.
    template <typename SurfaceInteraction>
    static std::pair<Vector2f, Vector2f> pixel(const SurfaceInteraction &si, const Value &pixel_angle) {
        Vector3f wi(dr::detach<false>(si.wi));
        Value width = pixel_angle * dr::detach<false>(si.t), cosine = dr::maximum(dr::abs(wi.z()), MinCos);
        Value slant   = dr::sqrt(wi.x() * wi.x() + wi.y() * wi.y());
        auto inclined = slant > 0.f;
        Value inverse = dr::rcp(dr::select(inclined, slant, 1.f));
        Vector2f away = dr::select(inclined, Vector2f(wi.x(), wi.y()) * inverse, Vector2f(1, 0));
        Tangents tangents(si);
        return { tangents.uv_of(away * (width / cosine)), tangents.uv_of(Vector2f(-away.y(), away.x()) * width) };
    }

    static constexpr float MinCos = .05f, MinSpan = 1e-6f;

    Transform m_to_uv, m_from_uv;
};

/// A place as the scalar calls of the core take it.
inline core::Place core_place(const TexturePlace<float> &place) {
    return { { place.uv.x(), place.uv.y() },
             { place.along.x(), place.along.y() },
             { place.across.x(), place.across.y() } };
}

} // namespace glimt
