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


def serve(scene, name=""):
    """What ``glimt.simulate`` answers on two pairs, and how it ends."""
    pairs = np.tile(np.float32([0, 0, 1]), (2, 2))
    requests = (2).to_bytes(4, "little") + pairs.tobytes()
    run = subprocess.run(
        [sys.executable, "-m", "glimt.simulate", scene, *([name] if name else [])],
        input=requests,
        capture_output=True,
    )
    hello, answer = run.stdout.split(b"\n", 1)
    return json.loads(hello), answer, run.returncode


SCENE = """<scene version="3.0.0">
    <shape type="sphere"><bsdf type="diffuse"/></shape>
    <shape type="sphere"><bsdf type="roughconductor"/></shape>
    {more}
</scene>"""
NAMED = '<shape type="cube"><bsdf type="roughplastic" id="lacquer"/></shape>'


def test_of_several_bsdfs_one_has_to_be_named(tmp_path):
    scene = tmp_path / "scene.xml"
    scene.write_text(SCENE.format(more=NAMED))
    hello, _, code = serve(scene)
    assert code == 1 and "scene.xml has 3 BSDFs" in hello["error"], hello
    assert "a SmoothDiffuse without id, a RoughConductor without id, lacquer" in hello["error"], hello
    hello, answer, code = serve(scene, "lacquer")
    assert hello["name"] == "lacquer" and code == 0
    assert answer[:4] == bytes(4) and len(answer) == 4 + 2 * 12
    hello, _, code = serve(scene, "laquer")
    assert code == 1 and 'no BSDF "laquer"' in hello["error"] and "lacquer" in hello["error"], hello


def test_the_only_bsdf_needs_no_id(tmp_path):
    scene = tmp_path / "paint.xml"
    scene.write_text('<scene version="3.0.0"><shape type="sphere"><bsdf type="diffuse"/></shape></scene>')
    hello, answer, code = serve(scene)
    assert hello["name"] == "paint" and code == 0 and answer[:4] == bytes(4), hello


def test_two_bsdfs_of_one_id_are_not_chosen_from(tmp_path):
    scene = tmp_path / "scene.json"
    shapes = [
        {"type": "sphere", "paint": {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}}
        for value in (0.2, 0.8)
    ]
    scene.write_text(json.dumps({"type": "scene", "a": shapes[0], "b": shapes[1]}))
    hello, _, code = serve(scene, "paint")
    assert code == 1 and '2 BSDFs with the id "paint"' in hello["error"], hello


def test_what_a_bsdf_throws_is_the_answer(tmp_path, monkeypatch):
    import io

    from glimt import simulate

    def broken(*_):
        def evaluate(_):
            raise RuntimeError("no data\n  at 3")

        return evaluate

    monkeypatch.setattr(simulate, "evaluator", broken)
    scene = tmp_path / "paint.json"
    scene.write_text(json.dumps(PLASTIC))
    answers = io.BytesIO()
    with pytest.raises(SystemExit):
        simulate.serve(str(scene), "", io.BytesIO((1).to_bytes(4, "little") + bytes(24)), answers)
    _, answer = answers.getvalue().split(b"\n", 1)
    message = b"RuntimeError: no data at 3"
    assert answer == len(message).to_bytes(4, "little") + message
