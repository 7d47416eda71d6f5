# SPDX-License-Identifier: Apache-2.0
"""The functions of `import foretouch as ft`: each step of the pipeline with its defaults, in one call."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy.typing as npt

from foretouch.base.files import as_path
from foretouch.dataset.formats import open_samples
from foretouch.dataset.samples import SampleSet
from foretouch.doors import FUNCTIONS
from foretouch.errors import TactileError, checked
from foretouch.grasp.messages import decode_predictions
from foretouch.models.touch_model import TouchModel
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.types import Cloud, Grasps, Prediction, Predictions, Sample
from foretouch.types.scene import Object, Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Scores(Protocol):
    """Scores of models and baselines on the same held-out samples; `print` shows them as a table.

    Attributes:
        scores: By split, predictor and modality: `rmse` and `interval_score` in the unit of the sensor, `nrmse`, `skill`, `coverage90`.
        samples: By split, how many samples were scored.
        notes: How each model was held out, a line each.
    """

    scores: dict[str, dict[str, dict[str, dict[str, float]]]]
    samples: dict[str, int]
    notes: tuple[str, ...]

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each split and predictor as plain data."""
        ...


@checked
def segment(cloud: Cloud, *, mask: npt.ArrayLike | None = None, config: PipelineConfig | None = None) -> Scene:
    """Find the table and the objects on it.

    Args:
        cloud: (H, W, 3), such as of `Cloud.from_depth`, or (N, 3) points [m], optical frame of the camera.
        mask: (H, W) integers or bool, labels of the objects; 0 and negative numbers are no object. They become the
            ids; the table is found in the rest of the image.
        config: Settings of all steps; the defaults if None.

    Returns:
        The scene: `table`, `objects` (nearest first), `labels` (H, W), `at(u, v)`, `near(point)`, `status` and `reason`.
        What cannot be used is in its status, such as `no_plane`, and not raised.

    Raises:
        CloudError: If the mask does not fit the image, or an array is passed for the cloud.
    """
    return Pipeline(config).segment(cloud, mask=mask)


@checked
def plan(
    target: Object,
    *,
    count: int | None = None,
    hand: str | Path | None = None,
    mass_kg: float | None = None,
    friction: float | None = None,
    config: PipelineConfig | None = None,
) -> Grasps:
    """Plan two-finger grasps on an object.

    Args:
        target: An object of a `Scene`, whose other objects are avoided.
        count: Most grasps; by default one.
        hand: A described hand that must find a way to the object, such as `franka_hand`, or the path of a YAML file.
        mass_kg: Mass of the object [kg]; grasps that cannot carry it get the flag `cannot_carry`. None if it is not known.
        friction: Coefficient between fingertips and object; 0.8 if None.
        config: Settings of all steps; the defaults if None.

    Returns:
        Columns of K grasps, best first: `g1`, `g2` (K, 3) and `pose` (K, 4, 4) [m] in the frame of the cloud, `score` (K,).
        Without a grasp K is 0, and `status` and `reason` say why.

    Raises:
        CloudError: If a scene, a cloud or background is passed for the object.
        ConfigError: If there is no such hand, or the count is out of its bounds.
    """
    pipeline = Pipeline(config)
    given: dict[str, tuple[str, int | float | str | Path | None]] = {
        "count": ("grasp.count", count),
        "hand": ("hand.name", hand),
        "mass_kg": ("object.mass_kg", mass_kg),
        "friction": ("object.friction", friction),
    }
    for name, (key, value) in given.items():
        if value is not None:
            pipeline.config = pipeline.config.updated({key: value}, name)
    return pipeline.plan(target).grasps


@checked
def reading(message: Any) -> Prediction | Predictions:
    """Read the predicted readings in a message, such as `reading(message)["E"].value`.

    Args:
        message: A `foretouch_msgs/TouchPrediction`, or any object with its fields; ROS need not be installed. Or a
            `TouchPredictionBatch` or `TouchPredictionArray`, with K grasps.

    Returns:
        What a touch model returns in Python: `reading(message)[channel]` has `value`, `lower` and `upper`, float64 arrays by
        finger in the order of `message.fingers`: (F, N) for a channel of the taxels, (F,) for a scalar, with a first
        dimension K for K grasps. Values are NaN if there is no prediction, bounds without calibration.

    Raises:
        TactileError: If it is no such message, or the number of values does not fit the names.
    """
    if not hasattr(message, "predictions") and not hasattr(message, "fingers"):
        rule = "is not a TouchPrediction, TouchPredictionBatch or TouchPredictionArray of foretouch_msgs"
        raise TactileError(f"message: {type(message).__name__} {rule}")
    try:
        rows = decode_predictions(message)
    except (AttributeError, TypeError) as err:  # of another object that has some of the fields
        raise TactileError(f"message: {type(message).__name__} lacks a field of a message: {err}") from err
    many = hasattr(message, "predictions") or hasattr(message, "statuses")
    return rows if many else rows[0]


@checked
def open(path: str | Path) -> SampleSet:  # noqa: A001
    """Open a dataset in any format that foretouch reads: a recording, a training store, vision2tactile folders.

    Args:
        path: The dataset.

    Returns:
        Its samples, read on demand: iteration gives `Sample`, `to_arrays()` columns, `split(…)` parts. They are those of now, read
        by absolute paths; threads, forked and spawned processes read them too.

    Raises:
        FileError: If there is no dataset, or it is damaged, cut off or of another version.
    """
    return open_samples(as_path(path).absolute())


@checked
def fit(samples: SampleSet | Sequence[Sample] | str | Path, recipe: str = "contact-v3", **settings: Any) -> TouchModel:
    """Fit a touch model to samples; requires `foretouch[lab]`.

    Args:
        samples: Labelled samples, or the path of a dataset.
        recipe: A recipe or method of `foretouch train`.
        settings: Of the run, such as `calibrate=False`; groups as a dictionary, such as `contact={"trees": 50}`.

    Returns:
        The model, as `load_model` gives it. `save(folder)` writes it, and `load_model(folder)` reads it again.

    Raises:
        DatasetError: If there are too few samples, or one cannot be used.
        MissingDependencyError: If the laboratory is not installed.
    """
    model: TouchModel = FUNCTIONS.call("fit", "foretouch.fit", samples, recipe, settings)
    return model


@checked
def calibrate(
    predictor: Any,
    samples: SampleSet | Sequence[Sample] | str | Path,
    split: str = "object",
    *,
    name: str = "",
    refit: bool | None = None,
    seed: int = 0,
    workers: int = 1,
) -> TouchModel:
    """Make a touch model of a predictor of your own, with a rest level, intervals and adaptation; requires `foretouch[lab]`.

    Args:
        predictor: An object with `estimate(cloud, grasps, table=None)`, which returns (K, D) numbers in the unit of the sensor or
            an `Estimate` (`foretouch.models.predictor`); or a class or function that makes one, or the name of either. If it has
            `fit(samples)`, it is fitted to all samples, and again without those of each fold. Otherwise it is used as it is.
        samples: Labelled samples, or the path of a dataset. A predictor without `fit` should not have been trained on them.
        split: What is left out for the intervals: `object`, `time` or `random`, as of `SampleSet.split`. Where the predictor says
            which grasps are familiar, those get the intervals of `time`.
        name: Of the model; by default of the predictor's class.
        refit: Whether it is fitted; by default if it can be.
        seed: Of random folds.
        workers: Number of processes.

    Returns:
        The model, as `load_model` gives it. `save(folder)` writes it; `load_model(folder, predictor)` reads it again.

    Raises:
        ModelError: If it is no predictor, fails, or returns what cannot be used.
        DatasetError: If there are too few samples, or one cannot be used.
        MissingDependencyError: If the laboratory is not installed.
    """
    options = {"name": name, "refit": refit, "seed": seed, "workers": workers}
    model: TouchModel = FUNCTIONS.call("calibrate", "foretouch.calibrate", predictor, samples, split, **options)
    return model


@checked
def evaluate(
    models: Any,
    samples: SampleSet | Sequence[Sample] | str | Path,
    splits: Sequence[str] = ("random", "time", "object"),
    *,
    refit: bool | None = None,
    seed: int = 0,
    workers: int = 1,
) -> Scores:
    """Score a model and every baseline on the same held-out samples; requires `foretouch[lab]`.

    Args:
        models: A model, a predictor as of `calibrate` or its name `module:attribute`, or the name of a recipe of `foretouch train`; or
            several of them by name.
        samples: Labelled samples, or the path of a dataset.
        splits: What is left out: `random`, `time` and `object`, as of `SampleSet.split`; and `touches`, the first three grasps on each
            object left out in order of time, each adapted to the readings of those before.
        refit: Whether models and predictors are fitted again without the samples of each fold; by default predictors that can be.
            Models that are given as they are lose the samples that they were trained on.
        seed: Of random folds and of the baselines.
        workers: Number of processes.

    Returns:
        The scores; `print` shows them as a table. `records()` has its rows, `scores` all numbers, and `notes` how each model was held out.

    Raises:
        DatasetError: If there are too few samples, or none is held out.
        ModelError: If a predictor fails, or returns what cannot be used.
        MissingDependencyError: If the laboratory is not installed.
    """
    options = {"refit": refit, "seed": seed, "workers": workers}
    scores: Scores = FUNCTIONS.call("evaluate", "foretouch.evaluate", models, samples, splits, **options)
    return scores


@checked
def draw(
    scene: Scene | Object, grasps: Grasps | None = None, touch: Predictions | None = None, **options: Any
) -> "Figure":
    """Draw a scene, the first of its grasps and their predicted touch.

    Args:
        scene: What `segment` found, drawn with the outline and id of each object; or one object.
        grasps: On one object; contacts and closing line of the first are drawn from two sides.
        touch: Predictions for the grasps; the taxels of both fingers with their intervals, of the first grasp.
        options: `path` of a file to write the figure to, `number` of the grasp that is drawn, `sensor`.

    Returns:
        A figure of Matplotlib.
    """
    from foretouch.report.scene_figure import draw_scene

    return checked(draw_scene)(scene, grasps, touch, **options)
