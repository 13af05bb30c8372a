#include "path.h"

#include <atomic>
#include <thread>

namespace harness {

namespace {

/// Light that was chosen for a point: from a shape or from the environment.
struct LightSample {
    Vec direction;
    float distance = 0;
    float pdf = 0; ///< per solid angle, with the choice among the emitters
    Vec radiance;
};

/// Veach's power heuristic with exponent 2.
float mis_weight(float pdf, float other) {
    const float a = pdf * pdf, b = other * other;
    return a > 0 ? a / (a + b) : 0;
}

class Integrator {
public:
    explicit Integrator(const Scene &scene) : scene_(scene), tracer_(scene) {
        for (std::size_t i = 0; i < scene.shapes.size(); ++i)
            if (scene.shapes[i].emits()) {
                emitters_.push_back(i);
                areas_.push_back(cumulative_areas(scene.shapes[i]));
            }
    }

    /// Radiance that one path brings along a ray.
    Vec radiance(Ray ray, Random &random) const {
        Vec sum, throughput{1, 1, 1};
        float bsdf_pdf = 0; // of the ray, 0 for the camera's
        for (int depth = 0;; ++depth) {
            const std::optional<Hit> hit = tracer_.closest(ray);
            sum += throughput * emission(hit, ray, bsdf_pdf);
            if (!hit || depth + 1 >= scene_.max_depth)
                return sum;
            const Bsdf &bsdf = *hit->shape->bsdf;
            const Vec view = hit->shading.to_local(-ray.direction);

            const LightSample light = sample_light(*hit, random);
            if (light.pdf > 0) {
                const Vec direction = hit->shading.to_local(light.direction);
                const Vec reflected = bsdf.eval(direction, view, hit->u, hit->v) * light.radiance;
                if (reflected.max() > 0 && !tracer_.blocked(hit->spawn(light.direction), light.distance))
                    sum += throughput * reflected * (mis_weight(light.pdf, bsdf.pdf(direction, view)) / light.pdf);
            }

            const BsdfSample sample =
                bsdf.sample(view, hit->u, hit->v, {random.uniform(), random.uniform(), random.uniform()});
            if (!(sample.pdf > 0))
                return sum;
            throughput = throughput * sample.weight;
            bsdf_pdf = sample.pdf;
            ray = hit->spawn(hit->shading.to_world(sample.light));
            if (depth >= roulette_depth) {
                const float survival = std::min(throughput.max(), 0.95f);
                if (random.uniform() >= survival)
                    return sum;
                throughput = throughput / survival;
            }
        }
    }

private:
    static constexpr int roulette_depth = 4;

    /// Sums of the triangles' areas; of a sphere its area alone.
    static std::vector<float> cumulative_areas(const Shape &shape) {
        if (shape.sphere)
            return {4 * pi * shape.sphere->radius * shape.sphere->radius};
        std::vector<float> sums;
        float sum = 0;
        for (const auto &[i, j, k] : shape.mesh.triangles) {
            const Vec p = shape.mesh.positions[i];
            sum += 0.5f * length(cross(shape.mesh.positions[j] - p, shape.mesh.positions[k] - p));
            sums.push_back(sum);
        }
        return sums;
    }

    std::size_t emitter_count() const { return emitters_.size() + (scene_.environment ? 1 : 0); }

    /// What a ray sees of emitters, weighted against next-event estimation's way to the same light.
    Vec emission(const std::optional<Hit> &hit, const Ray &ray, float bsdf_pdf) const {
        const auto choice = static_cast<float>(emitter_count());
        if (!hit) {
            if (!scene_.environment)
                return {};
            const float weight =
                bsdf_pdf > 0 ? mis_weight(bsdf_pdf, scene_.environment->pdf(ray.direction) / choice) : 1;
            return scene_.environment->radiance(ray.direction) * weight;
        }
        const float cos = -dot(hit->shading.n, ray.direction);
        if (!hit->shape->emits() || cos <= 0)
            return {};
        float weight = 1;
        if (bsdf_pdf > 0) {
            const auto at = std::find(emitters_.begin(), emitters_.end(), hit->shape_index) - emitters_.begin();
            const float area = areas_[static_cast<std::size_t>(at)].back();
            weight = mis_weight(bsdf_pdf, hit->distance * hit->distance / (cos * area * choice));
        }
        return hit->shape->radiance * weight;
    }

    /// An emitter, all with the same chance, and a point of its area or a direction of the environment.
    LightSample sample_light(const Hit &hit, Random &random) const {
        if (emitter_count() == 0)
            return {};
        const auto choice = static_cast<float>(emitter_count());
        const auto chosen = std::min(static_cast<std::size_t>(random.uniform() * choice), emitter_count() - 1);
        const float u = random.uniform(), v = random.uniform(), w = random.uniform();
        LightSample light;
        if (chosen == emitters_.size()) {
            const Environment::Sample sample = scene_.environment->sample(u, v);
            light.direction = sample.direction;
            light.distance = std::numeric_limits<float>::infinity();
            light.pdf = sample.pdf / choice;
            light.radiance = scene_.environment->radiance(sample.direction);
            return light;
        }
        const Shape &shape = scene_.shapes[emitters_[chosen]];
        const std::vector<float> &areas = areas_[chosen];
        const auto [position, normal] = shape.sphere ? point_on(*shape.sphere, u, v) : point_on(shape.mesh, areas, u, v, w);
        const Vec across = position - hit.position;
        const float square = dot(across, across);
        light.direction = across / std::sqrt(square);
        // A little short of the light itself.
        light.distance = std::sqrt(square) * (1 - 1e-4f);
        const float cos = -dot(light.direction, normal);
        if (cos > 0) {
            light.pdf = square / (cos * areas.back() * choice);
            light.radiance = shape.radiance;
        }
        return light;
    }

    struct SurfacePoint {
        Vec position, normal;
    };

    static SurfacePoint point_on(const Sphere &sphere, float u, float v) {
        const float z = 1 - 2 * u, r = std::sqrt(std::max(0.f, 1 - z * z)), phi = 2 * pi * v;
        const Vec outward{r * std::cos(phi), r * std::sin(phi), z};
        return {sphere.center + outward * sphere.radius, outward};
    }

    static SurfacePoint point_on(const Mesh &mesh, const std::vector<float> &areas, float u, float v, float w) {
        const auto at = std::min(static_cast<std::size_t>(std::upper_bound(areas.begin(), areas.end(), u * areas.back()) - areas.begin()),
                                 areas.size() - 1);
        const auto [i, j, k] = mesh.triangles[at];
        const Vec p = mesh.positions[i], q = mesh.positions[j], r = mesh.positions[k];
        const float root = std::sqrt(v), b = 1 - root, c = w * root;
        return {p + (q - p) * b + (r - p) * c, normalize(cross(q - p, r - p))};
    }

    const Scene &scene_;
    Tracer tracer_;
    std::vector<std::size_t> emitters_;
    std::vector<std::vector<float>> areas_;
};

Ray camera_ray(const Camera &camera, float x, float y) {
    const auto width = static_cast<float>(camera.width), height = static_cast<float>(camera.height);
    // +x of the camera is left.
    const Vec local{(1 - 2 * x / width) * camera.tan_half_x,
                    (1 - 2 * y / height) * camera.tan_half_x * height / width, 1};
    return {camera.to_world.point({}), normalize(camera.to_world.vector(local))};
}

} // namespace

Rendering render(const Scene &scene, int spp, std::uint64_t seed) {
    const Camera &camera = scene.camera;
    const Integrator integrator(scene);
    Rendering rendering;
    for (Image *image : {&rendering.mean, &rendering.variance}) {
        image->width = camera.width, image->height = camera.height;
        image->pixels.resize(static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height));
    }
    std::atomic<int> next_row{0};
    const auto work = [&] {
        for (int y; (y = next_row++) < camera.height;)
            for (int x = 0; x < camera.width; ++x) {
                const std::size_t pixel = static_cast<std::size_t>(y) * static_cast<std::size_t>(camera.width) + static_cast<std::size_t>(x);
                Random random(pixel, seed);
                // Welford's running mean and sum of squared deviations.
                Vec mean, squares;
                for (int i = 0; i < spp; ++i) {
                    const float dx = random.uniform(), dy = random.uniform();
                    const Ray ray = camera_ray(camera, static_cast<float>(x) + dx, static_cast<float>(y) + dy);
                    const Vec value = integrator.radiance(ray, random);
                    const Vec before = value - mean;
                    mean += before / static_cast<float>(i + 1);
                    squares += before * (value - mean);
                }
                rendering.mean.pixels[pixel] = mean;
                rendering.variance.pixels[pixel] =
                    squares / (static_cast<float>(spp) * static_cast<float>(std::max(spp - 1, 1)));
            }
    };
    std::vector<std::thread> threads(std::max(1u, std::thread::hardware_concurrency()));
    for (std::thread &thread : threads)
        thread = std::thread(work);
    for (std::thread &thread : threads)
        thread.join();
    return rendering;
}

} // namespace harness
