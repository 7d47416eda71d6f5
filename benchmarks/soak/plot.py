# SPDX-License-Identifier: Apache-2.0
"""Draws `soak.png` from `timeline.csv` and `disturbances.csv` of a folder: `python -m benchmarks.soak.plot FOLDER`."""

import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.lines import Line2D

from benchmarks.common import read_csv

KINDS = {"kill": "tab:red", "deactivate": "tab:orange", "clean up": "tab:brown", "stall": "tab:purple",
         "clock": "tab:blue", "disk": "black", "folder": "tab:gray", "second": "tab:green"}  # fmt: skip


def draw(folder: Path) -> None:
    """Memory of every process and answers per second over time, with a line for each disturbance."""
    rows = read_csv(folder / "timeline.csv")
    marks = [row for row in read_csv(folder / "disturbances.csv") if "disturbance" in row]  # none without chaos
    minutes = [float(row["t_s"]) / 60.0 for row in rows]
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(10, 6), sharex=True)
    for name in [key for key in rows[0] if key.endswith("_mb")]:
        top.plot(minutes, [float(row[name] or "nan") for row in rows], label=name.removesuffix("_mb"))
    for key, colour, label in (("played_per_s", "0.7", "clouds"), ("answered_per_s", "tab:blue", "answers")):
        bottom.plot(minutes, [float(row[key]) for row in rows], color=colour, label=label)
    for mark in marks:
        colour = next(c for kind, c in KINDS.items() if mark["disturbance"].startswith(kind))
        start, lasted = float(mark["t_s"]) / 60.0, float(mark["lasted_s"]) / 60.0
        for axes in (top, bottom):
            axes.axvspan(start, start + lasted, color=colour, alpha=0.25, lw=0)
            axes.axvline(start, color=colour, lw=0.7)
    top.set(ylabel="resident memory [MB]", ylim=(0, 1.15 * top.get_ylim()[1]))
    top.legend(ncols=6, fontsize=8, loc="upper left")
    top.margins(x=0)
    bottom.set(xlabel="time [min]", ylabel="per second", ylim=(0, 1.2 * bottom.get_ylim()[1]))
    bottom.add_artist(bottom.legend(loc="lower left", fontsize=8))
    lines = [Line2D([], [], color=colour, label=kind) for kind, colour in KINDS.items()]
    bottom.legend(handles=lines, ncols=8, fontsize=8, loc="upper left")
    figure.tight_layout()
    figure.savefig(folder / "soak.png", dpi=90)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
