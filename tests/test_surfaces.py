"""Materials at a place of a surface, in Python."""

import pickle

import numpy as np
import pytest
from model_libraries import (
    LIBRARIES,
    SEED,
    SURFACES,
    hemisphere,
    maps_tensors,
    save_safetensors,
    write_library,
)

glimt = pytest.importorskip("glimt", reason="the package is not installed: pip install .")

N = 500
LIGHT, VIEW = (np.ascontiguousarray(hemisphere(N, seed).T) for seed in (1, 2))
U = np.random.default_rng(3).random((N, 3), np.float32)
UV = np.random.default_rng(4).uniform(-1, 2, (N, 2)).astype(np.float32)
SIGMA = np.random.default_rng(5).uniform(0, 0.3, N).astype(np.float32)
PAIR = [-0.6, 0, 0.8], [0.6, 0, 0.8]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_library(tmp_path_factory.mktemp("maps") / "maps.safetensors", **LIBRARIES["maps"])


@pytest.fixture(scope="module")
def metal(path):
    return glimt.load(path)["metal"]


def answers(material, uv=UV, footprint=None):
    """f, pdf and samples at places, to the bit."""
    at = {"uv": uv, "footprint": footprint}
    said = material.eval(LIGHT, VIEW, **at), material.pdf(LIGHT, VIEW, **at), *material.sample(VIEW, U, **at)
    return [part.tobytes() for part in said]


def round_axes(sigma):
    return sigma[:, None, None] * np.eye(2, dtype=np.float32)


@pytest.mark.parametrize("name", LIBRARIES)
def test_surfaces_are_told_and_others_ignore_the_place(name, tmp_path):
    library = glimt.load(write_library(tmp_path / "library.safetensors", **LIBRARIES[name]))
    material = library[library.materials[1]]
    assert material.is_surface == (name in SURFACES)
    assert (answers(material) == answers(material, uv=None)) == (name not in SURFACES)
    # The result has a row for every place, whatever the material.
    assert material.eval(*PAIR, uv=UV).shape == (N, 3)
    assert material.pdf(*PAIR, uv=UV[:1]).shape == (1,)
    with pytest.raises(ValueError, match="uv has the shape"):
        material.eval(*PAIR, uv=0.5)


def test_without_a_place_it_is_the_far_field(metal):
    far = metal.eval(LIGHT, VIEW, uv=UV, footprint=np.inf)
    np.testing.assert_array_equal(metal.eval(LIGHT, VIEW), far)
    assert not np.array_equal(metal.eval(LIGHT, VIEW, uv=UV), far)
    # It is of the same colour as the mean over the tile.
    grid = (np.stack(np.meshgrid(np.arange(56), np.arange(40)), axis=-1).reshape(-1, 2) + 0.5) / [56, 40]
    mean = metal.eval([0, 0, 1], [0, 0, 1], uv=grid).mean(axis=0)
    assert metal.eval([0, 0, 1], [0, 0, 1]) == pytest.approx(mean, rel=0.15)


def test_a_texel_is_the_ggx_of_its_numbers_in_the_frame_of_its_normal(metal, tmp_path):
    maps = maps_tensors(np.random.default_rng(SEED))["maps"][1]
    height, width, _ = maps.shape
    for row, column in [(0, 0), (0, width - 1), (height - 1, 2)]:
        texel = maps[row, column]
        root = np.sqrt(texel[3:6])
        parameters = {"kd": texel[:3], "eta": (1 + root) / (1 - root), "alpha": texel[6:7]}
        ggx = tmp_path / "ggx.safetensors"
        header = (
            '{"format": 1, "kind": "ggx", "color_space": "linear sRGB",'
            ' "materials": [{"name": "texel", "source": "", "sha256": "", "command": ""}]}'
        )
        save_safetensors(ggx, {name: p[None] for name, p in parameters.items()}, {"glimt": header})
        normal = np.array([-texel[7], -texel[8], 1])
        normal /= np.linalg.norm(normal)
        tangent = np.cross([0, 1, 0], normal)
        tangent /= np.linalg.norm(tangent)
        frame = np.stack([tangent, np.cross(normal, tangent), normal])
        light, view = LIGHT @ frame.T, VIEW @ frame.T
        expected = glimt.load(ggx)["texel"].eval(light, view) * (light[:, 2:] / LIGHT[:, 2:])
        # The first row of a map is at the bottom.
        uv = [(column + 0.5) / width, (row + 0.5) / height]
        f = metal.eval(LIGHT, VIEW, uv=uv)
        assert np.all(np.abs(f - expected) <= 1e-4 * expected + 1e-6)
        np.testing.assert_allclose(metal.eval(LIGHT, VIEW, uv=np.add(uv, [3, -2])), f, rtol=1e-3, atol=1e-6)


def test_shapes_of_places_and_footprints(metal):
    every = answers(metal, UV, SIGMA)
    assert answers(metal, UV.tolist(), SIGMA.astype(np.float64)) == every
    assert answers(metal, UV, round_axes(SIGMA)) == every
    assert answers(metal) == answers(metal, UV, 0) == answers(metal, UV, np.zeros((2, 2)))
    assert answers(metal) != every
    # One footprint with many places, one place with many footprints, and one pair with both.
    assert answers(metal, UV, 0.1) == answers(metal, UV, np.full(N, 0.1)) == answers(metal, UV, [0.1])
    assert answers(metal, UV, [[0.1, 0], [0, 0.02]]) == answers(metal, UV, [[[0.1, 0], [0, 0.02]]] * N)
    assert answers(metal, UV[0], SIGMA) == answers(metal, np.tile(UV[:1], (N, 1)), SIGMA)
    f = metal.eval(LIGHT[0], VIEW[0], UV, SIGMA)
    np.testing.assert_array_equal(f, metal.eval(LIGHT[:1], [VIEW[0]] * N, UV, SIGMA))
    assert metal.eval(*PAIR, uv=[0.1, 0.2], footprint=[0.1, 0.2]).shape == (2, 3)
    assert metal.eval(*PAIR, uv=[0.1, 0.2], footprint=[[0.1, 0], [0, 0.2]]).shape == (3,)
    assert isinstance(metal.pdf(*PAIR, uv=[0.1, 0.2], footprint=0.1), float)
    light, pdf, weight = metal.sample(PAIR[1], [0.1, 0.2, 0.3], uv=[0.1, 0.2])
    assert light.shape == weight.shape == (3,) and isinstance(pdf, float)
    assert metal.eval(LIGHT[:0], VIEW[:0], UV[:0], SIGMA[:0]).shape == (0, 3)
    assert metal.eval(*PAIR, uv=UV[:0]).shape == (0, 3)


def test_axes_are_rows_in_any_order(metal):
    axis, none = [0.3, 0.1], [0, 0]
    assert answers(metal, UV, [axis, none]) == answers(metal, UV, [none, axis])
    assert answers(metal, UV, [axis, none]) != answers(metal, UV, [axis[::-1], none])


def test_a_batch_is_its_rows_one_by_one_in_pieces_and_in_threads(metal):
    f, pdf = metal.eval(LIGHT, VIEW, UV, SIGMA), metal.pdf(LIGHT, VIEW, UV, SIGMA)
    samples = metal.sample(VIEW, U, UV, SIGMA)
    for i in range(0, N, 17):
        at = {"uv": UV[i], "footprint": SIGMA[i]}
        np.testing.assert_array_equal(metal.eval(LIGHT[i], VIEW[i], **at), f[i])
        assert metal.pdf(LIGHT[i], VIEW[i], **at) == pdf[i]
        for one, many in zip(metal.sample(VIEW[i], U[i], **at), samples):
            np.testing.assert_array_equal(one, many[i])
    many = [np.tile(rows, (40, 1)) for rows in (LIGHT, VIEW, UV)]
    np.testing.assert_array_equal(metal.eval(*many, np.tile(SIGMA, 40)), np.tile(f, (40, 1)))
    np.testing.assert_array_equal(metal.pdf(*many, np.tile(SIGMA, 40)), np.tile(pdf, 40))


def test_weight_is_f_cos_over_pdf_at_every_place(metal):
    light, pdf, weight = metal.sample(VIEW, U, UV, SIGMA)
    carried = pdf > 0
    assert carried.mean() > 0.5 and np.all(weight[~carried] == 0) and np.all(light[carried, 2] > 0)
    np.testing.assert_array_equal(metal.pdf(light, VIEW, UV, SIGMA)[carried], pdf[carried])
    f_cos = metal.eval(light, VIEW, UV, SIGMA) * light[:, 2:]
    np.testing.assert_allclose((weight * pdf[:, None])[carried], f_cos[carried], rtol=1e-5, atol=1e-9)


def test_places_that_are_no_numbers_give_numbers(metal):
    wild = np.array([np.nan, np.inf, -np.inf, 1e38, -1e-45, 1e6, 0.5], np.float32)
    uv = np.stack(np.meshgrid(wild, wild), axis=-1).reshape(-1, 2)
    axes = np.stack([np.roll(uv, i, axis=0) for i in (1, 9)], axis=1)
    for footprint in (None, axes, axes[:, 0, 0]):
        f, pdf = metal.eval(*PAIR, uv, footprint), metal.pdf(*PAIR, uv, footprint)
        light, density, weight = metal.sample(PAIR[1], [0.1, 0.2, 0.3], uv, footprint)
        for numbers in (f, pdf, light, density, weight):
            assert np.all(np.isfinite(numbers))
        assert np.all(f > 0) and np.all(pdf > 0)


def test_materials_at_places_survive_pickling(path):
    library = glimt.load(path)
    for name in library:
        for arrived in (pickle.loads(pickle.dumps(library))[name], pickle.loads(pickle.dumps(library[name]))):
            assert arrived.is_surface
            assert answers(arrived, UV, SIGMA) == answers(library[name], UV, SIGMA)


@pytest.mark.parametrize(
    ("uv", "footprint", "words"),
    [
        (UV[:, :1], None, r"uv has the shape \(500, 1\), expected \(2,\) or \(n, 2\)"),
        (0.5, None, r"uv has the shape \(\), expected \(2,\) or \(n, 2\)"),
        (UV, UV, r"footprint has the shape \(500, 2\), expected a number, \(n,\), \(2, 2\) or \(n, 2, 2\)"),
        (UV, np.ones((3, 2, 3)), r"footprint has the shape \(3, 2, 3\)"),
        (UV[:7], None, "light has 500 rows and uv has 7; expected as many, or one"),
        (UV, SIGMA[:3], "light has 500 rows and footprint has 3; expected as many, or one"),
        (None, 0.1, "footprint is given without uv, expected both"),
    ],
)
def test_what_is_no_place_is_told_in_words(metal, uv, footprint, words):
    for ask in (metal.eval, metal.pdf):
        with pytest.raises(ValueError, match=words):
            ask(LIGHT, VIEW, uv=uv, footprint=footprint)
    with pytest.raises(ValueError, match=words.replace("light", "view")):
        metal.sample(VIEW, U, uv=uv, footprint=footprint)
