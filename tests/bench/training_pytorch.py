"""A training step of the hybrid model in PyTorch: the work of `step_time` in rust/fit/examples.

Twelve materials times 1024 pairs, six features of both directions, one shared network, the analytic part,
both losses, backward and AdamW, on one core. Prints the median time of a step:

    python tests/bench/training_pytorch.py [--compile]
    RAYON_NUM_THREADS=1 cargo run --release -p glimt-fit --example step_time
"""

import argparse
import math
import statistics
import time

try:
    import torch
except ImportError:
    raise SystemExit("PyTorch is not installed: pip install torch") from None

MATERIALS, PAIRS, LATENT, FEATURES = 12, 1024, 4, 6
ROUNDS = 21


def directions(count):
    """Unit vectors, distributed by the cosine."""
    r, phi = torch.rand(count).sqrt(), torch.rand(count) * 2 * math.pi
    return torch.stack([r * phi.cos(), r * phi.sin(), (1 - r * r).clamp(min=1e-6).sqrt()], -1)


def hard_gelu(x):
    """0 up to -1.5, the identity from 1.5 on, a parabola between."""
    t = x.clamp(-1.5, 1.5)
    return t * (t + 1.5) / 3 + (x - 1.5).clamp(min=0)


def features_and_analytic(light, view, kd, eta, alpha):
    """What the network sees but z, and Lambert under GGX with exact Fresnel reflectance."""
    h, d = light + view, light - view
    square = h * h
    across = square[..., 0] + square[..., 1]
    length_squared = across + square[..., 2]
    length = length_squared.sqrt()
    slope = across / (alpha * alpha)
    cos_d = (0.5 * length).clamp(max=1)
    along = -d[..., 2] * length
    beside = d[..., 1] * h[..., 0] - d[..., 0] * h[..., 1]
    features = [
        2 * (across / (length_squared + length * h[..., 2]) + 1e-12) ** 0.25 - 1,
        2 * cos_d - 1,
        along / (along * along + beside * beside + 1e-12).sqrt(),
        2 * light[..., 2] - 1,
        2 * view[..., 2] - 1,
        0.2 * torch.log(1 + slope / square[..., 2]),
    ]

    def masking(w):
        return w[..., 2] + (w[..., 2] ** 2 + alpha * alpha * (w[..., 0] ** 2 + w[..., 1] ** 2)).sqrt()

    ratio = length_squared / (slope + square[..., 2])
    shape = ratio * ratio / (math.pi * alpha * alpha * masking(light) * masking(view))
    excess, cos = (eta * eta - 1)[:, None], cos_d[..., None]
    total = (excess + cos * cos).sqrt() + cos
    difference = excess / total
    parallel = (cos * total - 1) / (cos * difference + 1)
    fresnel = 0.5 * (difference / total) ** 2 * (1 + parallel * parallel)
    return torch.stack(features, -1), kd[:, None] / math.pi + fresnel * shape[..., None]


def loss(cos_light, f, model):
    """|e| + e^2 with e the difference of logarithms."""
    e = torch.log1p(cos_light * model) - torch.log1p(cos_light * f)
    return (e.abs() + e * e).mean()


class Hybrid(torch.nn.Module):
    """One network; k_d, eta, alpha and z for every material."""

    def __init__(self, width, layers):
        super().__init__()
        sizes = [FEATURES + LATENT] + [width] * layers + [6]
        self.layers = torch.nn.ModuleList(torch.nn.Linear(a, b) for a, b in zip(sizes, sizes[1:]))
        self.z = torch.nn.Parameter(torch.rand(MATERIALS, LATENT) - 0.5)
        self.kd = torch.nn.Parameter(torch.zeros(MATERIALS, 3))
        self.eta = torch.nn.Parameter(torch.zeros(MATERIALS, 3))
        self.alpha = torch.nn.Parameter(torch.zeros(MATERIALS, 1))

    def forward(self, light, view, f):
        """Loss of the analytic part and of the whole."""
        alpha = 1e-4 + torch.sigmoid(self.alpha)
        eta = 1 + 9 * torch.sigmoid(self.eta)
        x, analytic = features_and_analytic(light, view, torch.sigmoid(self.kd), eta, alpha)
        x = torch.cat([x, self.z[:, None].expand(-1, PAIRS, -1)], -1)
        for layer in self.layers[:-1]:
            x = hard_gelu(layer(x))
        y = self.layers[-1](x)
        # As in glimt's recipe, the loss of f does not move the analytic part.
        model = torch.exp(y[..., :3].clamp(max=16)) + torch.sigmoid(y[..., 3:]) * analytic.detach()
        cos_light = light[..., 2:]
        return loss(cos_light, f, analytic) + loss(cos_light, f, model)


def main():
    """Times every size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--compile", action="store_true", help="with torch.compile")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(1)
    light, view = directions(PAIRS).expand(MATERIALS, -1, -1), directions(PAIRS).expand(MATERIALS, -1, -1)
    f = torch.rand(MATERIALS, PAIRS, 3)
    print(f"PyTorch {torch.__version__}, {MATERIALS} materials x {PAIRS} pairs, one core")
    for width, layers in [(16, 2), (32, 2), (32, 3), (64, 3)]:
        hybrid = Hybrid(width, layers)
        evaluate = torch.compile(hybrid) if arguments.compile else hybrid
        optimiser = torch.optim.AdamW(hybrid.parameters(), lr=5e-3)
        times = []
        for _ in range(ROUNDS + 3):
            start = time.perf_counter()
            optimiser.zero_grad()
            evaluate(light, view, f).backward()
            torch.nn.utils.clip_grad_norm_(hybrid.parameters(), 0.01)
            optimiser.step()
            times.append(time.perf_counter() - start)
        print(f"{width}x{layers}: step {statistics.median(times[3:]) * 1e3:.2f} ms")


if __name__ == "__main__":
    main()
