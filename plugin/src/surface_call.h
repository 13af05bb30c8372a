#pragma once

#include <tuple>

#include "kernel_call.h"
#include "surface.h"

namespace glimt {

/**
 * \brief Asks a Rust surface from inside the kernels that Dr.Jit compiles for the CPU
 *
 * The way in is that of \ref KernelCall, whose address of the material the calls take; the other side is
 * rust/mitsuba/src/place_packet.rs. Directions are in the frame of the texture. No derivatives.
 */
template <typename Float> class SurfaceCall {
public:
    using Value    = dr::detached_t<Float>;
    using Bool     = dr::mask_t<Value>;
    using UInt32   = dr::uint32_array_t<Value>;
    using UInt64   = dr::uint64_array_t<Value>;
    using Vector2f = mitsuba::Vector<Value, 2>;
    using Vector3f = mitsuba::Vector<Value, 3>;
    using Color3f  = mitsuba::Color<Value, 3>;
    using Place    = TexturePlace<Value>;

    SurfaceCall() {
        const size_t width = KernelCall<Float>::width();
        m_eval = UInt64::map_((void *) core::eval_at_packet_address(width), 1, false);
        m_sample = UInt64::map_((void *) core::sample_at_packet_address(width), 1, false);
    }

    /// f_r and the density (sr⁻¹) of \c light; 0 in the lanes that are not active.
    std::pair<Color3f, Value> eval_pdf(const UInt64 &address, const Place &place, const Vector3f &light,
                                       const Vector3f &view, const Bool &active) const {
        auto hit = call(m_eval, address, place, light, view, active);
        return { answer(hit, active), dr::select(active, hit.geometry, 0.f) };
    }

    /// A light direction, its density, which is 0 for a failed sample and in the lanes that are not active, and
    /// f cosθ / pdf.
    std::tuple<Vector3f, Value, Color3f> sample(const UInt64 &address, const Place &place, const Vector3f &view,
                                                const Vector3f &u, const Bool &active) const {
        auto hit = call(m_sample, address, place, u, view, active);
        // Stereographic from below.
        Vector2f p(dr::select(active, hit.t, 0.f), dr::select(active, hit.instance, 0.f));
        Value square = dr::squared_norm(p), scale = dr::rcp(1.f + square);
        Vector3f light(2.f * p.x() * scale, 2.f * p.y() * scale, (1.f - square) * scale);
        return { light, dr::select(active, hit.geometry, 0.f), answer(hit, active) };
    }

    /// Does a kernel get the very answers of direct calls, in active and inactive lanes?
    bool works(const UInt64 &address, const core::Material &material) const {
        if (KernelCall<Float>::width() == 0)
            return false;
        // More than one packet and not a multiple of it.
        constexpr size_t Count = 21;
        std::array<std::array<float, Count>, 3> view, u;
        std::array<std::array<float, Count>, 6> numbers;
        std::array<bool, Count> active;
        for (size_t i = 0; i < Count; ++i) {
            float phi = 2.4f * (float) i, z = ((float) i + .5f) / Count, r = std::sqrt(1.f - z * z);
            view[0][i] = r * std::cos(phi), view[1][i] = r * std::sin(phi), view[2][i] = z;
            for (size_t d = 0; d < 3; ++d)
                u[d][i] = std::fmod(.5f + (float) i * (.819f - .13f * (float) d), 1.f);
            // uv, and axes of a footprint in either direction.
            for (size_t d = 0; d < 6; ++d) {
                float fraction = std::fmod((float) (i + 1) * (.618f + .1f * (float) d), 1.f);
                numbers[d][i] = (d < 2 ? 3.f : .2f) * (fraction - .4f);
            }
            active[i] = i % 5 != 2;
        }
        auto load = [](const auto &values) { return Value(dr::load<Value>(values.data(), Count)); };
        Vector3f v(load(view[0]), load(view[1]), load(view[2]));
        Place place { { load(numbers[0]), load(numbers[1]) },
                      { load(numbers[2]), load(numbers[3]) },
                      { load(numbers[4]), load(numbers[5]) } };
        Bool mask = dr::load<Bool>(active.data(), Count);
        auto [light, density, weight] = sample(address, place, v, { load(u[0]), load(u[1]), load(u[2]) }, mask);
        auto [f, again] = eval_pdf(address, place, light, v, mask && density > 0.f);
        dr::eval(light, density, weight, f, again);
        for (size_t i = 0; i < Count; ++i) {
            std::array<float, 3> view_i { view[0][i], view[1][i], view[2][i] }, reflected { 0.f, 0.f, 0.f };
            core::Place place_i { { numbers[0][i], numbers[1][i] },
                                  { numbers[2][i], numbers[3][i] },
                                  { numbers[4][i], numbers[5][i] } };
            core::Sample expected { { 0.f, 0.f, 1.f }, 0.f, { 0.f, 0.f, 0.f } };
            if (active[i])
                expected = material.sample_at(place_i, view_i, { u[0][i], u[1][i], u[2][i] });
            float repeated = 0.f;
            if (expected.pdf > 0.f) {
                std::array<float, 3> light_i { light[0].entry(i), light[1].entry(i), light[2].entry(i) };
                reflected = material.eval_at(place_i, light_i, view_i);
                repeated = material.pdf_at(place_i, light_i, view_i);
            }
            bool same = agrees(density.entry(i), expected.pdf) && agrees(again.entry(i), repeated);
            for (size_t c = 0; c < 3; ++c)
                same &= agrees(light[c].entry(i), expected.light[c]) && agrees(f[c].entry(i), reflected[c]) &&
                        agrees(weight[c].entry(i), expected.weight[c]);
            if (!same)
                return false;
        }
        return true;
    }

private:
    /// Are these one number? The footprint loses its last digits on the way, and narrow lobes show it.
    static bool agrees(float a, float b) { return std::abs(a - b) <= 1e-2f * (1e-2f + std::abs(b)); }

    static Color3f answer(const PacketHit<Value> &hit, const Bool &active) {
        return { dr::select(active, hit.u, 0.f), dr::select(active, hit.v, 0.f),
                 dr::select(active, hit.primitive, 0.f) };
    }

    static PacketHit<Value> call(const UInt64 &function, const UInt64 &address, const Place &place,
                                 const Vector3f &origin, const Vector3f &direction, const Bool &active) {
        auto [first, second] = footprint(place);
        Vector3f extra(dr::reinterpret_array<Value>(first), place.uv.x(), place.uv.y());
        return call_packet<Value>(function, address, origin, direction, extra, second, active);
    }

    /// Three numbers in 64 bits: the lower triangular matrix that makes a round Gaussian this one.
    static std::pair<UInt32, UInt32> footprint(const Place &place) {
        Vector2f a = limited(place.along), b = limited(place.across);
        Value square = a.x() * a.x() + b.x() * b.x();
        auto is_wide = square > 0.f;
        Value along_u = dr::sqrt(square), inverse = dr::rcp(dr::select(is_wide, along_u, 1.f));
        Value det = dr::abs(a.x() * b.y() - a.y() * b.x()), mixed = a.x() * a.y() + b.x() * b.y();
        Value shear = dr::select(is_wide, mixed * inverse, 0.f),
              along_v = dr::select(is_wide, det * inverse, dr::sqrt(a.y() * a.y() + b.y() * b.y()));
        // Rounded to 13 bits of mantissa.
        auto shortened = [](const Value &x) { return (dr::reinterpret_array<UInt32>(x) + 512u) >> 10; };
        UInt32 middle = shortened(shear);
        return { (shortened(along_u) << 11) | (middle >> 11), (middle << 21) | shortened(along_v) };
    }

    /// Numbers whose squares are finite. What is none is 0, as in the core.
    static Vector2f limited(const Vector2f &axis) {
        auto within = [](const Value &x) {
            return dr::select(dr::isnan(x), 0.f, dr::clip(x, -MaxExtent, MaxExtent));
        };
        return { within(axis.x()), within(axis.y()) };
    }

    static constexpr float MaxExtent = 1e9f;

    /// The functions, as variables of which only the pointer matters.
    UInt64 m_eval, m_sample;

public:
    DRJIT_TRAVERSE(SurfaceCall, m_eval, m_sample)
};

} // namespace glimt
