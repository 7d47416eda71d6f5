# SPDX-License-Identifier: Apache-2.0
"""A contact model from a configuration: fitted to the labelled samples, calibrated on what was held out, written."""

from __future__ import annotations

from pathlib import Path

from foretouch.errors import DatasetError
from foretouch.learning.data.collection import Collection
from foretouch.learning.data.division import Division
from foretouch.learning.data.training_set import labels_of
from foretouch.learning.training.calibration import promise
from foretouch.learning.training.contact_predictor import ContactPredictor
from foretouch.learning.training.run_card import run_facts
from foretouch.learning.training.run_config import RunConfig
from foretouch.models.contact.checkpoint import save_contact

__all__ = ["fit_and_save"]


def fit_and_save(config: RunConfig, data: Collection, division: Division, out: Path) -> Path:
    """Fit a contact model to the training side of a division.

    Args:
        config: Of the run.
        data: The samples.
        division: What of them to learn from, and what the card tells of that.
        out: Folder of the run.

    Returns:
        Path of the card. Samples of one object give a model without intervals, and the card says why.

    Raises:
        DatasetError: If the samples are too few, or one has no usable label or cloud; named by id.
        FileError: If a file cannot be written, such as on a full disk; those before are kept.
    """
    samples = [data.samples[k] for k in division.train]
    predictor = ContactPredictor(samples, labels_of(samples), config.contact)
    facts = {**run_facts(config, data, division), "config": config.contact.to_mapping()}
    try:
        trust, calibration = predictor.trust
    except DatasetError as err:  # one object tells nothing of another
        return save_contact(out, config.name, predictor.estimator, {**facts, "limits": [f"No calibration: {err}."]})
    rest = "recorded tares" if predictor.rest_recorded else "guessed from the labels"
    limits = [promise(calibration), f"Rest level: {rest}."]
    told = {**calibration, "rest": rest}
    return save_contact(out, config.name, predictor.estimator, {**facts, "limits": limits}, (trust, told))
