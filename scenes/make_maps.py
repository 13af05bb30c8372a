"""Writes procedural texture maps, named as ambientCG names them, for tests and examples.

    python scenes/make_maps.py OUT [--size 256] [weave brushed flakes]

``weave`` is plain cloth of two colours, ``brushed`` metal with scratches, ``flakes`` paint with flakes.
Every set is a tile: its right edge continues on the left, its top at the bottom. A size always gives the same
files.
"""

import argparse
import struct
import zlib
from pathlib import Path

import numpy as np

#: Samples along each side of a texel. Slopes are averaged over them, so that edges do not alias.
SUPERSAMPLING = 4
#: Steepest slope that is written, 72°.
STEEPEST = 3.0


def grid(size):
    """u to the right and v up at the centres of texels, row by row from the top."""
    centres = (np.arange(size) + 0.5) / size
    return np.meshgrid(centres, centres[::-1])


def noise(rng, size, width_u, width_v):
    """Noise of mean 0 and variance 1 that tiles; features have these widths in tiles."""
    # The numbers are drawn on a grid of their own, so that another size shows the same pattern.
    n = 512
    f = np.fft.fftfreq(n, 1 / n)
    blur = np.exp(-2 * np.pi**2 * ((f[None] * width_u) ** 2 + (f[:, None] * width_v) ** 2))
    field = np.fft.ifft2(np.fft.fft2(rng.standard_normal((n, n))) * blur).real
    field = (field - field.mean()) / field.std()
    u, v = grid(size)
    return periodic_bilinear(field, u, v)


def periodic_bilinear(field, u, v):
    n = len(field)
    x, y = u * n - 0.5, v * n - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    x, y = x - i, y - j
    below = field[j % n, i % n] * (1 - x) + field[j % n, (i + 1) % n] * x
    above = field[(j + 1) % n, i % n] * (1 - x) + field[(j + 1) % n, (i + 1) % n] * x
    return below * (1 - y) + above * y


def slopes(height):
    """Slopes of a height in tiles along u and v."""
    along_u = (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) * len(height) / 2
    along_v = (np.roll(height, 1, axis=0) - np.roll(height, -1, axis=0)) * len(height) / 2
    return np.stack([along_u, along_v], axis=-1)


def smooth_step(x):
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def weave(size):
    """Plain weave: 16 dark blue warp yarns along v, 16 ochre weft yarns along u."""
    yarns = 16
    rng = np.random.default_rng(1)
    u, v = grid(size)
    x, y = u * yarns, v * yarns

    def yarn(across, along):
        """Height in widths of a yarn, -1 beside it, and its number. Odd yarns rise where even ones sink."""
        number = np.floor(across)
        offset = (across - number - 0.5) / 0.46
        inside = np.abs(offset) < 1
        round_part = 0.22 * (1 - offset**2)
        waves = 0.14 * np.cos(np.pi * (along - 0.5 + number))
        # Fibres run around the yarn as it is twisted.
        fibres = 0.008 * np.cos(2 * np.pi * (3 * along + 2 * offset))
        return np.where(inside, round_part + waves + fibres, -1), number.astype(int) % yarns

    warp, of_warp = yarn(x, y)
    weft, of_weft = yarn(y, x + 1)
    is_warp = warp > weft
    height = np.maximum(np.maximum(warp, weft), -0.2) + 0.008 * noise(rng, size, 0.006, 0.006)
    shade = 1 + 0.12 * rng.standard_normal((2, yarns))
    shade = np.where(is_warp, shade[0][of_warp], shade[1][of_weft])
    shade = shade * (1 + 0.1 * noise(rng, size, 0.004, 0.004))
    # Light hardly reaches the gaps.
    depth = smooth_step((height + 0.1) / 0.3)
    blue, ochre = np.array([0.04, 0.09, 0.25]), np.array([0.55, 0.33, 0.1])
    color = np.where(is_warp[..., None], blue, ochre) * (shade * (0.25 + 0.75 * depth))[..., None]
    roughness = np.where(is_warp, 0.55, 0.68) + 0.04 * noise(rng, size, 0.01, 0.01) + 0.2 * (1 - depth)
    return {
        "color": color,
        "slope": slopes(height / yarns),
        "roughness": roughness,
        "metalness": np.zeros_like(height),
    }


def brushed(size):
    """Steel, brushed along u, with some deep scratches in other directions."""
    rng = np.random.default_rng(2)
    u, v = grid(size)
    across = 0.09 * noise(rng, size, 0.12, 0.0015) + 0.05 * noise(rng, size, 0.03, 0.003)
    along = 0.012 * noise(rng, size, 0.01, 0.003)
    slope = np.stack([along, across], axis=-1)
    depth = np.zeros_like(u)
    for _ in range(36):
        middle, angle = rng.random(2), rng.uniform(-1.2, 1.2)
        length, width = rng.uniform(0.05, 0.3), rng.uniform(0.0015, 0.004)
        # Of all copies of the tile, the nearest.
        away_u, away_v = (u - middle[0] + 0.5) % 1 - 0.5, (v - middle[1] + 0.5) % 1 - 0.5
        direction = np.array([np.cos(angle), np.sin(angle)])
        ahead = away_u * direction[0] + away_v * direction[1]
        beside = (away_v * direction[0] - away_u * direction[1]) / width
        ends = smooth_step(8 * (1 - np.abs(ahead) / (length / 2)))
        groove = ends * np.exp(-(beside**2))
        depth = np.maximum(depth, groove)
        # The slope of a groove of this profile across it.
        side = 0.7 * beside * groove
        slope += side[..., None] * np.array([-direction[1], direction[0]])
    stains = smooth_step(0.5 + 0.4 * noise(rng, size, 0.08, 0.08))
    color = np.array([0.58, 0.56, 0.53]) * (1 - 0.12 * stains - 0.3 * depth)[..., None]
    roughness = 0.3 + 0.12 * stains + 0.03 * noise(rng, size, 0.06, 0.002) + 0.2 * depth
    return {"color": color, "slope": slope, "roughness": roughness, "metalness": np.ones_like(u)}


def flakes(size):
    """Dark red paint with flakes of a brighter red metal, each tilted as it fell."""
    cells = 48
    rng = np.random.default_rng(3)
    u, v = grid(size)
    jitter = rng.uniform(0.1, 0.9, (cells, cells, 2))
    radius = rng.uniform(0.3, 0.62, (cells, cells)) * (rng.random((cells, cells)) < 0.75)
    layer = rng.random((cells, cells))
    tilt = 0.16 * rng.standard_normal((cells, cells, 2))
    shine = rng.uniform(0.6, 1.0, (cells, cells))
    stretch = rng.uniform(0.7, 1.0, (cells, cells))
    turn = rng.uniform(0, np.pi, (cells, cells))
    i, j = np.floor(u * cells).astype(int), np.floor(v * cells).astype(int)
    top = np.full_like(u, -1.0)
    slope, brightness = np.zeros((*u.shape, 2)), np.zeros_like(u)
    for di in (-1, 0, 1):
        for dj in (-1, 0, 1):
            cell = (j + dj) % cells, (i + di) % cells
            away_u = u * cells - (i + di) - jitter[cell][..., 0]
            away_v = v * cells - (j + dj) - jitter[cell][..., 1]
            c, s = np.cos(turn[cell]), np.sin(turn[cell])
            a, b = c * away_u + s * away_v, (c * away_v - s * away_u) / stretch[cell]
            is_seen = (np.hypot(a, b) < radius[cell]) & (layer[cell] > top)
            top = np.where(is_seen, layer[cell], top)
            slope = np.where(is_seen[..., None], tilt[cell], slope)
            brightness = np.where(is_seen, shine[cell], brightness)
    is_flake = top >= 0
    waves = 0.01 * np.stack([noise(rng, size, 0.05, 0.05), noise(rng, size, 0.05, 0.05)], axis=-1)
    paint, metal = np.array([0.12, 0.008, 0.012]), np.array([0.75, 0.18, 0.12])
    color = np.where(is_flake[..., None], metal * brightness[..., None], paint)
    roughness = np.where(is_flake, 0.34, 0.5)
    return {
        "color": color,
        "slope": slope + waves,
        "roughness": roughness,
        "metalness": is_flake.astype(float),
    }


SETS = {"weave": weave, "brushed": brushed, "flakes": flakes}


def reduced(values):
    """Means over the samples of every texel."""
    n, size = SUPERSAMPLING, len(values) // SUPERSAMPLING
    return values.reshape(size, n, size, n, *values.shape[2:]).mean(axis=(1, 3))


def srgb(linear):
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def png(values, bits):
    """The bytes of a PNG of numbers from 0 to 1, (height, width) or (height, width, 3)."""
    height, width = values.shape[:2]
    codes = np.rint(np.clip(values, 0, 1) * (2**bits - 1)).astype(">u2" if bits == 16 else "u1")
    rows = codes.reshape(height, -1).view("u1").reshape(height, -1)
    data = np.hstack([np.zeros((height, 1), "u1"), rows]).tobytes()

    def chunk(name, body):
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    header = struct.pack(">IIBBBBB", width, height, bits, 2 if values.ndim == 3 else 0, 0, 0, 0)
    chunks = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(data, 9)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


def write(folder, name, size):
    """The maps of a set into a folder of its name."""
    maps = {key: reduced(values) for key, values in SETS[name](size * SUPERSAMPLING).items()}
    slope = np.clip(maps["slope"], -STEEPEST, STEEPEST)
    normal = np.concatenate([-slope, np.ones((size, size, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    files = {
        "Color": png(srgb(maps["color"]), 8),
        "NormalGL": png(0.5 + 0.5 * normal, 16),
        "Roughness": png(maps["roughness"], 8),
        "Metalness": png(maps["metalness"], 8),
    }
    (folder / name).mkdir(parents=True, exist_ok=True)
    for kind, data in files.items():
        (folder / name / f"{name}_{kind}.png").write_bytes(data)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path, help="folder in which every set gets a folder")
    parser.add_argument("sets", nargs="*", metavar="SET", help=f"{', '.join(SETS)}; all if not given")
    parser.add_argument("--size", type=int, default=256, help="texels along a side")
    arguments = parser.parse_args()
    if unknown := set(arguments.sets) - set(SETS):
        parser.error(f"no set is called {', '.join(sorted(unknown))}; there are {', '.join(SETS)}")
    if arguments.size < 1:
        parser.error(f"{arguments.size} texels along a side, expected at least 1")
    for name in arguments.sets or SETS:
        write(arguments.out, name, arguments.size)


if __name__ == "__main__":
    main()
