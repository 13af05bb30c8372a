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
    "write_libraries",
]


def interaction(view):
    """A surface interaction of the current variant whose ``wi`` is ``view``, (3, n)."""
    si = dr.zeros(mi.SurfaceInteraction3f, view.shape[1])
    si.wi = mi.Vector3f(view)
    return si


def load(library, material="orange", **edits):
    """The plugin as a scene would load it."""
    return mi.load_dict({"type": "glimt", "filename": str(library), "material": material, **edits})
