"""`pip install .` from a clean copy of the sources, and what it installs."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

# A tenth above what was measured; a symbol table is more.
LARGEST_COMMAND, LARGEST_MODULE = 12.1e6, 5.33e6


def sections(file):
    listing = subprocess.check_output(["readelf", "--sections", "--wide", str(file)], text=True)
    return [word for word in listing.split() if word.startswith(".")]


def test_command_is_stripped(command_line):
    assert not [name for name in sections(command_line) if name == ".symtab" or name.startswith(".debug")]
    assert command_line.stat().st_size < LARGEST_COMMAND


def test_python_modules_are_stripped():
    package = Path(
        pytest.importorskip("glimt", reason="the package is not installed: pip install .").__file__
    )
    for module in (package.parent / "_native.abi3.so", package.parent / "plugins" / "glimt.so"):
        assert not [name for name in sections(module) if name == ".symtab" or name.startswith(".debug")]
    assert (package.parent / "_native.abi3.so").stat().st_size < LARGEST_MODULE


@pytest.mark.long
@pytest.mark.parametrize("target_dir", ["absolute", "relative"])
def test_installation_does_not_depend_on_where_cargo_builds_otherwise(target_dir, tmp_path):
    files = subprocess.check_output(["git", "ls-files", "-z"], cwd=ROOT, text=True).split("\0")[:-1]
    source = tmp_path / "source"
    for file in files:
        (source / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, source / file)
    elsewhere = str(tmp_path / "elsewhere") if target_dir == "absolute" else "elsewhere"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-build-isolation", "--no-deps"]
    environment = {**os.environ, "CARGO_TARGET_DIR": elsewhere}
    subprocess.run([*pip, "--target", tmp_path / "site", source], check=True, env=environment)
    program = "import glimt; print(glimt.__file__, glimt.__version__)"
    environment["PYTHONPATH"] = str(tmp_path / "site")
    said = subprocess.check_output([sys.executable, "-c", program], env=environment, text=True)
    assert said.split() == [str(tmp_path / "site" / "glimt" / "__init__.py"), "0.1.0"]
