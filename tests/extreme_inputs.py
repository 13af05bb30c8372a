"""The catalogue of extreme inputs of ``rust/check``, with the answers of the core."""

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT


@dataclass
class Answers:
    """f (n, 3) in batches and one by one, and pdf (n), with the sampler to ask for.

    Every sampler but the own warp of a measurement reaches all directions that reflect.
    """

    sampler: str
    reaches_all: bool
    f: np.ndarray
    one: np.ndarray
    pdf: np.ndarray


@dataclass
class Catalogue:
    """Pairs of directions with their families, and the answers of every file."""

    light: np.ndarray
    view: np.ndarray
    families: np.ndarray
    files: dict[Path, Answers]


def export(target_dir, directory):
    """Writes the catalogue to a directory and reads it."""
    if shutil.which("cargo") is None:
        pytest.skip("cargo is not installed")
    run = ["cargo", "run", "--quiet", "--release", "--package", "glimt-check"]
    run += ["--example", "export_catalogue", "--target-dir", target_dir, "--", directory]
    subprocess.run(run, cwd=ROOT, check=True)
    pairs = np.fromfile(directory / "pairs.raw", np.float32).reshape(-1, 6)
    listed = (directory / "files.txt").read_text().splitlines()
    named = [line.split("\t") for line in listed]
    files = {
        (path := directory / name): Answers(
            sampler,
            bool(sampler) or not name.endswith(".bsdf"),
            np.fromfile(path.with_suffix(".f.raw"), np.float32).reshape(-1, 3),
            np.fromfile(path.with_suffix(".one.raw"), np.float32).reshape(-1, 3),
            np.fromfile(path.with_suffix(".pdf.raw"), np.float32),
        )
        for name, sampler in named
    }
    families = np.array((directory / "families.txt").read_text().splitlines())
    return Catalogue(pairs[:, :3].copy(), pairs[:, 3:].copy(), families, files)
