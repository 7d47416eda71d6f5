# SPDX-License-Identifier: Apache-2.0
"""Training of the two models of `label_ratio`, and the hyperparameters that were tried for each.

One trainer trains both. The PointNet is the SR-GAN with unsupervised weights of zero: the same network from the same
initial weights, batch norm frozen at the statistics of the same clouds, batches of labelled samples of the same size,
the same optimiser and number of updates. What remains is the effect of the unlabelled and fake clouds.

Departures from P2, equal for both models, each an option in the settings:

- An update takes `batch_size` samples of each kind, and the number of updates is the same at every ratio in `quick`:
  P2's 30 epochs over all labelled samples would give T10 nine times the updates of T90.
- AdamW with a cosine schedule instead of Adam at a constant 0.01, labels standardised instead of scaled by their
  ranges, the radius of the cloud and the width of the grasp as further inputs: with P2's recipe a PointNet does not
  converge on touch.
- No early stopping: no held-out samples are used in training, and the last weights are evaluated.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import torch

from foretouch.errors import ConfigError
from foretouch.experiments.framework.experiment import Row
from foretouch.experiments.label_ratio.data import LabelSplit
from foretouch.learning.data import TrainingSet
from foretouch.learning.data.training_set import predict_set
from foretouch.learning.training.losses import labeled_loss
from foretouch.learning.training.srgan import SrganConfig, SrganTrainer
from foretouch.learning.training.supervised import SupervisedTrainer, TrainConfig
from foretouch.learning.training.trainer import shuffled_batches
from foretouch.models.network.batch_norm import freeze
from foretouch.tactile import columns, modality_size
from foretouch.types import Float64

POINTNET: Final = "pointnet"
SRGAN: Final = "srgan"
MODELS: Final = (POINTNET, SRGAN)

_SUPERVISED: Final = {
    "loss_variant": "as_printed",
    "weight_unlabeled": 0.0,
    "weight_fake": 0.0,
    "gradient_penalty": 0.0,
}


def _srgan(matching: float, contrast: float, penalty: float, rate: float = 3e-3, decay: float = 0.0) -> dict[str, Any]:
    loss = {"weight_unlabeled": matching, "weight_fake": contrast, "gradient_penalty": penalty}
    return {"learning_rate": rate, "weight_decay": decay, "loss": {"loss_variant": "srgan", **loss}}


TRIALS: Final[Mapping[str, Mapping[str, Mapping[str, Any]]]] = {
    POINTNET: {
        "rate 0.001": {"learning_rate": 1e-3},
        "rate 0.001, decay 0.3": {"learning_rate": 1e-3, "weight_decay": 0.3},
        "rate 0.003": {"learning_rate": 3e-3},
        "rate 0.003, decay 0.3": {"learning_rate": 3e-3, "weight_decay": 0.3},
        "rate 0.0003, decay 0.3": {"learning_rate": 3e-4, "weight_decay": 0.3},
        "rate 0.001, decay 1": {"learning_rate": 1e-3, "weight_decay": 1.0},
    },
    SRGAN: {
        "0.03/0.1/0.03": _srgan(0.03, 0.1, 0.03),
        "0.3/1/0.1": _srgan(0.3, 1.0, 0.1),
        "0.3/1/0.3": _srgan(0.3, 1.0, 0.3),
        "0.3/1/1": _srgan(0.3, 1.0, 1.0),
        "0.3/1/1, decay 0.3": _srgan(0.3, 1.0, 1.0, decay=0.3),
        "0.3/1/1, rate 0.001, decay 0.3": _srgan(0.3, 1.0, 1.0, rate=1e-3, decay=0.3),
    },
}
"""Changes of each trial by model. Trials of the SR-GAN are named by w_U / w_F / λ of the loss `srgan`.

Their learning rate is 0.003 unless the name contains another one."""


AS_PRINTED: Final[Mapping[str, Mapping[str, Mapping[str, Any]]]] = {
    POINTNET: {"P2": {"batch_size": 32, "epochs": 50}},
    SRGAN: {
        f"P2, {variant}": {"batch_norm": "per_source", "loss": {"loss_variant": variant}}
        for variant in ("as_printed", "contrast", "srgan")
    },
}
"""P2's recipe, which is the defaults of `SrganConfig`, in the three readings of its losses. Its PointNet is trained by
`SupervisedTrainer` with batch norm as usual. Not among the trials: nothing is selected."""


def kind_of(modality: str) -> str:
    """`pressure` or `electrodes`; modalities of a kind share their trial."""
    return "pressure" if modality_size(modality) == 1 else "electrodes"


def configured(base: SrganConfig, model: str, trial: str, labelled: int, updates: int | None, seed: int) -> SrganConfig:
    """Configuration of one training.

    Args:
        base: Configuration that both models and all trials share.
        model: One of `MODELS`.
        trial: One of `TRIALS[model]`.
        labelled: Number of labelled samples.
        updates: Number of updates, rounded to whole epochs, at least one; None for the epochs of `base`.
        seed: Seed of weights, order, points and noise.

    Raises:
        ConfigError: If there is no such model or trial.
    """
    known = {**TRIALS.get(model, {}), **AS_PRINTED.get(model, {})}
    if trial not in known:
        raise ConfigError(f"label_ratio: {model} {trial!r} is none of {', '.join(known or MODELS)}")
    config = base.updated(known[trial], trial)
    if model == POINTNET:
        config = config.updated({"loss": _SUPERVISED})
    epochs = config.epochs
    if updates is not None:
        epochs = max(1, round(updates / max(1, labelled // config.batch_size)))
    return config.replace(epochs=epochs, seed=seed)


class PointnetTrainer(SrganTrainer):
    """The SR-GAN's trainer without unlabelled and fake clouds.

    With `_SUPERVISED` it takes the steps of `SrganTrainer` on the same batches, without the generator and the terms
    that are multiplied by zero, in a quarter of the time.
    """

    def _epoch(self) -> Iterator[Mapping[str, float]]:
        freeze(self.net)
        for number, batch in enumerate(shuffled_batches(self._labelled, self.config.batch_size, self.rng)):
            scaled = self.net(self._points(batch), self._grasps(batch))
            error = scaled - self.net.to_scaled(self._labels[batch])
            loss = self.config.loss.weight_labeled * labeled_loss(error, torch.zeros_like(error), self.sizes)
            self.require_finite({"labeled": loss}, number, batch, error)
            self.optimisers["net"].step(loss)
            yield {"labeled": float(loss.detach())}


def train_and_predict(
    data: TrainingSet, split: LabelSplit, model: str, config: SrganConfig, *, as_printed: bool = False
) -> tuple[Float64, int]:
    """Train a network and predict the test samples; with `as_printed` the PointNet as P2 describes it.

    Returns:
        (J, M) predictions [counts], and the number of updates.

    Raises:
        DatasetError: If there are fewer samples than a batch takes, or a loss is not finite.
    """
    trainer: SupervisedTrainer | SrganTrainer
    if model == POINTNET and as_printed:
        trainer = SupervisedTrainer(data, split.train, _supervised(config))
    else:
        kind = PointnetTrainer if model == POINTNET else SrganTrainer
        trainer = kind(data, split.train, split.unlabelled, config)
    while trainer.epoch < trainer.epochs:
        trainer.run_epoch()
    return predict_set(trainer.net.eval(), data, split.test), trainer.epochs * trainer.batch_count


def _supervised(config: SrganConfig) -> TrainConfig:
    """The settings that a supervised training has in common with an SR-GAN's, with P2's RMSE."""
    names = ("epochs", "batch_size", "optimiser", "learning_rate", "weight_decay", "schedule", "target_scaling", "seed")
    return TrainConfig(loss="rmse", **{name: getattr(config, name) for name in names})


def error_row(data: TrainingSet, split: LabelSplit, predicted: Float64, objects: Sequence[str]) -> Row:
    """Squared errors of a network and of the training mean for each test sample.

    Args:
        data: The samples.
        split: Training and test samples.
        predicted: (J, M) predictions [counts].
        objects: (J,) objects of the test samples.

    Returns:
        By object, in order of the samples, both means over the modality's values [counts²].
    """
    index = columns(data.config.outputs)
    actual = data.labels[np.ix_(split.test, index)]
    mean = data.labels[np.ix_(split.train, index)].mean(axis=0)
    squared, reference = (((guess - actual) ** 2).mean(axis=1) for guess in (predicted, mean))
    names = np.array(objects)
    return {
        "labelled": len(split.train),
        "objects": {
            str(name): {
                "squared": squared[names == name].round(3).tolist(),
                "reference": reference[names == name].round(3).tolist(),
            }
            for name in np.unique(names)
        },
    }
