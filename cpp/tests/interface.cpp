// What glimt.h and glimt.hpp promise of errors, edits and lifetimes.
//
//     interface LIBRARY MATERIAL     a library whose materials have an analytic part

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <utility>

#include <glimt/glimt.hpp>

#define CHECK(condition)                                                                                \
    do {                                                                                                \
        if (!(condition)) {                                                                             \
            std::fprintf(stderr, "%s:%d: %s is false\n", __FILE__, __LINE__, #condition);               \
            std::exit(1);                                                                               \
        }                                                                                               \
    } while (false)

namespace {

bool mentions(const char *text) { return std::strstr(glimt_last_error(), text) != nullptr; }

void files_that_do_not_open(const std::string &library_path) {
    glimt_library *library = nullptr;
    CHECK(glimt_library_open("none.safetensors", &library) == GLIMT_ERROR_READ);
    CHECK(library == nullptr && mentions("none.safetensors"));
    CHECK(glimt_library_open(nullptr, &library) == GLIMT_ERROR_ARGUMENT && mentions("path is NULL"));
    CHECK(glimt_library_open("x", nullptr) == GLIMT_ERROR_ARGUMENT && mentions("library is NULL"));
    CHECK(glimt_library_open("\xff", &library) == GLIMT_ERROR_ARGUMENT && mentions("UTF-8"));

    const std::string broken = library_path + ".broken";
    std::ofstream(broken) << "not a library";
    CHECK(glimt_library_open(broken.c_str(), &library) == GLIMT_ERROR_FORMAT && mentions(".broken"));
    std::remove(broken.c_str());
}

void materials_that_are_not_there(const char *path, const std::string &name) {
    glimt_library *library = nullptr;
    CHECK(glimt_library_open(path, &library) == GLIMT_OK);
    glimt_material *material = nullptr;
    CHECK(glimt_library_material(library, (name + "x").c_str(), &material) == GLIMT_ERROR_MATERIAL);
    CHECK(material == nullptr && mentions(name.c_str()));
    CHECK(glimt_library_material(library, nullptr, &material) == GLIMT_ERROR_MATERIAL);
    CHECK(glimt_library_material(nullptr, name.c_str(), &material) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_library_name(library, glimt_library_size(library)) == nullptr);
    CHECK(glimt_library_size(nullptr) == 0 && glimt_library_kind(nullptr) == nullptr);
    glimt_library_close(library);
    glimt_library_close(nullptr);
    glimt_material_release(nullptr);
}

void null_arguments(const glimt_material *material) {
    const float direction[3] = {0, 0, 1};
    float f[3] = {7, 7, 7};
    glimt_light_sample sample;
    glimt_material_info info;
    CHECK(glimt_eval(nullptr, direction, direction, f) == GLIMT_ERROR_ARGUMENT && f[0] == 7);
    CHECK(glimt_eval(material, nullptr, direction, f) == GLIMT_ERROR_ARGUMENT && mentions("light is NULL"));
    CHECK(glimt_eval(material, direction, nullptr, f) == GLIMT_ERROR_ARGUMENT && mentions("view is NULL"));
    CHECK(glimt_eval(material, direction, direction, nullptr) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_pdf(material, direction, direction, nullptr) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_sample(material, nullptr, direction, &sample) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_sample(material, direction, direction, nullptr) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_material_get_info(nullptr, &info) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_material_get_info(material, nullptr) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_eval_batch(material, 2, direction, nullptr, f) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_pdf_batch(material, 2, nullptr, direction, f) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_sample_batch(material, 2, direction, direction, nullptr) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_eval_batch(material, 0, nullptr, nullptr, nullptr) == GLIMT_OK);
    CHECK(f[0] == 7);
}

void edits(const glimt::Material &material) {
    const glimt_material_info before = material.info();
    CHECK(before.has_microfacet);
    const glimt::Material red = material.edit({glimt::Vec3{0.9f, 0.1f, 0.1f}, {}, {}});
    const glimt_material_info after = red.info();
    CHECK(after.kd[0] == 0.9f && after.eta[0] == before.eta[0] && after.alpha[1] == before.alpha[1]);
    CHECK(red.name() == material.name() && red.latent() == material.latent());
    const glimt::Vec3 light{-0.6f, 0, 0.8f}, view{0.6f, 0, 0.8f};
    CHECK(red.eval(light, view) != material.eval(light, view));
    try {
        material.edit({{}, glimt::Vec3{0.5f, 1.5f, 1.5f}, {}});
        CHECK(false);
    } catch (const glimt::Error &error) {
        CHECK(error.status() == GLIMT_ERROR_PARAMETER);
        CHECK(std::strstr(error.what(), "eta is 0.5") != nullptr);
    }
}

void places(const glimt::Material &material) {
    const glimt::Vec3 light{-0.6f, 0, 0.8f}, view{0.6f, 0, 0.8f}, u{0.25f, 0.5f, 0.75f};
    CHECK(!material.is_surface());
    const glimt::At at = material.at({0.1f, 0.3f, 0, 0, 0, 0});
    CHECK(at.eval(light, view) == material.eval(light, view));
    CHECK(at.pdf(light, view) == material.pdf(light, view));
    CHECK(at.sample(view, u).pdf == material.sample(view, u).pdf);
}

void mixes(const glimt::Library &library, const std::string &name) {
    const glimt::Material one = library.material(name);
    const glimt::Vec3 light{-0.6f, 0, 0.8f}, view{0.6f, 0, 0.8f};
    std::string other;
    for (const std::string &candidate : library.names())
        if (candidate != name)
            other = candidate;
    const glimt::Material mix = library.mix(name, other, 0.3f);
    CHECK(mix.name() != name && mix.info().has_microfacet);
    CHECK(mix.eval(light, view) != one.eval(light, view));
    CHECK(library.mix(name, other, 0.f).eval(light, view) == one.eval(light, view));
    for (const float weight : {-0.1f, 1.5f}) {
        try {
            library.mix(name, other, weight);
            CHECK(false);
        } catch (const glimt::Error &error) {
            CHECK(error.status() == GLIMT_ERROR_PARAMETER);
        }
    }
    glimt_material *material = nullptr;
    CHECK(glimt_library_mix(nullptr, "a", "b", 0.5f, &material) == GLIMT_ERROR_ARGUMENT);
}

void directions_that_carry_nothing(const glimt::Material &material) {
    const glimt::Vec3 normal{0, 0, 1}, below{0.6f, 0, -0.8f};
    const float nan = std::strtof("nan", nullptr);
    const glimt::Vec3 dark{};
    CHECK(material.eval(below, normal) == dark && material.eval(normal, below) == dark);
    CHECK(material.eval({nan, 0, 1}, normal) == dark && material.pdf({nan, 0, 1}, normal) == 0);
    CHECK(material.sample(below, {0.5f, 0.5f, 0.5f}).pdf == 0);
}

} // namespace

int main(int argc, char **argv) {
    CHECK(argc == 3);
    CHECK(std::strlen(glimt_version()) > 0 && std::strlen(glimt_last_error()) == 0);
    files_that_do_not_open(argv[1]);
    materials_that_are_not_there(argv[1], argv[2]);

    std::optional<glimt::Library> library(argv[1]);
    glimt::Material material = library->material(argv[2]);
    mixes(*library, argv[2]);
    library.reset();
    null_arguments(material.get());
    edits(material);
    places(material);
    directions_that_carry_nothing(material);

    const glimt::Material taken = std::move(material);
    CHECK(taken.name() == argv[2]);
    // NOLINTNEXTLINE(bugprone-use-after-move): what a material that was moved from does is promised.
    CHECK(material.eval({0, 0, 1}, {0, 0, 1}) == glimt::Vec3{});
    CHECK(material.at({}).eval({0, 0, 1}, {0, 0, 1}) == glimt::Vec3{});
    return 0;
}
