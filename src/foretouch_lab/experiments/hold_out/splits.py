# SPDX-License-Identifier: Apache-2.0
"""Settings of the hold-out experiments, and what each of them holds out."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, DatasetError
from foretouch.types import Float64, GraspSample
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.hold_out.transfer import TRANSFER_METHODS
from foretouch_lab.experiments.p1_as_published import ObjectTypes
from foretouch_lab.experiments.shared.folds import by_object, some_grasps, some_objects, split_objects
from foretouch_lab.experiments.shared.predictors import NETWORKS, PREDICTORS
from foretouch_lab.experiments.shared.scores import labelled
from foretouch_lab.experiments.shared.simulated_data import (
    BothSettings,
    RealAndSimulated,
    SimulatedGrasps,
    SimulatedSettings,
)
from foretouch_lab.learning.data import Dataset, labels_of, make_folds
from foretouch_lab.learning.data.folds import Fold, random_folds
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig

KNOWN: Final = "known objects"
NEW: Final = "new objects"
SIMULATED: Final = "simulated new objects"
# What the training size of a condition of `learning_curve` counts.
UNITS: Final = {KNOWN: "grasps an object", NEW: "objects", SIMULATED: "objects"}

OBJECT_KNOWN: Final = "trained on the tested object alone"  # table of `lookalikes` that shows how much there is to gain

_FOLDS: Final = 5


@dataclass(frozen=True, kw_only=True)
class HoldOutSettings(Settings):
    """Settings of all hold-out experiments."""

    predictors: tuple[str, ...] = setting(
        tuple(name for name in PREDICTORS if name not in NETWORKS), "Predictors to compare", choices=tuple(PREDICTORS)
    )
    seeds: tuple[int, ...] = setting(
        (0, 1, 2, 3, 4), "Seeds of splits and predictors; errors are pooled over them", minimum=0
    )
    network_seeds: int = setting(1, "Number of seeds that the slow networks are trained with", minimum=1)
    training_fraction: float = setting(
        1.0, "Fraction of trees and epochs; below 1 only for quick trials", bounds=(0.001, 1.0)
    )
    references: tuple[str, ...] = setting(
        ("geometry_trees",), "Predictors that the others are compared with", choices=tuple(PREDICTORS)
    )
    bootstrap: BootstrapConfig = BootstrapConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("predictors", "seeds", *(["touches"] if isinstance(self, TouchSettings) else [])):
            values = getattr(self, name)
            if not values or len(set(values)) != len(values):
                raise ConfigError(f"{name}: {list(values)} must contain at least one value and no duplicates")


@dataclass(frozen=True, kw_only=True)
class CrossTypeSettings(HoldOutSettings):
    """Settings of `cross_type`."""

    types: ObjectTypes = ObjectTypes()


@dataclass(frozen=True, kw_only=True)
class TouchSettings(HoldOutSettings):
    """Settings of `unseen_object`."""

    touches: tuple[int, ...] = setting((0, 1, 3, 5), "Numbers of touches of the object", bounds=(0, 1000))
    draws: int = setting(20, "Number of random draws of the touched grasps", bounds=(1, 1000))


@dataclass(frozen=True, kw_only=True)
class SimToRealSettings(TouchSettings, BothSettings):
    """Settings of `sim_to_real`."""

    predictors: tuple[str, ...] = setting(
        ("training_mean", "geometry_trees", *TRANSFER_METHODS, "contact"),
        "Predictors to compare",
        choices=(*PREDICTORS, *TRANSFER_METHODS),
    )


@dataclass(frozen=True, kw_only=True)
class LookalikesSettings(TouchSettings, SimulatedSettings):
    """Settings of `lookalikes`."""

    grasps_per_session: int = setting(
        25, "Number of grasps in a session with one object, including the touched ones", minimum=2
    )


@dataclass(frozen=True, kw_only=True)
class LearningCurveSettings(HoldOutSettings, BothSettings):
    """Settings of `learning_curve`."""

    test_conditions: tuple[str, ...] = setting(tuple(UNITS), "Data and splits to test on", choices=tuple(UNITS))
    grasps: tuple[int, ...] = setting((5, 10, 20, 40), "Numbers of training grasps of each known object", minimum=1)
    objects: tuple[int, ...] = setting((2, 4, 7), "Numbers of real training objects", minimum=1)
    simulated_objects: tuple[int, ...] = setting(
        (5, 10, 20, 40, 80), "Numbers of simulated training objects", minimum=1
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _TrainTestSplit:
    """Grasps that predictors are fitted to, and those that they are tested on."""

    train: Sequence[GraspSample]
    tested: Sequence[Sequence[GraspSample]]  # where objects are touched, the grasps of each
    table: str = ""  # table of the results; "" for those by number of touches
    part: str  # unique in the table
    mean: Float64 | None = None  # (50,) reference of the skill; by default the mean of the training labels [counts]
    columns: Row = field(default_factory=dict)  # further columns of the results


Splitter = Callable[[Any, Any, int], Iterator[_TrainTestSplit]]  # from settings, data and a seed


def folds(name: str) -> Splitter:
    """Folds of a named split over all objects, as one table."""

    def _split(_settings: HoldOutSettings, data: Dataset, seed: int) -> Iterator[_TrainTestSplit]:
        samples = labelled(data)
        if not samples:
            raise DatasetError("experiment: no sample is labelled")
        return (_of_fold(samples, fold, name) for fold in make_folds(samples, name, seed))

    return _split


def objects(_settings: TouchSettings, data: Dataset | RealAndSimulated, _seed: int) -> Iterator[_TrainTestSplit]:
    """Each real object."""
    samples = labelled(data.real if isinstance(data, RealAndSimulated) else data)
    return (_of_fold(samples, fold, "") for fold in make_folds(samples, "object", 0))


def types(settings: CrossTypeSettings, data: Dataset, seed: int) -> Iterator[_TrainTestSplit]:
    """Five random folds within each type of objects, and one type against the other."""
    samples = labelled(data)
    found = settings.types.indices(samples)
    for name in ("cylinders", "boxes"):
        if not len(found[name]):
            raise DatasetError(f"cross_type: none of the objects is among types.{name}")
    typed = {*settings.types.cylinders, *settings.types.boxes}
    columns = {"untyped": " ".join(sorted({sample.object for sample in samples} - typed))}
    for name, index in found.items():
        if len(index) >= _FOLDS:
            for fold in random_folds(len(index), _FOLDS, np.random.default_rng(seed)):
                yield _of_fold(samples, Fold(index[fold.train], index[fold.test], fold.name), f"within {name}", columns)
    for one, other in (("cylinders", "boxes"), ("boxes", "cylinders")):
        table = f"{one} to {other}"
        yield _of_fold(samples, Fold(found[one], found[other], table), table, columns)


def _of_fold(samples: Sequence[GraspSample], fold: Fold, table: str, columns: Row | None = None) -> _TrainTestSplit:
    train, test = ([samples[k] for k in side] for side in (fold.train, fold.test))
    return _TrainTestSplit(train=train, tested=[test], table=table, part=fold.name, columns=columns or {})


def sizes(settings: LearningCurveSettings, data: RealAndSimulated, seed: int) -> Iterator[_TrainTestSplit]:
    """Some of the training grasps or objects of each condition, drawn by the seed.

    The reference is the mean of the *full* training side at every size, so that all sizes are comparable.
    """
    counts = {KNOWN: settings.grasps, NEW: settings.objects, SIMULATED: settings.simulated_objects}
    for condition in settings.test_conditions:
        if condition == SIMULATED:
            train, test = split_objects(labelled(data.simulated), max(settings.simulated_objects), 0)
            whole = [_TrainTestSplit(train=train, tested=[test], part="all")]
        else:
            whole = list(folds("time" if condition == KNOWN else "object")(settings, data.real, 0))
        draw = some_grasps if condition == KNOWN else some_objects
        for size in counts[condition]:
            columns = {"condition": condition, "size": size}
            for one in whole:
                chosen, mean = draw(one.train, size, seed), labels_of(one.train).mean(axis=0)
                table = f"{condition}, {size} {UNITS[condition]}"
                yield replace(one, train=chosen, mean=mean, table=table, columns=columns)


def sessions(settings: LookalikesSettings, data: SimulatedGrasps, _seed: int) -> Iterator[_TrainTestSplit]:
    """Half of the sessions with each object, each under an object name of its own, since the cloud does not show it.

    Fits are to the other half of all objects, or of the tested object alone.
    """
    train: dict[str, list[GraspSample]] = {}
    tested: dict[str, list[list[GraspSample]]] = {}
    size = settings.grasps_per_session
    for own in by_object(labelled(data.collection)):
        name, half = own[0].object, len(own) // 2
        train[name] = [replace(one, object=f"{name}/train{k // size:03d}") for k, one in enumerate(own[:half])]
        starts = enumerate(range(half, len(own) - size + 1, size))
        tested[name] = [[replace(one, object=f"{name}/{k:03d}") for one in own[a : a + size]] for k, a in starts]
    if not any(tested.values()):
        raise DatasetError(f"{data.collection.name}: too few grasps for a session of {size}")
    every = [sample for own in train.values() for sample in own]
    mean = labels_of(every).mean(axis=0)
    yield _TrainTestSplit(train=every, tested=[one for own in tested.values() for one in own], part="all", mean=mean)
    for name, own in train.items():
        yield _TrainTestSplit(train=own, tested=tested[name], table=OBJECT_KNOWN, part=name, mean=mean)
