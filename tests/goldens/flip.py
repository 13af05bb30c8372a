"""Prints HDR-ꟻLIP of two synthetic images as the paper's authors compute it, for the test in flip.rs.

pip install flip-evaluator==1.7 && python tests/goldens/flip.py
"""

import flip_evaluator
import numpy as np

WIDTH, HEIGHT = 120, 90


def scene(phase, peak):
    """The images of the test, by the same formula in float32."""
    f = np.float32
    i = np.arange(WIDTH * HEIGHT)
    x, y = (i % WIDTH).astype(f), (i // WIDTH).astype(f)
    stripe = np.where(np.sin(f(0.15) * x + f(phase)) > f(0.6), f(0.5), f(0.05))
    point = np.where((i + int(40 * phase)) % 613 == 0, f(peak), f(0))
    wave = [np.abs(np.sin(f(0.05) * y * f(k) + f(phase))) for k in (0.3, 0.5, 0.8)]
    pixels = [(f(k) * stripe + f(0.2) * w + point) * f(0.8) for k, w in zip((0.3, 0.5, 0.8), wave)]
    return np.stack(pixels, -1).reshape(HEIGHT, WIDTH, 3).astype(f)


for phases, peaks in [((0.0, 0.0), (5.0, 50.0)), ((0.0, 0.3), (40.0, 80.0))]:
    truth, image = (scene(phase, peak) for phase, peak in zip(phases, peaks))
    _, mean, parameters = flip_evaluator.evaluate(truth, image, "HDR", inputsRGB=False)
    print(phases, peaks, mean, {k: parameters[k] for k in ("startExposure", "stopExposure", "numExposures")})
