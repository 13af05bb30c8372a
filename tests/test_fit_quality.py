"""The figures of the README, from the command line, on the reference measurements."""

import json
import subprocess
from pathlib import Path

import pytest

MEASUREMENTS = Path(__file__).parents[2] / "shared" / "data" / "rgl"
# Means over the materials: SMAPE, log-MAE of the whole and of its analytic part, each with room for another
# instruction set's rounding.
SHARED = {"smape": 0.25, "log_mae": 2.6e-3, "analytic_smape": 0.469, "analytic_log_mae": 9.12e-3}
PER_MATERIAL = {"smape": 0.25, "log_mae": 2.6e-3}


@pytest.mark.long
@pytest.mark.parametrize(("options", "limits"), [([], SHARED), (["--per-material"], PER_MATERIAL)])
def test_default_fit_reaches_its_figures(tmp_path, options, limits):
    files = sorted(MEASUREMENTS.glob("*.bsdf"))
    if len(files) != 12:
        pytest.skip(f"the twelve reference measurements are not in {MEASUREMENTS}")
    command = ["glimt", "fit", *files, *options, "--json", "-o", tmp_path / "fit.safetensors"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    materials = json.loads(printed)["materials"].values()
    for metric, limit in limits.items():
        mean = sum(material[metric] for material in materials) / len(materials)
        assert mean <= limit, f"{metric}: {mean}"
