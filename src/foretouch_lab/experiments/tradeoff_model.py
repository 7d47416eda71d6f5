# SPDX-License-Identifier: Apache-2.0
"""Area `model`: skill of touch models on held-out grasps against the time of 1 to 1000 grasps on a cloud.

All contact models of a fold share what is described and fitted alike. Networks are trained on blocks of time alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError
from foretouch.models.budget import PAUSE_S, levels_of
from foretouch.models.card import read_card
from foretouch.models.contact.estimator import ContactEstimator, fewer_trees
from foretouch.models.contact.features import CONDITIONS
from foretouch.models.registry import find_card, load_model
from foretouch.models.touch_model import Estimator, History, TouchModel
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import BIOTAC, MODALITIES
from foretouch.types import Bool, Cloud, Float64, Grasp, GraspSample
from foretouch_lab.experiments.framework.experiment import Cell, Row, Table
from foretouch_lab.experiments.framework.tradeoff import (
    Area,
    Panel,
    Timed,
    TradeoffSettings,
    Variant,
    interval,
    time_column,
)
from foretouch_lab.experiments.shared.scores import equal_columns, error_rows, labelled, load, skill_columns
from foretouch_lab.learning.data import Dataset, labels_of, make_folds
from foretouch_lab.learning.data.folds import Fold, Indices
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig
from foretouch_lab.learning.prequential import TimedReadings, replay
from foretouch_lab.learning.training.calibration import HeldOutPredictions, fit_group, rest_level
from foretouch_lab.learning.training.contact import (
    ContactTrainingConfig,
    describe_objects,
    describe_samples,
    fit_contact,
    thinned_samples,
)
from foretouch_lab.learning.training.tracker import fit_tracker

if TYPE_CHECKING:
    from foretouch.models.network.config import ModelConfig

SHIPPED: Final = "contact-v2"
NETWORK: Final = "touchnet-v1"
_PAPERS: Final = "papers' four networks"
_MEAN, _OBJECT = "mean of labels", "mean of the object"
_SPLITS: Final = {"time": "blocks of time", "object": "objects left out"}
_CONTACT: Final = "contact"

_SHOWN: Final = (
    *(_MEAN, _OBJECT, f"{_MEAN} + readings", NETWORK, "10 trees", "no surroundings", "forests alone", SHIPPED),
    *(f"{SHIPPED} + readings", _PAPERS),
)
"""Variants of the table of models, in this order."""

_BUDGET_MS: Final = 10.0  # of the answer


@dataclass(frozen=True, kw_only=True)
class ModelSettings(TradeoffSettings):
    """Settings of the area."""

    requests: tuple[int, ...] = setting((1, 10, 100, 1000), "Grasps per cloud that are timed", minimum=1)
    splits: tuple[str, ...] = setting(tuple(_SPLITS), "Splits on which skill is measured", choices=tuple(_SPLITS))
    seeds: tuple[int, ...] = setting((0,), "Seeds of random folds and of the trees", minimum=0)
    networks: bool = setting(False, "Train networks on blocks of time")
    bootstrap: BootstrapConfig = BootstrapConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.splits or not self.seeds:
            raise ConfigError("splits, seeds: must hold at least one value")


def _variants(_settings: ModelSettings) -> Iterator[Variant]:
    yield _contact("shipped", SHIPPED)
    yield Variant(_PAPERS, "reference", {"kind": "papers"})
    yield Variant(_MEAN, "part", {"kind": "mean"})
    yield Variant(_OBJECT, "part", {"kind": "object"})
    for name in (_MEAN, SHIPPED):
        yield Variant(f"{name} + readings", "readings", {"kind": "readings", "of": name})
    for count in (5, 10, 20):
        yield _contact("trees", f"{count} trees", trees=count)
    for part in ("no surroundings", "forests alone"):
        yield _contact("part", part, part=part)
    yield _contact("trees x part", "10 trees, no surroundings", trees=10, part="no surroundings")
    yield Variant(NETWORK, "network", {"kind": "network"})
    for count in (64, 256, 1024):
        yield Variant(
            f"{count} points", "network", {"kind": "network", "changes": {"n_points": count, "sampler": "random"}}
        )


def _contact(factor: str, name: str, **values: Any) -> Variant:
    return Variant(name, factor, {"kind": _CONTACT, **values})


# Contact models.


class Described:
    """Samples with the features of their grasps, computed once.

    Attributes:
        samples, labels, objects: The samples, their (S, 50) labels [counts], and the names of their objects.
    """

    def __init__(self, samples: Sequence[GraspSample]) -> None:
        self.samples = list(samples)
        self.labels = labels_of(samples)
        self.objects = [sample.object for sample in samples]
        self._rows: dict[bool, Float64] = {}
        self._place = {sample.id: k for k, sample in enumerate(self.samples)}

    def index(self, samples: Sequence[GraspSample]) -> Indices:
        """(T,) places of some of the samples."""
        return np.array([self._place[sample.id] for sample in samples], np.intp)

    def rows(self, *, thinned: bool = False) -> Float64:
        """(S, F) features on whole clouds, or on thinned ones."""
        if thinned not in self._rows:
            copies = thinned_samples(self.samples, ContactTrainingConfig()) if thinned else None
            self._rows[thinned] = describe_samples(copies or self.samples)
        return self._rows[thinned]


@dataclass(frozen=True, eq=False)
class _ForestsAlone(ContactEstimator):
    """Without the kernel, and of any object."""

    def predict_rows(self, rows: Float64) -> tuple[Float64, Bool]:
        scaled = self._trees(rows[:, len(CONDITIONS) :])
        return scaled * self.deviation + self.mean, np.ones(len(rows), np.bool_)


def _fitted(data: Described, train: Indices, seed: int) -> ContactEstimator:
    """The shipped recipe fitted to some samples."""
    objects = [data.objects[k] for k in train]
    config = ContactTrainingConfig(seed=seed)
    return fit_contact(data.rows()[train], data.labels[train], objects, config, data.rows(thinned=True)[train])


def _reduced(estimator: ContactEstimator, values: Mapping[str, Any]) -> ContactEstimator:
    """A fitted model with fewer trees, or one part of it alone."""
    if "trees" in values:
        estimator = fewer_trees(estimator, values["trees"])
    if "part" not in values:
        return estimator
    if values["part"] == "no surroundings":
        return replace(estimator, surroundings=False)
    return _ForestsAlone(**{name: getattr(estimator, name) for name in ContactEstimator.__dataclass_fields__})


# The object by name, and what the hand has read.


def _with_readings(
    data: Described, folds: Sequence[Fold], fold: Fold, vision: Float64, seed: int
) -> Iterator[tuple[str, Float64]]:
    """Predictions of the test side of a fold by the mean of the object, and by a tracker of all readings before each grasp.

    The tracker compares readings with what was expected without them: by the mean of the labels or by the shipped recipe,
    fitted without the part of the data that is predicted. Its parameters are fitted to the training side. `vision` are
    (T, 50) predictions of the test side by that recipe [counts].
    """
    names, sessions = np.array(data.objects), np.empty(len(data.samples), "U99")
    own, plain, seen = np.tile(data.labels[fold.train].mean(axis=0), (3, len(names), 1))
    for name in np.unique(names[fold.train]):
        own[names == name] = data.labels[fold.train][names[fold.train] == name].mean(axis=0)
    known_objects = bool(np.isin(names[fold.test], names[fold.train]).all())
    if known_objects:
        yield _OBJECT, own[fold.test]
    for part in folds:
        sessions[part.test] = [f"{name}/{part.name}" for name in names[part.test]]
        if part.name != fold.name:
            rest = np.setdiff1d(fold.train, part.test)
            plain[part.test] = data.labels[rest].mean(axis=0)
            seen[part.test] = _fitted(data, rest, seed).predict_rows(data.rows()[part.test])[0]
    seen[fold.test] = vision
    order = np.argsort([sample.stamp_ns for sample in data.samples], kind="stable")
    train = order[np.isin(order, fold.train)]
    level, _ = rest_level([data.samples[k] for k in train])
    for name, expected in ((_MEAN, plain), (SHIPPED, seen)):
        recording = TimedReadings.of_samples(data.samples, data.labels, expected, level)
        held_out = HeldOutPredictions(expected[train], data.labels[train], names[train], sessions[train], BIOTAC)
        group = fit_group(held_out, new=not known_objects)
        tracker = SensorTracker(fit_tracker(recording.take(train), group, group))
        counts = np.empty_like(expected)
        counts[order] = replay(tracker, recording.take(order)).counts
        yield f"{name} + readings", counts[fold.test]


# Networks; torch is imported where one is needed.


def _network(values: Mapping[str, Any], config: ModelConfig, tensors: Mapping[str, Any], fallback: Any) -> Estimator:
    """The estimator of a variant from the architecture and the weights of a network."""
    from foretouch.models.network.checkpoint import NetworkEstimator
    from foretouch.models.network.folding import fold

    return NetworkEstimator(config.replace(**values.get("changes", {})), fold(config, tensors), fallback=fallback)


def _trained(data: Described, fold: Fold, settings: ModelSettings) -> Iterator[tuple[str, Float64]]:
    """Train the recipe of touchnet-v1 on a fold, and predict its test side by each variant of this network."""
    from foretouch.models.novelty import Fallback
    from foretouch_lab.learning.data.training_set import TrainingSet
    from foretouch_lab.learning.training.run_config import load_run_config
    from foretouch_lab.learning.training.supervised import train_network

    run: Any = load_run_config(NETWORK)
    train, tested = fold.sides(data.samples)
    net = train_network(TrainingSet.build(train, run.model), np.arange(len(train)), run.train.replace(seed=0))
    fallback = Fallback.fit(BIOTAC, describe_objects(train), data.labels[fold.train])
    for variant in _variants(settings):
        if variant.values["kind"] == "network":
            estimator = _network(variant.values, net.config, net.state_dict(), fallback)
            yield variant.name, np.concatenate([estimator.estimate(one.cloud, [one.grasp]).counts for one in tested])


def _timed_network(values: Mapping[str, Any]) -> Estimator:
    """A variant of touchnet-v1."""
    from foretouch.models.card import load_calibration
    from foretouch.models.network.checkpoint import load_network

    path = find_card(NETWORK)
    config, tensors, card = load_network(path)
    return _network(values, config, tensors, load_calibration(path, card, BIOTAC)[1])


def _papers(cloud: Cloud, grasps: Sequence[Grasp]) -> Callable[[int], Float64]:
    """Four eager networks of P2 on 750 points, one for each modality, of random weights: for their time alone."""
    import torch

    from foretouch.models.network.config import ModelConfig
    from foretouch.models.network.preparation import prepare_cloud, prepare_grasps
    from foretouch_lab.learning.network.networks import TouchNet

    torch.manual_seed(0)
    configs = [ModelConfig(outputs=(name,)) for name in MODALITIES]
    nets = [TouchNet(config).eval() for config in configs]

    def answer(count: int) -> Float64:
        with torch.inference_mode():
            prepared = prepare_cloud(cloud, configs[0])
            points = torch.from_numpy(prepared.points)[None].expand(count, -1, -1)
            inputs = torch.from_numpy(prepare_grasps(grasps[:count], prepared.frame, configs[0]))
            return torch.cat([net.counts(points, inputs) for net in nets], dim=1).numpy()

    return answer


# Skills.


def _cells(settings: ModelSettings, data: Dataset) -> list[Cell]:
    """A cell for each fold and seed, which fits all contact models, and one for each training of a network."""
    samples = labelled(data)
    found = [
        (_CONTACT, split, fold.name, seed)
        for split in settings.splits
        for seed in settings.seeds
        for fold in make_folds(samples, split, seed)
    ]
    if settings.networks:
        found += [(NETWORK, "time", fold.name, 0) for fold in make_folds(samples, "time", 0)]
    names = ("model", "split", "part", "seed")
    return [
        Cell("+".join((*one[:3], f"seed{one[3]}")).replace(" ", "_"), dict(zip(names, one, strict=True)))
        for one in found
    ]


def _run(cell: Cell, settings: ModelSettings, data: Dataset) -> list[Row]:
    """Errors of all variants of a model on one fold."""
    model, split, part, seed = (cell.values[key] for key in ("model", "split", "part", "seed"))
    described = describe(data)
    folds = make_folds(described.samples, split, seed)
    fold = next(one for one in folds if one.name == part)
    labels, mean = described.labels[fold.test], described.labels[fold.train].mean(axis=0)
    tested = [described.samples[k] for k in fold.test]
    if model == _CONTACT:
        fitted, rows = _fitted(described, fold.train, seed), described.rows()[fold.test]
        contact = [one for one in _variants(settings) if one.values["kind"] == _CONTACT]
        found = [(_MEAN, np.tile(mean, (len(tested), 1)))]
        found += [(one.name, _reduced(fitted, one.values).predict_rows(rows)[0]) for one in contact]
        found += _with_readings(described, folds, fold, dict(found)[SHIPPED], seed)
    else:
        found = list(_trained(described, fold, settings))
    return [
        {"variant": name, **row} for name, predicted in found for row in error_rows(tested, predicted, labels, mean)
    ]


@lru_cache(maxsize=1)
def describe(data: Dataset) -> Described:
    """The labelled samples with the features of their grasps; kept for the next cell."""
    return Described(labelled(data))


def _tabulate(settings: ModelSettings, rows: Sequence[Row]) -> list[Row]:
    """A row for each variant: on each split the skill with its interval, its deviation over folds, and the errors.

    touchnet-v1 has the skills of its card where it was not trained here.
    """
    result = []
    names = dict.fromkeys([*(row["variant"] for row in rows), NETWORK])
    found: dict[str, dict[str, list[Row]]] = {split: {name: [] for name in names} for split in settings.splits}
    for one in rows:
        found[one["split"]][one["variant"]].append(one)
    equal = {split: equal_columns(split, own, settings.bootstrap) for split, own in found.items()}
    for name in names:
        row: Row = {"variant": name}
        for split in settings.splits:
            own = found[split][name]
            row |= skill_columns(split, own, settings.bootstrap) | equal[split].get(name, {})
            if name == NETWORK and not own:
                skill = read_card(find_card(NETWORK))["skill"][split]
                row[split] = float(np.mean([skill[one]["skill"] for one in MODALITIES]))
                row |= {f"{split}_{one}": skill[one]["skill"] for one in MODALITIES}
                row |= {f"{split}_rmse_{one}": skill[one]["rmse"] for one in MODALITIES}
        result.append(row)
    return result


# Times.


def _timed(variant: Variant, settings: ModelSettings, data: Dataset) -> Timed:
    """See `Area.timed`: predicts the touch of K grasps on a cloud of median size, (K, 50) counts."""
    values, kind = variant.values, variant.values["kind"]
    sample, grasps = _scene(data, max(settings.requests))
    if kind == "papers":
        return _papers(sample.cloud, grasps), 1.0
    models = {one.name: one.model for one in levels_of(load_model(SHIPPED))}
    if kind in ("mean", "object"):
        own = [one for one in labelled(data) if kind == "mean" or one.object == sample.object]
        mean = labels_of(own).mean(axis=0)
        return lambda count: np.tile(mean, (count, 1)), 1.0
    if kind == "readings":
        return _after_reading(models[values["of"]], sample, grasps), 1.0
    shipped: Any = models[SHIPPED].estimator
    estimator = _timed_network(values) if kind == "network" else _reduced(shipped, values)
    return lambda count: estimator.estimate(sample.cloud, grasps[:count]).counts, 1.0


def _after_reading(model: TouchModel, sample: GraspSample, grasps: Sequence[Grasp]) -> Callable[[int], Float64]:
    """Predictions right after one more reading of the hand, which is added to the tracker in each call."""
    expected = model.estimator.estimate(sample.cloud, [sample.grasp]).counts[0]
    reading, tracker = labels_of([sample])[0], model.new_tracker()
    tracker.start_object()

    def answer(count: int) -> Float64:
        now = tracker.copy()
        now.add_touch(1, reading, expected)
        return History(now, 2).adapt(model.estimator.estimate(sample.cloud, grasps[:count]))[0]

    return answer


@lru_cache(maxsize=1)
def _scene(data: Dataset, count: int) -> tuple[GraspSample, list[Grasp]]:
    """A sample whose cloud is of median size, with its grasp and others.

    The others are between random points of the cloud, with the hand of its own grasp.
    """
    samples = sorted(labelled(data), key=lambda one: one.cloud.size)
    sample = samples[len(samples) // 2]
    xyz = sample.cloud.xyz.reshape(-1, 3)
    xyz = xyz[np.isfinite(xyz).all(axis=1)].astype(np.float64)
    pairs = np.random.default_rng(0).integers(0, len(xyz), (50 * count, 2))
    width = np.linalg.norm(xyz[pairs[:, 0]] - xyz[pairs[:, 1]], axis=1)
    near = pairs[(width > 0.02) & (width < 0.1)][: count - 1]
    return sample, [sample.grasp, *(Grasp(xyz[a], xyz[b], sample.grasp.rotation) for a, b in near)]


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"


def _summarise(rows: Sequence[Row]) -> list[Table]:
    """The answer, and the main models."""
    requests = sorted({row["request"] for row in rows if row["request"]})
    found = {(row["variant"], row["request"]): row for row in rows}
    keys = ("ms_p50", "ms_p95", "ms_p99") if (wall := time_column(rows) == "ms_p50") else ("cpu_ms",)

    def cell(name: str, count: int) -> str:
        row = found.get((name, count))
        return "–" if row is None else ", ".join(_two_digits(row[key]) for key in keys)

    shipped = [found[SHIPPED, count] for count in requests if (SHIPPED, count) in found]
    sizes = f"{', '.join(str(row['request']) for row in shipped)} grasps on a cloud"
    times = [", ".join(_two_digits(row[key]) for row in shipped) for key in keys]
    most = max((row["request"] for row in shipped if row["ms_p95"] <= _BUDGET_MS), default=0)
    text = (
        f"In {_BUDGET_MS:g} ms you get the default model, {SHIPPED}, for up to {most} grasps: {sizes} take {times[1]} ms "
        f"in 95 of 100 calls and {times[-1]} ms in 99 (idle machine)."
        if wall
        else f"{SHIPPED}, the default model, takes {times[0]} ms of processor time for {sizes}; the machine was loaded, so that "
        "nothing is promised of the time of an answer."
    )
    skills = [split for split in ("time", "object") if split in rows[0]]
    body = [
        [name, *(interval(row, one) or "–" for one in skills), *(cell(name, count) for count in requests)]
        for name in _SHOWN
        if (row := found.get((name, requests[0]))) is not None
    ]
    grasps = (f"{count} grasp{'s' * (count > 1)} [ms]" for count in requests)
    head = ["", *(f"skill, {_SPLITS[one]}" for one in skills), *grasps]
    note = f"Times: {'p50, p95, p99 of the wall time' if wall else 'medians of the processor time'}."
    return [Table("In short", [], [], [text]), Table("Models", head, body, [note])]


EXPERIMENT = Area(
    name="tradeoff_model",
    question="How good a prediction of touch can I have in 10 ms?",
    module=__name__,
    settings=ModelSettings,
    presets={
        "small": {"timing_s": 45.0, "pause_s": PAUSE_S, "seeds": [0]},
        "full": {"timing_s": 420.0, "pause_s": PAUSE_S, "seeds": [0, 1], "networks": True},
    },
    load=load,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=_summarise,
    resumable_settings=("splits", "seeds", "networks", "bootstrap", "timing_s", "pause_s", "requests"),
    data_folder="vision2tactile",
    variants=_variants,
    timed=_timed,
    skills={name: f"mean skill, {text}" for name, text in _SPLITS.items()},
    panels=(
        Panel("time", 1, "Known objects (blocks of time), 1 grasp"),
        Panel("time", 100, "Known objects (blocks of time), 100 grasps"),
        Panel("time", 1000, "Known objects (blocks of time), 1000 grasps"),
        Panel("object", 100, "New objects (left out), 100 grasps"),
    ),
)
