"""Makes Mitsuba find the plugin, and Dr.Jit a libLLVM that works."""

import importlib.metadata
import importlib.util
import math
import os
import re
import subprocess
import warnings
from pathlib import Path

#: The version whose binary interface the plugin was built for.
MITSUBA_VERSION = "3.9.1"

#: With LLVM up to 16, rendering aborts the process ("Cannot select: fmaximum"); 19 is known to work.
OLDEST_LLVM, BEST_LLVM = 17, 19

#: Where Dr.Jit is sent when there are only versions that abort: it then reports an error instead.
NO_LLVM = "/libLLVM-17-or-later-is-not-installed"


def register():
    """Adds the plugin's directory to Mitsuba's file resolver, where Mitsuba is installed.

    Returns whether it did.
    """
    if importlib.util.find_spec("mitsuba") is None:
        return False
    found = importlib.metadata.version("mitsuba")
    if found != MITSUBA_VERSION:
        warnings.warn(
            f"glimt's plugin is built for Mitsuba {MITSUBA_VERSION}, and {found} is installed: "
            f"<bsdf type='glimt'> will not be found. Fix: pip install mitsuba=={MITSUBA_VERSION}",
            RuntimeWarning,
            stacklevel=3,
        )
        return False
    point_drjit_to_llvm()
    import mitsuba

    directory = str(Path(__file__).parent)
    if directory not in (str(path) for path in mitsuba.file_resolver()):
        mitsuba.file_resolver().append(directory)
    return True


def pixel_angle(sensor, spp=1):
    """The angle between neighbouring pixels in the middle of a sensor's image, in radians: ``pixel_angle`` of
    ``<bsdf type="glimt">``.

    ``sensor`` is one of Mitsuba's with a perspective (``perspective``, ``thinlens``). With ``spp`` it is the
    angle between neighbouring samples of ``spp`` a pixel, as Mitsuba scales the differentials of its rays.
    That makes images sharper, and noisier.
    """
    import mitsuba

    parameters = mitsuba.traverse(sensor) if isinstance(sensor, mitsuba.Sensor) else {}
    if "x_fov" not in parameters:
        kind = sensor.class_name() if isinstance(sensor, mitsuba.Sensor) else type(sensor).__name__
        raise TypeError(
            f"sensor is a {kind}, expected a perspective or thinlens sensor: the pixels of others are no "
            f"constant angle apart. Fix: give pixel_angle as a number"
        )
    if not spp >= 1:
        raise ValueError(f"spp is {spp}, expected at least 1 sample a pixel")
    # One number in scalar variants, an array of one in the others.
    x_fov = parameters["x_fov"]
    degrees = x_fov if isinstance(x_fov, float) else x_fov[0]
    # The field of view belongs to the whole film, whatever is cropped out of it.
    return 2 * math.tan(math.radians(degrees) / 2) / sensor.film().size()[0] / math.sqrt(spp)


def point_drjit_to_llvm():
    """Sets ``DRJIT_LIBLLVM_PATH``, unless it is set, to the best libLLVM of the system."""
    if "DRJIT_LIBLLVM_PATH" in os.environ:
        return
    versions = installed_llvm()
    usable = [version for version in versions if version >= OLDEST_LLVM]
    if usable:
        best = min(usable, key=lambda version: abs(version - BEST_LLVM))
        os.environ["DRJIT_LIBLLVM_PATH"] = versions[best]
    elif versions:
        os.environ["DRJIT_LIBLLVM_PATH"] = NO_LLVM
        warnings.warn(
            f"The newest libLLVM found is version {max(versions)}, with which Mitsuba's llvm_* variants "
            f"abort the process, so they are disabled; scalar_* variants work. Fix: install version "
            f"{BEST_LLVM} (Debian, Ubuntu: apt-get install libllvm{BEST_LLVM}), or set DRJIT_LIBLLVM_PATH.",
            RuntimeWarning,
            stacklevel=4,
        )


def installed_llvm():
    """The libLLVM libraries that the dynamic linker or the usual directories have: version -> path."""
    paths = []
    for command in ("ldconfig", "/sbin/ldconfig"):
        try:
            listing = subprocess.run([command, "-p"], capture_output=True, text=True, check=True).stdout
        except (OSError, subprocess.CalledProcessError):
            continue
        paths += re.findall(r"=> (\S*/libLLVM\S*)", listing)
        break
    for pattern in ("lib/*/libLLVM*.so*", "lib64/libLLVM*.so*", "lib/llvm-*/lib/libLLVM*.so*"):
        paths += (str(path) for path in sorted(Path("/usr").glob(pattern)))
    versions = {}
    for path in paths:
        # libLLVM-15.so.1, libLLVM-14.0.6.so.1, libLLVM.so.19.1
        match = re.search(r"/libLLVM(?:-(\d+)[\d.]*\.so|\.so\.(\d+))", path)
        if match and Path(path).exists():
            versions.setdefault(int(match[1] or match[2]), path)
    return versions
