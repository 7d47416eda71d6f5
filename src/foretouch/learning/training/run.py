# SPDX-License-Identifier: Apache-2.0
"""One training from a configuration to a model on disk, resumable at every epoch (`run_folder` tells what is there).

Of several processes (`torchrun`) the first alone writes; all of them read a state that is resumed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from foretouch.learning.data.collection import Collection
from foretouch.learning.data.division import Division, divide
from foretouch.learning.data.folds import Indices
from foretouch.learning.data.training_set import TrainingSet
from foretouch.learning.training.contact_run import fit_and_save
from foretouch.learning.training.run_card import add_scores, run_facts
from foretouch.learning.training.run_config import RunConfig
from foretouch.learning.training.run_folder import BOARD_FOLDER, RunFolder
from foretouch.learning.training.srgan import SrganTrainer
from foretouch.learning.training.supervised import SupervisedTrainer, predict_set
from foretouch.learning.training.tensorboard_logger import open_tensorboard
from foretouch.learning.training.trainer import Trainer
from foretouch.models.network.checkpoint import save_network
from foretouch.models.novelty import LengthRangeCheck
from foretouch.tactile import columns

__all__ = ["train_run"]

Say = Callable[[Mapping[str, Any]], None]


@dataclass
class _Best:
    """The best epoch so far, by validation; none without.

    Attributes:
        epoch: Its number, -1 for none.
        error: Root mean square of its scaled errors.
        weights: Of the network, by name; empty for none.
    """

    epoch: int
    error: float
    weights: dict[str, Tensor]

    @classmethod
    def none(cls) -> _Best:
        """Before the first validation."""
        return cls(-1, float("inf"), {})


def train_run(config: RunConfig, data: Collection, out: Path, say: Say, *, resume: bool = False) -> Path:
    """Train a model.

    Args:
        config: Resolved.
        data: The samples.
        out: Folder of the run.
        say: Called with each epoch's record, and with the result.
        resume: Go on in `out`, if something stands there.

    Returns:
        Path of the model's card. Killed at any time and resumed, the weights are those of an uninterrupted run.

    Raises:
        FileError: If `out` holds a run and `resume` is off, its state is damaged or of another architecture, or it cannot be
            written.
        ConfigError: If the run that stands there has another configuration or other data.
        DatasetError: If the data do not fit the configuration, or a loss stops being finite. The last good state stays.
    """
    division = divide(config, data)
    folder = RunFolder(out)
    # Where the data lie is no part of what they are.
    resolved = {**config.replace(data=None).to_mapping(), "data_sha256": data.sha256}
    if config.method == "contact":
        folder.open(resolved, resume=resume)  # a contact model takes minutes, so a run that was killed starts anew
        return _told(fit_and_save(config, data, division, out), config, data, division, say, epochs=0)
    prepared = TrainingSet.build(data.samples, config.model, unlabelled=True)
    trainer = _trainer(config, prepared, division)
    best = _Best.none()
    if _opened(folder, resolved, trainer, resume=resume):
        best = _restored(folder, trainer)
    _epochs(config, prepared, division.validation, trainer, best, folder, say)
    if best.weights:
        trainer.net.load_state_dict(best.weights)
    trainer.net.cpu().eval()
    if not trainer.place.first:
        return out / f"{config.name}.json"
    facts = _network_facts(config, data, prepared, division, best)
    return _told(save_network(out, config.name, trainer.net, facts), config, data, division, say, epochs=trainer.epoch)


def _epochs(
    config: RunConfig,
    prepared: TrainingSet,
    held: Indices,
    trainer: Trainer,
    best: _Best,
    folder: RunFolder,
    say: Say,
) -> None:
    """Train to the last epoch, or until the patience is over; each epoch is on the disk before it is told."""
    first = trainer.place.first
    if first:
        folder.keep_log(trainer.epoch)
    board = open_tensorboard(folder.path / BOARD_FOLDER) if config.tensorboard and first else None
    while trainer.epoch < trainer.epochs and not _patience_over(config, trainer, best):
        losses = trainer.run_epoch()
        record: dict[str, Any] = {"epoch": trainer.epoch - 1, "epochs": trainer.epochs, "losses": losses}
        if len(held):
            record["validation"] = _validate(trainer, prepared, held, best)
        if first:
            # The log first, for a line without its state is forgotten, and a state without its line would shift them.
            folder.log(record)
            _store(folder, trainer, best)
            say(record)
        if board is not None:
            board.write(record)
    if board is not None:
        board.close()


def _trainer(config: RunConfig, prepared: TrainingSet, division: Division) -> Trainer:
    if config.method == "srgan":
        return SrganTrainer(prepared, division.train, division.unlabelled, config.srgan)
    return SupervisedTrainer(prepared, division.train, config.train)


def _opened(folder: RunFolder, resolved: Mapping[str, Any], trainer: Trainer, *, resume: bool) -> bool:
    """As `RunFolder.open`, which the first process does for all; the others wait for its answer."""
    place = trainer.place
    there = place.first and folder.open(resolved, resume=resume)
    return bool(place.ranks.sum(torch.tensor(float(there), device=place.device)) > 0)


def _store(folder: RunFolder, trainer: Trainer, best: _Best) -> None:
    error = best.error if best.weights else None  # JSON knows no infinity
    folder.store(trainer, best.weights, {"epoch": best.epoch, "error": error})


def _restored(folder: RunFolder, trainer: Trainer) -> _Best:
    weights, facts = folder.restore(trainer)
    return _Best(facts["epoch"], facts["error"], weights) if weights else _Best.none()


def _validate(trainer: Trainer, prepared: TrainingSet, held: Indices, best: _Best) -> float:
    """Root mean square of the scaled errors; keeps the weights where it is the least so far."""
    net = trainer.net.eval()
    place = columns(prepared.config.outputs)
    error = (predict_set(net, prepared, held) - prepared.labels[np.ix_(held, place)]) / net.target_scale.cpu().numpy()
    value = float(np.sqrt(np.mean(error**2)))
    if value < best.error:
        best.epoch, best.error = trainer.epoch - 1, value
        best.weights = {name: tensor.to("cpu", copy=True) for name, tensor in net.state_dict().items()}
    return value


def _patience_over(config: RunConfig, trainer: Trainer, best: _Best) -> bool:
    return config.patience is not None and best.epoch >= 0 and trainer.epoch - 1 - best.epoch >= config.patience


def _network_facts(
    config: RunConfig, data: Collection, prepared: TrainingSet, division: Division, best: _Best
) -> dict[str, Any]:
    learned = np.concatenate([division.train, division.unlabelled])
    return {
        **run_facts(config, data, division),
        "limits": ["Bounds are null: no calibration exists."],
        "familiar": LengthRangeCheck.fit(prepared.lengths[learned]).to_card(),
        "training": {**config.replace(data=None).to_mapping(), "best_epoch": best.epoch if best.weights else None},
    }


def _told(card: Path, config: RunConfig, data: Collection, division: Division, say: Say, *, epochs: int) -> Path:
    """Judge the model where the division tests samples, and tell the result."""
    result: dict[str, Any] = {"status": "done", "card": str(card), "epochs": epochs, "data_sha256": data.sha256}
    if len(division.test):
        result |= add_scores(card, config, data)
    say(result)
    return card
