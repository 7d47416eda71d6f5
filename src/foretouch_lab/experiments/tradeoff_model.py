# SPDX-License-Identifier: Apache-2.0
"""Area `model`: skill of touch models on held-out grasps against the time of 1 to 1000 grasps on a cloud.

This area trains no network. It takes the skill of the papers' networks from the leaderboard of touch models, which has the same folds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.predictor import Estimate
from foretouch.models.registry import load_model
from foretouch.models.touch_model import History, TouchModel
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import BIOTAC, MODALITIES
from foretouch.types import Cloud, Float64, Grasp, Plane, Sample
from foretouch_lab.experiments.framework.experiment import Row, Table, require_data
from foretouch_lab.experiments.framework.manifest import read_results
from foretouch_lab.experiments.framework.tradeoff import Panel, Timed, TradeoffSettings, Variant, make_area, times_text
from foretouch_lab.experiments.shared.scores import labelled, skill_rows
from foretouch_lab.learning.data import Dataset, labels_of, make_folds
from foretouch_lab.learning.data.folds import Fold
from foretouch_lab.learning.evaluation.baselines import object_mean
from foretouch_lab.learning.evaluation.metrics import MEAN, error_rows
from foretouch_lab.learning.prequential import TimedReadings, replay
from foretouch_lab.learning.training.calibration import HeldOutPredictions, fit_group
from foretouch_lab.learning.training.contact import ContactPredictor
from foretouch_lab.learning.training.run_config import load_run_config, recipe_of
from foretouch_lab.learning.training.tracker import fit_tracker

SHIPPED: Final = "contact-v3"
_OUTPUTS: Final = f"model.outputs=[{','.join(MODALITIES)}]"
NETWORKS: Final = {
    "P1's PointNet": f"p1 {_OUTPUTS} train.epochs=17",
    "P2's PointNet, 256 points": f"p2 {_OUTPUTS} model.n_points=256 train.epochs=20",
    "P2's SR-GAN, 256 points": f"p2_srgan {_OUTPUTS} model.n_points=256 srgan.epochs=5",
}
"""The papers' networks by their recipes on the leaderboard: one network for all modalities, trained for fewer epochs."""
_MEAN, _OBJECT = "mean of labels", "mean of the object"
_COLUMNS: Final = ("data", "predictor", "split", "modality", "skill", "skill_low", "skill_high")  # of a leaderboard
READINGS: Final = " + readings"
_SPLITS: Final = {"time": "blocks of time", "object": "objects left out"}
PAUSE_S: Final = 0.02  # asleep before each call, as between the clouds of a camera
_BUDGET_MS: Final = 10.0  # of the answer
_REQUESTS: Final = (1, 10, 100, 1000)  # grasps on a cloud
VARIANTS: Final = (
    Variant(_MEAN, "part"),
    Variant(_OBJECT, "part"),
    Variant(_MEAN + READINGS, "readings"),
    *(Variant(f"{count} trees", "trees", {"trees": count}) for count in (5, 10, 20)),
    Variant("no surroundings", "part", {"part": True}),
    Variant(SHIPPED, "shipped"),
    Variant(SHIPPED + READINGS, "readings"),
    *(Variant(name, "reference") for name in NETWORKS),
)
"""In the order of the table of models."""


@dataclass(frozen=True, kw_only=True)
class ModelSettings(TradeoffSettings):
    """Settings of the area."""

    leaderboard: str = setting(
        "",
        "Table of `foretouch benchmark touch` with the skill of the papers' networks; they are timed alone without it",
    )


@lru_cache(maxsize=1)
def described(data: Dataset) -> tuple[ContactPredictor, dict[str, int]]:
    """Return the shipped recipe for the labelled samples, whose features are computed once; and the place of each by its id."""
    samples = labelled(data)
    recipe: Any = load_run_config(SHIPPED)
    predictor = ContactPredictor(samples, labels_of(samples), recipe.contact)
    return predictor, {sample.id: k for k, sample in enumerate(samples)}


class MeanPredictor:
    """Predicts the mean of the training labels of a model for every grasp, and looks at no cloud."""

    def __init__(self, model: TouchModel) -> None:
        self.ranges = model.ranges
        self._mean: Float64 = cast("ContactEstimator", model.predictor).mean

    def estimate(self, _: Cloud, grasps: Sequence[Grasp], _table: Plane | None = None) -> Estimate:
        """Return the mean for every grasp, as in the distribution of training."""
        return Estimate(np.tile(self._mean, (len(grasps), 1)), np.zeros(len(grasps), np.bool_))


def fewer_trees(estimator: ContactEstimator, count: int) -> ContactEstimator:
    """Return the same model with the first trees of each forest alone, as if it had been fitted with that number."""
    return replace(estimator, forests={name: forest.first(count) for name, forest in estimator.forests.items()})


def _reduced(estimator: ContactEstimator, values: Mapping[str, Any]) -> ContactEstimator:
    """Return a fitted model with fewer trees, or without the surroundings of the contacts."""
    if "trees" in values:
        return fewer_trees(estimator, values["trees"])
    return replace(estimator, surroundings=False) if "part" in values else estimator


def _accuracy(split: str, settings: ModelSettings, data: Dataset) -> dict[str, Row]:
    """Return errors on the folds of a split."""
    networks = _of_leaderboard(split, settings.leaderboard, data)
    samples = labelled(data)
    folds = make_folds(samples, split, 0)
    errors: dict[str, list[Row]] = {}
    for fold in folds:
        train, test = fold.sides(samples)
        names, mean = [sample.object for sample in test], labels_of(train).mean(axis=0)
        for variant, predicted in _predictions(data, folds, fold):
            errors.setdefault(variant, []).extend(error_rows(names, predicted, labels_of(test), mean))
    return skill_rows(split, errors, settings.bootstrap) | networks


def _of_leaderboard(split: str, table: str, data: Dataset) -> dict[str, Row]:
    """Return the mean skills of the networks that a leaderboard holds."""
    rows = _read_leaderboard(table)
    if any(row["data"] != data.sha256[:16] for row in rows):
        raise ConfigError(f"leaderboard: {table} is of other data than {data.name}")
    found = {row["predictor"]: row for row in rows if row["split"] == split and row["modality"] == MEAN}
    return {
        name: {split + end: found[recipe][f"skill{end}"] for end in ("", "_low", "_high")}
        for name, recipe in NETWORKS.items()
        if recipe in found
    }


def _read_leaderboard(table: str) -> list[Row]:
    """Return the rows of a leaderboard; none if no table is given. A `ConfigError` if it is another table."""
    rows = read_results(Path(table)) if table else []
    if table and not (rows and all(name in rows[0] for name in _COLUMNS)):
        raise ConfigError(f"leaderboard: {table} is not a results.csv of `foretouch benchmark touch`")
    return rows


def _prepare(settings: ModelSettings, source: Path | None, out: Path) -> Path:
    """Return the data; a leaderboard that cannot be read is refused before anything is measured."""
    _read_leaderboard(settings.leaderboard)
    return require_data(settings, source, out)


def _predictions(data: Dataset, folds: Sequence[Fold], fold: Fold) -> Iterator[tuple[str, Float64]]:
    """Iterate over predictions of the test side of a fold by all variants, which are fitted to its training side."""
    samples, (predictor, _) = labelled(data), described(data)
    labels, (train, test) = labels_of(samples), fold.sides(samples)
    fitted = predictor.fit(fold.train)
    vision = {}
    for variant in VARIANTS:
        if variant.name == SHIPPED or variant.values:
            vision[variant.name] = _reduced(fitted, variant.values).predict_rows(predictor.rows[fold.test])[0]
    yield from vision.items()
    yield _MEAN, np.tile(labels[fold.train].mean(axis=0), (len(test), 1))
    known_objects = {sample.object for sample in test} <= {sample.object for sample in train}
    if known_objects:
        yield _OBJECT, object_mean(train, labels[fold.train], test, 0)
    # A tracker of all readings before each grasp compares them with what was expected without them: by the mean of the
    # labels or by the shipped recipe, fitted without the part that is predicted. It is fitted to the training side.
    names, sessions = np.array([sample.object for sample in samples]), np.empty(len(samples), "U99")
    plain, seen = np.tile(labels[fold.train].mean(axis=0), (2, len(samples), 1))
    for part in folds:
        sessions[part.test] = [f"{name}/{part.name}" for name in names[part.test]]
        if part.name != fold.name:
            rest = np.setdiff1d(fold.train, part.test)
            plain[part.test] = labels[rest].mean(axis=0)
            seen[part.test] = predictor.fit(rest).predict_rows(predictor.rows[part.test])[0]
    seen[fold.test] = vision[SHIPPED]
    order = np.argsort([sample.stamp_ns for sample in samples], kind="stable")
    learned = order[np.isin(order, fold.train)]
    for name, expected in ((_MEAN, plain), (SHIPPED, seen)):
        recording = TimedReadings.of_samples(samples, labels, expected, predictor.rest)
        residuals = (expected[learned], labels[learned], names[learned], sessions[learned])
        group = fit_group(HeldOutPredictions(*residuals, BIOTAC), new=not known_objects)
        tracker = SensorTracker(fit_tracker(recording.take(learned), group, group))
        counts = np.empty_like(expected)
        counts[order] = replay(tracker, recording.take(order)).counts
        yield name + READINGS, counts[fold.test]


def _timed(variant: Variant, settings: ModelSettings, data: Dataset) -> Timed:
    """Return what predicts the touch of K grasps on a cloud of median size, (K, 50) counts."""
    sample, grasps = _scene(data, max(settings.requests))
    shipped = load_model(SHIPPED)
    name, _, readings = variant.name.partition(READINGS[:2])
    if variant.name in NETWORKS:
        return _network(NETWORKS[variant.name], sample.cloud, grasps), 1.0
    if variant.name in (_MEAN, _OBJECT):
        own = [other for other in labelled(data) if variant.name == _MEAN or other.object == sample.object]
        mean = labels_of(own).mean(axis=0)
        return lambda count: np.tile(mean, (count, 1)), 1.0
    if readings:
        if name == _MEAN:
            shipped = TouchModel(MeanPredictor(shipped), shipped.card, shipped.calibration)
        return _after_reading(shipped, sample, grasps), 1.0
    estimator = _reduced(cast("ContactEstimator", shipped.predictor), variant.values)
    return lambda count: estimator.estimate(sample.cloud, grasps[:count], sample.table).counts, 1.0


def _network(recipe: str, cloud: Cloud, grasps: Sequence[Grasp]) -> Callable[[int], Float64]:
    """Return the network of a recipe with random weights, for its time alone."""
    import torch

    from foretouch.models.network.preparation import prepare_cloud, prepare_grasps
    from foretouch_lab.learning.network.networks import TouchNet

    config = recipe_of(recipe).model
    net = TouchNet(config).eval()

    def answer(count: int) -> Float64:
        with torch.inference_mode():
            prepared = prepare_cloud(cloud, config)
            points = torch.from_numpy(prepared.points)[None].expand(count, -1, -1)
            inputs = torch.from_numpy(prepare_grasps(grasps[:count], prepared.frame, config))
            return net.counts(points, inputs).numpy()

    return answer


def _after_reading(model: TouchModel, sample: Sample, grasps: Sequence[Grasp]) -> Callable[[int], Float64]:
    """Return predictions right after one more reading of the hand, which is added to its history in each call."""
    expected = model.estimate(sample.cloud, [sample.grasp], sample.table).counts[0]
    reading, hand = labels_of([sample])[0], History(model)
    hand.start_object()

    def answer(count: int) -> Float64:
        now = hand.copy()
        now.tracker.add_touch(1, reading, expected)
        estimate = model.estimate(sample.cloud, grasps[:count], sample.table)
        return now.at(2, same_object=True).adapt(estimate)[0]

    return answer


def _scene(data: Dataset, count: int) -> tuple[Sample, list[Grasp]]:
    """Return a sample whose cloud is of median size, with its grasp and others.

    The others are between random points of the cloud, with the hand of the cloud's grasp.
    """
    samples = sorted(labelled(data), key=lambda sample: sample.cloud.size)
    sample = samples[len(samples) // 2]
    xyz = sample.cloud.finite.astype(np.float64)
    pairs = np.random.default_rng(0).integers(0, len(xyz), (50 * count, 2))
    width = np.linalg.norm(xyz[pairs[:, 0]] - xyz[pairs[:, 1]], axis=1)
    near = pairs[(width > 0.02) & (width < 0.1)][: count - 1]
    return sample, [sample.grasp, *(Grasp(xyz[a], xyz[b], sample.grasp.rotation) for a, b in near)]


def _summarise(rows: Sequence[Row]) -> list[Table]:
    """Return how many grasps the default model of the time of the table answers within a time."""
    shipped = [row for row in rows if row["factor"] == "shipped"]
    name = shipped[0]["variant"]
    sizes = f"{', '.join(str(row['request']) for row in shipped)} grasps on a cloud"
    texts = [times_text(row, rows).split(", ") for row in shipped]
    if len(texts[0]) == 1:
        loaded = "the machine was loaded, so that nothing is promised of the time of an answer"
        times = ", ".join(number for (number,) in texts)
        text = f"{name}, the default model, takes {times} ms of processor time for {sizes}; {loaded}."
    else:
        most = max((row["request"] for row in shipped if row["ms_p95"] <= _BUDGET_MS), default=0)
        _, p95, p99 = (", ".join(column) for column in zip(*texts, strict=True))
        answer = (
            f"In {_BUDGET_MS:g} ms you get the default model, {name}, for up to {most} grasps of the sizes measured"
        )
        text = f"{answer}: {sizes} take {p95} ms in 95 of 100 calls and {p99} ms in 99 (idle machine)."
    return [Table("In short", [], [], [text])]


EXPERIMENT = make_area(
    _accuracy,
    name="tradeoff_model",
    question="How good a prediction of touch can I have in 10 ms?",
    module=__name__,
    settings=ModelSettings,
    prepare=_prepare,
    presets={
        "smoke": {"skills": ["object"], "timing_s": 2.0, "requests": (1, 100)},
        "small": {"timing_s": 45.0, "pause_s": PAUSE_S, "requests": _REQUESTS},
        "full": {"timing_s": 420.0, "pause_s": PAUSE_S, "requests": _REQUESTS},
    },
    summarise=_summarise,
    data_folder="vision2tactile",
    variants=VARIANTS,
    timed=_timed,
    panels=(
        *(
            Panel(
                "time",
                count,
                f"Known objects (blocks of time), {count} grasp{'' if count == 1 else 's'}",
                "mean skill, blocks of time",
            )
            for count in (1, 100, 1000)
        ),
        Panel("object", 100, "New objects (left out), 100 grasps", "mean skill, objects left out"),
    ),
)
