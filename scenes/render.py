"""Renders the scenes of this directory to out/, as EXR and PNG.

python scenes/render.py [--spp N] [--measurement chm_orange_rgb.bsdf]
"""

import argparse
import time
from pathlib import Path

import glimt
import mitsuba as mi

SCENES = Path(__file__).parent
OUT = SCENES.parent / "out"


def choose_variant():
    """The LLVM variant where Dr.Jit finds a libLLVM, else the scalar one, which takes minutes."""
    try:
        mi.set_variant("llvm_ad_rgb")
    except ImportError:
        mi.set_variant("scalar_rgb")
        print(
            "Without libLLVM the scalar variant renders, with fewer samples. Fix: apt-get install libllvm19"
        )


def render(name, **parameters):
    """Renders one scene file and writes it."""
    start = time.perf_counter()
    scene = mi.load_file(str(SCENES / f"{name}.xml"), **parameters)
    loaded = time.perf_counter()
    image = mi.render(scene)
    mi.util.write_bitmap(str(OUT / f"{name}.exr"), image, write_async=False)
    mi.util.write_bitmap(str(OUT / f"{name}.png"), image, write_async=False)
    rendered = time.perf_counter()
    load_time, render_time = loaded - start, rendered - loaded
    print(f"out/{name}.png: loaded in {load_time:.1f} s, rendered in {render_time:.1f} s, {mi.variant()}")


def main():
    parser = argparse.ArgumentParser(description="Render the scenes to out/.")
    parser.add_argument("--spp", type=int, help="samples per pixel")
    parser.add_argument("--measurement", help="RGL file to render beside the fit of the same name")
    arguments = parser.parse_args()

    choose_variant()
    OUT.mkdir(exist_ok=True)
    spp = arguments.spp or (8 if mi.variant().startswith("scalar") else None)
    samples = {"spp": spp} if spp else {}
    print(f"glimt {glimt.__version__}, Mitsuba {mi.__version__}")
    render("gallery", **samples)
    render("surface", **samples)
    if arguments.measurement:
        measurement = Path(arguments.measurement).resolve()
        material = measurement.stem.removesuffix("_rgb")
        render("comparison", measurement=str(measurement), material=material, **samples)


if __name__ == "__main__":
    main()
