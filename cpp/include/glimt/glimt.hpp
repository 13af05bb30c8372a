// glimt for C++17: the objects of glimt.h with destructors, and its errors as exceptions.
//
//     glimt::Library library("rgl.safetensors");
//     glimt::Material material = library.material("chm_orange");
//     glimt::Vec3 f = material.eval(light, view);
//
// Conventions of directions and colours are those of glimt.h. What may fail throws glimt::Error;
// eval, pdf and sample throw nothing and allocate nothing, so that a renderer can call them anywhere.

#ifndef GLIMT_HPP
#define GLIMT_HPP

#if __cplusplus < 201703L && (!defined(_MSVC_LANG) || _MSVC_LANG < 201703L)
#error "glimt/glimt.hpp needs C++17 or later (-std=c++17); older C++ can use the C interface, glimt/glimt.h"
#elif !defined(__cpp_exceptions) && !defined(_CPPUNWIND)
#error "glimt/glimt.hpp reports errors as exceptions; under -fno-exceptions use the C interface, glimt/glimt.h"
#else

#include <array>
#include <cstddef>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "glimt.h"

namespace glimt {

/// A direction or a colour.
using Vec3 = std::array<float, 3>;
static_assert(sizeof(Vec3) == 3 * sizeof(float), "arrays of Vec3 are handed to C as they are");

/// A sampled light direction: light[3], pdf, weight[3]. Failed samples have pdf 0 and weight 0.
using Sample = glimt_light_sample;

/// A place on a surface: u, v, and the two axes of what is seen around it in uv, all 0 for a point.
using Place = glimt_place;

/// The message names the file, what was found and what was expected.
class Error : public std::runtime_error {
public:
    explicit Error(glimt_status status) : std::runtime_error(glimt_last_error()), status_(status) {}

    glimt_status status() const noexcept { return status_; }

private:
    glimt_status status_;
};

namespace detail {

inline void check(glimt_status status) {
    if (status != GLIMT_OK)
        throw Error(status);
}

struct Close {
    void operator()(glimt_library *library) const noexcept { glimt_library_close(library); }
    void operator()(glimt_material *material) const noexcept { glimt_material_release(material); }
};

} // namespace detail

/// Parameters of the analytic part that Material::edit() replaces.
struct Edit {
    std::optional<Vec3> kd;
    std::optional<Vec3> eta;
    std::optional<std::array<float, 2>> alpha;
};

/// A material at a place, by Material::at(). Valid as long as the material.
class At {
public:
    At(const glimt_material *material, const Place &place) noexcept : material_(material), place_(place) {}

    /// f_r(light, view) in 1/sr, without the cosine.
    Vec3 eval(const Vec3 &light, const Vec3 &view) const noexcept {
        Vec3 f{};
        glimt_eval_at(material_, &place_, light.data(), view.data(), f.data());
        return f;
    }

    /// Density in 1/sr with which sample() chooses light.
    float pdf(const Vec3 &light, const Vec3 &view) const noexcept {
        float pdf = 0;
        glimt_pdf_at(material_, &place_, light.data(), view.data(), &pdf);
        return pdf;
    }

    /// A light direction for a view direction, from three random numbers in [0, 1).
    Sample sample(const Vec3 &view, const Vec3 &u) const noexcept {
        Sample sample{};
        glimt_sample_at(material_, &place_, view.data(), u.data(), &sample);
        return sample;
    }

private:
    const glimt_material *material_;
    Place place_;
};

/// A material. Independent of the library that it came from; any number of threads may use it at
/// once. One that was moved from evaluates to 0.
class Material {
public:
    /// Takes a material of the C interface over.
    explicit Material(glimt_material *material) noexcept : material_(material) {}

    /// The material of the C interface.
    const glimt_material *get() const noexcept { return material_.get(); }

    std::string name() const { return info().name; }
    glimt_kind kind() const { return info().kind; }
    /// Whether it is another at every place. Without one, as in eval(), a surface is what it is from afar.
    bool is_surface() const { return info().is_surface; }
    std::vector<float> latent() const {
        const glimt_material_info all = info();
        return std::vector<float>(all.latent, all.latent + all.latent_size);
    }

    /// Kind, parameters and latent code. Its pointers live as long as the material.
    glimt_material_info info() const {
        glimt_material_info info{};
        detail::check(glimt_material_get_info(get(), &info));
        return info;
    }

    /// A copy with other parameters of its analytic part, and a sampler that follows them.
    Material edit(const Edit &edit) const {
        glimt_material *edited = nullptr;
        detail::check(glimt_material_edit(get(), edit.kd ? edit.kd->data() : nullptr,
                                          edit.eta ? edit.eta->data() : nullptr,
                                          edit.alpha ? edit.alpha->data() : nullptr, &edited));
        return Material(edited);
    }

    /// What the material is at a place: material.at(place).eval(light, view). A material that is no surface is
    /// the same at every place.
    At at(const Place &place) const & noexcept { return At(get(), place); }
    At at(const Place &place) && = delete;

    /// f_r(light, view) in 1/sr, without the cosine.
    Vec3 eval(const Vec3 &light, const Vec3 &view) const noexcept {
        Vec3 f{};
        glimt_eval(get(), light.data(), view.data(), f.data());
        return f;
    }

    /// Density in 1/sr with which sample() chooses light.
    float pdf(const Vec3 &light, const Vec3 &view) const noexcept {
        float pdf = 0;
        glimt_pdf(get(), light.data(), view.data(), &pdf);
        return pdf;
    }

    /// A light direction for a view direction, from three random numbers in [0, 1).
    Sample sample(const Vec3 &view, const Vec3 &u) const noexcept {
        Sample sample{};
        glimt_sample(get(), view.data(), u.data(), &sample);
        return sample;
    }

    /// eval() for n pairs: the same f within 16 ULP, and much faster than one by one.
    void eval(std::size_t n, const Vec3 *light, const Vec3 *view, Vec3 *f) const noexcept {
        if (n > 0)
            glimt_eval_batch(get(), n, light->data(), view->data(), f->data());
    }

    /// at().eval() for n pairs, each at a place of its own.
    void eval(std::size_t n, const Place *place, const Vec3 *light, const Vec3 *view, Vec3 *f) const noexcept {
        if (n > 0)
            glimt_eval_at_batch(get(), n, place, light->data(), view->data(), f->data());
    }

    /// pdf() for n pairs.
    void pdf(std::size_t n, const Vec3 *light, const Vec3 *view, float *pdf) const noexcept {
        if (n > 0)
            glimt_pdf_batch(get(), n, light->data(), view->data(), pdf);
    }

    /// sample() for n view directions.
    void sample(std::size_t n, const Vec3 *view, const Vec3 *u, Sample *samples) const noexcept {
        if (n > 0)
            glimt_sample_batch(get(), n, view->data(), u->data(), samples);
    }

private:
    std::unique_ptr<glimt_material, detail::Close> material_;
};

/// A model library in memory. Any number of threads may use it at once.
class Library {
public:
    /// Reads a library.
    explicit Library(const std::string &path) {
        glimt_library *library = nullptr;
        detail::check(glimt_library_open(path.c_str(), &library));
        library_.reset(library);
    }

    /// Number of materials.
    std::size_t size() const noexcept { return glimt_library_size(library_.get()); }

    /// The model as files and commands spell it, as glimt_library_kind().
    std::string kind() const { return glimt_library_kind(library_.get()); }

    /// Names of the materials in the file's order.
    std::vector<std::string> names() const {
        std::vector<std::string> names;
        for (std::size_t i = 0; i < size(); ++i)
            names.emplace_back(glimt_library_name(library_.get(), i));
        return names;
    }

    /// The material of that name.
    Material material(const std::string &name) const { return find(name.c_str()); }

    /// The only material of a library that holds one.
    Material material() const { return find(nullptr); }

    /// A material between two, with a share \c weight in [0, 1] of the second.
    Material mix(const std::string &a, const std::string &b, float weight) const {
        glimt_material *material = nullptr;
        detail::check(glimt_library_mix(library_.get(), a.c_str(), b.c_str(), weight, &material));
        return Material(material);
    }

private:
    Material find(const char *name) const {
        glimt_material *material = nullptr;
        detail::check(glimt_library_material(library_.get(), name, &material));
        return Material(material);
    }

    std::unique_ptr<glimt_library, detail::Close> library_;
};

} // namespace glimt

#endif // C++17 with exceptions
#endif
