"""Which libLLVM Dr.Jit is pointed at."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
pytest.importorskip("glimt", reason="the package is not installed: pip install .")
from glimt import _mitsuba

OLD_LLVM = Path("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1")


@pytest.fixture
def environment(monkeypatch):
    """A system whose libraries the test chooses."""
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)

    def install(versions):
        monkeypatch.setattr(_mitsuba, "installed_llvm", lambda: versions)

    return install


def test_best_version_is_chosen(environment):
    environment({15: "/lib/15", 18: "/lib/18", 19: "/lib/19", 21: "/lib/21"})
    _mitsuba.point_drjit_to_llvm()
    assert os.environ["DRJIT_LIBLLVM_PATH"] == "/lib/19"


def test_variable_of_the_user_is_left_alone(environment, monkeypatch):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/mine")
    environment({19: "/lib/19"})
    _mitsuba.point_drjit_to_llvm()
    assert os.environ["DRJIT_LIBLLVM_PATH"] == "/mine"


def test_old_versions_alone_are_kept_from_aborting(environment):
    environment({14: "/lib/14", 15: "/lib/15"})
    with pytest.warns(RuntimeWarning, match=r"version 15.*apt-get install libllvm19"):
        _mitsuba.point_drjit_to_llvm()
    assert not Path(os.environ["DRJIT_LIBLLVM_PATH"]).exists()
    run = subprocess.run(
        [sys.executable, "-c", "import mitsuba; mitsuba.set_variant('llvm_ad_rgb')"],
        capture_output=True,
        text=True,
    )
    assert "could not be found" in run.stderr


def test_no_version_leaves_the_message_to_drjit(environment):
    environment({})
    _mitsuba.point_drjit_to_llvm()
    assert "DRJIT_LIBLLVM_PATH" not in os.environ


def test_found_libraries_exist():
    for version, path in _mitsuba.installed_llvm().items():
        assert version >= 3 and Path(path).exists()


@pytest.mark.skipif(not OLD_LLVM.exists(), reason="needs an LLVM that is too old")
def test_plugin_refuses_an_llvm_that_aborts(tmp_path):
    code = f"""
import glimt, mitsuba as mi
mi.set_variant("llvm_ad_rgb")
mi.load_dict(dict(type="glimt", filename={str(tmp_path / "any")!r}))
"""
    env = {**os.environ, "DRJIT_LIBLLVM_PATH": str(OLD_LLVM)}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert "Dr.Jit loaded LLVM 15" in run.stderr and "libllvm19" in run.stderr
