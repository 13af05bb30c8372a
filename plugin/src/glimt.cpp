#include <atomic>
#include <cmath>
#include <memory>
#include <sstream>

#include <mitsuba/core/fresolver.h>
#include <mitsuba/core/properties.h>
#include <mitsuba/core/string.h>
#include <mitsuba/render/bsdf.h>

#include "kernel_call.h"
#include "lobes.h"
#include "primaries.h"
#include "sampler_call.h"
#include "surface.h"
#include "surface_call.h"
#include "traced.h"

// Without -march=haswell everything compiles, loads and computes garbage: the layout of structs differs.
static_assert(sizeof(mitsuba::Color<float, 3>) == 16, "not the binary interface of Mitsuba's wheel");

NAMESPACE_BEGIN(mitsuba)

/**!

.. _bsdf-glimt:

Compact fit of a measured material (:monosp:`glimt`)
----------------------------------------------------

.. pluginparameters::

 * - filename
   - |string|
   - Model library (``.safetensors``), as ``glimt fit`` writes it, or a measurement as it is: RGL
     ``.bsdf``, MERL ``.binary``, UTIA ``.bin``. Found by Mitsuba's file resolver: beside the scene file or
     in a directory of a ``<path>`` element.

 * - material
   - |string|
   - Name of the material in the library; ``glimt info FILE`` lists them. Not needed where the library
     has only one.

 * - mix, mix_weight
   - |string|, |float|
   - Name of a second material of the library, and its share in :math:`[0, 1]`: the material between the two. For
     the models whose materials share a network, and ``ggx``. (Default: none)

 * - sampler
   - |string|
   - How directions are sampled: ``lobes`` (GGX lobes and a cosine lobe), ``table`` (tables of the
     reflectance, made when first asked for; ``table:32x64x32`` or ``table:paper`` for another
     resolution). (Default: ``lobes`` for models, ``table`` for MERL and UTIA files, and the file's own
     warps for RGL files)

 * - kd
   - |rgb| or |float|
   - Edit: diffuse albedo of the analytic part, linear RGB in :math:`[0, 1]`. (Default: as fitted)
   - |exposed|, |differentiable|

 * - eta
   - |rgb| or |float|
   - Edit: relative index of refraction of the analytic part, one per channel, in :math:`[1, 10]`.
     (Default: as fitted)
   - |exposed|, |differentiable|

 * - alpha, or alpha_x and alpha_y
   - |float|
   - Edit: GGX roughness of the analytic part, in :math:`[0.0001, 1]`; along the tangent and the bitangent
     for an anisotropic material. (Default: as fitted)
   - |exposed|, |differentiable|

 * - latent
   - |float| array
   - The code by which the shared network tells the materials of a library apart.
   - |exposed|, |differentiable|

 * - tint
   - |rgb| or |float|
   - Factor on the reflectance of any material, linear RGB, not negative. (Default: 1)
   - |exposed|, |differentiable|

 * - to_uv
   - |transform|
   - Surfaces: from the shape's texture coordinates to those of the maps, as for ``bitmap`` textures.
     (Default: none)

 * - pixel_angle
   - |float|
   - Surfaces: the angle between two neighbouring pixels in the middle of the image, in radians, which
     ``glimt.pixel_angle(sensor)`` computes. It says how much of the maps a pixel sees. (Default: 0, the maps as they
     are)
   - |exposed|

This plugin evaluates a reflectance that was fitted to a measured material, by any of the models of
``docs/guide/models.md``: an analytic model (``ggx``), the same with a small neural network (``hybrid``, De Oliveira
et al., *A Hybrid Neural-Microfacet BRDF Model*), a network alone, tables, published fits. It also evaluates
measurements as they are. Only ``ggx`` and ``hybrid`` have
an analytic part; the edits are an error for the others.

**Surfaces.** A material of texture maps is another one at every place. :monosp:`uv` are taken through ``to_uv``, and the
normals of the maps follow the directions of u and v, also where a shape has them mirrored. Mitsuba tells a BSDF of no
footprint. With ``pixel_angle`` the plugin makes one, from the length of the last segment of the path and the inclination
of the surface, and averages of the maps come from their mip levels. After a bounce the footprint is smaller than it
could be, which leaves noise but does not blur. Where an integrator gives derivatives of uv (:monosp:`direct` in scalar
variants), they are used instead. Importance transport sees points. Such a material has its own sampler at every place,
and no derivatives but those of ``tint``. Materials that are the same everywhere ignore ``to_uv`` and ``pixel_angle``.

The material is one-sided; the ``twosided`` plugin makes it two-sided. It has one component, of type
*glossy reflection* as with ``measured``: a fitted measurement has no honest split into diffuse and
glossy. Samples come from a mixture of a cosine lobe and a GGX lobe, whose density is known exactly.

**Colour.** A fit knows linear sRGB only. RGB variants use it as it is, monochromatic variants its
luminance. Spectral variants upsample it, :math:`f(\lambda) = r R(\lambda) + g G(\lambda) + b B(\lambda)`
with the smooth reflectance spectra of the sRGB primaries after Mallett and Yuksel 2019: under D65 the
colour is that of the RGB variants, under other lights it is one of many that would be as right.
Polarized variants depolarize.

**Speed and derivatives.** The reflectance is computed by the Rust core: directly in scalar variants,
and by a call from inside the compiled kernel in LLVM variants. Where a direction or a parameter has
gradients enabled, and in CUDA variants, Dr.Jit traces the whole model instead, which takes seconds to
compile where there is a network. Samples and their densities carry no derivative with respect to
the parameters (detached sampling). Of the models ``ggx``, ``hybrid``, ``neural`` and ``nbrdf`` can be traced. The others and the
samplers ``table`` and of RGL files run in scalar and LLVM variants only, and carry no derivative with respect to
directions either, of which a warning is logged once.

.. tabs::
    .. code-tab:: xml

        <bsdf type="glimt">
            <string name="filename" value="rgl.safetensors"/>
            <string name="material" value="chm_orange"/>
            <rgb name="kd" value="0.8, 0.2, 0.1"/>
        </bsdf>

    .. code-tab:: python

        'type': 'glimt',
        'filename': 'rgl.safetensors',
        'material': 'chm_orange',
        'kd': {'type': 'rgb', 'value': [0.8, 0.2, 0.1]}

*/
template <typename Float, typename Spectrum>
class Glimt final : public BSDF<Float, Spectrum> {
public:
    MI_IMPORT_BASE(BSDF, m_flags, m_components)
    MI_IMPORT_TYPES()

    Glimt(const Properties &props) : Base(props) {
        if constexpr (dr::is_llvm_v<Float>)
            require_llvm();

        fs::path file = file_resolver()->resolve(props.get<std::string_view>("filename"));
        m_file = file.filename().string();
        const std::string name(props.get<std::string_view>("material", "")),
            mix(props.get<std::string_view>("mix", "")), sampler(props.get<std::string_view>("sampler", ""));
        if (mix.empty() == props.has_property("mix_weight"))
            Throw("glimt: \"mix\" names a second material and \"mix_weight\" its share; give both or neither.");
        rust::Box<Material> material = checked([&] {
            if (mix.empty())
                return glimt::core::open(file.string(), name, sampler);
            const float weight = (float) props.get<ScalarFloat>("mix_weight");
            return glimt::core::mixed(file.string(), name, mix, weight, sampler);
        });
        m_name = std::string(material->name());
        m_model = glimt::TracedModel<Float>(*material);
        m_is_surface = material->is_surface();
        if (m_is_surface && !sampler.empty())
            Throw("glimt: \"%s\" of \"%s\" is a surface, which is sampled in its own way at every place. Leave out "
                  "\"sampler\".", m_name, m_file);
        read_texturing(props);
        m_tint = props.has_property("tint") ? color(props, "tint") : ScalarColor3f(1.f);
        check_factors();
        fetch(*material);
        if (read_edits(props, *material))
            material = edit(*material);
        m_material = share(std::move(material));
        bind();
    }

    void traverse(TraversalCallback *cb) override {
        if (m_material->has_microfacet()) {
            cb->put("kd",  m_kd,  ParamFlags::Differentiable);
            cb->put("eta", m_eta, ParamFlags::Differentiable);
            if (m_isotropic) {
                cb->put("alpha", m_alpha.x(), ParamFlags::Differentiable);
            } else {
                cb->put("alpha_x", m_alpha.x(), ParamFlags::Differentiable);
                cb->put("alpha_y", m_alpha.y(), ParamFlags::Differentiable);
            }
        }
        if (dr::width(m_latent) > 0)
            cb->put("latent", m_latent, ParamFlags::Differentiable);
        cb->put("tint", m_tint, ParamFlags::Differentiable);
        if (m_is_surface)
            cb->put("pixel_angle", m_pixel_angle, ParamFlags::NonDifferentiable);
    }

    void parameters_changed(const std::vector<std::string> & /*keys*/ = {}) override {
        std::shared_ptr<const Material> edited;
        try {
            check_factors();
            // A surface has no parameters in the core, and its maps need no copy.
            edited = m_is_surface ? m_material : share(edit(*m_material));
        } catch (...) {
            restore();
            throw;
        }
        m_material = std::move(edited);
        bind();
    }

    std::pair<BSDFSample3f, Spectrum> sample(const BSDFContext &ctx, const SurfaceInteraction3f &si,
                                             Float sample1, const Point2f &sample2,
                                             Mask active) const override {
        MI_MASKED_FUNCTION(ProfilerPhase::BSDFSample, active);

        active &= Frame3f::cos_theta(si.wi) > 0.f;
        if (!ctx.is_enabled(BSDFFlags::GlossyReflection) || dr::none_or<false>(active))
            return { dr::zeros<BSDFSample3f>(), 0.f };

        if (m_is_surface)
            return sample_surface(ctx, si, sample1, sample2, active);
        if constexpr (!dr::is_jit_v<Float>) {
            auto s = m_material->sample(array(si.wi), { sample1, sample2.x(), sample2.y() });
            BSDFSample3f bs = reflected(Vector3f(s.light[0], s.light[1], s.light[2]), s.pdf);
            Color3f weight(s.weight[0], s.weight[1], s.weight[2]);
            active &= s.pdf > 0.f;
            // The core's weight is that of radiance, for which wi is the view.
            if (ctx.mode == TransportMode::Importance && active)
                weight = reflectance(ctx, si.wi, bs.wo, true) * (Frame3f::cos_theta(bs.wo) / s.pdf);
            return { bs, to_spectrum(weight, si, active) };
        } else {
            auto [bs, lit] = sample_direction(si.wi, sample1, sample2, active);
            return weighted(bs, reflectance(ctx, si.wi, bs.wo, lit), si, lit);
        }
    }

    Spectrum eval(const BSDFContext &ctx, const SurfaceInteraction3f &si, const Vector3f &wo,
                  Mask active) const override {
        return eval_pdf_impl<true, false>(ctx, si, wo, active).first;
    }

    Float pdf(const BSDFContext &ctx, const SurfaceInteraction3f &si, const Vector3f &wo,
              Mask active) const override {
        return eval_pdf_impl<false, true>(ctx, si, wo, active).second;
    }

    std::pair<Spectrum, Float> eval_pdf(const BSDFContext &ctx, const SurfaceInteraction3f &si,
                                        const Vector3f &wo, Mask active) const override {
        return eval_pdf_impl<true, true>(ctx, si, wo, active);
    }

    std::tuple<Spectrum, Float, BSDFSample3f, Spectrum>
    eval_pdf_sample(const BSDFContext &ctx, const SurfaceInteraction3f &si, const Vector3f &wo, Float sample1,
                    const Point2f &sample2, Mask active) const override {
        if constexpr (HasKernelCall) {
            // f of both directions in one call. Where importance is transported they have no view in common.
            if (!m_is_surface && ctx.mode == TransportMode::Radiance &&
                ctx.is_enabled(BSDFFlags::GlossyReflection) && calls_from_kernel(si.wi, wo)) {
                MI_MASKED_FUNCTION(ProfilerPhase::BSDFEvaluate, active);
                Mask lit = active && is_lit(si.wi, wo);
                auto [bs, chosen] = sample_direction(si.wi, sample1, sample2, active);
                auto [f, f_chosen] = m_call.eval(wo, lit, bs.wo, chosen, si.wi);
                auto [sample, weight] = weighted(bs, f_chosen, si, chosen);
                return { to_spectrum(f * Frame3f::cos_theta(wo), si, lit), direction_pdf(si.wi, wo, lit), sample,
                         weight };
            }
        }
        return Base::eval_pdf_sample(ctx, si, wo, sample1, sample2, active);
    }

    std::string to_string() const override {
        std::ostringstream oss;
        oss << "Glimt[" << std::endl
            << "  filename = \"" << m_file << "\"," << std::endl
            << "  material = \"" << m_name << "\"," << std::endl
            << "  model = " << std::string(m_material->description()) << "," << std::endl;
        if (m_material->has_microfacet())
            oss << "  kd = " << m_kd << "," << std::endl
                << "  eta = " << m_eta << "," << std::endl
                << "  alpha = " << m_alpha << "," << std::endl;
        if (dr::width(m_latent) > 0)
            oss << "  latent = " << m_latent << "," << std::endl;
        oss << "  tint = " << m_tint << "," << std::endl;
        if (m_is_surface)
            oss << "  to_uv = " << string::indent(m_texturing.to_uv()) << "," << std::endl
                << "  pixel_angle = " << m_pixel_angle << "," << std::endl;
        const char *way = calls_from_kernel()   ? "in-kernel call"
                          : dr::is_jit_v<Float> ? "traced"
                                                : "direct call";
        oss << "  evaluation = " << way << "," << std::endl
            << "  sampler = " << (m_is_surface ? "of every place" : std::string(m_material->sampler())) << std::endl
            << "]";
        return oss.str();
    }

    MI_DECLARE_CLASS(Glimt)

private:
    using Material = glimt::core::Material;
    using FloatStorage = DynamicBuffer<Float>;
    static constexpr bool HasKernelCall = dr::is_llvm_v<Float>;
    struct Nothing { };
    /// Dr.Jit 1.5 aborts with LLVM 15 and 16 ("Cannot select: fmaximum") and works with 19.
    static constexpr int MinLLVMVersion = 17;

    // ----- Construction and edits -----

    /// Dr.Jit's kernels abort the process with the LLVM versions that many systems have.
    static void require_llvm() {
        int major = 0, minor = 0, patch = 0;
        jit_llvm_version(&major, &minor, &patch);
        if (major < MinLLVMVersion)
            Throw("glimt: Dr.Jit loaded LLVM %i.%i.%i, with which rendering aborts the process. Install "
                  "version %i or later (Debian, Ubuntu: apt-get install libllvm19) and set the "
                  "environment variable DRJIT_LIBLLVM_PATH to its libLLVM.so, or use a scalar variant.",
                  major, minor, patch, MinLLVMVersion);
    }

    /// The result of a call into Rust; an error there becomes one of Mitsuba's.
    template <typename Call> static rust::Box<Material> checked(const Call &call) {
        try {
            return call();
        } catch (const std::exception &e) { // rust::Error
            Throw("glimt: %s", e.what());
        }
    }

    /// Takes the parameters over from \c material.
    void fetch(const Material &material) {
        if (material.has_microfacet()) {
            auto p = material.microfacet();
            m_kd = Color3f(p.kd[0], p.kd[1], p.kd[2]);
            m_eta = Color3f(p.eta[0], p.eta[1], p.eta[2]);
            m_alpha = Vector2f(p.alpha[0], p.alpha[1]);
            m_isotropic = p.alpha[0] == p.alpha[1];
        }
        auto latent = material.latent();
        if (!latent.empty())
            m_latent = dr::load<FloatStorage>(latent.data(), latent.size());
    }

    /// Takes the edits over from the scene description. Were there any?
    bool read_edits(const Properties &props, const Material &material) {
        bool edited = false;
        for (const char *name : { "kd", "eta", "alpha", "alpha_x", "alpha_y" }) {
            if (!props.has_property(name))
                continue;
            if (!material.has_microfacet())
                Throw("glimt: \"%s\" edits the analytic part of a model, but \"%s\" of \"%s\" is of the "
                      "kind %s, which has none.", name, m_name, m_file,
                      std::string(material.description()));
            edited = true;
        }
        if (props.has_property("kd"))
            m_kd = color(props, "kd");
        if (props.has_property("eta"))
            m_eta = color(props, "eta");
        const bool along_axes = props.has_property("alpha_x") || props.has_property("alpha_y");
        if (props.has_property("alpha")) {
            if (along_axes)
                Throw("glimt: give either \"alpha\" or \"alpha_x\" and \"alpha_y\", not both.");
            m_alpha = props.get<ScalarFloat>("alpha");
            m_isotropic = true;
        }
        if (along_axes) {
            if (!props.has_property("alpha_x") || !props.has_property("alpha_y"))
                Throw("glimt: \"alpha_x\" and \"alpha_y\" come together; for the same roughness along "
                      "both axes use \"alpha\".");
            m_alpha = Vector2f(props.get<ScalarFloat>("alpha_x"), props.get<ScalarFloat>("alpha_y"));
            m_isotropic = false;
        }
        return edited;
    }

    /// Takes over how maps lie on shapes. Other materials are the same wherever they are.
    void read_texturing(const Properties &props) {
        auto to_uv = props.get<ScalarAffineTransform3f>("to_uv", ScalarAffineTransform3f());
        const auto &tm = to_uv.matrix;
        const ScalarFloat det = tm.entry(0, 0) * tm.entry(1, 1) - tm.entry(0, 1) * tm.entry(1, 0);
        if (det == 0.f || !std::isfinite(det))
            Throw("glimt: \"to_uv\" has no inverse (its determinant is %f): every place of \"%s\" would be on one "
                  "line of the maps.", det, m_name);
        m_texturing = glimt::Texturing<Float>(to_uv);
        m_pixel_angle = props.get<ScalarFloat>("pixel_angle", 0.f);
        if (!m_is_surface && (props.has_property("to_uv") || props.has_property("pixel_angle")))
            Log(Info, "\"%s\" of \"%s\" is the same everywhere: \"to_uv\" and \"pixel_angle\" change nothing.", m_name,
                m_file);
    }

    /// Are the numbers that the core does not know in their ranges?
    void check_factors() const {
        auto check = [](const Float &value, const char *name) {
            const float x = host(value, name);
            if (!(x >= 0.f && std::isfinite(x)))
                Throw("glimt: \"%s\" is %f, expected a number that is not negative.", name, x);
        };
        for (size_t i = 0; i < 3; ++i)
            check(m_tint[i], "tint");
        check(m_pixel_angle, "pixel_angle");
    }

    /// A colour as the scene gives it, also in monochromatic variants: the core needs all three channels.
    static ScalarColor3f color(const Properties &props, const char *name) {
        switch (props.type(name)) {
            case Properties::Type::Color:
                return props.get<ScalarColor3f>(name);
            case Properties::Type::Float:
            case Properties::Type::Integer:
                return props.get<ScalarFloat>(name);
            case Properties::Type::Spectrum:
                if (auto *s = props.try_get<Properties::Spectrum>(name); s && s->is_uniform())
                    return (ScalarFloat) s->values.at(0);
                [[fallthrough]];
            default:
                Throw("glimt: \"%s\" must be an <rgb> or a <float>.", name);
        }
    }

    /// \c material with the parameters that this object holds.
    rust::Box<Material> edit(const Material &material) const {
        glimt::core::Microfacet microfacet {};
        if (material.has_microfacet()) {
            auto a = alpha();
            for (size_t i = 0; i < 3; ++i) {
                microfacet.kd[i] = host(m_kd[i], "kd");
                microfacet.eta[i] = host(m_eta[i], "eta");
            }
            for (size_t i = 0; i < 2; ++i)
                microfacet.alpha[i] = host(a[i], "alpha");
        }
        std::vector<float> latent(dr::width(m_latent));
        for (size_t i = 0; i < latent.size(); ++i)
            latent[i] = dr::detach<false>(m_latent).entry(i);
        return checked([&] { return material.edited(microfacet, { latent.data(), latent.size() }); });
    }

    /// Takes back the values of an update that was refused: Mitsuba has put them in place already.
    void restore() {
        put_back(m_kd, m_accepted.kd);
        put_back(m_eta, m_accepted.eta);
        put_back(m_alpha, m_accepted.alpha);
        put_back(m_latent, m_accepted.latent);
        put_back(m_tint, m_accepted.tint);
        put_back(m_pixel_angle, m_accepted.pixel_angle);
    }

    template <typename Value> static void put_back(Value &value, const Value &accepted) {
        if constexpr (dr::is_jit_v<Value> && dr::depth_v<Value> > 1) {
            for (size_t i = 0; i < Value::Size; ++i)
                put_back(value[i], accepted[i]);
        } else if constexpr (dr::is_jit_v<Value>) {
            // The variable that was there keeps the gradients that were enabled since.
            if (value.index() != accepted.index())
                value = accepted;
        } else {
            value = accepted;
        }
    }

    /// The value of a parameter, which is one number for the whole BSDF.
    static float host(const Float &value, const char *name) {
        if (dr::width(value) != 1)
            Throw("glimt: \"%s\" has %i values, expected one.", name, dr::width(value));
        if constexpr (dr::is_jit_v<Float>)
            return dr::detach<false>(value).entry(0);
        else
            return value;
    }

    static std::shared_ptr<const Material> share(rust::Box<Material> material) {
        return { material.into_raw(), [](Material *m) { rust::Box<Material>::from_raw(m); } };
    }

    /// Makes everything that depends on the material agree with it.
    void bind() {
        m_has_lobes = m_material->has_lobes() && !m_is_surface;
        if constexpr (dr::is_jit_v<Float>) {
            // Scalar variants sample in the core, where lobes are not chosen before they are needed.
            if (m_has_lobes)
                m_lobes = glimt::TracedLobes<Float>(m_material->lobes());
        }
        auto room = m_material->room();
        m_room = dr::load<FloatStorage>(room.data(), room.size());
        // Values that are not literals, so that a change of them compiles no new kernel.
        dr::make_opaque(m_kd, m_eta, m_alpha, m_latent, m_room, m_tint, m_pixel_angle);
        m_accepted = { m_kd, m_eta, m_alpha, m_latent, m_tint, m_pixel_angle };

        m_components.assign(1, BSDFFlags::GlossyReflection | BSDFFlags::FrontSide);
        if (!m_material->is_isotropic())
            m_components[0] |= +BSDFFlags::Anisotropic;
        if (!m_material->is_reciprocal())
            m_components[0] |= +BSDFFlags::NonSymmetric;
        if (m_is_surface)
            m_components[0] |= BSDFFlags::SpatiallyVarying | BSDFFlags::NeedsDifferentials;
        m_flags = m_components[0];

        if constexpr (HasKernelCall) {
            m_call.bind(m_material);
            m_call_works = kernel_call_works();
        }
        require_call();
    }

    /// Without a traced form, evaluation and sampling need the call from inside a kernel.
    void require_call() const {
        const bool is_traced = m_model.exists() && m_has_lobes;
        if (!dr::is_jit_v<Float> || is_traced)
            return;
        const char *what = m_model.exists() ? "has a sampler" : "is of a model";
        if constexpr (HasKernelCall) {
            if (!m_call_works || !(m_is_surface ? surface_call_works() : m_has_lobes || sampler_call_works()))
                Throw("glimt: \"%s\" of \"%s\" %s that is computed by a call from inside the compiled kernel, "
                      "which is not available here (packets of %u lanes). Use a scalar variant.",
                      m_name, m_file, what, jit_llvm_vector_width());
        } else {
            Throw("glimt: \"%s\" of \"%s\" %s that runs on the CPU only. Use a scalar or an llvm variant, or "
                  "another model and <string name=\"sampler\" value=\"lobes\"/>.", m_name, m_file, what);
        }
    }

    /// Checks the call from inside a kernel, the first time that it is asked.
    bool kernel_call_works() const {
        static std::atomic<State> state { Unknown };
        const bool was_known = state != Unknown;
        const bool works = remembered(state, [&] { return m_call.works(); });
        if (!was_known && !works && m_model.exists())
            Log(Warn, "The call from inside a kernel is not available (packets of %u lanes); the model is "
                      "traced instead, which is slower.", jit_llvm_vector_width());
        return works;
    }

    /// The same for densities and samples.
    bool sampler_call_works() const {
        static std::atomic<State> state { Unknown };
        return remembered(state, [&] { return m_sampler_call.works(m_call.address(), *m_material); });
    }

    /// The same for surfaces.
    bool surface_call_works() const {
        static std::atomic<State> state { Unknown };
        return remembered(state, [&] { return m_surface_call.works(m_call.address(), *m_material); });
    }

    enum State { Unknown, Works, Fails };

    /// What \c check found the first time that it was made.
    template <typename Check> static bool remembered(std::atomic<State> &state, const Check &check) {
        // No static initialiser, whose lock could be met again: Mitsuba loads scenes in parallel, and a
        // thread that waits for the kernel of the check goes on with the construction of other BSDFs.
        if (state == Unknown) {
            State expected = Unknown;
            state.compare_exchange_strong(expected, check() ? Works : Fails);
        }
        return state == Works;
    }

    // ----- Evaluation -----

    /// f_r |cosθ_o| and the density, each where asked for.
    template <bool Eval, bool Pdf>
    std::pair<Spectrum, Float> eval_pdf_impl(const BSDFContext &ctx, const SurfaceInteraction3f &si,
                                             const Vector3f &wo, Mask active) const {
        MI_MASKED_FUNCTION(ProfilerPhase::BSDFEvaluate, active);

        Float cos_theta_o = Frame3f::cos_theta(wo);
        active &= is_lit(si.wi, wo);
        if (!ctx.is_enabled(BSDFFlags::GlossyReflection) || dr::none_or<false>(active))
            return { 0.f, 0.f };

        if (m_is_surface) {
            auto [f, density] = eval_pdf_surface(ctx, si, wo, active);
            return { to_spectrum(f * cos_theta_o, si, active), density };
        }
        Spectrum value(0.f);
        Float density(0.f);
        if constexpr (Eval) {
            value = to_spectrum(reflectance(ctx, si.wi, wo, active) * cos_theta_o, si, active);
        }
        if constexpr (Pdf) {
            density = direction_pdf(si.wi, wo, active);
        }
        return { value, density };
    }

    /// The density with which \c wo is sampled for \c wi.
    Float direction_pdf(const Vector3f &wi, const Vector3f &wo, const Mask &active) const {
        if constexpr (!dr::is_jit_v<Float>) {
            return m_material->pdf(array(wo), array(wi));
        } else {
            if constexpr (HasKernelCall) {
                if (!m_has_lobes)
                    return m_sampler_call.pdf(m_call.address(), wo, wi, active);
            }
            return dr::select(active, m_lobes.pdf(wo, wi, active), 0.f);
        }
    }

    /// Can this pair carry energy: both above the horizon and, as in the core, of about unit length?
    static Mask is_lit(const Vector3f &wi, const Vector3f &wo) {
        auto is_direction = [](const Vector3f &w) {
            Float square = dr::squared_norm(w);
            return square >= .25f && square <= 4.f;
        };
        return Frame3f::cos_theta(wi) > 0.f && Frame3f::cos_theta(wo) > 0.f && is_direction(wi) &&
               is_direction(wo);
    }

    /// f_r, linear RGB. Where importance is transported, light comes from wi.
    Color3f reflectance(const BSDFContext &ctx, const Vector3f &wi, const Vector3f &wo,
                        const Mask &active) const {
        const bool radiance = ctx.mode == TransportMode::Radiance;
        const Vector3f &light = radiance ? wo : wi, &view = radiance ? wi : wo;
        if constexpr (!dr::is_jit_v<Float>) {
            auto f = m_material->eval(array(light), array(view));
            return { f[0], f[1], f[2] };
        } else {
            if constexpr (HasKernelCall) {
                if (calls_from_kernel(light, view))
                    return m_call.eval(light, view, active);
            }
            return m_model.eval(light, view, { { m_kd, m_eta, alpha() }, m_latent, m_room }, active);
        }
    }

    // ----- Surfaces -----

    using Value = dr::detached_t<Float>;
    using Place = glimt::TexturePlace<Value>;
    /// A direction without derivatives.
    using Direction = mitsuba::Vector<Value, 3>;

    /// Where a surface is asked. How much of it a pixel sees is known only where light is traced from the pixel.
    Place place(const BSDFContext &ctx, const SurfaceInteraction3f &si) const {
        Place place = m_texturing.place(si, m_pixel_angle);
        return ctx.mode == TransportMode::Radiance ? place : place.point();
    }

    /// f_r, linear RGB, and the density with which \c wo is sampled for \c si.wi.
    std::pair<Color3f, Float> eval_pdf_surface(const BSDFContext &ctx, const SurfaceInteraction3f &si,
                                               const Vector3f &wo, const Mask &active) const {
        if (dr::grad_enabled(si.wi, si.uv, wo))
            warn_of_detached_values();
        auto frame = m_texturing.frame(si);
        Place there = place(ctx, si);
        Direction in = frame.to_texture(Direction(dr::detach<false>(si.wi))),
                  out = frame.to_texture(Direction(dr::detach<false>(wo)));
        auto [f, density] = ask_surface(there, out, in, active);
        // Where importance is transported, light comes from wi, and wo is sampled all the same.
        if (ctx.mode == TransportMode::Importance)
            f = ask_surface(there, in, out, active).first;
        return { f, density };
    }

    /// A sample of \c wo for \c si.wi.
    std::pair<BSDFSample3f, Spectrum> sample_surface(const BSDFContext &ctx, const SurfaceInteraction3f &si,
                                                     const Float &sample1, const Point2f &sample2,
                                                     Mask active) const {
        if (dr::grad_enabled(si.wi, si.uv))
            warn_of_detached_values();
        auto frame = m_texturing.frame(si);
        Place there = place(ctx, si);
        Direction in = frame.to_texture(Direction(dr::detach<false>(si.wi))), out;
        Value pdf(0.f);
        Color3f weight(0.f);
        if constexpr (!dr::is_jit_v<Float>) {
            auto s = m_material->sample_at(core_place(there), array(in), { sample1, sample2.x(), sample2.y() });
            out = Direction(s.light[0], s.light[1], s.light[2]);
            pdf = s.pdf;
            weight = Color3f(s.weight[0], s.weight[1], s.weight[2]);
        } else if constexpr (HasKernelCall) {
            Direction u(dr::detach<false>(sample1), dr::detach<false>(sample2.x()), dr::detach<false>(sample2.y()));
            std::tie(out, pdf, weight) =
                m_surface_call.sample(m_call.address(), there, in, u, dr::detach<false>(active));
        }
        active &= pdf > 0.f;
        // The core's weight is that of radiance, for which wi is the view.
        if (ctx.mode == TransportMode::Importance)
            weight = ask_surface(there, in, out, active).first *
                     (Frame3f::cos_theta(out) / dr::select(active, pdf, 1.f));
        return { reflected(frame.to_shading(out), pdf), to_spectrum(weight, si, active) };
    }

    /// f_r and the density of \c light, both in the frame of the texture.
    std::pair<Color3f, Float> ask_surface(const Place &there, const Direction &light, const Direction &view,
                                          const Mask &active) const {
        DRJIT_MARK_USED(active);
        if constexpr (!dr::is_jit_v<Float>) {
            glimt::core::Place p = core_place(there);
            auto f = m_material->eval_at(p, array(light), array(view));
            return { Color3f(f[0], f[1], f[2]), m_material->pdf_at(p, array(light), array(view)) };
        } else if constexpr (HasKernelCall) {
            return m_surface_call.eval_pdf(m_call.address(), there, light, view, dr::detach<false>(active));
        } else {
            // Construction has refused it.
            return { 0.f, 0.f };
        }
    }

    /// A sample of the one component that there is.
    static BSDFSample3f reflected(const Vector3f &wo, const Float &pdf) {
        BSDFSample3f bs = dr::zeros<BSDFSample3f>();
        bs.wo = wo;
        bs.pdf = pdf;
        bs.eta = 1.f;
        bs.sampled_type = +BSDFFlags::GlossyReflection;
        return bs;
    }

    /// The choice of a direction; also, where it did not fail.
    std::pair<BSDFSample3f, Mask> sample_direction(const Vector3f &wi, const Float &sample1,
                                                   const Point2f &sample2, const Mask &active) const {
        if constexpr (HasKernelCall) {
            if (!m_has_lobes) {
                auto [wo, pdf] = m_sampler_call.sample(m_call.address(), wi, sample1, sample2, active);
                return { reflected(wo, pdf), pdf > 0.f };
            }
        }
        auto [wo, density] = m_lobes.sample(wi, sample1, sample2, active);
        Mask lit = active && is_lit(wi, wo);
        Float pdf = dr::select(lit, density, 0.f);
        return { reflected(wo, pdf), lit && pdf > 0.f };
    }

    /// A sample with its weight from f. Where f is near the end of float32 the weight can be beyond it; then
    /// the sample failed, as in the core.
    std::pair<BSDFSample3f, Spectrum> weighted(BSDFSample3f bs, const Color3f &f, const SurfaceInteraction3f &si,
                                               const Mask &lit) const {
        Color3f weight = f * (Frame3f::cos_theta(bs.wo) / bs.pdf);
        Mask valid = lit && dr::all(dr::isfinite(weight));
        bs.pdf = dr::select(valid, bs.pdf, 0.f);
        return { bs, to_spectrum(weight, si, valid) };
    }

    /// Linear RGB, tinted, as the variant's kind of colour, where \c active.
    Spectrum to_spectrum(const Color3f &rgb, const SurfaceInteraction3f &si, const Mask &active) const {
        return depolarizer<Spectrum>(spectrum(rgb * m_tint, si, active)) & active;
    }

    UnpolarizedSpectrum spectrum(const Color3f &rgb, const SurfaceInteraction3f &si, const Mask &active) const {
        DRJIT_MARK_USED(si);
        DRJIT_MARK_USED(active);
        if constexpr (is_monochromatic_v<Spectrum>)
            return luminance(rgb);
        else if constexpr (is_spectral_v<Spectrum>)
            return m_primaries.template upsample<UnpolarizedSpectrum>(rgb, si.wavelengths, active);
        else
            return rgb;
    }

    static std::array<float, 3> array(const Vector3f &w) { return { w.x(), w.y(), w.z() }; }

    /// An isotropic material exposes one roughness, and only that one can carry a gradient.
    Vector2f alpha() const { return { m_alpha.x(), m_isotropic ? m_alpha.x() : m_alpha.y() }; }

    /// Is the network, where there is one, in the core? The analytic model alone is less work than a call.
    bool calls_from_kernel() const { return HasKernelCall && m_call_works && m_model.has_network(); }

    /// … for these directions, too? A call has no derivative; a model without a traced form is detached.
    bool calls_from_kernel(const Vector3f &wi, const Vector3f &wo) const {
        if (!calls_from_kernel() || !dr::grad_enabled(wi, wo, m_kd, m_eta, m_alpha, m_latent))
            return calls_from_kernel();
        if (!m_model.exists())
            warn_of_detached_values();
        return !m_model.exists();
    }

    /// Once for every material: a derivative that is silently 0 costs its user an afternoon.
    void warn_of_detached_values() const {
        if (!m_warned.exchange(true))
            Log(Warn, "Gradients are enabled for a direction, a place or a parameter, but \"%s\" of \"%s\" is of a "
                      "model (%s) that has no derivatives but that of \"tint\": its reflectance is taken for "
                      "constant. Models with derivatives are %s.",
                m_name, m_file, std::string(m_material->description()),
                std::string(glimt::core::traced_models()));
    }

    std::string m_file, m_name;
    std::shared_ptr<const Material> m_material;
    glimt::TracedModel<Float> m_model;
    glimt::TracedLobes<Float> m_lobes;
    std::conditional_t<HasKernelCall, glimt::KernelCall<Float>, Nothing> m_call;
    std::conditional_t<HasKernelCall, glimt::SamplerCall<Float>, Nothing> m_sampler_call;
    std::conditional_t<HasKernelCall, glimt::SurfaceCall<Float>, Nothing> m_surface_call;
    glimt::Texturing<Float> m_texturing;
    bool m_call_works = false, m_has_lobes = true, m_is_surface = false;
    mutable std::atomic<bool> m_warned { false };
    std::conditional_t<is_spectral_v<Spectrum>, glimt::Primaries<Float>, Nothing> m_primaries;

    Color3f m_kd, m_eta;
    Vector2f m_alpha;
    bool m_isotropic = true;
    FloatStorage m_latent;
    /// What an edit leaves of the network's correction, see rust/core/src/models/edit.rs.
    FloatStorage m_room;
    Color3f m_tint;
    Float m_pixel_angle;

    /// The parameters of \c m_material, to return to when an update is refused.
    struct {
        Color3f kd, eta;
        Vector2f alpha;
        FloatStorage latent;
        Color3f tint;
        Float pixel_angle;
    } m_accepted;

    MI_TRAVERSE_CB(Base, m_kd, m_eta, m_alpha, m_latent, m_room, m_tint, m_pixel_angle, m_lobes, m_call,
                   m_sampler_call, m_surface_call, m_primaries)
};

MI_EXPORT_PLUGIN(Glimt)
NAMESPACE_END(mitsuba)
