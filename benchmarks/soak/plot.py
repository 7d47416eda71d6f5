# SPDX-License-Identifier: Apache-2.0
"""Draws `soak.png` from `timeline.csv` and `disturbances.csv` of a folder."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.lines import Line2D

KINDS = {
    "kill": "tab:red",
    "deactivate": "tab:orange",
    "clean up": "tab:brown",
    "stall": "tab:purple",
    "clock": "tab:blue",
    "disk": "black",
    "folder": "tab:gray",
    "second": "tab:green",
}


def draw(folder: Path) -> None:
    """Memory of every process and answers per second over time, with a line for each disturbance."""
    rows = list(csv.DictReader((folder / "timeline.csv").open()))
    marks = list(csv.DictReader((folder / "disturbances.csv").open()))
    minutes = [float(row["t_s"]) / 60.0 for row in rows]
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(10, 6), sharex=True)
    for name in [key for key in rows[0] if key.endswith("_mb")]:
        top.plot(minutes, [float(row[name] or "nan") for row in rows], label=name.removesuffix("_mb"))
    top.set(ylabel="resident memory [MB]", ylim=(0, None))
    top.legend(ncols=6, fontsize=8, loc="upper left")
    bottom.plot(minutes, [float(row["played_per_s"]) for row in rows], color="0.7", label="clouds")
    bottom.plot(minutes, [float(row["answered_per_s"]) for row in rows], color="tab:blue", label="answers")
    bottom.set(xlabel="time [min]", ylabel="per second", ylim=(0, None))
    for mark in marks:
        colour = next(c for kind, c in KINDS.items() if mark["disturbance"].startswith(kind))
        start = float(mark["t_s"]) / 60.0
        for axes in (top, bottom):
            axes.axvspan(start, start + float(mark["lasted_s"]) / 60.0, color=colour, alpha=0.25, lw=0)
            axes.axvline(start, color=colour, lw=0.7)
    lines = [Line2D([], [], color=colour, label=kind) for kind, colour in KINDS.items()]
    first = bottom.legend(loc="lower left", fontsize=8)
    bottom.legend(handles=lines, ncols=8, fontsize=8, loc="upper left")
    bottom.add_artist(first)
    top.margins(x=0)
    top.set_ylim(0, top.get_ylim()[1] * 1.15)
    bottom.set_ylim(0, bottom.get_ylim()[1] * 1.2)
    figure.tight_layout()
    figure.savefig(folder / "soak.png", dpi=90)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
