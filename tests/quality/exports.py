"""Exported files in renderers that know nothing of glimt: how far they are from the model, and how noisy.

    python tests/quality/exports.py LIBRARY --measured DIRECTORY --work OUT [--glimt target/release/glimt]

Every material of LIBRARY is written as RGL and rendered by Mitsuba's own `measured` beside the plugin with
the model itself: a sphere under a clear sky with a sun. `error` is the mean absolute difference of the
images over the mean of the model's, `noise` the same between two renderings of the model with other seeds.
`variance` is that of f cosθ/pdf over its squared mean, as `measured` samples the original file, that file
written anew by glimt, and the exported fit: the mean over views from 0° to 80°. `MERL` is the mean of
|f − g| cosθ over that of f cosθ, over cosine-distributed pairs, of the fit written as MERL and read back; f
is the mean of both orders of light and view, as MERL holds no other.
"""

import argparse
import subprocess
from pathlib import Path

import drjit as dr
import glimt
import mitsuba as mi
import numpy as np
from samplers import ANGLES, SAMPLES
from spheres import measured_file, names, render


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("library", type=Path)
    parser.add_argument("--glimt", default="glimt", help="the command")
    parser.add_argument("--measured", type=Path, help="directory with the RGL files of the materials")
    parser.add_argument("--work", type=Path, required=True, help="directory for the exported files")
    parser.add_argument("--envmap", type=Path, help="environment map; a clear sky with sun if not given")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--spp", type=int, default=1024)
    return parser.parse_args()


def export(arguments, source, material, name):
    """The file that `glimt convert` writes."""
    file = arguments.work / name
    if not file.exists():
        chosen = ["--material", material] if material else []
        subprocess.run([arguments.glimt, "convert", source, file, *chosen], check=True)
    return file


def relative_variance(file):
    """Mean over the views of the variance of the weights over their squared mean."""
    bsdf, ratios = mi.load_dict({"type": "measured", "filename": str(file)}), []
    u = np.random.default_rng(1).random((3, SAMPLES), np.float32)
    for theta in ANGLES:
        si = dr.zeros(mi.SurfaceInteraction3f, SAMPLES)
        si.wi = mi.Vector3f(float(np.sin(theta)), 0.0, float(np.cos(theta)))
        _, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(u[0]), mi.Point2f(u[1:]))
        grey = np.array(weight, np.float64).mean(axis=0)
        ratios.append(grey.var() / grey.mean() ** 2)
    return float(np.mean(ratios))


def merl_error(model, file):
    """Of the table against the model, over a million cosine-distributed pairs."""
    rng = np.random.default_rng(2)

    def directions():
        r2, phi = rng.random(1_000_000), 2 * np.pi * rng.random(1_000_000)
        xy = np.sqrt(r2) * np.array([np.cos(phi), np.sin(phi)])
        return np.stack([*xy, np.sqrt(1 - r2)], axis=1).astype(np.float32)

    light, view = directions(), directions()
    truth = 0.5 * (model.eval(light, view) + model.eval(view, light))
    f = glimt.load(file).material().eval(light, view)
    # Cosine-distributed lights carry the cosine already.
    return float(np.abs(f - truth).mean() / truth.mean())


def main():
    arguments = parse_arguments()
    arguments.work.mkdir(parents=True, exist_ok=True)
    mi.set_variant("llvm_ad_rgb")
    library = glimt.load(arguments.library)
    columns = ["error", "noise", "variance: file", "file anew", "fit", "MERL"]
    print(f"{'material':24}" + "".join(f"{column:>15}" for column in columns))
    rows = []
    for name, material in names(library).items():
        ours = {"type": "glimt", "filename": str(arguments.library), "material": material}
        exported = export(arguments, arguments.library, material, f"{name}.fit.bsdf")
        truth, again = (render(ours, arguments, seed) for seed in (1, 2))
        image = render({"type": "measured", "filename": str(exported)}, arguments, 3)
        row = [np.abs(image - truth).mean() / truth.mean(), np.abs(again - truth).mean() / truth.mean()]
        file = measured_file(arguments.measured, name) if arguments.measured else None
        if file:
            anew = export(arguments, file, None, f"{name}.file.bsdf")
            row += [relative_variance(file), relative_variance(anew)]
        else:
            row += [np.nan, np.nan]
        row.append(relative_variance(exported))
        merl = export(arguments, arguments.library, material, f"{name}.fit.binary")
        row.append(merl_error(library[material], merl))
        merl.unlink()
        rows.append(row)
        print(f"{name:24}" + "".join(f"{value:15.4f}" for value in row), flush=True)
    print(f"{'mean':24}" + "".join(f"{value:15.4f}" for value in np.mean(rows, axis=0)))


if __name__ == "__main__":
    main()
