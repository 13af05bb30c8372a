"""Mutated files through every face: an error or an answer, and never the end of the host process.

Run as a program, ``python test_hostile_files.py FACE FILE …`` is such a host process: it opens every file
with one face and prints how many were accepted.
"""

import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

CORPUS = Path(__file__).parent.parent / "fuzz" / "corpus"
PAIRS = [[0.6, 0.0, 0.8], [0.0, 0.0, 1.0], [0.0, 0.6, -0.8], [0.0, 1.0, 1e-30]]


def check_answer(f):
    assert np.isfinite(f).all() and (f >= 0).all(), f


def open_in_python(path):
    import glimt

    light = np.array(PAIRS, np.float32)
    library = glimt.load(path)
    for name in library.materials:
        check_answer(library[name].eval(light, light[::-1].copy()))


def open_in_mitsuba(variant):
    import glimt  # noqa: F401 (lets Mitsuba find the plugin)
    import mitsuba as mi

    mi.set_variant(variant)
    import drjit as dr

    def open_file(path):
        bsdf = mi.load_dict({"type": "glimt", "filename": str(path)})
        for view in PAIRS:
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wi = mi.Vector3f(view)
            f = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(PAIRS[0]))
            check_answer(np.array(f))

    return open_file


def host(face, paths):
    """Opens every file; exceptions are answers, anything else is not."""
    open_file = open_in_python if face == "python" else open_in_mitsuba(face)
    accepted = 0
    for path in paths:
        try:
            open_file(Path(path))
            accepted += 1
        except AssertionError:
            raise
        except Exception as error:
            assert str(error), "an error without a message"
            assert "panic" not in str(error).lower(), error
    print(accepted)


def mutations(seeds, count, folder):
    """``count`` mutated copies of each file: cut, lengthened, overwritten, bits flipped; and the file."""
    rng = random.Random(1)
    for path in seeds:
        data = path.read_bytes()
        yield path
        for i in range(count):
            mutated = bytearray(data)
            kind = i % 4
            if kind == 0:
                del mutated[rng.randrange(len(data)) :]
            elif kind == 1:
                at = rng.randrange(len(data))
                mutated[at:at] = rng.randbytes(rng.randrange(1, 64))
            else:
                for _ in range(rng.randrange(1, 8)):
                    at = rng.randrange(len(data))
                    mutated[at] = rng.randrange(256) if kind == 2 else data[at] ^ 1 << rng.randrange(8)
            copy = folder / f"{path.stem}-{i}{path.suffix}"
            copy.write_bytes(mutated)
            yield copy


def run_host(face, paths):
    """Runs a host process, which must live to its end; how many files it accepted."""
    command = [sys.executable, __file__, face, *(str(path) for path in paths)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=1200)
    assert result.returncode == 0, f"{face}: exit {result.returncode}\n{result.stderr[-3000:]}"
    return int(result.stdout.split()[-1])


def seeds(*readers):
    return [path for reader in readers for path in sorted((CORPUS / reader).iterdir())]


def check_python(count, folder):
    pytest.importorskip("glimt", reason="the package is not installed: pip install .")
    paths = list(mutations(seeds("library", "rgl", "nbrdf", "samples", "merl", "npy"), count, folder))
    assert run_host("python", paths) > 0


def check_mitsuba(variant, count, folder):
    mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
    if variant not in mi.variants():
        pytest.skip(f"{variant} is not built")
    paths = list(mutations(seeds("library"), count, folder))
    assert run_host(variant, paths) > 0


def check_c(count, folder, cpp_build):
    accepted = 0
    for path in mutations(seeds("library"), count, folder):
        result = subprocess.run([cpp_build / "evaluate", path, "a"], capture_output=True, text=True)
        assert result.returncode in (0, 1), f"{path.name}: exit {result.returncode}\n{result.stderr}"
        if result.returncode == 1:
            assert result.stderr.strip(), f"{path.name}: an error without a message"
        accepted += result.returncode == 0
    assert accepted > 0


def test_python_survives(tmp_path):
    check_python(20, tmp_path)


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_mitsuba_survives(variant, tmp_path):
    check_mitsuba(variant, 8, tmp_path)


def test_c_survives(tmp_path, cpp_build):
    check_c(20, tmp_path, cpp_build)


@pytest.mark.long
def test_every_face_survives_for_long(tmp_path, cpp_build):
    check_python(2000, tmp_path)
    check_c(1000, tmp_path, cpp_build)
    for variant in ("scalar_rgb", "llvm_ad_rgb"):
        check_mitsuba(variant, 300, tmp_path)


if __name__ == "__main__":
    host(sys.argv[1], sys.argv[2:])
