# SPDX-License-Identifier: Apache-2.0
"""The methods of training behind one interface: a learner fits, predicts, calibrates and saves.

A further method takes a learner here, and its name and group of settings in `run_config`.
"""

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.errors import ConfigError, DatasetError
from foretouch.grasp import closing_faults
from foretouch.models.card import CardCalibration
from foretouch.models.contact.estimator import save_contact
from foretouch.models.contact.features import CONDITIONS
from foretouch.models.network.checkpoint import network_key
from foretouch.models.network.config import EACH
from foretouch.models.network.preparation import LengthRangeCheck
from foretouch.models.novelty import Fallback
from foretouch.tactile import BIOTAC, P2_RANGES
from foretouch.types import Float64, Grasps
from foretouch_lab.learning.data import Dataset, labels_of
from foretouch_lab.learning.data.folds import Fold, Indices
from foretouch_lab.learning.data.training_set import TrainingSet, predict_set
from foretouch_lab.learning.network.networks import TouchNet, save_network, save_networks
from foretouch_lab.learning.training.calibration import calibrate_on_folds
from foretouch_lab.learning.training.contact import ContactPredictor, describe_objects
from foretouch_lab.learning.training.run_config import RunConfig
from foretouch_lab.learning.training.run_folder import RunFolder
from foretouch_lab.learning.training.srgan import SrganTrainer
from foretouch_lab.learning.training.supervised import SupervisedTrainer
from foretouch_lab.learning.training.trainer import Trainer


class Learner(ABC):
    """A training method, applied to one dataset.

    Indices count the labelled training samples, so that folds of them can be held out.

    Attributes:
        config: Settings of the run.
        data_name: Name of the dataset.
        sensor: That the samples are of.
        split: Partition of the dataset into training and test samples.
        samples: The labelled training samples.
        labels: (S, D) their labels [counts].
        shapes: (S,) shapes of their objects, where whole shapes are left out for the calibration; else None.
        where: (S, P) features of their grasps that the models' estimates hold, too; None of models without.
        epochs: Number of epochs of the last `fit`; 0 for a method without epochs.

    Raises:
        DatasetError: If a sample cannot be used, and names it; or if no label varies.
        ConfigError: If shapes are to be left out, and the dataset does not state them.
    """

    def __init__(self, config: RunConfig, data: Dataset, split: Fold) -> None:
        self.config = config
        self.split = split
        self.data_name = data.name
        self.sensor = data.sensor
        self.samples = [data.filled[k] for k in split.train]
        faults = closing_faults(Grasps.of([sample.grasp for sample in self.samples]))
        takes_grasp = not config.has_network or config.model.use_grasp
        for sample, fault in zip(self.samples, faults, strict=True):
            if takes_grasp and not sample.grasp.is_known:
                rule = (
                    "is not known, as without a camera; give the contacts that were executed, in the frame of the cloud"
                )
                raise DatasetError(f"{sample.id}: grasp: {rule}")
            if fault:
                raise DatasetError(f"{sample.id}: grasp: {fault}")
        self.labels = labels_of(self.samples)
        read = self.labels[:, self.sensor.channels.columns(self.outputs)]
        if len(read) > 1 and not np.ptp(read, axis=0).any():
            rule = f"{', '.join(self.outputs)} are the same in all {len(read)} samples, so nothing can be learnt"
            raise DatasetError(f"{data.name}: labels: {rule}; was one reading written to all of them?")
        self.shapes: list[str] | None = None
        if config.left_out == "shapes":
            if unknown := [sample.object for sample in self.samples if sample.object not in data.shapes]:
                rule = f"{data.name} does not state the shape of {unknown[0]}, as simulated data do; use objects"
                raise ConfigError(f"left_out: {rule}")
            self.shapes = [data.shapes[sample.object] for sample in self.samples]
        self.where: Float64 | None = None
        self.epochs = 0

    @abstractmethod
    def fit(self, chosen: Indices | None = None, run: RunFolder | None = None) -> None:
        """Fit to the chosen training samples, by default to all.

        Args:
            chosen: (T,) indices.
            run: Where a method with epochs keeps log and state, and from which it resumes.

        Raises:
            DatasetError: If there are too few samples, or a loss becomes infinite or NaN.
        """

    @abstractmethod
    def predict(self, index: Indices) -> Float64:
        """Return (T, D) predictions of training samples by the model of the last `fit`; NaN for absent modalities [counts]."""

    @abstractmethod
    def save(self, folder: Path, name: str, facts: Mapping[str, Any], calibration: CardCalibration | None) -> Path:
        """Write weights, card and calibration of the last `fit`, all files or none; returns the path of the card."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Modalities that are predicted."""
        if not self.config.has_network:
            return self.sensor.channels.modalities
        return tuple(name for network in self.config.model.networks() for name in network.outputs)

    def predict_fold(self, fold: Fold) -> Float64:
        """Return (T, D) predictions of a fold's test side by a copy that is fitted to its training side [counts]."""
        learner = copy.copy(self)
        learner.fit(fold.train)
        return learner.predict(fold.test)

    def calibrate(self, workers: int = 1) -> CardCalibration:
        """Calibrate by `calibrate_on_folds`; the fitted model stays as it is."""
        how: Any = {"where": self.where, "shapes": self.shapes, "workers": workers}
        return calibrate_on_folds(self.samples, self.labels, self.predict_fold, self.config.seed, **how)


class ContactLearner(Learner):
    """Fits a contact model at the rest level of all training samples."""

    def __init__(self, config: RunConfig, data: Dataset, split: Fold) -> None:
        super().__init__(config, data, split)
        if self.sensor.channels != BIOTAC and config.contact.ranges != P2_RANGES:
            raise ConfigError(
                f"contact.ranges: are of {BIOTAC.sensor}, and {data.name} is of {data.sensor.config.name}"
            )
        self._predictor = ContactPredictor(self.samples, self.labels, config.contact)
        self.where = self._predictor.rows[:, len(CONDITIONS) :]

    def fit(self, chosen: Indices | None = None, run: RunFolder | None = None) -> None:
        """Fit the forests and the kernel; it takes seconds, so a run that was stopped starts again."""
        del run
        self._estimator = self._predictor.fit(np.arange(len(self.samples)) if chosen is None else chosen)

    def predict(self, index: Indices) -> Float64:
        """Return (T, D) predictions of training samples [counts]."""
        return self._estimator.predict_rows(self._predictor.rows[index])[0]

    def save(self, folder: Path, name: str, facts: Mapping[str, Any], calibration: CardCalibration | None) -> Path:
        """Write weights, card and calibration, all files or none."""
        unknown = sum(sample.table is None for sample in self.samples)
        gains = zip(self.sensor.channels.modalities, self._estimator.generalisation_gain, strict=True)
        shares = ", ".join(f"{modality} {value:.2f}" for modality, value in gains)
        limits = [
            *facts.get("limits", []),
            f"Unfamiliar objects get the mean of the training labels and this share of what the kernel predicts beyond it: {shares}.",
            "Without a table the camera is taken to look straight down on it; from a tilted camera the upper side that it does not see is estimated by symmetry.",
            *([f"{unknown} of {len(self.samples)} training samples hold no table."] if unknown else []),
        ]
        config = self.config.contact.to_mapping()
        if self.sensor.channels != BIOTAC:
            del config["ranges"]  # which are of the BioTac SP
        facts = {**facts, "config": config, "limits": limits}
        return save_contact(folder, name, self._estimator, facts, calibration)


class NetworkLearner(Learner):
    """Trains a network, or one for each modality."""

    def __init__(self, config: RunConfig, data: Dataset, split: Fold) -> None:
        if config.method == "srgan" and not len(split.unlabelled):
            raise DatasetError(
                f"{data.name}: srgan: no sample is unlabelled; choose a split that withholds labels, such as labels/T50"
            )
        if data.sensor.channels != BIOTAC:
            rule = (
                f"{config.method} trains networks for {BIOTAC.sensor}, and {data.name} is of {data.sensor.config.name}"
            )
            raise ConfigError(f"method: {rule}; use contact")
        super().__init__(config, data, split)
        prepared = TrainingSet.build(data.filled, config.model, unlabelled=True)
        self._prepared = [replace(prepared, config=network) for network in config.model.networks()]
        self._objects = describe_objects(self.samples) if config.calibrates else np.empty((0, 0))

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the trained weights, which the processes that fit folds do not use."""
        return {**self.__dict__, "_nets": None}

    def fit(self, chosen: Indices | None = None, run: RunFolder | None = None) -> None:
        """Train the networks; with a model folder, every epoch is on disk before it is reported."""
        self._chosen = np.arange(len(self.samples)) if chosen is None else chosen
        one = len(self._prepared) == 1
        self._nets = [
            self._train(prepared, run if run is None or one else run.part(network_key(prepared.config)))
            for prepared in self._prepared
        ]

    def _train(self, prepared: TrainingSet, run: RunFolder | None) -> TouchNet:
        """Train one network."""
        train = self.split.train[self._chosen]
        trainer: Trainer
        if self.config.method == "srgan":
            held_out = np.setdiff1d(self.split.train, train)
            trainer = SrganTrainer(prepared, train, np.setdiff1d(self.split.unlabelled, held_out), self.config.srgan)
        else:
            trainer = SupervisedTrainer(prepared, train, self.config.train)
        if run is not None and run.resumed:
            run.restore(trainer)

        def done(losses: dict[str, float]) -> None:
            if run is not None:
                run.store(trainer, {"epoch": trainer.epoch - 1, "epochs": trainer.config.epochs, "losses": losses})

        net = trainer.train(done)
        self.epochs = trainer.epoch
        return net

    def predict(self, index: Indices) -> Float64:
        """Return (T, D) predictions of training samples [counts]; a calibrated network fades to its fallback on new objects."""
        predicted = np.full((len(index), BIOTAC.size), np.nan)
        for net, prepared in zip(self._nets, self._prepared, strict=True):
            predicted[:, BIOTAC.columns(prepared.config.outputs)] = predict_set(net, prepared, self.split.train[index])
        return self._fallback().fade(predicted, self._objects[index])[0] if self.config.calibrates else predicted

    def save(self, folder: Path, name: str, facts: Mapping[str, Any], calibration: CardCalibration | None) -> Path:
        """Write weights, card and calibration, all files or none."""
        learned = np.concatenate([self.split.train, self.split.unlabelled])
        own = {
            "familiar": LengthRangeCheck.fit(self._prepared[0].lengths[learned]).to_card(),
            "training": self.config.replace(data=None).to_mapping(),
        }
        fallback = None if calibration is None else self._fallback()
        save = save_network if self.config.model.outputs != (EACH,) else save_networks
        nets: Any = self._nets if save is save_networks else self._nets[0]
        return save(folder, name, nets, {**facts, **own}, calibration, fallback)

    def _fallback(self) -> Fallback:
        return Fallback.fit(BIOTAC, self._objects[self._chosen], self.labels[self._chosen])


def make_learner(config: RunConfig, data: Dataset, split: Fold | None = None) -> Learner:
    """Return the learner of the configured method for a part of a dataset, by default the configured one."""
    split = data.partition(config.split) if split is None else split
    return (NetworkLearner if config.has_network else ContactLearner)(config, data, split)
