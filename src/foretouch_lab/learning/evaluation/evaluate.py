# SPDX-License-Identifier: Apache-2.0
"""Score touch models and baselines on the same samples.

`evaluate_model` takes a trained model and fits only the baselines, to the training side of each part of a split. Samples that the model was trained on, which it recognises by
their hashes in its card, are left out and counted.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import DatasetError, ModelError
from foretouch.models.card import OWN, card_sensor, read_card
from foretouch.models.registry import find_cards, load_model
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import Ranges
from foretouch.tactile.description import require_same
from foretouch.types import Bool, Float64, Sample
from foretouch_lab.learning.data.dataset import Dataset
from foretouch_lab.learning.data.folds import Indices
from foretouch_lab.learning.data.training_set import TrainingSet, labels_of, predict_set
from foretouch_lab.learning.evaluation.baselines import BASELINES, Baseline, predict_part, training_mean
from foretouch_lab.learning.evaluation.metrics import score

MODEL: Final = "model"
"""Key of the model itself, beside the names of the baselines."""


def evaluate_model(
    model: str | Path,
    data: Dataset,
    split: str,
    *,
    seed: int = 0,
    baselines: Mapping[str, Baseline] = BASELINES,
    training_scores: bool = False,
    predictor: Any = None,
) -> dict[str, Any]:
    """Score a trained model and the baselines on the test samples of a split that the model was not trained on.

    If it was trained on all of them, the scores of its cross-validation on this kind of split are those in its card.

    Args:
        model: Name, card, weights or model folder; it may predict only some of the modalities.
        data: The dataset.
        split: `KIND` or `KIND/PART`; the baselines beside each test sample were fitted without it.
        seed: Seed of the baselines.
        baselines: By name.
        training_scores: Score the samples that the model was trained on, too.
        predictor: Of a model of the user, as of `load_model`.

    Returns:
        `scores`: by `model` and each baseline, by modality: `rmse` [counts], `nrmse`, `skill`, `coverage90` (None without
        intervals). `split`. `samples`: how many were scored. `scored`: `held_out`, `training_samples` (among others) or
        `cross_validation`. `unfamiliar`: how many the model flags, None of cross-validated ones. `excluded`: how many were
        left out, since the model was trained on them. `same_data`: whether it was trained on test samples; None if its
        card lists no hashes. `not_scored`: taxels by finger that are dead in the training data or were never read.

    Raises:
        DatasetError: If the split tests no sample, a sample is unlabelled, or none is held out.
        ModelError: If the model is damaged.
        TactileError: If the dataset is of another sensor.
    """
    parts = data.parts(split)
    chosen = np.concatenate([part.test for part in parts])
    if not len(chosen):
        raise DatasetError(f"{data.name}: the split tests no sample")
    loaded = None if _is_part(model) else load_model(model, predictor)
    card = read_card(find_cards(model)[0]) if loaded is None else loaded.card
    sensor = card_sensor(card, str(model))
    require_same(data.sensor.channels, sensor.channels, data.name)
    own = trained_on(card, data, chosen)
    kept = np.full(len(chosen), True) if own is None or training_scores else ~own
    facts = {"split": split, **_facts(own, kept)}
    if not kept.any():
        return {**facts, **_stored(card, str(model), split, parts[0].name)}

    def fitted(baseline: Baseline) -> Float64:
        return np.concatenate([predict_part(baseline, data.filled, seed, part) for part in parts])[kept]

    tested = [data.masked[k] for k in chosen[kept]]
    predicted = _by_network(find_cards(model)[0], tested) if loaded is None else _by_model(loaded, tested)
    by_baseline = {name: fitted(baseline) for name, baseline in baselines.items()}
    valid = sensor.valid_values & ~np.isnan(labels_of(tested)).any(axis=0)
    return {
        "scores": _scores(predicted, by_baseline, labels_of(tested), fitted(training_mean), valid),
        "samples": len(tested),
        "unfamiliar": predicted[2],
        **facts,
        "not_scored": sensor.taxels_of(~valid),
    }


def _facts(own: Bool | None, kept: Bool) -> dict[str, Any]:
    """Describe which samples are scored, by masks (S,) of those that the model was trained on, and of those that are kept."""
    return {
        "scored": "training_samples" if own is not None and (own & kept).any() else "held_out",
        "excluded": int((~kept).sum()),
        "same_data": None if own is None else bool(own.any()),
    }


def _scores(
    model: "_Predictions", by_baseline: Mapping[str, Float64], labels: Float64, reference: Float64, valid: Bool
) -> dict[str, dict[str, dict[str, float | None]]]:
    """Score (S, D) predictions of the valid values, of which the reference is the zero: by predictor and modality."""
    counts, half, _, ranges = model
    labels = np.nan_to_num(labels)  # of taxels that are not scored
    # The columns that the model does not predict are not scored, but must be finite.
    modalities = [name for name, own in ranges.channels.modality_columns.items() if np.isfinite(counts[:, own]).all()]
    scores = {
        name: {
            key: {**row, "coverage90": None}
            for key, row in score(value, labels, reference, ranges, modalities, valid).items()
        }
        for name, value in {MODEL: np.where(np.isnan(counts), reference, counts), **by_baseline}.items()
    }
    if not np.isnan(half).any():
        inside = np.abs(labels - counts) <= half
        for key, row in scores[MODEL].items():
            columns = ranges.channels.columns([key])
            row["coverage90"] = float(inside[:, columns[valid[columns]]].mean())
    return scores


def _stored(card: Mapping[str, Any], name: str, split: str, part: str) -> dict[str, Any]:
    """Return the scores of a release by cross-validation, in place of those on its own training samples."""
    kind = split.partition("/")[0]
    tables = {MODEL: card["skill"], **card["baselines"]}
    if any(kind not in table for table in tables.values()):
        cure = f"train with release=true (scores by cross-validation) or split='{kind}/{part}'"
        if card["kind"] == OWN:
            cure = "foretouch.evaluate(predictor, samples) fits it again in each fold"
        rule = f"was trained on all samples that the split {split} tests, so that none is held out"
        raise DatasetError(
            f"{name}: {rule}; {cure}, evaluate other data, or score them nevertheless with --training-scores"
        )
    scores = {
        who: {key: {"coverage90": None, **row} for key, row in table[kind].items()} for who, table in tables.items()
    }
    facts = {"samples": card["data"]["samples"], "unfamiliar": None, "split": kind, "scored": "cross_validation"}
    return {"scores": scores, **facts}


def trained_on(card: Mapping[str, Any], data: Dataset, index: Indices) -> Bool | None:
    """Return (S,) whether a model was trained on each sample of a dataset with these indices; None if its card does not list them."""
    text = card["data"].get("sample_hashes")
    if not isinstance(text, str):
        same = card["data"].get("sha256") in (data.sha256, *data.aliases) and card["split"].get("name") is None
        return np.full(len(index), True) if same else None
    trained = {text[k : k + 16] for k in range(0, len(text), 16)}
    return np.array([hash_ in trained for hash_ in data.hashes(index)], np.bool_)


_Predictions = tuple[Float64, Float64, int, Ranges]
"""(S, D) predictions, NaN for modalities without; (S, D) half widths of intervals, NaN without [counts]; how many are flagged."""


def _is_part(model: str | Path) -> bool:
    """Return whether a model is one network without intervals, which may predict only some of the modalities."""
    paths = find_cards(model)
    card = read_card(paths[0])
    return len(paths) == 1 and card["kind"] == "network" and card.get("calibration") is None


def _by_model(model: TouchModel, samples: Sequence[Sample]) -> _Predictions:
    """Predict as everywhere else, each sample on its own, with its tare where it has one."""
    counts, half = np.full((2, len(samples), model.sensor.channels.size), np.nan)
    unfamiliar = 0
    for k, sample in enumerate(samples):
        tare = sample.tare if model.calibration is not None else None
        (prediction,) = model.predict(sample.cloud, [sample.grasp], tare=tare, table=sample.table)
        if not prediction.ok:
            raise ModelError(f"{sample.id}: {prediction.reason}")
        counts[k] = prediction.value.values
        if prediction.calibrated:
            half[k] = (prediction.upper.values - prediction.lower.values) / 2.0
        unfamiliar += "unfamiliar" in prediction.flags
    return counts, half, unfamiliar, model.ranges


def _by_network(card_path: Path, samples: Sequence[Sample]) -> _Predictions:
    """Predict by a network that may cover only some of the modalities, all samples at once."""
    from foretouch.models.network.checkpoint import load_network
    from foretouch_lab.learning.network.networks import TouchNet

    config, tensors, _ = load_network(card_path)
    net, ranges = TouchNet.of(config, tensors), config.ranges.ranges
    counts, half = np.full((2, len(samples), ranges.channels.size), np.nan)
    prepared = TrainingSet.build(samples, config)
    counts[:, ranges.channels.columns(config.outputs)] = predict_set(net, prepared, np.arange(len(samples)))
    return counts, half, 0, ranges
