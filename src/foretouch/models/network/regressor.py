# SPDX-License-Identifier: Apache-2.0
"""The network that predicts touch: PointNet features and a head.

    cloud ─ PointNet ─► X (1024) ─┐
    g1, g2, R (15) ───────────────┴─► 1039 ─► 1024 ─► 512 ─► 256 ─► 1, 24 or 50

P2: with grasp, one modality. P1: 500 points, no grasp. Shared: with grasp, all modalities from one trunk.

Shapes: B clouds, N points, C channels, G grasp numbers, M outputs.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foretouch.models.network.config import ModelConfig
from foretouch.models.network.pointnet import PointNetFeatures, make_layers

__all__ = ["TouchNet"]


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

    def forward(self, points: Tensor, grasp: Tensor | None = None) -> Tensor:
        """Scaled predictions.

        Args:
            points: (B, N, C) float32, in the unit sphere.
            grasp: (B, G) float32, in the frame of the points; None without grasp inputs.

        Returns:
            (B, M) float32, scaled.
        """
        return self.regress(self.features(points), grasp)

    def regress(self, features: Tensor, grasp: Tensor | None = None) -> Tensor:
        """The head alone: (B, F) features and (B, G) grasps to (B, M) scaled predictions."""
        x = features if grasp is None else torch.cat([features, grasp], dim=-1)
        scaled: Tensor = self.output(self.dropout(self.head(x)))
        return scaled

    def counts(self, points: Tensor, grasp: Tensor | None = None) -> Tensor:
        """(B, M) predictions [counts]; arguments as in `forward`."""
        return self.to_counts(self(points, grasp))

    def to_counts(self, scaled: Tensor) -> Tensor:
        """Scaled (B, M) to counts."""
        return scaled * self.target_scale + self.target_mean

    def to_scaled(self, counts: Tensor) -> Tensor:
        """Counts (B, M) to scaled, the targets of training."""
        return (counts - self.target_mean) / self.target_scale

    def set_scaling(self, mean: Tensor, scale: Tensor) -> None:
        """Set the affine map of the targets, both (M,) [counts]."""
        self.target_mean.copy_(mean)
        self.target_scale.copy_(scale)
