# SPDX-License-Identifier: Apache-2.0
"""P2's generator: noise to a fake cloud, in the unit sphere's box.

    noise 6 x 6 ─ transposed convolution, kernel 5, stride 5, three times ─► 30 ─► 150 ─► 750 ─ tanh ─► 750 x 6

Kernel and stride are equal, so windows do not overlap: each column of the noise becomes 125 separate points.

P2 does not specify the channels between the layers (here 6, as at both ends) and the activation between them
(here ReLU; without one the three layers would be one linear map).

Shapes: B clouds, L length of the noise, N points, C channels of the noise and of the cloud.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import torch
from torch import Tensor, nn

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.models.network.config import ModelConfig

__all__ = ["CloudGenerator", "GeneratorConfig", "draw_noise"]

_NAMES: Final = {
    "xyz": ("x", "y", "z"),
    "xyz+rgb": ("x", "y", "z", "r", "g", "b"),
    "xyz+normals": ("x", "y", "z", "nx", "ny", "nz"),
}


@dataclass(frozen=True, kw_only=True)
class GeneratorConfig(Settings):
    """Architecture of a generator; the defaults are P2's.

    Raises:
        ConfigError: If a setting is out of its bounds.
    """

    noise_length: int = setting(6, "Columns of the noise", minimum=1, maximum=4096)
    noise_channels: int = setting(6, "Values of each column of the noise", minimum=1, maximum=4096)
    widths: tuple[int, ...] = setting(
        (6, 6), "Channels between the layers, one layer more than these; not in P2", minimum=1, maximum=8192
    )
    stride: int = setting(5, "Kernel and stride of every layer: points made from one", minimum=1, maximum=64)
    channels: int = setting(6, "Channels of the fake cloud", minimum=3, maximum=6)

    @property
    def n_points(self) -> int:
        """Points of the fake cloud: 6 · 5³ = 750 in P2."""
        return int(self.noise_length * self.stride ** (len(self.widths) + 1))


class CloudGenerator(nn.Module):
    """Noise to fake clouds.

    The fake cloud has six channels in P2, whatever the inputs of the network. A network of three channels uses the first
    three; `unused_channels` names the others, which receive no gradient.

    Args:
        config: Its architecture.
        model: Of the network that uses the clouds.

    Attributes:
        channel_names: Meaning of each channel of the fake cloud, in order.
        unused_channels: Those that the network does not use.

    Raises:
        ConfigError: If the network needs more channels than the generator makes.
    """

    def __init__(self, config: GeneratorConfig, model: ModelConfig) -> None:
        super().__init__()
        if config.channels < model.channel_count:
            raise ConfigError(
                f"GeneratorConfig.channels: {config.channels} are fewer than the {model.channel_count} of {model.channels}"
            )
        self.config = config
        used = _NAMES[model.channels]
        self.unused_channels = tuple(f"unused_{k}" for k in range(len(used), config.channels))
        self.channel_names = used + self.unused_channels
        self._used = len(used)
        widths = [config.noise_channels, *config.widths, config.channels]
        layers = [nn.ConvTranspose1d(a, b, config.stride, config.stride) for a, b in pairwise(widths)]
        self.layers = nn.ModuleList(layers)

    def forward(self, noise: Tensor) -> Tensor:
        """All channels of the fake clouds.

        Args:
            noise: (B, C, L) float32 in [0, 1), of `draw_noise`.

        Returns:
            (B, N, channels) float32 in [-1, 1], points in rows. Points may lie outside the unit sphere, in
            the corners of its box, and "normals" have any length: P2 excludes neither.
        """
        x = noise
        for k, layer in enumerate(self.layers):
            x = layer(torch.relu(x) if k else x)
        return torch.tanh(x).transpose(1, 2)

    def clouds(self, noise: Tensor) -> Tensor:
        """(B, N, C) fake clouds as inputs of the network: without the unused channels."""
        fake: Tensor = self(noise)
        return fake[..., : self._used].contiguous()


def draw_noise(count: int, config: GeneratorConfig, rng: torch.Generator) -> Tensor:
    """(count, C, L) float32, uniform in [0, 1) as in P2."""
    return torch.rand(count, config.noise_channels, config.noise_length, generator=rng)
