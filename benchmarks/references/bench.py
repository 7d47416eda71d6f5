# SPDX-License-Identifier: Apache-2.0
"""How large is the error of each numerical kernel against a reference of 40 digits, and does its bound C ε κ hold?"""

import argparse
import csv
import sys
from collections import defaultdict
from pathlib import Path

import kernels_of_clouds
import kernels_of_grasps
import kernels_of_models
import kernels_of_touch
import matplotlib as mpl
import numpy as np
from PIL import Image
from reference import KERNELS, Case, Kernel, measure, ratio

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

HERE = Path(__file__).parent
MODULES = (kernels_of_clouds, kernels_of_grasps, kernels_of_models, kernels_of_touch)
FIGURES = {"geometry": ("clouds", "grasps"), "models": ("models",), "touch": ("touch",)}
COLUMNS = 6
_BOX = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}


def main() -> int:
    """Measure, print, write the tables and draw the figures; the exit status is 1 if a bound is broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--levels", type=int, default=25, help="inputs between the benign and the hard end (default 25)"
    )
    parser.add_argument("--draws", type=int, default=4, help="random inputs of each level (default 4)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kernel", action="append", help="only this kernel, nothing is written; may be repeated")
    parser.add_argument("--draw", action="store_true", help="draw the figures from cases.csv alone")
    parser.add_argument("-o", "--out", type=Path, default=HERE, help="folder of the results")
    arguments = parser.parse_args()
    if arguments.draw:
        draw(arguments.out)
        return 0
    chosen = [one for one in KERNELS if not arguments.kernel or one.name in arguments.kernel]
    rows, cases = [], []
    for one in chosen:
        found = list(measure(one, arguments.levels, arguments.draws, arguments.seed))
        rows.append(summary(one, found))
        cases += drawn(one, found, arguments.draws)
        broken = "" if float(rows[-1]["worst"]) <= one.constant else "   BROKEN"
        print(f"{one.name:32s} C {one.constant:<6g} worst error / (ε κ) {rows[-1]['worst']}{broken}", flush=True)
    if not arguments.kernel:
        write(arguments.out / "results.csv", list(rows[0]), [list(row.values()) for row in rows])
        write(arguments.out / "cases.csv", ["kernel", "kappa", "error"], cases)
        draw(arguments.out)
    return int(any(float(row["worst"]) > float(row["C"]) for row in rows))


def summary(one: Kernel, cases: list[Case]) -> dict[str, str]:
    """The row of a kernel in `results.csv`."""
    worst = max(cases, key=lambda case: ratio(one, case))
    kappas = [case.kappa for case in cases]
    return {
        "kernel": one.name,
        "of": one.of,
        "error": one.error,
        "kappa": one.condition,
        "epsilon": f"{one.epsilon:.3g}",
        "C": f"{one.constant:g}",
        "worst": f"{ratio(one, worst):.2g}",
        "largest_error": f"{max(case.error for case in cases):.2g}",
        "smallest_kappa": f"{min(kappas):.2g}",
        "largest_kappa": f"{max(kappas):.2g}",
        "cases": str(len(cases)),
    }


def drawn(one: Kernel, cases: list[Case], draws: int) -> list[tuple[str, ...]]:
    """Rows of `cases.csv`: the first two draws of each level, enough for a figure."""
    first = [case for k, case in enumerate(cases) if k % draws < 2]
    return [(one.name, f"{case.kappa:.3g}", f"{case.error:.2g}") for case in first]


def write(path: Path, header: list[str], rows: list[list[str]] | list[tuple[str, ...]]) -> None:
    """Write a table."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def draw(folder: Path) -> None:
    """Error against κ with the bound, one panel for each kernel, from `cases.csv`."""
    points = defaultdict(list)
    with (folder / "cases.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            points[row["kernel"]].append((float(row["kappa"]), float(row["error"])))
    for name, groups in FIGURES.items():
        chosen = [one for one in KERNELS if one.group in groups]
        rows = -(-len(chosen) // COLUMNS)
        figure, axes = plt.subplots(rows, COLUMNS, figsize=(15.0, 2.2 * rows + 0.5), layout="constrained", dpi=100)
        for panel, one in zip(axes.flat, chosen, strict=False):
            draw_panel(panel, one, np.array(points[one.name]))
        for panel in axes.flat[len(chosen) :]:
            panel.set_axis_off()
        figure.supxlabel(
            "condition number κ of the input (formulas in README.md), double: ε = 2.2e-16, single: ε = 1.2e-7",
            fontsize=11,
        )
        figure.supylabel("error, in the kernel's own measure; red: the bound C ε κ", fontsize=11)
        figure.canvas.draw()
        image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
        image.quantize(32, dither=Image.Dither.NONE).save(folder / f"{name}.png", optimize=True)  # small: few colours
        plt.close(figure)


def draw_panel(panel: Axes, one: Kernel, points: np.ndarray) -> None:
    """One kernel; errors below the panel, such as exact zeros, lie on its lower border."""
    kappa, error = points.T
    middle = np.sqrt(kappa.min() * kappa.max())
    low, high = min(kappa.min() / 2.0, middle / 10.0), max(kappa.max() * 2.0, middle * 10.0)
    line = np.array([low, high])
    bound = one.constant * one.epsilon * line
    floor = max(min(bound[0], error[error > 0.0].min(initial=bound[0])) / 5.0, bound[0] * 1e-5)
    panel.loglog(line, bound, color="#c0392b", linewidth=1.2)
    panel.loglog(kappa, np.maximum(error, floor), ".", color="#1f4e79", markersize=3.0)
    panel.set_xlim(low, high)
    panel.set_ylim(floor, bound[1] * 5.0)
    panel.set_title(one.name, fontsize=9)
    panel.tick_params(labelsize=8, which="both", length=2)
    panel.minorticks_off()
    panel.locator_params(numticks=5)
    precision = {2.0**-52: "double", 2.0**-23: "single"}.get(one.epsilon, f"tolerance {one.epsilon:g}")
    note = f"C = {one.constant:g}, {precision}"
    panel.text(0.97, 0.07, note, transform=panel.transAxes, fontsize=8, va="center", ha="right", bbox=_BOX)


if __name__ == "__main__":
    sys.exit(main())
