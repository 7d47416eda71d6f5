# SPDX-License-Identifier: Apache-2.0
"""The network that predicts touch (PointNet features and a head), and P2's generator of clouds.

    cloud ─ PointNet ─► X (1024) ─┐
    g1, g2, R (15) ───────────────┴─► 1039 ─► 1024 ─► 512 ─► 256 ─► 1, 24 or 50

P2: with grasp, one modality. P1: 500 points, no grasp. Shared: with grasp, all modalities from one trunk.

Shapes: B clouds, N points, C channels, G grasp numbers, M outputs.

The generator turns noise into a fake cloud in the unit sphere's box:

    noise 6 x 6 ─ transposed convolution, kernel 5, stride 5, three times ─► 30 ─► 150 ─► 750 ─ tanh ─► 750 x 6

Kernel and stride are equal, so windows do not overlap: each column of the noise becomes 125 separate points.

P2 does not specify the channels between the layers (here 6, as at both ends) and the activation between them
(here ReLU; without one the three layers would be one linear map).

Shapes: B clouds, L length of the noise, N points, C channels that the network uses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Self

import torch
from torch import Tensor, nn

from foretouch.config import Settings, setting
from foretouch.models.card import NETWORKS, CardCalibration, save_model
from foretouch.models.network.checkpoint import network_key
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.folding import FoldedNetwork, fold
from foretouch.models.novelty import Fallback
from foretouch.types import AnyArray
from foretouch_lab.learning.network.pointnet import PointNetFeatures, make_layers


class TouchNet(nn.Module):
    """Cloud and grasp to scaled tactile values; `counts` undoes the scaling.

    The scaling is an affine map per output, stored with the weights: value = scaled * target_scale +
    target_mean [counts]. Training sets it, either to the ranges of the papers or to mean and deviation
    of its labels.

    Args:
        config: Its architecture.
    """

    target_mean: Tensor
    target_scale: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.features = PointNetFeatures(config)
        self.head = make_layers([config.head_size, *config.head_widths], norm=config.head_norm)
        self.dropout = nn.Dropout(config.head_dropout)
        self.output = nn.Linear([config.head_size, *config.head_widths][-1], config.output_size)
        self.register_buffer("target_mean", torch.zeros(config.output_size))
        self.register_buffer("target_scale", torch.ones(config.output_size))

    @classmethod
    def of(cls, config: ModelConfig, tensors: Mapping[str, AnyArray]) -> Self:
        """Return the network of a checkpoint, in evaluation mode."""
        with torch.device("meta"):  # no random numbers are drawn for weights that are replaced at once
            net = cls(config)
        net.load_state_dict({name: torch.from_numpy(value) for name, value in tensors.items()}, assign=True)
        return net.eval()

    def folded(self) -> FoldedNetwork:
        """Return the network for prediction, as of now; see `foretouch.models.network.folding.fold`."""
        return fold(self.config, _arrays(self))

    def forward(self, points: Tensor, grasp: Tensor | None = None) -> Tensor:
        """Return (B, M) float32, scaled, from (B, N, C) points in the unit sphere and (B, G) grasps in their frame, if any."""
        return self.regress(self.features(points), grasp)

    def regress(self, features: Tensor, grasp: Tensor | None = None) -> Tensor:
        """Apply the head alone: (B, F) features and (B, G) grasps to (B, M) scaled predictions.

        Args:
            features: (B, F) of the clouds.
            grasp: (B, G) as fed to the head, if any.
        """
        x = features if grasp is None else torch.cat([features, grasp], dim=-1)
        scaled: Tensor = self.output(self.dropout(self.head(x)))
        return scaled

    def counts(self, points: Tensor, grasp: Tensor | None = None) -> Tensor:
        """Return (B, M) predictions [counts]; arguments as in `forward`."""
        counts: Tensor = self(points, grasp) * self.target_scale + self.target_mean
        return counts

    def to_scaled(self, counts: Tensor) -> Tensor:
        """Map (B, M) counts to scaled, the targets of training."""
        return (counts - self.target_mean) / self.target_scale

    def set_scaling(self, mean: Tensor, scale: Tensor) -> None:
        """Set the affine map of the targets, both (M,) [counts]."""
        self.target_mean.copy_(mean)
        self.target_scale.copy_(scale)


def save_network(
    folder: str | Path,
    name: str,
    net: TouchNet,
    facts: Mapping[str, Any],
    calibration: CardCalibration | None = None,
    fallback: Fallback | None = None,
) -> Path:
    """Write a network and return the path of its card.

    Args:
        folder: Folder of its files.
        name: Name of the model.
        net: The network.
        facts: Further fields of the card.
        calibration: Calibration to store with it, if any.
        fallback: What is predicted for clouds that are not like the training, if anything.
    """
    facts = {"familiar": None, "config": net.config.to_mapping(), **facts}
    return save_model(Path(folder) / f"{name}.json", "network", _arrays(net), facts, calibration, fallback)


def save_networks(
    folder: str | Path,
    name: str,
    nets: Sequence[TouchNet],
    facts: Mapping[str, Any],
    calibration: CardCalibration | None = None,
    fallback: Fallback | None = None,
) -> Path:
    """Write networks for different modalities as one model, and return the path of its card; arguments as of `save_network`."""
    keys = [network_key(net.config) for net in nets]
    tensors = {
        f"{key}/{part}": value for key, net in zip(keys, nets, strict=True) for part, value in _arrays(net).items()
    }
    config = {key: net.config.to_mapping() for key, net in zip(keys, nets, strict=True)}
    lengths = {"familiar": dict.fromkeys(keys, facts.get("familiar"))}
    return save_model(
        Path(folder) / f"{name}.json", NETWORKS, tensors, {"config": config, **facts, **lengths}, calibration, fallback
    )


def _arrays(net: TouchNet) -> dict[str, AnyArray]:
    return {key: value.detach().cpu().numpy() for key, value in net.state_dict().items()}


_CHANNELS: Final = 6


@dataclass(frozen=True, kw_only=True)
class GeneratorConfig(Settings):
    """Layers of a generator and the size of its clouds; the defaults are P2's."""

    noise_length: int = setting(6, "Columns of the noise", bounds=(1, 4096))
    widths: tuple[int, ...] = setting(
        (6, 6), "Channels between the layers, one layer more than these; not in P2", bounds=(1, 8192)
    )
    stride: int = setting(5, "Kernel and stride of every layer: points made from one", bounds=(1, 64))

    @property
    def n_points(self) -> int:
        """Points of the fake cloud: 6 · 5³ = 750 in P2."""
        return int(self.noise_length * self.stride ** (len(self.widths) + 1))


class CloudGenerator(nn.Module):
    """Noise to fake clouds of six channels, whatever the inputs of the network; one of three channels uses the first three.

    Args:
        config: Its size.
        model: Of the network that uses the clouds.
    """

    def __init__(self, config: GeneratorConfig, model: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self._used = model.channel_count
        widths = [_CHANNELS, *config.widths, _CHANNELS]
        self.layers = nn.ModuleList(nn.ConvTranspose1d(a, b, config.stride, config.stride) for a, b in pairwise(widths))

    def forward(self, noise: Tensor) -> Tensor:
        """Map (B, 6, L) noise to (B, N, 6) fake clouds in [-1, 1].

        Points may lie outside the unit sphere, in the corners of its box, and "normals" have any length: P2 excludes
        neither.
        """
        x = noise
        for k, layer in enumerate(self.layers):
            x = layer(torch.relu(x) if k else x)
        return torch.tanh(x).transpose(1, 2)

    def clouds(self, noise: Tensor) -> Tensor:
        """Return (B, N, C) fake clouds as inputs of the network: without the channels that it does not use."""
        fake: Tensor = self(noise)
        return fake[..., : self._used].contiguous()


def draw_noise(count: int, config: GeneratorConfig, rng: torch.Generator) -> Tensor:
    """Return (count, 6, L) float32, uniform in [0, 1) as in P2."""
    return torch.rand(count, _CHANNELS, config.noise_length, generator=rng)
