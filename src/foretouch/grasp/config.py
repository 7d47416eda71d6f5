# SPDX-License-Identifier: Apache-2.0
"""Settings of the grasp planner, and what the hand can execute."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.grasp.hand import Hand, load_hand

GraspMethod = Literal["completed", "original"]
SEARCH_VOXELS = 4.0  # radius around an initial point in which contacts are searched: two fingertips
_METHOD = "completed: through the middle of the object, whose unseen side is estimated; original: equal to the published GeoGrasp"

_FLYING = (
    "Flying points, alone before or behind their neighbours, are dropped if they are at least this share of an object; "
    "0.012 of a recorded cloud look like that at most; 1 disables it"
)


@dataclass(frozen=True, kw_only=True)
class GeoGraspConfig(Settings):
    """Settings of the grasp planner (GeoGrasp: Zapata-Impata et al. 2019)."""

    tip_mm: float = setting(25.0, "Size of the gripper's fingertip, which `original` uses", bounds=(1.0, 200.0))
    count: int = setting(1, "Maximum number of grasps, best first", bounds=(1, 10_000))
    max_points: int = setting(
        8000,
        "Larger clouds are downsampled to every second, third, ... row and column of the image; 0 disables it",
        bounds=(0, 10_000_000),
    )
    flying_share: float = setting(0.015, _FLYING, bounds=(0.0, 1.0))
    neighbours: int = setting(50, "Nearest neighbours averaged by the outlier filter", bounds=(1, 1000))
    outlier_deviations: float = setting(
        1.0, "Standard deviations above the mean that the outlier filter keeps", bounds=(0.0, 100.0)
    )
    normal_radius_m: float = setting(0.03, "Radius of the neighbourhood for normal estimation", bounds=(0.001, 1.0))
    slab_half_width_m: float = setting(
        0.007, "Points closer than this to the grasp plane may be contacts", bounds=(0.0005, 0.5)
    )
    slide_fraction: float = setting(
        0.8, "Fraction of the object's extent along its axis from which a random slide is drawn", bounds=(0.0, 1.0)
    )
    method: GraspMethod = setting("completed", _METHOD, choices=get_args(GraspMethod))

    def __post_init__(self) -> None:
        if str(self.method) == "stable":
            raise ConfigError("method: 'stable' was replaced by 'completed', which is the default")
        super().__post_init__()

    @property
    def voxel_m(self) -> float:
        """Edge of the voxel grid [m]: half a fingertip."""
        return self.tip_mm / 2000.0


@dataclass(frozen=True, kw_only=True)
class SceneGeoGraspConfig(GeoGraspConfig):
    """Settings of the grasp planner of simulated samples, which drops no flying points: neither did the planner of the recorded ones."""

    flying_share: float = setting(1.0, _FLYING, bounds=(0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class HandConfig(Settings):
    """What the hand can execute: two fingers that close along the line through both contacts, from outside."""

    name: str = setting(
        "two_tips", "Description of the hand: its name (foretouch hand list), or a YAML file of one's own"
    )
    thumb_at: Literal["either", "g1", "g2"] = setting(
        "either",
        "Side on which the thumb touches, by where the arm stands: g1 is left in the image, g2 right. A planned grasp has its thumb at g1",
        choices=("either", "g1", "g2"),
    )
    opening_m: float | None = setting(
        None, "Grasps whose contacts are farther apart are not planned; absent: as described", bounds=(0.005, 1.0)
    )
    tip_radius_m: float | None = setting(
        None, "Radius of a fingertip where it touches; absent: as described", bounds=(0.001, 0.05)
    )
    clearance_m: float = setting(0.002, "Distance that a fingertip keeps from the table", bounds=(0.0, 0.1))
    approach_m: float = setting(
        0.03, "Length of the way in, from outside along the line, on which nothing may stand", bounds=(0.0, 0.3)
    )

    force_n: float = setting(
        5.0, "Force with which each fingertip presses; it counts where object.mass_kg is given", bounds=(0.1, 1000.0)
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            _ = self.hand
        except ConfigError as err:
            raise ConfigError(f"name: {err}") from err

    @cached_property
    def hand(self) -> Hand:
        """The described hand, as its file was when these settings were made."""
        return load_hand(self.name)

    @property
    def opening(self) -> float:
        """Largest distance of the contacts [m]."""
        return self.hand.config.opening_m if self.opening_m is None else self.opening_m

    @property
    def tip_radius(self) -> float:
        """Radius of a fingertip where it touches [m]."""
        return self.hand.config.tip_radius_m if self.tip_radius_m is None else self.tip_radius_m


@dataclass(frozen=True, kw_only=True)
class CarriedConfig(Settings):
    """What is known of the object besides its image."""

    mass_kg: float | None = setting(
        None,
        "Mass of the object: grasps that cannot carry it get the flag cannot_carry; absent: not known",
        bounds=(0.001, 100.0),
    )
    friction: float = setting(
        0.8, "Coefficient between fingertips and object; it counts where the mass is given", bounds=(0.05, 5.0)
    )


DEFAULT_HAND = HandConfig()
