# SPDX-License-Identifier: Apache-2.0
"""A trained model and the baselines on the same samples of a split; `evaluation` trains anew on each fold instead.

The baselines are fitted to the training side of each part. The model is taken as it is: where it was trained on
these very samples, its figures say how well it remembers; `same_data` tells so where hash and card agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.errors import DatasetError, ModelError
from foretouch.learning.data.collection import Collection
from foretouch.learning.data.splits import SplitPart
from foretouch.learning.data.training_set import TrainingSet, labels_of
from foretouch.learning.evaluation.baselines import BASELINES, Baseline, training_mean
from foretouch.learning.evaluation.cross_validation import MODEL
from foretouch.learning.evaluation.metrics import Score, score
from foretouch.learning.training.supervised import predict_set
from foretouch.models.card import read_card
from foretouch.models.network.checkpoint import load_network
from foretouch.models.registry import find_card, load_model
from foretouch.tactile import MODALITIES, TactileRanges, columns
from foretouch.types import TOUCH_SIZE, Float64, GraspSample

__all__ = ["judge"]


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
        `scores`: by `model` and each baseline, by modality: `rmse` [counts], `nrmse`, `skill`, `coverage90` (null where no
        interval is told). `samples`: how many. `unfamiliar`: how many of them the model flags. `same_data`: whether
        the model's card names these data as those it was trained on.

    Raises:
        DatasetError: If nothing is to be tested, or a sample is unlabelled.
        ModelError: If the model is damaged.
    """
    chosen = np.concatenate([data.index(part.test) for part in parts]) if parts else np.empty(0, np.intp)
    if not len(chosen):
        raise DatasetError(f"{data.name}: the split tests no sample")
    tested = [data.samples[k] for k in chosen]
    found = _predict(find_card(model), tested)
    labels = labels_of(tested)
    reference = _fitted(data, parts, training_mean, seed)
    # The columns that the model does not predict are not scored, but must be finite.
    values = {MODEL: np.where(np.isnan(found.counts), reference, found.counts)}
    values |= {name: _fitted(data, parts, baseline, seed) for name, baseline in baselines.items()}
    scores: dict[str, dict[str, dict[str, float | None]]] = {
        name: {key: _plain(one) for key, one in score(value, labels, reference, found.ranges, found.modalities).items()}
        for name, value in values.items()
    }
    if found.half_width is not None:
        inside = np.abs(labels - found.counts) <= found.half_width
        for key, row in scores[MODEL].items():
            row["coverage90"] = float(inside[:, columns([key])].mean())
    same = not found.trained_on.isdisjoint((data.sha256, *data.aliases))
    return {"scores": scores, "samples": len(tested), "unfamiliar": found.unfamiliar, "same_data": same}


@dataclass(frozen=True, eq=False)
class _Predicted:
    """What a model says of S samples.

    Attributes:
        counts: (S, 50), NaN where it predicts nothing [counts].
        half_width: (S, 50) of its intervals [counts]; None if it tells none.
        unfamiliar: Samples that it flags.
        modalities: That it predicts.
        ranges: Of the hand that it learned from.
        trained_on: Hashes of its training data.
    """

    counts: Float64
    half_width: Float64 | None
    unfamiliar: int
    modalities: Sequence[str]
    ranges: TactileRanges
    trained_on: frozenset[str]


def _predict(card_path: Path, samples: Sequence[GraspSample]) -> _Predicted:
    card = read_card(card_path)
    if card["kind"] == "contact" or card.get("calibration") is not None:
        return _by_model(card_path, samples)
    return _by_networks(card_path, card, samples)


def _by_model(card_path: Path, samples: Sequence[GraspSample]) -> _Predicted:
    """As the model answers everywhere else, each sample on its own; leaning on its tare where it has one."""
    model = load_model(card_path)
    counts, half = np.full((2, len(samples), TOUCH_SIZE), np.nan)
    unfamiliar = 0
    for k, sample in enumerate(samples):
        tare = sample.tare if model.calibration is not None else None
        (one,) = model.predict(sample.cloud, [sample.grasp], tare=tare)
        if one.value is None:
            raise ModelError(f"{sample.id}: {one.reason}")
        counts[k] = one.value.vector()
        if one.lower is not None and one.upper is not None:
            half[k] = (one.upper.vector() - one.lower.vector()) / 2.0
        unfamiliar += "unfamiliar" in one.flags
    told = None if np.isnan(half).any() else half
    trained_on = frozenset([str(model.card["data"].get("sha256"))])
    return _Predicted(counts, told, unfamiliar, list(MODALITIES), model.ranges, trained_on)


def _by_networks(card_path: Path, card: Mapping[str, Any], samples: Sequence[GraspSample]) -> _Predicted:
    """By networks that may predict some of the modalities only; all samples of one in one go."""
    members = [card_path]
    if card["kind"] == "ensemble":
        members = [card_path.with_name(Path(str(name)).name) for name in card["members"]]
    loaded = [load_network(member) for member in members]
    counts = np.full((len(samples), TOUCH_SIZE), np.nan)
    for net, _ in loaded:
        prepared = TrainingSet.build(samples, net.config)
        counts[:, columns(net.config.outputs)] = predict_set(net, prepared, np.arange(len(samples)))
    named = {output for net, _ in loaded for output in net.config.outputs}
    trained_on = frozenset(str(member["data"].get("sha256")) for _, member in loaded)
    modalities = [name for name in MODALITIES if name in named]
    return _Predicted(counts, None, 0, modalities, loaded[0][0].config.ranges, trained_on)


def _fitted(data: Collection, parts: Sequence[SplitPart], baseline: Baseline, seed: int) -> Float64:
    """(S, 50) predictions of the test samples of each part, in order."""
    rows = []
    for part in parts:
        train, test = ([data.samples[k] for k in data.index(ids)] for ids in (part.train, part.test))
        rows.append(baseline(train, labels_of(train), test, seed))
    return np.concatenate(rows)


def _plain(one: Score) -> dict[str, float | None]:
    return {"rmse": one.rmse, "nrmse": one.nrmse, "skill": one.skill, "coverage90": None}
