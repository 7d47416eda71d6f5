# SPDX-License-Identifier: Apache-2.0
"""A simulated hand that executes grasps on the objects of a scene: the readings of its fingertips, message by message.

The contact of a grasp is solved once, for the object as it lay when the grasp was planned; time only scales it. The same
effects run as in a data set, and only those that the scene calls for. Between grasps, `RestingFingers` generates the
readings of fingertips that touch nothing.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.config import setting
from foretouch.errors import SimulationError
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.types import Float64, Grasp
from foretouch_lab.simulation.contact.pad import ContactFrame
from foretouch_lab.simulation.effects import grasp, reading, view
from foretouch_lab.simulation.engine import Effect, Engine, Job, SampleState
from foretouch_lab.simulation.fingertip import quantise, read_press
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.fingers import DriftConfig, TimelineConfig
from foretouch_lab.simulation.scene.ranges import draw
from foretouch_lab.simulation.world import SampleKey, World

_BLOCK = 200  # messages that are made at a time
_STREAMS = 1 << 20  # apart from the numbers by which grasps are repeated
_NOT_LIVE = ("sessions", "counts", "tares")  # one hand, one day; touch and tare are found in the messages
_NOT_AT_REST = (*_NOT_LIVE, "fingertip", "timeline", "slip")

Counts = npt.NDArray[Any]


@dataclass(frozen=True, kw_only=True)
class GraspTimingConfig(TimelineConfig, read_only=True):
    """The phases of a live grasp. Whoever wants a tare finds it in the rest."""

    rest_s: float = setting(0.5, "Time before the hand moves, and again after release", bounds=(0.02, 600.0))
    approach_s: float = setting(0.3, "Time from there to first touch", bounds=(0.0, 60.0))


@dataclass(frozen=True, eq=False)
class GraspTrajectory:
    """One executed grasp."""

    counts: Counts  # (T, 2, 25 or 29) int16: thumb and middle finger, PDC, electrodes and, if simulated, the others; of taxels
    # (T, 2, V) float64, the values of each finger in the order of the channels
    start: int  # row at which the hand starts to close
    onset: int | None  # row of first touch; None where a finger never touches
    contact: int | None  # row from which on contact is steady; None likewise
    release: int | None  # first row after steady contact; None likewise
    midpoint: Float64  # (3,) float64, between the fingertips as they really went [m], in the frame of the grasp
    rotation: Float64  # (3, 3) float64, of the hand as it really went
    forces: tuple[float, float] = (0.0, 0.0)  # normal force of both fingers in steady contact [N]
    reason: str = ""  # why it failed, as `SimulationError.reason`; "" where it succeeded
    message: str = ""  # the same in words

    @property
    def success(self) -> bool:
        """Whether both fingers kept hold of the object."""
        return not self.reason

    def phase(self, row: int) -> str:
        """Phase of a row: `rest`, `approach`, `contact`, `hold` or `release`."""
        ends = (self.start, self.onset, self.contact, self.release)
        for end, name in zip(ends, ("rest", "approach", "contact", "hold"), strict=True):
            if end is None or row < end:
                return name
        return "release"


class SimulatedHand:
    """Two fingertips and the objects of a scene.

    Args:
        scene: The scene. Its camera is not used, and its `fingers.timeline` is replaced by `config`.
        config: Timing of a grasp.
    """

    def __init__(self, scene: SceneConfig, config: GraspTimingConfig | None = None) -> None:
        self.config = config = config or GraspTimingConfig()
        timeline = TimelineConfig(
            rate_hz=config.rate_hz,
            rest_s=config.rest_s + config.approach_s,
            close_s=config.close_s,
            hold_s=config.hold_s,
        )
        self.scene = scene.replace(fingers=scene.fingers.replace(timeline=timeline))
        self._grasp: Grasp | None = None
        self._idle_rows = 0
        self._elapsed_s = 0.0
        live = {"grasp": self._given_grasp, "drift": self._drift, "calendar": self._calendar}
        grasping, read = (
            [
                replace(effect, run=live.get(effect.name, effect.run))
                for effect in effects
                if effect.name not in _NOT_LIVE
            ]
            for effects in (grasp.EFFECTS, reading.EFFECTS)
        )
        self._executing = Engine(self.scene, [*view.PLACING, *grasping, *read])
        at_rest = Effect("rest", self._no_contact, "fingers")
        self._resting = Engine(
            self.scene, [at_rest if e.name == "moments" else e for e in read if e.name not in _NOT_AT_REST]
        )

    def execute(self, chosen: Grasp, slot: int, repeat: int = 0, elapsed_s: float = 0.0) -> GraspTrajectory:
        """Take an object.

        Args:
            chosen: In the camera frame, thumb at g1.
            slot: Which sample of the scene lies on the table.
            repeat: How many messages or grasps there were before: what the sensor adds differs from one to the next.
            elapsed_s: Time since the hand was switched on, for what drifts [s].

        Returns:
            The trajectory; where the grasp comes to nothing, that of a hand that closes without touching.
        """
        self._grasp, self._elapsed_s = chosen, elapsed_s
        start = round(self.config.rest_s * self.config.rate_hz)
        try:
            state = self._executing.run(self._key(slot, repeat))
        except SimulationError as err:
            config = self.config
            length_s = 2.0 * (config.rest_s + config.approach_s + config.close_s) + config.hold_s
            counts = self.rest(round(length_s * config.rate_hz), repeat, elapsed_s)
            return GraspTrajectory(
                counts, start, None, None, None, chosen.midpoint, chosen.rotation, reason=err.reason, message=str(err)
            )
        steady = np.flatnonzero(state.load == 1.0)
        midpoint, rotation = _achieved(state.fingers, chosen, self._executing.world)
        return GraspTrajectory(
            counts=self._counts(state),
            start=start,
            onset=int(np.argmax(state.load > 0.0)),
            contact=int(steady[0]),
            release=int(steady[-1]) + 1,
            midpoint=midpoint,
            rotation=rotation,
            forces=(state.contacts[0].force_n, state.contacts[1].force_n),
        )

    def press(self, finger: int) -> Counts:
        """(25,) int16, or (V,) float64 of taxels: what a press by a person adds to the thumb, 0, or the middle finger, 1."""
        one, array = self._resting.world.fingers[finger], self._resting.world.array
        if array is not None:
            return array.press(finger)
        return np.asarray(read_press(one) - one.rest).round().astype(np.int16)

    def rest(self, rows: int, repeat: int = 0, elapsed_s: float = 0.0) -> Counts:
        """As `GraspTrajectory.counts`, while nothing touches the fingertips; arguments as of `execute`."""
        self._idle_rows, self._elapsed_s = rows, elapsed_s
        return self._counts(self._resting.run(self._key(0, repeat)))

    @property
    def sensor(self) -> Sensor:
        """What the fingertips are."""
        array = self._executing.world.array
        return BIOTAC_SP if array is None else array.sensor

    def _counts(self, state: SampleState) -> Counts:
        if (array := self._executing.world.array) is not None:
            return array.quantise(state.series)
        others = [state.others] if state.others.any() else []
        return quantise(np.concatenate([state.series, *others], axis=2)).astype(np.int16)

    def _key(self, slot: int, repeat: int) -> SampleKey:
        return SampleKey(self.scene.seed, slot, 0, repeat)

    # Effects of a live hand.

    def _given_grasp(self, job: Job, state: SampleState) -> None:
        """In place of planning: the grasp that was asked for."""
        assert self._grasp is not None  # noqa: S101  # set by execute
        state.grasp = replace(self._grasp, object_id=job.item.name)

    def _no_contact(self, _job: Job, state: SampleState) -> None:
        array = self._resting.world.array
        low = np.array([finger.rest for finger in state.sensors]) if array is None else array.rest
        rows = self._idle_rows
        reading.start(state, np.arange(rows) / self.config.rate_hz, np.zeros(rows), low, low)

    def _calendar(self, job: Job, state: SampleState) -> None:
        """The campaign passes with the time since the hand was switched on."""
        assert job.world.campaign is not None  # noqa: S101  # the scene calls for this with a campaign only
        state.campaign_time = job.world.campaign.live(self._elapsed_s)

    def _drift(self, job: Job, state: SampleState) -> None:
        """In place of a tare of a drawn age: the liquid warms on as long as the hand is on."""
        config: DriftConfig = job.settings
        before = draw(SampleKey(job.scene.seed, 0).stream("session of the hand"), config.session_s)
        state.series += reading.drift_of(job.world, before + self._elapsed_s + state.times)


class RestingFingers:
    """Readings without contact, each new.

    Args:
        hand: Whose fingers; nobody else may use it at the same time.
    """

    def __init__(self, hand: SimulatedHand) -> None:
        self._hand = hand
        self._repeat = _STREAMS
        self._rows: Counts = np.empty((0, 2, 0))
        self._next = 0

    def read(self, elapsed_s: float) -> Counts:
        """Counts of thumb and middle finger, a row of `GraspTrajectory.counts`.

        Args:
            elapsed_s: Time since the hand was switched on [s].
        """
        if self._next == len(self._rows):
            self._rows, self._next = self._hand.rest(_BLOCK, self._repeat, elapsed_s), 0
            self._repeat += 1
        self._next += 1
        found: Counts = self._rows[self._next - 1]
        return found


def _achieved(fingers: tuple[ContactFrame, ContactFrame], grasp: Grasp, world: World) -> tuple[Float64, Float64]:
    """Midpoint and rotation of the hand in the camera frame, as the fingers really went.

    A finger's tangent x is the hand's X or its opposite, whichever points down; its approach is the hand's Z or -Z.
    """
    thumb, middle = fingers
    R_camera_world = world.view.R_world_camera.T  # noqa: N806  # transforms read as algebra
    x, z = R_camera_world @ thumb.rotation[:, 0], -(R_camera_world @ thumb.normal)
    if x @ grasp.rotation[:, 0] < 0.0:
        x = -x
    return world.view.to_camera((thumb.origin + middle.origin) / 2.0), np.column_stack([x, np.cross(z, x), z])
