# SPDX-License-Identifier: Apache-2.0
"""P2's semi-supervised training: a regressor and a generator, in turns.

    labelled ───┐                    ┌─ head with g1, g2, R ─► ŷ ─ L_labeled
    unlabelled ─┼─ PointNet ─► f(x) ─┴─ L_unlabeled, L_fake      (the regressor's step)
    noise ─ G ──┘                    └─ L_G                      (the generator's step)

f(x) is taken where P2 takes it, before g1, g2 and R are concatenated. The grasp of a fake cloud, which P2
computes with GeoGrasp, enters no loss from there; so none is computed.

Departures from P2, which specifies neither:

- Batch norm. With the three sources in one batch, or each in its own, the features of a cloud would depend on the
  clouds beside it. `frozen`: statistics are computed once, over real clouds, before the first step: features
  are a function of the cloud alone, in training as in prediction. `per_source`: each source is normalised
  by its own batch, and prediction by running statistics of the labelled clouds; kept to show the difference.
- An epoch is one pass over the labelled samples, so that a supervised network with the same batches takes as many
  steps. The unlabelled ones are shuffled again in each epoch, and repeated where they are fewer.

Shapes: B samples, N points, C channels, F features.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice, repeat

import numpy as np
import torch
from torch import Tensor, nn

from foretouch.config import setting
from foretouch_lab.learning.data.folds import Indices
from foretouch_lab.learning.data.training_set import TrainingSet
from foretouch_lab.learning.network.networks import CloudGenerator, GeneratorConfig, draw_noise
from foretouch_lab.learning.network.pointnet import Inputs, calibrate, freeze, statistics_kept
from foretouch_lab.learning.training import losses as loss_terms
from foretouch_lab.learning.training.trainer import EpochsConfig, Trainer, other_default, shuffled_batches

_CALIBRATION_BATCHES = 20


@dataclass(frozen=True, kw_only=True)
class SrganConfig(EpochsConfig):
    """Settings of the training of an SR-GAN; the defaults are P2's where P2 specifies them.

    Raises:
        ConfigError: If a setting is out of its bounds.
    """

    epochs: int = other_default("epochs", 30)
    batch_size: int = other_default("batch_size", 10)
    optimiser: str = other_default("optimiser", "adam")
    learning_rate: float = other_default("learning_rate", 0.01)
    weight_decay: float = other_default("weight_decay", 0.0)
    schedule: str = other_default("schedule", "constant")
    target_scaling: str = other_default("target_scaling", "ranges")
    batch_norm: str = setting("frozen", "Statistics of batch norm; see the module", choices=("frozen", "per_source"))
    generator: GeneratorConfig = GeneratorConfig()
    loss: loss_terms.SrganLossConfig = loss_terms.SrganLossConfig()


class SrganTrainer(Trainer):
    """Trains a regressor and a generator, one step each per batch.

    Args:
        data: All samples, labelled and not, prepared for the regressor's configuration.
        labelled: (T,) samples to learn from with their labels.
        unlabelled: (U,) samples to learn from without labels; labels that they have are not used.
        config: Settings of the training.

    Raises:
        DatasetError: If there are fewer samples of either kind than one batch.
    """

    config: SrganConfig
    generator: CloudGenerator

    def __init__(self, data: TrainingSet, labelled: Indices, unlabelled: Indices, config: SrganConfig) -> None:
        for kind, index in (("labelled ", labelled), ("unlabelled ", unlabelled)):
            self._require_batch(index, config.batch_size, kind)
        self._unlabelled = unlabelled
        super().__init__(data, labelled, config)
        if config.batch_norm == "frozen":
            calibrate(self.net, self._calibration())

    def _make_modules(self) -> dict[str, nn.Module]:
        self.generator = CloudGenerator(self.config.generator, self.data.config)
        return {"generator": self.generator}

    def _epoch(self) -> Iterator[Mapping[str, float]]:
        self.generator.train()
        self._set_mode()
        sources = [
            _repeated_batches(index, self.config.batch_size, self.batch_count, self.rng)
            for index in (self._labelled, self._unlabelled)
        ]
        for labelled, unlabelled in zip(*sources, strict=True):
            real, _ = self._inputs(unlabelled)
            yield self._regressor_step(labelled, real) | self._generator_step(real)

    def _set_mode(self) -> None:
        if self.config.batch_norm == "frozen":
            freeze(self.net)
        else:
            self.net.train()

    def _regressor_step(self, labelled: Indices, real: Tensor) -> dict[str, float]:
        with torch.no_grad():
            fake = self._fake(len(real))
        points, grasps = self._inputs(labelled)
        features = self._all_features(points, real, fake)
        error = self.net.regress(features[0], grasps) - self._targets(labelled)
        labeled = loss_terms.labeled_loss(error, torch.zeros_like(error), self.sizes)
        losses = loss_terms.discriminator_loss(labeled, features, self.config.loss)
        self.step("net", losses["total"])
        return {name: float(value.detach()) for name, value in losses.items()}

    def _generator_step(self, real: Tensor) -> dict[str, float]:
        with _fixed(self.net), statistics_kept(self.net):
            with torch.no_grad():
                aim = self.net.features(real)
            made = self.net.features(self._fake(len(real)))
            loss = loss_terms.matching_loss(made, aim, self.config.loss)
            self.step("generator", loss)
        return {"generator": float(loss.detach())}

    def _all_features(self, labelled: Tensor, unlabelled: Tensor, fake: Tensor) -> list[Tensor]:
        """Return f(x) of the three sources; in one pass, which is faster, where that gives the same features.

        Where fake clouds enter no loss (`as_printed`), their features are not computed.
        """
        used = [labelled, unlabelled, *([fake] if self.config.loss.loss_variant != "as_printed" else [])]
        features = self.net.features
        if self.config.batch_norm == "frozen" and all(cloud.shape[1:] == labelled.shape[1:] for cloud in used):
            return list(features(torch.cat(used)).chunk(len(used)))
        known = features(labelled)
        with statistics_kept(self.net):
            return [known, *(features(cloud) for cloud in used[1:])]

    def _fake(self, count: int) -> Tensor:
        noise = draw_noise(count, self.config.generator, torch.default_generator)
        return self.generator.clouds(noise.to(self.device))

    def _calibration(self) -> Iterator[Inputs]:
        """Return batches of real clouds, labelled or not."""
        everything = np.union1d(self._labelled, self._unlabelled)
        return map(self._inputs, _repeated_batches(everything, self.config.batch_size, _CALIBRATION_BATCHES, self.rng))


def _repeated_batches(index: Indices, size: int, count: int, rng: np.random.Generator) -> Iterator[Indices]:
    """Return `count` batches from as many shuffles of the samples as they take."""
    return islice(chain.from_iterable(shuffled_batches(index, size, rng) for _ in repeat(None)), count)


@contextmanager
def _fixed(net: nn.Module) -> Iterator[None]:
    """Compute no gradients for the weights within the block, as for a step of the other network."""
    for parameter in net.parameters():
        parameter.requires_grad = False
    try:
        yield
    finally:
        for parameter in net.parameters():
            parameter.requires_grad = True
