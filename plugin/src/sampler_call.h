#pragma once

#include "kernel_call.h"

namespace glimt {

/**
 * \brief Asks a Rust material for densities and samples from inside the kernels that Dr.Jit compiles for
 * the CPU
 *
 * For samplers that have no traced form: tables, and the warps of measurements. The way in is that of
 * \ref KernelCall, whose address of the material the calls take; the other side is
 * rust/mitsuba/src/sampler_packet.rs. No derivatives either.
 */
template <typename Float> class SamplerCall {
public:
    using Value    = dr::detached_t<Float>;
    using Bool     = dr::mask_t<Value>;
    using UInt32   = dr::uint32_array_t<Value>;
    using UInt64   = dr::uint64_array_t<Value>;
    using Mask     = dr::mask_t<Float>;
    using Vector3f = mitsuba::Vector<Float, 3>;
    using Point2f  = mitsuba::Point<Float, 2>;

    SamplerCall() {
        const size_t width = KernelCall<Float>::width();
        m_pdf = UInt64::map_((void *) core::pdf_packet_address(width), 1, false);
        m_sample = UInt64::map_((void *) core::sample_packet_address(width), 1, false);
    }

    /// Density (sr⁻¹) of \c light; 0 in the lanes that are not active.
    Float pdf(const UInt64 &address, const Vector3f &light, const Vector3f &view, const Mask &active) const {
        Bool lit = dr::detach<false>(active);
        auto hit = call(m_pdf, address, light, view, lit);
        return Float(dr::select(lit, hit.u, 0.f));
    }

    /// A light direction and its density, which is 0 for a failed sample and in the lanes that are not active.
    std::pair<Vector3f, Float> sample(const UInt64 &address, const Vector3f &view, const Float &u_1,
                                      const Point2f &u_2, const Mask &active) const {
        Bool lit = dr::detach<false>(active);
        Vector3f u(u_1, u_2.x(), u_2.y());
        auto hit = call(m_sample, address, u, view, lit);
        return { Vector3f(Float(dr::select(lit, hit.u, 0.f)), Float(dr::select(lit, hit.v, 0.f)),
                          Float(dr::select(lit, hit.primitive, 1.f))),
                 Float(dr::select(lit, hit.geometry, 0.f)) };
    }

    /// Does a kernel get the very answers of direct calls, in active and inactive lanes?
    bool works(const UInt64 &address, const core::Material &material) const {
        if (KernelCall<Float>::width() == 0)
            return false;
        // More than one packet and not a multiple of it.
        constexpr size_t Count = 21;
        std::array<std::array<float, Count>, 3> view, u;
        std::array<bool, Count> active;
        for (size_t i = 0; i < Count; ++i) {
            float phi = 2.4f * (float) i, z = ((float) i + .5f) / Count, r = std::sqrt(1.f - z * z);
            view[0][i] = r * std::cos(phi), view[1][i] = r * std::sin(phi), view[2][i] = z;
            for (size_t d = 0; d < 3; ++d)
                u[d][i] = std::fmod(.5f + (float) i * (.819f - .13f * (float) d), 1.f);
            active[i] = i % 5 != 2;
        }
        auto load = [](const auto &values) { return Value(dr::load<Value>(values.data(), Count)); };
        Vector3f v(load(view[0]), load(view[1]), load(view[2]));
        Mask mask = dr::load<Bool>(active.data(), Count);
        auto [light, density] = sample(address, v, load(u[0]), Point2f(load(u[1]), load(u[2])), mask);
        auto again = dr::detach<false>(pdf(address, light, v, mask && density > 0.f));
        auto wo = dr::detach<false>(light);
        auto pdf = dr::detach<false>(density);
        dr::eval(wo, pdf, again);
        for (size_t i = 0; i < Count; ++i) {
            core::Sample expected { { 0.f, 0.f, 1.f }, 0.f, { 0.f, 0.f, 0.f } };
            if (active[i])
                expected = material.sample({ view[0][i], view[1][i], view[2][i] }, { u[0][i], u[1][i], u[2][i] });
            float repeated = 0.f;
            if (expected.pdf > 0.f)
                repeated = material.pdf(expected.light, { view[0][i], view[1][i], view[2][i] });
            bool same = agrees(pdf.entry(i), expected.pdf) && agrees(again.entry(i), repeated);
            for (size_t c = 0; c < 3; ++c)
                same &= agrees(wo[c].entry(i), expected.light[c]);
            if (!same)
                return false;
        }
        return true;
    }

private:
    /// Are these one number? Threads of a renderer may round denormals to 0.
    static bool agrees(float a, float b) { return std::abs(a - b) <= 1e-5f * (1.f + std::abs(b)); }

    static PacketHit<Value> call(const UInt64 &function, const UInt64 &address, const Vector3f &origin,
                                 const Vector3f &direction, const Bool &active) {
        return call_packet<Value>(function, address, dr::detach<false>(origin), dr::detach<false>(direction),
                                  dr::zeros<mitsuba::Vector<Value, 3>>(), dr::zeros<UInt32>(), active);
    }

    /// The functions, as variables of which only the pointer matters.
    UInt64 m_pdf, m_sample;

public:
    DRJIT_TRAVERSE(SamplerCall, m_pdf, m_sample)
};

} // namespace glimt
