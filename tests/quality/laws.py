"""Prints reciprocity and energy of a library's materials beside those of the measurements.

    python tests/quality/laws.py LIBRARY MEASUREMENTS [--samples N]

Of every material, with the measurement of the same name in the directory in brackets: the symmetric
relative error (SMAPE) of f with light and view exchanged, over cosine-distributed pairs, and the directional
albedo by view angle, in the channel where it is largest.
"""

import argparse
from pathlib import Path

import glimt
import numpy as np
from albedo import directional_albedo

DEGREES = (0, 30, 60, 75, 85)
PAIRS = 100_000


def cosine_directions(u):
    r, phi = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u[:, 0])], axis=1).astype(np.float32)


def exchanged_error(material):
    """SMAPE of f(view, light) against f(light, view), each not below 0."""
    u = np.random.default_rng(12345).random((PAIRS, 4))
    light, view = cosine_directions(u[:, 2:]), cosine_directions(u[:, :2])
    a, b = (np.maximum(material.eval(*pair), 0) for pair in ((light, view), (view, light)))
    both = a + b
    return float(np.mean(np.divide(2 * np.abs(a - b), both, out=np.zeros_like(both), where=both > 1e-8)))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("library")
    parser.add_argument("measurements", type=Path)
    parser.add_argument("--samples", type=int, default=200_000)
    arguments = parser.parse_args()
    library = glimt.load(arguments.library)
    files = sorted(arguments.measurements.glob("*.bsdf"))
    measured = {material.name: material for material in (glimt.load(file).material() for file in files)}
    missing = [name for name in library.materials if name not in measured]
    if missing:
        parser.error(f"{arguments.measurements} holds no measurement of {', '.join(missing)}")
    heads = ("exchanged", *(f"{degrees}°" for degrees in DEGREES))
    print(f"{'material':20}" + "".join(f"{head:>15}" for head in heads))
    for name in library.materials:
        pair = (library[name], measured[name])
        cells = [[exchanged_error(material) for material in pair]]
        cells += [[directional_albedo(material, d, arguments.samples) for material in pair] for d in DEGREES]
        print(f"{name:20}" + "".join(f"{f'{fit:.3f} ({own:.3f})':>15}" for fit, own in cells), flush=True)


if __name__ == "__main__":
    main()
