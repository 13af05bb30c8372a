"""Fits to a BSDF of Mitsuba, which another process evaluates."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from mitsuba_common import hemisphere, interaction, mi

glimt = pytest.importorskip("glimt", reason="the package is not installed: pip install .")

PLASTIC = {
    "type": "roughplastic",
    "distribution": "ggx",
    "alpha": 0.3,
    "diffuse_reflectance": {"type": "rgb", "value": [0.5, 0.2, 0.1]},
}


def fit(command_line, directory, *options):
    """The library that ``glimt fit --from-mitsuba`` writes, and the errors that it prints."""
    scene, library = directory / "plastic.json", directory / "fit.safetensors"
    scene.write_text(json.dumps(PLASTIC))
    command = [command_line, "fit", "--from-mitsuba", scene, "-o", library, "--json", *options]
    environment = {**os.environ, "GLIMT_PYTHON": sys.executable}
    run = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return glimt.load(library), json.loads(run.stdout)["materials"]["plastic"]


@pytest.mark.parametrize(
    "options", [["--model", "ggx"], ["--model", "factor", "--variant", "g-from-d"]], ids=["ggx", "factor"]
)
def test_a_fit_looks_like_the_bsdf(command_line, tmp_path, options):
    library, errors = fit(command_line, tmp_path, *options)
    assert library.materials == ["plastic"] and library.kind == options[1]
    assert errors["smape"] < 0.1, errors
    mi.set_variant("llvm_ad_rgb")
    light, view = hemisphere(5000, 1, 0.2), hemisphere(5000, 2, 0.2)
    truth = np.array(mi.load_dict(PLASTIC).eval(mi.BSDFContext(), interaction(view), mi.Vector3f(light)))
    f_cos = library.material().eval(light.T, view.T) * light[2][:, None]
    assert np.mean(np.abs(f_cos - truth.T)) < 0.1 * truth.mean()


def test_a_bsdf_that_is_not_there_is_named(command_line, tmp_path):
    (tmp_path / "scene.json").write_text(json.dumps({"type": "nonsense"}))
    command = [
        command_line,
        "fit",
        "--from-mitsuba",
        tmp_path / "scene.json",
        "-o",
        tmp_path / "x.safetensors",
    ]
    run = subprocess.run(
        command, env={**os.environ, "GLIMT_PYTHON": sys.executable}, capture_output=True, text=True
    )
    assert run.returncode == 1 and "scene.json" in run.stderr and "nonsense" in run.stderr, run.stderr
    assert not (tmp_path / "x.safetensors").exists()
