"""The tables of the papers, made again with glimt's fits: one command each.

    python tests/quality/papers.py sizes      hybrid, neural, GGX at equal parameters (table 1, figures 4, 5)
    python tests/quality/papers.py ablation   forms of the hybrid model at 32x3 (table 2)
    python tests/quality/papers.py half       half of the materials in training, half added (table 3)
    python tests/quality/papers.py time       ns for every size (table 4)
    python tests/quality/papers.py sampling   variance of samplers (figures 9 and 10)

Tables and figures are those of the hybrid paper. Materials are the published NBRDF networks for MERL, since
the measurements themselves cannot be passed on: smooth stand-ins, so that errors are against NBRDF. Fits
follow the paper (--paper) for --steps steps, of which the paper takes 200,000; --own follows glimt's recipe
instead. Fits that are in --work are not made again.
"""

import argparse
import csv
import json
import subprocess
from pathlib import Path

import numpy as np

SHARED = Path(__file__).parents[3] / "shared" / "data"
NETS = ["16x2", "16x3", "32x2", "32x3", "64x2", "64x3"]
#: Numbers of a material that are not its latent code: k_d, η and α.
ANALYTIC = 8


class Workshop:
    """Where fits are made and found again."""

    def __init__(self, arguments):
        self.materials = sorted(arguments.materials.glob("*.npz")) or sorted(
            arguments.materials.glob("*.bsdf")
        )
        if not self.materials:
            raise SystemExit(f"{arguments.materials} holds no materials (.npz, .bsdf)")
        self.directory = arguments.work
        self.directory.mkdir(parents=True, exist_ok=True)
        self.recipe = [] if arguments.own else ["--paper"]
        self.prefix = "own" if arguments.own else "paper"
        self.steps = ["--steps", str(arguments.steps)]
        self.glimt = arguments.glimt

    def fit(self, name, *options, materials=None):
        """The library of that name, fitted now if there is none."""
        path = self.directory / f"{self.prefix}-{name}.safetensors"
        if not path.exists():
            files = self.materials if materials is None else materials
            self.run("fit", *self.recipe, *options, "-o", path, *files)
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


COMMANDS = {"sizes": sizes, "ablation": ablation, "half": half, "time": time, "sampling": sampling}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("table", choices=COMMANDS)
    parser.add_argument("--materials", type=Path, default=SHARED / "nbrdf" / "merl", help="directory")
    parser.add_argument("--work", type=Path, default=Path("papers"), help="where fits are kept")
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--own", action="store_true", help="glimt's recipe instead of the paper's")
    parser.add_argument("--nets", nargs="+", default=NETS)
    parser.add_argument("--latents", nargs="+", type=int, default=[4, 8])
    parser.add_argument("--each", action="store_true", help="print every material")
    parser.add_argument("--envmap", type=Path, help="environment map for image errors (.exr)")
    parser.add_argument("--glimt", default="glimt", help="the command")
    arguments = parser.parse_args()
    COMMANDS[arguments.table](Workshop(arguments), arguments)


if __name__ == "__main__":
    main()
