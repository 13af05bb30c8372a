"""What tests of several languages build: the command line and the C interface, once for all."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="session")
def target_dir():
    """Where Cargo builds."""
    return ROOT / os.environ.get("CARGO_TARGET_DIR", "target")


@pytest.fixture(scope="session")
def command_line(target_dir):
    """The binary ``glimt``."""
    if shutil.which("cargo") is None:
        pytest.skip("cargo is not installed")
    # The packages that an installation builds, in one call as there: with the features of one alone, Cargo
    # would compile what all share anew.
    packages = [f"--package=glimt-{name}" for name in ("mitsuba", "py", "cli")]
    build = ["cargo", "build", "--release", "--locked", *packages, "--target-dir", target_dir]
    subprocess.run(build, cwd=ROOT, check=True, env={**os.environ, "PYO3_PYTHON": sys.executable})
    return target_dir / "release" / "glimt"


@pytest.fixture(scope="session")
def cpp_build(target_dir, tmp_path_factory):
    """A directory with the examples and test programs of ``cpp``, built with warnings as errors."""
    for tool in ("cmake", "cargo", "c++"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    build = tmp_path_factory.mktemp("cpp")
    options = ["-DGLIMT_TESTS=ON", "-DGLIMT_WERROR=ON", f"-DGLIMT_CARGO_TARGET_DIR={target_dir}"]
    subprocess.run(["cmake", "-S", ROOT / "cpp", "-B", build, *options], check=True)
    subprocess.run(["cmake", "--build", build], check=True)
    return build
