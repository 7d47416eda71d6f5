# SPDX-License-Identifier: Apache-2.0
"""A trained model and the baselines on the same samples of a split.

The baselines are fitted to the training side of each part. The model is taken as it is: where it was trained on
these very samples, its figures say how well it remembers; `same_data` tells so where hash and card agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.errors import DatasetError
from foretouch.learning.baselines import BASELINES, Baseline, training_mean
from foretouch.learning.collection import Collection
from foretouch.learning.metrics import Score, score
from foretouch.learning.split_book import SplitPart
from foretouch.learning.train import predict_set
from foretouch.learning.training_set import TrainingSet
from foretouch.models.card import read_card
from foretouch.models.checkpoint import load_network
from foretouch.models.registry import find_card
from foretouch.models.regressor import TouchNet
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64, GraspSample

__all__ = ["MODEL", "judge"]

MODEL = "model"


def judge(
    model: str | Path,
    data: Collection,
    parts: Sequence[SplitPart],
    *,
    seed: int = 0,
    baselines: Mapping[str, Baseline] = BASELINES,
) -> dict[str, Any]:
    """Score a model and the baselines on the test samples of some parts.

    Args:
        model: Name, card or weights; it may predict some of the modalities only.
        data: The samples.
        parts: Of one split; each test sample is judged beside baselines that were fitted without it.
        seed: Of the baselines.
        baselines: By name.

    Returns:
        `scores`: by `model` and each baseline, by modality: `rmse` [counts], `nrmse`, `skill`, `coverage90` (null: no
        calibration exists). `samples`: how many. `same_data`: whether the model's card names these data
        as those it was trained on.

    Raises:
        DatasetError: If nothing is to be tested, or a sample is unlabelled.
        ModelError: If the model is damaged.
    """
    card_path = find_card(model)
    card = read_card(card_path)
    members = [card_path]
    if card["kind"] == "ensemble":
        members = [card_path.with_name(Path(str(name)).name) for name in card["members"]]
    loaded = [load_network(member) for member in members]
    chosen = np.concatenate([data.index(part.test) for part in parts]) if parts else np.empty(0, np.intp)
    if not len(chosen):
        raise DatasetError(f"{data.name}: the split tests no sample")
    tested = [data.samples[k] for k in chosen]
    predicted, modalities = _predicted([net for net, _ in loaded], tested)
    labels = _labels(tested)
    reference = _fitted(data, parts, training_mean, seed)
    # The columns that the model does not predict are not scored, but must be finite.
    values = {MODEL: np.where(np.isnan(predicted), reference, predicted)}
    values |= {name: _fitted(data, parts, baseline, seed) for name, baseline in baselines.items()}
    ranges = loaded[0][0].config.ranges
    scores = {
        name: {key: _plain(one) for key, one in score(value, labels, reference, ranges, modalities).items()}
        for name, value in values.items()
    }
    same = any(member["data"].get("sha256") in (data.sha256, *data.aliases) for _, member in loaded)
    return {"scores": scores, "samples": len(tested), "same_data": same}


def _predicted(networks: Sequence[TouchNet], samples: Sequence[GraspSample]) -> tuple[Float64, list[str]]:
    """(S, 50) predictions, NaN where no network predicts, and the modalities that they predict."""
    predicted = np.full((len(samples), TOUCH_SIZE), np.nan)
    for net in networks:
        prepared = TrainingSet.build(samples, net.config)
        predicted[:, columns(net.config.outputs)] = predict_set(net, prepared, np.arange(len(samples)))
    named = {output for net in networks for output in net.config.outputs}
    return predicted, [name for name in MODALITIES if name in named]


def _fitted(data: Collection, parts: Sequence[SplitPart], baseline: Baseline, seed: int) -> Float64:
    """(S, 50) predictions of the test samples of each part, in order."""
    rows = []
    for part in parts:
        train, test = ([data.samples[k] for k in data.index(ids)] for ids in (part.train, part.test))
        rows.append(baseline(train, _labels(train), test, seed))
    return np.concatenate(rows)


def _labels(samples: Sequence[GraspSample]) -> Float64:
    for sample in samples:
        if sample.touch is None:
            raise DatasetError(f"{sample.id}: touch: is not labelled")
    return np.array([sample.touch.vector() for sample in samples if sample.touch is not None])


def _plain(one: Score) -> dict[str, float | None]:
    return {"rmse": one.rmse, "nrmse": one.nrmse, "skill": one.skill, "coverage90": None}
