// Writes what a material answers, as raw float32, for the tests that compare languages.
//
//     answers LIBRARY MATERIAL PAIRS U PLACES ANSWERS
//
// PAIRS holds (light xyz, view xyz), and U three and PLACES six numbers for as many pairs. ANSWERS receives,
// one after the other for all pairs: f, the same from the batch call, pdf, the same from the batch call,
// samples for (view, u), and the same from the batch call; then, at the places, f, the same from the batch
// call, pdf, and samples. The first half of the pairs is evaluated in a second thread.

#include <cstdio>
#include <fstream>
#include <iterator>
#include <thread>

#include <glimt/glimt.hpp>

namespace {

std::vector<float> read(const char *path) {
    std::ifstream file(path, std::ios::binary);
    const std::vector<char> bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
    const float *begin = reinterpret_cast<const float *>(bytes.data());
    return std::vector<float>(begin, begin + bytes.size() / sizeof(float));
}

std::vector<glimt::Vec3> vectors(const std::vector<float> &numbers, std::size_t first, std::size_t stride) {
    std::vector<glimt::Vec3> vectors;
    for (std::size_t i = first; i + 2 < numbers.size(); i += stride)
        vectors.push_back({numbers[i], numbers[i + 1], numbers[i + 2]});
    return vectors;
}

std::vector<glimt::Place> places(const std::vector<float> &numbers) {
    std::vector<glimt::Place> places;
    for (const float *p = numbers.data(), *end = p + numbers.size(); p + 5 < end; p += 6)
        places.push_back({p[0], p[1], p[2], p[3], p[4], p[5]});
    return places;
}

template <typename T> void append(std::ofstream &file, const std::vector<T> &values) {
    file.write(reinterpret_cast<const char *>(values.data()),
               static_cast<std::streamsize>(values.size() * sizeof(T)));
}

void answer(const glimt::Material &material, char **argv) {
    const std::vector<float> pairs = read(argv[3]);
    const std::vector<glimt::Vec3> light = vectors(pairs, 0, 6), view = vectors(pairs, 3, 6);
    const std::vector<glimt::Vec3> u = vectors(read(argv[4]), 0, 3);
    const std::vector<glimt::Place> place = places(read(argv[5]));
    const std::size_t n = light.size();

    std::vector<glimt::Vec3> f(n), f_batch(n), f_at(n), f_at_batch(n);
    std::vector<float> pdf(n), pdf_batch(n), pdf_at(n);
    std::vector<glimt::Sample> samples(n), samples_batch(n), samples_at(n);
    const auto one_by_one = [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            f[i] = material.eval(light[i], view[i]);
            pdf[i] = material.pdf(light[i], view[i]);
            samples[i] = material.sample(view[i], u[i]);
            const glimt::At at = material.at(place[i]);
            f_at[i] = at.eval(light[i], view[i]);
            pdf_at[i] = at.pdf(light[i], view[i]);
            samples_at[i] = at.sample(view[i], u[i]);
        }
    };
    std::thread first_half(one_by_one, 0, n / 2);
    one_by_one(n / 2, n);
    first_half.join();
    material.eval(n, light.data(), view.data(), f_batch.data());
    material.pdf(n, light.data(), view.data(), pdf_batch.data());
    material.sample(n, view.data(), u.data(), samples_batch.data());
    material.eval(n, place.data(), light.data(), view.data(), f_at_batch.data());

    std::ofstream file(argv[6], std::ios::binary);
    append(file, f);
    append(file, f_batch);
    append(file, pdf);
    append(file, pdf_batch);
    append(file, samples);
    append(file, samples_batch);
    append(file, f_at);
    append(file, f_at_batch);
    append(file, pdf_at);
    append(file, samples_at);
}

} // namespace

int main(int argc, char **argv) {
    if (argc != 7) {
        std::fprintf(stderr, "usage: %s LIBRARY MATERIAL PAIRS U PLACES ANSWERS\n", argv[0]);
        return 2;
    }
    try {
        answer(glimt::Library(argv[1]).material(argv[2]), argv);
    } catch (const glimt::Error &error) {
        std::fprintf(stderr, "error %d: %s\n", error.status(), error.what());
        return 1;
    }
    return 0;
}
