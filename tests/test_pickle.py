"""Libraries and materials travel: pickled, copied, to worker processes, and past a second import."""

import copy
import multiprocessing
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from model_libraries import LIBRARIES, hemisphere, write_libraries

glimt = pytest.importorskip("glimt", reason="the package is not installed: pip install .")

LIGHT, VIEW = (np.ascontiguousarray(hemisphere(200, seed).T) for seed in (1, 2))
U = np.random.default_rng(3).random((200, 3), np.float32)
PROTOCOLS = range(2, pickle.HIGHEST_PROTOCOL + 1)


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    return write_libraries(tmp_path_factory.mktemp("libraries"))


@pytest.fixture(scope="module")
def measurement(tmp_path_factory):
    """A file in MERL's format that reflects more at one end of its table."""
    path = tmp_path_factory.mktemp("measurement") / "grey.binary"
    size = (90, 90, 180)
    with path.open("wb") as file:
        np.array(size, "<i4").tofile(file)
        (100 * np.linspace(0.1, 0.3, 3 * np.prod(size))).astype("<f8").tofile(file)
    return path


def answers(material):
    """All that a material says, to the bit."""
    said = [material.eval(LIGHT, VIEW), material.pdf(LIGHT, VIEW), *material.sample(VIEW, U), material.latent]
    attributes = ["name", "kind", "kd", "eta", "alpha", "sampler", "sampler_bytes"]
    return [part.tobytes() for part in said], [getattr(material, name) for name in attributes]


def travelled(thing):
    yield from (pickle.loads(pickle.dumps(thing, protocol)) for protocol in PROTOCOLS)
    yield copy.copy(thing)
    yield copy.deepcopy({"a": [thing]})["a"][0]


@pytest.mark.parametrize("name", LIBRARIES)
def test_every_model_arrives_as_it_left(libraries, name):
    library = glimt.load(libraries[name])
    for arrived in travelled(library):
        assert (arrived.materials, arrived.kind) == (library.materials, library.kind)
        assert arrived.path == library.path
        assert answers(arrived[library.materials[-1]]) == answers(library[library.materials[-1]])
    material = library[library.materials[0]]
    expected = answers(material)
    for arrived in travelled(material):
        assert answers(arrived) == expected


@pytest.mark.parametrize("name", ["ggx", "brushed", "hybrid", "hybrid_isotropic", "hybrid_additive"])
def test_edits_arrive(libraries, name):
    library = glimt.load(libraries[name])
    original = library[library.materials[0]]
    edited = original.edit(kd=(0.1, 0.2, 0.3), alpha=(0.5, 0.5)).edit(eta=1.7)
    for material in (edited, edited.edit(alpha=original.alpha)):
        expected = answers(material)
        assert expected != answers(original)
        for arrived in travelled(material):
            assert answers(arrived) == expected
            # … and further edits start from the same.
            assert answers(arrived.edit(alpha=0.3)) == answers(material.edit(alpha=0.3))


@pytest.mark.parametrize("sampler", ["lobes", "table:4x8x8", "table:paper"])
def test_samplers_arrive(libraries, sampler):
    chosen = glimt.load(libraries["ggx"])["orange"].with_sampler(sampler)
    assert answers(pickle.loads(pickle.dumps(chosen))) == answers(chosen)
    library = pickle.loads(pickle.dumps(glimt.load(libraries["ggx"], sampler=sampler)))
    assert answers(library["orange"]) == answers(chosen)


def test_measurement_travels_by_its_file(measurement, monkeypatch, tmp_path):
    monkeypatch.chdir(measurement.parent)
    library = glimt.load(measurement.name)
    material = library.material()
    with_lobes = material.with_sampler("lobes")
    pickles = [pickle.dumps(thing) for thing in (library, material, with_lobes)]
    assert max(map(len, pickles)) < 1000
    # The reader may be in another directory.
    monkeypatch.chdir(tmp_path)
    arrived = [pickle.loads(pickled) for pickled in pickles]
    assert arrived[0].path == measurement and answers(arrived[0].material()) == answers(material)
    assert answers(arrived[1]) == answers(material)
    assert answers(arrived[2]) == answers(with_lobes) and arrived[2].sampler == "lobes"
    assert copy.deepcopy(material) is material


def test_measurement_that_changed_is_not_taken_for_the_old_one(measurement, tmp_path):
    path = tmp_path / measurement.name
    path.write_bytes(measurement.read_bytes())
    material = glimt.load(path).material()
    pickled, unasked = pickle.dumps(material), glimt.load(path)
    bytes_ = bytearray(path.read_bytes())
    bytes_[-1] ^= 1
    path.write_bytes(bytes_)
    os.utime(path, (1, 1))
    with pytest.raises(glimt.Error, match=r"grey\.binary is not the file that was pickled: its SHA-256 is"):
        pickle.loads(pickled)
    with pytest.raises(glimt.Error, match=r"grey\.binary has changed since it was loaded"):
        pickle.dumps(unasked)
    # What is in memory is still the old one, and its digest known.
    assert pickle.dumps(material) == pickled
    path.unlink()
    with pytest.raises(glimt.Error, match=r"grey\.binary"):
        pickle.loads(pickled)


def test_scattered_samples_travel_by_their_file(tmp_path):
    path = tmp_path / "samples.npy"
    np.save(path, np.hstack([LIGHT, VIEW, np.full_like(LIGHT, 0.1)]))
    library = glimt.load(path)
    arrived = pickle.loads(pickle.dumps(library))
    assert (arrived.kind, arrived.materials, arrived.path) == (library.kind, library.materials, library.path)


def test_errors_travel(libraries):
    with pytest.raises(glimt.Error) as raised:
        glimt.load(libraries["ggx"])["oragne"]
    arrived = pickle.loads(pickle.dumps(raised.value))
    assert type(arrived) is glimt.Error and str(arrived) == str(raised.value)


def large_batch(material):
    """More rows than one thread computes."""
    return material.eval(np.tile(LIGHT, (100, 1)), np.tile(VIEW, (100, 1))), material


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_workers_take_materials_and_send_them_back(libraries, measurement, method):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {method} here")
    orange = glimt.load(libraries["hybrid"])["orange"]
    materials = [orange, orange.edit(alpha=0.5), glimt.load(measurement).material()]
    # The parent has started its threads, which a fork does not have.
    expected = [large_batch(material)[0] for material in materials]
    with multiprocessing.get_context(method).Pool(2) as pool:
        results = pool.map_async(large_batch, materials).get(timeout=300)
    for material, f, (found, returned) in zip(materials, expected, results):
        np.testing.assert_array_equal(found, f)
        assert answers(returned) == answers(material)


# Programs that import glimt again, as a variant change, a notebook's autoreload or a test runner makes them.
IMPORT_AGAIN = {
    "reload": "importlib.reload(glimt)",
    "reload of all": "[importlib.reload(m) for n, m in sorted(sys.modules.items()) if n.startswith('glimt')]",
    "purge": "[sys.modules.pop(n) for n in list(sys.modules) if n.split('.')[0] == 'glimt']; import glimt",
}
PROGRAM = """\
import importlib, pickle, sys
import numpy as np
import glimt
material = glimt.load({library!r})["orange"]
pair = [-0.6, 0, 0.8], [0.6, 0, 0.8]
f = material.eval(*pair)
{again}
assert np.array_equal(material.eval(*pair), f)
assert isinstance(material, glimt.Material)
assert np.array_equal(pickle.loads(pickle.dumps(material)).eval(*pair), f)
assert np.array_equal(glimt.load({library!r})["orange"].eval(*pair), f)
try:
    glimt.load("none.safetensors")
except glimt.Error:
    print("done")
"""


@pytest.mark.parametrize("again", IMPORT_AGAIN)
def test_materials_survive_a_second_import(libraries, again):
    program = PROGRAM.format(library=str(libraries["hybrid"]), again=IMPORT_AGAIN[again])
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert result.stdout == "done\n", result.stderr


MITSUBA_PROGRAM = """\
import importlib, sys
import mitsuba as mi
import glimt
import numpy as np
def bsdf():
    return mi.load_dict({{"type": "glimt", "filename": {library!r}, "material": "orange"}})
def answer(bsdf):
    si = mi.SurfaceInteraction3f()
    si.wi = [0.6, 0, 0.8]
    return np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(-0.6, 0, 0.8))).ravel()
mi.set_variant({first!r})
old = bsdf()
params = mi.traverse(old)
before, text = answer(old), str(old)
{again}
mi.set_variant({second!r})
{again}
new = bsdf()
assert np.allclose(answer(new), before, rtol=1e-5)
mi.set_variant({first!r})
assert np.array_equal(answer(old), before) and str(old) == text
params["alpha"] = 0.4
params.update()
assert not np.allclose(answer(old), before)
assert sum(str(path) == glimt.__path__[0] for path in mi.file_resolver()) == 1
print("done")
"""


@pytest.mark.parametrize("again", IMPORT_AGAIN)
@pytest.mark.parametrize("variants", [("scalar_rgb", "llvm_ad_rgb"), ("llvm_ad_rgb", "scalar_rgb")])
def test_mitsuba_objects_survive_a_second_import_and_another_variant(libraries, again, variants):
    pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
    first, second = variants
    program = MITSUBA_PROGRAM.format(
        library=str(libraries["hybrid"]), again=IMPORT_AGAIN[again], first=first, second=second
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert result.stdout == "done\n", result.stderr
