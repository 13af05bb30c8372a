"""Prints the directional albedo of every material of a library: what a white furnace would show.

    python tests/quality/albedo.py LIBRARY [--samples N]

Per view angle, the mean weight of samples, in the channel where it is largest; above 1 the fit reflects
more than it receives, as some measurements do near the horizon.
"""

import argparse

import glimt
import numpy as np

DEGREES = (0, 30, 60, 75, 85)


def directional_albedo(material, degrees, samples):
    theta = np.radians(degrees)
    view = np.tile(np.array([np.sin(theta), 0, np.cos(theta)], np.float32), (samples, 1))
    u = np.random.default_rng(0).random((samples, 3), np.float32)
    _, _, weight = material.sample(view, u)
    return float(weight.mean(axis=0).max())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("library")
    parser.add_argument("--samples", type=int, default=200_000)
    arguments = parser.parse_args()
    library = glimt.load(arguments.library)
    print(f"{'material':24}" + "".join(f"{degrees:>7}°" for degrees in DEGREES))
    for name in library.materials:
        albedos = (directional_albedo(library[name], d, arguments.samples) for d in DEGREES)
        print(f"{name:24}" + "".join(f"{albedo:8.3f}" for albedo in albedos))


if __name__ == "__main__":
    main()
