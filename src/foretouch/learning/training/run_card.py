# SPDX-License-Identifier: Apache-2.0
"""What the card of a trained model tells of its run, whatever kind of model it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from foretouch import __version__
from foretouch.learning.data.collection import Collection
from foretouch.learning.data.division import Division
from foretouch.learning.data.training_set import duplicate_labels
from foretouch.learning.evaluation.cross_validation import MODEL
from foretouch.learning.evaluation.evaluate_model import judge
from foretouch.learning.training.run_config import RunConfig
from foretouch.models.card import card_text, read_card, write_text
from foretouch.tactile import MODALITIES

__all__ = ["add_scores", "run_facts"]


def run_facts(config: RunConfig, data: Collection, division: Division) -> dict[str, Any]:
    """`summary`, `data`, `split` and `version` of the card.

    Raises:
        DatasetError: If a label to learn from is absent or no reading of a working sensor; named by id.
    """
    outputs = MODALITIES if config.method == "contact" else config.model.outputs
    learned = [data.samples[k] for k in division.train]
    return {
        "summary": f"{', '.join(outputs)}, {config.method}, from {len(learned)} labelled samples of {data.name}",
        "data": {
            "name": data.name,
            "sha256": data.sha256,
            "samples": len(data.samples),
            "duplicate_labels": [list(pair) for pair in duplicate_labels(learned)],
        },
        "split": {"name": config.split, **division.sizes()},
        "version": __version__,
    }


def add_scores(card: Path, config: RunConfig, data: Collection) -> dict[str, Any]:
    """Judge a model on the test samples of its run's split, and enter that in its card.

    Returns:
        As of `judge`.

    Raises:
        FileError: If the card cannot be written; the one before is kept.
    """
    judged = judge(card, data, data.parts(str(config.split)), seed=config.seed)
    told = read_card(card)
    told["skill"] = {str(config.split): judged["scores"][MODEL]}
    told["baselines"] = {name: table for name, table in judged["scores"].items() if name != MODEL}
    write_text(card, card_text(told))
    return judged
