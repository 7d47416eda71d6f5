# SPDX-License-Identifier: Apache-2.0
"""How well does the model `simulated` predict what the simulated hand reads? See README.md."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import ROOT, print_rows, scene, write_csv
from examples.draw_touch import grasps_to_draw
from foretouch.models import TouchModel, load_model
from foretouch.report.touch_figure import save_touch_picture
from foretouch_lab.learning.prequential import ModelReplay, replay_model
from foretouch_lab.simulation.simulate import Simulation

HERE = Path(__file__).parent
OBJECTS = {"can": True, "figure": False}  # of the demo, with whether the model knows them
FIGURE = "minion"  # shape of the figure
TOUCHES = range(5)  # touches of the object before the grasps that are counted: all of the demo
DRAWN = (0, 2)  # touches before the grasps that are drawn


def demo_run(model: TouchModel, seed: int, shape: str = FIGURE) -> ModelReplay:
    """Return ten grasps of the demo, each predicted from all that was read before it.

    Args:
        model: The model.
        seed: Of the scene.
        shape: Of the object that the model does not know.
    """
    can, figure = scene("demo").objects
    demo = scene("demo").replace(seed=seed, objects=(can, figure.replace(shape=shape)))
    return replay_model(model, list(Simulation(demo).samples(10)))


def inside(run: ModelReplay, name: str, touches: int) -> tuple[int, float]:
    """Return the index of the grasp of an object after so many touches of it, and the share of its electrodes in their intervals."""
    (k,) = np.flatnonzero((run.recording.objects == name) & (run.recording.touches() == touches))
    errors = np.abs(run.recording.readings[k] - run.played.counts[k])[2:]
    return int(k), float((errors <= run.played.half[k][2:]).mean())


def demo_rows(runs: Sequence[ModelReplay]) -> list[dict[str, Any]]:
    """Return a row for each object and number of touches: mean share over the runs with its standard error, share of flagged grasps, mean difference [counts]."""
    rows = []
    for name in OBJECTS:
        for touches in TOUCHES:
            grasps = [(run, *inside(run, name, touches)) for run in runs]
            share = np.array([share for *_, share in grasps])
            errors = [np.abs(run.recording.readings[k] - run.played.counts[k])[2:].mean() for run, k, _ in grasps]
            rows.append({
                "object": name, "touches": touches, "runs": len(runs), "inside": share.mean(),
                "standard_error": share.std(ddof=1) / len(runs) ** 0.5, "least": share.min(),
                "unfamiliar": np.mean([not run.recording.is_known(k) for run, k, _ in grasps]),
                "mean_difference": np.mean(errors),
            })  # fmt: skip
    return rows


def draw(runs: Sequence[ModelReplay], path: Path) -> None:
    """Draw the run whose share over the four grasps is the median of all runs; of two, the lower."""
    total = [np.mean([inside(run, name, touches)[1] for name in OBJECTS for touches in DRAWN]) for run in runs]
    seed = int(np.argsort(total, kind="stable")[(len(runs) - 1) // 2])
    save_touch_picture(path, grasps_to_draw(scene("demo").replace(seed=seed)))
    print(f"{path}: seed {seed}, {total[seed]:.3f} inside")


def main() -> None:
    """Print and write the table, and the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--model", default="simulated")
    parser.add_argument(
        "--shape", default=FIGURE, help="of the unknown object; of another than the demo's nothing is written"
    )
    parser.add_argument("--out", type=Path, default=HERE / "demo.csv")
    parser.add_argument("--picture", type=Path, default=ROOT / "docs" / "touch.png")
    options = parser.parse_args()
    model = load_model(options.model)
    runs = [demo_run(model, seed, options.shape) for seed in range(options.runs)]
    print_rows(demo_rows(runs))
    if options.shape == FIGURE:
        draw(runs, options.picture)
        write_csv(options.out, demo_rows(runs))


if __name__ == "__main__":
    main()
