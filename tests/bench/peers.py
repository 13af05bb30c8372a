"""glimt against its peers on one core, in the same interleaved rounds.

    python tests/bench/peers.py [--rounds 9] [--lanes 65536] [--json FILE]

Networks of 32×3: glimt's batches (the whole hybrid), ONNX Runtime and PyTorch (the network alone), Dr.Jit
with weights as literals (the whole hybrid, the plugin's traced form) and with cooperative vectors (the
network alone). BSDFs of Mitsuba, per lane of llvm_ad_rgb: glimt, roughconductor, principled, measured. Single
calls in scalar variants cannot be told from Python's own time; tests/bench/frames.py measures them. A peer
that is not installed is named and skipped.
"""

import argparse
import os
import tempfile
from pathlib import Path

os.environ.update(dict.fromkeys(("RAYON_NUM_THREADS", "OMP_NUM_THREADS"), "1"))

import glimt
import interior
import numpy as np
from rounds import interleave, keep, machine, ratio, summary

MEASUREMENT = interior.ROOT.parent / "shared" / "data" / "rgl" / "chm_orange_rgb.bsdf"
MATERIAL = "chm_orange"


def hemisphere(n, seed):
    """``n`` unit directions above the horizon, (3, n)."""
    rng = np.random.default_rng(seed)
    z, phi = rng.uniform(0.02, 1, n), rng.uniform(0, 2 * np.pi, n)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z]).astype(np.float32)


def layers(path):
    """Weights and biases of the library's network, with the latent code of a material folded away."""
    tensors, header = interior.read_safetensors(path)
    index = [material["name"] for material in header["materials"]].index(MATERIAL)
    pairs = [(tensors[f"network.{i}.weight"], tensors[f"network.{i}.bias"]) for i in range(4)]
    weight, bias = pairs[0]
    features = weight.shape[1] - tensors["latent"].shape[1]
    pairs[0] = (weight[:, :features].copy(), bias + weight[:, features:] @ tensors["latent"][index])
    return pairs


def glimt_batches(path, lanes):
    material = glimt.load(str(path))[MATERIAL]
    light, view = (np.ascontiguousarray(hemisphere(lanes, seed).T) for seed in (1, 2))
    return {"glimt, batches": lambda: material.eval(light, view)}


def onnx_runtime(path, lanes):
    import onnx
    import onnxruntime
    from onnx import helper

    nodes, constants = [], {"low": -1.5, "high": 1.5, "knee": 1.5, "third": 1 / 3}
    constants = {name: np.float32(value) for name, value in constants.items()}
    value = "x"
    for i, (weight, bias) in enumerate(layers(path)):
        constants |= {f"w{i}": weight.astype(np.float32), f"b{i}": bias.astype(np.float32)}
        nodes.append(helper.make_node("Gemm", [value, f"w{i}", f"b{i}"], [f"s{i}"], transB=1))
        value = f"s{i}"
        if i < 3:
            # HardGELU: t (t + 1.5) / 3 + max(0, x - 1.5) with t = x limited to [-1.5, 1.5].
            steps = [
                ("Clip", [value, "low", "high"], f"t{i}"),
                ("Add", [f"t{i}", "knee"], f"u{i}"),
                ("Mul", [f"t{i}", f"u{i}"], f"p{i}"),
                ("Mul", [f"p{i}", "third"], f"q{i}"),
                ("Sub", [value, "knee"], f"r{i}"),
                ("Relu", [f"r{i}"], f"m{i}"),
                ("Add", [f"q{i}", f"m{i}"], f"y{i}"),
            ]
            nodes += [helper.make_node(op, inputs, [output]) for op, inputs, output in steps]
            value = f"y{i}"
    shape = onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        nodes,
        "network",
        [helper.make_tensor_value_info("x", shape, [None, 6])],
        [helper.make_tensor_value_info(value, shape, [None, 6])],
        [onnx.numpy_helper.from_array(np.asarray(array), name) for name, array in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 9
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, ["CPUExecutionProvider"])
    # The batch at which it is fastest.
    x = np.random.default_rng(3).uniform(-1, 1, (4096, 6)).astype(np.float32)

    def run():
        for _ in range(lanes // len(x)):
            session.run(None, {"x": x})

    return {"ONNX Runtime, network alone": run}


def pytorch(path, lanes):
    import torch

    torch.set_num_threads(1)
    parameters = [(torch.tensor(w), torch.tensor(b, dtype=torch.float32)) for w, b in layers(path)]
    x = torch.rand(4096, 6) * 2 - 1

    def forward(x):
        for i, (weight, bias) in enumerate(parameters):
            x = torch.nn.functional.linear(x, weight, bias)
            if i < 3:
                t = x.clamp(-1.5, 1.5)
                x = t * (t + 1.5) / 3 + (x - 1.5).clamp(min=0)
        return x

    def task(function):
        def run():
            with torch.no_grad():
                for _ in range(lanes // len(x)):
                    function(x)

        return run

    return {
        "PyTorch eager, network alone": task(forward),
        "PyTorch compile, network alone": task(torch.compile(forward)),
    }


def cooperative_vectors(path, lanes):
    import drjit as dr
    import drjit.nn as nn
    import mitsuba as mi

    modules = []
    for i in range(4):
        modules += [nn.Linear(6 if i == 0 else 32, 6 if i == 3 else 32)]
        # ReLU, which is less work than glimt's activation.
        modules += [nn.ReLU()] if i < 3 else []
    network = nn.Sequential(*modules).alloc(mi.TensorXf, 6)
    network = nn.pack(network, layout="inference")
    x = [mi.Float(row) for row in np.random.default_rng(3).uniform(-1, 1, (6, lanes)).astype(np.float32)]
    dr.eval(x, network)

    def run():
        dr.eval(list(network(nn.CoopVec(x))))
        dr.sync_thread()

    return {"Dr.Jit cooperative vectors, network alone": run}


def mitsuba_lanes(path, lanes):
    import drjit as dr
    import mitsuba as mi

    interaction = dr.zeros(mi.SurfaceInteraction3f, lanes)
    interaction.wi = mi.Vector3f(hemisphere(lanes, 2))
    light = mi.Vector3f(hemisphere(lanes, 1))
    u = np.random.default_rng(4).random((3, lanes), np.float32)
    u_lobe, u_direction = mi.Float(u[0]), mi.Point2f(u[1:])
    dr.eval(interaction, light, u_lobe, u_direction)
    context = mi.BSDFContext()
    library = {"type": "glimt", "filename": str(path), "material": MATERIAL}
    traced = mi.load_dict(library)
    # Gradients need the traced form; only the values are computed.
    parameters = mi.traverse(traced)
    dr.enable_grad(parameters["kd"])
    descriptions = {
        "glimt": library,
        "principled": interior.principled()[7],
        "roughconductor": {"type": "roughconductor", "alpha": 0.2},
        "measured": {"type": "measured", "filename": str(MEASUREMENT)},
    }
    if not MEASUREMENT.exists():
        print(f"skipped: measured ({MEASUREMENT} not found)")
        del descriptions["measured"]

    def evaluate(bsdf):
        def run():
            dr.eval(dr.detach(bsdf.eval(context, interaction, light)))
            dr.sync_thread()

        return run

    def sample(bsdf):
        def run():
            dr.eval(bsdf.sample(context, interaction, u_lobe, u_direction))
            dr.sync_thread()

        return run

    tasks = {"Dr.Jit traced literals, hybrid": evaluate(traced)}
    for name, description in descriptions.items():
        bsdf = mi.load_dict(description)
        tasks[f"llvm_ad_rgb eval, {name}"] = evaluate(bsdf)
        tasks[f"llvm_ad_rgb sample, {name}"] = sample(bsdf)
    return tasks


#: Each gives tasks by name, or raises ImportError.
PEERS = [glimt_batches, onnx_runtime, pytorch, mitsuba_lanes, cooperative_vectors]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--lanes", type=int, default=1 << 16)
    parser.add_argument("--json", help="where the result is kept")
    arguments = parser.parse_args()
    tasks, skipped = {}, []
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "32x3.safetensors"
        interior.deepen(path)
        try:
            import drjit as dr
            import mitsuba as mi

            mi.set_variant("llvm_ad_rgb")
            dr.set_thread_count(1)
        except ImportError as error:
            print(f"Mitsuba's llvm_ad_rgb is not available: {error}")
        for peer in PEERS:
            try:
                tasks |= peer(path, arguments.lanes)
            except (ImportError, AttributeError, TypeError, RuntimeError) as error:
                skipped.append(f"{peer.__name__}: {error}")
        result = {"machine": machine(), "lanes": arguments.lanes, "skipped": skipped, "peers": {}}
        print(result["machine"])
        print("".join(f"skipped: {reason}\n" for reason in skipped), end="")
        times = interleave(tasks, arguments.rounds)
    ours = times["glimt, batches"]
    for name, seconds in times.items():
        s, scale = summary(seconds), 1e9 / arguments.lanes
        median, (low, high) = scale * s["median"], (scale * x for x in s["quartiles"])
        over = ratio(seconds, ours)
        result["peers"][name] = {
            "ns": round(median, 2),
            "quartiles_ns": [round(low, 2), round(high, 2)],
            "over_glimt_batches": round(over, 2),
        }
        print(f"{name:44} {median:8.1f} ns ({low:.1f} to {high:.1f}), {over:.2f} × glimt's batches")
    if arguments.json:
        keep(arguments.json, result)


if __name__ == "__main__":
    main()
