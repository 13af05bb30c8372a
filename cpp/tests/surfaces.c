/* What glimt.h promises of places, in plain C.

       surfaces LIBRARY MATERIAL SURFACE     whether the material is a surface: 0 or 1 */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <glimt/glimt.h>

#define CHECK(condition)                                                                                \
    do {                                                                                                \
        if (!(condition)) {                                                                             \
            fprintf(stderr, "%s:%d: %s is false\n", __FILE__, __LINE__, #condition);                    \
            exit(1);                                                                                    \
        }                                                                                               \
    } while (0)

static const float light[6] = {-0.6f, 0.0f, 0.8f, 0.0f, 0.0f, 1.0f};
static const float view[6] = {0.6f, 0.0f, 0.8f, 0.48f, 0.36f, 0.8f};
static const float u[3] = {0.25f, 0.5f, 0.75f};

static int same(const float *a, const float *b, size_t n) { return memcmp(a, b, n * sizeof(float)) == 0; }

static void null_arguments(const glimt_material *material) {
    const glimt_place place = {0};
    float f[3] = {7, 7, 7};
    glimt_light_sample sample;
    CHECK(glimt_eval_at(NULL, &place, light, view, f) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_eval_at(material, NULL, light, view, f) == GLIMT_ERROR_ARGUMENT);
    CHECK(strstr(glimt_last_error(), "place is NULL") != NULL);
    CHECK(glimt_eval_at(material, &place, NULL, view, f) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_eval_at(material, &place, light, view, NULL) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_pdf_at(material, NULL, light, view, f) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_sample_at(material, NULL, view, u, &sample) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_eval_at_batch(material, 1, NULL, light, view, f) == GLIMT_ERROR_ARGUMENT);
    CHECK(glimt_eval_at_batch(material, 0, NULL, NULL, NULL, NULL) == GLIMT_OK);
    CHECK(f[0] == 7);
}

/* Without a place a surface is what it is from afar, and any other material is the same everywhere. */
static void without_a_place(const glimt_material *material, int is_surface) {
    const glimt_place here = {0.1f, 0.3f, 0, 0, 0, 0};
    const glimt_place far = {0.1f, 0.3f, INFINITY, 0, 0, INFINITY};
    float f[3], at[3], from_afar[3], pdf, pdf_at;
    CHECK(glimt_eval(material, light, view, f) == GLIMT_OK);
    CHECK(glimt_eval_at(material, &here, light, view, at) == GLIMT_OK);
    CHECK(glimt_eval_at(material, &far, light, view, from_afar) == GLIMT_OK);
    CHECK(f[0] > 0 && same(f, from_afar, 3) && same(f, at, 3) == !is_surface);
    CHECK(glimt_pdf(material, light, view, &pdf) == GLIMT_OK);
    CHECK(glimt_pdf_at(material, &here, light, view, &pdf_at) == GLIMT_OK);
    CHECK(pdf > 0 && pdf_at > 0 && (pdf == pdf_at) == !is_surface);
}

static void at_places(const glimt_material *material, int is_surface) {
    const glimt_place places[2] = {{0.1f, 0.3f, 0, 0, 0, 0}, {0.6f, 0.7f, 0.05f, 0.01f, 0, 0.02f}};
    float each[6], batch[6], pdf;
    glimt_light_sample sample;
    int i;
    for (i = 0; i < 2; ++i)
        CHECK(glimt_eval_at(material, &places[i], light + 3 * i, view + 3 * i, each + 3 * i) == GLIMT_OK);
    CHECK(glimt_eval_at_batch(material, 2, places, light, view, batch) == GLIMT_OK);
    CHECK(!is_surface || same(each, batch, 6));
    for (i = 0; i < 6; ++i)
        CHECK(fabsf(each[i] - batch[i]) <= 1e-5f * each[i] + 2e-6f);
    CHECK(glimt_sample_at(material, &places[1], view, u, &sample) == GLIMT_OK && sample.pdf > 0);
    CHECK(glimt_pdf_at(material, &places[1], sample.light, view, &pdf) == GLIMT_OK && pdf == sample.pdf);
}

int main(int argc, char **argv) {
    glimt_library *library;
    glimt_material *material;
    glimt_material_info info;
    int is_surface;
    CHECK(argc == 4);
    is_surface = atoi(argv[3]);
    CHECK(glimt_library_open(argv[1], &library) == GLIMT_OK);
    CHECK(glimt_library_material(library, argv[2], &material) == GLIMT_OK);
    glimt_library_close(library);
    CHECK(glimt_material_get_info(material, &info) == GLIMT_OK && info.is_surface == is_surface);
    null_arguments(material);
    without_a_place(material, is_surface);
    at_places(material, is_surface);
    glimt_material_release(material);
    return 0;
}
