"""Whole frames in Mitsuba: how far each BSDF's image is from a reference, against the seconds that it took.

    python -m glimt.frames REQUEST.json

``REQUEST.json``, or ``-`` for the standard input, is an object; all but the first two may be left out:

    bsdfs       what is rendered: {name: dictionary of a BSDF}
    reference   the name among them whose converged image the others are compared with
    variants    Mitsuba's variants, ["scalar_rgb", "llvm_ad_rgb"]
    spp         samples per pixel, {variant: [1, 4, 16, 64]}
    rounds      rounds of timing, 3; they alternate between all BSDFs
    size        pixels across, 128
    converged   samples per pixel of the images that are compared with, 2048
    threads     threads, 1

Printed is one JSON object, {variant: {name: [{spp, seconds, rmse, noise}]}}: the median of the seconds of a
warm frame; the root mean square difference to the reference's converged image, and to the BSDF's own, which
is noise alone, both relative to the mean of the reference. The scene is a sphere on a floor, under an
even sky and a square lamp.
"""

import json
import os
import statistics
import sys
import time
from pathlib import Path

DEFAULTS = {
    "variants": ["scalar_rgb", "llvm_ad_rgb"],
    "spp": {"scalar_rgb": [1, 2, 4, 8, 16], "llvm_ad_rgb": [1, 4, 16, 64, 256]},
    "rounds": 3,
    "size": 128,
    "converged": 2048,
    "threads": 1,
}


def scene(mi, bsdf, size):
    """A sphere of ``bsdf`` on a floor, as a loaded scene."""
    camera = mi.ScalarTransform4f().look_at([0, -5.2, 0.9], [0, 0, 0], [0, 0, 1])
    lamp = mi.ScalarTransform4f().look_at([-2.5, -2.5, 3.5], [0, 0, 0], [0, 0, 1])
    floor = mi.ScalarTransform4f().translate([0, 0, -1]).scale(6)
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 4},
            "sky": {"type": "constant", "radiance": 0.4},
            "lamp": {
                "type": "rectangle",
                "to_world": lamp,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 10.0}},
            },
            "sensor": {
                "type": "perspective",
                "fov": 28,
                "to_world": camera,
                "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent"},
            },
            "floor": {
                "type": "rectangle",
                "to_world": floor,
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.4}},
            },
            "sphere": {"type": "sphere", "bsdf": bsdf},
        }
    )


def render(mi, loaded, spp, seed):
    """The image, waited for, as a float64 array."""
    import numpy as np

    return np.array(mi.render(loaded, spp=spp, seed=seed), dtype=np.float64)[..., :3]


def rms(difference):
    """Root of the mean of the squares."""
    return float((difference**2).mean() ** 0.5)


def measure(variant, request, np):
    """One variant: {name: [{spp, seconds, rmse, noise}]}."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant(variant)
    dr.set_thread_count(request["threads"])
    loaded = {name: scene(mi, bsdf, request["size"]) for name, bsdf in request["bsdfs"].items()}
    reference = request["reference"]
    times = {name: {spp: [] for spp in request["spp"][variant]} for name in loaded}
    errors = {name: {spp: [] for spp in request["spp"][variant]} for name in loaded}
    # Converged images come from the fastest variant that there is.
    converged = request["images"]
    mean = float(converged[reference].mean())
    for number in range(request["rounds"] + 1):
        for spp in request["spp"][variant]:
            for name, one in loaded.items():
                start = time.perf_counter()
                image = render(mi, one, spp, seed=1000 * number + spp)
                elapsed = time.perf_counter() - start
                # The first round compiles.
                if number > 0:
                    times[name][spp].append(elapsed)
                    both = rms(image - converged[reference]), rms(image - converged[name])
                    errors[name][spp].append(np.array(both) / mean)
    return {
        name: [
            {
                "spp": spp,
                "seconds": statistics.median(seconds),
                "rmse": float(np.mean([error[0] for error in errors[name][spp]])),
                "noise": float(np.mean([error[1] for error in errors[name][spp]])),
            }
            for spp, seconds in by_spp.items()
        ]
        for name, by_spp in times.items()
    }


def converge(request):
    """The converged image of every BSDF."""
    import mitsuba as mi

    variants = mi.variants()
    mi.set_variant("llvm_ad_rgb" if "llvm_ad_rgb" in variants else "scalar_rgb")
    # In passes, so that a wavefront fits into memory.
    one_pass = 256
    passes = max(1, request["converged"] // one_pass)
    images = {}
    for name, bsdf in request["bsdfs"].items():
        loaded = scene(mi, bsdf, request["size"])
        images[name] = sum(render(mi, loaded, one_pass, 77_000 + i) for i in range(passes)) / passes
    return images


def run(request):
    import numpy as np

    import glimt  # noqa: F401  makes Mitsuba find the plugin

    request = {**DEFAULTS, **request}
    request["images"] = converge(request)
    return {variant: measure(variant, request, np) for variant in request["variants"]}


def main():
    if len(sys.argv) != 2 or sys.argv[1].startswith("--"):
        print(__doc__, file=sys.stderr)
        return 2
    text = sys.stdin.read() if sys.argv[1] == "-" else Path(sys.argv[1]).read_text()
    # Mitsuba writes its warnings to the standard output, which is for the answer alone.
    with os.fdopen(os.dup(1), "w") as answer:
        os.dup2(2, 1)
        json.dump(run(json.loads(text)), answer)
        answer.write("\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
