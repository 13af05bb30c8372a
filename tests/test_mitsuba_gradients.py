"""Derivatives with respect to the parameters of a material, against central differences."""

import numpy as np
import pytest
from mitsuba_common import TRACED, dr, hemisphere, interaction, load, mi, write_libraries

# Central differences of float32 values summed over this many pairs are good to about a percent.
PAIRS = 400


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    mi.set_variant("llvm_ad_rgb")
    return write_libraries(tmp_path_factory.mktemp("libraries"))


def keys(params):
    return list(params.properties)


def flat(value):
    return np.atleast_1d(np.array(value, dtype=np.float64)).ravel()


def with_element(value, index, number):
    """A copy of a parameter with one of its numbers replaced."""
    if isinstance(value, mi.Color3f):
        return mi.Color3f(*[float(number if i == index else flat(value)[i]) for i in range(3)])
    numbers = flat(value)
    numbers[index] = number
    return mi.Float(numbers.astype(np.float32))


def differences(params, key, loss, step):
    """Central differences of ``loss()`` in each number of ``params[key]``."""
    original = type(params[key])(params[key])
    slopes = []
    for i, x in enumerate(flat(original)):
        sides = []
        for side in (x + step, x - step):
            params[key] = with_element(original, i, side)
            params.update()
            sides.append(float(loss()))
        slopes.append((sides[0] - sides[1]) / (2 * step))
    params[key] = original
    params.update()
    return np.array(slopes)


def gradients(params, key, loss):
    dr.enable_grad(params[key])
    params.update()
    dr.backward(loss())
    gradient = flat(dr.grad(params[key]))
    dr.disable_grad(params[key])
    return gradient


class Messages(mi.Appender):
    """What Mitsuba logs as a warning."""

    def __init__(self):
        super().__init__()
        self.warnings = []

    def append(self, level, text):
        if level == mi.LogLevel.Warn:
            self.warnings.append(text)

    def log_progress(self, progress, name, formatted, eta, ptr=None):
        pass


@pytest.fixture
def logged():
    messages, logger = Messages(), mi.logger()
    logger.add_appender(messages)
    yield messages.warnings
    logger.remove_appender(messages)


@pytest.mark.parametrize("library", ["spherical", "factor", "hybrid"])
def test_gradients_that_a_model_cannot_have_are_warned_of_once(libraries, logged, library):
    bsdf = load(libraries[library])
    si, context = interaction(hemisphere(4, 1, 0.2)), mi.BSDFContext()
    light = mi.Vector3f(hemisphere(4, 2, 0.2))
    bsdf.eval(context, si, light)
    assert not logged
    dr.enable_grad(light)
    bsdf.eval(context, si, light)
    bsdf.eval_pdf(context, si, light)
    if library in TRACED:
        assert not logged
    else:
        assert len(logged) == 1
        assert "no derivatives" in logged[0] and libraries[library].name in logged[0]


@pytest.mark.parametrize("library", TRACED)
def test_eval_has_the_derivatives_of_every_parameter(libraries, library):
    bsdf = load(libraries[library])
    params = mi.traverse(bsdf)
    si, wo = interaction(hemisphere(PAIRS, 1, 0.2)), mi.Vector3f(hemisphere(PAIRS, 2, 0.2))
    weight = mi.Color3f(1.0, 0.7, 0.4)

    def loss():
        return dr.mean(dr.sum(bsdf.eval(mi.BSDFContext(), si, wo) * weight))[0]

    if library == "nbrdf":
        assert keys(params) == ["tint"]
    for key in keys(params):
        expected = differences(params, key, loss, 4e-3)
        found = gradients(params, key, lambda: dr.mean(dr.sum(bsdf.eval(mi.BSDFContext(), si, wo) * weight)))
        assert np.any(expected != 0)
        # A finite step crosses the kinks of max(0, f_a + a) in some pairs.
        absolute = 2e-2 if library == "hybrid_additive" else 2e-3
        assert np.allclose(found, expected, rtol=0.02, atol=absolute * np.abs(expected).max()), key


@pytest.mark.parametrize("library", TRACED)
def test_eval_has_the_derivative_of_the_directions(libraries, library):
    bsdf = load(libraries[library])
    view, light = hemisphere(200, 3, 0.2), hemisphere(200, 4, 0.2)
    angle = mi.Float(0)
    dr.enable_grad(angle)
    ctx = mi.BSDFContext()

    def value(angle):
        turn = mi.Transform4f().rotate([0.3, 0.5, 0.1], angle)
        return bsdf.eval(ctx, interaction(np.array(view)), turn @ mi.Vector3f(light))

    dr.backward(dr.mean(dr.sum(value(angle))))
    step = 0.2  # degrees
    sides = [np.array(dr.mean(dr.sum(value(mi.Float(x)))))[0] for x in (step, -step)]
    assert np.isclose(dr.grad(angle)[0], (sides[0] - sides[1]) / (2 * step), rtol=0.03, atol=1e-6)


@pytest.mark.parametrize("library", TRACED)
def test_derivatives_are_finite_at_special_pairs(libraries, library):
    bsdf = load(libraries[library])
    r = np.sqrt(0.5)
    # Mirror pair, retro-reflection, both at the normal, grazing, below the horizon.
    view = np.array([[r, 0, r], [r, 0, r], [0, 0, 1], [1, 0, 1e-4], [r, 0, r]], np.float32).T
    light = np.array([[-r, 0, r], [r, 0, r], [0, 0, 1], [-1, 0, 1e-4], [r, 0, -r]], np.float32).T
    si, wo = interaction(view), mi.Vector3f(light)
    params = mi.traverse(bsdf)
    for key in keys(params):
        dr.enable_grad(params[key])
    params.update()
    dr.enable_grad(si.wi, wo)
    dr.backward(dr.sum(bsdf.eval(mi.BSDFContext(), si, wo)))
    gradients = [dr.grad(si.wi), dr.grad(wo)] + [dr.grad(params[key]) for key in keys(params)]
    for gradient in gradients:
        assert np.all(np.isfinite(np.array(gradient))), gradient


def scene(library, integrator):
    """A sphere of the material in front of a second one, under a lamp and a dim sky."""
    bsdf = {"type": "glimt", "filename": str(library), "material": "orange"}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": mi.ScalarTransform4f().look_at([0, 1, 4], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
            },
            "sphere": {"type": "sphere", "bsdf": {"id": "fit", **bsdf}},
            "floor": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(5),
                "bsdf": {"type": "diffuse"},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 4, 1]).rotate([1, 0, 0], 90),
                "emitter": {"type": "area", "radiance": 8.0},
            },
            "sky": {"type": "constant", "radiance": 0.3},
        }
    )


@pytest.mark.parametrize(
    ("library", "integrator"), [("ggx", "prb"), ("hybrid", "prb"), ("hybrid", "path"), ("neural", "prb")]
)
def test_rendering_has_the_derivatives(libraries, library, integrator):
    description = {"type": integrator, "max_depth": 3}
    if integrator == "prb":
        # The weight of a sample depends on the parameters, its direction does not.
        description["rr_depth"] = 10
    view = scene(libraries[library], description)
    params = mi.traverse(view)
    names = [key for key in keys(params) if key.rsplit(".", 1)[-1] in ("kd", "eta", "alpha", "latent")]
    assert names, keys(params)
    for key in names:
        dr.enable_grad(params[key])
    image = mi.render(view, params, spp=256, seed=1)
    dr.backward(dr.mean(image))
    found = {key: flat(dr.grad(params[key])) for key in names}
    for key in names:
        dr.disable_grad(params[key])
        # Equal random numbers on both sides; the lobes follow α, and with them the samples.
        expected = differences(params, key, lambda: dr.mean(mi.render(view, spp=1024, seed=2)).array[0], 0.02)
        tolerance = 0.05 if key.endswith("alpha") else 0.03
        scale = np.abs(expected).max()
        assert np.allclose(found[key], expected, rtol=tolerance, atol=tolerance * scale), key
