# SPDX-License-Identifier: Apache-2.0
"""Skill of each model on held-out grasps; all models of a fold share what is described and fitted alike."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError
from foretouch.experiments.framework.experiment import Cell, Row, require_data
from foretouch.experiments.shared.folds import split_objects
from foretouch.experiments.shared.scores import error_rows, labelled
from foretouch.experiments.shared.simulated_data import BothSettings, load_both, prepare_both
from foretouch.learning.data import Dataset, Fold, load_dataset, make_folds
from foretouch.learning.evaluation.metrics import MEAN as MEAN_SKILL
from foretouch.learning.evaluation.metrics import BootstrapConfig, ObjectErrors, skills
from foretouch.models.card import read_card
from foretouch.models.registry import find_card
from foretouch.tactile import MODALITIES
from foretouch.tradeoff.area import TradeoffSettings
from foretouch.tradeoff.areas.model.contact import Described, FittedContact, predict_fold
from foretouch.tradeoff.areas.model.variants import NETWORK, RECIPES, list_variants
from foretouch.types import Float64

SPLITS: Final = {"time": "blocks of time", "object": "objects left out", "random": "random folds"}
"""Splits of the real grasps, with what is held out."""

SIMULATED: Final = "simulated"
FREE: Final = ("splits", "seeds", "recipes", "bootstrap", "timing_s", "requests", "seed")
"""Settings that no cell depends on: a sweep may be resumed with others."""

_CONTACT: Final = "contact"
_SECONDS: Final = {"contact": 20.0, "touchnet": 95.0, "narrow": 30.0, "wide": 85.0, "T-Net": 80.0}
"""Processor time of a cell on the machine of the benchmarks [s]."""

_BASE_FIT_S: Final = 0.11  # of `_probe` there


@dataclass(frozen=True, kw_only=True)
class ModelSettings(TradeoffSettings):
    """Settings of the area `model`."""

    requests: tuple[int, ...] = setting((1, 10, 100, 1000), "Grasps per cloud that are timed", minimum=1)
    splits: tuple[str, ...] = setting(tuple(SPLITS), "Splits on which skill is measured", choices=tuple(SPLITS))
    seeds: tuple[int, ...] = setting((0,), "Seeds of random folds and of the trees", minimum=0)
    full: bool = setting(False, "Fit more contact models, and time more networks")
    recipes: tuple[str, ...] = setting((), "Networks that are trained on blocks of time", choices=tuple(RECIPES))
    simulated: int = setting(0, "Simulated grasps on which skill is measured too; 0 for none", minimum=0)
    scene: str = setting("config/scenes/unseen_objects.yaml", "Scene of the simulated grasps")
    bootstrap: BootstrapConfig = BootstrapConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.splits or not self.seeds:
            raise ConfigError("ModelSettings.splits, seeds: must hold at least one value")


@dataclass(frozen=True, eq=False)
class ModelData:
    """Real grasps, and simulated ones if they are asked for."""

    real: Dataset
    simulated: Dataset | None

    @property
    def sha256(self) -> str:
        """Hash of the content."""
        return self.real.sha256 + ("" if self.simulated is None else self.simulated.sha256)


def prepare(settings: ModelSettings, source: Path | None, out: Path) -> Path:
    """Simulate what is asked for; see `Experiment.prepare`."""
    if not settings.simulated:
        return require_data(settings, source, out)
    return prepare_both(BothSettings(scene=settings.scene, samples=settings.simulated), source, out)


def load(settings: ModelSettings, path: Path) -> ModelData:
    """Read the data of `prepare`."""
    if not settings.simulated:
        return ModelData(load_dataset(path), None)
    both = load_both(BothSettings(scene=settings.scene, samples=settings.simulated), path)
    return ModelData(both.real, both.simulated)


def cells(settings: ModelSettings, data: ModelData) -> list[Cell]:
    """A cell for each fold and seed, which fits all contact models, and one for each training of a network."""
    found = [
        _cell(_CONTACT, split, fold.name, seed)
        for split in settings.splits
        for seed in settings.seeds
        for fold in make_folds(labelled(data.real), split, seed)
    ]
    if data.simulated is not None:
        found.append(_cell(_CONTACT, SIMULATED, "half of the objects", 0))
    blocks = make_folds(labelled(data.real), "time", 0)
    found += [_cell(recipe, "time", fold.name, 0) for recipe in settings.recipes for fold in blocks]
    return found


def _cell(model: str, split: str, part: str, seed: int) -> Cell:
    values: Row = {"model": model, "split": split, "part": part, "seed": seed}
    if model != _CONTACT:
        values["trains"] = 2 if model == "touchnet" else 1
    return Cell("+".join((model, split, part, f"seed{seed}")).replace(" ", "_"), values)


def run(cell: Cell, settings: ModelSettings, data: ModelData) -> list[Row]:
    """Errors of all variants of a model on one fold."""
    model, split, part, seed = (cell.values[key] for key in ("model", "split", "part", "seed"))
    described = _described(data, simulated=split == SIMULATED)
    fold = _fold(described, split, part, seed)
    labels, mean = described.labels[fold.test], described.labels[fold.train].mean(axis=0)
    tested = [described.samples[k] for k in fold.test]
    found = (
        _contact(described, fold, settings, seed) if model == _CONTACT else _network(model, described, fold, settings)
    )
    return [
        {"variant": name, **row} for name, predicted in found for row in error_rows(tested, predicted, labels, mean)
    ]


def _contact(described: Described, fold: Fold, settings: ModelSettings, seed: int) -> Iterator[tuple[str, Float64]]:
    fitted = FittedContact(described, fold.train, seed)
    for variant in list_variants(full=settings.full):
        if variant.values["kind"] == "mean":
            yield variant.name, np.tile(described.labels[fold.train].mean(axis=0), (len(fold.test), 1))
        elif variant.values["kind"].startswith("contact"):
            yield variant.name, predict_fold(described, fold, fitted, variant.values)


def _network(recipe: str, described: Described, fold: Fold, settings: ModelSettings) -> Iterator[tuple[str, Float64]]:
    from foretouch.tradeoff.areas.model.networks import trained_rows

    return trained_rows(recipe, described, fold, list_variants(full=settings.full))


@lru_cache(maxsize=2)
def _described(data: ModelData, *, simulated: bool) -> Described:
    chosen = data.simulated if simulated else data.real
    assert chosen is not None  # noqa: S101  there is no such cell else
    return Described(labelled(chosen))


def _fold(described: Described, split: str, part: str, seed: int) -> Fold:
    if split == SIMULATED:
        number = {id(sample): k for k, sample in enumerate(described.samples)}
        sides = split_objects(described.samples, len(set(described.objects)) // 2, 0)
        train, test = (np.array([number[id(sample)] for sample in side], np.intp) for side in sides)
        return Fold(train, test, part)
    return next(one for one in make_folds(described.samples, split, seed) if one.name == part)


def tabulate(settings: ModelSettings, rows: Sequence[Row]) -> list[Row]:
    """A row for each variant: on each split the skill with its interval, its deviation over folds, and the errors.

    touchnet-v1 has the skills of its card where it was not trained here.
    """
    splits = [*settings.splits, *[SIMULATED] * bool(settings.simulated)]
    result = []
    for name in dict.fromkeys(row["variant"] for row in rows):
        row: Row = {"variant": name}
        for split in splits:
            own = [one for one in rows if (one["variant"], one["split"]) == (name, split)]
            row |= _scores(split, own, settings.bootstrap)
        result.append(row)
    if not any(row["variant"] == NETWORK for row in result):
        result.append({"variant": NETWORK} | dict.fromkeys(_columns(splits)))
    card = read_card(find_card(NETWORK))["skill"]
    network = next(row for row in result if row["variant"] == NETWORK)
    for split in settings.splits:
        if network[split] is None:
            network[split] = round(float(np.mean([card[split][name]["skill"] for name in MODALITIES])), 5)
            network |= {f"{split}_{name}": card[split][name]["skill"] for name in MODALITIES}
            network |= {f"{split}_rmse_{name}": card[split][name]["rmse"] for name in MODALITIES}
    return result


def _columns(splits: Sequence[str]) -> list[str]:
    ends = ["", "_low", "_high", "_sd", *(f"_{name}" for name in MODALITIES), *(f"_rmse_{name}" for name in MODALITIES)]
    return [f"{split}{end}" for split in splits for end in ends]


def _scores(split: str, rows: Sequence[Row], bootstrap: BootstrapConfig) -> Row:
    if not rows:
        return dict.fromkeys(_columns([split]))
    errors = _errors(rows)
    found = skills(errors, bootstrap)
    mean = found[MEAN_SKILL]
    folds = {(one["part"], one["seed"]) for one in rows}
    each = [
        skills(_errors([one for one in rows if (one["part"], one["seed"]) == fold]), bootstrap.replace(draws=100))
        for fold in folds
    ]
    row: Row = {split: mean.value, f"{split}_low": mean.low, f"{split}_high": mean.high}
    row |= {f"{split}_sd": float(np.std([one[MEAN_SKILL].value for one in each]))}
    row |= {f"{split}_{modality}": found[modality].value for modality in MODALITIES}
    row |= {f"{split}_rmse_{modality}": value for modality, value in errors.rmse().items()}
    return {key: None if value is None else round(value, 5) for key, value in row.items()}


def _errors(rows: Sequence[Row]) -> ObjectErrors:
    return ObjectErrors.total(
        [(one["object"], one["count"], np.array(one["squared"]), np.array(one["reference"])) for one in rows]
    )


def seconds(settings: ModelSettings, data: ModelData, left: Sequence[Cell]) -> float:
    """Processor time of cells: what they took on another machine, times how much slower this one fits some trees [s]."""
    del settings, data
    slower = _probe() / _BASE_FIT_S
    kinds = [one.values["model"] for one in left]
    return slower * sum(_SECONDS[kind] for kind in kinds)


def _probe() -> float:
    from sklearn.ensemble import ExtraTreesRegressor

    rng = np.random.default_rng(0)
    rows, labels = rng.normal(size=(640, 54)), rng.normal(size=(640, 50))
    start = time.process_time()
    model: Any = ExtraTreesRegressor(20, min_samples_leaf=6, max_features=0.5, random_state=0)
    model.fit(rows, labels)
    return time.process_time() - start
