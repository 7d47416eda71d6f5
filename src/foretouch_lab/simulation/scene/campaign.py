# SPDX-License-Identifier: Apache-2.0
"""A recording campaign: sessions over days and weeks, and how the level of the sensors changes meanwhile."""

from dataclasses import dataclass, field
from typing import Final

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch_lab.simulation.fingertip import BODY_KELVIN, WARMING_S
from foretouch_lab.simulation.scene.ranges import Switch

DAY_S: Final = 86400.0
POWER_ON_S: Final = 120.0  # from power-on to the first grasp
GRASP_S: Final = (50.0, 110.0)  # from one grasp to the next, low and high
# Of a finger whose temperature is simulated: slopes as in the recordings, the time an assumption (docs/scenes.md).
CONTACT_S: Final = 20.0  # time constant with which a finger in contact takes the temperature of the object
SLOPE_TH: Final = 0.75  # mean of the thumb's electrode counts per count of TDC
SLOPE_MF: Final = 0.65  # the same of the middle finger
SLOPE_SPREAD: Final = 0.15  # standard deviation of these slopes between electrodes
# Sessions differ by more than the recorded ones (.65 K); the cooling in contact is within the differences of TDC between grasps.
SESSION_KELVIN: Final = 1.0  # standard deviation of the temperature at power-on between sessions
FINGER_KELVIN: Final = 0.2  # the same of each finger on its own
OBJECT_KELVIN: Final = (-3.0, 0.0)  # temperature of an object minus the fingers', low and high

CHANGE_S: Final = (60.0, 300.0)  # in addition where the object is changed, low and high


@dataclass(frozen=True, kw_only=True)
class DriftTermConfig(Settings):
    """One stationary Ornstein-Uhlenbeck process of the readings: correlation exp(-Δt / memory) at a distance of Δt.

    The defaults are the slow term of 400 public grasps, by maximum likelihood of a slow and a fast term, the object
    and the grasp (docs/scenes.md). Between 5 and 40 days of memory the likelihood hardly differs.
    """

    memory_days: float = setting(10.0, "Time in which the correlation falls to 1/e", bounds=(0.05, 1000.0))
    hand_counts: float = setting(55.0, "Standard deviation of what all electrodes of both fingers share", minimum=0.0)
    finger_counts: float = setting(7.0, "Standard deviation of what the electrodes of one finger share", minimum=0.0)
    electrode_counts: float = setting(3.0, "Standard deviation of each electrode by itself", minimum=0.0)
    pdc_counts: float = setting(7.0, "Standard deviation of PDC of one finger", minimum=0.0)
    in_contact: bool = setting(
        False, "Whether readings move in contact only, and tares do not: how hand and object lie, not the sensor"
    )


@dataclass(frozen=True, kw_only=True)
class ExchangeConfig(Settings):
    """A fingertip is replaced before a session: another sensor with other electrodes and another drift."""

    session: int = setting(1, "First session with the new sensor, counted from 0", minimum=1)
    finger: str = setting("thumb", "Finger whose sensor is replaced", choices=("thumb", "middle"))
    electrode_counts: float = setting(
        100.0, "Difference of the new sensor's mean electrode at rest from the old one's", bounds=(-2000.0, 2000.0)
    )
    pdc_counts: float = setting(
        50.0, "Difference of the new sensor's PDC at rest from the old one's", bounds=(-2000.0, 2000.0)
    )


@dataclass(frozen=True, kw_only=True)
class WarmUpConfig(Settings):
    """Warming after each power-on.

    Attributes:
        tdc: Each finger has a temperature, which its sensor sends as TDC and TAC, and which its electrodes follow, as in the recordings.
    """

    body_kelvin: float = setting(
        BODY_KELVIN, "Rise of the liquid's temperature since power-on, in the end", bounds=(-1e3, 1e3)
    )
    warming_s: float = setting(WARMING_S, "Time constant of the warming", bounds=(1e-3, 1e9))
    tdc: Switch | None = None


@dataclass(frozen=True, kw_only=True)
class CampaignConfig(Settings):
    """When grasps are executed, and what the sensors do in the course of the campaign.

    In each session some objects are grasped one after the other, each several times. All objects of the scene have
    their turn before the first comes again, in another order.

    Raises:
        ConfigError: If sessions overlap, or an exchange is not within the campaign.
    """

    days: tuple[float, ...] = setting(
        (0.0,), "Start of each session, counted from the first", unit="days", bounds=(0.0, 365.0)
    )
    objects: int = setting(6, "Number of objects in a session", bounds=(1, 1000))
    grasps: int = setting(10, "Number of grasps of an object in succession", bounds=(1, 1000))
    repeat_every: int | None = setting(
        None, "Number of grasps of an object after which the one before is executed again", bounds=(2, 1000)
    )
    tares: str = setting(
        "grasp",
        "Which grasps have a tare: each, the first of an object or of a session, none",
        choices=("grasp", "object", "session", "none"),
    )
    live_speed: float = setting(
        1.0, "Time of the campaign that passes in a second of a live simulated hand", unit="s/s", bounds=(0.0, 1e6)
    )
    warm_up: WarmUpConfig | None = None
    drift: tuple[DriftTermConfig, ...] = field(default=())
    exchanges: tuple[ExchangeConfig, ...] = field(default=())

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.days or self.days[0] != 0.0:
            raise ConfigError(f"days: {list(self.days)} does not begin with 0, the first session")
        longest = self.longest_session_s / DAY_S
        for k, (day, after) in enumerate(zip(self.days, self.days[1:], strict=False)):
            if after - day < longest:
                raise ConfigError(
                    f"days: session {k + 1} starts {after - day:g} days after session {k}, "
                    f"which may take {longest:.3g} days"
                )
        mounted = [(each.session, each.finger) for each in self.exchanges]
        for k, (session, finger) in enumerate(mounted):
            if session >= len(self.days):
                raise ConfigError(f"exchanges[{k}].session: {session}, but the last session is {len(self.days) - 1}")
            if mounted.index((session, finger)) < k:
                raise ConfigError(f"exchanges[{k}]: the {finger} is exchanged twice at session {session}")

    def repeats(self, slot: int) -> bool:
        """Return whether a slot repeats the grasp of the slot before it."""
        return self.repeat_every is not None and (slot % self.grasps + 1) % self.repeat_every == 0

    @property
    def longest_session_s(self) -> float:
        """Upper bound of the duration of a session [s]."""
        return POWER_ON_S + self.objects * (self.grasps * GRASP_S[1] + CHANGE_S[1])

    @property
    def size(self) -> int:
        """Number of grasps in the campaign."""
        return len(self.days) * self.objects * self.grasps
