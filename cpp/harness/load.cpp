// The subset of Mitsuba's scene XML that the harness renders. Whatever is not listed is refused by name.
//
//   default                       with -D name=value of the command line
//   integrator   path             max_depth
//   sensor       perspective      fov (fov_axis x), to_world; sampler sample_count; film width, height, rfilter box
//   shape        rectangle, cube, sphere (center, radius), ply
//   bsdf         glimt (filename, material, kd, eta, alpha), diffuse (reflectance: rgb or bitmap), twosided, ref
//   emitter      area, constant, envmap (filename, scale, to_world)
//   texture      bitmap           an OpenEXR file, raw
//   transform    lookat, scale, rotate, translate, matrix

#include <filesystem>
#include <map>
#include <sstream>
#include <stdexcept>

#include <pugixml.hpp>

#include "scene.h"

namespace harness {

namespace {

namespace fs = std::filesystem;

class Loader {
public:
    Loader(const std::string &path, const Overrides &overrides) : path_(path), fault_(overrides.fault) {
        for (const auto &[name, value] : overrides.parameters)
            parameters_[name] = value;
    }

    Scene load() {
        pugi::xml_document document;
        const pugi::xml_parse_result parsed = document.load_file(path_.c_str());
        if (!parsed)
            throw std::runtime_error(path_.string() + ": " + parsed.description());
        for (const pugi::xml_node node : document.child("scene").children())
            element(node);
        return std::move(scene_);
    }

private:
    [[noreturn]] void refuse(pugi::xml_node node) const {
        std::ostringstream text;
        text << path_.string() << ": <" << node.name();
        for (const pugi::xml_attribute attribute : node.attributes())
            text << ' ' << attribute.name() << "=\"" << attribute.value() << '"';
        text << "> is not in the subset that the harness renders (cpp/harness/load.cpp lists it)";
        throw std::runtime_error(text.str());
    }

    /// An attribute with $names replaced.
    std::string text(pugi::xml_node node, const char *attribute = "value") const {
        std::string value = node.attribute(attribute).value();
        for (std::size_t at = value.find('$'); at != std::string::npos; at = value.find('$', at)) {
            std::size_t end = at + 1;
            while (end < value.size() && (std::isalnum(static_cast<unsigned char>(value[end])) || value[end] == '_'))
                ++end;
            const auto found = parameters_.find(value.substr(at + 1, end - at - 1));
            if (found == parameters_.end())
                refuse(node);
            value.replace(at, end - at, found->second);
        }
        return value;
    }

    std::vector<float> numbers(pugi::xml_node node, const char *attribute = "value") const {
        std::string value = text(node, attribute);
        std::replace(value.begin(), value.end(), ',', ' ');
        std::istringstream stream(value);
        std::vector<float> result;
        for (float number; stream >> number;)
            result.push_back(number);
        if (result.empty() || !stream.eof())
            refuse(node);
        return result;
    }

    float number(pugi::xml_node node, const char *attribute = "value") const { return numbers(node, attribute)[0]; }

    /// Three numbers, or one for all three.
    Vec vector(pugi::xml_node node, const char *attribute = "value") const {
        const std::vector<float> v = numbers(node, attribute);
        if (v.size() == 3)
            return {v[0], v[1], v[2]};
        if (v.size() != 1)
            refuse(node);
        return {v[0], v[0], v[0]};
    }

    /// The attributes x, y, z, or `value`.
    Vec axes(pugi::xml_node node, float missing) const {
        if (node.attribute("value"))
            return vector(node);
        const auto axis = [&](const char *name) { return node.attribute(name) ? number(node, name) : missing; };
        return {axis("x"), axis("y"), axis("z")};
    }

    static bool is(pugi::xml_node node, const char *tag, const char *type) {
        return std::string(node.name()) == tag && std::string(node.attribute("type").value()) == type;
    }
    static bool named(pugi::xml_node node, const char *name) { return std::string(node.attribute("name").value()) == name; }

    void element(pugi::xml_node node) {
        const std::string tag = node.name();
        if (tag == "default")
            parameters_.emplace(node.attribute("name").value(), node.attribute("value").value());
        else if (is(node, "integrator", "path"))
            integrator(node);
        else if (is(node, "sensor", "perspective"))
            sensor(node);
        else if (tag == "bsdf")
            bsdf(node);
        else if (tag == "shape")
            shape(node);
        else if (is(node, "emitter", "constant"))
            scene_.environment.emplace(vector(node.find_child_by_attribute("name", "radiance")));
        else if (is(node, "emitter", "envmap"))
            environment(node);
        else
            refuse(node);
    }

    void integrator(pugi::xml_node node) {
        for (const pugi::xml_node child : node.children()) {
            if (!named(child, "max_depth"))
                refuse(child);
            scene_.max_depth = static_cast<int>(number(child));
        }
    }

    void sensor(pugi::xml_node node) {
        float fov = 45;
        for (const pugi::xml_node child : node.children()) {
            const std::string tag = child.name();
            if (named(child, "fov"))
                fov = number(child);
            else if (named(child, "to_world"))
                scene_.camera.to_world = transform(child);
            else if (tag == "sampler")
                scene_.spp = static_cast<int>(number(child.find_child_by_attribute("name", "sample_count")));
            else if (tag == "film")
                film(child);
            else if (!named(child, "fov_axis") || text(child) != "x")
                refuse(child);
        }
        scene_.camera.tan_half_x = std::tan(fov * pi / 360);
    }

    void film(pugi::xml_node node) {
        bool box = false;
        for (const pugi::xml_node child : node.children()) {
            if (named(child, "width"))
                scene_.camera.width = static_cast<int>(number(child));
            else if (named(child, "height"))
                scene_.camera.height = static_cast<int>(number(child));
            else if (is(child, "rfilter", "box"))
                box = true;
            else
                refuse(child);
        }
        if (!box)
            throw std::runtime_error(path_.string() + ": the film needs <rfilter type=\"box\"/>: with another filter pixels share their samples");
    }

    void environment(pugi::xml_node node) {
        float scale = 1;
        Transform to_world;
        std::string file;
        for (const pugi::xml_node child : node.children()) {
            if (named(child, "filename"))
                file = resolve(text(child));
            else if (named(child, "scale"))
                scale = number(child);
            else if (named(child, "to_world"))
                to_world = transform(child);
            else
                refuse(child);
        }
        scene_.environment.emplace(read_exr(file), to_world, scale);
    }

    std::string resolve(const std::string &file) const { return (path_.parent_path() / file).string(); }

    std::shared_ptr<const Bsdf> bsdf(pugi::xml_node node) {
        std::shared_ptr<Bsdf> made;
        if (is(node, "bsdf", "glimt"))
            made = material(node);
        else if (is(node, "bsdf", "diffuse"))
            made = diffuse(node);
        else if (is(node, "bsdf", "twosided")) {
            made = std::const_pointer_cast<Bsdf>(bsdf(node.child("bsdf")));
            made->two_sided = true;
        } else
            refuse(node);
        if (node.attribute("id"))
            bsdfs_[node.attribute("id").value()] = made;
        return made;
    }

    std::shared_ptr<Bsdf> material(pugi::xml_node node) {
        std::string file, name;
        glimt::Edit edit;
        for (const pugi::xml_node child : node.children()) {
            if (named(child, "filename"))
                file = resolve(text(child));
            else if (named(child, "material"))
                name = text(child);
            else if (named(child, "kd") || named(child, "eta")) {
                const Vec v = vector(child);
                (named(child, "kd") ? edit.kd : edit.eta) = glimt::Vec3{v.x, v.y, v.z};
            } else if (named(child, "alpha")) {
                const float alpha = number(child);
                edit.alpha = {alpha, alpha};
            } else
                refuse(child);
        }
        const glimt::Library library(file);
        glimt::Material material = name.empty() ? library.material() : library.material(name);
        if (edit.kd || edit.eta || edit.alpha)
            material = material.edit(edit);
        auto made = std::make_shared<Glimt>(std::move(material));
        made->fault = fault_;
        return made;
    }

    std::shared_ptr<Bsdf> diffuse(pugi::xml_node node) {
        auto made = std::make_shared<Diffuse>();
        for (const pugi::xml_node child : node.children()) {
            if (!named(child, "reflectance"))
                refuse(child);
            if (is(child, "texture", "bitmap"))
                made->texture = std::make_shared<Image>(
                    read_exr(resolve(text(child.find_child_by_attribute("name", "filename")))));
            else
                made->color = vector(child);
        }
        return made;
    }

    void shape(pugi::xml_node node) {
        Shape shape;
        Transform to_world;
        const std::string type = node.attribute("type").value();
        Sphere sphere;
        std::string file;
        for (const pugi::xml_node child : node.children()) {
            const std::string tag = child.name();
            if (named(child, "to_world"))
                to_world = transform(child);
            else if (tag == "bsdf")
                shape.bsdf = bsdf(child);
            else if (tag == "ref" && bsdfs_.count(child.attribute("id").value()))
                shape.bsdf = bsdfs_[child.attribute("id").value()];
            else if (is(child, "emitter", "area"))
                shape.radiance = vector(child.find_child_by_attribute("name", "radiance"));
            else if (type == "sphere" && named(child, "center"))
                sphere.center = axes(child, 0);
            else if (type == "sphere" && named(child, "radius"))
                sphere.radius = number(child);
            else if (type == "ply" && named(child, "filename"))
                file = resolve(text(child));
            else
                refuse(child);
        }
        if (!shape.bsdf) {
            // As in Mitsuba: a lamp reflects nothing unless it says what.
            auto missing = std::make_shared<Diffuse>();
            if (shape.emits())
                missing->color = {};
            shape.bsdf = missing;
        }
        if (type == "sphere") {
            sphere.center = to_world.point(sphere.center);
            sphere.radius *= length(to_world.vector({1, 0, 0}));
            shape.sphere = sphere;
        } else if (type == "rectangle")
            shape.mesh = rectangle();
        else if (type == "cube")
            shape.mesh = cube();
        else if (type == "ply")
            shape.mesh = load_ply(file);
        else
            refuse(node);
        for (Vec &p : shape.mesh.positions)
            p = to_world.point(p);
        for (Vec &n : shape.mesh.normals)
            n = to_world.normal(n);
        scene_.shapes.push_back(std::move(shape));
    }

    /// [−1, 1]² with normal +z.
    static Mesh rectangle() {
        return {{{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}},
                {},
                {{0, 0}, {1, 0}, {1, 1}, {0, 1}},
                {{0, 1, 2}, {2, 3, 0}}};
    }

    /// [−1, 1]³, flat, normals outwards, with the texture coordinates and thereby the tangents that Mitsuba's has.
    static Mesh cube() {
        static constexpr Vec along_u[6] = {{0, 1, 0}, {0, 1, 0}, {-1, 0, 0}, {0, 0, 1}, {0, 1, 0}, {0, -1, 0}};
        static constexpr Vec normals[6] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
        const Mesh square = rectangle();
        Mesh cube;
        for (int i = 0; i < 6; ++i) {
            const Frame face(normals[i], along_u[i]);
            const auto base = static_cast<std::uint32_t>(cube.positions.size());
            for (const Vec corner : square.positions)
                cube.positions.push_back(face.to_world(corner + Vec{0, 0, 1}));
            // v runs against the bitangent on every face.
            for (const auto &[u, v] : square.uvs)
                cube.uvs.push_back({u, 1 - v});
            for (const auto &[a, b, c] : square.triangles)
                cube.triangles.push_back({base + a, base + b, base + c});
        }
        return cube;
    }

    Transform transform(pugi::xml_node node) const {
        Transform result;
        for (const pugi::xml_node child : node.children()) {
            const std::string tag = child.name();
            Transform step;
            if (tag == "translate") {
                const Vec t = axes(child, 0);
                step.m[0][3] = t.x, step.m[1][3] = t.y, step.m[2][3] = t.z;
            } else if (tag == "scale") {
                const Vec s = axes(child, 1);
                step.m[0][0] = s.x, step.m[1][1] = s.y, step.m[2][2] = s.z;
            } else if (tag == "rotate")
                step = rotation(axes(child, 0), number(child, "angle") * pi / 180);
            else if (tag == "lookat")
                step = look_at(vector(child, "origin"), vector(child, "target"), vector(child, "up"));
            else if (tag == "matrix") {
                const std::vector<float> m = numbers(child);
                if (m.size() != 16)
                    refuse(child);
                for (std::size_t i = 0; i < 12; ++i)
                    step.m[i / 4][i % 4] = m[i];
            } else
                refuse(child);
            result = step.after(result);
        }
        return result;
    }

    /// Rodrigues' formula.
    static Transform rotation(Vec axis, float angle) {
        const Vec a = normalize(axis);
        const float c = std::cos(angle), s = std::sin(angle);
        Transform result;
        const Vec units[] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
        for (int j = 0; j < 3; ++j) {
            const Vec column = units[j] * c + cross(a, units[j]) * s + a * (dot(a, units[j]) * (1 - c));
            result.m[0][j] = column.x, result.m[1][j] = column.y, result.m[2][j] = column.z;
        }
        return result;
    }

    static Transform look_at(Vec origin, Vec target, Vec up) {
        const Vec forward = normalize(target - origin), left = normalize(cross(up, forward));
        const Vec columns[] = {left, cross(forward, left), forward, origin};
        Transform result;
        for (int j = 0; j < 4; ++j)
            result.m[0][j] = columns[j].x, result.m[1][j] = columns[j].y, result.m[2][j] = columns[j].z;
        return result;
    }

    fs::path path_;
    Fault fault_;
    std::map<std::string, std::string> parameters_;
    std::map<std::string, std::shared_ptr<Bsdf>> bsdfs_;
    Scene scene_;
};

} // namespace

Scene load_scene(const std::string &path, const Overrides &overrides) { return Loader(path, overrides).load(); }

} // namespace harness
