"""The tables of the papers, made again with glimt's fits: one command each.

    python tests/quality/papers.py sizes         hybrid, neural, GGX of equal size (table 1, figures 4, 5)
    python tests/quality/papers.py ablation      forms of the hybrid model at 32x3 (table 2)
    python tests/quality/papers.py half          half of the materials in training, half added (table 3)
    python tests/quality/papers.py time          ns for every size (table 4)
    python tests/quality/papers.py sampling      variance of samplers (figures 9 and 10)

    python tests/quality/papers.py spherical     spherical primitives, NBRDF, factor tables, GGX (its table 3)
    python tests/quality/papers.py quantisation  features, 4-bit features, a codebook (its table 4)
    python tests/quality/papers.py grids         its configurations and pixelations (its figure 8)

The first five are tables of the hybrid paper. Their materials are the published NBRDF networks for MERL,
since the measurements themselves cannot be passed on: smooth stand-ins, so that errors are against NBRDF.
Fits follow the paper (--paper) for --steps steps, of which the paper takes 200,000; --own follows glimt's
recipe instead. The last three are of the paper on spherical primitives, on the twelve RGL measurements; their
fits differ from the paper's as docs/notes/spherical.md says. Fits that are in --work are not made again.
"""

import argparse
import csv
import json
import subprocess
from pathlib import Path

import numpy as np

SHARED = Path(__file__).parents[3] / "shared" / "data"
MERL, RGL = SHARED / "nbrdf" / "merl", SHARED / "rgl"
NETS = ["16x2", "16x3", "32x2", "32x3", "64x2", "64x3"]
#: Numbers of a material that are not its latent code: k_d, η and α.
ANALYTIC = 8
#: The spherical paper's configuration but for the codebook, and its bits.
SPHERICAL = {"grids": "lv", "nside": 64, "features": 16, "net": "64x2"}
CODEBOOK = ("--codebook", "9")


class Workshop:
    """Where fits are made and found again."""

    def __init__(self, directory, arguments):
        self.materials = sorted(directory.glob("*.npz")) or sorted(directory.glob("*.bsdf"))
        if not self.materials:
            raise SystemExit(f"{directory} holds no materials (.npz, .bsdf)")
        self.directory = arguments.work
        self.directory.mkdir(parents=True, exist_ok=True)
        self.recipe = [] if arguments.own else ["--paper"]
        self.prefix = "own" if arguments.own else "paper"
        self.steps = ["--steps", str(arguments.steps)]
        self.glimt = arguments.glimt

    def fit(self, name, *options, materials=None):
        """The library of that name, fitted now if there is none."""
        files = self.materials if materials is None else materials
        return self.made(f"{self.prefix}-{name}", *self.recipe, *options, files=files)

    def made(self, name, *options, files=None):
        """The library of that name, fitted by exactly these options."""
        path = self.directory / f"{name}.safetensors"
        if not path.exists():
            self.run("fit", *options, "-o", path, *(files or self.materials))
        return path

    def run(self, *arguments):
        print("glimt", *arguments[:8], "…", flush=True)
        subprocess.run([self.glimt, *arguments], check=True, stdout=subprocess.DEVNULL)

    def hybrid(self, net, latent=4, *options, name="hybrid", materials=None):
        options = ("--net", net, "--latent", str(latent), *self.steps, *options)
        return self.fit(f"{name}-{net}-l{latent}", "--model", "hybrid", *options, materials=materials)

    def neural(self, net, latent=12):
        options = ("--net", net, "--latent", str(latent), *self.steps)
        return self.fit(f"neural-{net}-l{latent}", "--model", "neural", *options)

    def spherical(self, *options, **form):
        """The paper's configuration with something else in it, and its name in words."""
        form = {**SPHERICAL, **form}
        words = [word for key, value in form.items() for word in (f"--{key}", str(value))]
        name = "-".join(["spherical", *map(str, form.values()), *(word.strip("-") for word in options)])
        return self.made(name, "--model", "spherical", *words, *options, *self.steps)

    def ggx(self):
        return self.fit("ggx", "--model", "ggx")

    def report(self, name, libraries, *options):
        """Rows of the report's table and the study."""
        directory = self.directory / f"report-{self.prefix}-{name}"
        self.run("report", *options, "-o", directory, *libraries, *self.materials)
        with (directory / "report.csv").open() as table:
            return list(csv.DictReader(table)), json.loads((directory / "report.json").read_text())


def errors(library, metric="smape"):
    """{material: error}, as the fit left them in the library."""
    with library.open("rb") as file:
        header = json.loads(file.read(int.from_bytes(file.read(8), "little")))
    materials = json.loads(header["__metadata__"]["glimt"])["materials"]
    return {material["name"]: material["metrics"][metric] for material in materials}


def mean(library, metric="smape"):
    return float(np.mean(list(errors(library, metric).values())))


def sizes(shop, arguments):
    """Equal parameters: a hybrid material with l numbers of code against a neural one with l + 8."""
    ggx = shop.ggx()
    print(f"GGX alone: SMAPE {mean(ggx):.4f}")
    print(f"{'net':6}{'l':>3}{'hybrid':>9}{'neural':>9}{'better on':>12}")
    libraries = [ggx]
    for net in arguments.nets:
        for latent in arguments.latents:
            hybrid, neural = shop.hybrid(net, latent), shop.neural(net, latent + ANALYTIC)
            ours, theirs = errors(hybrid), errors(neural)
            wins = sum(ours[name] < theirs[name] for name in ours)
            line = f"{net:6}{latent:3}{mean(hybrid):9.4f}{mean(neural):9.4f}"
            print(f"{line}{wins:>6} of {len(ours)}", flush=True)
            libraries += [hybrid, neural]
            if arguments.each:
                for name in ours:
                    print(f"  {name:28}{ours[name]:9.4f}{theirs[name]:9.4f}{errors(ggx)[name]:9.4f}")
    if arguments.envmap:
        images(shop, libraries, arguments)


def images(shop, libraries, arguments):
    """Image MAE of spheres under an environment, as the paper's table 1 has it."""
    rows, _ = shop.report(
        "sizes", libraries, "--envmap", arguments.envmap, "--size", "64", "--pairs", "10000"
    )
    light = arguments.envmap.stem
    print(f"{'model':30}{'image MAE':>10}{'FLIP':>9}   ({light})")
    for model in dict.fromkeys(row["model"] for row in rows):
        of = [row for row in rows if row["model"] == model]
        mae, flip = (np.mean([float(row[f"{light}_{metric}"]) for row in of]) for metric in ("mae", "flip"))
        print(f"{model:30}{mae:10.5f}{flip:9.5f}")


def ablation(shop, _):
    forms = {
        "hybrid": (),
        "analytic-input": ("--analytic-input",),
        "additive": ("--composition", "additive"),
        "log-multiplicative": ("--composition", "log-multiplicative"),
        "no-analytic-loss": ("--no-analytic-loss",),
    }
    print(f"{'form':20}{'SMAPE':>8}{'log-MAE':>10}{'its analytic part':>19}")
    for name, options in forms.items():
        library = shop.hybrid("32x3", 4, *options, name=name)
        analytic = mean(library, "analytic_smape")
        print(f"{name:20}{mean(library):8.4f}{mean(library, 'log_mae'):10.5f}{analytic:19.4f}", flush=True)


def half(shop, _):
    """Every second material, by name, trains the network; the others are added to it."""
    trained, added = shop.materials[::2], shop.materials[1::2]
    whole = shop.hybrid("32x3", 4)
    library = shop.hybrid("32x3", 4, name="half", materials=trained)
    together = library.with_name(f"{library.stem}-and-added.safetensors")
    if not together.exists():
        shop.run("add", library, *added, "-o", together)
    all_names, sets = {path.stem for path in shop.materials}, {"trained": trained, "added": added}
    sets = {"all": shop.materials, **sets}
    whole_errors, half_errors = errors(whole), errors(together)
    assert set(half_errors) == all_names, "a material is called after its file"
    print(f"{'materials':10}{'all in training':>16}{'half in training':>18}   SMAPE")
    for name, files in sets.items():
        a, b = (np.mean([table[path.stem] for path in files]) for table in (whole_errors, half_errors))
        print(f"{name:10}{a:16.4f}{b:18.4f}")


def time(shop, arguments):
    models = [shop.ggx()]
    for net in arguments.nets:
        models += [shop.hybrid(net, 4), shop.neural(net, 12)]
    quick = ("--pairs", "1000", "--size", "16", "--spp", "1", "--rounds", "31")
    _, study = shop.report("time", models, *quick)
    print(f"{study['made']['cpu']}, {study['made']['instruction_set']}; ns for a pair, one core")
    print(f"{'model':28}{'batch':>8}{'packet':>8}{'single':>8}")
    for candidate in study["candidates"]:
        ns = [candidate["times"][way]["median"] for way in ("batch", "packet of 8", "single")]
        print(f"{candidate['name']:28}" + "".join(f"{value:8.1f}" for value in ns))


def sampling(shop, _):
    library = shop.hybrid("32x3", 4)
    _, study = shop.report("sampling", [library], "--pairs", "1000", "--size", "16", "--spp", "1")
    subjects = study["subjects"]
    curves = {name: [s["variance"][name] for s in subjects] for name in subjects[0]["variance"]}
    curves["hybrid, its own lobes"] = [s["cases"][0]["variance"] for s in subjects]
    print("variance of a pixel / mean², geometric mean over the materials")
    for name, values in curves.items():
        means = np.exp(np.mean(np.log(np.maximum(values, 1e-12)), axis=0))
        print(f"{name:24}" + "".join(f"{value:10.4f}" for value in means))


def spherical(shop, _):
    """Mean image errors under studio light, on the materials that all models have and on all."""
    named = {
        "GGX": shop.made("ggx", "--model", "ggx"),
        "factor tables": shop.made("factor", "--model", "factor"),
        "NBRDF": SHARED / "nbrdf" / "rgl",
        "spherical, the paper's form": shop.spherical(*CODEBOOK),
        "spherical, glimt's default": shop.made("spherical-default", "--model", "spherical", *shop.steps),
    }
    quick = ("--pairs", "100000", "--size", "96", "--rounds", "1")
    rows, _ = shop.report("spherical", named.values(), *quick)
    by_path = {path: materials_of(rows, path) for path in named.values()}
    common = set.intersection(*(set(of) for of in by_path.values()))
    keys = ["studio_mae", "studio_rmse", "studio_ssim", "studio_psnr", "smape"]
    print(f"{'':30}{'materials':>10}{'MAE':>9}{'RMSE':>9}{'SSIM':>9}{'PSNR':>9}{'SMAPE':>9}")
    for label, path in named.items():
        of = by_path[path]
        for names in [common] if len(of) == len(common) else [common, set(of)]:
            means = [np.mean([float(of[name][key]) for name in names]) for key in keys]
            print(f"{label:30}{len(names):10}" + "".join(f"{value:9.4f}" for value in means))


def materials_of(rows, path):
    """The report's rows of a model's file by material; a directory of NBRDF networks is one model."""
    model = "nbrdf" if path.is_dir() else path.stem
    return {row["material"]: row for row in rows if row["model"] == model}


def compared(shop, name, libraries):
    """Prints the error of each library over the materials, and its bytes a material."""
    quick = ("--pairs", "1000000", "--size", "16", "--spp", "1", "--rounds", "1")
    rows, _ = shop.report(name, libraries.values(), *quick)
    print(f"{'':34}{'MSE of f':>12}{'log-MSE':>11}{'SMAPE':>9}{'log-MAE':>10}{'kB':>9}")
    for label, library in libraries.items():
        of = materials_of(rows, library).values()
        rmse, log_mse, smape, log_mae = (
            np.array([float(row[key]) for row in of]) for key in ("rmse", "log_mse", "smape", "log_mae")
        )
        means = f"{(rmse**2).mean():12.4g}{log_mse.mean():11.3g}{smape.mean():9.4f}{log_mae.mean():10.5f}"
        kilobytes = np.mean([float(row["bytes_per_material"]) for row in of]) / 1000
        print(f"{label:34}{means}{kilobytes:9.1f}", flush=True)


def quantisation(shop, _):
    types = {
        "float16 features": ("--table-type", "f16"),
        "4-bit features": ("--table-type", "i4"),
        "codebook of 9 bits": CODEBOOK,
    }
    compared(shop, "quantisation", {label: shop.spherical(*options) for label, options in types.items()})


def grids(shop, _):
    """One part of the configuration after the other, on grids a quarter as fine as the paper's."""
    forms = {"N 16, 9 bits": {}}
    forms |= {f"network {net}": {"net": net} for net in ("16x2", "32x2")}
    forms |= {f"N {nside}": {"nside": nside} for nside in (8, 32)}
    forms |= {f"{k} features": {"features": k} for k in (4, 8)}
    libraries = {label: shop.spherical(*CODEBOOK, **{"nside": 16, **form}) for label, form in forms.items()}
    for bits in ("5", "7"):
        libraries[f"{bits} bits"] = shop.spherical("--codebook", bits, nside=16)
    # A lattice has no pixels to be bilinear in: all three by the paper's training weights.
    weights = ("--interpolation", "inverse-distance")
    for points in ("healpix", "lat-long", "fibonacci"):
        libraries[f"{points}, inverse distances"] = shop.spherical(
            *CODEBOOK, "--pixelation", points, *weights, nside=16
        )
    compared(shop, "grids", libraries)


#: What there is, and the materials it is made on.
COMMANDS = {
    "sizes": (sizes, MERL),
    "ablation": (ablation, MERL),
    "half": (half, MERL),
    "time": (time, MERL),
    "sampling": (sampling, MERL),
    "spherical": (spherical, RGL),
    "quantisation": (quantisation, RGL),
    "grids": (grids, RGL),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("table", choices=COMMANDS)
    parser.add_argument("--materials", type=Path, help="directory of other materials (.npz, .bsdf)")
    parser.add_argument("--work", type=Path, default=Path("papers"), help="where fits are kept")
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--own", action="store_true", help="glimt's recipe instead of the paper's")
    parser.add_argument("--nets", nargs="+", default=NETS)
    parser.add_argument("--latents", nargs="+", type=int, default=[4, 8])
    parser.add_argument("--each", action="store_true", help="print every material")
    parser.add_argument("--envmap", type=Path, help="environment map for image errors (.exr)")
    parser.add_argument("--glimt", default="glimt", help="the command")
    arguments = parser.parse_args()
    command, materials = COMMANDS[arguments.table]
    command(Workshop(arguments.materials or materials, arguments), arguments)


if __name__ == "__main__":
    main()
