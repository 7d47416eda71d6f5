# SPDX-License-Identifier: Apache-2.0
"""One training from a configuration to a model on disk, resumable at every epoch.

RUN/config.yaml        as resolved
RUN/log.jsonl          one line an epoch
RUN/state.safetensors  of the last epoch that was finite, from which --resume goes on
RUN/<name>.safetensors, RUN/<name>.json  the model and its card, at the end
RUN/tensorboard        the same figures as the log's, only where `tensorboard` asks for them

Of several processes (`torchrun`) the first alone writes; all of them read a state that is resumed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
import yaml
from torch import Tensor

from foretouch import __version__
from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, DatasetError, FileError
from foretouch.learning.board import open_board
from foretouch.learning.collection import Collection
from foretouch.learning.contact_run import fit_and_save
from foretouch.learning.contact_training import ContactConfig
from foretouch.learning.judging import judge
from foretouch.learning.srgan import SrganConfig, SrganTrainer
from foretouch.learning.train import SupervisedTrainer, TrainConfig, predict_set
from foretouch.learning.trainer import Indices, Trainer
from foretouch.learning.training_set import TrainingSet, duplicate_labels
from foretouch.learning.training_state import read_state, write_state
from foretouch.models.card import read_card, write_text
from foretouch.models.checkpoint import save_network
from foretouch.models.familiarity import Familiarity
from foretouch.models.settings import ModelConfig
from foretouch.tactile.modalities import columns

__all__ = ["LOG_FILE", "STATE_FILE", "RunConfig", "train_run"]

CONFIG_FILE: Final = "config.yaml"
LOG_FILE: Final = "log.jsonl"
BOARD_FOLDER: Final = "tensorboard"
STATE_FILE: Final = "state.safetensors"

Say = Callable[[Mapping[str, Any]], None]

_BEST: Final = "best/"


@dataclass(frozen=True, kw_only=True)
class RunConfig(Settings):
    """A model to train, and on what."""

    name: str = setting("touchnet", "Name of the model and of its files")
    data: str | None = setting(None, "Recorded dataset, training store or vision2tactile folders")
    method: str = setting(
        "supervised",
        "A network from labelled samples, or from unlabelled and fake ones too; or a contact model",
        choices=("supervised", "srgan", "contact"),
    )
    split: str | None = setting(None, "Part to learn from, such as labels/T50 or time/block 0; all samples by default")
    validation: float = setting(
        0.0, "Share of the labelled samples that is held back to choose the best epoch", minimum=0.0, maximum=0.5
    )
    tensorboard: bool = setting(False, "Write the log's figures for TensorBoard too; needs foretouch[tensorboard]")
    patience: int | None = setting(None, "Stop after so many epochs without a better validation", minimum=1)
    model: ModelConfig = ModelConfig()
    train: TrainConfig = TrainConfig()
    srgan: SrganConfig = SrganConfig()
    contact: ContactConfig = ContactConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.patience is not None and self.validation == 0.0:
            raise ConfigError("RunConfig.patience: needs validation above 0, for nothing else may stop a training")
        if self.method == "contact" and self.validation > 0.0:
            raise ConfigError("RunConfig.validation: a contact model has no epochs to choose from; leave it at 0")

    @property
    def seed(self) -> int:
        """Of the method that is used."""
        by_method = {"srgan": self.srgan.seed, "contact": self.contact.seed}
        return by_method.get(self.method, self.train.seed)

    @property
    def device(self) -> str:
        """Of the method that is used: `cpu` or `cuda`."""
        if self.method == "contact":
            return "cpu"
        return self.srgan.resolved_device if self.method == "srgan" else self.train.resolved_device


@dataclass(frozen=True, eq=False)
class _Sides:
    """Places of the samples: to learn from with and without label, to choose the epoch by, to be judged on."""

    train: Indices
    unlabelled: Indices
    validation: Indices
    test: Indices


@dataclass
class _Best:
    """The best epoch so far, by validation."""

    epoch: int = -1
    error: float = float("inf")
    weights: dict[str, Tensor] | None = None


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
        FileError: If `out` holds a run and `resume` is off, or cannot be written.
        ConfigError: If the run that stands there has another configuration or other data.
        DatasetError: If the data do not fit the configuration, or a loss stops being finite. The last good state stays.
    """
    sides = _sides(config, data)
    if config.method == "contact":
        return _contact_run(config, data, sides, out, say, resume=resume)
    prepared = TrainingSet.build(data.samples, config.model, unlabelled=True)
    trainer = _trainer(config, prepared, sides)
    best = _Best()
    if _opened(config, data, out, trainer, resume=resume):
        _restore(trainer, best, out)
    board = open_board(out / BOARD_FOLDER) if config.tensorboard and trainer.place.first else None
    while trainer.epoch < trainer.epochs and not _patience_over(config, trainer, best):
        losses = trainer.run_epoch()
        record: dict[str, Any] = {"epoch": trainer.epoch - 1, "epochs": trainer.epochs, "losses": losses}
        if len(sides.validation):
            record["validation"] = _validate(trainer, prepared, sides.validation, best)
        if trainer.place.first:
            # The log first, for a line without its state is replaced, and a state without its line would shift them.
            _log(out, record)
            _store(trainer, best, out)
            say(record)
        if board is not None:
            board.write(record)
    if board is not None:
        board.close()
    if best.weights is not None:
        trainer.net.load_state_dict(best.weights)
    trainer.net.cpu()
    if not trainer.place.first:
        return out / f"{config.name}.json"
    return _finish(config, data, prepared, sides, trainer, best, out, say)


def _contact_run(config: RunConfig, data: Collection, sides: _Sides, out: Path, say: Say, *, resume: bool) -> Path:
    """A contact model takes minutes, so a run that was killed starts anew."""
    _open_folder(config, data, out, resume=resume)
    division = {"name": config.split, **{side: len(index) for side, index in vars(sides).items()}}
    card = fit_and_save(config, data, sides.train, division, out)
    result: dict[str, Any] = {"status": "done", "card": str(card), "epochs": 0, "data_sha256": data.sha256}
    if len(sides.test):
        judged = judge(card, data, data.parts(str(config.split)), seed=config.seed)
        told = read_card(card)
        told["skill"] = {str(config.split): judged["scores"]["model"]}
        told["baselines"] = {name: table for name, table in judged["scores"].items() if name != "model"}
        write_text(card, json.dumps(told, indent=1) + "\n")
        result |= judged
    say(result)
    return card


def _sides(config: RunConfig, data: Collection) -> _Sides:
    labelled = [k for k, sample in enumerate(data.samples) if sample.touch is not None]
    train = np.array(labelled, np.intp)
    unlabelled = np.setdiff1d(np.arange(len(data.samples), dtype=np.intp), train)
    test = np.empty(0, np.intp)
    if config.split is not None:
        parts = data.parts(config.split)
        if len(parts) != 1:
            raise DatasetError(
                f"split: {config.split!r} has {len(parts)} parts; choose one: {config.split}/{parts[0].name}"
            )
        train, test, unlabelled = (data.index(ids) for ids in (parts[0].train, parts[0].test, parts[0].unlabelled))
    if config.method == "srgan" and not len(unlabelled):
        raise DatasetError("srgan: no sample is unlabelled; choose a split that withholds labels, such as labels/T50")
    held = np.random.default_rng(config.seed).permutation(train)[: round(config.validation * len(train))]
    if config.validation > 0.0 and not len(held):
        raise DatasetError(f"validation: {config.validation} of {len(train)} samples is none")
    return _Sides(np.setdiff1d(train, held), unlabelled, np.sort(held), test)


def _trainer(config: RunConfig, prepared: TrainingSet, sides: _Sides) -> Trainer:
    if config.method == "srgan":
        return SrganTrainer(prepared, sides.train, sides.unlabelled, config.srgan)
    return SupervisedTrainer(prepared, sides.train, config.train)


def _opened(config: RunConfig, data: Collection, out: Path, trainer: Trainer, *, resume: bool) -> bool:
    """As `_open_folder`, which the first process does for all; the others wait for its answer."""
    place = trainer.place
    there = place.first and _open_folder(config, data, out, resume=resume)
    return bool(place.ranks.sum(torch.tensor(float(there), device=place.device)) > 0)


def _open_folder(config: RunConfig, data: Collection, out: Path, *, resume: bool) -> bool:
    """Make the folder, or check that it holds this very run; whether there is a state to go on from."""
    # Where the data lie is no part of what they are.
    resolved = {**config.replace(data=None).to_mapping(), "data_sha256": data.sha256}
    file = out / CONFIG_FILE
    try:
        if file.exists():
            if not resume:
                raise FileError(out, "holds a run already; --resume goes on with it")
            _require_same(yaml.safe_load(file.read_text(encoding="utf-8")), resolved, file)
            return (out / STATE_FILE).exists()
        out.mkdir(parents=True, exist_ok=True)
        file.write_text(yaml.safe_dump(resolved, sort_keys=False), encoding="utf-8")
    except OSError as err:
        raise FileError(out, err.strerror or str(err)) from err
    return False


def _require_same(old: Any, new: Mapping[str, Any], file: Path) -> None:
    if not isinstance(old, dict):
        raise ConfigError(f"{file}: is no configuration of a run")
    for key in new:
        if old.get(key) != new[key]:
            raise ConfigError(f"{file}: {key}: {old.get(key)!r} is not {new[key]!r}; a run resumes as it began")


def _store(trainer: Trainer, best: _Best, out: Path) -> None:
    tensors, plain = trainer.snapshot()
    for name, value in (best.weights or {}).items():
        tensors[_BEST + name] = value
    plain["best"] = {"epoch": best.epoch, "error": best.error if best.weights is not None else None}
    write_state(out / STATE_FILE, tensors, plain)


def _restore(trainer: Trainer, best: _Best, out: Path) -> None:
    tensors, plain = read_state(out / STATE_FILE)
    weights = {name.removeprefix(_BEST): tensors.pop(name) for name in list(tensors) if name.startswith(_BEST)}
    if weights:
        best.epoch, best.error, best.weights = plain["best"]["epoch"], plain["best"]["error"], weights
    trainer.restore(tensors, plain)


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


def _log(out: Path, record: Mapping[str, Any]) -> None:
    """Append a line; an epoch that was run again after a kill replaces its line and those after it."""
    file = out / LOG_FILE
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    kept = [*lines[: record["epoch"]], json.dumps(record)]
    file.write_text("\n".join(kept) + "\n", encoding="utf-8")


def _finish(
    config: RunConfig,
    data: Collection,
    prepared: TrainingSet,
    sides: _Sides,
    trainer: Trainer,
    best: _Best,
    out: Path,
    say: Say,
) -> Path:
    learned = np.concatenate([sides.train, sides.unlabelled])
    facts: dict[str, Any] = {
        "summary": f"{', '.join(config.model.outputs)}, {config.method}, from {len(sides.train)} labelled samples of {data.name}",
        "data": {
            "name": data.name,
            "sha256": data.sha256,
            "samples": len(data.samples),
            "duplicate_labels": [list(pair) for pair in duplicate_labels([data.samples[k] for k in sides.train])],
        },
        "split": {"name": config.split, **{side: len(index) for side, index in vars(sides).items()}},
        "limits": ["Bounds are null: no calibration exists."],
        "familiar": Familiarity.fit(prepared.lengths[learned]).to_card(),
        "training": {**config.replace(data=None).to_mapping(), "best_epoch": best.epoch if best.weights else None},
        "version": __version__,
    }
    card = save_network(out, config.name, trainer.net.eval(), facts)
    result: dict[str, Any] = {"status": "done", "card": str(card), "epochs": trainer.epoch, "data_sha256": data.sha256}
    if len(sides.test):
        judged = judge(card, data, data.parts(str(config.split)), seed=config.seed)
        facts["skill"] = {str(config.split): judged["scores"]["model"]}
        facts["baselines"] = {name: table for name, table in judged["scores"].items() if name != "model"}
        card = save_network(out, config.name, trainer.net, facts)
        result |= judged
    say(result)
    return card
