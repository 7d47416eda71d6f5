# SPDX-License-Identifier: Apache-2.0
"""The learners of networks: supervised and SR-GAN training, resumable at every epoch."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from torch import Tensor

from foretouch.errors import ConfigError, DatasetError
from foretouch.learning.data import Dataset, DataSplit, Indices, TrainingSet
from foretouch.learning.data.training_set import predict_set
from foretouch.learning.training.contact import describe_objects
from foretouch.learning.training.device import DistributedContext
from foretouch.learning.training.learners.learner import CardCalibration, Learner, RunConfig, register
from foretouch.learning.training.run_folder import TENSORBOARD_FOLDER, RunFolder
from foretouch.learning.training.srgan import SrganConfig, SrganTrainer
from foretouch.learning.training.supervised import SupervisedTrainer, TrainConfig
from foretouch.learning.training.trainer import Trainer
from foretouch.models.calibration import add_calibration
from foretouch.models.network.checkpoint import save_network
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.length_check import LengthRangeCheck
from foretouch.models.novelty import Fallback
from foretouch.tactile import MODALITIES, TactileRanges, columns
from foretouch.types import TOUCH_SIZE, Float64


@dataclass(frozen=True, kw_only=True)
class NetworkRun(RunConfig):
    """Settings of all methods that train a network.

    Raises:
        ConfigError: Also if a network with only some of the modalities is to be calibrated or released.
    """

    has_epochs: ClassVar[bool] = True

    model: ModelConfig = ModelConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.calibrates and self.outputs != MODALITIES:
            field = "release" if self.release else "calibrate"
            raise ConfigError(
                f"RunConfig.{field}: model.outputs: {list(self.outputs)} are not all modalities, {', '.join(MODALITIES)}"
            )

    @property
    @abstractmethod
    def training(self) -> TrainConfig | SrganConfig:
        """Settings of the training."""

    @property
    def seed(self) -> int:
        """Seed of the training."""
        return self.training.seed

    @property
    def device(self) -> str:
        """`cpu` or `cuda`."""
        return self.training.resolved_device

    @property
    def outputs(self) -> tuple[str, ...]:
        """Modalities that the network predicts."""
        return self.model.outputs


@dataclass(frozen=True, kw_only=True)
class SupervisedRun(NetworkRun):
    """Settings of `method: supervised`."""

    train: TrainConfig = TrainConfig()

    @property
    def training(self) -> TrainConfig:
        """Settings of the training."""
        return self.train


@dataclass(frozen=True, kw_only=True)
class SrganRun(NetworkRun):
    """Settings of `method: srgan`."""

    srgan: SrganConfig = SrganConfig()

    @property
    def training(self) -> SrganConfig:
        """Settings of the training."""
        return self.srgan


@dataclass
class _Best:
    """The best epoch so far, by validation."""

    epoch: int  # its number, -1 without any
    error: float  # root mean square of its scaled errors
    weights: dict[str, Tensor]  # the network's weights by name, empty without any


_N = TypeVar("_N", bound=NetworkRun)


class NetworkLearner(Learner[_N]):
    """Trains a network; without a run folder, for as many epochs as the kept epoch of the run before."""

    def __init__(self, config: _N, data: Dataset, split: DataSplit) -> None:
        super().__init__(config, data, split)
        if config.calibrates and DistributedContext.of_process_group().world_size > 1:
            raise ConfigError("RunConfig.calibrate: requires a single process; start the training without torchrun")
        self._prepared = TrainingSet.build(data.samples, config.model, unlabelled=True)
        self._best = _Best(-1, float("inf"), {})
        self._objects = describe_objects(self.samples) if config.calibrates else np.empty((0, 0))

    def __getstate__(self) -> dict[str, Any]:
        """All but the trained weights, which the processes that fit folds do not use."""
        return {**self.__dict__, "_net": None, "_best": replace(self._best, weights={})}

    @property
    def ranges(self) -> TactileRanges:
        """Ranges of the hand that it learns from."""
        return self.config.model.ranges

    @abstractmethod
    def _trainer(self, train: Indices) -> Trainer:
        """The trainer of the method; indices count the samples of the dataset."""

    def fit(self, chosen: Indices | None = None, run: RunFolder | None = None) -> None:
        """As `Learner.fit`; with a run folder, every epoch is on disk before it is reported."""
        self._chosen = np.arange(len(self.samples)) if chosen is None else chosen
        trainer = self._trainer(self.split.train[self._chosen])
        if run is not None:
            self._train(trainer, run)
            self.epochs = trainer.epoch
            if self._best.weights:
                trainer.net.load_state_dict(self._best.weights)
        else:
            for _ in range((self._best.epoch + 1) or self.epochs or trainer.epochs):
                trainer.run_epoch()
        self._net = trainer.net.cpu().eval()

    def predict(self, index: Indices) -> Float64:
        """As `Learner.predict`; a calibrated network fades to its fallback on new objects."""
        predicted = np.full((len(index), TOUCH_SIZE), np.nan)
        counts = predict_set(self._net, self._prepared, self.split.train[index])
        predicted[:, columns(self.config.outputs)] = counts
        if not self.config.calibrates:
            return predicted
        return self._fallback().fade(predicted, self._objects[index])[0]

    def save(
        self, folder: Path, name: str, facts: Mapping[str, Any], calibration: CardCalibration | None = None
    ) -> Path:
        """As `Learner.save`."""
        learned = np.concatenate([self.split.train, self.split.unlabelled])
        best = self._best.epoch if self._best.weights else None
        own = {
            "familiar": LengthRangeCheck.fit(self._prepared.lengths[learned]).to_card(),
            "training": {**self.config.replace(data=None).to_mapping(), "best_epoch": best},
        }
        card = save_network(folder, name, self._net, {**facts, **own})
        if calibration is not None:
            add_calibration(card, *calibration, self._fallback())
        return card

    def _fallback(self) -> Fallback:
        return Fallback.fit(self._objects[self._chosen], self.labels[self._chosen])

    def _train(self, trainer: Trainer, run: RunFolder) -> None:
        """Train to the last epoch, or until there was no better validation for the epochs of the patience."""
        if run.resumed:
            weights, facts = run.restore(trainer)
            if weights:
                self._best = _Best(facts["epoch"], facts["error"], weights)
        first = trainer.training_device.context.rank == 0
        if first:
            run.keep_log(trainer.epoch)
        writer = _tensorboard_writer(run.path / TENSORBOARD_FOLDER) if self.config.tensorboard and first else None
        while trainer.epoch < trainer.epochs and not self._patience_over(trainer):
            losses = trainer.run_epoch()
            record: dict[str, Any] = {"epoch": trainer.epoch - 1, "epochs": trainer.epochs, "losses": losses}
            if len(self.split.validation):
                record["validation"] = self._validate(trainer)
            if first:
                # The log first: a line without its state is removed at resume; a state without its line would shift them.
                run.log(record)
                error = self._best.error if self._best.weights else None  # JSON has no infinity
                run.store(trainer, self._best.weights, {"epoch": self._best.epoch, "error": error})
                run.report(record)
            if writer is not None:
                for name, value in losses.items():
                    writer.add_scalar(f"losses/{name}", value, record["epoch"])
                if "validation" in record:
                    writer.add_scalar("validation", record["validation"], record["epoch"])
        if writer is not None:
            writer.close()

    def _validate(self, trainer: Trainer) -> float:
        """Root mean square of the scaled validation errors; keeps the weights if it is the least so far."""
        net, held = trainer.net.eval(), self.split.validation
        labels = self._prepared.labels[np.ix_(held, columns(self.config.outputs))]
        error = (predict_set(net, self._prepared, held) - labels) / net.target_scale.cpu().numpy()
        value = float(np.sqrt(np.mean(error**2)))
        if value < self._best.error:
            weights = {name: tensor.to("cpu", copy=True) for name, tensor in net.state_dict().items()}
            self._best = _Best(trainer.epoch - 1, value, weights)
        return value

    def _patience_over(self, trainer: Trainer) -> bool:
        patience, best = self.config.patience, self._best.epoch
        return patience is not None and best >= 0 and trainer.epoch - 1 - best >= patience


@register("supervised")
class SupervisedLearner(NetworkLearner[SupervisedRun]):
    """Trains a network on labelled samples."""

    config_type = SupervisedRun

    def _trainer(self, train: Indices) -> Trainer:
        return SupervisedTrainer(self._prepared, train, self.config.train)


@register("srgan")
class SrganLearner(NetworkLearner[SrganRun]):
    """Trains a network on labelled, unlabelled and generated samples."""

    config_type = SrganRun

    def __init__(self, config: SrganRun, data: Dataset, split: DataSplit) -> None:
        if not len(split.unlabelled):
            raise DatasetError(
                f"{data.name}: srgan: no sample is unlabelled; choose a split that withholds labels, such as labels/T50"
            )
        super().__init__(config, data, split)

    def _trainer(self, train: Indices) -> Trainer:
        return SrganTrainer(self._prepared, train, self.split.unlabelled, self.config.srgan)


def _tensorboard_writer(folder: Path) -> Any:
    """A writer in `folder`, beside the events of an earlier part of the same run.

    Raises:
        ConfigError: If TensorBoard is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as err:
        raise ConfigError("RunConfig.tensorboard: needs TensorBoard: pip install 'foretouch[tensorboard]'") from err
    return SummaryWriter(str(folder))
