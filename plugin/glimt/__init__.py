"""glimt: compact and neural BRDFs, fitted to measured reflectance.

Importing this package, before or after ``mitsuba.set_variant()``, makes ``<bsdf type="glimt">``
available in Mitsuba scenes.
"""

from . import _mitsuba

__all__ = ["has_mitsuba_plugin"]

#: Whether Mitsuba is installed and will find the plugin.
has_mitsuba_plugin = _mitsuba.register()
