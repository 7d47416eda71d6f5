# SPDX-License-Identifier: Apache-2.0
"""Augmentation: turn an object and the hand together about the camera's viewing axis.

Seen from above, that axis stands on the table, so gravity and contact stay the same and so does the touch.
It does not hold for a camera that looks from the side.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from foretouch.models.settings import GRASP_SIZE, ModelConfig
from foretouch.types import Float64

__all__ = ["turn", "viewing_axis_rotations"]


def viewing_axis_rotations(count: int, largest_deg: float, rng: np.random.Generator) -> Float64:
    """(B, 3, 3) rotations about z by angles uniform in +-`largest_deg`."""
    angles = np.radians(rng.uniform(-largest_deg, largest_deg, count))
    rotations = np.tile(np.eye(3), (count, 1, 1))
    rotations[:, 0, 0] = rotations[:, 1, 1] = np.cos(angles)
    rotations[:, 1, 0] = np.sin(angles)
    rotations[:, 0, 1] = -rotations[:, 1, 0]
    return rotations


def turn(points: Tensor, grasp: Tensor, rotations: Tensor, config: ModelConfig) -> tuple[Tensor, Tensor]:
    """Turn clouds and grasps; colours and metric inputs stay.

    Args:
        points: (B, N, C), as fed to the network.
        grasp: (B, G), as fed to the head; G may be 0.
        rotations: (B, 3, 3).
        config: Tells what the channels are.

    Returns:
        New (B, N, C) and (B, G).
    """
    back = rotations.transpose(1, 2)
    parts = [points[..., :3] @ back, points[..., 3:]]
    if config.channels == "xyz+normals":
        parts[1] = parts[1] @ back
    if grasp.shape[1] == 0:
        return torch.cat(parts, dim=-1), grasp
    contacts = grasp[:, :6].reshape(-1, 2, 3) @ back
    hand = rotations @ grasp[:, 6:GRASP_SIZE].reshape(-1, 3, 3)
    turned = [contacts.flatten(1), hand.flatten(1), grasp[:, GRASP_SIZE:]]
    return torch.cat(parts, dim=-1), torch.cat(turned, dim=1)
