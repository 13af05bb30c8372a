"""Plots error against bytes and against time, from the table of docs/notes/report.md: the README's plot.

    python tests/quality/overview.py [--out docs/images/error-size-time.png]

Needs matplotlib.
"""

import argparse
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "notes" / "report.md"
HEADER = "| model | ns, batch | ns, single | bytes a material | SMAPE | log-MAE |"
# The measurement against itself, light and view swapped: docs/notes/quality.md.
NOISE = 5.15e-3


def read_table(text):
    """(name, ns, bytes, log-MAE) of every model."""
    _, table = text.split(HEADER)
    rows = table.split("\n\n")[0].splitlines()[2:]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    return [(name, float(ns), float(size), float(error)) for name, ns, _, size, _, error, *_ in cells]


def plot(models, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), sharey=True, layout="constrained")
    columns = [(2, "bytes a material"), (1, "ns for a pair, in a batch on one core")]
    for axis, (column, label) in zip(axes, columns):
        for model in models:
            # A mean over other materials than the rest is drawn hollow.
            hollow = " of " in model[0]
            axis.plot(model[column], model[3], "o", color="tab:blue", fillstyle="none" if hollow else "full")
            axis.annotate(model[0], (model[column], model[3]), (5, 4), textcoords="offset points", fontsize=8)
        axis.axhline(NOISE, color="grey", linewidth=1, linestyle="--")
        axis.set(xscale="log", yscale="log", xlabel=label)
        values = [model[column] for model in models]
        axis.set_xlim(min(values) / 2, max(values) * 5)  # room for the names
        axis.grid(alpha=0.3)
        axis.minorticks_off()
    axes[0].set_ylabel("log-MAE")
    axes[0].set_yticks([5e-4, 1e-3, 2e-3, 5e-3, 1e-2], ["0.0005", "0.001", "0.002", "0.005", "0.01"])
    axes[0].annotate("measurement, swapped", (0.02, NOISE), (0, 3), xycoords=("axes fraction", "data"),
                     textcoords="offset points", fontsize=8, color="grey")  # fmt: skip
    figure.savefig(path, dpi=110, metadata={"Software": None})


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "error-size-time.png")
    plot(read_table(PAGE.read_text()), parser.parse_args().out)


if __name__ == "__main__":
    main()
