# SPDX-License-Identifier: Apache-2.0
"""What does each level of contact and each effect cost, and what is lost without it?

One table (CSV) and one plot. For levels of contact: CPU time of both contacts, and the error of the 24 electrodes
against the elastic layer at 128x128, ‖drop - drop128‖ / ‖drop128‖, median over grasps. For effects: CPU time, and what a
reader of the data would miss: root mean square change of the counts when it alone is left out of a scene with everything.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scenes import engine, keys, scene

from foretouch.errors import SimulationError
from foretouch.simulation.engine import Engine
from foretouch.simulation.scene import SceneConfig

Array = npt.NDArray[np.float64]
Row = dict[str, Any]

_LEVELS = (
    *(("hertz", 24), ("winkler", 12), ("winkler", 24), ("winkler", 48)),
    *(("layer", 12), ("layer", 24), ("layer", 32), ("layer", 48)),
)
_REFERENCE = ("layer", 128)

_EFFECTS = {
    "clutter": "clutter",
    "flying_pixels": "camera.flying_pixels",
    "depth_noise": "camera.noise",
    "stereo_shadow": "camera.stereo",
    "holes": "camera.holes",
    "depth_steps": "camera.z_step_m",
    "execution_error": "grasps.error",
    "weight": "gravity",
    "creep": "fingers.creep",
    "slip": "fingers.slip",
    "drift": "fingers.drift",
    "noise": "fingers.noise",
    "scan_hold": "fingers.scan",
    "dead_electrodes": "fingers.dead",
}


def drops(config: SceneConfig, count: int) -> tuple[dict[int, Array], Engine]:
    """Drop of the electrodes of both fingers, by slot, where the grasp did not fail."""
    made, found = engine(config, "readings"), {}
    for key in keys(config, count):
        try:
            rest, touched = made.run(key).readings
        except SimulationError:
            continue
        found[key.slot] = (rest - touched)[:, 1:]
    return found, made


def levels(name: str, count: int) -> Iterator[Row]:
    """Each level of contact on one scene."""
    level, cells = _REFERENCE
    best, _ = drops(scene(name, fidelity=level, fingers__pad__cells=cells), count)
    for level, cells in _LEVELS:
        found, made = drops(scene(name, fidelity=level, fingers__pad__cells=cells), count)
        errors = [np.linalg.norm(found[k] - best[k]) / np.linalg.norm(best[k]) for k in found.keys() & best.keys()]
        timing = made.timings[f"contact_{level}"]
        yield {
            "kind": f"contact, {name}",
            "name": f"{level} {cells}x{cells}",
            "ms": 1e3 * timing.seconds / max(timing.calls, 1),
            "error": float(np.median(errors)) if errors else None,
            "error_largest": float(max(errors)) if errors else None,
            "unit": "relative",
            "refused": count - len(found),
        }


def effects(count: int) -> Iterator[Row]:
    """Each effect, left out of the scene with everything."""
    full, made = touches(scene("everything"), count)
    for name, field in _EFFECTS.items():
        without, _ = touches(scene("everything", **{field.replace(".", "__"): None}), count)
        both = sorted(full.keys() & without.keys())
        change = np.array([full[k] - without[k] for k in both])
        timing = made.timings[name]
        yield {
            "kind": "effect",
            "name": name,
            "ms": 1e3 * timing.seconds / max(timing.calls, 1),
            "error": float(np.sqrt(np.mean(change**2))),
            "error_largest": float(np.abs(change).max()),
            "unit": "counts",
            "refused": count - len(without),
        }


def touches(config: SceneConfig, count: int) -> tuple[dict[int, Array], Engine]:
    """(50,) readings by slot, where the grasp did not fail."""
    made, found = engine(config, "touch"), {}
    for key in keys(config, count):
        try:
            found[key.slot] = made.run(key).touch.vector()
        except SimulationError:
            continue
    return found, made


def draw(rows: list[Row], path: Path) -> None:
    """Cost against loss, one panel for each kind."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    figure = Figure(figsize=(5.5 * len(kinds), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, kind in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds, strict=True):
        shown = [row for row in rows if row["kind"] == kind and row["error"]]
        axes.scatter([row["ms"] for row in shown], [row["error"] for row in shown], color="#00798c")
        for row in shown:
            axes.annotate(row["name"], (row["ms"], row["error"]), textcoords="offset points", xytext=(4, 3), fontsize=8)
        lost = "error of the electrode pattern" if kind != "effect" else "change of the counts without it [counts]"
        axes.set(xscale="log", yscale="log", xlabel="CPU time a sample [ms]", ylabel=lost, title=kind)
        axes.margins(0.2)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", type=int, default=60, help="grasps")
    parser.add_argument("-o", type=Path, default=Path("build/tradeoff_simulation"), help="folder for table and plot")
    arguments = parser.parse_args()
    rows = [*levels("rigid", arguments.n), *levels("deformables", arguments.n), *effects(arguments.n)]
    arguments.o.mkdir(parents=True, exist_ok=True)
    with (arguments.o / "tradeoff.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, rows[0])
        table.writeheader()
        table.writerows(rows)
    draw(rows, arguments.o / "tradeoff.png")
    print("| kind | name | CPU ms | median loss | largest | unit | refused |\n|---|---|---|---|---|---|---|")
    for row in rows:
        loss = ["" if row[k] is None else f"{row[k]:.3g}" for k in ("error", "error_largest")]
        print(
            f"| {row['kind']} | {row['name']} | {row['ms']:.2f} | {' | '.join(loss)} | {row['unit']} | {row['refused']} |"
        )


if __name__ == "__main__":
    main()
