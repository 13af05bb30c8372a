#pragma once

#include <array>
#include <variant>
#include <vector>

#include <mitsuba/core/logger.h>

#include "edit.h"
#include "features.h"
#include "microfacet.h"
#include "network.h"

namespace glimt {

namespace dr = drjit;

/**
 * \brief A whole model as Dr.Jit traces it, for derivatives and for GPUs
 *
 * The counterpart of rust/core/src/models/hybrid and its neighbours, with the parameters of a material
 * as variables that can carry gradients.
 */
template <typename Float> class TracedModel {
public:
    using Vector2f     = mitsuba::Vector<Float, 2>;
    using Vector3f     = mitsuba::Vector<Float, 3>;
    using Color3f      = mitsuba::Color<Float, 3>;
    using FloatStorage = mitsuba::DynamicBuffer<Float>;
    using Mask         = dr::mask_t<Float>;

    /// The parameters that can be edited. \c room is what the core found for the others, and constant.
    struct Parameters {
        TracedMicrofacet<Float> microfacet;
        const FloatStorage &latent;
        const FloatStorage &room;
    };

    TracedModel() = default;
    explicit TracedModel(const core::Material &material) : m_form(form(material)) {
        if (auto *hybrid = std::get_if<core::Hybrid>(&m_form)) {
            const core::Microfacet &p = hybrid->fitted;
            m_edit.fitted             = { Color3f(p.kd[0], p.kd[1], p.kd[2]),
                                          Color3f(p.eta[0], p.eta[1], p.eta[2]),
                                          Vector2f(p.alpha[0], p.alpha[1]) };
        }
    }

    /// Is there anything to trace?
    bool exists() const { return !std::holds_alternative<Untraced>(m_form); }
    bool has_network() const { return !std::holds_alternative<Ggx>(m_form); }

    /// f_r(light, view), linear RGB; 0 in the lanes that are not active.
    Color3f eval(const Vector3f &light, const Vector3f &view, const Parameters &parameters,
                 const Mask &active) const {
        // A pair that is lit in place of one that is not: derivatives of the latter may be NaN, which
        // no mask takes back.
        Vector3f normal(0.f, 0.f, 1.f);
        Vector3f l = dr::select(active, light, normal), v = dr::select(active, view, normal);
        auto reflect = [&](const auto &model) { return this->reflect(model, l, v, parameters, active); };
        return std::visit(reflect, m_form) & active;
    }

private:
    /// All parameters, and nothing besides.
    struct Ggx {};
    struct Untraced {};
    using Form = std::variant<Untraced, Ggx, core::Hybrid, core::Neural, core::Nbrdf>;

    static Form form(const core::Material &material) {
        switch (material.kind()) {
            case core::Kind::Ggx: return Ggx();
            case core::Kind::Hybrid: return material.hybrid();
            case core::Kind::Neural: return material.neural();
            case core::Kind::Nbrdf: return material.nbrdf();
            case core::Kind::Untraced: break;
        }
        return Untraced();
    }

    Color3f reflect(const Untraced &, const Vector3f &, const Vector3f &, const Parameters &,
                    const Mask &) const {
        return 0.f;
    }

    Color3f reflect(const Ggx &, const Vector3f &light, const Vector3f &view, const Parameters &parameters,
                    const Mask &) const {
        return parameters.microfacet.eval(light, view);
    }

    /// De Oliveira et al., "A Hybrid Neural-Microfacet BRDF Model", eq. 1 and its ablations.
    Color3f reflect(const core::Hybrid &model, const Vector3f &light, const Vector3f &view,
                    const Parameters &parameters, const Mask &active) const {
        Color3f analytic = parameters.microfacet.eval(light, view);
        auto [l, v] = m_edit.turn(light, view, parameters.microfacet.alpha);
        Color3f fitted = m_edit.fitted.eval(l, v);
        auto x = TracedFeatures<Float>::compute(model.inputs, l, v, m_edit.fitted.alpha);
        if (model.analytic_input)
            for (size_t c = 0; c < 3; ++c)
                x.push_back(AnalyticScale * dr::log(fitted[c] + AnalyticFloor));
        auto z = elements(parameters.latent, active);
        x.insert(x.end(), z.begin(), z.end());
        auto y = forward(model.network, std::move(x));
        Color3f a = dr::minimum(Color3f(y[0], y[1], y[2]), model.bound);
        auto change = [&](const Color3f &residual) {
            return TracedEdit<Float>::change(fitted, analytic, residual);
        };
        Float room = TracedEdit<Float>::room(parameters.room, light.z(), view.z(), active);
        switch (model.composition) {
            case core::Composition::GatedResidual: {
                Color3f residual = dr::exp(a);
                return residual * change(residual) * room +
                       analytic / (1.f + dr::exp(-Color3f(y[3], y[4], y[5])));
            }
            case core::Composition::Additive: {
                Color3f more = dr::maximum(a, 0.f), less = dr::minimum(a, 0.f);
                return dr::maximum(analytic + change(more - less) * (more * room + less), 0.f);
            }
            default: { // LogMultiplicative
                Color3f factor = dr::exp(a);
                return analytic * (dr::minimum(factor, 1.f) + dr::maximum(factor - 1.f, 0.f) * room);
            }
        }
    }

    /// Directions seen from learned shading frames, after Zeltner et al. 2024.
    Color3f reflect(const core::Neural &model, const Vector3f &light, const Vector3f &view,
                    const Parameters &parameters, const Mask &active) const {
        auto z = elements(parameters.latent, active);
        auto offsets = affine(model.frames, z);
        std::vector<Float> x;
        for (size_t k = 0; k + 6 <= offsets.size(); k += 6) {
            auto axes = frame(&offsets[k]);
            for (const Vector3f &w : { light, view })
                for (const Vector3f &axis : axes)
                    x.push_back(dr::dot(axis, w));
        }
        x.insert(x.end(), z.begin(), z.end());
        auto y = forward(model.network, std::move(x));
        return dr::exp(dr::minimum(Color3f(y[0], y[1], y[2]), model.bound)) *
               TracedEdit<Float>::room(parameters.room, light.z(), view.z(), active);
    }

    /// Tangent, bitangent and normal from offsets of the normal from z and of the tangent from x.
    static std::array<Vector3f, 3> frame(const Float *offsets) {
        Vector3f normal = dr::normalize(Vector3f(offsets[0], offsets[1], offsets[2] + 1.f)),
                 tangent = Vector3f(offsets[3] + 1.f, offsets[4], offsets[5]);
        tangent = dr::normalize(tangent - normal * dr::dot(normal, tangent));
        return { tangent, dr::cross(normal, tangent), normal };
    }

    /// Half and difference vector with the half vector turned to azimuth 0, Sztrajman et al. 2021.
    Color3f reflect(const core::Nbrdf &model, const Vector3f &light, const Vector3f &view,
                    const Parameters &, const Mask &) const {
        Vector3f h = TracedMicrofacet<Float>::half_vector(light, view);
        Float across_squared = h.x() * h.x() + h.y() * h.y();
        auto tilted = across_squared > 0.f;
        Float across = dr::sqrt(dr::select(tilted, across_squared, 1.f));
        Float cos_phi = dr::select(tilted, h.x() / across, 1.f),
              sin_phi = dr::select(tilted, h.y() / across, 0.f);
        Float length = dr::norm(h);
        Float sin_theta = dr::select(tilted, across, 0.f) / length, cos_theta = h.z() / length;
        Float along = light.x() * cos_phi + light.y() * sin_phi;
        auto y = forward<Float>(model.network, { sin_theta, 0.f, cos_theta,
                                                   along * cos_theta - light.z() * sin_theta,
                                                   light.y() * cos_phi - light.x() * sin_phi,
                                                   along * sin_theta + light.z() * cos_theta });
        return dr::maximum(dr::exp(dr::minimum(Color3f(y[0], y[1], y[2]), NbrdfMaxOutput)) - 1.f, 0.f);
    }

    static std::vector<Float> elements(const FloatStorage &values, const Mask &active) {
        using UInt32 = dr::uint32_array_t<Float>;
        std::vector<Float> result;
        for (uint32_t i = 0; i < (uint32_t) dr::width(values); ++i)
            result.push_back(dr::gather<Float>(values, UInt32(i), active));
        return result;
    }

    /// The scale of ln f_a as a network input, see `Form::analytic_feature` in rust/core.
    static constexpr float AnalyticFloor = 1e-4f, AnalyticScale = .2f;
    /// The limit of the exponent, see rust/core/src/models/nbrdf.rs.
    static constexpr float NbrdfMaxOutput = 20.7f;

    Form m_form;
    TracedEdit<Float> m_edit;
};

} // namespace glimt
