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
    """f (n, 3) in batches and one by one, and pdf (n)."""

    f: np.ndarray
    one: np.ndarray
    pdf: np.ndarray


@dataclass
class Catalogue:
    """Pairs of directions with their families, and the answers of every library."""

    light: np.ndarray
    view: np.ndarray
    families: np.ndarray
    libraries: dict[Path, Answers]


def export(target_dir, directory):
    """Writes the catalogue to a directory and reads it."""
    if shutil.which("cargo") is None:
        pytest.skip("cargo is not installed")
    run = ["cargo", "run", "--quiet", "--release", "--package", "glimt-check"]
    run += ["--example", "export_catalogue", "--target-dir", target_dir, "--", directory]
    subprocess.run(run, cwd=ROOT, check=True)
    pairs = np.fromfile(directory / "pairs.raw", np.float32).reshape(-1, 6)
    libraries = {
        path: Answers(
            np.fromfile(path.with_suffix(".f.raw"), np.float32).reshape(-1, 3),
            np.fromfile(path.with_suffix(".one.raw"), np.float32).reshape(-1, 3),
            np.fromfile(path.with_suffix(".pdf.raw"), np.float32),
        )
        for path in sorted(directory.glob("*.safetensors"))
    }
    families = np.array((directory / "families.txt").read_text().splitlines())
    return Catalogue(pairs[:, :3].copy(), pairs[:, 3:].copy(), families, libraries)
