"""The catalogue of extreme inputs through Python and Mitsuba: the answers of the core, and nothing
that is infinite, negative or NaN."""

import numpy as np
import pytest
from extreme_inputs import export


@pytest.fixture(scope="module")
def catalogue(target_dir, tmp_path_factory):
    return export(target_dir, tmp_path_factory.mktemp("catalogue"))


def assert_valid(f, pdf, reaches_all, where):
    """f and pdf are finite and not negative, and the pdf is positive where f is."""
    assert np.isfinite(f).all() and (f >= 0).all(), where
    assert np.isfinite(pdf).all() and (pdf >= 0).all(), where
    assert not reaches_all or (pdf[(f > 0).any(axis=1)] > 0).all(), where


def assert_valid_samples(light_z, pdf, weight, where):
    """A sample is above the horizon with a finite weight, or failed with none."""
    sampled = pdf > 0
    assert sampled.any() and np.isfinite(pdf).all() and np.isfinite(weight).all(), where
    assert (weight >= 0).all() and (light_z[sampled] > 0).all() and not weight[~sampled].any(), where


def test_python_has_the_bits_of_the_core(catalogue):
    glimt = pytest.importorskip("glimt", reason="the package is not installed: pip install .")
    u = np.random.default_rng(3).random((len(catalogue.view), 3), np.float32)
    # The same numbers one byte further on, which is refused, and in another order, which is not.
    unaligned = np.empty(catalogue.light.nbytes + 1, np.uint8)[1:].view(np.float32)
    unaligned = unaligned.reshape(catalogue.light.shape)
    unaligned[:] = catalogue.light
    strided = np.asfortranarray(catalogue.light)
    for path, answers in catalogue.files.items():
        f, pdf = answers.f, answers.pdf
        library = glimt.load(path, sampler=answers.sampler or None)
        material = library[library.materials[0]]
        with pytest.raises(TypeError, match="misaligned"):
            material.eval(unaligned, catalogue.view)
        for light in (catalogue.light, strided):
            np.testing.assert_array_equal(material.eval(light, catalogue.view), f, str(path))
            np.testing.assert_array_equal(material.pdf(light, catalogue.view), pdf, str(path))
        assert material.eval(catalogue.light[:0], catalogue.view[:0]).shape == (0, 3)
        assert_valid(f, pdf, answers.reaches_all, path)
        light, density, weight = material.sample(catalogue.view, u)
        assert_valid_samples(light[:, 2], density, weight, path)


# Dr.Jit's kernels take denormals for 0; times the largest lobe of the catalogue that moves f by this.
SMALLEST_NORMAL = np.finfo(np.float32).tiny
UNDERFLOW = 1e12 * SMALLEST_NORMAL


def assert_close(f_cos, pdf, expected_f, expected_pdf, light, where):
    """What Mitsuba answers is f cosθ and the pdf of the core, to a few ULP."""
    expected = expected_f * np.maximum(np.nan_to_num(light[:, 2:], posinf=0, neginf=0), 0)
    np.testing.assert_allclose(f_cos, expected, rtol=1e-5, atol=UNDERFLOW, err_msg=str(where))
    # Shares are interpolated: where a small one is between greater ones, rounding is 1.12e-5 of the density.
    np.testing.assert_allclose(pdf, expected_pdf, rtol=1.25e-5, atol=UNDERFLOW, err_msg=str(where))


# A traced model rounds otherwise than the core: by 5.1e-7 of the largest channel of f with AVX-512.
TRACED_RELATIVE = 1e-6


def assert_close_when_traced(f_cos, f, light, where):
    """What a traced model answers is f cosθ of the core."""
    cosine = np.maximum(np.nan_to_num(light[:, 2:], posinf=0, neginf=0), 0)
    allowed = TRACED_RELATIVE * f.max(axis=1, keepdims=True) * cosine + UNDERFLOW
    excess = np.abs(f_cos - f * cosine) - allowed
    worst = np.unravel_index(np.argmax(excess), excess.shape)
    assert excess[worst] <= 0, f"{where}: {f_cos[worst]} against {(f * cosine)[worst]} at pair {worst[0]}"


# They have the sampler of the catalogue without a place only, and Mitsuba asks at a place as large as all.
SURFACES = ("gated", "maps")


def load(mi, path, answers):
    """A file of the catalogue as a BSDF."""
    sampler = {"sampler": answers.sampler} if answers.sampler else {}
    return mi.load_dict({"type": "glimt", "filename": str(path), **sampler})


def has_denormal(v):
    """Whether a component is 0 for Dr.Jit's kernels, but not for the core."""
    return ((v != 0) & (np.abs(v) < SMALLEST_NORMAL)).any(axis=1)


@pytest.mark.parametrize("traced", [False, True], ids=["in-kernel call", "traced"])
def test_mitsuba_llvm_has_the_answers_of_the_core(catalogue, traced):
    from mitsuba_common import dr, interaction, mi

    mi.set_variant("llvm_ad_rgb")
    light, view = catalogue.light, catalogue.view
    kept = ~(has_denormal(light) | has_denormal(view))
    random = np.random.default_rng(4).random((3, len(light)), np.float32)
    # Tracing a network takes seconds: of each kind the first materials show what there is to see.
    # A measurement has no traced form.
    modelled = (path for path in catalogue.files if path.suffix == ".safetensors")
    first = [path for path in modelled if path.stem.endswith(("-0", "-1"))]
    paths = first if traced else list(catalogue.files)
    for path in paths:
        answers = catalogue.files[path]
        f, pdf = answers.f, answers.pdf
        bsdf = load(mi, path, answers)
        si, context = interaction(view.T), mi.BSDFContext()
        if traced:
            dr.enable_grad(si.wi)
        value, density = bsdf.eval_pdf(context, si, mi.Vector3f(light.T))
        value, density = np.array(dr.detach(value)).T, np.array(dr.detach(density))
        assert_valid(value, density, answers.reaches_all, path)
        # Places in tables jump where a coordinate becomes 0; the scalar test compares these.
        if traced:
            assert_close_when_traced(value[kept], f[kept], light[kept], path)
        elif not path.stem.startswith(("spherical", "tabulated")):
            pdf = density if path.stem.startswith(SURFACES) else pdf
            assert_close(value[kept], density[kept], f[kept], pdf[kept], light[kept], path)
        sample, weight = bsdf.sample(context, si, mi.Float(random[0]), mi.Point2f(random[1:]))
        parts = (sample.wo.z, sample.pdf, weight)
        wo_z, density, weight = (np.array(dr.detach(part)) for part in parts)
        assert_valid_samples(wo_z, density, weight.T, path)


def test_mitsuba_scalar_has_the_answers_of_the_core(catalogue):
    from mitsuba_common import mi, scalar_interaction

    mi.set_variant("scalar_rgb")
    # Every family, a few pairs of each: a call takes microseconds.
    chosen = np.concatenate(
        [np.flatnonzero(catalogue.families == name)[::37] for name in np.unique(catalogue.families)]
    )
    light, view = catalogue.light[chosen], catalogue.view[chosen]
    context, si = mi.BSDFContext(), scalar_interaction()
    for path, answers in catalogue.files.items():
        f, pdf = answers.one, answers.pdf
        bsdf = load(mi, path, answers)
        values, densities, samples = [], [], []
        for wo, wi in zip(light, view):
            si.wi = wi
            value, density = bsdf.eval_pdf(context, si, wo)
            sample, weight = bsdf.sample(context, si, 0.3, [0.4, 0.6])
            values.append(np.array(value))
            densities.append(density)
            samples.append([sample.wo.z, sample.pdf, *np.array(weight)])
        samples, values, densities = np.array(samples), np.array(values), np.array(densities)
        assert_valid(values, densities, answers.reaches_all, path)
        pdf = densities if path.stem.startswith(SURFACES) else pdf[chosen]
        assert_close(values, densities, f[chosen], pdf, light, path)
        assert_valid_samples(samples[:, 0], samples[:, 1], samples[:, 2:], path)
