# SPDX-License-Identifier: Apache-2.0
"""Fingertips of a scene (pad, posture, sensor), and its grasps (by GeoGrasp, with force or depth by the hand)."""

from dataclasses import dataclass

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.grasp import GeoGraspConfig
from foretouch.simulation import fingertip as sensor
from foretouch.simulation.contact import ContactConfig, PadConfig
from foretouch.simulation.scene.ranges import require_range


@dataclass(frozen=True, kw_only=True)
class ThumbConfig(sensor.FingerConfig):
    """A thumb: other rests than the middle finger."""

    pdc_rest: float = setting(sensor.THUMB.pdc_rest, "PDC without contact", unit="counts", minimum=1.0, maximum=4094.0)
    electrode_rest: float = setting(
        sensor.THUMB.electrode_rest, "Electrodes without contact", unit="counts", minimum=500.0, maximum=4000.0
    )


@dataclass(frozen=True, kw_only=True)
class PostureConfig(Settings):
    """Which place of its pad a finger aims with, drawn uniformly."""

    pitch_deg: tuple[float, ...] = setting(
        (0.0, 0.0), "From the middle of the pad towards the tip, low and high", unit="deg", minimum=-60.0, maximum=60.0
    )
    roll_deg: tuple[float, ...] = setting(
        (0.0, 0.0), "The same towards +y of the fingertip", unit="deg", minimum=-60.0, maximum=60.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_range(self, "pitch_deg")
        require_range(self, "roll_deg")


@dataclass(frozen=True, kw_only=True)
class TimelineConfig(Settings):
    """A grasp as the sensor sees it go by: rest, closing, hold, release. Tare and touch are read out of it."""

    rate_hz: float = setting(100.0, "Messages a second", unit="Hz", minimum=1.0, maximum=1000.0)
    rest_s: float = setting(0.2, "Before contact, and again after release", unit="s", minimum=0.02, maximum=600.0)
    close_s: float = setting(0.2, "From first touch to the target, and back", unit="s", minimum=0.0, maximum=60.0)
    hold_s: float = setting(0.5, "At the target; its last message is the touch", unit="s", minimum=0.02, maximum=600.0)


@dataclass(frozen=True, kw_only=True)
class DriftConfig(Settings):
    """Counts drift with the liquid's temperature, so a tare grows old."""

    temperature: sensor.TemperatureConfig = sensor.TemperatureConfig()
    session_s: tuple[float, ...] = setting(
        (0.0, 1800.0), "Time since power-up, low and high", unit="s", minimum=0.0, maximum=1e9
    )
    tare_age_s: tuple[float, ...] = setting(
        (2.0, 30.0), "Age of the tare at the touch", unit="s", minimum=0.0, maximum=1e9
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_range(self, "session_s")
        require_range(self, "tare_age_s")


@dataclass(frozen=True, kw_only=True)
class SessionsConfig(Settings):
    """Each object was recorded on another day; the rest level of a fingertip differs by the day (inflation, wear).

    Between the eight objects of the public recordings, which have no tare, the lower end of PDC varies by 54 counts
    and the upper end of the electrodes by 50 to 80. That holds the touches of the objects too and so bounds the rest
    from above; the defaults stay well below, so that an object's mean explains about as much as it does there.
    """

    pdc_counts: float = setting(
        20.0, "Standard deviation of PDC between sessions", unit="counts", minimum=0.0, maximum=1e6
    )
    finger_counts: float = setting(
        20.0, "The same of all electrodes of a finger in common", unit="counts", minimum=0.0, maximum=1e6
    )
    electrode_counts: float = setting(10.0, "The same of each electrode alone", unit="counts", minimum=0.0, maximum=1e6)


@dataclass(frozen=True, kw_only=True)
class DeadConfig(Settings):
    """Electrodes that have died; the numbers are those of the layout, 1 to 24."""

    thumb: tuple[int, ...] = setting((), "Dead electrodes of the thumb", minimum=1, maximum=24)
    middle: tuple[int, ...] = setting((), "Dead electrodes of the middle finger", minimum=1, maximum=24)
    stuck_at: str = setting("low", "What they read", choices=("low", "high", "last"))


@dataclass(frozen=True, kw_only=True)
class FingersConfig(Settings):
    """Both fingers. What is absent is off.

    Raises:
        ConfigError: If an effect over time is asked for without a timeline.
    """

    pad: PadConfig = PadConfig()
    contact: ContactConfig = ContactConfig()
    fingertip: sensor.FingertipConfig = sensor.FingertipConfig()
    thumb: ThumbConfig = ThumbConfig()
    middle: sensor.FingerConfig = sensor.FingerConfig()
    thumb_posture: PostureConfig = PostureConfig()
    middle_posture: PostureConfig = PostureConfig()
    timeline: TimelineConfig | None = None
    creep: sensor.CreepConfig | None = None
    slip: sensor.SlipConfig | None = None
    drift: DriftConfig | None = None
    sessions: SessionsConfig | None = None
    noise: sensor.NoiseConfig | None = None
    scan: sensor.ScanConfig | None = None
    dead: DeadConfig | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("creep", "slip", "scan"):
            if self.timeline is None and getattr(self, name) is not None:
                raise ConfigError(f"FingersConfig.{name}: acts over time, but there is no timeline; give one")


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
        0.0,
        "How far below the planned points the fingers close, along the table's normal",
        unit="m",
        minimum=0.0,
        maximum=1.0,
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
