"""Prints the table of plugin/src/primaries.h: reflectance spectra of the sRGB primaries.

Three smooth spectra R, G, B in [0, 1] that sum to 1 at every wavelength and have the linear sRGB
colours (1, 0, 0), (0, 1, 0) and (0, 0, 1) under D65: Mallett & Yuksel 2019, *Spectral Primary
Decomposition for Rendering with sRGB Reflectance*. Solved here with Mitsuba's own tables, so that
its film returns the colours that were put in.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.optimize import minimize

FIRST, LAST, STEP = 360, 830, 10


def color_of_nodes():
    """The matrix from the values at the nodes to linear sRGB under D65, by linear interpolation."""
    mi.set_variant("llvm_ad_spectral")
    fine = np.arange(FIRST, LAST + 0.5, 0.5)
    si = dr.zeros(mi.SurfaceInteraction3f, len(fine))
    si.wavelengths = mi.Spectrum(mi.Float(fine))
    light = np.array(mi.load_dict({"type": "d65"}).eval(si))[0]
    xyz = np.array(mi.cie1931_xyz(mi.Float(fine)))
    srgb = np.array(mi.xyz_to_srgb(mi.Color3f(*(light * xyz))))
    nodes = np.arange(FIRST, LAST + STEP, STEP)
    hats = np.maximum(0, 1 - np.abs(fine[:, None] - nodes) / STEP)
    matrix = srgb @ hats
    return matrix / matrix.sum(axis=1, keepdims=True)


def solve(color):
    """R, G and B at the nodes, (3, nodes)."""
    n = color.shape[1]

    def split(x):
        red, green = x[:n], x[n:]
        return np.stack([red, green, 1 - red - green])

    def roughness(x):
        slopes = np.diff(split(x), axis=1)
        gradient = np.zeros((3, n))
        gradient[:, 1:] += 2 * slopes
        gradient[:, :-1] -= 2 * slopes
        return np.sum(slopes**2), np.concatenate([gradient[0] - gradient[2], gradient[1] - gradient[2]])

    zero = np.zeros_like(color)
    targets = np.block([[color, zero], [zero, color]])
    result = minimize(
        roughness,
        np.full(2 * n, 1 / 3),
        jac=True,
        method="SLSQP",
        bounds=[(0, 1)] * (2 * n),
        constraints=[
            {
                "type": "eq",
                "fun": lambda x: targets @ x - [1, 0, 0, 0, 1, 0],
                "jac": lambda x: targets,
            },
            {
                "type": "ineq",
                "fun": lambda x: 1 - x[:n] - x[n:],
                "jac": lambda x: -np.hstack([np.eye(n), np.eye(n)]),
            },
        ],
        options={"maxiter": 1000, "ftol": 1e-14},
    )
    if not result.success:
        raise RuntimeError(result.message)
    return np.clip(split(result.x), 0, 1)


if __name__ == "__main__":
    color = color_of_nodes()
    spectra = solve(color)
    print("colours:", (spectra @ color.T).round(5).tolist())
    for red, green, _ in spectra.T:
        print(f"    {red:.6f}f, {green:.6f}f,")
