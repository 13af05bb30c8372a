"""The scenes of the project, at the size of a stamp."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from mitsuba_common import mi

SCENES = ROOT / "scenes"
MEASUREMENT = ROOT.parent / "shared" / "data" / "rgl" / "chm_orange_rgb.bsdf"


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb", "llvm_ad_spectral"])
def test_gallery_renders(variant):
    mi.set_variant(variant)
    scene = mi.load_file(str(SCENES / "gallery.xml"), width=96, height=36, spp=4)
    image = np.array(mi.render(scene))[..., :3]
    assert np.all(np.isfinite(image))
    assert 0.05 < image.mean() < 1
    # Twelve materials: more colours than the grey floor has.
    assert np.std(image[..., 0] - image[..., 2]) > 0.02


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
@pytest.mark.parametrize("model", ["brushed", "weave"])
def test_a_surface_reaches_to_the_horizon(variant, model):
    mi.set_variant(variant)
    size = {"width": 64, "height": 36, "spp": 4}
    filename = str(SCENES / f"models/{model}.safetensors")
    scene = mi.load_file(str(SCENES / "surface.xml"), filename=filename, **size)
    image = np.array(mi.render(scene))[..., :3]
    assert np.all(np.isfinite(image))
    assert 0.02 < image[20:].mean() < 2


@pytest.mark.skipif(not MEASUREMENT.exists(), reason=f"{MEASUREMENT} not found")
def test_fit_looks_like_its_measurement(tmp_path):
    """The right half of the comparison, once with the measurement and once with the fit in its place."""
    mi.set_variant("llvm_ad_rgb")
    text = (SCENES / "comparison.xml").read_text()
    for name in ("models/rgl.safetensors", "knot.ply"):
        text = text.replace(f'"{name}"', f'"{SCENES / name}"')
    measured = '<bsdf type="measured">\n            <string name="filename" value="$measurement"/>'
    fit = (
        '<bsdf type="glimt"><string name="filename" value="$library"/>'
        '<string name="material" value="$material"/>'
    )
    assert measured in text
    images = []
    for description in (text, text.replace(measured, fit)):
        path = tmp_path / "scene.xml"
        path.write_text(description)
        parameters = {"measurement": str(MEASUREMENT)} if description is text else {}
        scene = mi.load_file(str(path), spp=16, **parameters)
        images.append(np.array(mi.render(scene))[:, 480:, :3])
    # What a display shows, in blocks of 8 × 8 pixels, which average the noise away.
    measured, fit = (np.clip(i, 0, 1).reshape(60, 8, 60, 8, 3).mean(axis=(1, 3)) for i in images)
    assert np.abs(measured - fit).mean() < 0.02
    assert np.allclose(measured.mean(axis=(0, 1)), fit.mean(axis=(0, 1)), rtol=0.03)


def test_command_of_mitsuba_renders_without_python(tmp_path):
    """The native program finds the plugin by the directory that it is given."""
    import glimt

    program = Path(mi.__file__).parent / "mitsuba"
    plugins = str(Path(glimt.__file__).parent)
    options = ["-m", "scalar_rgb", "-a", plugins, "-D", "width=32", "-D", "height=12", "-D", "spp=1"]
    output = tmp_path / "gallery.exr"
    run = subprocess.run(
        [program, *options, "-o", output, SCENES / "gallery.xml"],
        capture_output=True,
        text=True,
        env={**os.environ, "LD_LIBRARY_PATH": str(Path(sys.modules["drjit"].__file__).parent)},
    )
    assert run.returncode == 0 and output.exists(), run.stdout + run.stderr
