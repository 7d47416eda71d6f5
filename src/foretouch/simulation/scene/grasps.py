# SPDX-License-Identifier: Apache-2.0
"""How a scene is grasped: where by GeoGrasp, how hard or how deep by the hand."""

from __future__ import annotations

from dataclasses import dataclass

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.grasp import GeoGraspConfig
from foretouch.simulation.scene.ranges import require_range

__all__ = ["ExecutionErrorConfig", "GraspsConfig", "TargetConfig"]


@dataclass(frozen=True, kw_only=True)
class TargetConfig(Settings):
    """What a finger's controller aims at, drawn uniformly; `control` decides which of the two counts."""

    force_n: tuple[float, ...] = setting((1.0, 3.0), "Normal force, low and high", unit="N")
    depth_m: tuple[float, ...] = setting((0.0005, 0.0015), "Closing beyond first touch, low and high", unit="m")

    def __post_init__(self) -> None:
        super().__post_init__()
        require_range(self, "force_n", lowest=0.0)
        require_range(self, "depth_m", lowest=0.0)


@dataclass(frozen=True, kw_only=True)
class ExecutionErrorConfig(Settings):
    """The hand does not go exactly where it is sent, nor press exactly as hard."""

    position_m: float = setting(0.001, "Standard deviation along each tangent", unit="m", minimum=0.0, maximum=0.05)
    angle_deg: float = setting(1.0, "Standard deviation about each axis", unit="deg", minimum=0.0, maximum=30.0)
    target_share: float = setting(
        0.1,
        "Standard deviation of the force or depth that is reached, relative to its target",
        minimum=0.0,
        maximum=0.3,
    )


@dataclass(frozen=True, kw_only=True)
class GraspsConfig(Settings):
    """Where and how the hand grasps."""

    geograsp: GeoGraspConfig = GeoGraspConfig()
    slide: bool = setting(False, "Whether the grasp plane is slid at random along the object's axis (P2)")
    initial_points: bool = setting(
        False, "Whether the initial points are grasped, as in the data of P1, in place of the best ranked pair"
    )
    insertion_m: float = setting(
        0.0, "How far below the planned points the fingers close, along the table's normal", unit="m", minimum=0.0
    )
    max_width_m: float = setting(0.13, "Widest opening of the hand", unit="m", minimum=0.001, maximum=0.5)
    control: str = setting("force", "What the hand controls", choices=("force", "depth"))
    thumb: TargetConfig = TargetConfig()
    middle: TargetConfig | None = None
    balanced: bool = setting(
        True, "Whether the object is free to move between the fingers, so that their forces balance"
    )
    error: ExecutionErrorConfig | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.balanced and self.control == "force" and self.middle is not None:
            raise ConfigError(
                "GraspsConfig.middle: a target of its own, but balanced fingers share one force; leave it out or "
                "set balanced: false"
            )
