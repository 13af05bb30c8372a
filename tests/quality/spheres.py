"""Renders a sphere of each material, measured and fitted, and prints how far the images are apart.

    python tests/quality/spheres.py --measured DIRECTORY LIBRARY [LIBRARY ...]

DIRECTORY holds RGL files; a material of a library is compared with Mitsuba's own `measured` on the file of
the same name, and left out where there is none. The light is Mitsuba's `sunsky`, or an environment map.
PSNR is of the images as shown, sRGB clipped to [0, 1], at an exposure that the measured image sets; MAE is of
linear radiance.
"""

import argparse
import math
from pathlib import Path

import glimt
import mitsuba as mi
import numpy as np


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("libraries", nargs="+", type=Path)
    parser.add_argument("--measured", type=Path, required=True, help="directory with RGL files (.bsdf)")
    parser.add_argument("--envmap", type=Path, help="environment map; a clear sky with sun if not given")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--spp", type=int, default=512)
    parser.add_argument("--out", type=Path, help="directory for the images, as PNG")
    return parser.parse_args()


def light(envmap):
    if envmap:
        z_up = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
        return {"type": "envmap", "filename": str(envmap), "to_world": z_up}
    # A sun of this size lights narrow lobes without ruling the picture by a few pixels.
    return {"type": "sunsky", "sun_direction": [0.5, -0.6, 0.6], "sun_aperture": 5.0}


def render(bsdf, arguments, seed=1):
    """The image of a sphere with `bsdf`, linear RGB."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "light": light(arguments.envmap),
            "sensor": {
                "type": "perspective",
                "fov": 26,
                "to_world": mi.ScalarTransform4f().look_at([0, -5, 0], [0, 0, 0], [0, 0, 1]),
                "film": {
                    "type": "hdrfilm",
                    "width": arguments.size,
                    "height": arguments.size,
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "independent"},
            },
            "sphere": {"type": "sphere", "bsdf": bsdf},
        }
    )
    return np.array(mi.render(scene, spp=arguments.spp, seed=seed))[..., :3]


def shown(image, exposure):
    """As a display shows it: sRGB, clipped."""
    image = np.clip(image * exposure, 0, 1)
    return np.where(image <= 0.0031308, 12.92 * image, 1.055 * image ** (1 / 2.4) - 0.055)


def exposure(truth):
    """Brings all but the brightest twentieth of the values below 1."""
    return 1 / np.percentile(truth, 95)


def psnr(truth, image):
    scale = exposure(truth)
    error = np.mean((shown(truth, scale) - shown(image, scale)) ** 2)
    return 10 * math.log10(1 / error) if error > 0 else math.inf


def measured_file(directory, material):
    files = (directory / f"{material}{suffix}.bsdf" for suffix in ("_rgb", ""))
    return next((file for file in files if file.exists()), None)


def names(library):
    """The library's materials, by their names without the suffix that RGL files have."""
    return {name.removesuffix("_rgb"): name for name in library.materials}


def main():
    arguments = parse_arguments()
    mi.set_variant(arguments.variant)
    libraries = {path: names(glimt.load(str(path))) for path in arguments.libraries}
    materials = sorted(set().union(*libraries.values()))
    results = {path: [] for path in libraries}
    print(f"{'material':24}" + "".join(f"{path.stem[:24]:>26}" for path in libraries))
    for material in materials:
        file = measured_file(arguments.measured, material)
        if file is None:
            continue
        truth = render({"type": "measured", "filename": str(file)}, arguments)
        images, row = [truth], f"{material:24}"
        for path, library in libraries.items():
            if material not in library:
                row += f"{'-':>26}"
                continue
            image = render({"type": "glimt", "filename": str(path), "material": library[material]}, arguments)
            images.append(image)
            result = psnr(truth, image), float(np.mean(np.abs(truth - image)))
            results[path].append(result)
            row += f"{result[0]:14.1f} dB {result[1]:.5f}"
        print(row, flush=True)
        if arguments.out:
            arguments.out.mkdir(parents=True, exist_ok=True)
            row = mi.Bitmap((np.concatenate(images, axis=1) * exposure(truth)).astype(np.float32))
            mi.util.write_bitmap(str(arguments.out / f"{material}.png"), row, write_async=False)
    means = [np.mean(values, axis=0) if values else (math.nan, math.nan) for values in results.values()]
    print(f"{'mean':24}" + "".join(f"{mean[0]:14.1f} dB {mean[1]:.5f}" for mean in means))


if __name__ == "__main__":
    main()
