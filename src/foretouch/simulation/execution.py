# SPDX-License-Identifier: Apache-2.0
"""A simulated hand that executes grasps on the objects of a scene: the readings of its fingertips, message by message.

The contact of a grasp is solved once, for the object as it lay when the grasp was planned; the course of time only
scales it. The same effects run as in a data set, and only those that the scene calls for. Between grasps,
`RestingFingers` generates the readings of fingertips that touch nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import SimulationError
from foretouch.simulation.effect import Effect, Job, SampleState, always, keys
from foretouch.simulation.effects import campaign, contact, grasp, meeting, place, reading
from foretouch.simulation.engine import Engine
from foretouch.simulation.finger_contact import FingerFrame
from foretouch.simulation.fingertip import quantise, temperature_drift, warming
from foretouch.simulation.scene import SceneConfig
from foretouch.simulation.scene.fingers import TimelineConfig
from foretouch.simulation.scene.ranges import draw
from foretouch.simulation.world import SampleKey, World
from foretouch.types import Float64, Grasp

_BLOCK = 200  # messages that are made at a time
_STREAMS = 1 << 20  # apart from the numbers by which grasps are repeated


class RestingFingers:
    """Readings without contact, each new.

    Args:
        hand: Whose fingers; nobody else may use it at the same time.
        stream: Two with another number have noise of their own.
    """

    def __init__(self, hand: SimulatedHand, stream: int = 0) -> None:
        self._hand = hand
        self._repeat = _STREAMS * (stream + 1)
        self._rows: npt.NDArray[np.int16] = np.empty((0, 2, 25), np.int16)
        self._next = 0

    def read(self, elapsed_s: float) -> npt.NDArray[np.int16]:
        """(2, 25) int16 counts: thumb and middle finger, PDC then electrodes.

        Args:
            elapsed_s: Time since the hand was switched on [s].
        """
        if self._next == len(self._rows):
            self._rows, self._next = self._hand.rest(_BLOCK, self._repeat, elapsed_s), 0
            self._repeat += 1
        self._next += 1
        return np.asarray(self._rows[self._next - 1], np.int16)


Counts = npt.NDArray[np.int16]


@dataclass(frozen=True, kw_only=True)
class CourseConfig(Settings):
    """A grasp in time. Whoever wants a tare finds it in the rest."""

    rate_hz: float = setting(100.0, "Messages a second", unit="Hz", minimum=1.0, maximum=1000.0, read_only=True)
    rest_s: float = setting(0.5, "Before the hand moves", unit="s", minimum=0.02, maximum=600.0, read_only=True)
    approach_s: float = setting(0.3, "From there to first touch", unit="s", minimum=0.0, maximum=60.0, read_only=True)
    close_s: float = setting(
        0.2, "From first touch to steady contact, and back", unit="s", minimum=0.0, maximum=60.0, read_only=True
    )
    hold_s: float = setting(0.5, "Of steady contact", unit="s", minimum=0.02, maximum=600.0, read_only=True)

    @property
    def timeline(self) -> TimelineConfig:
        """The same in a scene's words."""
        return TimelineConfig(
            rate_hz=self.rate_hz, rest_s=self.rest_s + self.approach_s, close_s=self.close_s, hold_s=self.hold_s
        )


@dataclass(frozen=True, eq=False)
class Course:
    """One executed grasp."""

    counts: Counts  # (T, 2, 25) int16: thumb and middle finger, PDC then electrodes, as the sensor sends them
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
        """What the hand does: `rest`, `approach`, `contact`, `hold` or `release`."""
        if row < self.start:
            return "rest"
        if self.onset is None or row < self.onset:
            return "approach"
        if self.contact is None or row < self.contact:
            return "contact"
        return "hold" if self.release is None or row < self.release else "release"


class SimulatedHand:
    """Two fingertips and the objects of a scene.

    Args:
        scene: The scene. Its camera is not used, and its `fingers.timeline` is replaced by `config`.
        config: Timing of a grasp.
    """

    def __init__(self, scene: SceneConfig, config: CourseConfig | None = None) -> None:
        self.config = CourseConfig() if config is None else config
        self.scene = scene.replace(fingers=scene.fingers.replace(timeline=self.config.timeline))
        self._world = World.of(self.scene)
        self._grasp: Grasp | None = None
        self._idle_rows = 0
        self._elapsed_s = 0.0
        own = {"drift": self._drift(), "calendar": self._clock()}
        not_live = {"sessions", "tares"}  # one hand, one day; a tare is found in the rest
        recorded = [effect for effect in (*campaign.EFFECTS, *reading.EFFECTS) if effect.name not in not_live]
        sensor = tuple(own.get(effect.name, effect) for effect in recorded)
        closing = tuple(self._given() if effect.name == "grasp" else effect for effect in grasp.EFFECTS)
        # What a resting fingertip does by itself: all that changes its readings and asks for no contact.
        by_itself = keys("series", "level", "sensors", "moment")
        alone = [effect for effect in sensor if effect.modifies | effect.writes <= by_itself and effect.name != "slip"]
        self._executing = Engine(
            self.scene,
            (*place.EFFECTS, *closing, *meeting.EFFECTS, *contact.EFFECTS, *sensor),
            ("series", "load", "fingers", "contacts"),
        )
        self._resting = Engine(self.scene, (self._rest(), *alone), ("series",))

    def execute(self, grasp: Grasp, slot: int, repeat: int = 0, elapsed_s: float = 0.0) -> Course:
        """Take an object.

        Args:
            grasp: In the camera frame, thumb at g1.
            slot: Which sample of the scene lies on the table.
            repeat: How many messages or grasps there were before: what the sensor adds differs from one to the next.
            elapsed_s: Time since the hand was switched on, for what drifts [s].

        Returns:
            The course; where the grasp comes to nothing, that of a hand that closes without touching.
        """
        self._grasp, self._elapsed_s = grasp, elapsed_s
        try:
            state = self._executing.run(self._key(slot, repeat))
        except SimulationError as err:
            if err.reason == "effect":
                raise  # a mistake in the program, not in the grasp
            return self._missed(grasp, err, repeat, elapsed_s)
        steady = np.flatnonzero(state.load == 1.0)
        midpoint, rotation = _achieved(state.fingers, grasp, self._world)
        return Course(
            counts=self._counts(state),
            start=self._start,
            onset=int(np.argmax(state.load > 0.0)),
            contact=int(steady[0]),
            release=int(steady[-1]) + 1,
            midpoint=midpoint,
            rotation=rotation,
            forces=(state.contacts[0].force_n, state.contacts[1].force_n),
        )

    def rest(self, rows: int, repeat: int = 0, elapsed_s: float = 0.0) -> Counts:
        """(rows, 2, 25) int16: what both fingertips send while nothing touches them.

        Args:
            rows: Messages.
            repeat: As in `execute`.
            elapsed_s: As in `execute`.
        """
        self._idle_rows, self._elapsed_s = rows, elapsed_s
        return self._counts(self._resting.run(self._key(0, repeat)))

    @property
    def _start(self) -> int:
        return round(self.config.rest_s * self.config.rate_hz)

    def _key(self, slot: int, repeat: int) -> SampleKey:
        return SampleKey(self.scene.seed, slot, 0, repeat)

    def _counts(self, state: SampleState) -> Counts:
        pdc, electrodes = quantise(self.scene.fingers.fingertip, state.series[..., 0], state.series[..., 1:])
        return np.concatenate([pdc[..., None], electrodes], axis=-1).astype(np.int16)

    def _missed(self, grasp: Grasp, err: SimulationError, repeat: int, elapsed_s: float) -> Course:
        config = self.config
        length_s = 2.0 * (config.rest_s + config.approach_s + config.close_s) + config.hold_s
        return Course(
            counts=self.rest(round(length_s * config.rate_hz), repeat, elapsed_s),
            start=self._start,
            onset=None,
            contact=None,
            release=None,
            midpoint=grasp.midpoint,
            rotation=grasp.rotation,
            reason=err.reason,
            message=str(err),
        )

    # Effects that run for an execution only.

    def _given(self) -> Effect:
        """In place of planning: the grasp that was asked for."""

        def run(job: Job, state: SampleState) -> None:
            grasp, widest = self._grasp, job.scene.grasps.max_width_m
            if grasp is None:
                raise SimulationError("hand: no grasp was given", "effect")
            if grasp.width_m > widest:
                raise SimulationError(
                    f"{job.item.name}: a grasp of {grasp.width_m:.3f} m, the hand opens {widest:g} m", "too_wide"
                )
            state.grasp = replace(grasp, object_id=job.item.name)

        return Effect("given_grasp", run, always("the hand"), writes=keys("grasp"))

    def _rest(self) -> Effect:
        """In place of contact: nothing."""

        def run(_job: Job, state: SampleState) -> None:
            low = np.array([np.append(finger.pdc_rest, finger.electrode_rest) for finger in state.sensors])
            state.series = np.repeat(low[None], self._idle_rows, axis=0)
            state.times = np.arange(self._idle_rows) / self.config.rate_hz
            state.load = np.zeros(self._idle_rows)

        return Effect("rest", run, always("the hand"), reads=keys("sensors"), writes=keys("series", "times", "load"))

    def _clock(self) -> Effect:
        """In place of the calendar: the campaign passes with the time since the hand was switched on."""

        def run(job: Job, state: SampleState) -> None:
            if job.campaign is not None:
                state.moment = job.campaign.live(self._elapsed_s)

        original = next(effect for effect in campaign.EFFECTS if effect.name == "calendar")
        return replace(original, run=run)

    def _drift(self) -> Effect:
        """In place of a tare of a drawn age: the liquid warms on as long as the hand is on."""

        def run(job: Job, state: SampleState) -> None:
            config = job.scene.fingers.drift
            if config is None:
                return
            before = draw(SampleKey(job.scene.seed, 0).stream("session of the hand"), config.session_s)
            kelvin = warming(config.temperature, before + self._elapsed_s + state.times)
            pdc, electrodes = temperature_drift(config.temperature, kelvin)
            state.series[..., 0] += pdc[:, None]
            state.series[..., 1:] += electrodes[:, None, None]

        original = next(effect for effect in reading.EFFECTS if effect.name == "drift")
        return replace(original, run=run, reads=keys("times"))


def _achieved(fingers: tuple[FingerFrame, FingerFrame], grasp: Grasp, world: World) -> tuple[Float64, Float64]:
    """Midpoint and rotation of the hand in the camera frame, as the fingers really went.

    A finger's tangent x is the hand's X or its opposite, whichever points down; its approach is the hand's Z or -Z.
    """
    thumb, middle = fingers
    R_camera_world = world.view.R_world_camera.T  # noqa: N806  # transforms read as algebra
    x, z = R_camera_world @ thumb.rotation[:, 0], -(R_camera_world @ thumb.approach)
    if x @ grasp.rotation[:, 0] < 0.0:
        x = -x
    midpoint = world.to_camera((thumb.origin + middle.origin) / 2.0)
    return midpoint, np.column_stack([x, np.cross(z, x), z])
