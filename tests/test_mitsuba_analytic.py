"""The analytic model against Mitsuba's own microfacet BSDF, which shares no line with it.

With k = 0 the Fresnel term of a conductor is that of a dielectric, and `roughconductor` has the same NDF and
the same separable masking: without a diffuse part, `ggx` must be the same function, and the same image.
"""

import numpy as np
import pytest
from mitsuba_common import dr, hemisphere, interaction, load, mi, write_libraries

ETA = [1.3, 1.5, 2.4]
ALPHAS = [(0.02, 0.02), (0.1, 0.1), (0.5, 0.5), (1.0, 1.0), (0.05, 0.3)]


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    return write_libraries(tmp_path_factory.mktemp("libraries"))


def rgb(value):
    return {"type": "rgb", "value": value}


def both(libraries, alpha):
    """The model and its twin."""
    along_axes = {"alpha_x": alpha[0], "alpha_y": alpha[1]}
    edits = {"kd": rgb([0.0] * 3), "eta": rgb(ETA), **along_axes}
    twin = {"type": "roughconductor", "distribution": "ggx", "eta": rgb(ETA), "k": rgb([0.0] * 3)}
    return load(libraries["brushed"], "brushed", **edits), mi.load_dict(
        {**twin, "alpha_u": alpha[0], "alpha_v": alpha[1]}
    )


@pytest.mark.parametrize("alpha", ALPHAS)
def test_ggx_without_a_diffuse_part_is_roughconductor(libraries, alpha):
    mi.set_variant("llvm_ad_rgb")
    ours, twin = both(libraries, alpha)
    light, view = hemisphere(100_000, 1), hemisphere(100_000, 2)
    si, wo = interaction(view), mi.Vector3f(light)
    f, truth = (np.array(dr.detach(bsdf.eval(mi.BSDFContext(), si, wo))) for bsdf in (ours, twin))
    # Mitsuba's half vector and slopes are rounded to float32 as well.
    assert np.max(np.abs(f - truth) / (truth + 1e-6)) < 2e-3
    assert np.mean(np.abs(f - truth) / (truth + 1e-6)) < 1e-5


@pytest.mark.parametrize("alpha", [(0.1, 0.1), (0.05, 0.3)])
def test_a_sphere_of_ggx_is_a_sphere_of_roughconductor(libraries, alpha):
    mi.set_variant("llvm_ad_rgb")
    means, variances = [], []
    for bsdf in both(libraries, alpha):
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": 2},
                "sky": {"type": "constant", "radiance": 0.3},
                "lamp": {
                    "type": "sphere",
                    "center": [2.0, -2.0, 3.0],
                    "radius": 0.7,
                    "emitter": {"type": "area", "radiance": rgb([9.0, 8.0, 7.0])},
                },
                "sensor": {
                    "type": "perspective",
                    "fov": 26,
                    "to_world": mi.ScalarTransform4f().look_at([0, -5, 0], [0, 0, 0], [0, 0, 1]),
                    "film": {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": "box"}},
                },
                "sphere": {"type": "sphere", "bsdf": bsdf},
            }
        )
        passes = [np.array(mi.render(scene, spp=32, seed=seed))[..., :3] for seed in range(8)]
        means.append(np.mean(passes, axis=0))
        variances.append(np.var(passes, axis=0, ddof=1) / len(passes))
    # Sums over blocks of pixels are nearly normal; 5.5 standard deviations among 432 are no accident.
    images = means[0] - means[1], sum(variances)
    difference, variance = (image.reshape(12, 4, 12, 4, 3).sum(axis=(1, 3)) for image in images)
    assert np.max(np.abs(difference) / np.sqrt(variance + 1e-12)) < 5.5
