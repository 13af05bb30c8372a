"""Serves the values of a Mitsuba BSDF to another process: ``python3 -m glimt.simulate SCENE [ID]``.

``glimt fit --from-mitsuba`` starts it. SCENE is a scene (.xml), whose BSDF ``ID`` a shape uses, or a
dictionary of a BSDF or a scene as ``mitsuba.load_dict`` takes it (.json). The first line of the standard
output is a JSON object: ``{"name": …, "anisotropic": …, "variant": …}``, or ``{"error": …}`` and the end.
Then every request on the standard input is a little-endian uint32 n and 6 n float32, light x y z and view
x y z for each pair, and is answered by the uint32 0 and 3 n float32: f_r in 1/sr, linear RGB, without the
cosine. Where the BSDF throws, the answer is the length of a message in bytes, the message, and the end.
"""

import difflib
import json
import os
import sys

#: The first of these that works here is used.
VARIANTS = ("llvm_ad_rgb", "scalar_rgb")
#: Where on the surface a textured BSDF is looked at.
UV = (0.5, 0.5)


class SimulationError(Exception):
    """What the user can do something about."""


def import_mitsuba():
    """The module with a variant that evaluates RGB, and the variant's name."""
    try:
        import mitsuba
    except ImportError as error:
        raise SimulationError(f"Mitsuba is not installed ({error}); fix: pip install mitsuba") from error
    from . import _mitsuba

    _mitsuba.point_drjit_to_llvm()
    for variant in VARIANTS:
        try:
            mitsuba.set_variant(variant)
            import drjit

            if not variant.startswith("llvm") or drjit.has_backend(drjit.JitBackend.LLVM):
                return mitsuba, variant
        except (ImportError, AttributeError):
            continue
    raise SimulationError(f"Mitsuba has none of the variants {', '.join(VARIANTS)}")


def load_bsdf(mi, path, name):
    """The BSDF ``name`` of the file, and its name; the only one of its file if none is given."""
    if not os.path.exists(path):
        raise SimulationError(f"cannot read {path}: no such file")
    try:
        if path.lower().endswith(".json"):
            with open(path, encoding="utf-8") as file:
                loaded = mi.load_dict(json.load(file))
        else:
            loaded = mi.load_file(path)
    except (RuntimeError, ValueError, TypeError) as error:
        raise SimulationError(f"{path} cannot be loaded: {error}") from error
    if isinstance(loaded, mi.BSDF):
        return loaded, name or os.path.splitext(os.path.basename(path))[0]
    if not isinstance(loaded, mi.Scene):
        raise SimulationError(f"{path} holds a {type(loaded).__name__}, expected a scene or a BSDF")
    return choose_bsdf(loaded.shapes(), path, name)


def choose_bsdf(shapes, path, name):
    """The BSDF ``name`` of some shapes, and its name; the only one if none is given."""
    bsdfs = []
    for shape in shapes:
        bsdf = shape.bsdf()
        if bsdf is not None and not any(bsdf is other for other in bsdfs):
            bsdfs.append(bsdf)
    wanted = [bsdf for bsdf in bsdfs if bsdf.id() == name] if name else bsdfs
    if len(wanted) == 1:
        stem = os.path.splitext(os.path.basename(path))[0]
        return wanted[0], name or wanted[0].id() or stem
    if len(wanted) > 1:
        what = f'has {len(wanted)} BSDFs with the id "{name}"' if name else f"has {len(wanted)} BSDFs"
        raise SimulationError(
            f"{path} {what}; give them ids of their own and name one with --bsdf: {listed(wanted)}"
        )
    near = difflib.get_close_matches(name or "", [bsdf.id() for bsdf in bsdfs if bsdf.id()], n=3)
    what = f'has no BSDF "{name}" on a shape' if name else "has no BSDF on a shape"
    raise SimulationError(f"{path} {what}; there are: {', '.join(near) or listed(bsdfs)}")


def listed(bsdfs, most=12):
    """The BSDFs in words, by their ids or, where they have none, by their classes."""
    words = [bsdf.id() or f"a {bsdf.class_name()} without id" for bsdf in bsdfs[:most]]
    return ", ".join(words + ["…"] * (len(bsdfs) > most)) or "none"


def evaluator(mi, bsdf, variant):
    """A function from (6, n) float32 to (n, 3) float32."""
    import drjit as dr
    import numpy as np

    context = mi.BSDFContext()

    def interaction(view, n):
        si = dr.zeros(mi.SurfaceInteraction3f, n) if n else dr.zeros(mi.SurfaceInteraction3f)
        si.wi = view
        si.uv = mi.Point2f(*UV)
        si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
        si.n = mi.Normal3f(0, 0, 1)
        si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
        si.t = 1.0
        return si

    def without_cosine(value, pairs):
        cos = np.abs(pairs[2])
        lit = (pairs[2] > 0) & (pairs[5] > 0)
        f = np.where(lit, value / np.where(lit, cos, 1), 0)
        return np.ascontiguousarray(f.T, "<f4")

    def batch(pairs):
        # Dr.Jit has no operations on nothing.
        if pairs.shape[1] == 0:
            return np.zeros((0, 3), "<f4")
        light, view = mi.Vector3f(pairs[:3]), mi.Vector3f(pairs[3:])
        value = bsdf.eval(context, interaction(view, pairs.shape[1]), light)
        return without_cosine(np.array(value), pairs)

    def one_by_one(pairs):
        def value(pair):
            light, view = (mi.Vector3f(*(float(x) for x in v)) for v in (pair[:3], pair[3:]))
            return np.array(bsdf.eval(context, interaction(view, 0), light))

        values = [value(pair) for pair in pairs.T]
        return without_cosine(np.stack(values, axis=1) if values else np.zeros((3, 0)), pairs)

    return one_by_one if variant.startswith("scalar") else batch


def serve(path, name, requests, answers):
    """Answers until there are no more requests."""
    import numpy as np

    mi, variant = import_mitsuba()
    bsdf, name = load_bsdf(mi, path, name)
    evaluate = evaluator(mi, bsdf, variant)
    anisotropic = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Anisotropic)
    hello = {"name": name, "anisotropic": anisotropic, "variant": variant}
    answers.write(json.dumps(hello).encode() + b"\n")
    answers.flush()
    while header := requests.read(4):
        n = int.from_bytes(header, "little")
        pairs = np.frombuffer(requests.read(24 * n), "<f4").reshape(n, 6)
        try:
            values = evaluate(np.ascontiguousarray(pairs.T)).tobytes()
        except Exception as error:  # Whatever a BSDF throws.
            message = in_a_line(error).encode()
            answers.write(len(message).to_bytes(4, "little") + message)
            raise SystemExit(1) from error
        answers.write(bytes(4) + values)
        answers.flush()


def in_a_line(error):
    """What an exception says, and its type where that is not all of it."""
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words}" if words else type(error).__name__


def main():
    """The command."""
    # Whatever prints to the standard output from now on prints to the error stream instead.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    if not 2 <= len(sys.argv) <= 3:
        sys.exit("usage: python3 -m glimt.simulate SCENE [ID]")
    try:
        serve(sys.argv[1], sys.argv[2] if len(sys.argv) == 3 else "", sys.stdin.buffer, answers)
    except SimulationError as error:
        answers.write(json.dumps({"error": " ".join(str(error).split())}).encode() + b"\n")
        sys.exit(1)


if __name__ == "__main__":
    main()
