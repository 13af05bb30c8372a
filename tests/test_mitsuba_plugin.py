"""Loading, editing and describing the Mitsuba plugin: what a scene's author meets."""

import gc
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mitsuba_common import (
    LIBRARIES,
    MICROFACET,
    dr,
    hemisphere,
    interaction,
    load,
    mi,
    network_tensors,
    save_safetensors,
    write_libraries,
)

glimt = pytest.importorskip("glimt")

VARIANTS = [
    "scalar_rgb",
    "scalar_spectral",
    "scalar_spectral_polarized",
    "llvm_ad_rgb",
    "llvm_ad_mono",
    "llvm_ad_mono_polarized",
    "llvm_ad_spectral",
    "llvm_ad_spectral_polarized",
]


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    return write_libraries(tmp_path_factory.mktemp("libraries"))


def test_xml_finds_the_library_beside_the_scene(libraries, tmp_path):
    mi.set_variant("scalar_rgb")
    (tmp_path / "models").mkdir()
    (tmp_path / "models/lib.safetensors").write_bytes(libraries["hybrid"].read_bytes())
    scene = tmp_path / "scene.xml"
    scene.write_text(
        """<scene version="3.0.0">
             <shape type="sphere"><bsdf type="glimt">
               <string name="filename" value="models/lib.safetensors"/>
               <string name="material" value="metal"/>
             </bsdf></shape>
           </scene>"""
    )
    text = str(mi.load_file(str(scene)).shapes()[0].bsdf())
    for expected in ("lib.safetensors", "metal", "hybrid", "10-16-16-6", "4, 3.1, 2.2"):
        assert expected in text, text


def test_xml_edits_take_the_place_of_the_fit(libraries):
    mi.set_variant("scalar_rgb")
    edited = mi.load_string(
        f"""<bsdf version="3.0.0" type="glimt">
              <string name="filename" value="{libraries["ggx"]}"/> <string name="material" value="orange"/>
              <rgb name="kd" value="0.8, 0.2, 0.1"/> <rgb name="eta" value="1.7"/>
              <float name="alpha_x" value="0.1"/> <float name="alpha_y" value="0.3"/>
            </bsdf>"""
    )
    params = mi.traverse(edited)
    assert np.allclose(params["kd"], [0.8, 0.2, 0.1])
    assert np.allclose(params["eta"], 1.7)
    assert np.allclose([params["alpha_x"], params["alpha_y"]], [0.1, 0.3])
    # k_d/π is all that there is away from the lobe.
    si = mi.SurfaceInteraction3f()
    si.wi = [0.6, 0, 0.8]
    wo = mi.ScalarVector3f(0.6, 0, 0.8)
    bare = load(libraries["ggx"], kd=0.0, eta=1.0, alpha=0.1).eval(mi.BSDFContext(), si, wo)
    assert np.allclose(bare, 0)
    matte = load(libraries["ggx"], kd={"type": "rgb", "value": [0.8, 0.2, 0.1]}, eta=1.0)
    assert np.allclose(matte.eval(mi.BSDFContext(), si, wo), 0.8 * np.array([0.8, 0.2, 0.1]) / np.pi)


def test_only_material_needs_no_name(tmp_path):
    mi.set_variant("scalar_rgb")
    tensors = network_tensors(np.random.default_rng(1), [6, 21, 21, 3], 0.1, leading=(1,))
    header = (
        '{"format": 1, "kind": "nbrdf", "color_space": "linear sRGB",'
        ' "materials": [{"name": "single", "source": "", "sha256": "", "command": ""}]}'
    )
    library = tmp_path / "one.safetensors"
    save_safetensors(library, tensors, {"glimt": header})
    assert "single" in str(mi.load_dict({"type": "glimt", "filename": str(library)}))


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("library", LIBRARIES)
def test_every_model_loads_in_every_variant(libraries, library, variant):
    mi.set_variant(variant)
    bsdf = load(libraries[library])
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.3, 0.1, 0.9)
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(-0.3, 0.2, 0.9))
    assert np.all(np.array(pdf) > 0)
    assert np.max(np.array(value)) > 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"filename": "nowhere.safetensors"}, ["nowhere.safetensors", "No such file"]),
        ({"material": "orage"}, ['"orage"', "did you mean", "orange"]),
        ({"material": ""}, ["orange, metal, rough"]),
        ({"kd": 2.0}, ["kd is 2", "[0, 1]"]),
        ({"eta": 0.5}, ["eta is 0.5", "[1, 10]"]),
        ({"alpha": 0.0}, ["alpha is 0"]),
        ({"alpha": 0.1, "alpha_x": 0.1}, ["not both"]),
        ({"alpha_y": 0.1}, ["come together"]),
        ({"kd": "red"}, ['"kd" must be an <rgb> or a <float>']),
        ({"roughness": 0.1}, ["roughness"]),
    ],
)
@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_bad_input_is_told_in_words(libraries, variant, change, words):
    mi.set_variant(variant)
    with pytest.raises(RuntimeError) as error:
        mi.load_dict({"type": "glimt", "filename": str(libraries["hybrid"]), "material": "orange", **change})
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize("library", ["hybrid", "factor", "factor_bivariate", "analytic_gamma"])
def test_broken_file_is_told_in_words(libraries, tmp_path, library):
    mi.set_variant("scalar_rgb")
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(libraries[library].read_bytes()[:-100])
    with pytest.raises(RuntimeError, match=r"broken\.safetensors"):
        load(broken)


@pytest.mark.parametrize(
    ("library", "before", "after", "words"),
    [
        ("factor", b'"independent-g\\"', b'"independent-h\\"', ["form", "independent-h", "g-from-d"]),
        ("factor", b'"masking"', b'"maskinh"', ["masking"]),
        ("factor_bivariate", b'"bivariate": {"dtype"', b'"bivariatf": {"dtype"', ["bivariate"]),
        ("factor_naive", b"[3, 3, 180]", b"[3, 6,  90]", ["azimuth", "[3, 3, 180]"]),
        ("analytic_ward", b"ward", b"wart", ["wart", "cook-torrance"]),
        ("analytic_ward", b"[3, 4]", b"[4, 3]", ["specular"]),
    ],
)
def test_broken_tables_are_told_in_words(libraries, tmp_path, library, before, after, words):
    mi.set_variant("scalar_rgb")
    intact, broken = libraries[library].read_bytes(), tmp_path / "broken.safetensors"
    assert before in intact and len(before) == len(after)
    broken.write_bytes(intact.replace(before, after))
    with pytest.raises(RuntimeError, match=r"broken\.safetensors") as error:
        load(broken)
    for word in words:
        assert word in str(error.value)


def test_numbers_out_of_range_are_told_in_words(libraries, tmp_path):
    mi.set_variant("scalar_rgb")
    broken = tmp_path / "broken.safetensors"
    intact = libraries["factor"].read_bytes()
    # The last tensor is the masking; a factor is at most 1.
    broken.write_bytes(intact[:-4] + np.float32(1.5).tobytes())
    with pytest.raises(RuntimeError, match=r"broken\.safetensors.*masking holds 1\.5.*from 0 to 1"):
        load(broken)


def test_edit_of_a_model_without_analytic_part_is_an_error(libraries):
    mi.set_variant("scalar_rgb")
    for kind in ("nbrdf", "factor", "analytic_ward"):
        with pytest.raises(RuntimeError, match=rf"kd.*{kind.split('_')[0]}"):
            load(libraries[kind], kd=0.5)


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_traversed_parameters_change_the_material(libraries, variant):
    mi.set_variant(variant)
    bsdf = load(libraries["hybrid"])
    params = mi.traverse(bsdf)
    assert set(params.properties) == {"kd", "eta", "alpha", "latent", "tint"}
    params["kd"] = mi.Color3f(0.1, 0.5, 0.9)
    params["alpha"] = 0.4
    params.update()
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.36, 0.48, 0.8)
    wo = mi.Vector3f(0, 0.6, 0.8)
    edited = load(libraries["hybrid"], kd={"type": "rgb", "value": [0.1, 0.5, 0.9]}, alpha=0.4)
    ctx = mi.BSDFContext()
    assert np.array_equal(np.array(bsdf.eval(ctx, si, wo)), np.array(edited.eval(ctx, si, wo)))
    assert np.array_equal(np.array(bsdf.pdf(ctx, si, wo)), np.array(edited.pdf(ctx, si, wo)))


def refused_values():
    """Values that an update refuses, by the parameter, with a word of the message."""
    values = [("alpha", 7.0, "alpha is 7"), ("kd", mi.Color3f(0.2, 2.0, 0.2), "kd is 2")]
    values += [("eta", mi.Color3f(0.5), "eta is 0.5"), ("kd", mi.Color3f(float("nan")), "kd is NaN")]
    values += [("latent", "nan", "latent")]
    if dr.is_jit_v(mi.Float):
        values += [
            ("latent", mi.Float([0.1] * 7), "7 numbers"),
            ("alpha", mi.Float(0.1, 0.2, 0.3), "3 values"),
        ]
    return values


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_nothing_of_a_refused_update_remains(libraries, variant):
    mi.set_variant(variant)
    bsdf = load(libraries["hybrid"], kd=0.3)
    ctx, si = mi.BSDFContext(), dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.36, 0.48, 0.8)
    params = mi.traverse(bsdf)

    def state():
        answers = []
        for traced in [False, True] if dr.is_diff_v(mi.Float) else [False]:
            wo = mi.Vector3f(0, 0.6, 0.8)
            if traced:
                dr.enable_grad(wo)
            answers += [bsdf.eval(ctx, si, wo), bsdf.pdf(ctx, si, wo), *bsdf.eval_pdf(ctx, si, wo)]
            answers += bsdf.sample(ctx, si, 0.7, mi.Point2f(0.3, 0.6))[1:]
        answers += [params[name] for name in ("kd", "eta", "alpha", "latent")]
        return [np.array(answer) for answer in answers], str(bsdf)

    before, text = state()
    for name, value, words in refused_values():
        if isinstance(value, str):
            value = params[name] * float(value)
        params["kd"] = mi.Color3f(0.9)
        params[name] = value
        with pytest.raises(RuntimeError, match=words):
            params.update()
        after, text_after = state()
        for a, b in zip(before, after):
            np.testing.assert_array_equal(a, b, err_msg=name)
        assert text_after == text
    params["kd"] = mi.Color3f(0.9)
    params["alpha"] = 0.4
    params.update()
    edited = load(libraries["hybrid"], kd=0.9, alpha=0.4)
    wo = mi.Vector3f(0, 0.6, 0.8)
    assert np.array_equal(np.array(bsdf.eval(ctx, si, wo)), np.array(edited.eval(ctx, si, wo)))
    assert np.array_equal(np.array(bsdf.pdf(ctx, si, wo)), np.array(edited.pdf(ctx, si, wo)))
    if dr.is_diff_v(mi.Float):
        # Gradients that were asked for of another parameter are no part of what is refused.
        dr.enable_grad(params["eta"])
        params["alpha"] = 7.0
        with pytest.raises(RuntimeError, match="alpha is 7"):
            params.update()
        assert dr.grad_enabled(params["eta"])


def test_one_component_that_masks_switch_as_a_whole(libraries):
    mi.set_variant("llvm_ad_rgb")
    bsdf = load(libraries["hybrid"])
    assert bsdf.component_count() == 1
    assert mi.has_flag(bsdf.flags(), mi.BSDFFlags.GlossyReflection)
    view, light = hemisphere(64, 1), hemisphere(64, 2)
    si, wo = interaction(view), mi.Vector3f(light)

    def evaluate(**mask):
        ctx = mi.BSDFContext()
        for name, value in mask.items():
            setattr(ctx, name, value)
        u = mi.Float(light[2]), mi.Point2f(light[0] * 0.5 + 0.5, view[2])
        sample, weight = bsdf.sample(ctx, si, *u)
        return [np.array(x) for x in (bsdf.eval(ctx, si, wo), bsdf.pdf(ctx, si, wo), sample.pdf, weight)]

    whole = evaluate()
    assert all(np.any(x > 0) for x in whole)
    for mask in ({"type_mask": +mi.BSDFFlags.GlossyReflection}, {"component": 0}):
        assert all(np.array_equal(a, b) for a, b in zip(evaluate(**mask), whole))
    for mask in ({"type_mask": +mi.BSDFFlags.DiffuseReflection}, {"component": 1}):
        assert not any(np.any(x) for x in evaluate(**mask))


def test_material_outlives_its_bsdf_in_a_recorded_kernel(libraries):
    mi.set_variant("llvm_ad_rgb")
    view, light = hemisphere(1000, 3), hemisphere(1000, 4)
    ctx, si, wo = mi.BSDFContext(), interaction(view), mi.Vector3f(light)
    bsdf = load(libraries["hybrid"], kd=0.123)
    expected = np.array(bsdf.eval(ctx, si, wo))
    pending = bsdf.eval(ctx, si, wo) * 1.0
    del bsdf
    gc.collect()
    # Whatever else is loaded now may take the memory of a material that was freed too early.
    others = [load(libraries["hybrid"], kd=0.9) for _ in range(20)]
    dr.eval(pending)
    assert np.array_equal(np.array(pending), expected)
    assert len(others) == 20


def test_edit_does_not_reach_back_into_a_recorded_kernel(libraries):
    mi.set_variant("llvm_ad_rgb")
    view, light = hemisphere(1000, 3), hemisphere(1000, 4)
    ctx, si, wo = mi.BSDFContext(), interaction(view), mi.Vector3f(light)
    bsdf = load(libraries["hybrid"])
    expected = np.array(bsdf.eval(ctx, si, wo))
    pending = bsdf.eval(ctx, si, wo) * 1.0
    params = mi.traverse(bsdf)
    params["kd"] = mi.Color3f(0.0)
    params.update()
    assert np.array_equal(np.array(pending), expected)
    assert not np.allclose(np.array(bsdf.eval(ctx, si, wo)), expected)


def test_several_materials_share_a_virtual_call(libraries):
    mi.set_variant("llvm_ad_rgb")
    ctx = mi.BSDFContext()
    bsdfs = [load(libraries["hybrid"], name) for name in MICROFACET]
    bsdfs += [load(libraries["nbrdf"], "rough"), mi.load_dict({"type": "diffuse"})]
    n = 999
    si, wo = interaction(hemisphere(n, 5)), mi.Vector3f(hemisphere(n, 6))
    which = np.arange(n) % len(bsdfs)
    pointers = dr.zeros(mi.BSDFPtr, n)
    for i, bsdf in enumerate(bsdfs):
        pointers = dr.select(mi.UInt32(which) == i, mi.BSDFPtr(bsdf), pointers)
    mixed = np.array(pointers.eval(ctx, si, wo))
    for i, bsdf in enumerate(bsdfs):
        alone = np.array(bsdf.eval(ctx, si, wo))
        assert np.array_equal(mixed[:, which == i], alone[:, which == i]), i


@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm")
def test_plugin_exports_its_entry_point_alone():
    plugin = Path(glimt.__file__).parent / "plugins" / "glimt.so"
    symbols = subprocess.run(["nm", "-D", "--defined-only", plugin], capture_output=True, text=True)
    assert [line.split()[-1] for line in symbols.stdout.splitlines()] == ["init_plugin"]


def test_import_order_does_not_matter(libraries):
    load_it = f"print(mi.load_dict(dict(type='glimt', filename={str(libraries['ggx'])!r}, material='metal')))"
    for order in (
        "import glimt; import mitsuba as mi; mi.set_variant('llvm_ad_rgb')",
        "import mitsuba as mi; mi.set_variant('scalar_rgb'); import glimt",
    ):
        run = subprocess.run([sys.executable, "-c", f"{order}; {load_it}"], capture_output=True, text=True)
        assert "metal" in run.stdout, run.stderr


def test_scene_with_many_materials_loads_in_parallel(libraries):
    """In a new process, where the first of them checks the in-kernel call while the others wait."""
    code = f"""
import glimt, mitsuba as mi
mi.set_variant("llvm_ad_rgb")
bsdf = dict(type="glimt", filename={str(libraries["hybrid"])!r}, material="metal")
spheres = {{f"s{{i}}": dict(type="sphere", bsdf=dict(bsdf, kd=i / 40)) for i in range(40)}}
print(mi.load_dict(dict(type="scene", **spheres)))
"""
    for _ in range(3):
        run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
        assert run.stdout.count("Glimt[") == 40, run.stderr


@pytest.mark.parametrize(
    ("width", "way"), [(1, "traced"), (4, "in-kernel call"), (8, "in-kernel call"), (16, "in-kernel call")]
)
def test_vector_width_decides_the_way_of_evaluation(libraries, width, way):
    # Dr.Jit has no Python function for it: the C++ one, by its mangled name.
    code = f"""
import ctypes, drjit as dr, glimt, mitsuba as mi, pathlib
mi.set_variant("llvm_ad_rgb")
core = ctypes.CDLL(str(pathlib.Path(dr.__file__).parent / "libdrjit-core.so"))
core._Z19jit_llvm_set_targetPKcS0_j(b"x86-64-v3", b"+avx2,+fma,+f16c", {width})
bsdf = mi.load_dict(dict(type="glimt", filename={str(libraries["hybrid"])!r}, material="metal"))
si = dr.zeros(mi.SurfaceInteraction3f, 100)
si.wi = mi.Vector3f(0, 0.6, 0.8)
print(bsdf, bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(0, -0.6, 0.8))[0][99])
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert f"evaluation = {way}" in run.stdout, run.stdout + run.stderr
    mi.set_variant("scalar_rgb")
    si = mi.SurfaceInteraction3f()
    si.wi = [0, 0.6, 0.8]
    f = load(libraries["hybrid"], "metal").eval(mi.BSDFContext(), si, [0, -0.6, 0.8])
    assert np.isclose(float(run.stdout.split()[-1]), f[0], rtol=1e-5)


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_mono"])
def test_frozen_rendering_follows_edits(libraries, variant):
    mi.set_variant(variant)
    bsdf = {"type": "glimt", "filename": str(libraries["hybrid"])}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 16, "height": 16},
            },
            "left": {"type": "sphere", "center": [-1, 0, 0], "bsdf": {**bsdf, "material": "orange"}},
            "right": {"type": "sphere", "center": [1, 0, 0], "bsdf": {**bsdf, "material": "metal"}},
            "sky": {"type": "constant"},
        }
    )

    def render(scene, seed):
        return mi.render(scene, spp=4, seed=seed)

    frozen = dr.freeze(render)
    params = mi.traverse(scene)
    for i in range(4):
        params["left.bsdf.kd"] = mi.Color3f(0.2 * i, 0.5, 0.1)
        params["left.bsdf.alpha"] = mi.Float(0.1 + 0.1 * i)
        params.update()
        image = np.array(frozen(scene, mi.UInt32(i)))
        assert np.allclose(image, np.array(render(scene, mi.UInt32(i))), atol=1e-5), i
