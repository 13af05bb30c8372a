"""A renderer that is not Mitsuba makes the same images, and a broken material does not.

`cpp/harness` is a path tracer over the C++ header. It and Mitsuba render each scene of `scenes/harness`, and
a z-test on blocks of pixels tells error from noise (`glimt compare`).
"""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SCENES = ROOT / "scenes" / "harness"
SPP = 64

mi = pytest.importorskip("mitsuba")
sys.path.insert(0, str(Path(__file__).parent / "harness"))
import mitsuba_image  # noqa: E402
from model_libraries import LIBRARIES, write_library  # noqa: E402


@pytest.fixture(scope="module")
def harness(target_dir, tmp_path_factory):
    """The program."""
    if not any(Path(f"/usr/include/embree{version}/rtcore.h").exists() for version in (3, 4)):
        pytest.skip("Embree is not installed: apt-get install libembree-dev libpugixml-dev")
    for tool in ("cmake", "cargo", "c++"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    build = tmp_path_factory.mktemp("harness")
    options = ["HARNESS=ON", "EXAMPLES=OFF", "WERROR=ON", f"CARGO_TARGET_DIR={target_dir}"]
    subprocess.run(["cmake", "-S", ROOT / "cpp", "-B", build, *(f"-DGLIMT_{o}" for o in options)], check=True)
    subprocess.run(["cmake", "--build", build, "--target", "harness"], check=True)
    return build / "harness"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """An environment map and a texture."""
    mi.set_variant("scalar_rgb")
    folder = tmp_path_factory.mktemp("images")
    mitsuba_image.write_sky(folder / "sky.exr")
    mitsuba_image.write_checker(folder / "checker.exr")
    return folder


@pytest.fixture(scope="module")
def truths(files):
    """Mitsuba's image of a scene, rendered once."""
    rendered = {}

    def truth(scene):
        if scene not in rendered:
            try:
                mi.set_variant("llvm_ad_rgb")
            except ImportError:
                pytest.skip("no libLLVM: the scalar variant would take minutes")
            rendered[scene] = files / f"{scene}.exr"
            loaded = mi.load_file(str(SCENES / f"{scene}.xml"), **parameters(scene, files))
            mitsuba_image.write(rendered[scene], *mitsuba_image.render(loaded, SPP))
        return rendered[scene]

    return truth


def parameters(scene, files):
    return {
        "environment": {"envmap": str(files / "sky.exr")},
        "texture": {"texture": str(files / "checker.exr")},
    }.get(scene, {})


def compare(command_line, harness, scene, truth, files, *options):
    """The verdict of `glimt compare` on the harness's image: its exit code, and what it measured."""
    image = files / "image.exr"
    definitions = [word for pair in parameters(scene, files).items() for word in ("-D", "=".join(pair))]
    command = [harness, SCENES / f"{scene}.xml", "-o", image, "--spp", str(SPP), *definitions, *options]
    subprocess.run(command, check=True)
    compared = subprocess.run([command_line, "compare", "--json", truth, image], stdout=subprocess.PIPE)
    return compared.returncode, json.loads(compared.stdout)


@pytest.mark.parametrize("scene", ["environment", "mesh", "texture", "interior"])
def test_harness_and_mitsuba_agree_within_noise(command_line, harness, scene, truths, files):
    code, measured = compare(command_line, harness, scene, truths(scene), files)
    assert code == 0, measured
    assert abs(measured["bias"]) < 0.05 * measured["mean"]


def interior_of_one_material(path):
    """The interior with every surface of $material, and without the edit that not every model takes."""
    text = (SCENES / "interior.xml").read_text()
    text = re.sub(r'(name="material" value=)"\w+"', r'\1"$material"', text)
    path.write_text(re.sub(r'<float name="alpha"[^>]*/>', "", text))
    return path


MODELS = [
    "ggx",
    "brushed",
    "hybrid",
    "hybrid_isotropic",
    "neural",
    "nbrdf",
    "spherical",
    "factor",
    "analytic_gamma",
]


@pytest.mark.long
@pytest.mark.parametrize("model", ["shipped", *MODELS])
@pytest.mark.parametrize("scene", ["environment", "mesh", "texture", "interior"])
def test_they_agree_at_256_samples_for_every_model(harness, scene, model, tmp_path):
    if scene == "mesh" and model in ("brushed", "hybrid", "neural", "spherical"):
        pytest.skip("without texture coordinates a tangent, on which f depends, is each renderer's own")
    file, definitions = SCENES / f"{scene}.xml", []
    if model != "shipped":
        if scene == "interior":
            file = interior_of_one_material(tmp_path / file.name)
        library = write_library(tmp_path / "lib.safetensors", **LIBRARIES[model])
        material = "brushed" if model == "brushed" else "orange"
        definitions = ["-D", f"library={library}", "-D", f"material={material}"]
    program = Path(__file__).parent / "harness" / "mitsuba_image.py"
    command = [sys.executable, program, harness, file, "--spp", "256", *definitions]
    done = subprocess.run(command, capture_output=True, text=True)
    print(f"{scene}, {model}: {done.stdout.splitlines()[-1] if done.stdout else done.stderr}")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("fault", ["cosine", "swap", "pdf"])
def test_a_broken_material_is_found(command_line, harness, fault, truths, files):
    code, measured = compare(
        command_line, harness, "environment", truths("environment"), files, "--fault", fault
    )
    assert code == 1 and measured["z_test"]["p_value"] < 1e-4, measured


def test_what_the_harness_does_not_know_is_refused_by_name(harness, tmp_path):
    scene = tmp_path / "scene.xml"
    scene.write_text('<scene version="3.0.0"><shape type="teapot"/></scene>')
    refused = subprocess.run([harness, scene, "-o", tmp_path / "a.exr"], stderr=subprocess.PIPE, text=True)
    assert refused.returncode == 1 and 'type="teapot"' in refused.stderr
    assert subprocess.run([harness], stderr=subprocess.PIPE).returncode == 2
