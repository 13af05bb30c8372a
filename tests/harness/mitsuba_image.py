"""What the harness is compared with: Mitsuba's image of a scene, with the variance of each pixel's mean.

As a program it renders one scene with both and says whether noise explains how they differ:

    python tests/harness/mitsuba_image.py HARNESS scenes/harness/mesh.xml [--spp N] [-D name=value ...]
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import glimt  # noqa: F401  Mitsuba finds the plugin
import mitsuba as mi
import numpy as np

PASSES = 16


def render(scene, spp):
    """Mean and variance of the mean, (height, width, 3), from independent passes of spp / PASSES samples."""
    images = [np.array(mi.render(scene, spp=spp // PASSES, seed=seed))[..., :3] for seed in range(PASSES)]
    return np.mean(images, axis=0), np.var(images, axis=0, ddof=1) / PASSES


def write(path, mean, variance):
    """As `glimt compare` reads it."""
    names = [prefix + channel for prefix in ("", "variance.") for channel in "RGB"]
    pixels = np.concatenate([mean, variance], axis=2).astype(np.float32)
    bitmap = mi.Bitmap(pixels, mi.Bitmap.PixelFormat.MultiChannel, names)
    bitmap.write(str(path))


def write_sky(path):
    """A sky of 64 × 32 pixels with a small sun, a horizon and a dark ground."""
    theta = np.pi * np.arange(32)[:, None, None] / 31
    phi = 2 * np.pi * (np.arange(64)[None, :, None] + 0.5) / 64
    sky = np.exp(-2 * np.cos(theta).clip(0)) * [0.5, 0.7, 1.0] + 0.2 * (1 + np.sin(phi)) * [1.0, 0.6, 0.3]
    sky = np.where(theta < np.pi / 2, sky, 0.15 * np.ones(3) * (1 + 0.5 * np.cos(3 * phi)))
    sun = np.exp(-((theta - 0.8) ** 2 + (phi - 2) ** 2) / 0.02)
    mi.Bitmap((sky + 40 * sun * [1.0, 0.9, 0.7]).astype(np.float32)).write(str(path))


def write_checker(path):
    """Coloured squares, 8 × 8 of 4 × 4 pixels."""
    y, x = np.mgrid[:32, :32] // 4
    squares = np.where(((x + y) % 2 == 0)[..., None], [0.8, 0.75, 0.6], [0.1, 0.15, 0.3])
    mi.Bitmap((squares * (0.5 + 0.06 * x[..., None])).astype(np.float32)).write(str(path))


def main():
    parser = argparse.ArgumentParser(description="Render one scene with the harness and with Mitsuba.")
    parser.add_argument("harness", help="the program")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--spp", type=int, default=256)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("-D", dest="parameters", action="append", default=[], metavar="name=value")
    parser.add_argument("--out", type=Path, help="directory for both images")
    arguments = parser.parse_args()
    mi.set_variant(arguments.variant)
    with tempfile.TemporaryDirectory() as temporary:
        out = arguments.out or Path(temporary)
        out.mkdir(parents=True, exist_ok=True)
        write_sky(out / "sky.exr")
        write_checker(out / "checker.exr")
        given = dict(pair.split("=", 1) for pair in arguments.parameters)
        parameters = {"envmap": str(out / "sky.exr"), "texture": str(out / "checker.exr"), **given}
        # Both renderers take files from the directory of the scene.
        paths = {name: Path(value) for name, value in parameters.items() if Path(value).exists()}
        parameters.update((name, str(path.resolve())) for name, path in paths.items())
        text = arguments.scene.read_text()
        used = {name: value for name, value in parameters.items() if f"${name}" in text}
        name = arguments.scene.stem
        truth, image = out / f"{name}-mitsuba.exr", out / f"{name}-harness.exr"
        write(truth, *render(mi.load_file(str(arguments.scene), **used), arguments.spp))
        definitions = [word for name, value in used.items() for word in ("-D", f"{name}={value}")]
        command = [arguments.harness, arguments.scene, "-o", image, "--spp", str(arguments.spp), *definitions]
        subprocess.run(command, check=True)
        sys.exit(subprocess.run(["glimt", "compare", truth, image]).returncode)


if __name__ == "__main__":
    main()
