#pragma once

#include <array>
#include <cmath>
#include <memory>

#include <drjit-core/jit.h>
#include <drjit/jit.h>
#include <mitsuba/render/fwd.h>
#include <mitsuba/core/spectrum.h>
#include <mitsuba/core/vector.h>

#include "glimt-mitsuba/src/bridge.rs.h"

namespace glimt {

namespace dr = drjit;

/// What a call from inside a kernel brings back, in the fields of a ray's hit.
template <typename Value> struct PacketHit {
    Value t, u, v;
    /// Integers for Embree, here the bits of floats.
    Value primitive, geometry, instance;
};

/**
 * \brief Calls the function whose pointer the variable \c pointer holds, for the active lanes
 *
 * The one place that knows the order of Dr.Jit's arguments. \c extra takes the fields near end, time and
 * far end of the ray. Lanes that are not active bring back whatever was in the packet.
 */
template <typename Value>
PacketHit<Value> call_packet(const dr::uint64_array_t<Value> &pointer, const dr::uint64_array_t<Value> &address,
                             const mitsuba::Vector<Value, 3> &origin,
                             const mitsuba::Vector<Value, 3> &direction,
                             const mitsuba::Vector<Value, 3> &extra, const dr::uint32_array_t<Value> &mask,
                             const dr::mask_t<Value> &active) {
    using UInt32 = dr::uint32_array_t<Value>;
    using UInt64 = dr::uint64_array_t<Value>;
    auto function = UInt64::steal(jit_var_pointer(JitBackend::LLVM, pointer.data(), pointer.index(), 0));
    UInt32 address_low(address), address_high(address >> 32);
    dr::mask_t<Value> coherent = false;
    uint32_t in[14] = { coherent.index(),      active.index(),                                // Flags
                        origin.x().index(),    origin.y().index(),    origin.z().index(),     // Origin
                        extra.x().index(),                                                    // Near end
                        direction.x().index(), direction.y().index(), direction.z().index(),  // Direction
                        extra.y().index(),     extra.z().index(),                             // Time, far end
                        mask.index(),                                                         // Mask
                        address_low.index(),   address_high.index() };                        // Id, flags
    // Out: valid, t, u, v, primitive, geometry, instance, hit on an instance?
    uint32_t out[8];
    jit_llvm_ray_trace(function.index(), /* scene = */ function.index(), /* shadow_ray = */ 0, in, out);
    for (uint32_t i : { 0, 7 })
        jit_var_dec_ref(out[i]);
    auto bits = [](uint32_t index) { return dr::reinterpret_array<Value>(UInt32::steal(index)); };
    return { Value::steal(out[1]), Value::steal(out[2]), Value::steal(out[3]),
             bits(out[4]),         bits(out[5]),         bits(out[6]) };
}

/**
 * \brief Evaluates a Rust material from inside the kernels that Dr.Jit compiles for the CPU
 *
 * The one place where a kernel of Dr.Jit 1.5 calls a foreign function is \c jit_llvm_ray_trace(),
 * which takes any function with the convention of Embree's \c rtcIntersectN(). rust/mitsuba/src/packet.rs
 * serves that convention and says which field of a ray carries what. There is no scene.
 *
 * The call has no derivative. It is not the documented purpose of that function either, which is
 * why \ref works() compares it with direct calls before anybody relies on it.
 */
template <typename Float> class KernelCall {
public:
    using Value    = dr::detached_t<Float>;
    using Bool     = dr::mask_t<Value>;
    using UInt32   = dr::uint32_array_t<Value>;
    using UInt64   = dr::uint64_array_t<Value>;
    using Vector3f = mitsuba::Vector<Float, 3>;
    using Color3f  = mitsuba::Color<Float, 3>;

    /// Lanes per call; 0 where Dr.Jit has a vector width that the Rust side does not serve.
    static size_t width() {
        size_t width = jit_llvm_vector_width();
        return core::eval_packet_address(width) ? width : 0;
    }

    /**
     * \brief Points the call to \c material
     *
     * Kernels run asynchronously and can outlive the BSDF that they were recorded from. The material is
     * therefore kept by the JIT variable that holds its address too, and let go once the kernels that
     * were launched before the variable went have finished.
     */
    void bind(std::shared_ptr<const core::Material> material) {
        auto owner = new Owner { (uint64_t) material.get(), material };
        m_function = UInt64::map_((void *) core::eval_packet_address(width()), 1, false);
        m_address = UInt64::map_(&owner->address, 1, false);
        m_material = std::move(material);
        jit_var_set_callback(
            m_address.index(),
            [](uint32_t /*index*/, int free, void *owner) {
                if (free)
                    jit_enqueue_host_func(JitBackend::LLVM,
                                          [](void *o) { delete static_cast<Owner *>(o); }, owner);
            },
            owner);
    }

    /// The material's address, for other calls about it.
    const UInt64 &address() const { return m_address; }

    /// f_r(light, view); 0 in the lanes that are not active.
    Color3f eval(const Vector3f &light, const Vector3f &view, const dr::mask_t<Float> &active) const {
        return call(light, active, dr::zeros<Vector3f>(), false, view).first;
    }

    /// f_r of two lights and one view, each 0 in the lanes that are not active, in one call.
    std::pair<Color3f, Color3f> eval(const Vector3f &light_1, const dr::mask_t<Float> &active_1,
                                     const Vector3f &light_2, const dr::mask_t<Float> &active_2,
                                     const Vector3f &view) const {
        return call(light_1, active_1, light_2, active_2, view);
    }

    /// Does a kernel get the very values of direct calls, in active and inactive lanes?
    bool works() const {
        if (width() == 0)
            return false;
        // Pairs over the hemisphere, more than one packet and not a multiple of it.
        constexpr size_t Count = 37;
        std::array<std::array<float, Count>, 3> light, view;
        std::array<bool, Count> active;
        for (size_t i = 0; i < Count; ++i) {
            float phi = 2.4f * (float) i, z = ((float) i + .5f) / Count, r = std::sqrt(1.f - z * z);
            light[0][i] = r * std::cos(phi), light[1][i] = r * std::sin(phi), light[2][i] = z;
            view[0][i] = z, view[1][i] = 0.f, view[2][i] = r;
            active[i] = i % 5 != 2;
        }
        auto load = [](const auto &xyz) {
            return Vector3f(dr::load<Value>(xyz[0].data(), Count), dr::load<Value>(xyz[1].data(), Count),
                            dr::load<Value>(xyz[2].data(), Count));
        };
        Bool mask = dr::load<Bool>(active.data(), Count);
        Vector3f first = load(light), second(first.y(), first.x(), first.z());
        auto [f_1, f_2] = eval(first, mask, second, true, load(view));
        auto value_1 = dr::detach<false>(f_1), value_2 = dr::detach<false>(f_2);
        dr::eval(value_1, value_2);
        for (size_t i = 0; i < Count; ++i) {
            const std::array<float, 3> v { view[0][i], view[1][i], view[2][i] };
            std::array<float, 3> expected_1 { 0.f, 0.f, 0.f };
            if (active[i])
                expected_1 = m_material->eval({ light[0][i], light[1][i], light[2][i] }, v);
            auto expected_2 = m_material->eval({ light[1][i], light[0][i], light[2][i] }, v);
            for (size_t c = 0; c < 3; ++c)
                if (!agrees(value_1[c].entry(i), expected_1[c]) || !agrees(value_2[c].entry(i), expected_2[c]))
                    return false;
        }
        return true;
    }

private:
    /// Are these one value? The kernels for one pair and for many may round differently.
    static bool agrees(float value, float expected) {
        return std::abs(value - expected) <= 1e-4f * (expected + 1e-3f);
    }

    std::pair<Color3f, Color3f> call(const Vector3f &light_1, const dr::mask_t<Float> &active_1,
                                     const Vector3f &light_2, const dr::mask_t<Float> &active_2,
                                     const Vector3f &view) const {
        Bool lit_1 = dr::detach<false>(active_1), lit_2 = dr::detach<false>(active_2);
        UInt32 wanted = dr::select(lit_1, UInt32(First), 0u) | dr::select(lit_2, UInt32(Second), 0u);
        auto hit = call_packet<Value>(m_function, m_address, dr::detach<false>(light_1), dr::detach<false>(view),
                                      dr::detach<false>(light_2), wanted, lit_1 | lit_2);
        // Lanes that were not called hold whatever was in the packet.
        auto f = [](const Bool &lit, const Value &red, const Value &green, const Value &blue) {
            return Color3f(Float(dr::select(lit, red, 0.f)), Float(dr::select(lit, green, 0.f)),
                           Float(dr::select(lit, blue, 0.f)));
        };
        return { f(lit_1, hit.u, hit.v, hit.primitive), f(lit_2, hit.t, hit.geometry, hit.instance) };
    }

    /// What is asked for in a lane, see rust/mitsuba/src/packet.rs.
    static constexpr uint32_t First = 1, Second = 2;

    /// What keeps a material, and the memory that the variable with its address maps.
    struct Owner {
        uint64_t address;
        std::shared_ptr<const core::Material> material;
    };

    std::shared_ptr<const core::Material> m_material;
    /// The function, as a variable of which only the pointer matters.
    UInt64 m_function;
    /// The material's address, as data.
    UInt64 m_address;

public:
    DRJIT_TRAVERSE(KernelCall, m_function, m_address)
};

} // namespace glimt
