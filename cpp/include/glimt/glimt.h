/* glimt: compact and neural BRDFs, fitted to measured reflectance.

   A model library is opened once, and its materials answer f, pdf and samples. Objects are
   immutable, so that any number of threads may use them at once.

   Directions are unit vectors in the local shading frame, right-handed, with the normal +z. Both
   point away from the surface: light to where the energy comes from, view to where it goes.
   Colours are linear RGB.

   Pointers must be valid for what the function says of them. Where NULL is not allowed, a function
   that returns a status answers GLIMT_ERROR_ARGUMENT to it. Strings end with a zero byte. Every
   error leaves a message in glimt_last_error().

   Generated from rust/ffi/src/c_api.rs. */

#ifndef GLIMT_H
#define GLIMT_H

#include <stdbool.h>
#include <stddef.h>

/**
 * What a function answers.
 */
typedef enum glimt_status {
  /**
   * It did what it says.
   */
  GLIMT_OK = 0,
  /**
   * An argument is NULL that must not be, a name is not UTF-8, or a size is 0.
   */
  GLIMT_ERROR_ARGUMENT = 1,
  /**
   * The file cannot be read.
   */
  GLIMT_ERROR_READ = 2,
  /**
   * The file is not a model library, or not a valid one.
   */
  GLIMT_ERROR_FORMAT = 3,
  /**
   * The library has no material of that name, or has several and none was named.
   */
  GLIMT_ERROR_MATERIAL = 4,
  /**
   * A parameter is out of its range, or the model has no such parameter.
   */
  GLIMT_ERROR_PARAMETER = 5,
  /**
   * An error of glimt itself.
   */
  GLIMT_ERROR_INTERNAL = 6,
  /**
   * The file cannot be written.
   */
  GLIMT_ERROR_WRITE = 7,
} glimt_status;

/**
 * The model of a material.
 */
typedef enum glimt_kind {
  /**
   * The analytic BRDF alone: a Lambertian lobe under a GGX lobe.
   */
  GLIMT_KIND_GGX = 0,
  /**
   * The analytic BRDF, corrected by a network.
   */
  GLIMT_KIND_HYBRID = 1,
  /**
   * A network with learned shading frames.
   */
  GLIMT_KIND_NEURAL = 2,
  /**
   * A network of one material, as Sztrajman et al. 2021.
   */
  GLIMT_KIND_NBRDF = 3,
  /**
   * Tables over single angles, as Bagher et al. 2016.
   */
  GLIMT_KIND_FACTOR = 4,
  /**
   * A measured table as it is.
   */
  GLIMT_KIND_TABULATED = 5,
  /**
   * A published analytic model: Cook and Torrance, Ward, Ashikhmin and Shirley, Low, Bagher.
   */
  GLIMT_KIND_ANALYTIC = 6,
  /**
   * Features in tables on hemispheres and a network, as Dou et al.
   */
  GLIMT_KIND_SPHERICAL = 7,
  /**
   * Texture maps: a surface that is another at every place.
   */
  GLIMT_KIND_MAPS = 8,
  /**
   * A surface whose reflectance at every scale is learned, as Timonen et al.
   */
  GLIMT_KIND_GATED = 9,
} glimt_kind;

/**
 * A model library in memory. Immutable: any number of threads may use it at once.
 */
typedef struct glimt_library glimt_library;

/**
 * A material. Immutable: any number of threads may use it at once. It does not depend on the
 * library that it came from, which may be closed before it.
 */
typedef struct glimt_material glimt_material;

/**
 * What a material is made of.
 */
typedef struct glimt_material_info {
  /**
   * The name, UTF-8; valid as long as the material.
   */
  const char *name;
  /**
   * The model.
   */
  enum glimt_kind kind;
  /**
   * Whether the material is a surface: another at every place, for which glimt_eval_at() and its like ask.
   */
  bool is_surface;
  /**
   * Whether the model has an analytic part. If not, kd, eta and alpha are 0.
   */
  bool has_microfacet;
  /**
   * Diffuse albedo, linear RGB, in [0, 1].
   */
  float kd[3];
  /**
   * Relative index of refraction per channel, in [1, 10].
   */
  float eta[3];
  /**
   * GGX roughness along x and y, in [0.0001, 1].
   */
  float alpha[2];
  /**
   * The latent code, or NULL; valid as long as the material.
   */
  const float *latent;
  /**
   * Length of the latent code, 0 for models that have none.
   */
  size_t latent_size;
} glimt_material_info;

/**
 * A sampled light direction. A sample that failed has pdf 0 and weight 0.
 */
typedef struct glimt_light_sample {
  /**
   * Unit direction towards the light.
   */
  float light[3];
  /**
   * Density of the direction, in 1/sr.
   */
  float pdf;
  /**
   * f cos(theta_light) / pdf, linear RGB.
   */
  float weight[3];
} glimt_light_sample;

/**
 * A place on a surface, and how much of the surface around it is seen: a Gaussian.
 *
 * The axes of the footprint are what uv changes by over one standard deviation along each of two directions on the
 * screen. A pixel sees about half of what uv changes by from it to the next. Four zeros are a point, and infinity is
 * the whole surface; a number that is NaN counts as 0. A tile of the texture is [0, 1)^2, u to the right and v up.
 */
typedef struct glimt_place {
  /**
   * Texture coordinate to the right.
   */
  float u;
  /**
   * Texture coordinate up.
   */
  float v;
  /**
   * u of the first axis of the footprint.
   */
  float dudx;
  /**
   * v of the first axis.
   */
  float dvdx;
  /**
   * u of the second axis.
   */
  float dudy;
  /**
   * v of the second axis.
   */
  float dvdy;
} glimt_place;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * Version of glimt, as "major.minor.patch". A string that is always valid.
 */
const char *glimt_version(void);

/**
 * Message of the last error in the calling thread, UTF-8, one line; empty if there was none.
 *
 * It names the file, what was found and what was expected. Valid until the next error in the same
 * thread. Never NULL. A call that succeeds leaves the message as it is.
 */
const char *glimt_last_error(void);

/**
 * Reads a model library (.safetensors), a measurement (RGL .bsdf, MERL .binary, UTIA .bin), the weights
 * of a neural BRDF (.h5, .npz, .npy) or published analytic fits (.fit). A measurement and the weights are
 * libraries of one material.
 *
 * \param path     File name, UTF-8.
 * \param library  Receives the library, to be closed with glimt_library_close(); NULL on error.
 *
 * \return GLIMT_OK; GLIMT_ERROR_READ if the file cannot be read; GLIMT_ERROR_FORMAT if it is not a
 * valid library; GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_library_open(const char *path,
                                     struct glimt_library **library);

/**
 * Closes a library. Its materials stay valid; its names do not. NULL is ignored.
 */
void glimt_library_close(struct glimt_library *library);

/**
 * Number of materials in a library; 0 for NULL.
 */
size_t glimt_library_size(const struct glimt_library *library);

/**
 * Name of a material, UTF-8; valid until the library is closed.
 *
 * \param index  0 to glimt_library_size() - 1, in the file's order; the result is NULL for others.
 */
const char *glimt_library_name(const struct glimt_library *library, size_t index);

/**
 * The model of the library's materials as files and commands spell it: "ggx", "hybrid", "neural",
 * "nbrdf", "factor", "analytic", "spherical", "maps" or "gated", and "tabulated" for a measurement; valid until
 * the library is closed. NULL for NULL.
 */
const char *glimt_library_kind(const struct glimt_library *library);

/**
 * A material of a library.
 *
 * \param name      Name, UTF-8; NULL for the only material of a library that holds one.
 * \param material  Receives the material, to be released with glimt_material_release(); NULL on error.
 *
 * \return GLIMT_OK; GLIMT_ERROR_MATERIAL if there is no such material, and glimt_last_error() then
 * says which names are near; GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_library_material(const struct glimt_library *library,
                                         const char *name,
                                         struct glimt_material **material);

/**
 * A material between two of a library: for the models whose materials share a network, and ggx.
 *
 * \param a, b      Names, UTF-8.
 * \param weight    Share of the second, in [0, 1].
 * \param material  Receives the material, to be released with glimt_material_release(); NULL on error.
 *
 * \return GLIMT_OK; GLIMT_ERROR_MATERIAL if there is no such material; GLIMT_ERROR_PARAMETER if the two cannot be
 * mixed, or for a weight outside [0, 1]; GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_library_mix(const struct glimt_library *library,
                                    const char *a,
                                    const char *b,
                                    float weight,
                                    struct glimt_material **material);

/**
 * Releases a material. NULL is ignored.
 */
void glimt_material_release(struct glimt_material *material);

/**
 * What a material is made of.
 *
 * \param info  Receives it. Its pointers are valid until the material is released.
 *
 * \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_material_get_info(const struct glimt_material *material,
                                          struct glimt_material_info *info);

/**
 * A copy of a material with other parameters of its analytic part. The sampler follows them.
 *
 * \param kd     Three numbers in [0, 1], or NULL to keep them.
 * \param eta    Three numbers in [1, 10], or NULL to keep them.
 * \param alpha  Two numbers in [0.0001, 1], or NULL to keep them.
 * \param edited Receives the copy, to be released with glimt_material_release(); NULL on error.
 *
 * \return GLIMT_OK; GLIMT_ERROR_PARAMETER for a number out of its range or a model without an
 * analytic part; GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_material_edit(const struct glimt_material *material,
                                      const float *kd,
                                      const float *eta,
                                      const float *alpha,
                                      struct glimt_material **edited);

/**
 * Evaluates f_r(light, view) in 1/sr, linear RGB, without the cosine.
 *
 * Directions are unit vectors in the local frame, whose normal is +z, and point away from the
 * surface: light to where the energy comes from, view to where it goes. Below the horizon on
 * either side, and where a direction holds a NaN, f is 0. f is finite and never negative.
 * Allocates no memory. Not guaranteed: f(light, view) = f(view, light).
 *
 * A surface (is_surface of glimt_material_info) is what it is from afar here and in every function that takes no
 * place: glimt_eval_at() asks for one.
 *
 * \param f  Receives three numbers.
 *
 * \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_eval(const struct glimt_material *material,
                             const float *light,
                             const float *view,
                             float *f);

/**
 * Density in 1/sr (solid angle of light) with which glimt_sample() chooses light for view.
 *
 * Directions as for glimt_eval(). Below the horizon on either side, and where a direction holds a NaN,
 * it is 0; elsewhere it may be positive where f is 0. Allocates no memory, but in the first call of a
 * density or sample of a material, which makes its sampler in some milliseconds.
 *
 * \param pdf  Receives one number.
 *
 * \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_pdf(const struct glimt_material *material,
                            const float *light,
                            const float *view,
                            float *pdf);

/**
 * Chooses a light direction for a view direction.
 *
 * A direction that falls below the horizon is a failed sample: pdf 0 and weight 0, and GLIMT_OK.
 * Allocates no memory but in the first call, as glimt_pdf().
 *
 * \param view  Unit vector, as for glimt_eval().
 * \param u     Three random numbers in [0, 1): the first selects the lobe, the others a direction.
 * \param sample  Receives the direction, its density and its weight.
 *
 * \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_sample(const struct glimt_material *material,
                               const float *view,
                               const float *u,
                               struct glimt_light_sample *sample);

/**
 * glimt_eval() at a place of a surface. A material that is no surface is the same at every place, and place is
 * not looked at but for NULL.
 *
 * Allocates no memory.
 *
 * \param place  Where, and how much is seen around it.
 * \param f      Receives three numbers.
 *
 * \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_eval_at(const struct glimt_material *material,
                                const struct glimt_place *place,
                                const float *light,
                                const float *view,
                                float *f);

/**
 * glimt_pdf() at a place: the density with which glimt_sample_at() chooses light there.
 *
 * Allocates no memory for a surface, and what glimt_pdf() does for any other material.
 *
 * \param place  As for glimt_eval_at().
 * \param pdf    Receives one number.
 *
 * \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_pdf_at(const struct glimt_material *material,
                               const struct glimt_place *place,
                               const float *light,
                               const float *view,
                               float *pdf);

/**
 * glimt_sample() at a place. Memory as glimt_pdf_at().
 *
 * \param place   As for glimt_eval_at().
 * \param view    Unit vector, as for glimt_eval().
 * \param u       Three random numbers in [0, 1).
 * \param sample  Receives the direction, its density and its weight.
 *
 * \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_sample_at(const struct glimt_material *material,
                                  const struct glimt_place *place,
                                  const float *view,
                                  const float *u,
                                  struct glimt_light_sample *sample);

/**
 * glimt_eval() for n pairs. Much faster than n calls.
 *
 * f differs from that of glimt_eval() by rounding only: by no more than 16 ULP of f's largest channel, as one pair's
 * sums are added in another order. A pair has the same bits in every batch, wherever it stands there.
 *
 * Runs in the calling thread. Allocates no memory.
 *
 * \param light  n directions, one after the other: 3 n numbers.
 * \param view   As many directions.
 * \param f      Receives 3 n numbers; must not overlap with light or view.
 *
 * \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_eval_batch(const struct glimt_material *material,
                                   size_t n,
                                   const float *light,
                                   const float *view,
                                   float *f);

/**
 * glimt_eval_at() for n pairs, each at a place of its own. A surface gives the bits of glimt_eval_at(), any other
 * material those of glimt_eval_batch().
 *
 * Runs in the calling thread. Allocates no memory.
 *
 * \param place  n places.
 * \param light  n directions, one after the other: 3 n numbers.
 * \param view   As many directions.
 * \param f      Receives 3 n numbers; must not overlap with place, light or view.
 *
 * \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_eval_at_batch(const struct glimt_material *material,
                                      size_t n,
                                      const struct glimt_place *place,
                                      const float *light,
                                      const float *view,
                                      float *f);

/**
 * glimt_pdf() for n pairs.
 *
 * Runs in the calling thread. Allocates no memory but in the first call, as glimt_pdf().
 *
 * \param light  n directions, one after the other: 3 n numbers.
 * \param view   As many directions.
 * \param pdf    Receives n numbers; must not overlap with light or view.
 *
 * \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_pdf_batch(const struct glimt_material *material,
                                  size_t n,
                                  const float *light,
                                  const float *view,
                                  float *pdf);

/**
 * glimt_sample() for n view directions.
 *
 * Runs in the calling thread. Allocates no memory but in the first call, as glimt_pdf().
 *
 * \param view     n directions, one after the other: 3 n numbers.
 * \param u        3 n random numbers in [0, 1).
 * \param samples  Receives n samples.
 *
 * \return GLIMT_OK or GLIMT_ERROR_ARGUMENT.
 */
enum glimt_status glimt_sample_batch(const struct glimt_material *material,
                                     size_t n,
                                     const float *view,
                                     const float *u,
                                     struct glimt_light_sample *samples);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* GLIMT_H */
