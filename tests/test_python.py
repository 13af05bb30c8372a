"""The Python module: shapes, errors, and that it answers what the conventions promise."""

import multiprocessing
import threading

import numpy as np
import pytest
from model_libraries import LIBRARIES, hemisphere, write_libraries

glimt = pytest.importorskip("glimt", reason="the package is not installed: pip install .")


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    return write_libraries(tmp_path_factory.mktemp("libraries"))


@pytest.fixture
def orange(libraries):
    return glimt.load(libraries["hybrid"])["orange"]


def directions(n, seed):
    return np.ascontiguousarray(hemisphere(n, seed).T)


def test_library_is_a_collection_of_names(libraries):
    library = glimt.load(libraries["hybrid"])
    assert library.kind == "hybrid"
    assert library.materials == list(library) == ["orange", "metal", "rough"]
    assert len(library) == 3 and "metal" in library and "gold" not in library
    assert str(library.path) == str(libraries["hybrid"])
    material = library["metal"]
    assert (material.name, material.kind) == ("metal", "hybrid")


@pytest.mark.parametrize("name", LIBRARIES)
def test_weight_is_f_cos_over_pdf(libraries, name):
    library = glimt.load(libraries[name])
    material = library[library.materials[0]]
    view, u = directions(5000, 1), np.random.default_rng(2).random((5000, 3), np.float32)
    light, pdf, weight = material.sample(view, u)
    assert light.shape == weight.shape == (5000, 3) and pdf.shape == (5000,)
    carried = pdf > 0
    assert carried.mean() > 0.5
    assert np.all(weight[~carried] == 0)
    f = material.eval(light, view)
    assert np.all(np.isfinite(f)) and np.all(f >= 0)
    np.testing.assert_array_equal(material.pdf(light, view)[carried], pdf[carried])
    scale = (light[:, 2] / np.where(carried, pdf, 1))[:, None]
    # One pair and a batch add in different orders; additive models subtract numbers of order 1.
    tolerance = 1e-5 * f * scale + 2e-6 * scale
    assert np.all(np.abs(weight - f * scale)[carried] <= tolerance[carried])


def test_one_pair_and_one_direction_with_many(orange):
    light, view = directions(7, 1), directions(7, 2)
    f = orange.eval(light, view)
    assert f.dtype == np.float32
    assert orange.eval(light[0], view[0]).shape == (3,)
    np.testing.assert_array_equal(orange.eval(light[0], view[0]), f[0])
    np.testing.assert_array_equal(
        orange.eval(light, view[0]), orange.eval(light, np.repeat(view[:1], 7, axis=0))
    )
    assert isinstance(orange.pdf(light[0], view[0]), float)
    direction, pdf, weight = orange.sample(view[0], [0.1, 0.2, 0.3])
    assert direction.shape == weight.shape == (3,) and isinstance(pdf, float)
    assert orange.eval(light[:0], view[:0]).shape == (0, 3)


def test_any_layout_and_type_of_number(orange):
    light, view = directions(50, 1), directions(50, 2)
    f = orange.eval(light, view)
    np.testing.assert_array_equal(orange.eval(light.astype(np.float64), view.tolist()), f)
    np.testing.assert_array_equal(orange.eval(np.asfortranarray(light), view), f)
    both = np.hstack([light, view])
    np.testing.assert_array_equal(orange.eval(both[:, :3], both[:, 3:]), f)


def test_below_the_horizon_and_nan_give_zero(orange):
    light = np.array([[0.6, 0, -0.8], [np.nan, 0, 1], [0, 0, 1]], np.float32)
    view = [0.6, 0, 0.8]
    f, pdf = orange.eval(light, view), orange.pdf(light, view)
    assert np.all(f[:2] == 0) and np.all(f[2] > 0)
    assert np.all(pdf[:2] == 0) and pdf[2] > 0


def test_threads_and_large_batches_give_the_same(orange):
    light, view = directions(50_000, 1), directions(50_000, 2)
    f = orange.eval(light, view)
    pieces = [orange.eval(light[i : i + 1000], view[i : i + 1000]) for i in range(0, 50_000, 1000)]
    np.testing.assert_array_equal(np.concatenate(pieces), f)
    results = [None] * 4

    def evaluate(i):
        results[i] = orange.eval(light, view)

    threads = [threading.Thread(target=evaluate, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for result in results:
        np.testing.assert_array_equal(result, f)


def evaluate_in_child(path, light, view, answers):
    answers.put(glimt.load(path)["orange"].eval(light, view))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork here")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_child_of_a_fork_does_not_wait_for_the_parents_threads(libraries, orange):
    light, view = directions(20_000, 1), directions(20_000, 2)
    f = orange.eval(light, view)
    context = multiprocessing.get_context("fork")
    answers = context.Queue()
    child = context.Process(target=evaluate_in_child, args=(libraries["hybrid"], light, view, answers))
    child.start()
    np.testing.assert_array_equal(answers.get(timeout=60), f)
    child.join()


def test_parameters_and_edits(orange):
    assert orange.kd == pytest.approx((0.55, 0.21, 0.04))
    assert orange.eta == (1.5, 1.5, 1.5)
    assert orange.alpha == (0.25, 0.25)
    assert orange.latent.shape == (4,) and orange.latent.dtype == np.float32
    edited = orange.edit(kd=(0.1, 0.2, 0.3), alpha=0.5)
    assert edited.kd == pytest.approx((0.1, 0.2, 0.3))
    assert edited.eta == orange.eta and edited.alpha == (0.5, 0.5)
    np.testing.assert_array_equal(edited.latent, orange.latent)
    assert orange.alpha == (0.25, 0.25)
    pair = [-0.6, 0, 0.8], [0.6, 0, 0.8]
    assert np.all(edited.eval(*pair) != orange.eval(*pair))
    assert edited.pdf(*pair) != orange.pdf(*pair)


def test_mixes_lie_between_two_materials(libraries):
    library = glimt.load(libraries["hybrid_isotropic"])
    orange, metal = library["orange"], library["metal"]
    pair = [-0.6, 0, 0.8], [0.6, 0, 0.8]
    np.testing.assert_array_equal(library.mix("orange", "metal", 0).eval(*pair), orange.eval(*pair))
    np.testing.assert_array_equal(library.mix("orange", "metal", 1).eval(*pair), metal.eval(*pair))
    mix = library.mix("orange", "metal", 0.5)
    assert mix.kd == pytest.approx((np.array(orange.kd) + np.array(metal.kd)) / 2)
    assert mix.latent == pytest.approx((orange.latent + metal.latent) / 2, abs=1e-6)
    assert np.all(np.isfinite(mix.eval(*pair)))
    assert "orange" in mix.name and "metal" in mix.name
    with pytest.raises(glimt.Error, match="weight of 2"):
        library.mix("orange", "metal", 2)
    with pytest.raises(glimt.Error, match="nbrdf"):
        glimt.load(libraries["nbrdf"]).mix("orange", "metal", 0.5)


def test_models_without_an_analytic_part(libraries):
    for kind in ("nbrdf", "factor", "analytic_ward", "maps"):
        material = glimt.load(libraries[kind])["orange"]
        assert material.kd is material.eta is material.alpha is None
        assert material.latent.shape == (0,)
        with pytest.raises(glimt.Error, match=f"{material.kind} materials have no kd, eta or alpha"):
            material.edit(kd=0.5)


def test_the_libraries_of_the_tests_are_of_every_model(libraries, tmp_path):
    unknown = tmp_path / "unknown.safetensors"
    content = libraries["ggx"].read_bytes()
    assert content.count(rb"\"kind\": \"ggx\"") == 1
    unknown.write_bytes(content.replace(rb"\"kind\": \"ggx\"", rb"\"kind\": \"xyz\""))
    with pytest.raises(glimt.Error, match='its model is "xyz", expected ') as refused:
        glimt.load(unknown)
    models = str(refused.value).split("expected ")[1].replace(" or ", ", ").split(", ")
    assert {spec["kind"] for spec in LIBRARIES.values()} == set(models)


def test_errors_name_the_file_and_what_is_near(libraries, tmp_path):
    with pytest.raises(glimt.Error, match=r"none\.safetensors"):
        glimt.load(tmp_path / "none.safetensors")
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(libraries["hybrid"].read_bytes()[:-10])
    with pytest.raises(glimt.Error, match=r"broken\.safetensors is not a valid glimt model library"):
        glimt.load(broken)
    library = glimt.load(libraries["hybrid"])
    with pytest.raises(glimt.Error, match="did you mean orange"):
        library["ornage"]
    with pytest.raises(glimt.Error, match="holds 3 materials"):
        library.material()
    with pytest.raises(glimt.Error, match=r"eta is 0\.5, expected a value in \[1, 10\]"):
        library["orange"].edit(eta=0.5)


def test_wrong_shapes_are_named(orange):
    good = directions(4, 1)
    with pytest.raises(ValueError, match=r"light has the shape \(4, 2\), expected \(3,\) or \(n, 3\)"):
        orange.eval(good[:, :2], good)
    with pytest.raises(ValueError, match="view has 3; expected as many"):
        orange.eval(good, good[:3])
    with pytest.raises(ValueError, match="u has the shape"):
        orange.sample(good, 0.5)
    with pytest.raises((ValueError, TypeError)):
        orange.eval("up", good)
