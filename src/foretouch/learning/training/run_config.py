# SPDX-License-Identifier: Apache-2.0
"""What `foretouch train` is told: a model, how it learns, and from what."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.learning.training.contact import ContactConfig
from foretouch.learning.training.srgan import SrganConfig
from foretouch.learning.training.supervised import TrainConfig
from foretouch.models.network.config import ModelConfig

__all__ = ["IDLE", "RunConfig"]

IDLE: Final = {
    "supervised": ("srgan", "contact"),
    "srgan": ("train", "contact"),
    "contact": ("model", "train", "srgan"),
}
"""By method, the settings that it does not look at."""


@dataclass(frozen=True, kw_only=True)
class RunConfig(Settings):
    """A model to train, and on what.

    Raises:
        ConfigError: If a setting is out of its bounds or of a method that is not used, patience is given without validation, or
            validation for a contact model.
    """

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
        for name in IDLE[self.method]:
            given: Settings = getattr(self, name)
            default = type(given)().to_mapping()
            changed = [key for key, value in given.to_mapping().items() if value != default[key]]
            if changed:
                raise ConfigError(f"RunConfig.{name}.{changed[0]}: has no effect on method {self.method!r}")

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
