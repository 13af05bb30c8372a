// PLY: a header in text, then vertices and faces in text or as little-endian binary.

#include <cstring>
#include <fstream>
#include <sstream>
#include <stdexcept>

#include "scene.h"

namespace harness {

namespace {

struct Property {
    std::string name, type, count_type; ///< count_type is empty for what is no list
};

struct Element {
    std::string name;
    std::size_t count = 0;
    std::vector<Property> properties;
};

/// Reads numbers of the types that the header names.
class Reader {
public:
    Reader(std::istream &stream, bool ascii) : stream_(stream), ascii_(ascii) {}

    double number(const std::string &type) {
        if (ascii_) {
            double value = 0;
            stream_ >> value;
            return value;
        }
        if (type == "float" || type == "float32")
            return raw<float>();
        if (type == "double" || type == "float64")
            return raw<double>();
        if (type == "uchar" || type == "uint8")
            return raw<std::uint8_t>();
        if (type == "ushort" || type == "uint16")
            return raw<std::uint16_t>();
        if (type == "uint" || type == "uint32")
            return raw<std::uint32_t>();
        if (type == "int" || type == "int32")
            return raw<std::int32_t>();
        throw std::runtime_error("it has numbers of type " + type + ", which are not read");
    }

private:
    template <class T> double raw() {
        T value{};
        stream_.read(reinterpret_cast<char *>(&value), sizeof(T));
        return static_cast<double>(value);
    }

    std::istream &stream_;
    bool ascii_;
};

std::vector<Element> header(std::istream &stream, bool &ascii) {
    std::string line, word;
    std::getline(stream, line);
    if (line.rfind("ply", 0) != 0)
        throw std::runtime_error("it does not begin with \"ply\"");
    std::vector<Element> elements;
    while (std::getline(stream, line)) {
        std::istringstream words(line);
        words >> word;
        if (word == "format") {
            words >> word;
            ascii = word == "ascii";
            if (!ascii && word != "binary_little_endian")
                throw std::runtime_error("its format is " + word + ", expected ascii or binary_little_endian");
        } else if (word == "element") {
            Element element;
            words >> element.name >> element.count;
            elements.push_back(element);
        } else if (word == "property" && !elements.empty()) {
            Property property;
            words >> property.type;
            if (property.type == "list")
                words >> property.count_type >> property.type;
            words >> property.name;
            elements.back().properties.push_back(property);
        } else if (word == "end_header") {
            return elements;
        }
    }
    throw std::runtime_error("its header does not end");
}

void read_vertex(Reader &reader, const Element &element, Mesh &mesh) {
    Vec position, normal;
    std::array<float, 2> uv{};
    bool has_normal = false, has_uv = false;
    for (const Property &property : element.properties) {
        const auto value = static_cast<float>(reader.number(property.type));
        const std::string &name = property.name;
        if (name == "x" || name == "y" || name == "z")
            (&position.x)[name[0] - 'x'] = value;
        else if (name == "nx" || name == "ny" || name == "nz") {
            (&normal.x)[name[1] - 'x'] = value;
            has_normal = true;
        } else if (name == "u" || name == "s" || name == "v" || name == "t") {
            uv[name == "v" || name == "t"] = value;
            has_uv = true;
        }
    }
    mesh.positions.push_back(position);
    if (has_normal)
        mesh.normals.push_back(normal);
    if (has_uv)
        mesh.uvs.push_back(uv);
}

void read_face(Reader &reader, const Element &element, Mesh &mesh) {
    for (const Property &property : element.properties) {
        if (property.count_type.empty()) {
            reader.number(property.type);
            continue;
        }
        const double count = reader.number(property.count_type);
        if (count != 3)
            throw std::runtime_error("it has a face of " + std::to_string(static_cast<int>(count)) + " corners, expected 3");
        std::array<std::uint32_t, 3> triangle{};
        for (std::uint32_t &corner : triangle) {
            corner = static_cast<std::uint32_t>(reader.number(property.type));
            if (corner >= mesh.positions.size())
                throw std::runtime_error("a face has corner " + std::to_string(corner) + ", and there are " +
                                         std::to_string(mesh.positions.size()) + " vertices");
        }
        mesh.triangles.push_back(triangle);
    }
}

} // namespace

Mesh load_ply(const std::string &path) {
    try {
        std::ifstream stream(path, std::ios::binary);
        if (!stream)
            throw std::runtime_error("it cannot be opened");
        bool ascii = false;
        const std::vector<Element> elements = header(stream, ascii);
        Reader reader(stream, ascii);
        Mesh mesh;
        for (const Element &element : elements)
            for (std::size_t i = 0; i < element.count; ++i) {
                if (element.name == "vertex")
                    read_vertex(reader, element, mesh);
                else
                    read_face(reader, element, mesh);
                if (!stream)
                    throw std::runtime_error("it ends too early");
            }
        return mesh;
    } catch (const std::runtime_error &error) {
        throw std::runtime_error(path + " cannot be read as PLY: " + error.what());
    }
}

} // namespace harness
