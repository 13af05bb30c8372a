"""Fits factor tables to materials in MERL and RGL format, renders them, and prints PSNR beside other models'.

    python tests/quality/factor.py --glimt target/release/glimt --nbrdf DIRECTORY --rgl DIRECTORY \\
        --fits DIRECTORY --envmaps park.exr studio.exr --work OUT

The materials in MERL format are NBRDF networks (.npz) that `glimt convert` writes to MERL's grid: the truth
of a picture is that table, answered with linear interpolation. Those in RGL's format are the measurements.

The renderer is deterministic and the same for every model: light from an environment map without shadows,
2,048 light directions at every pixel, half of them from the map and half from lobes of several widths,
weighted by the density of the mixture. A picture of a model differs from that of the truth by f alone. PSNR
is the paper's: linear radiance over the pixels of the object, and the truth's brightest channel value as
the peak.
"""

import argparse
import subprocess
from pathlib import Path

import glimt
import mitsuba as mi
import numpy as np

MERL = [
    "violet-rubber",
    "neoprene-rubber",
    "pink-felt",
    "blue-fabric",
    "polyurethane-foam",
    "yellow-paint",
    "green-plastic",
    "white-acrylic",
    "gold-metallic-paint",
    "silver-paint",
    "brass",
    "chrome",
]
PUBLISHED = {
    "cook-torrance (Ngan)": "ngan_cooktorrance.fit",
    "ward (Ngan)": "ngan_ward.fit",
    "ashikhmin-shirley (Ngan)": "ngan_ashikhminshirley.fit",
    "microfacet (Low)": "low_lowmicrofacet_E2.fit",
    "shifted gamma (Bagher)": "bagher_sgd.fit",
}
VARIANTS = ["bivariate", "independent-g", "g-from-d", "naive"]


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--glimt", default="glimt", help="the command")
    parser.add_argument("--nbrdf", type=Path, help="directory with NBRDF networks of MERL materials (.npz)")
    parser.add_argument("--rgl", type=Path, help="directory with RGL files (.bsdf)")
    parser.add_argument("--fits", type=Path, help="directory with published analytic fits (.fit)")
    parser.add_argument("--envmaps", type=Path, nargs="+", required=True, help="environment maps")
    parser.add_argument("--work", type=Path, required=True, help="directory for fits, tables and pictures")
    parser.add_argument("--interpolation", default="linear", choices=["linear", "nearest"])
    parser.add_argument("--size", type=int, default=40, help="pixels of a picture's edge")
    parser.add_argument("--lights", type=int, default=2048, help="light directions a pixel")
    parser.add_argument("--only", nargs="+", help="materials to measure; all if not given")
    parser.add_argument("--pictures", action="store_true", help="save the pictures and what they miss")
    return parser.parse_args()


class Light:
    """An environment map as a table over directions that can be looked up and sampled."""

    def __init__(self, path):
        bitmap = mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
        # Colours outside of sRGB are negative in some maps, around their suns.
        radiance = np.maximum(np.array(bitmap), 0)
        # Pixels of the map that are smaller than a sun would need far more lights.
        rows, columns = 64, 128
        shape = (rows, radiance.shape[0] // rows, columns, radiance.shape[1] // columns, 3)
        self.radiance = radiance.reshape(shape).mean(axis=(1, 3))
        theta = (np.arange(rows) + 0.5) / rows * np.pi
        weight = self.radiance.mean(axis=2) * np.sin(theta)[:, None]
        self.probability = weight / weight.sum()
        self.density = self.probability / (np.sin(theta)[:, None] * (np.pi / rows) * (2 * np.pi / columns))
        self.cumulative = np.cumsum(self.probability.ravel())

    def cell(self, direction):
        """Row and column; the map's top is +y."""
        rows, columns = self.probability.shape
        row = np.arccos(np.clip(direction[:, 1], -1, 1)) / np.pi * rows
        column = np.arctan2(direction[:, 0], -direction[:, 2]) / (2 * np.pi) % 1 * columns
        return row.astype(int).clip(0, rows - 1), column.astype(int).clip(0, columns - 1)

    def sample(self, u):
        rows, columns = self.probability.shape
        cell = np.searchsorted(self.cumulative, u[:, 0] * self.cumulative[-1], side="right")
        row, column = np.divmod(cell.clip(0, rows * columns - 1), columns)
        theta = (row + u[:, 1]) / rows * np.pi
        phi = (column + u[:, 2]) / columns * 2 * np.pi
        sin = np.sin(theta)
        return np.stack([sin * np.sin(phi), np.cos(theta), -sin * np.cos(phi)], axis=1)


def shapes(size):
    """Normals of the pixels of an object, seen along −z: a sphere, and a plate with waves, by name."""
    x, y = (np.stack(np.meshgrid(np.arange(size), np.arange(size))) + 0.5) / size * 2 - 1
    inside = x**2 + y**2 < 0.998
    z = np.sqrt(np.where(inside, 1 - x**2 - y**2, 0))
    sphere = np.stack([x, -y, z], axis=-1)[inside]
    slope = 1.4 * np.stack([np.cos(9 * x) * np.cos(4 * y), np.sin(9 * x + 1) * np.sin(7 * y)], axis=-1)
    waves = np.concatenate([-slope, np.ones((size, size, 1))], axis=-1).reshape(-1, 3)
    waves /= np.linalg.norm(waves, axis=1, keepdims=True)
    return {"sphere": (sphere, inside), "waves": (waves, np.ones((size, size), bool))}


def frame(normals):
    """Rows are the tangent, the bitangent and the normal (Duff et al. 2017)."""
    x, y, z = normals.T
    sign = np.where(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    tangent = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1)
    bitangent = np.stack([b, sign + y * y * a, -y], axis=1)
    return np.stack([tangent, bitangent, normals], axis=1)


def evenly(n):
    """Points of a sequence that fills the cube evenly (Roberts 2018)."""
    steps = np.array([0.819_172_513, 0.671_043_607, 0.549_700_478])
    return (0.5 + np.arange(n)[:, None] * steps) % 1


class Scene:
    """Fixed pairs of directions and what each is worth for a pixel, for one truth, shape and light."""

    def __init__(self, normals, light, lights):
        self.lights = lights
        view = frame(normals)[:, :, 2]
        rng = np.random.default_rng(1)
        half = lights // 2
        directions, density = [], []
        frames = frame(normals)
        # Lights from a mixture of the map and GGX-like half vectors of three widths and a cosine: every
        # model is seen by the same lights, whoever they suit.
        alphas = np.array([0.02, 0.1, 0.35])
        for to_local, v in zip(frames, view):
            u = (evenly(lights) + rng.random(3)) % 1
            from_map = light.sample(u[:half]) @ to_local.T
            chosen = np.minimum((u[half:, 0] * 4).astype(int), 3)
            r2 = u[half:, 1]
            alpha = alphas[np.minimum(chosen, 2)]
            tan2 = alpha**2 * r2 / (1 - r2 + 1e-12)
            cos = np.where(chosen < 3, 1 / np.sqrt(1 + tan2), np.sqrt(1 - r2))
            sin, phi = np.sqrt(np.maximum(0, 1 - cos**2)), 2 * np.pi * u[half:, 2]
            w = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=1)
            mirrored = 2 * (w @ v)[:, None] * w - v
            both = np.concatenate([from_map, np.where((chosen < 3)[:, None], mirrored, w)])
            both /= np.linalg.norm(both, axis=1, keepdims=True)
            h = both + v
            h /= np.maximum(np.linalg.norm(h, axis=1, keepdims=True), 1e-9)
            cos_h, cos_d = np.maximum(h[:, 2], 1e-6), np.maximum(h @ v, 1e-6)
            world = both @ to_local
            p = 0.5 * light.density[light.cell(world)] + 0.5 * 0.25 * np.maximum(both[:, 2], 0) / np.pi
            for a in alphas:
                ndf = a**2 / (np.pi * (cos_h**2 * (a**2 - 1) + 1) ** 2)
                p += 0.5 * 0.25 * ndf * cos_h / (4 * cos_d)
            lit = (both[:, 2] > 0) & (v[2] > 0)
            directions.append(np.where(lit[:, None], both, [0, 0, -1]))
            density.append(
                np.where(lit[:, None], light.radiance[light.cell(world)] * both[:, 2:3] / p[:, None], 0)
            )
        self.light = np.concatenate(directions).astype(np.float32)
        self.view = np.repeat(view, lights, axis=0).astype(np.float32)
        self.worth = (np.concatenate(density) / lights).astype(np.float32)

    def render(self, material):
        """Radiance of every pixel, (pixels, 3)."""
        f = material.eval(self.light, self.view)
        return (f * self.worth).reshape(-1, self.lights, 3).sum(axis=1, dtype=np.float64)


def run(command):
    subprocess.run([str(word) for word in command], check=True, stdout=subprocess.DEVNULL)


def psnr(truth, image):
    return 10 * np.log10(truth.max() ** 2 / np.mean((truth - image) ** 2))


def material_of(file):
    return file.name.split(".")[0]


def models(arguments, truth):
    """Every model of a material: name -> material."""
    work, name = arguments.work, material_of(truth)
    fits = {variant: ["factor", "--variant", variant] for variant in VARIANTS} | {"ggx": ["ggx"]}
    result = {}
    for model, options in fits.items():
        if model != "ggx":
            options = [*options, "--interpolation", arguments.interpolation]
        file = work / (".".join([name, model, *options[4:]]) + ".safetensors")
        if not file.exists():
            run([arguments.glimt, "fit", "--model", *options, truth, "-o", file])
        result[model] = glimt.load(file).material()
    for label, published in PUBLISHED.items() if arguments.fits and truth.suffix == ".binary" else ():
        library = glimt.load(arguments.fits / published)
        if name in library:
            result[label] = library[name]
    return result


def save(path, images, inside):
    """The pictures of one material side by side; below them what each misses, four times as bright."""
    exposure = 0.8 / np.percentile(images[0], 95)
    rows = [images, [4 * np.abs(image - images[0]) for image in images]]
    picture = []
    for row in rows:
        tiles = []
        for image in row:
            tile = np.ones((*inside.shape, 3))
            tile[inside] = np.clip(image * exposure, 0, 1)
            tiles.append(tile)
        picture.append(np.concatenate(tiles, axis=1))
    bitmap = mi.Bitmap(np.concatenate(picture).astype(np.float32))
    mi.util.write_bitmap(str(path), bitmap, write_async=False)


def cells(row, columns):
    return "".join(f"{row[column]:13.1f}" if column in row else f"{'-':>13}" for column in columns)


def table(title, results, columns):
    """The means over the materials."""
    mean = {
        column: np.mean([row[column] for row in results.values() if column in row])
        for column in columns
        if any(column in row for row in results.values())
    }
    print(f"{'mean':24}" + cells(mean, columns))
    print(f"{'materials':24}" + "".join(f"{sum(c in r for r in results.values()):13}" for c in columns))
    print(f"{title}: PSNR in dB, mean over shapes and lights\n")


def main():
    arguments = parse_arguments()
    mi.set_variant("scalar_rgb")
    arguments.work.mkdir(parents=True, exist_ok=True)
    groups = {}
    if arguments.nbrdf:
        tables = [arguments.work / f"{name}.binary" for name in MERL]
        for file in tables:
            if not file.exists():
                run([arguments.glimt, "convert", arguments.nbrdf / f"{file.stem}.npz", file])
        groups["MERL format, from NBRDF networks"] = tables
    if arguments.rgl:
        groups["RGL measurements"] = sorted(arguments.rgl.glob("*.bsdf"))
    scenes = {}
    for path in arguments.envmaps:
        light = Light(path)
        for shape, (normals, inside) in shapes(arguments.size).items():
            scenes[f"{shape}_{path.stem}"] = Scene(normals, light, arguments.lights), inside
    columns = [*VARIANTS, "ggx", *PUBLISHED]
    print(f"{'':24}" + "".join(f"{column[:12]:>13}" for column in columns))
    for title, truths in groups.items():
        results = {}
        for truth in truths:
            name = material_of(truth)
            if arguments.only and name not in arguments.only:
                continue
            measured, materials, row = glimt.load(truth).material(), models(arguments, truth), {}
            for label, (scene, inside) in scenes.items():
                pictures = [scene.render(measured)]
                for model, material in materials.items():
                    pictures.append(scene.render(material))
                    row[model] = row.get(model, 0) + psnr(pictures[0], pictures[-1]) / len(scenes)
                if arguments.pictures:
                    save(arguments.work / f"{name}_{label}.png", pictures, inside)
            results[name] = row
            print(f"{name:24}" + cells(row, columns), flush=True)
        if results:
            table(title, results, columns)


if __name__ == "__main__":
    main()
