# SPDX-License-Identifier: Apache-2.0
"""How much of a touch can be predicted from cloud and grasp at all, and how much of that do predictors reach?

Test grasps are repeated with everything that no camera sees redrawn (`Repeater`). With y_r the n repeats of grasp i, m
their mean, s² their variance (n - 1), p a prediction and µ the mean of the training labels, each per value,

    of the best prediction, the mean of all repeats:   S_i = s²                                (1)
    of a predictor:                                    S_i = (p - m)² + s² (1 - 1/n)           (2)
    of the training mean:                              R_i = (µ - m)² + s² (1 - 1/n)           (3)

are unbiased estimates of the squared error on one new execution, for any number of repeats: in eqs. 2 and 3 the
variance of the mean of n repeats is s²/n. Skill is 1 - sum S / sum R as everywhere. Repeats keep the object itself, its
pose and its cloud: more than a model is given, so the ceiling is an upper bound. A predictor's `share` is its skill
over the ceiling's, on the same repeats. With `split: object` there is a second ceiling for objects that were never
touched: their material and day are unknown as well, and predictors are compared with that one.

Intervals are by bootstrap over the repeated grasps, with the same draws for ceiling and predictors: they are for other
grasps of the same objects in the same scene.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError, DatasetError, SimulationError
from foretouch.types import Float64, GraspSample
from foretouch.types.channels import Channels
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch_lab.experiments.shared.predictors import PREDICTORS, find_predictor
from foretouch_lab.experiments.shared.simulated_data import (
    SimulatedGrasps,
    SimulatedSettings,
    load_simulated,
    prepare_simulated,
)
from foretouch_lab.experiments.shared.tables import grouped, pivot, select, unique
from foretouch_lab.learning.data import labels_of
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.objects import ObjectConfig
from foretouch_lab.simulation.world import SampleKey

# Hidden causes and the simulated effects that draw them: how far the hand closes; which part of the pads makes contact;
# where the hand lands and how exactly it reaches its target; what the sensor adds over time.
CAUSES: Final = {
    "command": frozenset({"targets"}),
    "posture": frozenset({"posture"}),
    "placement": frozenset({"execution_error"}),
    "sensor": frozenset({"slip", "drift", "noise", "scan_hold"}),
}

# Also unknown of an object that was never touched: its day, and its material, that of any object of the scene.
NEW_OBJECT: Final = "new_object"

_MATERIAL: Final = ("young_pa", "thickness_m", "friction")
_TRIES: Final = 10  # per requested repeat
_BLOCK: Final = 10  # grasps per cell
_CEILING: Final = "ceiling"
_TAIL: Final = 0.025


@dataclass(frozen=True, kw_only=True)
class NoiseCeilingSettings(SimulatedSettings):
    """Settings of `noise_ceiling`."""

    grasps: int = setting(200, "Number of test grasps to repeat", bounds=(2, 100_000))
    repeats: int = setting(20, "Number of repeats of each grasp", bounds=(2, 10_000))
    single_cause_grasps: int = setting(
        60, "Number of these grasps that are also repeated with one cause at a time", minimum=0
    )
    split: str = setting(
        "labels",
        "labels: test on 200 grasps per object; time: on a block of time of each object; object: on a fifth of the objects",
        choices=("labels", "time", "object"),
    )
    predictors: tuple[str, ...] = setting(
        ("object_mean", "geometry_trees", "contact"),
        "Predictors to compare with the ceiling",
        choices=tuple(PREDICTORS),
    )
    training_fraction: float = setting(
        1.0, "Fraction of trees and epochs; below 1 only for quick trials", bounds=(0.001, 1.0)
    )
    draws: int = setting(2000, "Number of bootstrap samples of the grasps for the intervals", bounds=(100, 1_000_000))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.single_cause_grasps > self.grasps:
            count = self.single_cause_grasps
            raise ConfigError(f"single_cause_grasps: {count} exceeds grasps, {self.grasps}")


def _split(settings: NoiseCeilingSettings, data: SimulatedGrasps) -> tuple[list[GraspSample], list[GraspSample]]:
    """Training samples, and the test samples to repeat, which are spread evenly over all test samples."""
    collection = data.collection
    part = collection.parts(settings.split)[0]
    train, test = (
        [collection.samples[k] for k in collection.index(ids)] for ids in (part.train + part.unlabelled, part.test)
    )
    if settings.grasps > len(test):
        raise DatasetError(f"{collection.name}: {len(test)} test grasps are fewer than grasps, {settings.grasps}")
    chosen = np.linspace(0, len(test) - 1, settings.grasps).round().astype(int)
    return train, [test[k] for k in chosen]


def _cells(settings: NoiseCeilingSettings, _data: SimulatedGrasps) -> list[Cell]:
    whole = ["all", NEW_OBJECT] if settings.split == "object" else ["all"]
    blocks = [(cause, first) for cause in whole for first in range(0, settings.grasps, _BLOCK)]
    blocks += [(cause, first) for cause in CAUSES for first in range(0, settings.single_cause_grasps, _BLOCK)]
    cells = [{"what": "repeats", "name": cause, "first": first} for cause, first in blocks]
    cells += [{"what": "predictor", "name": name} for name in settings.predictors]
    return [Cell("+".join(map(str, values.values())), values) for values in cells]


def _run(cell: Cell, settings: NoiseCeilingSettings, data: SimulatedGrasps) -> list[Row]:
    train, test = _split(settings, data)
    labels = labels_of(train)
    if cell.values["what"] == "predictor":
        fitted = find_predictor(cell.values["name"], settings.training_fraction)(train, labels, 0)
        return [
            {"id": sample.id, "predicted": row.tolist()} for sample, row in zip(test, fitted.predict(test), strict=True)
        ]
    cause, first = cell.values["name"], cell.values["first"]
    hidden = {"all": frozenset(CAUSES), NEW_OBJECT: frozenset({*CAUSES, NEW_OBJECT})}.get(cause, frozenset({cause}))
    grasps = test[first : min(first + _BLOCK, settings.single_cause_grasps if cause in CAUSES else settings.grasps)]
    return list(_repeated(Repeater(data.scene, hidden), grasps, settings.repeats, labels.mean(axis=0)))


def _repeated(repeater: "Repeater", grasps: Sequence[GraspSample], count: int, mean: Float64) -> Iterator[Row]:
    for sample in grasps:
        made = repeater.repeat(int(sample.extra["slot"]), int(sample.extra["attempt"]), count)
        centre, variance = made.touches.mean(axis=0), made.touches.var(axis=0, ddof=1)
        share = 1.0 - 1.0 / len(made.touches)
        yield {
            "id": sample.id,
            "object": sample.object,
            "repeats": len(made.touches),
            "mean": centre.tolist(),
            "rest": (share * variance).tolist(),  # of eqs. 2 and 3
            "within": variance.tolist(),  # eq. 1
            "within_change": (made.touches - made.tares).var(axis=0, ddof=1).tolist(),
            "reference": ((mean - centre) ** 2 + share * variance).tolist(),  # eq. 3
            "modalities": {name: channel.size for name, channel in made.channels.channel_of.items()},
        }


@dataclass(frozen=True, eq=False)
class _Repeats:
    """Repeats of one grasp."""

    touches: Float64  # (n, D)
    tares: Float64  # (n, D)
    channels: Channels  # what the D values are


class Repeater:
    """Repeats grasps of one scene.

    Args:
        scene: The scene.
        causes: Those of `CAUSES` and `NEW_OBJECT` that are redrawn; the others are those of the sample.

    Raises:
        ConfigError: If the scene has a campaign, in which no moment comes twice.
    """

    def __init__(self, scene: SceneConfig, causes: frozenset[str]) -> None:
        if scene.campaign is not None:
            raise ConfigError("scene: campaign: grasps are repeated at one moment; give a scene without a campaign")
        self._new_object = NEW_OBJECT in causes
        again = {effect for cause in causes for effect in ({"sessions"} if cause == NEW_OBJECT else CAUSES[cause])}
        effects = [replace(effect, again=effect.name in again) for effect in EFFECTS]
        self._engine = Engine(scene, effects, ("touch", "tare"))

    def repeat(self, slot: int, attempt: int, count: int) -> _Repeats:
        """Execute one grasp again.

        Args:
            slot: Slot of the sample.
            attempt: Attempt that made it.
            count: Number of repeats; a grasp that fails too often gives fewer.

        Raises:
            SimulationError: If fewer than two succeed.
        """
        touches: list[Float64] = []
        tares: list[Float64] = []
        for number in range(1, 1 + _TRIES * count):
            if len(touches) == count:
                break
            try:
                state = self._engine.run(
                    SampleKey(self._engine.scene.seed, slot, attempt, number), self._item(slot, number)
                )
            except SimulationError:
                continue
            if state.tare is not None:  # without a campaign each grasp has one
                touches.append(state.touch.values)
                tares.append(state.tare.values)
        if len(touches) < 2:
            raise SimulationError(f"slot {slot}: {len(touches)} of {_TRIES * count} repeats succeed", "repeats")
        return _Repeats(np.array(touches), np.array(tares), self._engine.world.channels())

    def _item(self, slot: int, number: int) -> ObjectConfig:
        """Object of a slot, with the material of another object in each repeat if the object is new."""
        items = self._engine.scene.objects
        item = items[slot % len(items)]
        if not self._new_object:
            return item
        others = [other for other in items if other.rigid == item.rigid]  # these need the same effects
        rng = np.random.default_rng([self._engine.scene.seed, slot, number])
        other = others[int(rng.integers(len(others)))]
        return item.replace(**{name: getattr(other, name) for name in _MATERIAL})


def ceiling_rows(rows: Sequence[Row], draws: int) -> list[Row]:
    """Rows of `results.csv`: one per modality for each ceiling, each single cause and each predictor.

    Args:
        rows: Rows of the cells. A predictor whose cell failed is left out.
        draws: Number of bootstrap samples.
    """
    causes = dict(grouped(select(rows, what="repeats"), "name"))
    all_hidden, new_object = causes.pop("all", []), causes.pop(NEW_OBJECT, [])
    result: list[Row] = []
    modalities: dict[str, int] = next((row["modalities"] for row in rows if row["what"] == "repeats"), {})
    ends = np.cumsum([0, *modalities.values()])
    parts = {name: slice(*ends[k : k + 2]) for k, name in enumerate(modalities)}
    for name, repeated in ((_CEILING, all_hidden), (f"{_CEILING}, object never touched", new_object)):
        if repeated:
            reference = _table(repeated, "reference")
            result += _score(parts, name, _table(repeated, "within"), reference, draws)
            result += _score(
                parts, f"{name}, change from the tare", _table(repeated, "within_change"), reference, draws
            )
    known = {row["id"]: row["reference"] for row in all_hidden}
    for cause, repeated in causes.items():
        if all(row["id"] in known for row in repeated):
            same = np.array([known[row["id"]] for row in repeated])
            result += _score(parts, f"only {cause} hidden", _table(repeated, "within"), same, draws)
    repeated = new_object or all_hidden
    for name, own in grouped(select(rows, what="predictor"), "name") if repeated else ():
        by_id = {row["id"]: row["predicted"] for row in own}
        predicted = np.array([by_id[row["id"]] for row in repeated])
        squared = (predicted - _table(repeated, "mean")) ** 2 + _table(repeated, "rest")  # eq. 2
        result += _score(parts, name, squared, _table(repeated, "reference"), draws, _table(repeated, "within"))
    return result


def _table(rows: Sequence[Row], column: str) -> Float64:
    return np.array([row[column] for row in rows], np.float64)


def _score(
    parts: dict[str, slice], name: str, squared: Float64, reference: Float64, draws: int, ceiling: Float64 | None = None
) -> list[Row]:
    """One row per modality, by its columns; with a ceiling also the share of it."""
    size = len(squared)
    weights = np.random.default_rng(0).multinomial(size, np.full(size, 1.0 / size), draws).astype(np.float64)
    weights = np.vstack([np.ones(size), weights])
    skill = _skills(parts, squared, reference, weights)
    share = None if ceiling is None else skill / _skills(parts, ceiling, reference, weights)
    rows = []
    for k, (modality, part) in enumerate(parts.items()):
        rmse = float(np.sqrt(squared[:, part].mean()))
        row = {"name": name, "modality": modality, "grasps": size, "rmse": rmse}
        rows.append(row | _ends("skill", skill[:, k]) | _ends("share", None if share is None else share[:, k]))
    return rows


def _skills(parts: dict[str, slice], squared: Float64, reference: Float64, weights: Float64) -> Float64:
    """(draws, M): 1 - sum S / sum R per value, averaged over the modality's values."""
    per_value = 1.0 - (weights @ squared) / (weights @ reference)
    return np.stack([per_value[:, part].mean(axis=1) for part in parts.values()], axis=1)


def _ends(column: str, drawn: Float64 | None) -> Row:
    values = (None,) * 3 if drawn is None else (drawn[0], *np.quantile(drawn[1:], [_TAIL, 1.0 - _TAIL]))
    return dict(zip((column, f"{column}_low", f"{column}_high"), values, strict=True))


def _summarise(rows: Sequence[Row]) -> list[Table]:
    """Skills, and the predictors' shares of the ceiling."""
    notes = [
        "skill: 0 is the mean of the training labels; [95 % interval by bootstrap over grasps]",
        "only ... hidden: the ceiling if all other causes were known",
    ]
    scored, modalities = [row for row in rows if row["share"] is not None], unique(rows, "modality")
    tables = [
        Table(f"noise ceiling: {rows[0]['grasps']} grasps", ["skill", *modalities], _body(rows, "skill"), notes),
        Table("share of the ceiling", ["share", *modalities], _body(scored, "share")),
    ]
    return [table for table in tables if table.rows or table.notes]


def _body(rows: Sequence[Row], name: str) -> list[list[str]]:
    def text(row: Row) -> str:
        return f"{row[name]:.2f} [{row[f'{name}_low']:.2f}, {row[f'{name}_high']:.2f}]"

    return pivot(rows, "name", text, names=unique(rows, "modality"))


EXPERIMENT = Experiment(
    name="noise_ceiling",
    question="How much of a touch can be predicted from cloud and grasp at all, and how much of that do predictors reach?",
    module=__name__,
    order=50,
    settings=NoiseCeilingSettings,
    presets={
        "full": {},
        "smoke": {
            "samples": 200,
            "grasps": 20,
            "repeats": 5,
            "single_cause_grasps": 10,
            "training_fraction": 0.1,
            "draws": 200,
        },
    },
    load=load_simulated,
    cells=_cells,
    run=_run,
    tabulate=lambda settings, rows: ceiling_rows(rows, settings.draws),
    summarise=_summarise,
    prepare=prepare_simulated,
    resumable_settings=("predictors", "draws"),
)
