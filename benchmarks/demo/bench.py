# SPDX-License-Identifier: Apache-2.0
"""How well does the model `simulated` predict what the simulated hand reads? See README.md."""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.common import ROOT, Rows, command, scene
from foretouch.config import load_yaml
from foretouch.models import TouchModel, load_model
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.pipeline import Pipeline
from foretouch.report.touch_figure import DrawnGrasp, save_touch_picture
from foretouch.tactile import BIOTAC, biotac_touch
from foretouch.types import Float64, GraspSample, TouchPrediction
from foretouch_lab.experiments.noise_ceiling import CAUSES, NEW_OBJECT, Repeater, ceiling_rows
from foretouch_lab.learning.prequential import ModelReplay, replay_model
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene_camera import FrameMaker
from foretouch_lab.simulation.simulate import Simulation

HERE = Path(__file__).parent
OBJECTS = {"can": True, "figure": False}  # of the demo, with whether the model knows them
TOUCHES = (0, 2)  # of the object before the grasps that are drawn and counted
OTHERS = 60  # objects that the model was not trained on
REPEATS = 10
SIZES = {name: channel.size for name, channel in BIOTAC.channel_of.items()}


def tables(arguments: argparse.Namespace) -> dict[Path, Rows]:
    """Both tables, and the picture."""
    model = load_model(arguments.model)
    runs = [demo_run(model, seed) for seed in range(arguments.runs)]
    draw(runs, arguments.picture)
    return {HERE / "demo.csv": demo_rows(runs), HERE / "ceiling.csv": shares(model)}


def demo_run(model: TouchModel, seed: int) -> ModelReplay:
    """Ten grasps of the demo, each predicted from all that was read before it."""
    return replay_model(model, list(Simulation(scene("demo").replace(seed=seed)).samples(10)))


def inside(run: ModelReplay, name: str, touches: int) -> tuple[int, float]:
    """Index of the grasp of an object after so many touches of it, and the share of its electrodes in their intervals."""
    (k,) = np.flatnonzero((run.recording.objects == name) & (run.recording.touches() == touches))
    errors = np.abs(run.recording.readings[k] - run.played.counts[k])[2:]
    return int(k), float((errors <= run.played.half[k][2:]).mean())


def demo_rows(runs: Sequence[ModelReplay]) -> list[dict[str, Any]]:
    """By object and touches: mean share over the runs with its standard error, share of flagged grasps, mean difference [counts]."""
    rows = []
    for name in OBJECTS:
        for touches in TOUCHES:
            found = [(run, *inside(run, name, touches)) for run in runs]
            share = np.array([one for *_, one in found])
            errors = [np.abs(run.recording.readings[k] - run.played.counts[k])[2:].mean() for run, k, _ in found]
            rows.append({
                "object": name, "touches": touches, "runs": len(runs), "inside": share.mean(),
                "standard_error": share.std(ddof=1) / len(runs) ** 0.5, "least": share.min(),
                "unfamiliar": np.mean([not run.recording.is_known(k) for run, k, _ in found]),
                "mean_difference": np.mean(errors),
            })  # fmt: skip
    return rows


def draw(runs: Sequence[ModelReplay], path: Path) -> None:
    """Draw the run whose share over the four grasps is the median of all runs; of two, the lower."""
    total = [np.mean([inside(run, name, touches)[1] for name in OBJECTS for touches in TOUCHES]) for run in runs]
    seed = int(np.argsort(total, kind="stable")[(len(runs) - 1) // 2])
    run, maker, pipeline, drawn = runs[seed], FrameMaker(scene("demo").replace(seed=seed)), Pipeline(), []
    for name, known in OBJECTS.items():
        for touches in TOUCHES:
            k, _ = inside(run, name, touches)
            sample, value, half = run.samples[k], run.played.counts[k], run.played.half[k]
            value, lower, upper = (biotac_touch(one) for one in (value, value - half, value + half))
            cloud = maker.frame(int(sample.extra["slot"]), int(sample.extra["attempt"])).cloud()
            (target,) = pipeline.segment(cloud).targets
            knows = "knows" if known else "does not know (unfamiliar)"
            based = f"after {touches} touches" if touches else "before the first touch"
            drawn.append(DrawnGrasp(
                target=target, prediction=TouchPrediction(sample.grasp, value, lower=lower, upper=upper), scene=cloud,
                rest=sample.tare, read=sample.touch, title=f"{name}, which the model simulated {knows}, {based}",
            ))  # fmt: skip
    save_touch_picture(path, drawn)
    with Image.open(path) as image:
        image.convert("RGB").quantize(128, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)
    print(f"{path}: seed {seed}, {total[seed]:.3f} inside")


def shares(model: TouchModel) -> list[dict[str, Any]]:
    """Skills on grasps of objects that the model never saw, and their share of the noise ceiling, without and with a tare.

    The objects are further members of the family that the training objects were drawn from.
    """
    mapping = load_yaml(ROOT / "config" / "scenes" / "simulated_hand.yaml")
    trained = len(SceneConfig.from_mapping(mapping).objects)
    mapping["families"][0]["count"] += OTHERS
    more = SceneConfig.from_mapping(mapping)
    count = len(more.objects)
    samples = [one for one in Simulation(more).samples(2 * count) if one.extra["slot"] % count >= trained]
    repeater = Repeater(more, frozenset({*CAUSES, NEW_OBJECT}))
    assert model.calibration is not None
    assert isinstance(model.estimator, ContactEstimator)
    plain, tared = [], []
    for sample in samples:
        made = repeater.repeat(int(sample.extra["slot"]), int(sample.extra["attempt"]), REPEATS)
        counts = model.estimator.estimate(sample.cloud, [sample.grasp]).counts[0]
        squared = (model.estimator.mean - made.touches.mean(axis=0)) ** 2
        reference = squared + (1.0 - 1.0 / len(made.touches)) * made.touches.var(axis=0, ddof=1)  # of the training mean
        predicted = {"without vision": model.estimator.mean, "simulated": counts}
        for found, readings in ((plain, made.touches), (tared, made.touches - made.tares + model.calibration.rest)):
            found.extend(_cells(sample, readings, predicted, reference))
    rows = []
    for name, found in (("", plain), (", with a tare", tared)):
        chosen = [row for row in ceiling_rows(found, 2000) if "change" not in row["name"]]
        rows += [{**row, "name": row["name"].replace(", object never touched", "") + name} for row in chosen]
    return rows


def _cells(
    sample: GraspSample, readings: Float64, predicted: Mapping[str, Float64], reference: Float64
) -> Iterator[dict[str, Any]]:
    """A grasp with its (n, 50) repeats, as the cells of the experiment `noise_ceiling` give it."""
    variance = readings.var(axis=0, ddof=1)
    tables = {"mean": readings.mean(axis=0), "rest": (1.0 - 1.0 / len(readings)) * variance, "within": variance,
              "within_change": variance, "reference": reference, "modalities": SIZES}  # fmt: skip
    yield {"what": "repeats", "name": NEW_OBJECT, "id": sample.id, **tables}
    for name, counts in predicted.items():
        yield {"what": "predictor", "name": name, "id": sample.id, "predicted": counts}


if __name__ == "__main__":
    picture = {"type": Path, "default": ROOT / "docs" / "touch.png"}
    command(
        __doc__,
        tables,
        {"--runs": {"type": int, "default": 20}, "--model": {"default": "simulated"}, "--picture": picture},
    )
