# SPDX-License-Identifier: Apache-2.0
"""Training loop shared by all networks: epochs, private random numbers, and a state that resumes bit for bit.

The same seed gives the same bits on the same device with the same number of threads. A GPU adds in no fixed order, so
its results agree with each other and with a CPU's only up to rounding.
"""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim.lr_scheduler import ConstantLR, CosineAnnealingLR

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, DatasetError, ModelError
from foretouch.models.files import under
from foretouch.tactile import BIOTAC
from foretouch.types import Float64
from foretouch_lab.learning.data.folds import Indices
from foretouch_lab.learning.data.training_set import TrainingSet
from foretouch_lab.learning.network.networks import TouchNet
from foretouch_lab.learning.network.pointnet import Inputs, InputTransform, PointNetFeatures

_LEAST_DEVIATION = 1.0  # [counts], so that a constant output does not divide by zero
_OPTIMISERS: Final[dict[str, type[torch.optim.Optimizer]]] = {
    "adamw": torch.optim.AdamW,
    "adam": torch.optim.Adam,
    "sgd": torch.optim.SGD,
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class EpochsConfig(Settings):
    """Settings of every training in epochs."""

    device: str = setting(
        "auto", "Device to train on; auto uses a GPU if there is one", choices=("auto", "cpu", "cuda")
    )
    precision: str = setting(
        "float32",
        "Precision of the search for the points that win the maximum. With bfloat16 a nearly equal point may win; weights, "
        "values and gradients stay float32",
        choices=("float32", "bfloat16"),
    )
    epochs: int = setting(
        100, "Passes over the training samples, with srgan over the labelled ones", bounds=(1, 100_000)
    )
    batch_size: int = setting(32, "Samples per step, with srgan of each source", bounds=(2, 4096))
    optimiser: str = setting("adamw", "Optimiser", choices=tuple(_OPTIMISERS))
    learning_rate: float = setting(1e-3, "Largest learning rate", bounds=(1e-7, 10.0))
    weight_decay: float = setting(1e-2, "Weight decay", bounds=(0.0, 10.0))
    schedule: str = setting("cosine", "Schedule of the learning rate", choices=("cosine", "constant"))
    target_scaling: str = setting(
        "standardised",
        "Scaling of the labels by their mean and deviation, or by the ranges as in the papers",
        choices=("standardised", "ranges"),
    )
    points: int | None = setting(
        None, "Points per cloud in training, drawn again each time; by default as in prediction", minimum=8
    )
    seed: int = setting(0, "Seed of weights, order, points and noise", minimum=0)
    partial_batches = False  # a setting of supervised training

    @property
    def resolved_device(self) -> str:
        """`cpu` or `cuda`; a `ConfigError` if a GPU is configured and absent."""
        has_cuda = torch.cuda.is_available()
        if self.device == "cuda" and not has_cuda:
            raise ConfigError("device: cuda: torch finds no GPU; choose auto or cpu")
        return "cuda" if has_cuda and self.device != "cpu" else "cpu"


def other_default(name: str, default: Any) -> Any:
    """Return a setting of `EpochsConfig` with another default, for a subclass."""
    return dataclasses.field(default=default, metadata=EpochsConfig.__dataclass_fields__[name].metadata)


_TORCH_RNG = "torch_rng"
_CUDA_RNG = "cuda_rng"


class Trainer(ABC):
    """Trains a network epoch by epoch.

    Weights, order, points and dropout depend only on the seed: torch's global generator is used within an
    epoch, and restored afterwards.

    Args:
        data: All samples, prepared for the network's configuration.
        index: (T,) labelled samples to train on.
        config: Settings.

    Attributes:
        net: The network on the training device, in the mode that the last epoch left.
        epoch: Number of completed epochs.
        rng: Generator of order and points.
        sizes: Number of values of each predicted modality.
        batch_count: Steps of an epoch.
        modules, optimisers: All trained networks and their optimisers by name; `net` is one of them.

    Raises:
        DatasetError: If there are fewer samples than one batch.
    """

    def __init__(self, data: TrainingSet, index: Indices, config: EpochsConfig) -> None:
        self._require_batch(index, config.batch_size)
        self.config = config
        self.data = data
        self._labelled = index
        self.device = torch.device(config.resolved_device)
        self.epoch = 0
        self._randomness: dict[str, Tensor] = {}
        self.rng = np.random.default_rng(config.seed)
        whole, rest = divmod(len(index), config.batch_size)
        self.batch_count = whole + (1 if rest > 1 and config.partial_batches else 0)
        with self._own_randomness():
            torch.manual_seed(config.seed)
            self.net = TouchNet(data.config)
            extra = self._make_modules()
        self.modules: dict[str, nn.Module] = {"net": self.net, **extra}
        outputs = BIOTAC.columns(data.config.outputs)
        _set_target_scaling(self.net, data.labels[np.ix_(index, outputs)], config.target_scaling)
        for module in self.modules.values():
            module.to(self.device)
            _set_precision(module, config.precision)
        # One kernel for all weights: the time of a small network's step is its number of calls.
        options: dict[str, Any] = {"lr": config.learning_rate, "weight_decay": config.weight_decay, "fused": True}
        self.optimisers, self._schedules = {}, {}
        for name, module in self.modules.items():
            optimiser = self.optimisers[name] = _OPTIMISERS[config.optimiser](list(module.parameters()), **options)
            self._schedules[name] = (
                CosineAnnealingLR(optimiser, T_max=config.epochs * self.batch_count)
                if config.schedule == "cosine"
                else ConstantLR(optimiser, factor=1.0)
            )
        self.sizes = [len(BIOTAC.columns([name])) for name in data.config.outputs]
        self._labels = torch.from_numpy(data.labels[:, outputs].astype(np.float32))
        self._grasp_inputs = torch.from_numpy(data.grasps)

    @staticmethod
    def _require_batch(index: Indices, size: int, kind: str = "") -> None:
        if len(index) < size:
            raise DatasetError(f"training: {len(index)} {kind}samples are fewer than one batch of {size}")

    def run_epoch(self) -> dict[str, float]:
        """Make one pass over the training samples.

        Gives the mean of each loss over the batches.

        Raises:
            DatasetError: If a loss or a weight becomes infinite or NaN; names it and the epoch.
        """
        with self._own_randomness():
            batches = list(self._epoch())
        means = {name: float(np.mean([batch[name] for batch in batches])) for name in batches[0]}
        weights = {
            f"{name}.{key}": v for name, module in self.modules.items() for key, v in module.state_dict().items()
        }
        bad = [name for name, mean in means.items() if not np.isfinite(mean)]
        bad += [name for name, value in weights.items() if not bool(torch.isfinite(value).all())]
        if bad:
            raise DatasetError(f"training: {bad[0]}: is not finite in epoch {self.epoch}; lower learning_rate")
        self.epoch += 1
        return means

    def train(self, done: Callable[[dict[str, float]], None] = lambda _: None) -> TouchNet:
        """Run the epochs that are left; `done` is called with the losses of each. Returns the network for prediction."""
        while self.epoch < self.config.epochs:
            done(self.run_epoch())
        return self.net.cpu().eval()

    def step(self, name: str, loss: Tensor) -> None:
        """Differentiate a scalar loss, and take one step of the network of this name."""
        optimiser = self.optimisers[name]
        optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        self._schedules[name].step()

    def snapshot(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Return copies of all tensors by name and the rest as plain data: all that `restore` requires."""
        tensors = dict(self._randomness)
        plain: dict[str, Any] = {"epoch": self.epoch, "rng": self.rng.bit_generator.state, "steppers": {}}
        for name, module in self.modules.items():
            tensors |= _prefixed(name, module.state_dict())
        for name, optimiser in self.optimisers.items():
            state = optimiser.state_dict()
            plain["steppers"][name] = {"groups": state["param_groups"], "schedule": self._schedules[name].state_dict()}
            for number, values in state["state"].items():  # where SGD has no momentum, it keeps None
                moments = {f"{number}.{key}": value for key, value in values.items() if isinstance(value, Tensor)}
                tensors |= _prefixed(f"{name}-steps", moments)
        # To the CPU, so that a run may be resumed on another device; with `copy`, also from a CPU.
        return {name: value.detach().to("cpu", copy=True).contiguous() for name, value in tensors.items()}, plain

    def restore(self, tensors: Mapping[str, Tensor], plain: Mapping[str, Any]) -> None:
        """Continue from a snapshot, bit for bit.

        Raises:
            ModelError: If it is of another architecture or damaged.
        """
        try:
            for name, module in self.modules.items():
                module.load_state_dict(under(f"{name}/", tensors))
            for name, optimiser in self.optimisers.items():
                state: dict[int, dict[str, Tensor]] = {}
                for key, value in under(f"{name}-steps/", tensors).items():
                    number, moment = key.split(".", 1)
                    state.setdefault(int(number), {})[moment] = value
                stepper = plain["steppers"][name]
                optimiser.load_state_dict({"state": state, "param_groups": stepper["groups"]})
                self._schedules[name].load_state_dict(dict(stepper["schedule"]))
            self._randomness = {name: tensors[name] for name in (_TORCH_RNG, _CUDA_RNG) if name in tensors}
            self.rng.bit_generator.state = plain["rng"]
            self.epoch = int(plain["epoch"])
        except (RuntimeError, KeyError, TypeError, ValueError) as err:
            raise ModelError(f"is damaged or of another training: {' '.join(str(err).split())[:200]}") from err

    @abstractmethod
    def _epoch(self) -> Iterator[Mapping[str, float]]:
        """Train on each batch of an epoch; yields its losses."""

    def _make_modules(self) -> dict[str, nn.Module]:
        """Return further networks, initialised after the first from the same seed."""
        return {}

    @contextmanager
    def _own_randomness(self) -> Iterator[None]:
        """Let torch's generators continue from this trainer's state within the block; outside, they are unchanged."""
        cuda = self.device if self.device.type == "cuda" else None
        with torch.random.fork_rng(devices=[] if cuda is None else [cuda]):
            if self._randomness:
                torch.set_rng_state(self._randomness[_TORCH_RNG])
            if cuda is not None and _CUDA_RNG in self._randomness:
                torch.cuda.set_rng_state(self._randomness[_CUDA_RNG], cuda)
            yield
            self._randomness = {_TORCH_RNG: torch.get_rng_state()}
            if cuda is not None:
                self._randomness[_CUDA_RNG] = torch.cuda.get_rng_state(cuda)

    def _inputs(self, batch: Indices) -> Inputs:
        """Return (B, N, C) points of a batch, drawn again each time, and its (B, G) grasps where the network takes them."""
        points = torch.from_numpy(self.data.points(batch, self.rng, self.config.points)).to(self.device)
        return points, self._grasp_inputs[batch].to(self.device) if self.data.config.use_grasp else None

    def _targets(self, batch: Indices) -> Tensor:
        """Return (B, M) scaled labels."""
        return self.net.to_scaled(self._labels[batch].to(self.device))


def _set_precision(module: nn.Module, precision: str) -> None:
    """Set the precision of a network's searches for winning points; its weights do not change."""
    for part in module.modules():
        if isinstance(part, PointNetFeatures | InputTransform):
            part.precision = torch.bfloat16 if precision == "bfloat16" else torch.float32


def shuffled_batches(
    index: Indices, size: int, rng: np.random.Generator, *, partial: bool = False
) -> Iterator[Indices]:
    """Iterate over batches of shuffled samples.

    A remainder of a single sample is always left out, since batch norm has no statistics of it.

    Args:
        index: (S,) the samples.
        size: Samples of a batch.
        rng: Shuffles them.
        partial: Whether the remainder is a last batch; else it is left out of this epoch.
    """
    shuffled = rng.permutation(index)
    for start in range(0, len(shuffled), size):
        batch = shuffled[start : start + size]
        if len(batch) == size or (partial and len(batch) > 1):
            yield batch


def _prefixed(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {f"{prefix}/{name}": value for name, value in tensors.items()}


def _set_target_scaling(net: TouchNet, labels: Float64, kind: str) -> None:
    """Set the affine map of the targets from (T, M) training labels [counts]."""
    outputs = BIOTAC.columns(net.config.outputs)
    if kind == "ranges":
        low, high = net.config.ranges.ranges.low[outputs], net.config.ranges.ranges.high[outputs]
        mean, scale = low, high - low
    else:
        mean, scale = labels.mean(axis=0), np.maximum(labels.std(axis=0), _LEAST_DEVIATION)
    net.set_scaling(torch.from_numpy(mean).float(), torch.from_numpy(scale).float())
