"""The same f in every variant and by every way of evaluation, against a float64 reference."""

import numpy as np
import pytest
from mitsuba_common import (
    FAR,
    LIBRARIES,
    MICROFACET,
    TRACED,
    dr,
    hemisphere,
    interaction,
    load,
    mi,
    scalar_interaction,
    write_libraries,
)

PAIRS = 10_000


glimt = pytest.importorskip("glimt")


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    return write_libraries(tmp_path_factory.mktemp("libraries"))


def evaluate(bsdf, light, view, traced=False):
    """f (3, n) and pdf (n) of a bsdf of the current LLVM variant."""
    si, wo = interaction(view), mi.Vector3f(light)
    if traced:
        # A direction that may need a derivative rules the call into Rust out.
        dr.enable_grad(si.wi)
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, wo)
    return np.array(dr.detach(value)) / light[2], np.array(dr.detach(pdf))


def analytic(light, view, kd, eta, alpha):
    """f_a in float64, as Walter et al. 2007 and Heitz 2014 print it."""
    light, view = light.astype(np.float64), view.astype(np.float64)
    a = np.array([alpha[0], alpha[-1]])
    half = light + view
    half /= np.linalg.norm(half, axis=0)
    cos_d = np.sum(light * half, axis=0)
    slope = (half[0] / a[0]) ** 2 + (half[1] / a[1]) ** 2
    d = 1 / (np.pi * a[0] * a[1] * (slope + half[2] ** 2) ** 2)

    def g1(w):
        return 2 / (1 + np.sqrt(1 + ((a[0] * w[0]) ** 2 + (a[1] * w[1]) ** 2) / w[2] ** 2))

    f = []
    for k, n in zip(kd, eta):
        cos_t = np.sqrt(1 - (1 - cos_d**2) / n**2)
        perpendicular = (cos_d - n * cos_t) / (cos_d + n * cos_t)
        parallel = (n * cos_d - cos_t) / (n * cos_d + cos_t)
        fresnel = 0.5 * (perpendicular**2 + parallel**2)
        f.append(k / np.pi + fresnel * d * g1(light) * g1(view) / (4 * light[2] * view[2]))
    return np.array(f)


@pytest.mark.parametrize("material", MICROFACET)
def test_ggx_is_the_textbook(libraries, material):
    mi.set_variant("llvm_ad_rgb")
    light, view = hemisphere(PAIRS, 1), hemisphere(PAIRS, 2)
    f, _ = evaluate(load(libraries["ggx"], material), light, view)
    truth = analytic(light, view, *MICROFACET[material])
    assert np.max(np.abs(f - truth) / truth) < 1e-4


@pytest.mark.parametrize("library", TRACED)
def test_traced_way_is_the_in_kernel_call(libraries, library):
    mi.set_variant("llvm_ad_rgb")
    light, view = hemisphere(PAIRS, 3), hemisphere(PAIRS, 4)
    bsdf = load(libraries[library], "metal")
    has_network = LIBRARIES[library]["kind"] != "ggx"
    assert ("in-kernel call" in str(bsdf)) == has_network
    call, pdf = evaluate(bsdf, light, view)
    traced, traced_pdf = evaluate(bsdf, light, view, traced=True)
    # Two of the models subtract numbers of order 1, which leaves an absolute error.
    absolute = 2e-6 if library in ("nbrdf", "hybrid_additive") else 1e-9
    assert np.all(np.abs(call - traced) <= 1e-5 * call + absolute)
    assert np.allclose(pdf, traced_pdf, rtol=1e-5)


# Wider, narrower and brighter than the materials of the tests.
EDITS = {
    "wide": {"alpha": 0.8},
    "narrow": {"alpha": 0.05, "eta": 3.0},
    "white": {"kd": 1.0, "eta": 1.1, "alpha": 0.6},
    "mix": {"mix": "metal", "mix_weight": 0.4},
    "edited mix": {"mix": "metal", "mix_weight": 0.4, "alpha": 0.3, "kd": 0.7},
}


def shares_network(library):
    return LIBRARIES[library]["kind"] in ("hybrid", "neural") and "per_material" not in library


@pytest.mark.parametrize("edit", EDITS)
@pytest.mark.parametrize("library", [name for name in TRACED if shares_network(name)])
def test_edits_and_mixes_are_the_same_in_core_call_and_trace(libraries, library, edit):
    changes = EDITS[edit]
    if LIBRARIES[library]["kind"] == "neural" and set(changes) - {"mix", "mix_weight"}:
        pytest.skip("neural materials have no analytic part to edit")
    light, view = hemisphere(1000, 3), hemisphere(1000, 4)
    material = glimt.load(libraries[library])["orange"]
    if "mix" in changes:
        material = glimt.load(libraries[library]).mix("orange", changes["mix"], changes["mix_weight"])
    parameters = {key: value for key, value in changes.items() if key in ("kd", "eta", "alpha")}
    if parameters:
        material = material.edit(**parameters)
    expected = material.eval(light.T, view.T).T
    for variant in "scalar_rgb", "llvm_ad_rgb":
        mi.set_variant(variant)
        bsdf = load(libraries[library], "orange", **changes)
        if variant == "scalar_rgb":
            found = [scalar(bsdf, light, view)]
        else:
            found = [evaluate(bsdf, light, view, traced)[0] for traced in (False, True)]
        for f in found:
            assert np.allclose(f, expected, rtol=2e-4, atol=2e-5 * expected.max()), (library, edit, variant)


def scalar(bsdf, light, view):
    """f (3, n) of a bsdf of a scalar variant."""
    context, f = mi.BSDFContext(), []
    for to_light, to_view in zip(light.T, view.T):
        si = mi.SurfaceInteraction3f()
        si.wi = to_view.tolist()
        f.append(np.array(bsdf.eval(context, si, mi.ScalarVector3f(*to_light.tolist()))) / to_light[2])
    return np.array(f).T


@pytest.mark.parametrize("library", LIBRARIES)
def test_scalar_variant_is_the_in_kernel_call(libraries, library):
    n = 1000
    light, view = hemisphere(n, 5), hemisphere(n, 6)
    mi.set_variant("llvm_ad_rgb")
    bsdf = load(libraries[library], "metal")
    f, pdf = evaluate(bsdf, light, view)
    u = np.random.default_rng(7).random((3, n), np.float32)
    sample, weight = bsdf.sample(mi.BSDFContext(), interaction(view), mi.Float(u[0]), mi.Point2f(u[1:]))
    wo, sample_pdf, weight = np.array(sample.wo), np.array(sample.pdf), np.array(weight)

    mi.set_variant("scalar_rgb")
    bsdf, ctx, si = load(libraries[library], "metal"), mi.BSDFContext(), scalar_interaction()
    for i in range(n):
        si.wi = view[:, i]
        value, density = bsdf.eval_pdf(ctx, si, light[:, i])
        # One pair and a packet add in different orders; additive models subtract numbers of order 1.
        assert np.allclose(np.array(value) / light[2, i], f[:, i], rtol=1e-5, atol=2e-6)
        assert np.isclose(density, pdf[i], rtol=1e-5)
        sample, w = bsdf.sample(ctx, si, u[0, i], u[1:, i])
        # A direction at the horizon may fail on one side only.
        if min(sample.wo.z, wo[2, i]) > 1e-4:
            assert np.allclose(sample.wo, wo[:, i], atol=1e-5)
            # The weight of a direction that differs in the last digit differs with the lobe's slope.
            assert np.isclose(sample.pdf, sample_pdf[i], rtol=1e-3)
            assert np.allclose(w, weight[:, i], rtol=1e-3, atol=1e-6)
        else:
            assert sample.pdf == 0 or wo[2, i] < 2e-4


@pytest.mark.parametrize("library", LIBRARIES)
def test_python_module_is_the_plugin(libraries, library):
    mi.set_variant("llvm_ad_rgb")
    light, view = hemisphere(PAIRS, 12), hemisphere(PAIRS, 13)
    f, pdf = evaluate(load(libraries[library], "metal"), light, view)
    material = glimt.load(libraries[library])["metal"]
    assert np.allclose(material.eval(light.T, view.T), f.T, rtol=1e-5, atol=1e-7)
    # Surfaces sample at a place only.
    afar = {"uv": [0, 0], "footprint": FAR} if material.is_surface else {}
    assert np.allclose(material.pdf(light.T, view.T, **afar), pdf, rtol=1e-5)


def test_twosided_serves_both_sides(libraries):
    mi.set_variant("llvm_ad_rgb")
    bsdf = {"type": "glimt", "filename": str(libraries["hybrid"]), "material": "orange"}
    bsdf = mi.load_dict({"type": "twosided", "bsdf": bsdf})
    light, view = hemisphere(100, 14), hemisphere(100, 15)
    flip = np.array([[1], [1], [-1]], np.float32)
    front = np.array(bsdf.eval(mi.BSDFContext(), interaction(view), mi.Vector3f(light)))
    back = np.array(bsdf.eval(mi.BSDFContext(), interaction(view * flip), mi.Vector3f(light * flip)))
    assert np.all(front > 0)
    assert np.array_equal(front, back)


def test_monochromatic_variants_have_the_luminance(libraries):
    light, view = hemisphere(100, 8), hemisphere(100, 9)
    mi.set_variant("llvm_ad_rgb")
    rgb, pdf = evaluate(load(libraries["hybrid"]), light, view)
    mi.set_variant("llvm_ad_mono")
    mono, mono_pdf = evaluate(load(libraries["hybrid"]), light, view)
    assert np.allclose(mono[0], np.array([0.212671, 0.715160, 0.072169]) @ rgb, rtol=1e-5)
    assert np.array_equal(pdf, mono_pdf)


@pytest.mark.parametrize("variant", ["scalar_spectral", "llvm_ad_spectral"])
def test_spectral_variants_show_the_rgb_colour_under_d65(libraries, variant):
    """∫ f(λ) D65(λ) x̄ȳz̄(λ) dλ in linear sRGB is the rgb value, and no wavelength exceeds its channels."""
    light, view = hemisphere(5, 8), hemisphere(5, 9)
    mi.set_variant("llvm_ad_rgb")
    rgb, _ = evaluate(load(libraries["hybrid"]), light, view)
    mi.set_variant("llvm_ad_spectral")
    grid = np.linspace(360, 830, 941).astype(np.float32)
    d65 = dr.zeros(mi.SurfaceInteraction3f, len(grid))
    d65.wavelengths = mi.Spectrum(mi.Float(grid))
    emission = np.array(mi.load_dict({"type": "d65"}).eval(d65))[0]
    xyz = emission * np.array(mi.cie1931_xyz(mi.Float(grid)))
    srgb = np.array(mi.xyz_to_srgb(mi.Color3f(*xyz)))
    srgb /= srgb.sum(axis=1, keepdims=True)

    mi.set_variant(variant)
    bsdf, ctx = load(libraries["hybrid"]), mi.BSDFContext()
    for i in range(5):
        spectrum = []
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = mi.Vector3f(view[:, i])
        for wavelengths in [*grid[:-1].reshape(-1, 4), grid[-4:]]:
            si.wavelengths = mi.Spectrum([float(x) for x in wavelengths])
            spectrum.append(np.array(bsdf.eval(ctx, si, mi.Vector3f(light[:, i]))).ravel() / light[2, i])
        spectrum = np.concatenate([*spectrum[:-1], spectrum[-1][-1:]])
        assert np.allclose(srgb @ spectrum, rgb[:, i], rtol=1e-3)
        assert rgb[:, i].min() * 0.999 <= spectrum.min() and spectrum.max() <= rgb[:, i].max() * 1.001


def test_polarized_variants_depolarize(libraries):
    light, view = hemisphere(100, 8), hemisphere(100, 9)
    mi.set_variant("llvm_ad_mono")
    mono, _ = evaluate(load(libraries["hybrid"]), light, view)
    mi.set_variant("llvm_ad_mono_polarized")
    si, wo = interaction(view), mi.Vector3f(light)
    mueller = load(libraries["hybrid"]).eval(mi.BSDFContext(), si, wo)
    for row in range(4):
        for column in range(4):
            entry = np.array(mueller[row, column]) * np.ones(100)
            expected = mono[0] * light[2] if row == column == 0 else 0
            assert np.allclose(entry, expected, rtol=1e-6), (row, column)


@pytest.mark.parametrize("library", ["hybrid", "nbrdf", "neural", "factor", "analytic_ward"])
def test_importance_transport_swaps_the_roles(libraries, library):
    mi.set_variant("llvm_ad_rgb")
    light, view = hemisphere(200, 10), hemisphere(200, 11)
    bsdf = load(libraries[library])
    radiance, _ = evaluate(bsdf, light, view)
    adjoint = bsdf.eval(mi.BSDFContext(mi.TransportMode.Importance), interaction(light), mi.Vector3f(view))
    assert np.allclose(np.array(adjoint) / view[2], radiance, rtol=1e-5)

    mi.set_variant("scalar_rgb")
    bsdf, ctx = load(libraries[library]), mi.BSDFContext(mi.TransportMode.Importance)
    si = mi.SurfaceInteraction3f()
    for i in range(50):
        si.wi = light[:, i]
        sample, weight = bsdf.sample(ctx, si, view[2, i], view[:2, i] * 0.5 + 0.5)
        if sample.pdf > 0:
            expected = np.array(bsdf.eval(ctx, si, sample.wo)) / sample.pdf
            assert np.allclose(weight, expected, rtol=1e-5)


@pytest.mark.parametrize("library", ["hybrid", "factor", "analytic_gamma"])
@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_below_the_horizon_and_nan_give_zero(libraries, variant, library):
    mi.set_variant(variant)
    bsdf, ctx = load(libraries[library]), mi.BSDFContext()
    up, down, nan = [0.6, 0, 0.8], [0.6, 0, -0.8], [float("nan"), 0, 0.8]
    for wi, wo in ((down, up), (up, down), (down, down), (nan, up), (up, nan)):
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = mi.Vector3f(wi)
        value, pdf = bsdf.eval_pdf(ctx, si, mi.Vector3f(wo))
        assert not np.any(np.array(value)) and not np.any(np.array(pdf)), (wi, wo)
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(down)
    sample, weight = bsdf.sample(ctx, si, 0.5, mi.Point2f(0.3, 0.4))
    assert not np.any(np.array(weight)) and not np.any(np.array(sample.pdf))
