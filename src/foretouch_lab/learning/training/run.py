# SPDX-License-Identifier: Apache-2.0
"""One training from settings to a model folder with weights, calibration and card, resumable at every epoch."""

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from foretouch import __version__
from foretouch.base.files import write_text
from foretouch.errors import ConfigError, DatasetError, FileError, ModelError
from foretouch.models.card import card_text, read_card
from foretouch.models.registry import load_model
from foretouch.tactile.description import named_taxels, with_sensor
from foretouch_lab.learning.data import Dataset
from foretouch_lab.learning.data.folds import SPLITS
from foretouch_lab.learning.evaluation.evaluate import MODEL, evaluate_model
from foretouch_lab.learning.evaluation.metrics import mean_skill
from foretouch_lab.learning.training.calibration import GUESSED, guarantee
from foretouch_lab.learning.training.compare import Report, compare_splits
from foretouch_lab.learning.training.contact import FEWEST_SAMPLES
from foretouch_lab.learning.training.learners import Learner, make_learner
from foretouch_lab.learning.training.run_config import RunConfig
from foretouch_lab.learning.training.run_folder import STATE_FILE, RunFolder

Scores = dict[str, dict[str, Any]]

_SPLIT_WORDS: Final = {
    "random": "5 random folds: other grasps of the same sessions",
    "time": "5 consecutive blocks of time within each object, each left out once",
    "object": "one object left out: objects never touched, and other days",
}
_PARTS: Final = ("train", "unlabelled", "test")  # of the split, whose sizes a card names


def train_run(
    config: RunConfig, data: Dataset, out: Path, report: Report, *, resume: bool = False, workers: int = 1
) -> Path:
    """Train a model.

    Args:
        config: Resolved settings.
        data: The dataset.
        out: The model folder.
        report: Called with each epoch's record, and with the result.
        resume: Continue the run in `out`, if there is one.
        workers: Processes for cross-validation and calibration; the result does not depend on it.

    Returns:
        Path of the model's card. Killed at any time and resumed, it writes the weights of an uninterrupted run.

    Raises:
        FileError: If `out` holds a run and `resume` is off, its state is damaged or of another architecture, or it
            cannot be written.
        ConfigError: If the run in `out` has other settings or other data.
        DatasetError: If the dataset does not fit the settings, or a loss becomes infinite or NaN. The last good state
            stays.
    """
    own = re.sub(r"[^A-Za-z0-9._-]+", "_", out.resolve().name).lstrip(".")[:100]
    config = config.replace(name=config.name or own or "model")
    if f"{config.name}.safetensors" == STATE_FILE:
        raise ConfigError(f"name: {config.name!r} is the name of the training's own file; give name=NAME")
    learner = make_learner(config, data)
    folder = RunFolder(out, report)
    # The path of a dataset is no part of its identity.
    resolved = {**config.replace(data=None).to_mapping(), "data_sha256": data.sha256}
    folder.open(resolved, resume=resume)
    learner.fit(run=folder)
    skill = compare_splits(learner, SPLITS, report, workers).scores if config.release else {}
    facts = _facts(learner, data)
    calibration = None
    if config.calibrates:
        try:
            calibration = learner.calibrate(workers)
            facts["limits"] = [guarantee(calibration[1]), f"Rest level: {calibration[1]['rest']}."]
        except DatasetError as err:  # of too few objects or grasps
            facts["limits"] = [f"No calibration: {_missing_grasps(learner) or err}."]
    if calibration is not None and skill:
        facts |= _release_facts(facts, learner, data, skill, calibration[1])
    if dead := learner.sensor.dead:
        facts["limits"] = [
            *facts["limits"],
            f"Dead in the training data, so that their predictions are not valid: taxels {named_taxels(dead)}.",
        ]
    card = learner.save(out, config.name, facts, calibration)
    if set(learner.outputs) == set(learner.sensor.channels.modalities):
        _require_readable(card)
    result: dict[str, Any] = {"status": "done", "card": str(card), "epochs": learner.epochs, "data_sha256": data.sha256}
    result |= {"calibrated": calibration is not None, "limits": facts["limits"], "dead_taxels": dead}
    if len(learner.split.test):
        result |= _add_scores(card, config, data)
    report(result)
    return card


def _require_readable(card: Path) -> None:
    """Remove the card of a model that its reader refuses, such as of labels that hardly vary, and raise a `DatasetError`."""
    try:
        load_model(card)
    except (ModelError, FileError) as err:
        card.unlink()
        raise DatasetError(f"the model that was trained cannot be read: {err}; do its labels vary?") from err


def _missing_grasps(learner: Learner) -> str:
    """Return how many grasps a calibration lacks: a model must be fitted without each of the objects; "" if none are missing."""
    name, most = Counter(sample.object for sample in learner.samples).most_common(1)[0]
    others = len(learner.samples) - most
    if others >= FEWEST_SAMPLES:
        return ""
    return f"{most} of {most + others} grasps are of {name}; at least {FEWEST_SAMPLES - others} more of other objects are needed"


def _facts(learner: Learner, data: Dataset) -> dict[str, Any]:
    """Return `summary`, `data`, `split`, `limits` and `version` of the card."""
    config, count = learner.config, len(learner.samples)
    facts = {
        "summary": f"{', '.join(learner.outputs)}, {config.method}, from {count} labelled samples of {data.name}",
        "data": {
            "name": data.name, "sha256": data.sha256, "samples": len(data.samples),
            "sample_hashes": "".join(sorted(data.hashes(learner.split.train))),
            **{key: value for key, value in data.origin.items() if key != "limits"},
            "recipe": f"foretouch train {config.name} data={data.name}{' release=true' if config.release else ''}",
        },
        "split": {"name": config.split, **{part: len(getattr(learner.split, part)) for part in _PARTS}},
        "limits": ["Bounds are null: the model was trained with calibrate=false."],
        "version": __version__,
    }  # fmt: skip
    return with_sensor(facts, learner.sensor)


def _release_facts(
    facts: Mapping[str, Any],
    learner: Learner,
    data: Dataset,
    results: Mapping[str, Scores],
    calibration: Mapping[str, Any],
) -> dict[str, Any]:
    """Return what a release changes of the facts for a card: skills and baselines by split, the origin of the data, the limits."""
    rounded = {
        split: {
            name: {key: {"rmse": round(s["rmse"], 2), "nrmse": round(s["nrmse"], 4), "skill": round(s["skill"], 4)}
                   for key, s in by_modality.items()}
            for name, by_modality in scores.items()
        }
        for split, scores in results.items()
    }  # fmt: skip
    skill = {split: scores.pop(MODEL) for split, scores in rounded.items()}
    baselines = {name: {split: rounded[split][name] for split in rounded} for name in rounded[SPLITS[0]]}
    objects = [sample.object for sample in learner.samples]
    limits = list(data.origin.get("limits", []))
    if calibration["rest"] == GUESSED:
        limits.append("The rest level that a tare is compared with is guessed from the labels: no tare was recorded.")
    limits.append(guarantee(calibration))
    for split, ours in ((split, mean_skill(table)) for split, table in skill.items()):
        best = max(baselines, key=lambda name: mean_skill(baselines[name][split]))
        value = mean_skill(baselines[best][split])
        limits.append(f"Split {split}: mean skill {ours:.2f}; that of the best baseline, {best}, is {value:.2f}.")
        if ours <= 0.0:
            limits.append(f"Split {split}: no better than the training mean; do not rely on it there.")
    return {
        "summary": f"{', '.join(learner.outputs)} from {len(objects)} grasps of {data.name}; read skill and limits first",
        "data": {
            **facts["data"],
            "sha256": data.aliases[0] if data.aliases else data.sha256,
            "objects": {name: objects.count(name) for name in sorted(set(objects))},
        },
        "split": {**facts["split"], **_SPLIT_WORDS, "shipped": "trained on all samples"},
        "skill": skill,
        "baselines": baselines,
        "limits": limits,
    }


def _add_scores(card_path: Path, config: RunConfig, data: Dataset) -> dict[str, Any]:
    """Evaluate a model on the test samples of its run's split, and enter the scores in its card."""
    split = str(config.split)
    result = evaluate_model(card_path, data, split, seed=config.seed)
    card = read_card(card_path)
    card["skill"] = {split: result["scores"][MODEL]}
    card["baselines"] = {name: table for name, table in result["scores"].items() if name != MODEL}
    write_text(card_path, card_text(card))
    return result
