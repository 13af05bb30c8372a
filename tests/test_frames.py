"""``python -m glimt.frames``: what it says of whole frames."""

import json
import subprocess
import sys

import pytest

pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
pytest.importorskip("glimt.frames", reason="the package is not installed: pip install .")


def frames(request):
    command = [sys.executable, "-m", "glimt.frames", "-"]
    return subprocess.run(command, input=json.dumps(request), capture_output=True, text=True)


@pytest.mark.parametrize("scene", ["sphere", "room"])
def test_noise_falls_with_samples_and_another_bsdf_stays_apart(scene):
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.9}}
    request = {
        "bsdfs": {"grey": grey, "white": white},
        "reference": "grey",
        "variants": ["scalar_rgb"],
        "scenes": [scene],
        "spp": {"scalar_rgb": [1, 16]},
        "rounds": 1,
        "size": 16,
        "converged": 256,
    }
    done = frames(request)
    assert done.returncode == 0, done.stderr
    curves = json.loads(done.stdout)[scene]["scalar_rgb"]
    for few, many in curves.values():
        assert few["spp"] == 1 and many["spp"] == 16 and few["seconds"] > 0 and many["seconds"] > 0
        assert many["noise"] < 0.5 * few["noise"]
    assert curves["grey"][1]["rmse"] == curves["grey"][1]["noise"]
    assert curves["white"][1]["rmse"] > 1.2 * curves["white"][1]["noise"]


def test_without_a_request_it_says_how_to_ask():
    done = subprocess.run([sys.executable, "-m", "glimt.frames"], capture_output=True, text=True)
    assert done.returncode == 2 and "REQUEST.json" in done.stderr


def test_a_scene_that_does_not_exist_is_named():
    done = frames({"bsdfs": {}, "reference": "", "scenes": ["castle"]})
    assert done.returncode == 2 and done.stderr == "there is no scene 'castle'; expected sphere or room\n"
