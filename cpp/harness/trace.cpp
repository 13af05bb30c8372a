#include "trace.h"

#include <limits>

// Debian has version 3 until bookworm and version 4 from trixie; they differ in how a query is called.
#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

namespace harness {

namespace {

#if RTC_VERSION_MAJOR >= 4
void intersect(RTCScene scene, RTCRayHit &query) { rtcIntersect1(scene, &query, nullptr); }
void occluded(RTCScene scene, RTCRay &query) { rtcOccluded1(scene, &query, nullptr); }
#else
void intersect(RTCScene scene, RTCRayHit &query) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(scene, &context, &query);
}
void occluded(RTCScene scene, RTCRay &query) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded1(scene, &context, &query);
}
#endif

RTCRay query_ray(const Ray &ray, float far) {
    RTCRay query{};
    query.org_x = ray.origin.x, query.org_y = ray.origin.y, query.org_z = ray.origin.z;
    query.dir_x = ray.direction.x, query.dir_y = ray.direction.y, query.dir_z = ray.direction.z;
    query.tfar = far;
    query.mask = ~0u;
    return query;
}

RTCGeometry mesh_geometry(RTCDevice device, const Mesh &mesh) {
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    void *positions = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, sizeof(Vec),
                                              mesh.positions.size());
    std::copy(mesh.positions.begin(), mesh.positions.end(), static_cast<Vec *>(positions));
    using Triangle = std::array<std::uint32_t, 3>;
    void *triangles = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, sizeof(Triangle),
                                              mesh.triangles.size());
    std::copy(mesh.triangles.begin(), mesh.triangles.end(), static_cast<Triangle *>(triangles));
    return geometry;
}

RTCGeometry sphere_geometry(RTCDevice device, const Sphere &sphere) {
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_SPHERE_POINT);
    void *buffer =
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT4, 4 * sizeof(float), 1);
    const float values[] = {sphere.center.x, sphere.center.y, sphere.center.z, sphere.radius};
    std::copy(std::begin(values), std::end(values), static_cast<float *>(buffer));
    return geometry;
}

void complete(Hit &hit, const Sphere &sphere) {
    const Vec outward = normalize(hit.position - sphere.center);
    // Along the parallel; what Embree says of the point is less exact than the sphere.
    hit.position = sphere.center + outward * sphere.radius;
    hit.normal = outward;
    hit.shading = Frame(outward, {-outward.y, outward.x, 0});
}

void complete(Hit &hit, const Mesh &mesh, std::size_t index, float b, float c) {
    const auto [i, j, k] = mesh.triangles[index];
    const float a = 1 - b - c;
    const Vec p = mesh.positions[i], q = mesh.positions[j], r = mesh.positions[k];
    hit.position = p * a + q * b + r * c;
    hit.normal = normalize(cross(q - p, r - p));
    Vec along;
    if (!mesh.uvs.empty()) {
        const auto &s = mesh.uvs[i], &t = mesh.uvs[j], &w = mesh.uvs[k];
        hit.u = s[0] * a + t[0] * b + w[0] * c;
        hit.v = s[1] * a + t[1] * b + w[1] * c;
        const float du1 = t[0] - s[0], du2 = w[0] - s[0], dv1 = t[1] - s[1], dv2 = w[1] - s[1];
        const float determinant = du1 * dv2 - du2 * dv1;
        if (determinant != 0)
            along = ((q - p) * dv2 - (r - p) * dv1) / determinant;
    }
    const bool smooth = !mesh.normals.empty();
    hit.shading = Frame(smooth ? normalize(mesh.normals[i] * a + mesh.normals[j] * b + mesh.normals[k] * c) : hit.normal, along);
}

} // namespace

Ray Hit::spawn(Vec direction) const {
    // Beyond the rounding of positions of this size.
    const float size = 1 + std::max(std::abs(position.x), std::max(std::abs(position.y), std::abs(position.z)));
    const Vec offset = normal * (size * 2e-6f);
    return {dot(direction, normal) > 0 ? position + offset : position - offset, direction};
}

struct Tracer::Embree {
    RTCDevice device = rtcNewDevice(nullptr);
    RTCScene scene = rtcNewScene(device);

    ~Embree() {
        rtcReleaseScene(scene);
        rtcReleaseDevice(device);
    }
};

Tracer::Tracer(const Scene &scene) : scene_(scene), embree_(std::make_unique<Embree>()) {
    rtcSetSceneFlags(embree_->scene, RTC_SCENE_FLAG_ROBUST);
    for (std::size_t i = 0; i < scene.shapes.size(); ++i) {
        const Shape &shape = scene.shapes[i];
        RTCGeometry geometry = shape.sphere ? sphere_geometry(embree_->device, *shape.sphere)
                                            : mesh_geometry(embree_->device, shape.mesh);
        rtcCommitGeometry(geometry);
        rtcAttachGeometryByID(embree_->scene, geometry, static_cast<unsigned>(i));
        rtcReleaseGeometry(geometry);
    }
    rtcCommitScene(embree_->scene);
}

Tracer::~Tracer() = default;

std::optional<Hit> Tracer::closest(const Ray &ray) const {
    RTCRayHit query{};
    query.ray = query_ray(ray, std::numeric_limits<float>::infinity());
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    intersect(embree_->scene, query);
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID)
        return {};
    Hit hit;
    hit.shape_index = query.hit.geomID;
    hit.shape = &scene_.shapes[hit.shape_index];
    hit.distance = query.ray.tfar;
    hit.position = ray.origin + ray.direction * query.ray.tfar;
    if (hit.shape->sphere)
        complete(hit, *hit.shape->sphere);
    else
        complete(hit, hit.shape->mesh, query.hit.primID, query.hit.u, query.hit.v);
    return hit;
}

bool Tracer::blocked(const Ray &ray, float distance) const {
    RTCRay query = query_ray(ray, distance);
    occluded(embree_->scene, query);
    return query.tfar < 0;
}

} // namespace harness
