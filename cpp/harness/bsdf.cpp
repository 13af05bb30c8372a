#include "bsdf.h"

namespace harness {

namespace {

glimt::Vec3 array(Vec v) { return {v.x, v.y, v.z}; }
Vec vec(const float *v) { return {v[0], v[1], v[2]}; }

} // namespace

bool Bsdf::to_front(Vec &light, Vec &view) const {
    if (two_sided && view.z < 0) {
        light.z = -light.z;
        view.z = -view.z;
    }
    return light.z > 0 && view.z > 0;
}

Vec Bsdf::eval(Vec light, Vec view, float u, float v) const {
    if (!to_front(light, view))
        return {};
    if (fault == Fault::swap)
        return reflectance(view, light, u, v) * light.z;
    return reflectance(light, view, u, v) * (fault == Fault::cosine ? 1.f : light.z);
}

float Bsdf::pdf(Vec light, Vec view) const {
    if (!to_front(light, view))
        return 0;
    return fault == Fault::pdf ? light.z / pi : density(light, view);
}

BsdfSample Bsdf::sample(Vec view, float u, float v, std::array<float, 3> numbers) const {
    const bool back = two_sided && view.z < 0;
    if (back)
        view.z = -view.z;
    if (view.z <= 0)
        return {};
    BsdfSample sample;
    sample.light = direction(view, numbers);
    sample.pdf = pdf(sample.light, view);
    if (!(sample.pdf > 0))
        return {};
    sample.weight = eval(sample.light, view, u, v) / sample.pdf;
    if (back)
        sample.light.z = -sample.light.z;
    return sample;
}

Vec Diffuse::reflectance(Vec, Vec, float u, float v) const {
    return (texture ? lookup_repeated(*texture, u, v) : color) / pi;
}
float Diffuse::density(Vec light, Vec) const { return light.z / pi; }
Vec Diffuse::direction(Vec, std::array<float, 3> numbers) const {
    return cosine_direction(numbers[1], numbers[2]);
}

Vec Glimt::reflectance(Vec light, Vec view, float, float) const {
    return vec(material_.eval(array(light), array(view)).data());
}
float Glimt::density(Vec light, Vec view) const { return material_.pdf(array(light), array(view)); }
Vec Glimt::direction(Vec view, std::array<float, 3> numbers) const {
    const glimt::Sample sample = material_.sample(array(view), numbers);
    return sample.pdf > 0 ? vec(sample.light) : Vec{};
}

} // namespace harness
