"""Renders strips of edited and of mixed materials: docs/images/edits.png and mixes.png.

    python tests/quality/edits.py [LIBRARY] [--out DIRECTORY]

A strip of edits has the fitted material first, and one parameter changed in each of the others; rows are
k_d, η and α. A strip of mixes goes from one material to another. The exposure is that of the first sphere of
a material.
"""

import argparse
from pathlib import Path

import mitsuba as mi
import numpy as np

ROOT = Path(__file__).parents[2]
MATERIALS = ["vch_golden_yellow", "chm_orange", "cc_ibiza_sunset", "acrylic_felt_green"]
MIXES = [
    ("chm_orange", "chm_light_blue"),
    ("acrylic_felt_green", "cc_ibiza_sunset"),
    ("paper_white", "vch_golden_yellow"),
    ("aurora_white", "chm_mint"),
]
KD = [(0, 0, 0), (0.1, 0.2, 0.6), (0.6, 0.1, 0.1), (0.4, 0.4, 0.4), (0.8, 0.8, 0.8), (1, 1, 1)]
ETA = [1.05, 1.2, 1.5, 2, 2.8, 4]
ALPHA = [0.02, 0.05, 0.1, 0.2, 0.5, 1]
WEIGHTS = [0, 0.15, 0.3, 0.5, 0.7, 0.85, 1]


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "library", nargs="?", type=Path, default=ROOT / "scenes" / "models" / "rgl.safetensors"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images")
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--spp", type=int, default=512)
    return parser.parse_args()


def sphere(bsdf, size, spp):
    """A sphere under a round lamp, a panel behind it and a dim sky, linear RGB."""
    place = mi.ScalarTransform4f()
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "gaussian"}}
    view = place.look_at([0, -5, 0], [0, 0, 0], [0, 0, 1])
    panel = place.look_at([4, 2, 1], [0, 0, 0], [0, 0, 1]).scale([0.6, 2, 1])
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
        "sky": {"type": "constant", "radiance": 0.25},
        "lamp": {
            "type": "sphere",
            "center": [-4, -5, 5],
            "radius": 0.9,
            "emitter": {"type": "area", "radiance": 25.0},
        },
        "panel": {"type": "rectangle", "to_world": panel, "emitter": {"type": "area", "radiance": 6.0}},
        "sensor": {"type": "perspective", "fov": 24, "to_world": view, "film": film},
        "sphere": {"type": "sphere", "bsdf": bsdf},
    }
    return np.array(mi.render(mi.load_dict(scene), spp=spp))[..., :3]


def strip(bsdfs, arguments, exposure=None):
    """Spheres side by side, and the exposure that shows the first of them."""
    images = [sphere(bsdf, arguments.size, arguments.spp) for bsdf in bsdfs]
    exposure = exposure or 0.6 / np.percentile(images[0], 97)
    return np.concatenate(images, axis=1) * exposure, exposure


def rgb(value):
    return {"type": "rgb", "value": list(value)}


def edits(library, arguments):
    rows = []
    for name in MATERIALS:
        fitted = {"type": "glimt", "filename": str(library), "material": name}
        exposure = None
        for changes in (
            [{"kd": rgb(kd)} for kd in KD],
            [{"eta": eta} for eta in ETA],
            [{"alpha": alpha} for alpha in ALPHA],
        ):
            row, exposure = strip(
                [fitted, *({**fitted, **change} for change in changes)], arguments, exposure
            )
            rows.append(row)
    return np.concatenate(rows)


def mixes(library, arguments):
    rows = []
    for first, second in MIXES:
        mix = {"type": "glimt", "filename": str(library), "material": first, "mix": second}
        row, _ = strip([{**mix, "mix_weight": weight} for weight in WEIGHTS], arguments)
        rows.append(row)
    return np.concatenate(rows)


def main():
    arguments = parse_arguments()
    mi.set_variant("llvm_ad_rgb")
    import glimt  # noqa: F401  (makes Mitsuba find the plugin)

    for name, draw in ("edits", edits), ("mixes", mixes):
        image = mi.Bitmap(draw(arguments.library, arguments).astype(np.float32))
        mi.util.write_bitmap(str(arguments.out / f"{name}.png"), image, write_async=False)


if __name__ == "__main__":
    main()
