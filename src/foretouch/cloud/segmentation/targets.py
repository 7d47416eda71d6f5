# SPDX-License-Identifier: Apache-2.0
"""Which of the objects on the table is meant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from foretouch.cloud.segmentation.objects import ObjectSegment
from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.types import Float64

__all__ = ["TargetConfig", "TargetMode", "choose_targets"]

TargetMode = Literal["nearest", "largest", "point", "all"]


@dataclass(frozen=True, kw_only=True)
class TargetConfig(Settings):
    """Which objects get grasps."""

    mode: TargetMode = setting(
        "nearest",
        "nearest to the camera, largest in points, the one at a point, or all",
        choices=get_args(TargetMode),
    )
    point: tuple[float, ...] = setting((), "x, y, z that mode point asks for, in the cloud's frame", unit="m")
    tolerance_m: float = setting(
        0.03, "How far from the point the object's nearest point may lie", minimum=0.0, maximum=1.0, unit="m"
    )
    margin_m: float = setting(
        0.005, "Two objects this close to being chosen are ambiguous", minimum=0.0, maximum=1.0, unit="m"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.point) not in (0, 3):
            raise ConfigError(f"TargetConfig.point: {len(self.point)} numbers are not x, y, z")
        if self.mode == "point" and not self.point:
            raise ConfigError("TargetConfig.point: is empty, mode point needs x, y, z")


def choose_targets(objects: Sequence[ObjectSegment], config: TargetConfig) -> tuple[list[ObjectSegment], str]:
    """The objects that are meant.

    Args:
        objects: In order of id.
        config: The rule.

    Returns:
        The chosen objects and "", or none and the reason: there is no object, the point hits none, or two are
        within `margin_m` (mode `largest`: within 5 % of the points) of each other, so that noise would decide.
    """
    if not objects:
        return [], "there is no object"
    if config.mode == "all":
        return list(objects), ""
    if config.mode == "largest":
        return _largest(objects)
    if config.mode == "nearest":
        distances = [obj.distance_m for obj in objects]
        return _least(objects, distances, config.margin_m, "the camera")
    point = np.asarray(config.point)
    distances = [_distance_to(obj, point) for obj in objects]
    at = f"({', '.join(f'{p:g}' for p in config.point)})"
    nearest = min(distances)
    if nearest > config.tolerance_m:
        return [], f"no object within {config.tolerance_m:g} m of the point {at}: the nearest is {nearest:.3f} m away"
    return _least(objects, distances, config.margin_m, f"the point {at}")


def _least(
    objects: Sequence[ObjectSegment], distances: Sequence[float], margin: float, where: str
) -> tuple[list[ObjectSegment], str]:
    order = sorted(range(len(objects)), key=lambda i: distances[i])
    if len(order) > 1 and distances[order[1]] - distances[order[0]] < margin:
        a, b = sorted(order[:2])
        pair = f"objects {objects[a].id} and {objects[b].id}"
        return [], f"{pair} are equally near to {where}, {distances[a]:.3f} and {distances[b]:.3f} m"
    return [objects[order[0]]], ""


def _largest(objects: Sequence[ObjectSegment]) -> tuple[list[ObjectSegment], str]:
    first, *rest = sorted(objects, key=lambda obj: -obj.n_points)
    if rest and rest[0].n_points > 0.95 * first.n_points:
        return [], (
            f"objects {first.id} and {rest[0].id} are equally large, {first.n_points} and {rest[0].n_points} points"
        )
    return [first], ""


def _distance_to(obj: ObjectSegment, point: Float64) -> float:
    return float(np.sqrt(((obj.cloud.xyz.astype(np.float64) - point) ** 2).sum(axis=1).min()))
