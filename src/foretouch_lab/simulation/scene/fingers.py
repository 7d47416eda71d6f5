# SPDX-License-Identifier: Apache-2.0
"""Fingertips of a scene (pad, posture, sensor), and its grasps (by GeoGrasp, with force or depth by the hand)."""

from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, ForetouchError
from foretouch.grasp import SceneGeoGraspConfig
from foretouch.tactile.description import Sensor, load_sensor, require_two
from foretouch_lab.simulation.contact.pad import PadConfig
from foretouch_lab.simulation.fingertip import SimulatedFingerConfig, ThumbConfig
from foretouch_lab.simulation.scene.ranges import RangedSettings, Switch
from foretouch_lab.simulation.taxels import TaxelConfig, require_channels


@dataclass(frozen=True, kw_only=True)
class PostureConfig(RangedSettings):
    """Which place of its pad a finger aims with, drawn uniformly."""

    pitch_deg: tuple[float, ...] = setting(
        (0.0, 0.0), "Angle from the middle of the pad towards the tip, low and high", bounds=(-60.0, 60.0)
    )
    roll_deg: tuple[float, ...] = setting(
        (0.0, 0.0), "Angle from the middle of the pad towards +y of the fingertip, low and high", bounds=(-60.0, 60.0)
    )


@dataclass(frozen=True, kw_only=True)
class TimelineConfig(Settings, read_only=True):
    """The messages of a grasp: rest, closing, hold, release. Tare and touch are read out of them."""

    rate_hz: float = setting(100.0, "Rate of the messages", bounds=(1.0, 1000.0))
    rest_s: float = setting(0.2, "Time before contact, and again after release", bounds=(0.02, 600.0))
    close_s: float = setting(0.2, "Time from first touch to steady contact, and back", bounds=(0.0, 60.0))
    hold_s: float = setting(0.5, "Time of steady contact; its last message is the touch", bounds=(0.02, 600.0))


@dataclass(frozen=True, kw_only=True)
class DeadConfig(Settings):
    """Electrodes that have failed and read 0; numbered as in the layout, 1 to 24."""

    thumb: tuple[int, ...] = setting((), "Dead electrodes of the thumb", bounds=(1, 24))
    middle: tuple[int, ...] = setting((), "Dead electrodes of the middle finger", bounds=(1, 24))


# What fields are where the sensor is not an array of taxels, and where it is one: the others' groups are refused.
_NO_TAXELS: Final[dict[str, tuple[Any, ...]]] = {"taxels": (None,), "crosstalk": (None,)}
_TAXELS: Final[dict[str, tuple[Any, ...]]] = {
    **dict.fromkeys(("scan", "dead"), (None,)),
    "thumb": (ThumbConfig(),),
    "middle": (SimulatedFingerConfig(),),
    "pad.window_m": (PadConfig().window_m,),
}


@dataclass(frozen=True, kw_only=True)
class FingersConfig(Settings):
    """Both fingers. What is absent is off.

    Attributes:
        creep: The skin relaxes under load within seconds.
        slip: The object slides over the skin during the hold.
        drift: Counts drift with the liquid's temperature, so a tare grows old.
        noise: Electrodes and PDC, or taxels, have white noise; electrodes wander besides.
        crosstalk: Neighbours, and the other axes, of a taxel read a part of its force; how much is an assumption.
        sessions: Rest levels differ from object to object, each of which was recorded on another day.
        scan: Electrodes are sampled one after the other, so that a message repeats about eight of them.

    Raises:
        ConfigError: If an effect over time is asked for without a timeline, or a group is not for the sensor.
    """

    sensor: str = setting("", "Sensor of the fingertips: name or YAML file of a description; empty for the BioTac SP")
    pad: PadConfig = PadConfig()
    thumb: ThumbConfig = ThumbConfig()
    middle: SimulatedFingerConfig = SimulatedFingerConfig()
    thumb_posture: PostureConfig = PostureConfig()
    middle_posture: PostureConfig = PostureConfig()
    taxels: TaxelConfig | None = None
    crosstalk: Switch | None = None
    timeline: TimelineConfig | None = None
    creep: Switch | None = None
    slip: Switch | None = None
    drift: Switch | None = None
    sessions: Switch | None = None
    noise: Switch | None = None
    scan: Switch | None = None
    dead: DeadConfig | None = None
    hand: int = setting(
        0, "Number of the simulated hand: each has different fingertips; the model simulated knows 0", minimum=0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("creep", "slip", "scan"):
            if self.timeline is None and getattr(self, name) is not None:
                raise ConfigError(f"{name}: acts over time, but there is no timeline; give one")
        sensor = self.taxel_sensor()
        for field, allowed in (_TAXELS if sensor else _NO_TAXELS).items():
            if attrgetter(field)(self) not in allowed:
                name, other = (sensor.config.name, "the BioTac SP") if sensor else ("the BioTac SP", "arrays of taxels")
                raise ConfigError(f"{field}: is of {other}, but the sensor of these fingers is {name}")
        if sensor is not None:
            require_channels(sensor)
            object.__setattr__(self, "taxels", self.taxels or TaxelConfig())

    def taxel_sensor(self) -> Sensor | None:
        """Return the sensor, where it is an array of taxels; None for the BioTac SP. A `ConfigError` names the file and the rule."""
        if not self.sensor:
            return None
        try:
            sensor = require_two(load_sensor(self.sensor))
        except ForetouchError as err:
            raise ConfigError(f"sensor: {err}") from err
        return None if sensor.is_biotac else sensor


@dataclass(frozen=True, kw_only=True)
class GraspTargetConfig(RangedSettings):
    """What the fingers' controllers aim at, drawn uniformly; `control` decides which of the two counts.

    The object is free to move between the fingers, so both get the same.
    """

    force_n: tuple[float, ...] = setting((1.0, 3.0), "Normal force, low and high", bounds=(0.0, 1e4))
    depth_m: tuple[float, ...] = setting(
        (0.0005, 0.0015), "Closing beyond first touch, low and high", bounds=(0.0, 0.1)
    )


TARGET_SHARE = 0.1  # standard deviation of the force or depth that is reached, relative to its target


@dataclass(frozen=True, kw_only=True)
class ExecutionErrorConfig(Settings):
    """The hand does not go exactly where it is sent, nor press exactly as hard."""

    position_m: float = setting(0.001, "Standard deviation of the position along each tangent", bounds=(0.0, 0.05))
    angle_deg: float = setting(1.0, "Standard deviation of the orientation about each axis", bounds=(0.0, 30.0))


@dataclass(frozen=True, kw_only=True)
class GraspsConfig(Settings):
    """Where and how the hand grasps."""

    geograsp: SceneGeoGraspConfig = SceneGeoGraspConfig()
    slide: bool = setting(False, "Whether the grasp plane is slid at random along the object's axis (P2)")
    initial_points: bool = setting(
        False, "Whether the initial points are grasped, as in the data of P1, in place of the best ranked pair"
    )
    insertion_m: float = setting(
        0.0, "Distance below the planned points at which the fingers close, along the table's normal", bounds=(0.0, 1.0)
    )
    max_width_m: float = setting(0.13, "Widest opening of the hand", bounds=(0.001, 0.5))
    control: str = setting("force", "Quantity that the hand controls", choices=("force", "depth"))
    thumb: GraspTargetConfig = GraspTargetConfig()
    error: ExecutionErrorConfig | None = None
