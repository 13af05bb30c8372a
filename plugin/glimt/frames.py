"""Whole frames in Mitsuba: how far each BSDF's image is from a reference, against the seconds that it took.

    python -m glimt.frames REQUEST.json

``REQUEST.json``, or ``-`` for the standard input, is an object; all but the first two may be left out:

    bsdfs       what is rendered: {name: dictionary of a BSDF}
    reference   the name among them whose converged image the others are compared with
    variants    Mitsuba's variants, ["scalar_rgb", "llvm_ad_rgb"]
    scenes      ["sphere", "room"]
    spp         samples per pixel, {variant: [1, 4, 16, 64]}
    rounds      rounds of timing, 3; they alternate between all BSDFs
    size        pixels across, 64
    converged   samples per pixel of the images that are compared with, 1024
    threads     threads, 1

Printed is one JSON object, {scene: {variant: {name: [{spp, seconds, rmse, noise}]}}}: the median of the
seconds of a warm frame; the root mean square difference to the reference's converged image, and to the BSDF's
own, which is noise alone, both relative to the mean of the reference. "sphere" is a sphere of the BSDF on a
grey floor, under an even sky and a square lamp; "room" is closed, has grey walls, a floor and two spheres of
the BSDF, and paths of up to six segments.
"""

import json
import os
import statistics
import sys
import time
from pathlib import Path

DEFAULTS = {
    "variants": ["scalar_rgb", "llvm_ad_rgb"],
    "scenes": ["sphere", "room"],
    "spp": {"scalar_rgb": [1, 2, 4, 8, 16], "llvm_ad_rgb": [1, 4, 16, 64]},
    "rounds": 3,
    "size": 64,
    "converged": 1024,
    "threads": 1,
}


def grey(value):
    """A diffuse BSDF."""
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}


def lamp(to_world, radiance):
    """A square that shines to its front."""
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    return {"type": "rectangle", "to_world": to_world, "emitter": emitter}


def camera(transform, origin, target, fov, size):
    """A perspective view whose pixels are independent of each other."""
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": transform().look_at(origin, target, [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent"},
    }


def sphere(transform, bsdf, size):
    """A sphere of ``bsdf`` on a floor, in the open."""
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sky": {"type": "constant", "radiance": 0.4},
        "lamp": lamp(transform().look_at([-2.5, -2.5, 3.5], [0, 0, 0], [0, 0, 1]), 10.0),
        "sensor": camera(transform, [0, -5.2, 0.9], [0, 0, 0], 28, size),
        "floor": {
            "type": "rectangle",
            "to_world": transform().translate([0, 0, -1]).scale(6),
            "bsdf": grey(0.4),
        },
        "sphere": {"type": "sphere", "bsdf": bsdf},
    }


def room(transform, bsdf, size):
    """A closed room, 2 × 2 × 2, whose floor is of ``bsdf``, and two spheres."""
    walls = {
        "ceiling": transform().translate([0, 0, 2]).rotate([1, 0, 0], 180),
        "left": transform().translate([-1, 0, 1]).rotate([0, 1, 0], 90),
        "right": transform().translate([1, 0, 1]).rotate([0, 1, 0], -90),
        "back": transform().translate([0, 1, 1]).rotate([1, 0, 0], 90),
        "front": transform().translate([0, -1, 1]).rotate([1, 0, 0], -90),
    }
    to_ceiling = transform().translate([0, 0, 1.99]).rotate([1, 0, 0], 180).scale(0.4)
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sensor": camera(transform, [0, -0.95, 1], [0, 1, 0.8], 75, size),
        "lamp": lamp(to_ceiling, 8.0),
        "material": {**bsdf, "id": "material"},
        "wall": {**grey(0.6), "id": "wall"},
        **{
            name: {"type": "rectangle", "to_world": to_world, "bsdf": {"type": "ref", "id": "wall"}}
            for name, to_world in walls.items()
        },
        "floor": {"type": "rectangle", "bsdf": {"type": "ref", "id": "material"}},
        "ball": {
            "type": "sphere",
            "to_world": transform().translate([-0.4, 0.3, 0.4]).scale(0.4),
            "bsdf": {"type": "ref", "id": "material"},
        },
        "marble": {
            "type": "sphere",
            "to_world": transform().translate([0.4, 0, 0.25]).scale(0.25),
            "bsdf": {"type": "ref", "id": "material"},
        },
    }


SCENES = {"sphere": sphere, "room": room}


def render(mi, loaded, spp, seed):
    """The image, waited for, as a float64 array."""
    import numpy as np

    return np.array(mi.render(loaded, spp=spp, seed=seed), dtype=np.float64)[..., :3]


def rms(difference):
    """Root of the mean of the squares."""
    return float((difference**2).mean() ** 0.5)


def load(mi, scene, request):
    """The scene with every BSDF, {name: scene}."""
    build = SCENES[scene]
    return {
        name: mi.load_dict(build(mi.ScalarTransform4f, bsdf, request["size"]))
        for name, bsdf in request["bsdfs"].items()
    }


def measure(variant, scene, converged, request):
    """One scene in one variant: {name: [{spp, seconds, rmse, noise}]}."""
    import drjit as dr
    import mitsuba as mi
    import numpy as np

    mi.set_variant(variant)
    dr.set_thread_count(request["threads"])
    loaded = load(mi, scene, request)
    reference = converged[request["reference"]]
    times = {name: {spp: [] for spp in request["spp"][variant]} for name in loaded}
    errors = {name: {spp: [] for spp in request["spp"][variant]} for name in loaded}
    for number in range(request["rounds"] + 1):
        for spp in request["spp"][variant]:
            for name, one in loaded.items():
                start = time.perf_counter()
                image = render(mi, one, spp, seed=1000 * number + spp)
                elapsed = time.perf_counter() - start
                # The first round compiles.
                if number > 0:
                    times[name][spp].append(elapsed)
                    both = rms(image - reference), rms(image - converged[name])
                    errors[name][spp].append(np.array(both) / reference.mean())
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


def converge(scene, request):
    """The converged image of every BSDF, {name: image}, by the fastest variant that there is."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb" if "llvm_ad_rgb" in mi.variants() else "scalar_rgb")
    dr.set_thread_count(os.cpu_count())
    # In passes, so that a wavefront fits into memory.
    one_pass = 256
    passes = max(1, request["converged"] // one_pass)
    return {
        name: sum(render(mi, loaded, one_pass, 77_000 + i) for i in range(passes)) / passes
        for name, loaded in load(mi, scene, request).items()
    }


def run(request):
    """The answer to a request, as the module says."""
    import mitsuba as mi

    import glimt  # noqa: F401  makes Mitsuba find the plugin

    # Mitsuba's own `measured` answers negative values where a file was measured so: a warning a sample.
    mi.set_log_level(mi.LogLevel.Error)
    request = {**DEFAULTS, **request}
    answer = {}
    for scene in request["scenes"]:
        converged = converge(scene, request)
        answer[scene] = {
            variant: measure(variant, scene, converged, request) for variant in request["variants"]
        }
    return answer


def main():
    if len(sys.argv) != 2 or sys.argv[1].startswith("--"):
        print(__doc__, file=sys.stderr)
        return 2
    text = sys.stdin.read() if sys.argv[1] == "-" else Path(sys.argv[1]).read_text()
    request = json.loads(text)
    if unknown := [scene for scene in request.get("scenes", []) if scene not in SCENES]:
        print(f"there is no scene {unknown[0]!r}; expected {' or '.join(SCENES)}", file=sys.stderr)
        return 2
    # Mitsuba writes its warnings to the standard output, which is for the answer alone.
    with os.fdopen(os.dup(1), "w") as answer:
        os.dup2(2, 1)
        json.dump(run(request), answer)
        answer.write("\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
