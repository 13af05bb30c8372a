"""Whole frames in Mitsuba: a closed interior of glimt materials against the same of other BSDFs.

    python tests/bench/frames.py [--rounds 9] [--spp 64] [--size 256] [--threads N] [--json FILE]

Warm frames have their kernels compiled and their scene loaded. Cold frames are those of a new process
with an empty kernel cache, from the loading of the scene to the image.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import glimt  # noqa: F401  makes Mitsuba find the plugin
import interior
from rounds import interleave, keep, machine, ratio, summary

MEASUREMENT = interior.ROOT.parent / "shared" / "data" / "rgl" / "chm_orange_rgb.bsdf"

#: Warm scenes, cold scenes, and what is held against what: (scene, reference, goal).
WARM = ["glimt", "principled", "ggx", "measured", "glimt one", "principled one", "ggx one"]
COLD = ["principled one", "ggx one", "glimt one", "glimt", "principled"]
WARM_GOALS = {
    "llvm_ad_rgb": [
        ("glimt", "principled", 1.3),
        ("glimt", "ggx", 2.0),
        ("glimt", "measured", None),
        ("glimt one", "principled one", 1.3),
        ("glimt one", "ggx one", 2.0),
    ],
    "scalar_rgb": [
        ("glimt", "principled", 1.2),
        ("glimt", "ggx", None),
        ("glimt", "measured", None),
        ("glimt one", "principled one", 1.2),
    ],
}
COLD_GOALS = [("glimt one", "principled one", 1.3), ("glimt", "glimt one", 1.2)]


def materials(name, directory):
    """The materials of a scene: a kind, with ten different ones or "one" on all surfaces."""
    kind, _, one = name.partition(" ")
    if kind == "principled":
        chosen = interior.principled()
    elif kind == "measured":
        chosen = [{"type": "measured", "filename": str(MEASUREMENT)}]
    else:
        library = directory / f"{kind}.safetensors"
        names = interior.deepen(library) if kind == "glimt" else interior.analytic_only(library)
        chosen = [{"type": "glimt", "filename": str(library), "material": name} for name in names]
    return chosen[7:8] if one else chosen


def renderer(mi, scene, spp):
    """A function that renders the scene and waits for the image."""
    import drjit as dr

    seeds = iter(range(1 << 30))

    def render():
        dr.eval(mi.render(scene, spp=spp, seed=next(seeds)))
        dr.sync_thread()

    return render


def warm(variant, arguments, directory):
    """Times of the warm frames: {scene: [seconds]}."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant(variant)
    if arguments.threads:
        dr.set_thread_count(arguments.threads)
    spp = arguments.spp if variant.startswith("llvm") else arguments.scalar_spp
    tasks = {}
    for name in WARM:
        if name == "measured" and not MEASUREMENT.exists():
            print(f"skipped: measured ({MEASUREMENT} not found)")
            continue
        description = interior.scene(mi, materials(name, directory), arguments.size)
        tasks[name] = renderer(mi, mi.load_dict(description), spp)
    return interleave(tasks, arguments.rounds)


def first_frame(name, directory):
    """Prints the seconds from the loading of a scene to its first image, in this process."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    chosen = materials(name, Path(directory))
    start = time.perf_counter()
    # Small, so that the time is that of getting ready.
    renderer(mi, mi.load_dict(interior.scene(mi, chosen, size=64)), 4)()
    print(time.perf_counter() - start)


def cold(arguments, directory):
    """Times of the cold frames: {scene: [seconds]}, each of a process with a kernel cache of its own."""
    times = {name: [] for name in COLD}
    for _ in range(arguments.cold_rounds):
        for name in COLD:
            with tempfile.TemporaryDirectory() as cache:
                run = subprocess.run(
                    [sys.executable, __file__, "--first-frame", name, str(directory)],
                    env={**os.environ, "DRJIT_CACHE_DIR": cache},
                    capture_output=True,
                    text=True,
                    check=True,
                )
            times[name].append(float(run.stdout.split()[-1]))
    return times


def report(title, times, goals):
    """Prints the medians and ratios of one set of frames; returns them."""
    print(f"\n{title}")
    for name, seconds in times.items():
        s = summary(seconds)
        low, high = s["quartiles"]
        print(f"  {name:16} {s['median'] * 1e3:9.1f} ms  (quartiles {low * 1e3:.1f} to {high * 1e3:.1f})")
    ratios = []
    for name, reference, goal in goals:
        if name in times and reference in times:
            value = ratio(times[name], times[reference])
            ratios.append({"scene": name, "over": reference, "ratio": round(value, 3), "goal": goal})
            print(f"  {name} / {reference}: {value:.2f}" + (f" (goal {goal})" if goal else ""))
    return {"seconds": {name: summary(seconds) for name, seconds in times.items()}, "ratios": ratios}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--cold-rounds", type=int, default=5)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--scalar-spp", type=int, default=4, help="samples of scalar_rgb, which is slower")
    parser.add_argument("--size", type=int, default=256, help="pixels along a side")
    parser.add_argument("--threads", type=int, help="all that the machine has if not given")
    parser.add_argument("--only", nargs="*", default=["llvm_ad_rgb", "scalar_rgb", "cold"])
    parser.add_argument("--json", help="where the result is kept")
    parser.add_argument("--first-frame", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.first_frame:
        first_frame(*arguments.first_frame)
        return

    result = {"machine": machine(), "pixels": arguments.size**2, "threads": arguments.threads}
    print(result["machine"])
    with tempfile.TemporaryDirectory() as directory:
        directory = Path(directory)
        for variant in WARM_GOALS:
            if variant in arguments.only:
                times = warm(variant, arguments, directory)
                result[variant] = report(f"{variant}, warm", times, WARM_GOALS[variant])
        if "cold" in arguments.only:
            title = "llvm_ad_rgb, first frame of a process, empty kernel cache"
            result["cold"] = report(title, cold(arguments, directory), COLD_GOALS)
    if arguments.json:
        keep(arguments.json, result)


if __name__ == "__main__":
    main()
