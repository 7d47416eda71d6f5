# SPDX-License-Identifier: Apache-2.0
"""The published networks as predictors: `config/train/p1.yaml`, `p2.yaml` and `touchnet-v1.yaml`, a test holds them equal.

They stand here as well because an installed package has no `config/`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from foretouch.errors import ConfigError
from foretouch.learning.baselines import Baseline
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64, GraspSample

__all__ = ["RECIPES", "network"]

_PAPERS: Final = {"weight_decay": 0.0, "schedule": "constant", "loss": "rmse", "target_scaling": "ranges"}

RECIPES: Final[dict[str, dict[str, Any]]] = {
    "p1_pointnet": {
        "model": {
            "n_points": 500,
            "use_grasp": False,
            "head_widths": [512, 256],
            "head_norm": True,
            "ranges": {"pdc_th": [0, 3100], "pdc_mf": [0, 2000], "e_th": [0, 3500], "e_mf": [0, 3800]},
        },
        "train": {"epochs": 50, "batch_size": 5, "optimiser": "sgd", "learning_rate": 0.01, **_PAPERS},
        "one_a_modality": True,
    },
    "p2_pointnet": {
        "model": {"channels": "xyz+normals"},
        "train": {"epochs": 50, "batch_size": 32, "optimiser": "adam", "learning_rate": 0.01, **_PAPERS},
        "one_a_modality": True,
    },
    "touchnet_v1": {
        "model": {
            "tnet": False,
            "trunk_widths": [32, 64, 128],
            "head_widths": [128],
            "head_dropout": 0.3,
            "metric_inputs": True,
        },
        "train": {"epochs": 120, "turn_deg": 20.0, "points": 256},
        "one_a_modality": False,
        "falls_back": True,
    },
}


def network(name: str, effort: float) -> Baseline:
    """A recipe as a baseline, which is trained anew for each call.

    Args:
        name: Out of `RECIPES`.
        effort: Share of its epochs, at least one is run.

    Raises:
        ConfigError: If there is no such recipe.
    """
    if name not in RECIPES:
        raise ConfigError(f"recipe: {name!r} is none of {', '.join(RECIPES)}")
    recipe = RECIPES[name]
    groups = [(one,) for one in MODALITIES] if recipe["one_a_modality"] else [MODALITIES]

    def predict(train: Sequence[GraspSample], labels: Float64, test: Sequence[GraspSample], seed: int) -> Float64:
        from foretouch.learning.train import TrainConfig, predict_set, train_network
        from foretouch.learning.training_set import TrainingSet
        from foretouch.models.settings import ModelConfig

        model = ModelConfig.from_mapping(recipe["model"], name)
        how = TrainConfig.from_mapping(recipe["train"], name)
        how = how.replace(epochs=max(1, round(effort * how.epochs)), seed=seed)
        data = TrainingSet.build([*train, *test], model, unlabelled=True)
        hidden = np.full((len(test), TOUCH_SIZE), np.nan)
        data = replace(data, labels=np.concatenate([labels, hidden]))
        learned, asked = np.arange(len(train)), np.arange(len(train), len(data))
        predicted = np.empty((len(test), TOUCH_SIZE))
        for outputs in groups:
            part = replace(data, config=model.replace(outputs=outputs))
            predicted[:, columns(outputs)] = predict_set(train_network(part, learned, how), part, asked)
        return _fallen_back(predicted, train, labels, test) if recipe.get("falls_back") else predicted

    return predict


def _fallen_back(
    predicted: Float64, train: Sequence[GraspSample], labels: Float64, test: Sequence[GraspSample]
) -> Float64:
    """As the shipped network's predictions fade on objects unlike those of training."""
    from foretouch.learning.contact_training import describe_objects
    from foretouch.models.fallback import Fallback

    return Fallback.fit(describe_objects(train), labels).fade(predicted, describe_objects(test))[0]
