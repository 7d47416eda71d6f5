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
  steps; or over the unlabelled ones (`epoch_over`). The others are shuffled again in each epoch, and repeated where
  they are fewer.

Shapes: B samples, N points, C channels, F features.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice, repeat

import numpy as np
import torch
from torch import Tensor, nn

from foretouch.config import setting
from foretouch.errors import ConfigError, DatasetError
from foretouch.learning.data import Indices, TrainingSet
from foretouch.learning.training import losses as loss_terms
from foretouch.learning.training import trainer
from foretouch.learning.training.device import SINGLE_PROCESS, DeviceConfig, TrainingDevice
from foretouch.learning.training.supervised import set_target_scaling
from foretouch.models.network.batch_norm import Inputs, calibrate, freeze, statistics_kept
from foretouch.models.network.networks import CloudGenerator, GeneratorConfig, draw_noise
from foretouch.tactile import columns

_CALIBRATION_BATCHES = 20


@dataclass(frozen=True, kw_only=True)
class SrganConfig(DeviceConfig):
    """Settings of the training of an SR-GAN; the defaults are P2's where P2 specifies them.

    Raises:
        ConfigError: If a setting is out of its bounds, or a gradient penalty is set without frozen batch norm.
    """

    epochs: int = setting(30, "Passes over the samples of `epoch_over`", minimum=1, maximum=100_000)
    epoch_over: str = setting(
        "labelled",
        "Samples of which an epoch is one pass, which P2 does not specify; the others are repeated or cut to as many batches",
        choices=("labelled", "unlabelled"),
    )
    batch_size: int = setting(10, "Samples of each source per step", minimum=2, maximum=4096)
    optimiser: str = setting("adam", "Optimiser", choices=trainer.OPTIMISERS)
    learning_rate: float = setting(0.01, "Largest learning rate of the regressor", minimum=1e-7, maximum=10.0)
    generator_learning_rate: float | None = setting(
        None, "Largest learning rate of the generator; by default the regressor's", minimum=1e-7, maximum=10.0
    )
    weight_decay: float = setting(0.0, "Weight decay", minimum=0.0, maximum=10.0)
    schedule: str = setting("constant", "Schedule of the learning rate", choices=trainer.SCHEDULES)
    target_scaling: str = setting(
        "ranges", "Scaling of the labels, as in supervised training", choices=("standardised", "ranges")
    )
    points: int | None = setting(None, "Points per cloud in training; by default as in prediction", minimum=8)
    batch_norm: str = setting("frozen", "Statistics of batch norm; see the module", choices=("frozen", "per_source"))
    seed: int = setting(0, "Seed of weights, order, points and noise", minimum=0)
    generator: GeneratorConfig = GeneratorConfig()
    loss: loss_terms.SrganLossConfig = loss_terms.SrganLossConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.loss.gradient_penalty > 0.0 and self.batch_norm != "frozen":
            raise ConfigError(
                "SrganConfig.loss.gradient_penalty: needs batch_norm frozen; else it starts in the millions"
            )


class SrganTrainer(trainer.Trainer):
    """Trains a regressor and a generator, one step each per batch.

    Args:
        data: All samples, labelled and not, prepared for the regressor's configuration.
        labelled: (T,) samples to learn from with their labels.
        unlabelled: (U,) samples to learn from without labels; labels that they have are not used.
        config: Settings of the training.

    Raises:
        DatasetError: If there are fewer samples of either kind than one batch.
    """

    generator: CloudGenerator

    def __init__(self, data: TrainingSet, labelled: Indices, unlabelled: Indices, config: SrganConfig) -> None:
        for kind, index in (("labelled", labelled), ("unlabelled", unlabelled)):
            if len(index) < config.batch_size:
                raise DatasetError(
                    f"training: {len(index)} {kind} samples are fewer than one batch of {config.batch_size}"
                )
        self.config = config
        super().__init__(data, config.seed, config.epochs, TrainingDevice.of(config, config.batch_size))
        self._labelled, self._unlabelled = labelled, unlabelled
        outputs = columns(data.config.outputs)
        set_target_scaling(self.net, data.labels[np.ix_(labelled, outputs)], config.target_scaling)
        steps = config.epochs * self.batch_count
        rate = config.learning_rate if config.generator_learning_rate is None else config.generator_learning_rate
        for name, module, largest in (("net", self.net, config.learning_rate), ("generator", self.generator, rate)):
            rule = trainer.OptimiserRule(config.optimiser, largest, config.weight_decay, config.schedule)
            self.optimisers[name] = trainer.ScheduledOptimiser(module, rule, steps, self.training_device.context)
        if config.batch_norm == "frozen":
            # Each process for itself and over whole batches, so that processes do not differ by rounding.
            dataclasses.replace(self.training_device, context=SINGLE_PROCESS).prepare(self.net)
            calibrate(self.net, self._calibration())
            self.training_device.prepare(self.net)

    def _make_modules(self) -> dict[str, nn.Module]:
        self.generator = CloudGenerator(self.config.generator, self.data.config)
        return {"generator": self.generator}

    def _epoch(self) -> Iterator[Mapping[str, float]]:
        self.generator.train()
        if self.config.batch_norm == "frozen":
            freeze(self.net)
        else:
            self.net.train()
        # Generators: the labelled samples are drawn first, as in runs of earlier versions, which can be resumed.
        sources = [
            _repeated_batches(index, self.config.batch_size, self.batch_count, self.rng)
            for index in (self._labelled, self._unlabelled)
        ]
        for number, (labelled, unlabelled) in enumerate(zip(*sources, strict=True)):
            real = self._points(unlabelled)
            losses = self._regressor_step(number, labelled, unlabelled, real)
            yield losses | self._generator_step(number, unlabelled, real)

    @property
    def batch_count(self) -> int:
        """Steps per epoch."""
        counted = self._labelled if self.config.epoch_over == "labelled" else self._unlabelled
        return len(counted) // self.config.batch_size

    def _regressor_step(self, number: int, labelled: Indices, unlabelled: Indices, real: Tensor) -> dict[str, float]:
        context = self.training_device.context
        with torch.no_grad():
            fake = self._fake(len(unlabelled))
        features = self._all_features(self._points(labelled), real, fake)
        scaled = self.net.regress(features.labeled, self._grasps(labelled))
        error = scaled - self.net.to_scaled(self.training_device.shard(self._labels[labelled]))
        penalty = None
        if self.config.loss.gradient_penalty > 0.0:
            penalty = loss_terms.gradient_penalty(self.net.features, real, fake, torch.default_generator, context)
        labeled = loss_terms.labeled_loss(error, torch.zeros_like(error), self.sizes, context=context)
        loss = loss_terms.discriminator_loss(labeled, features, self.config.loss, penalty, context)
        self.require_finite({"labeled": labeled}, number, context.shard(labelled), error, features.labeled)
        parts = loss.parts | {"total": loss.total}
        self.require_finite(parts, number, context.shard(unlabelled), features.unlabeled)
        self.optimisers["net"].step(loss.total)
        return loss.numbers()

    def _generator_step(self, number: int, unlabelled: Indices, real: Tensor) -> dict[str, float]:
        with _fixed(self.net), statistics_kept(self.net):
            with torch.no_grad():
                aim = self.net.features(real)
            made = self.net.features(self._fake(len(unlabelled)))
            loss = loss_terms.generator_loss(made, aim, self.config.loss, self.training_device.context)
            self.require_finite(loss.parts, number, self.training_device.context.shard(unlabelled), aim)
            self.optimisers["generator"].step(loss.total)
        return {"generator": float(loss.total.detach())}

    def _all_features(self, labelled: Tensor, unlabelled: Tensor, fake: Tensor) -> loss_terms.Features:
        """f(x) of the three sources; in one pass, which is faster, where that gives the same features.

        Where fake clouds enter no loss (`as_printed`), their features are not computed.
        """
        if self.config.loss.loss_variant == "as_printed":
            if self.config.batch_norm == "frozen":
                known, other = self.net.features(torch.cat([labelled, unlabelled])).chunk(2)
                return loss_terms.Features(known, other, None)
            known = self.net.features(labelled)
            with statistics_kept(self.net):
                return loss_terms.Features(known, self.net.features(unlabelled), None)
        if self.config.batch_norm == "frozen" and labelled.shape[1:] == fake.shape[1:]:
            return loss_terms.Features(*self.net.features(torch.cat([labelled, unlabelled, fake])).chunk(3))
        known = self.net.features(labelled)
        with statistics_kept(self.net):
            return loss_terms.Features(known, self.net.features(unlabelled), self.net.features(fake))

    def _fake(self, count: int) -> Tensor:
        noise = draw_noise(count, self.config.generator, torch.default_generator)
        return self.generator.clouds(self.training_device.shard(noise))

    def _points(self, batch: Indices) -> Tensor:
        return self.training_device.shard(torch.from_numpy(self.data.points(batch, self.rng, self.config.points)))

    def _grasps(self, batch: Indices) -> Tensor | None:
        return self.training_device.shard(self._grasp_inputs[batch]) if self.data.config.use_grasp else None

    def _calibration(self) -> Iterator[Inputs]:
        """Batches of real clouds, labelled or not."""
        everything = np.union1d(self._labelled, self._unlabelled)
        device = self.training_device.device
        for batch in _repeated_batches(everything, self.config.batch_size, _CALIBRATION_BATCHES, self.rng):
            points = torch.from_numpy(self.data.points(batch, self.rng, self.config.points)).to(device)
            yield points, self._grasp_inputs[batch].to(device) if self.data.config.use_grasp else None


def _repeated_batches(index: Indices, size: int, count: int, rng: np.random.Generator) -> Iterator[Indices]:
    """`count` batches from as many shuffles of the samples as they take."""
    return islice(chain.from_iterable(trainer.shuffled_batches(index, size, rng) for _ in repeat(None)), count)


@contextmanager
def _fixed(net: nn.Module) -> Iterator[None]:
    """Within, no gradients are computed for the weights, as for a step of the other network."""
    for parameter in net.parameters():
        parameter.requires_grad = False
    try:
        yield
    finally:
        for parameter in net.parameters():
            parameter.requires_grad = True
