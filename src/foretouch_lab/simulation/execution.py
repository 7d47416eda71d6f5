# SPDX-License-Identifier: Apache-2.0
"""A simulated hand that executes grasps on the objects of a scene: the readings of its fingertips, message by message.

The contact of a grasp is solved once, for the object as it lay when the grasp was planned; time only scales it. The same
effects run as in a data set, and only those that the scene calls for. Between grasps, `SimulatedHand.read` gives the
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
from foretouch_lab.simulation import fingertip
from foretouch_lab.simulation.effects import grasp, reading, view
from foretouch_lab.simulation.engine import Effect, Engine, Job, SampleState
from foretouch_lab.simulation.fingertip import quantise, read_press
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.fingers import TimelineConfig
from foretouch_lab.simulation.scene.ranges import draw
from foretouch_lab.simulation.world import SampleKey

_BLOCK = 200  # messages that are made at a time
_STREAMS = 1 << 20  # apart from the numbers by which grasps are repeated

Counts = npt.NDArray[Any]


def _calendar(job: Job, state: SampleState) -> None:
    """Let the campaign pass with the time since the hand was switched on."""
    assert job.world.campaign is not None  # noqa: S101  # the scene calls for this with a campaign only
    state.campaign_time = job.world.campaign.live(state.elapsed_s)


def _drift(job: Job, state: SampleState) -> None:
    """Let the liquid warm on as long as the hand is on, in place of a tare of a drawn age."""
    before = draw(SampleKey(job.scene.seed, 0).stream("session of the hand"), fingertip.SESSION_S)
    state.series += reading.drift_of(job.world, before + state.elapsed_s + state.times)


def _at_rest(job: Job, state: SampleState) -> None:
    """Let nothing touch the fingertips."""
    array = job.world.array
    rows = state.idle_rows
    timeline = job.scene.fingers.timeline
    assert timeline is not None  # noqa: S101  # of the hand
    low = np.array([finger.rest for finger in state.sensors]) if array is None else array.rest
    reading.start(state, np.arange(rows) / timeline.rate_hz, np.zeros(rows), low, low)


# Without the effects of one hand on one day; touch and tare are found in the messages, and the grasp is given.
_READING = [
    replace(effect, run={"calendar": _calendar, "drift": _drift}.get(effect.name, effect.run))
    for effect in reading.EFFECTS
    if effect.name not in ("sessions", "counts", "tares")
]
_EXECUTING = [*view.PLACING, *grasp.EFFECTS[1:], *_READING]
_RESTING = [
    Effect("rest", _at_rest, "fingers") if effect.name == "moments" else effect
    for effect in _READING
    if effect.name not in ("fingertip", "timeline", "slip")
]


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
    reason: str = ""  # why it failed, as `SimulationError.reason`; "" where it succeeded
    message: str = ""  # the same in words

    @property
    def success(self) -> bool:
        """Whether both fingers kept hold of the object."""
        return not self.reason

    def phase(self, row: int) -> str:
        """Return the phase of a row: `rest`, `approach`, `contact`, `hold` or `release`."""
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
        self._executing, self._resting = Engine(self.scene, _EXECUTING), Engine(self.scene, _RESTING)
        self._rows: Counts = np.empty((0, 2, 0))  # those that `read` gives next
        self._repeat = _STREAMS

    def execute(self, chosen: Grasp, slot: int, repeat: int = 0, elapsed_s: float = 0.0) -> GraspTrajectory:
        """Take an object.

        Args:
            chosen: In the camera frame, thumb at g1.
            slot: Which sample of the scene lies on the table.
            repeat: How many messages or grasps there were before: what the sensor adds differs from one to the next.
            elapsed_s: Time since the hand was switched on, for what drifts [s].

        Returns:
            The trajectory; where the grasp comes to nothing, of a hand that closes without touching.
        """
        config, key = self.config, SampleKey(self.scene.seed, slot, 0, repeat)
        start = round(config.rest_s * config.rate_hz)
        try:
            state = self._executing.run(key, grasp=chosen, elapsed_s=elapsed_s)
        except SimulationError as err:
            length_s = 2.0 * (config.rest_s + config.approach_s + config.close_s) + config.hold_s
            counts = self.rest(round(length_s * config.rate_hz), repeat, elapsed_s)
            return GraspTrajectory(
                counts, start, None, None, None, chosen.midpoint, chosen.rotation, reason=err.reason, message=str(err)
            )
        (thumb, middle), camera = state.fingers, self._executing.world.view
        turn = camera.R_world_camera.T @ state.turn @ camera.R_world_camera
        steady = np.flatnonzero(state.load == 1.0)
        return GraspTrajectory(
            counts=self._counts(state),
            start=start,
            onset=int(np.argmax(state.load > 0.0)),
            contact=int(steady[0]),
            release=int(steady[-1]) + 1,
            midpoint=camera.to_camera((thumb.origin + middle.origin) / 2.0),
            rotation=turn @ chosen.rotation,
        )

    def press(self, finger: int) -> Counts:
        """Return (25,) int16, or (V,) float64 of taxels: what a press by a person adds to the thumb, 0, or the middle finger, 1."""
        pressed, array = self._resting.world.fingers[finger], self._resting.world.array
        if array is not None:
            return array.press(finger)
        return np.asarray(read_press(pressed) - pressed.rest).round().astype(np.int16)

    def rest(self, rows: int, repeat: int = 0, elapsed_s: float = 0.0) -> Counts:
        """Return counts as in a `GraspTrajectory` while nothing touches the fingertips, for the arguments of `execute`."""
        key = SampleKey(self.scene.seed, 0, 0, repeat)
        return self._counts(self._resting.run(key, idle_rows=rows, elapsed_s=elapsed_s))

    def read(self, elapsed_s: float) -> Counts:
        """Return the next row of readings without contact, each new, at a time since the hand was switched on [s]."""
        if not len(self._rows):
            self._rows = self.rest(_BLOCK, self._repeat, elapsed_s)
            self._repeat += 1
        row: Counts = self._rows[0]
        self._rows = self._rows[1:]
        return row

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
