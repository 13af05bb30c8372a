"""``python -m glimt.check``: stock BSDFs pass, broken ones do not, and bad usage is said to be."""

import json

import pytest

pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
check = pytest.importorskip("glimt.check", reason="the package is not installed: pip install .")

#: Broken BSDFs of check_mutants.py, and the test that must catch each.
CAUGHT_BY = {
    "weight": "weight",
    "cosine of weight": "weight",
    "pdf": "pdf-integral",
    "pdf term": "chi-squared",
    "misses half": "chi-squared",
    "swapped": "horizon-limit",
    "cosine": "horizon-limit",
    "nan": "finite",
    "below": "horizon",
    "components": "components-eval",
}


def run(capsys, *arguments, variant="llvm_ad_rgb"):
    """Exit code and the report."""
    code = check.main([*arguments, "--variant", variant, "--quick", "--json"])
    return code, json.loads(capsys.readouterr().out)


def failed(report):
    return {test["test"] for test in report["subjects"][0]["tests"] if test["verdict"] == "fail"}


@pytest.mark.parametrize("bug", CAUGHT_BY)
def test_a_broken_bsdf_fails(capsys, bug):
    code, report = run(capsys, json.dumps({"type": "mutant", "bug": bug}), "--import", "check_mutants")
    assert code == 1 and report["verdict"] == "fail"
    assert CAUGHT_BY[bug] in failed(report), failed(report)
    print(f"| {bug} | {', '.join(sorted(failed(report)))} |")


def test_the_bsdf_without_a_bug_passes(capsys):
    promises = ("--promise", "reciprocal", "--promise", "conserving")
    code, report = run(capsys, '{"type": "mutant"}', "--import", "check_mutants", *promises)
    assert code == 0 and report["verdict"] == "pass", failed(report)


def test_a_broken_bsdf_fails_in_a_scalar_variant(capsys):
    target = '{"type": "mutant", "bug": "weight"}'
    code, report = run(capsys, target, "--import", "check_mutants", variant="scalar_rgb")
    assert code == 1 and "weight" in failed(report)


@pytest.mark.parametrize(
    "target", ["diffuse", '{"type": "roughconductor", "distribution": "ggx"}', "plastic"]
)
def test_stock_bsdfs_pass(capsys, target):
    code, report = run(capsys, target)
    assert code == 0, report["subjects"][0]["tests"]


def test_delta_components_are_left_out_of_the_histogram(capsys):
    code, report = run(capsys, "conductor", variant="scalar_rgb")
    by_name = {test["test"]: test for test in report["subjects"][0]["tests"]}
    assert code == 0 and by_name["chi-squared"]["verdict"] == "left-out"
    assert "delta" in by_name["chi-squared"]["worst"]["note"]
    assert report["subjects"][0]["views"][0]["delta_share"] == 1


def test_a_bsdf_of_a_scene_is_found_by_its_id(capsys, tmp_path):
    scene = tmp_path / "scene.xml"
    scene.write_text(
        "<scene version='3.0.0'><bsdf type='diffuse' id='wall'/>"
        "<shape type='sphere'><ref id='wall'/></shape></scene>"
    )
    page = tmp_path / "page.html"
    code, report = run(capsys, f"{scene}#wall", "--html", str(page))
    assert code == 0 and report["subjects"][0]["name"] == f"{scene}#wall (llvm_ad_rgb)"
    assert page.read_text(encoding="utf-8").startswith("<!doctype html>")
    with pytest.raises(SystemExit) as exit:
        check.main([f"{scene}#floor"])
    assert exit.value.code == 2 and "there are wall" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("target", "complaint"),
    [
        ("no_such_plugin", "no_such_plugin"),
        ('{"type": "sphere"}', "expected a BSDF"),
        ("missing.xml", "missing.xml"),
        ("{broken", "broken"),
    ],
)
def test_bad_usage_has_its_own_exit_code(capsys, target, complaint):
    with pytest.raises(SystemExit) as exit:
        check.main([target, "--variant", "scalar_rgb"])
    assert exit.value.code == 2 and complaint in capsys.readouterr().err


def test_a_page_replaces_neither_what_is_read_nor_what_is_no_page(capsys, tmp_path):
    scene = tmp_path / "scene.xml"
    scene.write_text("<bsdf version='3.0.0' type='diffuse'/>")
    link = tmp_path / "link.html"
    link.symlink_to(scene)
    stranger = tmp_path / "stranger.html"
    stranger.write_text("<!doctype html><title>somebody's</title>")
    before = sorted(tmp_path.iterdir())
    for page, complaint in [
        (scene, "must not be overwritten"),
        (link, "must not be overwritten"),
        (stranger, "--force"),
        (tmp_path / "none/page.html", "cannot write"),
        (tmp_path, "cannot write"),
    ]:
        with pytest.raises(SystemExit) as exit:
            check.main([str(scene), "--variant", "scalar_rgb", "--html", str(page)])
        assert exit.value.code == 2 and complaint in capsys.readouterr().err
    assert scene.read_text().startswith("<bsdf") and stranger.read_text().endswith("</title>")
    code, _ = run(capsys, str(scene), "--html", str(stranger), "--force", variant="scalar_rgb")
    assert code == 0 and stranger.read_text(encoding="utf-8").startswith("<!doctype html><html")
    assert sorted(tmp_path.iterdir()) == before
