/* Prints f, its density and a sample of one material, in plain C.

       evaluate LIBRARY.safetensors [MATERIAL] */

#include <stdio.h>

#include <glimt/glimt.h>

static int fail(void) {
    fprintf(stderr, "error: %s\n", glimt_last_error());
    return 1;
}

static int evaluate(const glimt_material *material) {
    const float light[3] = {-0.6f, 0.0f, 0.8f};
    const float view[3] = {0.6f, 0.0f, 0.8f};
    const float u[3] = {0.25f, 0.5f, 0.75f};
    float f[3], pdf;
    glimt_light_sample sample;
    if (glimt_eval(material, light, view, f) || glimt_pdf(material, light, view, &pdf) ||
        glimt_sample(material, view, u, &sample))
        return fail();
    printf("f      %.6g %.6g %.6g\n", f[0], f[1], f[2]);
    printf("pdf    %.6g\n", pdf);
    printf("sample %.6g %.6g %.6g, pdf %.6g, weight %.6g %.6g %.6g\n", sample.light[0], sample.light[1],
           sample.light[2], sample.pdf, sample.weight[0], sample.weight[1], sample.weight[2]);
    return 0;
}

int main(int argc, char **argv) {
    glimt_library *library;
    glimt_material *material;
    int code;
    if (argc < 2 || argc > 3) {
        fprintf(stderr, "usage: %s LIBRARY.safetensors [MATERIAL]\n", argv[0]);
        return 2;
    }
    if (glimt_library_open(argv[1], &library))
        return fail();
    /* The material lives on without its library. */
    code = glimt_library_material(library, argc == 3 ? argv[2] : NULL, &material) ? fail() : 0;
    glimt_library_close(library);
    if (code)
        return code;
    code = evaluate(material);
    glimt_material_release(material);
    return code;
}
