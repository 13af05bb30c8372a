"""glimt: compact and neural BRDFs, fitted to measured reflectance.

    lib = glimt.load("rgl.safetensors")
    f = lib["chm_orange"].eval(light, view)

Importing this package, before or after ``mitsuba.set_variant()``, makes ``<bsdf type="glimt">``
available in Mitsuba scenes.
"""

from . import _mitsuba
from ._mitsuba import pixel_angle
from ._native import Error, Library, Material, __version__, load

__all__ = ["Error", "Library", "Material", "__version__", "has_mitsuba_plugin", "load", "pixel_angle"]

#: Whether Mitsuba is installed and will find the plugin.
has_mitsuba_plugin = _mitsuba.register()
