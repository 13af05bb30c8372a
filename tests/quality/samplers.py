"""Noise of each sampler on measurements or fits: the variance of f cosθ / pdf, relative to the squared mean.

    python tests/quality/samplers.py [DIRECTORY|LIBRARY] [--plot samplers.png]

For every RGL file of the directory, or material of the library, and views from 0° to 80°, samples are drawn
by the cosine, by the fitted lobes, by the measurement's own warp, and by tables; the figure is the mean over
the views, which says how many samples per pixel a renderer needs under an even sky. The time to make a table
and its bytes follow.
"""

import argparse
import time
from pathlib import Path

import glimt
import numpy as np

DIRECTORY = Path(__file__).parents[3] / "shared" / "data" / "rgl"
TABLES = ["table:8x16x8", "table:16x32x16", "table", "table:64x128x64", "table:paper"]
SAMPLERS = ["cosine", "lobes", "warp", *TABLES]
ANGLES = np.radians([0, 15, 30, 45, 60, 70, 80])
SAMPLES = 40_000


def weights(material, sampler, view, u):
    """f cosθ / pdf, (n, 3)."""
    if sampler != "cosine":
        return material.sample(view, u)[2]
    r, phi = np.sqrt(u[:, 1]), 2 * np.pi * u[:, 2]
    light = np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u[:, 1])], axis=1)
    return np.pi * material.eval(light.astype(np.float32), view)


def relative_variance(material, sampler, rng):
    """Mean over the views of the variance over the squared mean, of the mean of the channels."""
    ratios = []
    for theta in ANGLES:
        view = np.array([np.sin(theta), 0, np.cos(theta)], np.float32)
        weight = weights(material, sampler, view, rng.random((SAMPLES, 3), np.float32))
        grey = weight.mean(axis=1, dtype=np.float64)
        ratios.append(grey.var() / grey.mean() ** 2)
    return float(np.mean(ratios))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path, nargs="?", default=DIRECTORY)
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args()
    materials, samplers = opened(arguments.source)
    if not materials:
        parser.error(f"{arguments.source} holds no .bsdf file")
    table, cost = {}, {}
    print(f"{'material':24}" + "".join(f"{sampler:>16}" for sampler in samplers))
    for source in materials:
        row = []
        for sampler in samplers:
            material = source
            if sampler not in ("cosine", "warp"):
                start = time.perf_counter()
                material = source.with_sampler(sampler)
                cost.setdefault(sampler, []).append((time.perf_counter() - start, material.sampler_bytes))
            row.append(relative_variance(material, sampler, np.random.default_rng(1)))
        table[source.name] = row
        print(f"{source.name:24}" + "".join(f"{value:16.3f}" for value in row), flush=True)
    means = np.exp(np.mean(np.log(list(table.values())), axis=0))
    print(f"{'geometric mean':24}" + "".join(f"{value:16.3f}" for value in means))
    for sampler, values in cost.items():
        seconds, size = np.median(values, axis=0)
        print(f"{sampler}: made in {1e3 * seconds:.0f} ms, {int(size):,} bytes")
    if arguments.plot:
        plot(table, samplers, arguments.plot)


def opened(source):
    """The materials of a directory or library, and the samplers that they can have."""
    if source.is_dir():
        return [glimt.load(file).material() for file in sorted(source.glob("*.bsdf"))], SAMPLERS
    library = glimt.load(source)
    return [library[name] for name in library.materials], [name for name in SAMPLERS if name != "warp"]


def plot(table, samplers, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    values, places = np.array(list(table.values())), np.arange(len(table))
    figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
    for i, sampler in enumerate(samplers):
        axes.plot(places, values[:, i], "o", label=sampler)
    axes.set_yscale("log")
    axes.set_ylabel("variance / mean²")
    axes.set_xticks(places, list(table), rotation=40, ha="right")
    figure.legend(loc="outside right upper")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
