"""Draws a sphere of one material from each of several libraries, side by side, under a distant light.

    python tests/quality/facets.py MATERIAL LIBRARY [LIBRARY ...] -o facets.png

Nothing blurs the highlight and there is no noise, so that what shows is the tables: where f is constant in a
pixel, its facets.
"""

import argparse
from pathlib import Path

import mitsuba as mi
import numpy as np
from spheres import exposure, shown

SUN = [1.0, 1.5, -1.0]
"""Where the light goes."""


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("material")
    parser.add_argument("libraries", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    return parser.parse_args()


def render(bsdf, size):
    """The image of a sphere with `bsdf`, linear RGB."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sun": {"type": "directional", "direction": SUN, "irradiance": 3.0},
            "sensor": {
                "type": "perspective",
                "fov": 24,
                "to_world": mi.ScalarTransform4f().look_at([0, -5, 0], [0, 0, 0], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent"},
            },
            "sphere": {"type": "sphere", "bsdf": bsdf},
        }
    )
    return np.array(mi.render(scene, spp=64))[..., :3]


def main():
    arguments = parse_arguments()
    mi.set_variant(arguments.variant)
    images = [
        render({"type": "glimt", "filename": str(library), "material": arguments.material}, arguments.size)
        for library in arguments.libraries
    ]
    scale = exposure(images[0])
    pixels = np.concatenate([shown(image, scale) for image in images], axis=1)
    mi.Bitmap(np.round(255 * pixels).astype(np.uint8)).write(str(arguments.output))


if __name__ == "__main__":
    main()
