"""What the tests of the Mitsuba plugin share: its modules, and how it is loaded."""

import pytest
from model_libraries import (
    LIBRARIES,
    MICROFACET,
    TRACED,
    hemisphere,
    network_tensors,
    save_safetensors,
    write_libraries,
)

mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
dr = pytest.importorskip("drjit")
pytest.importorskip("glimt", reason="the package is not installed: pip install .")

__all__ = [
    "FAR",
    "LIBRARIES",
    "MICROFACET",
    "TRACED",
    "dr",
    "hemisphere",
    "interaction",
    "load",
    "mi",
    "network_tensors",
    "save_safetensors",
    "scalar_interaction",
    "write_libraries",
]


# What uv changes by to the next pixel where a surface is seen from so far that it has no places.
FAR = 1e9


def interaction(view):
    """A surface interaction of the current variant whose ``wi`` is ``view``, (3, n), seen from afar."""
    si = dr.zeros(mi.SurfaceInteraction3f, view.shape[1])
    si.wi = mi.Vector3f(view)
    si.duv_dx, si.duv_dy = mi.Vector2f(FAR, 0), mi.Vector2f(0, FAR)
    return si


def scalar_interaction():
    """The same of a scalar variant, whose ``wi`` is to be set."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.duv_dx, si.duv_dy = [FAR, 0], [0, FAR]
    return si


def load(library, material="orange", **edits):
    """The plugin as a scene would load it."""
    return mi.load_dict({"type": "glimt", "filename": str(library), "material": material, **edits})
