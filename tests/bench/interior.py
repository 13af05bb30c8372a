"""A closed interior whose every surface, the lamp too, has the material that is asked for."""

import json
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent.parent
sys.path.insert(0, str(ROOT / "tests"))
from model_libraries import save_safetensors  # noqa: E402

LIBRARY = ROOT / "scenes" / "models" / "rgl.safetensors"

#: Six walls, two spheres, a box and the lamp.
SURFACES = 10


def read_safetensors(path):
    """Tensors by name, and the header of a model library."""
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + size])
    metadata = header.pop("__metadata__")
    tensors = {}
    for name, entry in header.items():
        first, last = entry["data_offsets"]
        values = np.frombuffer(data[8 + size + first : 8 + size + last], np.float32)
        tensors[name] = values.reshape(entry["shape"]).copy()
    return tensors, json.loads(metadata["glimt"])


def save_library(path, tensors, header):
    """Writes a model library; returns the names of its materials."""
    save_safetensors(path, tensors, {"glimt": json.dumps(header)})
    return [material["name"] for material in header["materials"]]


def deepen(path):
    """Writes the fitted library of scenes/, a network of 32×2, as the same function of a network of 32×3.

    The layer that is put in adds 2 to every value, far enough from the knee of the activation to pass
    unchanged, and the next layer takes it off: the work of 32×3 with the reflectance of real materials.
    """
    tensors, header = read_safetensors(LIBRARY)
    shift, width = np.float32(2), tensors["network.1.bias"].size
    weight, bias = tensors["network.2.weight"], tensors["network.2.bias"]
    tensors["network.3.weight"], tensors["network.3.bias"] = weight, bias - shift * weight.sum(axis=1)
    tensors["network.2.weight"] = np.eye(width, dtype=np.float32)
    tensors["network.2.bias"] = np.full(width, shift)
    return save_library(path, tensors, header)


def analytic_only(path):
    """Writes the analytic parts of the same library as a library of the kind ``ggx``."""
    tensors, header = read_safetensors(LIBRARY)
    header["kind"] = "ggx"
    header.pop("form")
    return save_library(path, {name: tensors[name] for name in ("kd", "eta", "alpha")}, header)


def principled():
    """A ``principled`` for each material of the library, with its diffuse colour and roughness."""
    tensors, _ = read_safetensors(LIBRARY)
    return [
        {
            "type": "principled",
            "base_color": {"type": "rgb", "value": np.clip(kd, 0, 1).tolist()},
            "roughness": float(np.sqrt(alpha[0])),
            "specular": 0.5,
        }
        for kd, alpha in zip(tensors["kd"], tensors["alpha"])
    ]


def scene(mi, materials, size=256, depth=6):
    """The interior as a dictionary; surface i has the material i modulo their number."""
    transform = mi.ScalarTransform4f
    numbers = iter(range(SURFACES))
    bsdfs = {f"bsdf{i}": {**material, "id": f"bsdf{i}"} for i, material in enumerate(materials[:SURFACES])}

    def surface(shape, to_world, **others):
        bsdf = {"type": "ref", "id": f"bsdf{next(numbers) % len(materials)}"}
        return {"type": shape, "to_world": to_world, "bsdf": bsdf, **others}

    walls = {
        "floor": transform(),
        "ceiling": transform().translate([0, 0, 2]).rotate([1, 0, 0], 180),
        "left": transform().translate([-1, 0, 1]).rotate([0, 1, 0], 90),
        "right": transform().translate([1, 0, 1]).rotate([0, 1, 0], -90),
        "back": transform().translate([0, 1, 1]).rotate([1, 0, 0], 90),
        "front": transform().translate([0, -1, 1]).rotate([1, 0, 0], -90),
    }
    objects = {name: surface("rectangle", to_world) for name, to_world in walls.items()}
    objects["ball"] = surface("sphere", transform().translate([-0.4, 0.3, 0.4]).scale(0.4))
    objects["marble"] = surface("sphere", transform().translate([0.1, -0.3, 0.2]).scale(0.2))
    objects["box"] = surface(
        "cube", transform().translate([0.5, 0.2, 0.3]).rotate([0, 0, 1], 30).scale([0.2, 0.2, 0.3])
    )
    objects["lamp"] = surface(
        "rectangle",
        transform().translate([0, 0, 1.99]).rotate([1, 0, 0], 180).scale(0.3),
        emitter={"type": "area", "radiance": {"type": "rgb", "value": [12, 11, 10]}},
    )
    return {
        "type": "scene",
        # No Russian roulette, which would make the work depend on the albedo.
        "integrator": {"type": "path", "max_depth": depth, "rr_depth": 1000},
        "sensor": {
            "type": "perspective",
            "fov": 75,
            "to_world": transform().look_at([0, -0.95, 1], [0, 1, 0.8], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent"},
        },
        **bsdfs,
        **objects,
    }
