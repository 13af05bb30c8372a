"""The library file as anybody's safetensors sees it, and as glimt reads it once that has saved it again."""

import json
from pathlib import Path

import numpy as np
import pytest
from model_libraries import LIBRARIES, hemisphere, write_libraries
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

glimt = pytest.importorskip("glimt", reason="the package is not installed: pip install .")

# One that glimt has fitted and written; the others are written by the tests.
SHIPPED = "shipped"


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    shipped = Path(__file__).parent.parent / "scenes/models/rgl.safetensors"
    return {**write_libraries(tmp_path_factory.mktemp("libraries")), SHIPPED: shipped}


def metadata(path):
    with safe_open(path, "numpy") as file:
        return file.metadata()


def materials(library):
    return [library[name] for name in library]


@pytest.mark.parametrize("name", [SHIPPED, *LIBRARIES])
def test_tensors_and_names_are_those_that_glimt_reads(libraries, name):
    path = libraries[name]
    library, tensors = glimt.load(path), load_file(path)
    header = json.loads(metadata(path)["glimt"])
    assert header["kind"] == library.kind
    assert [material["name"] for material in header["materials"]] == library.materials
    assert all(np.all(np.isfinite(tensor)) for tensor in tensors.values() if tensor.dtype.kind == "f")
    for key in ("kd", "eta", "alpha", "latent"):
        for row, material in zip(tensors.get(key, ()), materials(library)):
            expected = np.broadcast_to(row, (2,)) if key == "alpha" else row
            np.testing.assert_array_equal(np.float32(getattr(material, key)), expected, strict=True)
    if library.kind in ("ggx", "hybrid"):
        assert len(tensors["kd"]) == len(library)


@pytest.mark.parametrize("name", [SHIPPED, *LIBRARIES])
def test_what_safetensors_has_saved_again_is_the_same_library(libraries, tmp_path, name):
    path, again = libraries[name], tmp_path / "again.safetensors"
    save_file(load_file(path), again, metadata(path))
    ours, theirs = glimt.load(path), glimt.load(again)
    assert theirs.materials == ours.materials
    light, view = (np.ascontiguousarray(hemisphere(500, seed).T) for seed in (1, 2))
    for material, other in zip(materials(ours), materials(theirs)):
        np.testing.assert_array_equal(other.eval(light, view), material.eval(light, view))


def test_a_file_without_the_metadata_is_refused(libraries, tmp_path):
    bare = tmp_path / "bare.safetensors"
    save_file(load_file(libraries["ggx"]), bare)
    with pytest.raises(glimt.Error, match='its metadata has no entry "glimt"'):
        glimt.load(bare)
