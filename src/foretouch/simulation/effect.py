# SPDX-License-Identifier: Apache-2.0
"""What an effect is: a unit that declares what it reads, writes and changes, and which field of the scene enables it.

`SampleState` holds what the effects of one sample have computed so far, by key. Each effect has a random stream of its own:
a disabled effect leaves all bit-equal that is not downstream of it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from foretouch.errors import SimulationError
from foretouch.grasp import GraspPlan
from foretouch.simulation.campaign import Campaign, Moment
from foretouch.simulation.contact import ContactFrame, ContactSolution, HeldWeight, PadWindow
from foretouch.simulation.finger_contact import FingerFrame
from foretouch.simulation.fingertip import Finger
from foretouch.simulation.scene import ObjectConfig, SceneConfig
from foretouch.simulation.solids import Body, Hits
from foretouch.simulation.world import SampleKey, World
from foretouch.types import Cloud, Float64, Grasp, Touch

Window = tuple[slice, slice]


def _key() -> Any:
    return field(init=False)


@dataclass(eq=False)
class SampleState:
    """The keys that effects read, write and modify; none is there before an effect has made it.

    Attributes:
        bodies: The object first, then the clutter.
        window: Rows and columns of the image that are rendered.
        exact_depth: (h, w) float64 along the optical axis [m], inf where there is nothing.
        labels: (h, w) int32: 0 none, 1 table, 2 the object, 3 and on the clutter.
        hits: Of each body, flat over the window; None for a body that the window does not show.
        normals: (h, w, 3) float64, outward unit normals in the world; zero where no body is.
        depth: (h, w) float64 [m], as the camera measures it; inf where it measures nothing.
        cloud: The object's points in the camera frame.
        pixels: (n,) int64, their places in the image.
        plan: What GeoGrasp found.
        grasp: The grasp that is executed, in the camera frame.
        fingers: Where thumb and middle finger close, in the world.
        targets: (2,) float64: what thumb and middle finger reach, [N] or [m] by the scene's `control`.
        axial_load_n: How much more the middle finger pushes than the thumb [N].
        weight: What the object's weight asks of the fingers.
        postures: Of each fingertip: where on its skin the hand aims with, and its axes as columns in the world, (3, 3).
        pads: Where on its skin each fingertip is touched, and the window about it.
        touches: The tangent frames there, in the world.
        relief: (2, N, N) float64 [m], the object's surface behind each tangent plane, inf where there is none.
        contacts: How thumb and middle finger touch it.
        moment: When in the campaign the grasp is executed.
        sensors: The fingertips that are mounted, of thumb and middle finger.
        readings: (2, 2, 25) float64 [counts]: at rest and in contact, of thumb and middle finger, PDC then electrodes;
            of an ideal fingertip, not rounded.
        times: (T,) float64 [s] of the messages; without a timeline two, for tare and touch, at one time.
        load: (T,) float64, 0 without contact and 1 in full contact.
        hold_row: The message that is the touch; the tare is the median of those before the first load.
        level: (T, 2, 25) float64 [counts], how far the readings have moved in the course of the campaign.
        series: (T, 2, 25) float64 [counts], what the sensor makes of it.
        touch: Readings in contact [counts].
        tare: What it said before; None where no tare is recorded.
    """

    bodies: list[Body] = _key()
    window: Window = _key()
    exact_depth: Float64 = _key()
    labels: npt.NDArray[np.int32] = _key()
    hits: list[Hits | None] = _key()
    normals: Float64 = _key()
    depth: Float64 = _key()
    cloud: Cloud = _key()
    pixels: npt.NDArray[np.int64] = _key()
    plan: GraspPlan = _key()
    grasp: Grasp = _key()
    fingers: tuple[FingerFrame, FingerFrame] = _key()
    targets: Float64 = _key()
    axial_load_n: float = _key()
    weight: HeldWeight = _key()
    postures: tuple[tuple[ContactFrame, Float64], tuple[ContactFrame, Float64]] = _key()
    touches: tuple[FingerFrame, FingerFrame] = _key()
    pads: tuple[PadWindow, PadWindow] = _key()
    relief: Float64 = _key()
    contacts: tuple[ContactSolution, ContactSolution] = _key()
    moment: Moment = _key()
    sensors: tuple[Finger, Finger] = _key()
    readings: Float64 = _key()
    times: Float64 = _key()
    load: Float64 = _key()
    hold_row: int = _key()
    level: Float64 = _key()
    series: Float64 = _key()
    touch: Touch = _key()
    tare: Touch | None = _key()


Needed = Callable[[SceneConfig, ObjectConfig], str | None]


@dataclass(frozen=True, eq=False)
class Job:
    """What an effect may read besides the state."""

    scene: SceneConfig  # the scene
    item: ObjectConfig  # the object of this sample
    world: World  # what all samples of the scene share
    key: SampleKey  # which sample
    name: str  # of the effect, and of its random stream
    again: bool = False  # whether the effect draws anew when a grasp is repeated
    campaign: Campaign | None = None  # of the scene

    def rng(self) -> np.random.Generator:
        """The effect's own stream; call it once, for each call starts it again."""
        return self.key.stream(self.name, again=self.again)


@dataclass(frozen=True)
class Effect:
    """One step of a sample.

    Attributes:
        name: Unique; it also names the random stream, so renaming an effect changes its numbers.
        run: Does it.
        needed: The field of the scene that calls for it with this object, or None where nothing does.
        off: Why it does not run where nothing needs it: the field that is absent.
        reads: Keys of the state that must be there.
        writes: Keys that it makes; each key has one maker.
        modifies: Keys that it changes, after they are made and before they are read. Several change one key in
            the order in which the effects are listed.
        again: Whether it draws anew when the same grasp is repeated: what the hand and the sensor do, not what is
            there.
    """

    name: str
    run: Callable[[Job, SampleState], None]
    needed: Needed
    off: str = ""
    reads: frozenset[str] = field(default_factory=frozenset)
    writes: frozenset[str] = field(default_factory=frozenset)
    modifies: frozenset[str] = field(default_factory=frozenset)
    again: bool = False


def keys(*names: str) -> frozenset[str]:
    """Keys of the state.

    Raises:
        SimulationError: If the state has no such key.
    """
    unknown = [name for name in names if name not in SampleState.__dataclass_fields__]
    if unknown:
        raise SimulationError(f"state: has no key {unknown[0]!r}", "effect")
    return frozenset(names)


def always(reason: str) -> Needed:
    """For effects without which there is no sample."""
    return lambda _scene, _item: reason


def called_for(path: str) -> Needed:
    """For effects that run where a field of the scene is given.

    Args:
        path: Of the field, such as `camera.noise`; `objects.` stands for the object of the sample.
    """
    value = attrgetter(path.removeprefix("objects."))
    of_object = path.startswith("objects.")
    return lambda scene, item: path if value(item if of_object else scene) is not None else None


def guarded(state: SampleState, effect: Effect) -> SampleState:
    """The state as the effect has declared to use it; all else in it is out of reach."""
    return cast("SampleState", _Guard(state, effect))


class _Guard:
    """Lets through what is declared; everything else is a mistake in the effect."""

    __slots__ = ("_effect", "_state")
    _effect: Effect
    _state: SampleState

    def __init__(self, state: SampleState, effect: Effect) -> None:
        object.__setattr__(self, "_state", state)
        object.__setattr__(self, "_effect", effect)

    def __getattr__(self, key: str) -> object:
        effect = self._effect
        if key not in effect.reads and key not in effect.modifies and key not in effect.writes:
            raise SimulationError(f"{effect.name}: reads {key}, which it does not declare", "effect")
        return getattr(self._state, key)

    def __setattr__(self, key: str, value: object) -> None:
        effect = self._effect
        if key not in effect.writes and key not in effect.modifies:
            raise SimulationError(f"{effect.name}: writes {key}, which it does not declare", "effect")
        setattr(self._state, key, value)
