# SPDX-License-Identifier: Apache-2.0
"""Levels of a model: itself and cheaper forms of it, whose skill is known, down to the mean of its training labels.

No level needs training. `levels.json` names models by their hash, and holds for each level the skill on held-out blocks
of time, and by how much its errors exceed those of the model, by which its intervals are widened.
`benchmarks/budget/levels.py` writes it from the results of `foretouch tradeoff model`. A model that it does not name
has itself and the mean of its labels.

All levels have the calibration of the model, and adapt to the same readings. The mean looks at no cloud: its
predictions are flagged `unfamiliar`, and have the intervals of a new object.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any, Final

import numpy as np

from foretouch.errors import ModelError
from foretouch.models.contact.cheaper import WithoutSurroundings, fewer_trees
from foretouch.models.contact.estimator import ContactEstimator, by_modality
from foretouch.models.registry import load_model
from foretouch.models.touch_model import Estimate, Estimator, TouchModel
from foretouch.tactile import TactileRanges
from foretouch.types import Cloud, Float64, Grasp

MEAN: Final = "mean of labels"


@dataclass(frozen=True, eq=False)
class Level:
    """One way to predict by a model."""

    name: str
    skill: float | None  # mean skill on held-out blocks of time; None if it is not known
    model: TouchModel  # predicts in this way


@dataclass(frozen=True, eq=False)
class _Mean:
    """Predicts the mean of the training labels for every grasp."""

    mean: Float64  # (50,) [counts]
    ranges: TactileRanges

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp]) -> Estimate:
        """See `Estimator.estimate`."""
        del cloud
        return Estimate(np.tile(self.mean, (len(grasps), 1)), np.zeros(len(grasps), np.bool_))


def _contact(cut: Callable[[ContactEstimator], Estimator]) -> Callable[[Estimator], Estimator]:
    def make(estimator: Estimator) -> Estimator:
        if not isinstance(estimator, ContactEstimator):
            raise ModelError("levels.json: names a level of contact models for another kind of model")
        return cut(estimator)

    return make


_MAKERS: Final[dict[str, Callable[[Estimator], Estimator]]] = {
    "10 trees": _contact(lambda one: fewer_trees(one, 10)),
    "no surroundings": _contact(WithoutSurroundings.of),
    "touchnet-v1": lambda _: load_model("touchnet-v1").estimator,
}
"""Estimators of the levels by name, from the model's own."""


def levels_of(model: TouchModel) -> list[Level]:
    """The levels of a model, itself first, then by descending skill; the mean of its labels last."""
    known = known_levels().get(model.sha256, {})
    skills = known.get("levels", {})
    levels = [Level(model.name, skills.get(model.name, {}).get("skill"), model)]
    for name, entry in sorted(skills.items(), key=lambda item: -item[1]["skill"]):
        if name in _MAKERS:
            made = _MAKERS[name](model.estimator)
            levels.append(Level(name, entry["skill"], model.reduced(made, by_modality(np.array(entry["widen"])))))
    mean = getattr(model.estimator, "mean", None)
    if isinstance(mean, np.ndarray):
        estimator = _Mean(mean, model.ranges)
        levels.append(Level(MEAN, 0.0 if known else None, model.reduced(estimator, np.ones(len(mean)))))
    return levels


def known_levels() -> dict[str, Any]:
    """The content of `levels.json`: by the hash of a model, its name and its levels."""
    file = resources.files("foretouch.tradeoff.budget") / "levels.json"
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found
