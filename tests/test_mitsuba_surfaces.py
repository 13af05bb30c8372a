"""Materials that are another at every place, in Mitsuba: places, footprints, frames, scenes, derivatives."""

import json

import numpy as np
import pytest
from mitsuba_common import LIBRARIES, MICROFACET, dr, hemisphere, load, mi, save_safetensors
from model_libraries import write_library

glimt = pytest.importorskip("glimt", reason="the package is not installed: pip install .")

N = 60
VIEW, LIGHT = hemisphere(N, 1, 0.1), hemisphere(N, 2, 0.1)
U = np.random.default_rng(3).random((3, N), np.float32)
UV = np.random.default_rng(4).uniform(-1, 2, (2, N)).astype(np.float32)
# What uv changes by to the next pixel in x and in y, (axis, component, N): from less than a texel to all.
DUV = (
    np.random.default_rng(5).normal(0, 1, (2, 2, N)) * 10 ** np.random.default_rng(6).uniform(-3, 0, N)
).astype(np.float32)
# A place in tiles that are turned and mirrored.
TURN = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]], np.float32)
MIRROR = np.diag([-1, 1]).astype(np.float32)


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    folder = tmp_path_factory.mktemp("surfaces")
    return {
        name: write_library(folder / f"{name}.safetensors", **LIBRARIES[name])
        for name in ("maps", "ggx", "hybrid")
    }


@pytest.fixture(scope="module")
def waves(tmp_path_factory):
    """Colours in waves of a quarter of the tile, and of an eighth across: a footprint damps them."""
    v, u = (np.mgrid[:64, :64] + 0.5) / 64 * 2 * np.pi
    maps = np.zeros((1, 64, 64, 9))
    maps[..., :3] = (0.5 + 0.2 * np.sin(4 * u) + 0.2 * np.sin(8 * v))[..., None]
    maps[..., 6] = 0.5
    return write_maps(tmp_path_factory.mktemp("waves") / "waves.safetensors", maps)


def write_maps(path, maps):
    """A library of one material of maps, (1, height, width, 9)."""
    material = {"name": "patch", "source": "", "sha256": "", "command": ""}
    header = {"format": 1, "kind": "maps", "color_space": "linear sRGB", "materials": [material]}
    header["form"] = {"wrap": "repeat", "filter": "moments"}
    save_safetensors(path, {"maps": maps}, {"glimt": json.dumps(header)})
    return path


def scalar_interaction(i, view=VIEW, uv=UV, duv=DUV):
    """Number ``i`` of the interactions, in a scalar variant."""
    si = mi.SurfaceInteraction3f()
    si.t, si.wi, si.uv = 1.0, view[:, i].tolist(), uv[:, i].tolist()
    si.duv_dx, si.duv_dy = duv[0, :, i].tolist(), duv[1, :, i].tolist()
    si.sh_frame, si.dp_du, si.dp_dv = mi.Frame3f([0, 0, 1]), [1, 0, 0], [0, 1, 0]
    si.sh_frame.s, si.sh_frame.t = [1, 0, 0], [0, 1, 0]
    return si


def interaction(view=VIEW, uv=UV, duv=DUV):
    """All of them, in a JIT variant."""
    si = dr.zeros(mi.SurfaceInteraction3f, view.shape[1])
    si.t, si.wi, si.uv = 1.0, mi.Vector3f(view), mi.Point2f(uv)
    si.duv_dx, si.duv_dy = mi.Vector2f(duv[0]), mi.Vector2f(duv[1])
    si.sh_frame, si.dp_du, si.dp_dv = mi.Frame3f([0, 0, 1]), [1, 0, 0], [0, 1, 0]
    si.sh_frame.s, si.sh_frame.t = [1, 0, 0], [0, 1, 0]
    return si


def response(bsdf, si, light=LIGHT):
    """f cosθ of as many pairs, (3, n)."""
    return np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(light)))


def expected(library, to_uv=None, material="orange", scale=1):
    """(f cosθ, pdf) as Python knows them where the texture's coordinates are ``to_uv`` of the shape's."""
    m = np.eye(2, dtype=np.float32) if to_uv is None else to_uv
    turn = m / np.linalg.norm(m, axis=0)
    turned = [np.ascontiguousarray(np.vstack([turn @ w[:2], w[2:]]).T) for w in (LIGHT, VIEW)]
    at = {"uv": (m @ UV).T, "footprint": np.ascontiguousarray(np.moveaxis(0.5 * scale * (m @ DUV), -1, 0))}
    surface = glimt.load(library)[material]
    return surface.eval(*turned, **at).T * LIGHT[2], surface.pdf(*turned, **at)


@pytest.mark.parametrize("material", MICROFACET)
def test_scalar_llvm_and_python_agree(libraries, material):
    value, pdf = expected(libraries["maps"], material=material)
    mi.set_variant("scalar_rgb")
    bsdf, context = load(libraries["maps"], material), mi.BSDFContext()
    for i in range(N):
        answer = bsdf.eval_pdf(context, scalar_interaction(i), mi.Vector3f(LIGHT[:, i]))
        assert np.allclose(answer[0], value[:, i], rtol=1e-5), i
        assert np.isclose(answer[1], pdf[i], rtol=1e-5), i
    mi.set_variant("llvm_ad_rgb")
    bsdf, context = load(libraries["maps"], material), mi.BSDFContext()
    answer = bsdf.eval_pdf(context, interaction(), mi.Vector3f(LIGHT))
    assert np.allclose(answer[0], value, rtol=1e-4)
    assert np.allclose(answer[1], pdf, rtol=1e-4)
    assert "in-kernel call" in str(bsdf)
    # The footprint counts: without it the answers are others.
    point = response(bsdf, interaction(duv=0 * DUV))
    assert np.mean(np.abs(point - value) > 0.01 * value) > 0.25


def test_samples_agree_and_have_the_weight_of_their_density(libraries):
    context = {}
    samples = {}
    for variant in ("scalar_rgb", "llvm_ad_rgb"):
        mi.set_variant(variant)
        bsdf, context = load(libraries["maps"], "rough"), mi.BSDFContext()
        if variant == "scalar_rgb":
            drawn = [
                bsdf.sample(context, scalar_interaction(i), float(U[0, i]), mi.Point2f(U[1:, i]))
                for i in range(N)
            ]
            wo = np.array([np.array(s.wo) for s, _ in drawn]).T
            pdf = np.array([s.pdf for s, _ in drawn])
            samples[variant] = wo, pdf, np.array([np.array(w) for _, w in drawn]).T
            continue
        si, u = interaction(), (mi.Float(U[0]), mi.Point2f(U[1:]))
        f, light_pdf, sample, weight = bsdf.eval_pdf_sample(context, si, mi.Vector3f(LIGHT), *u)
        assert np.allclose(f, response(bsdf, si), rtol=1e-6)
        assert np.allclose(light_pdf, bsdf.pdf(context, si, mi.Vector3f(LIGHT)), rtol=1e-6)
        again, again_pdf = bsdf.eval_pdf(context, si, sample.wo)
        lit = np.array(sample.pdf) > 0
        assert lit.mean() > 0.5
        assert np.allclose(np.array(again_pdf)[lit], np.array(sample.pdf)[lit], rtol=1e-4)
        assert np.allclose(
            np.array(again)[:, lit], (np.array(weight) * np.array(sample.pdf))[:, lit], rtol=1e-4
        )
        assert not np.any(np.array(weight)[:, ~lit])
        samples[variant] = np.array(sample.wo), np.array(sample.pdf), np.array(weight)
    scalar, llvm = samples.values()
    lit = scalar[1] > 0
    assert np.array_equal(lit, llvm[1] > 0)
    assert np.allclose(scalar[0][:, lit], llvm[0][:, lit], atol=1e-4)
    for a, b in zip(scalar[1:], llvm[1:]):
        assert np.allclose(a[..., lit], b[..., lit], rtol=2e-3)


@pytest.mark.parametrize("wi", [(0, 0, 1), (0.6, -0.48, 0.64)])
def test_samples_follow_the_density(libraries, wi):
    mi.set_variant("llvm_ad_rgb")
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    bsdf, context = load(libraries["maps"], "rough", pixel_angle=0.05), mi.BSDFContext()

    def interactions(n):
        """All at one place."""
        each = np.ones(n, np.float32)
        view = np.array(wi, np.float32)[:, None] * each
        return interaction(view, np.array([[0.3], [0.6]], np.float32) * each, np.zeros((2, 2, n), np.float32))

    def sample(u):
        drawn, _ = bsdf.sample(context, interactions(dr.width(u)), u.x, mi.Point2f(u.y, u.z))
        # Samples of a facet that is turned away from them have a density, and no weight.
        return drawn.wo, dr.select(drawn.pdf > 0, mi.Float(1), 0)

    def pdf(wo):
        return bsdf.pdf(context, interactions(dr.width(wo)), wo)

    test = ChiSquareTest(SphericalDomain(), sample, pdf, sample_dim=3, sample_count=200_000, res=51)
    assert test.run(), test.messages


def test_other_kinds_of_colour(libraries):
    mi.set_variant("llvm_ad_rgb")
    rgb = response(load(libraries["maps"]), interaction())
    mi.set_variant("llvm_ad_mono")
    mono = response(load(libraries["maps"]), interaction())
    assert np.allclose(mono[0], [0.212671, 0.71516, 0.072169] @ rgb, rtol=1e-4)
    for variant in ("llvm_ad_spectral", "llvm_ad_mono_polarized", "scalar_spectral_polarized"):
        mi.set_variant(variant)
        si = scalar_interaction(0) if variant.startswith("scalar") else interaction()
        if mi.is_spectral:
            si.wavelengths = mi.UnpolarizedSpectrum(450.0, 550.0, 650.0, 700.0)
        light = mi.Vector3f(LIGHT[:, 0]) if variant.startswith("scalar") else mi.Vector3f(LIGHT)
        value = load(libraries["maps"]).eval(mi.BSDFContext(), si, light)
        if mi.is_polarized:
            value = mi.unpolarized_spectrum(value)
        value = np.array(value).reshape(4 if mi.is_spectral else 1, -1)
        low, high = rgb.min(axis=0), rgb.max(axis=0)
        value = value[:, : 1 if variant.startswith("scalar") else N]
        assert np.all(value >= 0.9 * low[: value.shape[1]]) and np.all(value <= 1.1 * high[: value.shape[1]])


def test_flags_say_what_it_is(libraries):
    mi.set_variant("scalar_rgb")
    flags = int(load(libraries["maps"]).flags())
    needs_differentials = 0x20000
    for flag in (mi.BSDFFlags.SpatiallyVarying, mi.BSDFFlags.Anisotropic, needs_differentials):
        assert flags & int(flag)
    assert not int(load(libraries["ggx"]).flags()) & int(mi.BSDFFlags.SpatiallyVarying)


# ----- Where a texture lies -----


@pytest.mark.parametrize(
    "m", [np.diag([2, 3]), TURN, MIRROR, 2 * TURN @ MIRROR], ids=["scale", "turn", "mirror", "all"]
)
@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_to_uv_turns_the_texture_with_its_normals(libraries, m, variant):
    mi.set_variant(variant)
    matrix = np.eye(3)
    matrix[:2, :2] = m
    bsdf = load(libraries["maps"], to_uv=mi.ScalarTransform3f(matrix))
    value, pdf = expected(libraries["maps"], np.asarray(m, np.float32))
    context = mi.BSDFContext()
    if variant == "llvm_ad_rgb":
        answer = bsdf.eval_pdf(context, interaction(), mi.Vector3f(LIGHT))
        assert np.allclose(answer[0], value, rtol=2e-4) and np.allclose(answer[1], pdf, rtol=2e-4)
        return
    for i in range(N):
        answer = bsdf.eval_pdf(context, scalar_interaction(i), mi.Vector3f(LIGHT[:, i]))
        assert np.allclose(answer[0], value[:, i], rtol=2e-4) and np.isclose(answer[1], pdf[i], rtol=2e-4)


def test_samples_come_back_from_the_frame_of_the_texture(libraries):
    """Where the texture is turned and mirrored, so are views and samples."""
    mi.set_variant("llvm_ad_rgb")
    turn = TURN @ MIRROR
    matrix = np.eye(3)
    matrix[:2, :2] = turn
    u = mi.Float(U[0]), mi.Point2f(U[1:])
    plain, plain_weight = load(libraries["maps"]).sample(
        mi.BSDFContext(), interaction(np.vstack([turn @ VIEW[:2], VIEW[2:]]), turn @ UV, turn @ DUV), *u
    )
    sample, weight = load(libraries["maps"], to_uv=mi.ScalarTransform3f(matrix)).sample(
        mi.BSDFContext(), interaction(), *u
    )
    lit = np.array(sample.pdf) > 0
    wo = np.array(sample.wo)
    assert np.allclose(np.vstack([turn @ wo[:2], wo[2:]])[:, lit], np.array(plain.wo)[:, lit], atol=1e-3)
    assert np.allclose(np.array(weight)[:, lit], np.array(plain_weight)[:, lit], rtol=1e-2)


def plane(texcoords, positions=(0, 0, 0, 2, 0, 0, 2, 2, 0, 0, 2, 0)):
    """Two triangles in the square (0, 0) to (2, 2)."""
    mesh = mi.Mesh("plane", 4, 2, has_vertex_texcoords=texcoords is not None)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"], parameters["faces"] = list(positions), [0, 1, 2, 0, 2, 3]
    if texcoords is not None:
        parameters["vertex_texcoords"] = texcoords
    parameters.update()
    return mesh


def hits(mesh, x, y, view):
    """Where rays against ``view`` (3, n) meet a mesh at x and y."""
    scene = mi.load_dict({"type": "scene", "mesh": mesh})
    p = mi.Point3f(mi.Float(x), mi.Float(y), 0)
    return scene.ray_intersect(mi.Ray3f(p + 3 * mi.Vector3f(view), -mi.Vector3f(view)))


@pytest.mark.parametrize("pixel_angle", [0.0, 0.01])
def test_mirrored_texture_coordinates_mirror_the_surface(libraries, pixel_angle):
    """What is on the mirrored half of a model is the mirror image of the other half, normals and all."""
    mi.set_variant("llvm_ad_rgb")
    x, y = np.random.default_rng(7).uniform(0.1, 1.9, (2, N)).astype(np.float32)
    bsdf = load(libraries["maps"], pixel_angle=pixel_angle)
    across = np.array([-1, 1, 1], np.float32)[:, None]
    values = []
    for texcoords, view, light in (
        ([0, 0, 1, 0, 1, 1, 0, 1], VIEW, LIGHT),
        ([1, 0, 0, 0, 0, 1, 1, 1], across * VIEW, across * LIGHT),
    ):
        si = hits(plane(texcoords), 2 - x if values else x, y, view)
        wo = si.to_local(mi.Vector3f(light))
        sample, _ = bsdf.sample(mi.BSDFContext(), si, mi.Float(U[0]), mi.Point2f(U[1:]))
        lit = np.array(sample.pdf) > 0
        values.append((np.array(bsdf.eval(mi.BSDFContext(), si, wo)), np.array(si.to_world(sample.wo)), lit))
    (f, wo, lit), (mirrored, mirrored_wo, _) = values
    assert np.allclose(f, mirrored, rtol=1e-3)
    assert np.allclose((across * wo)[:, lit], mirrored_wo[:, lit], atol=1e-2)
    # … which it would not be without the turn of the normals.
    unturned = response(bsdf, hits(plane([0, 0, 1, 0, 1, 1, 0, 1]), x, y, VIEW), LIGHT * [[1], [-1], [1]])
    assert np.mean(np.abs(f - unturned) > 0.02 * f) > 0.5


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_meshes_without_texture_coordinates_and_degenerate_ones_render(libraries, variant):
    mi.set_variant(variant)
    for texcoords in (None, [0.5, 0.5] * 4, [0, 0, 1, 1, 2, 2, 3, 3]):
        mesh = plane(texcoords)
        mesh.set_bsdf(load(libraries["maps"], pixel_angle=0.01))
        image = render(mesh, integrator={"type": "path", "max_depth": 3})
        assert np.all(np.isfinite(image)) and image.mean() > 0.01


# ----- Footprints -----


def sensor(size=8, fov=15, kind="perspective", **more):
    look_at = mi.ScalarTransform4f().look_at([1, -1.5, 1], [1, 1, 0], [0, 0, 1])
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    return mi.load_dict({"type": kind, "fov": fov, "to_world": look_at, "film": film, **more})


@pytest.mark.parametrize("spp", [1, 16])
def test_footprint_is_that_of_the_rays_differentials(waves, spp):
    """In scalar variants rays from the camera have them, and `direct` hands them on."""
    mi.set_variant("scalar_rgb")
    # Differentials are differences: of small pixels, so that the perspective within one does not count.
    camera = sensor(size=200, near_clip=1e-3)
    to_uv = mi.ScalarTransform3f().scale(20 * spp**0.5)
    exact = load(waves, "patch", to_uv=to_uv)
    own = load(waves, "patch", to_uv=to_uv, pixel_angle=glimt.pixel_angle(camera, spp))
    scene = mi.load_dict({"type": "scene", "plane": plane([0, 0, 1, 0, 1, 1, 0, 1])})
    context, wo = mi.BSDFContext(), mi.Vector3f(0, 0, 1)
    differences = []
    for position in np.random.default_rng(8).uniform(0.35, 0.65, (100, 2)):
        ray, _ = camera.sample_ray_differential(0, 0.5, position.tolist(), [0.5, 0.5])
        ray.scale_differential(spp**-0.5)
        si = scene.ray_intersect(ray)
        si.compute_uv_partials(ray)
        duv = np.array(si.duv_dx), np.array(si.duv_dy)
        answers = []
        for bsdf, scale in ((exact, 1), (own, 0), (exact, 1.01), (exact, 0)):
            si.duv_dx, si.duv_dy = (scale * duv[0]).tolist(), (scale * duv[1]).tolist()
            answers.append(bsdf.eval(context, si, wo)[0])
        differences.append(answers)
    truth, own, larger, point = np.array(differences).T
    assert np.abs(own - truth).mean() < np.abs(larger - truth).mean()
    # Such a footprint matters.
    assert np.abs(point - truth).mean() > 5 * np.abs(larger - truth).mean()


@pytest.mark.parametrize("kind", ["perspective", "thinlens"])
@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_pixel_angle_is_that_between_rays(variant, kind):
    mi.set_variant(variant)
    lens = {"aperture_radius": 1e-4} if kind == "thinlens" else {}
    camera = sensor(size=200, kind=kind, **lens)
    place = mi.Point2f(0.5, 0.5), mi.Point2f(0.5, 0.5)
    ray, _ = camera.sample_ray_differential(0.0, 0.5, *place)
    turn = np.linalg.norm(np.array(ray.d_x).ravel() - np.array(ray.d).ravel())
    assert np.isclose(glimt.pixel_angle(camera), turn, rtol=1e-3)
    assert np.isclose(glimt.pixel_angle(camera, spp=16), turn / 4, rtol=1e-3)


def test_pixel_angle_refuses_what_it_does_not_know():
    mi.set_variant("llvm_ad_rgb")
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    for camera, kind in (
        (mi.load_dict({"type": "orthographic", "film": film}), "OrthographicCamera"),
        (3, "int"),
    ):
        with pytest.raises(TypeError, match=f"sensor is a {kind}, expected a perspective or thinlens"):
            glimt.pixel_angle(camera)
    with pytest.raises(ValueError, match="spp is 0"):
        glimt.pixel_angle(sensor(), spp=0)


def test_importance_is_not_filtered_and_swaps_the_roles(libraries):
    mi.set_variant("llvm_ad_rgb")
    bsdf, context = load(libraries["maps"], pixel_angle=0.1), mi.BSDFContext(mi.TransportMode.Importance)
    si = interaction()
    value = np.array(bsdf.eval(context, si, mi.Vector3f(LIGHT)))
    swapped = glimt.load(libraries["maps"])["orange"].eval(VIEW.T, LIGHT.T, uv=UV.T).T * LIGHT[2]
    assert np.allclose(value, swapped, rtol=1e-4)
    sample, weight = bsdf.sample(context, si, mi.Float(U[0]), mi.Point2f(U[1:]))
    lit = np.array(sample.pdf) > 0
    again, pdf = bsdf.eval_pdf(context, si, sample.wo)
    assert np.allclose(np.array(pdf)[lit], np.array(sample.pdf)[lit], rtol=1e-4)
    assert np.allclose(np.array(again)[:, lit], (np.array(weight) * np.array(sample.pdf))[:, lit], rtol=1e-3)


# ----- In scenes -----


def render(shape, integrator=None, spp=4, camera=None, **more):
    """A plane of a surface below a lamp."""
    shapes = {"plane": shape, **more} if shape else more
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator or {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
            "sensor": camera or sensor(),
            "lamp": {"type": "point", "position": [0.5, 2, 2], "intensity": 10.0},
            "sky": {"type": "constant", "radiance": 0.3}
            if integrator
            else {"type": "point", "intensity": 0.0},
            **shapes,
        }
    )
    return np.array(mi.render(scene, spp=spp, seed=1))[..., :3]


def rectangle(bsdf):
    place = mi.ScalarTransform4f().translate([1, 1, 0])
    return {"type": "rectangle", "to_world": place, "bsdf": bsdf}


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_adapters_and_instances_change_nothing(libraries, variant):
    """A lamp alone asks for no samples, so that images are equal, and not up to noise."""
    mi.set_variant(variant)
    surface = {"type": "glimt", "filename": str(libraries["maps"]), "material": "orange", "pixel_angle": 0.02}
    bare = render(rectangle(surface))
    assert np.all(np.isfinite(bare)) and bare.mean() > 0.01
    adapters = {
        "twosided": {"type": "twosided", "bsdf": surface},
        "mask": {"type": "mask", "opacity": 1.0, "bsdf": surface},
        "blendbsdf": {"type": "blendbsdf", "weight": 0.5, "a": surface, "b": surface},
    }
    for name, bsdf in adapters.items():
        assert np.allclose(render(rectangle(bsdf)), bare, rtol=1e-4, atol=1e-6), name
        noisy = render(rectangle(bsdf), {"type": "path", "max_depth": 4})
        assert np.all(np.isfinite(noisy)) and noisy.mean() > bare.mean(), name
    group = {"type": "shapegroup", "plane": {"type": "rectangle", "bsdf": surface}}
    instance = {
        "type": "instance",
        "to_world": mi.ScalarTransform4f().translate([1, 1, 0]),
        "group": {"type": "ref", "id": "group"},
    }
    assert np.allclose(render(None, group=group, instance=instance), bare, rtol=1e-3, atol=1e-6)


def test_back_of_a_two_sided_surface_renders(libraries):
    mi.set_variant("llvm_ad_rgb")
    surface = {"type": "glimt", "filename": str(libraries["maps"]), "material": "orange", "pixel_angle": 0.02}
    turned = rectangle({"type": "twosided", "bsdf": surface})
    turned["to_world"] = turned["to_world"] @ mi.ScalarTransform4f().rotate([0, 1, 0], 180)
    image = render(turned)
    assert np.all(np.isfinite(image)) and image.mean() > 0.01
    assert not np.any(render({**turned, "bsdf": surface}))


def test_surfaces_and_others_share_a_virtual_call(libraries):
    mi.set_variant("llvm_ad_rgb")
    bsdfs = [load(libraries["maps"], name, tint=0.5 + 0.1 * i) for i, name in enumerate(MICROFACET)]
    bsdfs += [load(libraries["maps"], "rough", pixel_angle=0.1), load(libraries["hybrid"], "metal")]
    which = np.arange(N) % len(bsdfs)
    pointers = dr.zeros(mi.BSDFPtr, N)
    for i, bsdf in enumerate(bsdfs):
        pointers = dr.select(mi.UInt32(which) == i, mi.BSDFPtr(bsdf), pointers)
    si = interaction(duv=0 * DUV)
    mixed = response(pointers, si)
    for i, bsdf in enumerate(bsdfs):
        assert np.allclose(mixed[:, which == i], response(bsdf, si)[:, which == i], rtol=1e-6), i


def horizon(library, pixel_angle, spp, seed, size=16):
    camera = {
        "type": "perspective",
        "fov": 60,
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 1], [0, 4, 0], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
    }
    angle = glimt.pixel_angle(mi.load_dict(camera)) if pixel_angle else 0.0
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": camera,
            "plane": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().scale(100),
                "bsdf": {
                    "type": "glimt",
                    "filename": str(library),
                    "material": "rough",
                    "pixel_angle": angle,
                    "to_uv": mi.ScalarTransform3f().scale(100),
                },
            },
            "sky": {"type": "constant", "radiance": 0.5},
            "sun": {"type": "directional", "direction": [0.3, 0.5, -0.8], "irradiance": 2.0},
        }
    )
    image = np.array(mi.render(scene, spp=spp, seed=seed))[..., :3]
    # The plane is below the horizon.
    return image[image.shape[0] // 2 :]


def test_footprints_keep_the_mean_of_an_image(libraries):
    mi.set_variant("llvm_ad_rgb")
    points = [horizon(libraries["maps"], False, 64, seed).mean() for seed in range(4)]
    seen = [horizon(libraries["maps"], True, 64, seed + 4).mean() for seed in range(4)]
    # Means of four images each, and what a fit of averages costs besides.
    noise = np.hypot(np.std(points, ddof=1), np.std(seen, ddof=1)) / 2
    assert abs(np.mean(points) - np.mean(seen)) < 4 * noise + 0.01 * np.mean(points)


@pytest.mark.long
def test_footprints_have_no_bias_of_a_percent(libraries):
    mi.set_variant("llvm_ad_rgb")
    points, seen = (horizon(libraries["maps"], filtered, 4096, 1).mean() for filtered in (False, True))
    assert abs(points - seen) < 0.01 * points


# ----- Parameters and derivatives -----


@pytest.mark.parametrize("library", ["maps", "ggx", "hybrid"])
@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb", "llvm_ad_mono"])
def test_tint_is_a_factor(libraries, library, variant):
    mi.set_variant(variant)
    tint = np.array([0.2, 0.5, 1.5])
    plain, tinted = (
        load(libraries[library]),
        load(libraries[library], tint={"type": "rgb", "value": tint.tolist()}),
    )
    si = scalar_interaction(0) if variant == "scalar_rgb" else interaction()
    light = mi.Vector3f(LIGHT[:, 0] if variant == "scalar_rgb" else LIGHT)
    u = (
        (float(U[0, 0]), mi.Point2f(U[1:, 0]))
        if variant == "scalar_rgb"
        else (mi.Float(U[0]), mi.Point2f(U[1:]))
    )
    context = mi.BSDFContext()
    for ask in (
        lambda bsdf: bsdf.eval(context, si, light),
        lambda bsdf: bsdf.sample(context, si, *u)[1],
        lambda bsdf: bsdf.eval_pdf_sample(context, si, light, *u)[0],
        lambda bsdf: bsdf.eval_pdf_sample(context, si, light, *u)[3],
    ):
        before, after = np.array(ask(plain)), np.array(ask(tinted))
        if variant == "llvm_ad_mono":
            assert np.all(after <= 1.5 * before) and np.all(after >= 0.2 * before) and np.any(after != before)
        else:
            assert np.allclose((before.T * tint).T, after, rtol=1e-5)


def test_tint_has_a_derivative(libraries):
    """f is linear in it."""
    mi.set_variant("llvm_ad_rgb")
    bsdf = load(libraries["maps"], tint={"type": "rgb", "value": [0.2, 0.5, 1.5]})
    params = mi.traverse(bsdf)
    dr.enable_grad(params["tint"])
    params.update()
    value = bsdf.eval(mi.BSDFContext(), interaction(), mi.Vector3f(LIGHT))
    dr.backward(dr.sum(dr.sum(value)))
    found = np.array(dr.grad(params["tint"])).ravel()
    assert np.allclose(found * [0.2, 0.5, 1.5], np.array(dr.detach(value)).sum(axis=1), rtol=1e-4)


@pytest.mark.parametrize("integrator", ["prb", "path"])
def test_rendering_has_the_derivative_of_tint(libraries, integrator):
    mi.set_variant("llvm_ad_rgb")
    surface = {"type": "glimt", "filename": str(libraries["maps"]), "material": "orange", "pixel_angle": 0.02}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": integrator, "max_depth": 4, "rr_depth": 10},
            "sensor": sensor(),
            "plane": {**rectangle({**surface, "id": "surface"}), "id": "plane"},
            "wall": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([1, 2, 1]).rotate([1, 0, 0], 90),
                "bsdf": {"type": "diffuse"},
            },
            "sky": {"type": "constant"},
        }
    )
    params = mi.traverse(scene)
    (key,) = [key for key in params.properties if key.endswith("tint")]
    original = mi.Color3f(0.6, 0.7, 0.8)
    sides = []
    for step in (0.02, -0.02):
        params[key] = original + step
        params.update()
        sides.append(np.array(mi.render(scene, spp=256, seed=3)).mean())
    params[key] = original
    dr.enable_grad(params[key])
    params.update()
    dr.backward(dr.mean(mi.render(scene, params, spp=256, seed=3), axis=None))
    found = np.array(dr.grad(params[key])).sum()
    assert np.isclose(found, (sides[0] - sides[1]) / 0.04, rtol=0.03)


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


def test_other_derivatives_are_warned_of_once(libraries):
    mi.set_variant("llvm_ad_rgb")
    bsdf, si, messages = load(libraries["maps"]), interaction(), Messages()
    params = mi.traverse(bsdf)
    mi.logger().add_appender(messages)
    try:
        dr.enable_grad(params["tint"])
        params.update()
        response(bsdf, si)
        assert not messages.warnings
        dr.enable_grad(si.uv)
        for _ in range(2):
            value = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(LIGHT))
            bsdf.sample(mi.BSDFContext(), si, mi.Float(U[0]), mi.Point2f(U[1:]))
        assert len(messages.warnings) == 1
        for words in ("no derivatives", "tint", libraries["maps"].name):
            assert words in messages.warnings[0]
        dr.backward(dr.sum(value))
        assert not np.any(np.array(dr.grad(si.uv)))
    finally:
        mi.logger().remove_appender(messages)


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_materials_that_are_the_same_everywhere_ignore_the_place(libraries, variant):
    mi.set_variant(variant)
    for library in ("ggx", "hybrid"):
        plain = load(libraries[library])
        placed = load(libraries[library], pixel_angle=0.1, to_uv=mi.ScalarTransform3f().scale(3))
        scalar = variant == "scalar_rgb"
        si, light = (scalar_interaction(0), LIGHT[:, 0]) if scalar else (interaction(), LIGHT)
        assert np.array_equal(response(plain, si, light), response(placed, si, light))
        assert "pixel_angle" not in mi.traverse(placed)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"tint": -0.5}, ['"tint" is -0.5', "not negative"]),
        ({"tint": "red"}, ['"tint" must be']),
        ({"pixel_angle": -0.1}, ['"pixel_angle" is -0.1']),
        ({"sampler": "table"}, ["is a surface", "sampler"]),
        ({"kd": 0.5}, ["maps"]),
    ],
)
def test_wrong_parameters_are_refused(libraries, change, words):
    mi.set_variant("llvm_ad_rgb")
    with pytest.raises(RuntimeError) as error:
        load(libraries["maps"], **change)
    assert all(word in str(error.value) for word in words), error.value


def test_to_uv_without_an_inverse_is_refused(libraries):
    mi.set_variant("scalar_rgb")
    with pytest.raises(RuntimeError, match="no inverse"):
        load(libraries["maps"], to_uv=mi.ScalarTransform3f().scale([1, 0]))


def test_parameters_can_be_changed_and_refused(libraries):
    mi.set_variant("llvm_ad_rgb")
    bsdf = load(libraries["maps"])
    params = mi.traverse(bsdf)
    si = hits(plane([0, 0, 1, 0, 1, 1, 0, 1]), 0.3 + 0.02 * np.arange(N), np.full(N, 0.7), VIEW)
    near = response(bsdf, si)
    params["pixel_angle"] = 0.1
    params.update()
    far = response(bsdf, si)
    assert np.mean(np.abs(far - near) > 0.01 * near) > 0.5
    for key, wrong in (("pixel_angle", -1.0), ("tint", mi.Color3f(-1.0))):
        params[key] = wrong
        with pytest.raises(RuntimeError, match=key):
            params.update()
        assert np.array_equal(response(bsdf, si), far)


def test_frozen_evaluation_follows_the_parameters(libraries):
    mi.set_variant("llvm_ad_rgb")
    bsdf = load(libraries["maps"])
    params = mi.traverse(bsdf)
    light = mi.Vector3f(LIGHT)

    def evaluate(bsdf, si):
        return bsdf.eval(mi.BSDFContext(), si, light)

    frozen = dr.freeze(evaluate)
    si = hits(plane([0, 0, 1, 0, 1, 1, 0, 1]), 0.3 + 0.02 * np.arange(N), np.full(N, 0.7), VIEW)
    for i in range(3):
        params["pixel_angle"] = 0.05 * i
        params["tint"] = mi.Color3f(0.3 + 0.2 * i, 1.0, 0.5)
        params.update()
        assert np.allclose(np.array(frozen(bsdf, si)), np.array(evaluate(bsdf, si)), rtol=1e-6), i
