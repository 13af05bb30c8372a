"""Conformance tests of any Mitsuba BSDF: ``python -m glimt.check TARGET …``.

A target is a scene file (``scene.xml`` for all of its BSDFs, ``scene.xml#id`` for one), a BSDF file, a
description in JSON as ``mitsuba.load_dict`` takes it (``'{"type": "roughconductor", "alpha": 0.1}'``), or the
name of a plugin. The tests are those of ``glimt check``; docs/guide/check.md explains them.

Exit code 0: all passed; 1: one failed; 2: bad usage.
"""

import argparse
import ast
import importlib
import json
import re
import sys
from pathlib import Path

import numpy as np

from . import _native

#: One scalar and one JIT variant.
VARIANTS = ("scalar_rgb", "llvm_ad_rgb")
PROMISES = ("reciprocal", "conserving")
#: Nanometres at which spectral variants are asked; three of them are shown.
WAVELENGTHS = (450.0, 550.0, 650.0, 750.0)


class MitsubaSubject:
    """A Mitsuba BSDF of the current variant as callables over NumPy arrays.

    The attributes and methods are what ``glimt._native.check`` asks for: directions are (n, 3), responses
    include the cosine, and ``component`` is an index or None for all.
    """

    def __init__(self, bsdf, name, promises=(), quick=False):
        import mitsuba

        self.mi, self.variant, self.bsdf = mitsuba, mitsuba.variant(), bsdf
        self.is_scalar = self.variant.startswith("scalar")
        self.is_slow = self.is_scalar or quick
        self.name = f"{name} ({self.variant})"
        flags, names = int(bsdf.flags()), mitsuba.BSDFFlags
        self.claims = {
            "reciprocal": "reciprocal" in promises,
            "conserving": "conserving" in promises,
            "isotropic": not flags & int(names.Anisotropic),
            "transmits": bool(flags & int(names.Transmission)),
            "two_sided": bool(flags & int(names.BackSide)),
        }
        count = bsdf.component_count()
        self.components = [component(mitsuba, int(bsdf.flags(i)), i) for i in range(count)]

    def response(self, component, light, view):
        return self._ask("eval", component, light, view)

    def pdf(self, component, light, view):
        return self._ask("pdf", component, light, view)

    def response_and_pdf(self, component, light, view):
        return self._ask("eval_pdf", component, light, view)

    def sample(self, component, view, u):
        self.mi.set_variant(self.variant)
        context = self._context(component)
        if not self.is_scalar:
            si = self._interaction(view)
            sample, weight = self.bsdf.sample(
                context, si, self.mi.Float(u[:, 0]), self.mi.Point2f(u[:, 1], u[:, 2])
            )
            light = np.broadcast_to(np.array(sample.wo).T, u.shape)
            pdf, kinds, eta = (rows(x, len(u)) for x in (sample.pdf, sample.sampled_type, sample.eta))
            weight = rows(self._colors(weight), len(u))
        else:
            si = self._interaction(view[:1])
            drawn = []
            for direction, (u0, u1, u2) in zip(view.tolist(), u.tolist()):
                si.wi = direction
                sample, weight = self.bsdf.sample(context, si, u0, self.mi.Point2f(u1, u2))
                drawn.append((*sample.wo, sample.pdf, sample.sampled_type, sample.eta, *self._color(weight)))
            drawn = np.array(drawn, np.float64).reshape(-1, 9)
            light, pdf, kinds, eta, weight = np.split(drawn, [3, 4, 5, 6], axis=1)
            pdf, kinds, eta = (x[:, 0] for x in (pdf, kinds, eta))
        # Mitsuba: "A zero spectrum indicates that sampling failed", and all else is undefined then.
        failed = np.all(weight == 0, axis=1)
        defined = (pdf >= 0) & np.isfinite(pdf) & np.isfinite(light).all(axis=1)
        pdf = np.where(failed & ~defined, 0, pdf)
        names = self.mi.BSDFFlags
        delta = (kinds.astype(np.int64) & (int(names.Delta) | int(names.Delta1D))) != 0
        # Reflection has 1, which BSDFs written in Python tend to leave at 0.
        return light, pdf, weight, delta, np.where(eta == 0, 1, eta)

    def _ask(self, method, component, light, view):
        """Values of eval, densities of pdf, or both of eval_pdf, for as many rows."""
        self.mi.set_variant(self.variant)
        context, ask = self._context(component), getattr(self.bsdf, method)
        if not self.is_scalar:
            answer = ask(context, self._interaction(view), self.mi.Vector3f(light.T))
            if method == "pdf":
                return rows(answer, len(view))
            value, pdf = answer if method == "eval_pdf" else (answer, None)
            value = rows(self._colors(value), len(view))
            return value if pdf is None else (value, rows(pdf, len(view)))
        si, answers = self._interaction(view[:1]), []
        for towards, direction in zip(light.tolist(), view.tolist()):
            si.wi = direction
            answers.append(ask(context, si, self.mi.Vector3f(towards)))
        if method == "pdf":
            return np.array(answers)
        if method == "eval":
            return np.array([self._color(value) for value in answers]).reshape(-1, 3)
        values = np.array([self._color(value) for value, _ in answers]).reshape(-1, 3)
        return values, np.array([pdf for _, pdf in answers])

    def _context(self, component):
        context = self.mi.BSDFContext()
        if component is not None:
            context.component = component
        return context

    def _interaction(self, view):
        """Interactions in the middle of a texture, seen from ``view``; in scalar variants one."""
        import drjit as dr

        mi = self.mi
        si = mi.SurfaceInteraction3f() if self.is_scalar else dr.zeros(mi.SurfaceInteraction3f, len(view))
        si.t, si.uv, si.n = 1.0, mi.Point2f(0.5, 0.5), mi.Normal3f(0, 0, 1)
        si.dp_du, si.dp_dv, si.sh_frame = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Frame3f([0, 0, 1])
        if mi.is_spectral:
            si.wavelengths = mi.UnpolarizedSpectrum(*WAVELENGTHS)
        si.wi = view[0].tolist() if self.is_scalar else mi.Vector3f(view.T)
        return si

    def _color(self, value):
        """r, g, b of a scalar variant's spectrum."""
        if self.mi.is_polarized:
            value = self.mi.unpolarized_spectrum(value)
        return self._rgb(np.atleast_1d(np.array(value, np.float64))[:, None])[0]

    def _colors(self, value):
        if self.mi.is_polarized:
            value = self.mi.unpolarized_spectrum(value)
        return self._rgb(np.atleast_2d(np.array(value)))

    @staticmethod
    def _rgb(channels):
        """(channels, n) to (n, 3): one channel thrice, the first three of four."""
        return (np.repeat(channels, 3, axis=0) if len(channels) == 1 else channels[:3]).T


def rows(values, n):
    """``n`` rows of what Dr.Jit may have kept as one, because all are the same."""
    values = np.atleast_1d(np.array(values))
    return np.broadcast_to(values, (n, *values.shape[1:]))


def component(mi, flags, index):
    """Name of a component, and whether it has single directions only."""
    names = mi.BSDFFlags
    kinds = (
        names.Null,
        names.DiffuseReflection,
        names.DiffuseTransmission,
        names.GlossyReflection,
        names.GlossyTransmission,
        names.DeltaReflection,
        names.DeltaTransmission,
    )
    words = [re.sub("([a-z])([A-Z])", r"\1 \2", kind.name).lower() for kind in kinds if flags & int(kind)]
    return f"{index} {' + '.join(words)}", not flags & int(names.Smooth)


def load(target, mi):
    """The BSDFs that a target names: a list of (name, BSDF) of the current variant."""
    text = target.strip()
    if text.startswith("{"):
        try:
            description = json.loads(text)
        except json.JSONDecodeError:
            # Python's spelling, as people copy it from a script.
            try:
                description = ast.literal_eval(text)
            except (SyntaxError, ValueError):
                raise ValueError(f"{target} is not a description in JSON") from None
        return [(label(description), as_bsdf(mi, mi.load_dict(description), target))]
    path, _, wanted = text.partition("#")
    if Path(path).suffix != ".xml":
        return [(text, as_bsdf(mi, mi.load_dict({"type": text}), target))]
    loaded = mi.load_file(path)
    if isinstance(loaded, mi.BSDF):
        return [(Path(path).name, loaded)]
    found = {}
    for shape in loaded.shapes():
        if shape.bsdf() is not None:
            found.setdefault(shape.bsdf().id(), shape.bsdf())
    if not wanted:
        return [(f"{Path(path).name}#{name}", bsdf) for name, bsdf in found.items()]
    if wanted not in found:
        raise ValueError(f"{path}: no shape has the BSDF {wanted!r}; there are {', '.join(sorted(found))}")
    return [(text, found[wanted])]


def as_bsdf(mi, loaded, target):
    if not isinstance(loaded, mi.BSDF):
        raise ValueError(f"{target} is a {type(loaded).__name__}, expected a BSDF")
    return loaded


def label(description):
    """A name for a description: its type, and what is short of the rest."""
    rest = [
        f"{key} {value}"
        for key, value in description.items()
        if key != "type" and isinstance(value, (int, float, str, bool))
    ]
    return ", ".join([str(description.get("type", "?")), *rest])


def parse(arguments):
    parser = argparse.ArgumentParser(
        prog="python -m glimt.check",
        description="Test any Mitsuba BSDF: sampling, weights, energy, components, symmetry, the horizon.",
        epilog="Exit code 0: all passed, perhaps with warnings; 1: one failed; 2: bad usage.",
    )
    parser.add_argument(
        "targets", nargs="+", metavar="TARGET", help="scene.xml, scene.xml#id, a dict in JSON, or a plugin"
    )
    parser.add_argument(
        "--variant", action="append", help=f"Mitsuba variant; repeatable (default: {' and '.join(VARIANTS)})"
    )
    parser.add_argument(
        "--promise", action="append", default=[], choices=PROMISES, help="what the BSDFs must be; repeatable"
    )
    parser.add_argument(
        "--import", dest="modules", action="append", default=[], metavar="MODULE",
        help="Python module to import in every variant, for BSDFs that it registers; repeatable",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--html", metavar="PAGE.html", help="write a page with pictures")
    parser.add_argument(
        "--force", action="store_true", help="replace an existing file that is no page of glimt"
    )
    parser.add_argument(
        "--quick", action="store_true", help="ask JIT variants as little as scalar ones: seconds, less sharp"
    )
    parser.add_argument("--samples", type=int, metavar="N", help="samples for each view")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random numbers (default: 1)")
    return parser, parser.parse_args(arguments)


def subjects(options, mi):
    """Everything that the command line names, in every variant."""
    sys.path.insert(0, "")
    for variant in options.variant or VARIANTS:
        mi.set_variant(variant)
        for name in options.modules:
            module = sys.modules.get(name)
            # A BSDF class is tied to the variant in which its module was executed.
            importlib.reload(module) if module else importlib.import_module(name)
        for target in options.targets:
            for name, bsdf in load(target, mi):
                yield MitsubaSubject(bsdf, name, options.promise, options.quick)


def may_write(page, targets, force):
    """Raises an error if the page cannot be written, or something would be lost by it."""
    _native.probe(page)
    path = Path(page)
    if not path.is_file():
        return
    for target in targets:
        scene = Path(target.partition("#")[0])
        if not target.startswith("{") and scene.is_file() and scene.samefile(path):
            raise ValueError(f"{target} is read, and must not be overwritten by the page {page}")
    with path.open("rb") as file:
        start = file.read(1024)
    if start and not force and not (start.startswith(b"<!doctype html>") and b"glimt" in start):
        raise ValueError(f"{page} is there and is no page of glimt; name another, or replace it with --force")


def main(arguments=None):
    parser, options = parse(arguments)
    try:
        import mitsuba as mi
    except ImportError:
        parser.error("Mitsuba is not installed: pip install 'glimt[mitsuba]'")
    try:
        named = list(subjects(options, mi))
        if options.html:
            may_write(options.html, options.targets, options.force)
    except (ImportError, OSError, RuntimeError, SyntaxError, TypeError, ValueError) as error:
        parser.error(" ".join(str(error).split()))
    report = _native.check(named, samples=options.samples, seed=options.seed)
    print(report.json() if options.json else report.text(), end="\n" if options.json else "")
    if options.html:
        _native.write_whole(options.html, report.html())
    return 0 if report.passed else 1


if __name__ == "__main__":
    sys.exit(main())
