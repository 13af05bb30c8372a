"""The sampler of the plugin: its density, its weights, and how much energy they add up to."""

import numpy as np
import pytest
from mitsuba_common import dr, hemisphere, interaction, load, mi, write_libraries

MATERIALS = [
    ("ggx", "metal"),
    ("brushed", "brushed"),
    ("hybrid", "orange"),
    ("neural", "rough"),
    ("nbrdf", "metal"),
    ("factor", "metal"),
    ("factor_naive", "rough"),
    ("analytic_ward", "orange"),
    ("analytic_gamma", "orange"),
]
# From the normal to grazing, at azimuths that favour no axis.
VIEWS = [
    [float(x) for x in (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))]
    for theta, phi in zip(np.radians(np.linspace(0, 86, 20)), 2.4 * np.arange(20))
]
SIGNIFICANCE = 0.01


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    mi.set_variant("llvm_ad_rgb")
    return write_libraries(tmp_path_factory.mktemp("libraries"))


def off_horizon(sample):
    """Without the one sample in millions that is so near the horizon that the test counts it below."""

    def sampled(u):
        direction, weight = sample(u)
        return direction, dr.select(direction.z < 1e-6, 0, weight)

    return sampled


@pytest.mark.parametrize(("library", "material"), MATERIALS)
def test_samples_follow_the_density(libraries, library, material):
    """χ² over 20 views; the significance is that of all tests of this function together."""
    from mitsuba.chi2 import BSDFAdapter, ChiSquareTest, SphericalDomain

    description = {"type": "glimt", "filename": str(libraries[library]), "material": material}
    rejected = []
    for view in VIEWS:
        sample, pdf = BSDFAdapter("glimt", description, wi=view)
        # An even resolution has the horizon, where the density jumps to 0, between two cells.
        test = ChiSquareTest(
            SphericalDomain(), off_horizon(sample), pdf, sample_dim=3, sample_count=200_000, res=50, ires=20
        )
        if not test.run(SIGNIFICANCE, test_count=len(VIEWS) * len(MATERIALS), quiet=True):
            rejected.append((view, test.messages))
    assert not rejected, rejected


@pytest.mark.parametrize(("library", "material"), MATERIALS)
def test_weight_is_value_over_density(libraries, library, material):
    bsdf, ctx, n = load(libraries[library], material), mi.BSDFContext(), 20_000
    u = np.random.default_rng(1).random((3, n), np.float32)
    si = interaction(hemisphere(n, 2))
    sample, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
    value, pdf = (np.array(x) for x in bsdf.eval_pdf(ctx, si, sample.wo))
    assert np.array_equal(value, np.array(bsdf.eval(ctx, si, sample.wo)))
    assert np.array_equal(pdf, np.array(bsdf.pdf(ctx, si, sample.wo)))
    valid = np.array(sample.pdf) > 0
    value, pdf = np.where(valid, value, 0), np.where(valid, pdf, 1)
    assert valid.mean() > 0.7
    assert np.allclose(np.array(sample.pdf)[valid], pdf[valid], rtol=1e-5)
    assert np.allclose(np.array(weight), value / pdf, rtol=1e-4, atol=1e-7)
    lengths = np.linalg.norm(np.array(sample.wo)[:, valid], axis=0)
    assert np.allclose(lengths, 1, atol=1e-5)
    assert np.all(np.array(sample.sampled_type) == +mi.BSDFFlags.GlossyReflection)


@pytest.mark.parametrize("mode", ["Radiance", "Importance"])
@pytest.mark.parametrize(("library", "material"), MATERIALS)
def test_combined_query_is_the_two_that_it_stands_for(libraries, library, material, mode):
    bsdf, n = load(libraries[library], material), 5_000
    ctx = mi.BSDFContext()
    ctx.mode = getattr(mi.TransportMode, mode)
    # Directions below the horizon on either side, and inactive lanes.
    si = interaction(hemisphere(n, 5, min_cos=-0.3))
    light = mi.Vector3f(hemisphere(n, 6, min_cos=-0.3))
    u = np.random.default_rng(7).random((3, n), np.float32)
    u_lobe, u_direction = mi.Float(u[0]), mi.Point2f(u[1:])
    active = mi.Bool(np.arange(n) % 7 != 3)
    value, pdf, sample, weight = bsdf.eval_pdf_sample(ctx, si, light, u_lobe, u_direction, active)
    expected_value, expected_pdf = bsdf.eval_pdf(ctx, si, light, active)
    expected_sample, expected_weight = bsdf.sample(ctx, si, u_lobe, u_direction, active)
    assert np.allclose(np.array(value), np.array(expected_value), rtol=1e-4, atol=1e-7)
    assert np.allclose(np.array(weight), np.array(expected_weight), rtol=1e-4, atol=1e-7)
    assert np.array_equal(np.array(pdf), np.array(expected_pdf))
    assert np.array_equal(np.array(sample.pdf), np.array(expected_sample.pdf))
    valid = np.array(sample.pdf) > 0
    assert 0.3 < valid.mean() < 0.85
    assert np.array_equal(np.array(sample.wo)[:, valid], np.array(expected_sample.wo)[:, valid])


def spherical_grid(n_theta, n_phi):
    """Midpoints of a product grid over the hemisphere, fine towards the normal, and their solid angles."""
    edges = np.linspace(0, 1, n_theta + 1) ** 2
    cos = 1 - edges
    z = 0.5 * (cos[:-1] + cos[1:])
    phi = (np.arange(n_phi) + 0.5) / n_phi * 2 * np.pi
    z, phi = (x.ravel() for x in np.meshgrid(z, phi, indexing="ij"))
    omega = np.repeat(-np.diff(cos), n_phi) * 2 * np.pi / n_phi
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z]).astype(np.float32), omega


@pytest.mark.parametrize(("library", "material"), MATERIALS)
def test_density_integrates_to_one(libraries, library, material):
    bsdf, ctx = load(libraries[library], material), mi.BSDFContext()
    light, omega = spherical_grid(1500, 1024)
    for view in VIEWS:
        si = dr.zeros(mi.SurfaceInteraction3f, len(omega))
        si.wi = mi.Vector3f(view)
        integral = np.array(bsdf.pdf(ctx, si, mi.Vector3f(light))).astype(np.float64) @ omega
        # What is missing are the samples that fell below the horizon.
        n = 100_000
        u = np.random.default_rng(3).random((3, n), np.float32)
        many = dr.zeros(mi.SurfaceInteraction3f, n)
        many.wi = mi.Vector3f(view)
        sample, _ = bsdf.sample(ctx, many, mi.Float(u[0]), mi.Point2f(u[1:]))
        failed = np.mean(np.array(sample.pdf) == 0)
        # Five standard deviations of the share that failed.
        assert abs(integral + failed - 1) < 1e-3 + 5 * np.sqrt(failed * (1 - failed) / n), (view, integral)
        if failed == 0:
            assert abs(integral - 1) < 1e-3, (view, integral)


@pytest.mark.parametrize(("library", "material"), MATERIALS)
def test_albedo_is_the_integral_of_f(libraries, library, material):
    """A white furnace: the mean weight against ∫ f cosθ by quadrature."""
    bsdf, ctx = load(libraries[library], material), mi.BSDFContext()
    light, omega = spherical_grid(800, 512)
    n = 400_000
    u = np.random.default_rng(4).random((3, n), np.float32)
    for view in VIEWS[:18:3]:
        si = dr.zeros(mi.SurfaceInteraction3f, n)
        si.wi = mi.Vector3f(view)
        _, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
        weight = np.array(weight).astype(np.float64)
        estimate, deviation = weight.mean(axis=1), weight.std(axis=1) / np.sqrt(n)
        si = dr.zeros(mi.SurfaceInteraction3f, len(omega))
        si.wi = mi.Vector3f(view)
        albedo = np.array(bsdf.eval(ctx, si, mi.Vector3f(light))).astype(np.float64) @ omega
        print(f"{library}/{material}, cos {view[2]:.2f}: albedo {albedo.round(4)}")
        assert np.all(np.abs(estimate - albedo) < 5 * deviation + 2e-3 * albedo), (view, estimate, albedo)


def test_furnace_rendering_is_the_albedo(libraries):
    """Under a white sky a convex object shows its albedo, by emitter and BSDF sampling together."""
    bsdf = {"type": "glimt", "filename": str(libraries["hybrid"]), "material": "orange"}
    view = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {
                "type": "orthographic",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]).scale(0.1),
                "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
            },
            "plane": {"type": "rectangle", "bsdf": bsdf},
            "sky": {"type": "constant", "radiance": 1.0},
        }
    )
    image = np.array(mi.render(view, spp=4096, seed=5)).reshape(-1, 3).mean(axis=0)
    light, omega = spherical_grid(800, 512)
    si = dr.zeros(mi.SurfaceInteraction3f, len(omega))
    si.wi = mi.Vector3f(0, 0, 1)
    value = mi.load_dict(bsdf).eval(mi.BSDFContext(), si, mi.Vector3f(light))
    albedo = np.array(value).astype(np.float64) @ omega
    assert np.allclose(image, albedo, rtol=5e-3), (image, albedo)
