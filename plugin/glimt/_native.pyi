from collections.abc import Iterator, Sequence
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

Float32 = NDArray[np.float32]

class Error(Exception):
    """A file that cannot be used, a material that is not there, or a parameter out of its range."""

def load(path: str | PathLike[str], *, sampler: str | None = None) -> Library:
    """Opens a model library, a measurement (RGL .bsdf, MERL .binary, UTIA .bin) or NBRDF weights.

    ``sampler`` gives all materials another sampler, see ``Material.with_sampler``.
    """

class Library:
    """The materials of a file. Immutable.

    Pickles as the bytes of a model library. What such a library cannot hold, measurements and scattered
    samples, pickles as the absolute path and the SHA-256 of its file, which is read again where the pickle
    is loaded; a file that has changed or is not there raises ``Error``.
    """

    @property
    def materials(self) -> list[str]:
        """Names of the materials in the file's order."""
    @property
    def kind(self) -> str:
        """Model ("hybrid") or measured format ("merl"), as commands spell it."""
    @property
    def path(self) -> PathLike[str]:
        """The file that it was read from."""
    def material(self, name: str | None = None) -> Material:
        """The material of that name; the only one if no name is given."""
    def mix(self, a: str, b: str, weight: float) -> Material:
        """A material between the two of those names, with a share ``weight`` in [0, 1] of the second.

        Models whose materials share a network, and ggx, can be mixed.
        """
    def __getitem__(self, name: str) -> Material: ...
    def __contains__(self, name: str) -> bool: ...
    def __iter__(self) -> Iterator[str]: ...
    def __len__(self) -> int: ...

class Material:
    """A material: a fitted model, or a measured table as it is. Immutable.

    Pickles with its edits and its sampler; a measurement by its file, as ``Library`` says.

    Directions are unit vectors in the local frame with the normal +z, and point away from the surface:
    ``light`` to where the energy comes from, ``view`` to where it goes. Arrays (n, 3), or (3,) for one;
    one direction goes with many. float64 is converted to float32. The work is shared among all cores,
    with the GIL released.

    A surface (``is_surface``) is another material at every place. ``uv`` says where, (n, 2), or (2,) for one:
    u to the right, v up, a tile is [0, 1) x [0, 1). ``footprint`` says how much is seen around it, as the
    standard deviation of a Gaussian in uv: one number, (n,), or the two axes (2, 2), (n, 2, 2) that a round
    Gaussian becomes, each a row. Without it a point is seen. A pixel sees about half of what uv changes by
    to the next. Without ``uv`` a surface is what it is from afar: its far field. Where any argument has n
    rows, so has the result. The numbers of ``uv`` and ``footprint`` mean nothing to a material that is no
    surface.
    """

    @property
    def name(self) -> str:
        """The name."""
    @property
    def kind(self) -> str:
        """Model or measured format, as in ``Library.kind``."""
    @property
    def is_surface(self) -> bool:
        """Whether the material is another at every place of a surface."""
    @property
    def oddities(self) -> list[str]:
        """What is odd about the file of a measurement, and what was made of it; empty for models."""
    @property
    def kd(self) -> tuple[float, float, float] | None:
        """Diffuse albedo, linear RGB; None where the model has no analytic part."""
    @property
    def eta(self) -> tuple[float, float, float] | None:
        """Relative index of refraction per channel; None where the model has no analytic part."""
    @property
    def alpha(self) -> tuple[float, float] | None:
        """GGX roughness along x and y; None where the model has no analytic part."""
    @property
    def latent(self) -> Float32:
        """The latent code; empty where the model has none."""
    def edit(
        self,
        *,
        kd: float | Sequence[float] | None = None,
        eta: float | Sequence[float] | None = None,
        alpha: float | Sequence[float] | None = None,
    ) -> Material:
        """A copy with other parameters of its analytic part, and a sampler that follows them.

        kd and eta take three numbers, alpha two, and each also one number for all.
        """
    @property
    def sampler(self) -> str:
        """Name of the sampler: "lobes", "table" or "warp" (a measurement's own)."""
    @property
    def sampler_bytes(self) -> int:
        """Bytes of the sampler's tables; 0 for lobes and for a measurement's own warp."""
    def with_sampler(self, sampler: str) -> Material:
        """A copy with another sampler, which is made when it is first asked for.

        "lobes", "table", "table:paper" or "table:VIEWSxRINGSxSECTORS".
        """
    def eval(
        self,
        light: ArrayLike,
        view: ArrayLike,
        uv: ArrayLike | None = None,
        footprint: ArrayLike | None = None,
    ) -> Float32:
        """f_r(light, view) in 1/sr, linear RGB, without the cosine: (n, 3), or (3,) for one pair.

        Below the horizon, and for NaN, f is 0.
        """
    def pdf(
        self,
        light: ArrayLike,
        view: ArrayLike,
        uv: ArrayLike | None = None,
        footprint: ArrayLike | None = None,
    ) -> Float32 | float:
        """Density in 1/sr with which ``sample`` chooses ``light`` for ``view``: (n,), or a float."""
    def sample(
        self,
        view: ArrayLike,
        u: ArrayLike,
        uv: ArrayLike | None = None,
        footprint: ArrayLike | None = None,
    ) -> tuple[Float32, Float32 | float, Float32]:
        """Light directions for ``view`` from random numbers ``u`` in [0, 1).

        Returns (light, pdf, weight), where weight = f cos(theta_light) / pdf. A sample that failed has
        pdf 0 and weight 0.
        """
