# SPDX-License-Identifier: Apache-2.0
"""A contact model from a configuration: fitted to the labelled samples, calibrated on what was held out, written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foretouch import __version__
from foretouch.errors import DatasetError
from foretouch.learning.calibration import promise
from foretouch.learning.contact_predictor import ContactPredictor
from foretouch.learning.training_set import duplicate_labels, labels_of
from foretouch.models.contact_checkpoint import add_trust, save_contact
from foretouch.tactile.modalities import MODALITIES

if TYPE_CHECKING:
    from foretouch.learning.collection import Collection
    from foretouch.learning.run import RunConfig
    from foretouch.learning.splits import Indices

__all__ = ["fit_and_save"]


def fit_and_save(config: RunConfig, data: Collection, train: Indices, split: Mapping[str, Any], out: Path) -> Path:
    """Fit a contact model to some samples.

    Args:
        config: Of the run.
        data: The samples.
        train: (T,) those to learn from, labelled.
        split: What the card tells of the division.
        out: Folder of the run.

    Returns:
        Path of the card.

    Raises:
        DatasetError: If the samples are too few, or one has no usable label.
    """
    samples = [data.samples[k] for k in train]
    predictor = ContactPredictor(samples, labels_of(samples), config.contact)
    facts: dict[str, Any] = {
        "summary": f"{', '.join(MODALITIES)}, contact, from {len(samples)} labelled samples of {data.name}",
        "config": config.contact.to_mapping(),
        "data": {
            "name": data.name,
            "sha256": data.sha256,
            "samples": len(data.samples),
            "duplicate_labels": [list(pair) for pair in duplicate_labels(samples)],
        },
        "split": dict(split),
        "version": __version__,
    }
    try:
        trust, calibration = predictor.trust
    except DatasetError as err:  # one object tells nothing of another
        return save_contact(out, config.name, predictor.estimator, {**facts, "limits": [f"No calibration: {err}."]})
    rest = "recorded tares" if predictor.rest_recorded else "guessed from the labels"
    limits = [promise(calibration), f"Rest level: {rest}."]
    card = save_contact(out, config.name, predictor.estimator, {**facts, "limits": limits})
    add_trust(card, trust, {**calibration, "rest": rest})
    return card
