"""``glimt report``: its files, its cache, and its page in a browser."""

import csv
import html
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SMALL = ("--pairs", "4000", "--size", "24", "--spp", "16", "--rounds", "1")

#: Renders small frames, whatever it is asked for.
QUICK_PYTHON = """#!{python}
import sys
from glimt import frames
spp = {{"scalar_rgb": [1, 4]}}
frames.DEFAULTS.update(size=16, converged=256, rounds=1, variants=["scalar_rgb"], spp=spp)
sys.argv = ["frames", "-"]
sys.exit(frames.main())
"""

#: Sets in the title of a page how the report in its frame fits.
PROBE = """<!doctype html><meta charset=utf-8><link rel=icon href='data:,'>
<iframe width=390 height=844 style='border: 0' srcdoc="{page}"></iframe>
<script>
  onload = () => {{
    const page = document.querySelector("iframe").contentDocument;
    for (const details of page.querySelectorAll("details")) details.open = true;
    const images = [...page.images];
    const broken = images.filter((image) => !image.complete || image.naturalWidth === 0).length;
    const result = [page.documentElement.scrollWidth, images.length, broken];
    document.querySelector("iframe").remove();
    document.title = "fits " + result.join(" ");
  }};
</script>"""


def glimt(command_line, *arguments):
    return subprocess.run([command_line, *arguments], capture_output=True, text=True)


@pytest.fixture(scope="module")
def samples(command_line, tmp_path_factory):
    """A measurement in RGL's format, written from a shipped material, and a model fitted to it."""
    directory = tmp_path_factory.mktemp("materials")
    source = directory / "source.safetensors"
    shipped = Path(__file__).parent.parent / "scenes" / "models" / "rgl.safetensors"
    measurement = directory / "paint.bsdf"
    done = glimt(command_line, "convert", shipped, measurement, "--material", "chm_orange")
    assert done.returncode == 0, done.stderr
    done = glimt(command_line, "fit", "--model", "ggx", measurement, "-o", source)
    assert done.returncode == 0, done.stderr
    return measurement, source


@pytest.fixture(scope="module")
def report(command_line, samples, tmp_path_factory):
    directory = tmp_path_factory.mktemp("report")
    models = ("--models", "hybrid", "--sizes", "16x2", "--steps", "20")
    done = glimt(command_line, "report", *samples, *models, *SMALL, "-o", directory)
    assert done.returncode == 0, done.stderr
    return directory, (*samples, *models)


def test_tables_hold_every_model(report):
    directory, _ = report
    rows = list(csv.DictReader((directory / "report.csv").open()))
    assert {row["model"] for row in rows} == {"source", "hybrid-16x2"}
    for row in rows:
        assert 0 < float(row["smape"]) < 2
        assert float(row["batch_ns"]) > 0 and float(row["studio_flip"]) > 0
    study = json.loads((directory / "report.json").read_text())
    assert study["made"]["command"].startswith("glimt report") and study["settings"]["pairs"] == 4000
    assert {candidate["fit_seconds"] is None for candidate in study["candidates"]} == {True, False}


def test_a_second_run_measures_nothing_again(command_line, report):
    directory, arguments = report
    kept = {path: path.stat().st_mtime_ns for path in (directory / "cache").iterdir()}
    assert len(kept) == 3
    done = glimt(command_line, "report", *arguments, *SMALL, "-o", directory)
    assert done.returncode == 0, done.stderr
    assert {path: path.stat().st_mtime_ns for path in (directory / "cache").iterdir()} == kept


def test_whole_frames_of_every_model_and_sampler(command_line, samples, tmp_path):
    """A Python that renders little stands in for the one that renders for minutes."""
    pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
    pytest.importorskip("glimt.frames", reason="the package is not installed: pip install .")
    python = tmp_path / "python"
    python.write_text(QUICK_PYTHON.format(python=sys.executable))
    python.chmod(0o755)
    command = [command_line, "report", *samples, *SMALL, "--frames", "paint", "-o", tmp_path / "report"]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "GLIMT_PYTHON": python})
    assert done.returncode == 0, done.stderr
    study = json.loads((tmp_path / "report" / "report.json").read_text())
    assert set(study["frames"]["scenes"]) == {"sphere", "room"}
    for variants in study["frames"]["scenes"].values():
        curves = variants["scalar_rgb"]
        models = {f"{name}{sampler}" for name in ("measurement", "source") for sampler in ("", ", table")}
        assert set(curves) == {*models, "Mitsuba's measured", "Mitsuba's principled"}
        # The same reflectance by another sampler is another noise about the same image.
        mine, theirs = (curves[name][-1] for name in ("measurement, table", "Mitsuba's measured"))
        assert max(mine["rmse"] / mine["noise"], theirs["rmse"] / theirs["noise"]) < 1.3
    page = (tmp_path / "report" / "index.html").read_text()
    assert "At equal time" in page and "room, scalar_rgb" in page


def test_without_a_model_it_says_what_to_do(command_line, samples, tmp_path):
    done = glimt(command_line, "report", samples[0], "-o", tmp_path)
    assert done.returncode == 2 and "--models" in done.stderr


def test_the_page_opens_offline_and_fits_a_phone(report, tmp_path):
    if BROWSER is None:
        pytest.skip("no Chromium: apt-get install chromium")
    page = (report[0] / "index.html").read_text()
    assert len(page) < 15e6
    probe = tmp_path / "probe.html"
    probe.write_text(PROBE.format(page=html.escape(page)))
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr")
    profile = f"--user-data-dir={tmp_path / 'profile'}"
    command = [BROWSER, *options, profile, "--virtual-time-budget=10000", "--dump-dom", probe.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    complaints = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert not complaints
    title = done.stdout.split("<title>")[1].split("</title>")[0]
    width, images, broken = map(int, title.removeprefix("fits ").split())
    assert width <= 390
    assert images == 2 * (1 + 2 * 3) and broken == 0
