"""Small model libraries of every kind with random materials, and directions to ask them for."""

import json

import numpy as np

MICROFACET = {
    "orange": ([0.55, 0.21, 0.04], [1.5, 1.5, 1.5], [0.25]),
    "metal": ([0.02, 0.02, 0.03], [4.0, 3.1, 2.2], [0.12]),
    "rough": ([0.30, 0.35, 0.40], [1.4, 1.6, 1.8], [0.60]),
}
BRUSHED = {"brushed": ([0.05, 0.06, 0.08], [3.0, 2.6, 2.4], [0.15, 0.45])}

# Of the random numbers of a library.
SEED = 7

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
    "factor": {"kind": "factor", "form": {"variant": "independent-g", "interpolation": "linear"}},
    "factor_g_from_d": {"kind": "factor", "form": {"variant": "g-from-d", "interpolation": "nearest"}},
    "factor_naive": {"kind": "factor", "form": {"variant": "naive", "interpolation": "linear"}},
    "factor_bivariate": {"kind": "factor", "form": {"variant": "bivariate", "interpolation": "linear"}},
    "analytic_ward": {"kind": "analytic", "form": {"lobe": "ward"}},
    "analytic_gamma": {"kind": "analytic", "form": {"lobe": "shifted-gamma"}},
    "maps": {"kind": "maps", "form": {"wrap": "repeat", "filter": "moments"}},
    "gated": {"kind": "gated"},
}

# Those that Dr.Jit can differentiate; the others are calls into the core.
UNTRACED = ("spherical", "factor", "analytic", "maps", "gated")
TRACED = [name for name, library in LIBRARIES.items() if library["kind"] not in UNTRACED]

# Libraries whose materials are another at every place.
SURFACES = ("maps", "gated")

# Codes of three levels, and two small disks of matrices.
GATED_FORM = {
    "wrap": "repeat",
    "filter": "moments",
    "precision": "f32",
    "base": "maps",
    "angles": "matrices",
    "latents": [4, 3],
    "half": {"rings": 4, "sectors": 6},
    "difference": {"rings": 4, "sectors": 6},
    "frames": True,
    "warps": True,
}

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


def factor_tensors(variant):
    """The three materials as tables over 90 bins: a lobe, a Fresnel factor and a third factor each."""
    bins = (np.arange(90) + 0.5) / 90
    gloss = np.array([8.0, 60.0, 2.0])[:, None, None]  # orange, metal, rough
    tint = np.array([1.0, 0.9, 0.7])[None, :, None]
    ndf = np.exp(-gloss * bins**4) * np.ones_like(tint)
    fresnel = (0.3 + 0.7 * bins**5) * np.ones_like(gloss * tint)
    if variant == "bivariate":
        lobe = gloss * tint * ndf
        return {"bivariate": 0.05 + np.einsum("mch,mcd->mhdc", lobe, fresnel)}
    tensors = {
        "diffuse": np.array([kd for kd, _, _ in MICROFACET.values()]) / np.pi,
        "specular": 0.1 * (gloss * tint)[..., 0],
        "ndf": ndf,
        "fresnel": fresnel,
    }
    if variant == "independent-g":
        tensors["masking"] = (1 - bins**6) * np.ones_like(gloss * tint)
    if variant == "naive":
        azimuth = (np.arange(180) + 0.5) / 180 * np.pi
        tensors["azimuth"] = (0.8 + 0.2 * np.cos(azimuth)) * np.ones_like(gloss * tint)
    return tensors


def analytic_tensors(lobe):
    """The three materials as published models have them."""
    diffuse = np.array([kd for kd, _, _ in MICROFACET.values()])
    scale, roughness = np.full((3, 3), 0.2), np.array([[0.2], [0.1], [0.5]])
    if lobe == "ward":
        return {"diffuse": diffuse, "specular": np.hstack([scale, roughness])}
    # α, p, F₀, F₁, K, λ, s, k and θ₀ of every channel, near those that are published for gold-metallic-paint.
    numbers = [0.1, 0.8, 0.0, -1.0, 6.0, 2.7, 0.5, 24.0, -0.3]
    return {"diffuse": diffuse, "specular": np.hstack([scale, np.tile(np.repeat(numbers, 3), (3, 1))])}


def maps_tensors(rng, width=7, height=5):
    """Texture maps whose numbers vary about those of the three materials, and whose normals are inclined."""

    def map_of(values):
        values = np.array(values)[:, None, None]
        return values * rng.uniform(0.5, 1, (len(MICROFACET), height, width, values.shape[-1]))

    kd, eta, alpha = zip(*MICROFACET.values())
    f0 = ((np.array(eta) - 1) / (np.array(eta) + 1)) ** 2
    slopes = rng.uniform(-0.4, 0.4, (len(MICROFACET), height, width, 2))
    return {"maps": np.concatenate([map_of(kd), map_of(f0), map_of(alpha), slopes], axis=-1)}


def gated_tensors(rng):
    """Codes, matrices and a network that change the maps of the three materials a little."""
    count, texels, columns = len(MICROFACET), 4 * 3 + 2 * 2 + 1, 1 + 3 * 6
    upright, warps = [0, 0, 1, 1, 0, 0], [0, -1.3, 0.1] * 2
    network = network_tensors(rng, [16, 16, 16, 6], [-3.0, -3.5, -4.0, 1.5, 1.5, 1.5], leading=(count,))
    return (
        maps_tensors(rng)
        | network
        | {
            "latents": rng.normal(0.35, 0.15, (count, texels, 8)),
            "half": rng.normal(0, 0.5, (count, columns, 8, 8)),
            "difference": rng.normal(0, 0.5, (count, columns, 8, 8)),
            "frames.weight": rng.normal(0, 0.1, (count, 6, 8)),
            "frames.bias": np.tile(upright, (count, 1)),
            "warps.weight": rng.normal(0, 0.1, (count, 6, 8)),
            "warps.bias": np.tile(warps, (count, 1)),
            "bound": np.full(count, -1.0),
        }
    )


def write_library(
    path,
    kind,
    inputs="cartesian",
    composition="gated-residual",
    analytic=False,
    anisotropic=False,
    form=None,
):
    """A library of the given kind with random, but tame, materials."""
    rng = np.random.default_rng(SEED)
    materials = dict(MICROFACET, **BRUSHED) if anisotropic else dict(MICROFACET)
    if anisotropic:
        materials = {name: (kd, eta, (alpha * 2)[:2]) for name, (kd, eta, alpha) in materials.items()}
    count, tensors = len(materials), {}
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
    if kind == "factor":
        tensors = factor_tensors(form["variant"])
    if kind == "analytic":
        tensors = analytic_tensors(form["lobe"])
    if kind == "maps":
        tensors = maps_tensors(rng)
    if kind == "gated":
        form, tensors = GATED_FORM, gated_tensors(rng)
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
