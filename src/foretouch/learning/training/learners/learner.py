# SPDX-License-Identifier: Apache-2.0
"""The interface of a training method: settings of a run, and a learner that fits, predicts, calibrates and saves."""

import copy
import dataclasses
import typing
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, TypeVar

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.learning.data import Dataset, DataSplit, Fold, Indices, fold_workers, labels_of, predict_folds
from foretouch.learning.training.calibration import calibrate, calibration_folds
from foretouch.learning.training.run_folder import RunFolder
from foretouch.models.calibration import Calibration
from foretouch.models.registry import load_model
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import MODALITIES, P2_RANGES, TactileRanges
from foretouch.types import Float64

CardCalibration = tuple[Calibration, dict[str, Any]]
"""A calibration, and its facts for the card."""


@dataclass(frozen=True, kw_only=True)
class RunConfig(Settings):
    """Settings of every `foretouch train`; a method that has further settings declares them in a subclass.

    Raises:
        ConfigError: If a setting is out of bounds, patience is set without validation, validation is set for a method
            without epochs, or a release is set to train on a part of the samples.
    """

    has_epochs: ClassVar[bool] = False

    name: str = setting("touchnet", "Name of the model and of its files")
    data: str | None = setting(None, "Dataset: recorded dataset, training store or vision2tactile folders")
    method: str = setting(
        "supervised",
        "Training method: supervised (a network from labelled samples), srgan (a network from labelled, unlabelled and "
        "generated samples) or contact (the contact model)",
    )
    split: str | None = setting(
        None, "Part of the dataset to learn from, such as labels/T50 or time/block 0; all samples by default"
    )
    validation: float = setting(
        0.0, "Share of the labelled samples set aside to choose the best epoch", minimum=0.0, maximum=0.5
    )
    tensorboard: bool = setting(False, "Write the log for TensorBoard, too; requires foretouch[tensorboard]")
    patience: int | None = setting(None, "Stop after this many epochs without a better validation error", minimum=1)
    calibrate: bool = setting(
        False,
        "Calibrate intervals on held-out predictions, for which the model is fitted again on each of up to 15 folds; "
        "the weights do not depend on it",
    )
    release: bool = setting(
        False,
        "Score model and baselines on three splits by cross-validation, calibrate, and list the limits in the card",
    )

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.__name__ = "RunConfig"  # errors name a setting alike whatever the method

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.patience is not None and self.validation == 0.0:
            raise ConfigError("RunConfig.patience: needs validation above 0, for nothing else may stop a training")
        if self.validation > 0.0 and not self.has_epochs:
            raise ConfigError(
                f"RunConfig.validation: a {self.method} model has no epochs to choose from; leave it at 0"
            )
        if self.release and (self.split is not None or self.validation > 0.0):
            raise ConfigError("RunConfig.release: trains on all samples; leave split empty and validation at 0")

    @classmethod
    def groups(cls) -> dict[str, type[Settings]]:
        """The groups of settings of the method, by name."""
        hints = typing.get_type_hints(cls)
        return {f.name: hints[f.name] for f in dataclasses.fields(cls) if _is_group(hints[f.name])}

    @property
    def calibrates(self) -> bool:
        """Whether the model gets intervals."""
        return self.calibrate or self.release

    @property
    def seed(self) -> int:
        """Seed of the method."""
        return 0

    @property
    def device(self) -> str:
        """`cpu` or `cuda`."""
        return "cpu"

    @property
    def outputs(self) -> tuple[str, ...]:
        """Modalities that the model predicts."""
        return MODALITIES


def _is_group(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, Settings)


_C = TypeVar("_C", bound=RunConfig)


class Learner(ABC, Generic[_C]):
    """A training method, applied to one dataset.

    Indices count the labelled training samples, so that folds of them can be held out.

    Attributes:
        config: Settings of the run, of type `config_type`.
        split: Partition of the dataset into training, validation and test samples.
        samples: The labelled training samples.
        labels: (S, 50) their labels [counts].
        epochs: Number of epochs of the last `fit`; 0 for a method without epochs.

    Raises:
        DatasetError: If a sample cannot be used; names the sample.
    """

    config_type: ClassVar[type[RunConfig]] = RunConfig

    def __init__(self, config: _C, data: Dataset, split: DataSplit) -> None:
        self.config = config
        self.split = split
        self.samples = [data.samples[k] for k in split.train]
        self.labels = labels_of(self.samples)
        self.epochs = 0

    @property
    def ranges(self) -> TactileRanges:
        """Ranges of the hand that it learns from."""
        return P2_RANGES

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
        """(T, 50) predictions of training samples by the model of the last `fit` [counts].

        NaN for absent modalities.
        """

    @abstractmethod
    def save(
        self, folder: Path, name: str, facts: Mapping[str, Any], calibration: CardCalibration | None = None
    ) -> Path:
        """Write weights, card and calibration of the last `fit`; returns the path of the card."""

    @staticmethod
    def load(card: Path) -> TouchModel:
        """Read back what `save` wrote, if it predicts all modalities."""
        return load_model(card)

    def predict_fold(self, fold: Fold) -> Float64:
        """(T, 50) predictions of a fold's test side by a model fitted to its training side [counts].

        Changes nothing.
        """
        learner = copy.copy(self)
        learner.fit(fold.train)
        return learner.predict(fold.test)

    def calibrate(self, predicted: Mapping[str, Float64] | None = None, *, workers: int = 1) -> CardCalibration:
        """Calibrate intervals and adaptation on held-out predictions; the fitted model stays as it is.

        Args:
            predicted: (S, 50) held-out predictions by condition (see `calibration_folds`); computed by default.
            workers: Number of processes.

        Raises:
            DatasetError: If all training samples are of one object.
        """
        conditions = calibration_folds(self.samples, self.config.seed)
        if predicted is None:
            with fold_workers(workers) as run:
                predicted = {
                    name: predict_folds(self.predict_fold, folds, run) for name, (folds, _) in conditions.items()
                }
        held_out = {name: (predicted[name], sessions) for name, (_, sessions) in conditions.items()}
        return calibrate(self.samples, self.labels, held_out)


LEARNERS: Final[dict[str, type[Learner[Any]]]] = {}
"""By method; see `register`."""

_L = TypeVar("_L", bound=type[Learner[Any]])


def register(method: str) -> Callable[[_L], _L]:
    """Make a learner available as `method` of a run configuration."""

    def add(learner: _L) -> _L:
        LEARNERS[method] = learner
        return learner

    return add
