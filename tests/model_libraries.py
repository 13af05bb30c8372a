"""Small model libraries of every kind with random materials, and directions to ask them for."""

import json

import numpy as np

MICROFACET = {
    "orange": ([0.55, 0.21, 0.04], [1.5, 1.5, 1.5], [0.25]),
    "metal": ([0.02, 0.02, 0.03], [4.0, 3.1, 2.2], [0.12]),
    "rough": ([0.30, 0.35, 0.40], [1.4, 1.6, 1.8], [0.60]),
}
BRUSHED = {"brushed": ([0.05, 0.06, 0.08], [3.0, 2.6, 2.4], [0.15, 0.45])}

# Every kind of model, and of the hybrid every choice of inputs and of composition.
LIBRARIES = {
    "ggx": {"kind": "ggx"},
    "brushed": {"kind": "ggx", "anisotropic": True},
    "hybrid": {"kind": "hybrid", "inputs": "cartesian"},
    "hybrid_isotropic": {"kind": "hybrid", "inputs": "isotropic"},
    "hybrid_isotropic_reciprocal": {"kind": "hybrid", "inputs": "isotropic-reciprocal", "analytic": True},
    "hybrid_anisotropic": {"kind": "hybrid", "inputs": "anisotropic", "anisotropic": True},
    "hybrid_anisotropic_reciprocal": {
        "kind": "hybrid",
        "inputs": "anisotropic-reciprocal",
        "anisotropic": True,
    },
    "hybrid_additive": {"kind": "hybrid", "inputs": "cartesian", "composition": "additive"},
    "hybrid_multiplicative": {
        "kind": "hybrid",
        "inputs": "cartesian",
        "composition": "log-multiplicative",
    },
    "neural": {"kind": "neural"},
    "nbrdf": {"kind": "nbrdf"},
    "spherical": {"kind": "spherical"},
}

# Those that Dr.Jit can differentiate; the others are calls into the core.
TRACED = [name for name, library in LIBRARIES.items() if library["kind"] != "spherical"]

# Two small hemispheres of features, of lights and of views.
SPHERICAL_FORM = {
    "grids": "lv",
    "pixelation": "healpix",
    "nside": 4,
    "nodes": 2,
    "features": 4,
    "interpolation": "bilinear",
    "store": "f32",
}


def save_safetensors(path, tensors, metadata):
    """Writes the container: length of the header, header, float32 data."""
    header, offset = {"__metadata__": metadata}, 0
    for name, tensor in tensors.items():
        header[name] = {
            "dtype": "F32",
            "shape": list(tensor.shape),
            "data_offsets": [offset, offset + 4 * tensor.size],
        }
        offset += 4 * tensor.size
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    data = b"".join(np.ascontiguousarray(t, np.float32).tobytes() for t in tensors.values())
    path.write_bytes(len(text).to_bytes(8, "little") + text + data)


def network_tensors(rng, sizes, last_bias, leading=()):
    """Random layers whose outputs stay near ``last_bias``."""
    tensors = {}
    for i, (inputs, outputs) in enumerate(zip(sizes[:-1], sizes[1:])):
        weight = rng.normal(0, np.sqrt(1.5 / inputs), (*leading, outputs, inputs))
        bias = rng.normal(0, 0.1, (*leading, outputs))
        if i == len(sizes) - 2:
            weight, bias = weight * 0.5, np.broadcast_to(last_bias, bias.shape)
        tensors[f"network.{i}.weight"], tensors[f"network.{i}.bias"] = weight, bias
    return tensors


def write_libraries(directory):
    """All of ``LIBRARIES``: name -> path."""
    return {
        name: write_library(directory / f"{name}.safetensors", **spec) for name, spec in LIBRARIES.items()
    }


def write_library(
    path, kind, inputs="cartesian", composition="gated-residual", analytic=False, anisotropic=False
):
    """A library of the given kind with random, but tame, materials."""
    rng = np.random.default_rng(7)
    materials = dict(MICROFACET, **BRUSHED) if anisotropic else dict(MICROFACET)
    if anisotropic:
        materials = {name: (kd, eta, (alpha * 2)[:2]) for name, (kd, eta, alpha) in materials.items()}
    count, tensors, form = len(materials), {}, None
    if kind in ("ggx", "hybrid"):
        for i, name in enumerate(("kd", "eta", "alpha")):
            tensors[name] = np.array([parameters[i] for parameters in materials.values()])
    if kind == "hybrid":
        features = (8 if inputs.startswith("anisotropic") else 6) + (3 if analytic else 0)
        last_bias = {
            "gated-residual": [-3.0, -3.5, -4.0, 1.5, 1.5, 1.5],
            "additive": [0.01, 0.02, 0.03],
            "log-multiplicative": [-0.1, -0.2, -0.3],
        }[composition]
        tensors |= network_tensors(rng, [features + 4, 16, 16, len(last_bias)], last_bias)
        tensors["latent"] = rng.normal(0, 0.5, (count, 4))
        tensors["bound"] = np.full(count, -1.0 if composition == "gated-residual" else 0.5)
        form = {"inputs": inputs, "analytic_input": analytic, "composition": composition}
    if kind == "neural":
        tensors |= network_tensors(rng, [18 + 12, 16, 16, 3], [-2.0, -2.5, -3.0])
        tensors["latent"] = rng.normal(0, 0.5, (count, 12))
        tensors["bound"] = np.full(count, 0.5)
        tensors["frames.weight"], tensors["frames.bias"] = rng.normal(0, 0.2, (18, 12)), np.full(18, 0.1)
    if kind == "nbrdf":
        tensors = network_tensors(rng, [6, 21, 21, 3], [0.1, 0.2, 0.15], leading=(count,))
    if kind == "spherical":
        form, nside, k = SPHERICAL_FORM, SPHERICAL_FORM["nside"], SPHERICAL_FORM["features"]
        tensors = network_tensors(rng, [2 * k, 16, 16, 3], [2.0, 2.5, 3.0], leading=(1,))
        tensors["features"] = rng.normal(0, 0.5, (count * 2 * (6 * nside * (nside + 1) + 1), k))
        tensors["bound"] = np.full(count, 6.0)
    header = {
        "format": 1,
        "kind": kind,
        "color_space": "linear sRGB",
        "materials": [{"name": name, "source": "", "sha256": "", "command": ""} for name in materials],
    }
    if form:
        header["form"] = form
    save_safetensors(path, tensors, {"glimt": json.dumps(header)})
    return path


def hemisphere(n, seed, min_cos=0.02):
    """``n`` unit directions above the horizon, (3, n) float32."""
    rng = np.random.default_rng(seed)
    z, phi = rng.uniform(min_cos, 1, n), rng.uniform(0, 2 * np.pi, n)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z]).astype(np.float32)
