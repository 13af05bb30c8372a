"""Rust, C, C++ and Python give the same bits."""

import subprocess

import numpy as np
import pytest
from model_libraries import LIBRARIES, write_libraries

N = 10_000


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    return write_libraries(tmp_path_factory.mktemp("libraries"))


@pytest.fixture(scope="module")
def questions(tmp_path_factory):
    """Files with pairs (light, view), some of them below the horizon, random numbers, and places."""
    directory, rng = tmp_path_factory.mktemp("questions"), np.random.default_rng(5)
    pairs = rng.normal(size=(N, 2, 3))
    pairs[..., 2] = np.abs(pairs[..., 2]) * np.where(rng.random((N, 2)) < 0.05, -1, 1)
    pairs = (pairs / np.linalg.norm(pairs, axis=2, keepdims=True)).reshape(N, 6).astype(np.float32)
    u = rng.random((N, 3), np.float32)
    np.save(directory / "pairs.npy", pairs)
    pairs.tofile(directory / "pairs.raw")
    u.tofile(directory / "u.raw")
    # u, v and two axes, from points to several tiles.
    axes = rng.normal(size=(N, 4)) * 10 ** rng.uniform(-4, 0.5, (N, 1)) * (rng.random((N, 1)) < 0.9)
    places = np.hstack([rng.uniform(-2, 3, (N, 2)), axes]).astype(np.float32)
    places.tofile(directory / "places.raw")
    return directory, pairs, u, places


def answers_in_cpp(cpp_build, library, material, directory):
    """f, pdf and samples (light, pdf, weight), each one by one and as a batch.

    Then, at places, f one by one and as a batch, pdf and samples.
    """
    questions = [directory / f"{name}.raw" for name in ("pairs", "u", "places")]
    answers = directory / "answers.raw"
    subprocess.run([cpp_build / "answers", library, material, *questions, answers], check=True)
    raw = np.fromfile(answers, np.float32)
    widths = [3, 3, 1, 1, 7, 7, 3, 3, 1, 7]
    assert raw.size == N * sum(widths)
    parts = np.split(raw, np.cumsum([N * width for width in widths])[:-1])
    return [part.reshape(N, width) for part, width in zip(parts, widths)]


def same_bits(a, b):
    np.testing.assert_array_equal(
        np.ascontiguousarray(a, np.float32).view(np.uint32).ravel(),
        np.ascontiguousarray(b, np.float32).view(np.uint32).ravel(),
    )


@pytest.mark.parametrize("name", LIBRARIES)
def test_same_bits_in_every_language(name, libraries, questions, cpp_build, command_line):
    glimt = pytest.importorskip("glimt", reason="the package is not installed: pip install .")
    directory, pairs, u, places = questions
    library = glimt.load(libraries[name])
    material = library[library.materials[1]]

    light, view = pairs[:, :3], pairs[:, 3:]
    f, pdf = material.eval(light, view), material.pdf(light, view)
    samples = np.hstack([part.reshape(N, -1) for part in material.sample(view, u)])
    assert (f > 0).any() and (f == 0).any() and (pdf > 0).any()

    answers = answers_in_cpp(cpp_build, libraries[name], material.name, directory)
    one_by_one, *others = answers[:6]
    for ours, theirs in zip(others, [f, pdf, pdf, samples, samples]):
        same_bits(ours, theirs)
    # One pair and a batch add in different orders; additive models subtract numbers of order 1.
    np.testing.assert_allclose(one_by_one, f, rtol=1e-5, atol=2e-6)

    at = {"uv": places[:, :2], "footprint": places[:, 2:].reshape(N, 2, 2)}
    f_at, pdf_at = material.eval(light, view, **at), material.pdf(light, view, **at)
    samples_at = np.hstack([part.reshape(N, -1) for part in material.sample(view, u, **at)])
    one_by_one_at, *others = answers[6:]
    for ours, theirs in zip(others, [f_at, pdf_at, samples_at]):
        same_bits(ours, theirs)
    same_bits(one_by_one_at, f_at if material.is_surface else one_by_one)
    if not material.is_surface:
        same_bits(f_at, f)

    # The far field, which Python answers without a place; other materials are the same everywhere.
    options = ["--material", material.name, "--footprint", "inf"]
    options += ["--pairs", directory / "pairs.npy", "-o", directory / "f.npy"]
    subprocess.run([command_line, "eval", libraries[name], *options], check=True)
    same_bits(np.load(directory / "f.npy"), f)


def test_command_line_samples_as_python_evaluates(libraries, questions, command_line):
    glimt = pytest.importorskip("glimt", reason="the package is not installed: pip install .")
    directory, *_ = questions
    material = glimt.load(libraries["hybrid"])["rough"]
    view, out = [0.48, 0.36, 0.8], directory / "s.npy"
    options = ["--material", "rough", "--view", "0.48,0.36,0.8", "-n", "5000", "--seed", "3", "-o", out]
    subprocess.run([command_line, "sample", libraries["hybrid"], *options], check=True)
    samples = np.load(out)
    assert samples.shape == (5000, 7) and samples.dtype == np.float32
    light, pdf, weight = samples[:, :3], samples[:, 3], samples[:, 4:]
    carried = pdf > 0
    same_bits(pdf[carried], material.pdf(light, view)[carried])
    f_cos = material.eval(light, view) * light[:, 2:]
    np.testing.assert_allclose((weight * pdf[:, None])[carried], f_cos[carried], rtol=1e-5, atol=1e-9)
