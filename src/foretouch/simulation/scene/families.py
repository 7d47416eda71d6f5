# SPDX-License-Identifier: Apache-2.0
"""Many objects from one line: how a scene file asks for K objects whose shape, size and stiffness are drawn.

A family is shorthand. It is drawn when the scene is read, so the scene itself holds each object in full, its hash
covers them all, and an object keeps what it drew however many grasps it gets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.simulation.objects import SHAPES
from foretouch.simulation.scene.ranges import draw, require_range
from foretouch.simulation.scene.things import RESTS, ObjectConfig, PoseConfig

__all__ = ["FamiliesConfig", "FamilyConfig", "draw_objects"]


@dataclass(frozen=True, kw_only=True)
class FamilyConfig(Settings):
    """Objects of one kind. Each draws its own values once, whatever the seed of the scene."""

    name: str = setting("obj", "Labels of the samples are this name and a number: obj_000, obj_001...")
    count: int = setting(10, "How many objects", minimum=1, maximum=10_000)
    seed: int = setting(0, "Decides what the objects draw", minimum=0, maximum=2**53)
    shapes: tuple[str, ...] = setting(
        ("random",), "Shapes to draw from; each object of the shape random is a member of its own", choices=SHAPES
    )
    rests: tuple[str, ...] = setting(("upright",), "What they rest on, to draw from", choices=RESTS)
    size_m: tuple[float, ...] = setting(
        (0.05, 0.1), "Each edge of the bounding box, low and high", unit="m", minimum=0.005, maximum=0.5
    )
    young_pa: tuple[float, ...] | None = setting(
        None,
        "Young's modulus, low and high, uniform in its logarithm; absent for rigid objects",
        unit="Pa",
        minimum=1e3,
        maximum=1e9,
    )
    thickness_m: tuple[float, ...] = setting(
        (0.01, 0.03), "Thickness of the soft layer, low and high", unit="m", minimum=1e-4, maximum=0.5
    )
    pose: PoseConfig = PoseConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("size_m", "thickness_m"):
            require_range(self, name)
        if self.young_pa is not None:
            require_range(self, "young_pa")
        for name in ("shapes", "rests"):
            if not getattr(self, name):
                raise ConfigError(f"FamilyConfig.{name}: there is none")


@dataclass(frozen=True, kw_only=True)
class FamiliesConfig(Settings):
    """The key `families` of a scene file."""

    families: tuple[FamilyConfig, ...] = ()

    def objects(self) -> list[ObjectConfig]:
        """All objects of all families, in order."""
        return [item for family in self.families for item in draw_objects(family)]


def draw_objects(family: FamilyConfig) -> list[ObjectConfig]:
    """The members of a family; the first k are the same whatever its count."""
    return [_member(family, k) for k in range(family.count)]


def _member(family: FamilyConfig, number: int) -> ObjectConfig:
    rng = np.random.default_rng([family.seed, number])
    shape = family.shapes[int(rng.integers(len(family.shapes)))]
    size = tuple(round(draw(rng, family.size_m), 4) for _ in range(3))
    rest = family.rests[int(rng.integers(len(family.rests)))]
    young_pa, thickness_m = _softness(family, rng)
    return ObjectConfig(
        name=f"{family.name}_{number:03d}",
        shape=shape,
        first_variant=number if shape == "random" else 0,
        size_m=size,
        pose=family.pose.replace(rest=rest),
        young_pa=young_pa,
        thickness_m=thickness_m,
    )


def _softness(family: FamilyConfig, rng: np.random.Generator) -> tuple[float | None, float | None]:
    """Modulus and thickness of one object; neither where the family is rigid."""
    if family.young_pa is None:
        return None, None
    low, high = np.log(family.young_pa)
    return float(np.exp(rng.uniform(low, high)).round(-1)), round(draw(rng, family.thickness_m), 4)
