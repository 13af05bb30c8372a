#pragma once

#include <mitsuba/core/spectrum.h>

namespace glimt {

namespace dr = drjit;

/**
 * \brief Turns linear sRGB into a spectrum: f(λ) = r R(λ) + g G(λ) + b B(λ)
 *
 * R, G and B are smooth reflectance spectra that sum to 1 and have the colours (1, 0, 0), (0, 1, 0)
 * and (0, 0, 1) under D65 (Mallett & Yuksel 2019, "Spectral Primary Decomposition for Rendering with
 * sRGB Reflectance"). The map is linear, and so it holds for values of any size, which the values of a
 * BRDF have; it adds no energy at any wavelength.
 */
template <typename Float> class Primaries {
public:
    using UInt32  = dr::uint32_array_t<Float>;
    using Mask    = dr::mask_t<Float>;
    using Color3f = mitsuba::Color<Float, 3>;

    Primaries() : m_table(dr::load<Table>(RedGreen, 2 * Count)) { }

    /// The spectrum of \c rgb at \c wavelengths in nanometres.
    template <typename Spectrum, typename Wavelength>
    Spectrum upsample(const Color3f &rgb, const Wavelength &wavelengths, const Mask &active) const {
        Spectrum result;
        for (size_t i = 0; i < dr::size_v<Wavelength>; ++i) {
            Float x = dr::clip((wavelengths[i] - First) * (1.f / Step), 0.f, (float) (Count - 1));
            UInt32 node = dr::minimum(UInt32(x), Count - 2);
            Float t = x - Float(node);
            Float red = dr::lerp(value(2 * node, active), value(2 * node + 2, active), t),
                  green = dr::lerp(value(2 * node + 1, active), value(2 * node + 3, active), t);
            result[i] = red * (rgb.x() - rgb.z()) + green * (rgb.y() - rgb.z()) + rgb.z();
        }
        return result;
    }

private:
    using Table = mitsuba::DynamicBuffer<Float>;

    Float value(const UInt32 &index, const Mask &active) const {
        return dr::gather<Float>(m_table, index, active);
    }

    static constexpr float First = 360.f, Step = 10.f;
    static constexpr uint32_t Count = 48;
    /// R and G; B is the rest. Made by plugin/fit_primaries.py.
    static constexpr float RedGreen[2 * Count] = {
        0.028423f, 0.000000f, 0.028422f, 0.000000f, 0.028417f, 0.000000f, 0.028397f, 0.000000f,
        0.028323f, 0.000000f, 0.028028f, 0.000000f, 0.027015f, 0.000000f, 0.024317f, 0.000000f,
        0.020112f, 0.000000f, 0.018495f, 0.000000f, 0.029206f, 0.000000f, 0.011963f, 0.109361f,
        0.000000f, 0.294856f, 0.000000f, 0.507918f, 0.000000f, 0.716290f, 0.000000f, 0.887916f,
        0.000000f, 0.991154f, 0.000000f, 1.000000f, 0.000000f, 1.000000f, 0.000000f, 1.000000f,
        0.000000f, 1.000000f, 0.015126f, 0.937912f, 0.206164f, 0.741808f, 0.477606f, 0.488047f,
        0.739564f, 0.248065f, 0.924770f, 0.075230f, 1.000000f, 0.000000f, 1.000000f, 0.000000f,
        1.000000f, 0.000000f, 1.000000f, 0.000000f, 1.000000f, 0.000000f, 1.000000f, 0.000000f,
        1.000000f, 0.000000f, 1.000000f, 0.000000f, 1.000000f, 0.000000f, 1.000000f, 0.000000f,
        1.000000f, 0.000000f, 1.000000f, 0.000000f, 1.000000f, 0.000000f, 1.000000f, 0.000000f,
        1.000000f, 0.000000f, 1.000000f, 0.000000f, 1.000000f, 0.000000f, 1.000000f, 0.000000f,
        1.000000f, 0.000000f, 1.000000f, 0.000000f, 1.000000f, 0.000000f, 1.000000f, 0.000000f,
    };

    Table m_table;

public:
    DRJIT_TRAVERSE(Primaries, m_table)
};

} // namespace glimt
