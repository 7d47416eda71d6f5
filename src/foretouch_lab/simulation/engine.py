# SPDX-License-Identifier: Apache-2.0
"""Effects, each one step of a sample, and the engine that runs those that a scene calls for and measures their time.

Each effect has its own random stream: an effect that is off leaves all bit-equal that is not computed from its result.
Of each object of the scene, those effects run, in the order of their list, that the scene calls for. The others cost nothing.
"""

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from foretouch.errors import ContactError, ConvergenceError, ForetouchError, GraspError, SimulationError
from foretouch.grasp import GraspPlan
from foretouch.types import Cloud, Float64, Grasp, Int32, Int64, Touch
from foretouch_lab.simulation.contact.pad import ContactFrame, PadWindow
from foretouch_lab.simulation.contact.problem import ContactSolution
from foretouch_lab.simulation.depth_scene import Window
from foretouch_lab.simulation.fingertip import Finger
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.objects import ObjectConfig
from foretouch_lab.simulation.solids import Body, Hits
from foretouch_lab.simulation.world import CampaignTime, SampleKey, World, object_index


class SampleState:
    """The keys that effects read and write; none is there before an effect has written it.

    Pairs are thumb and middle finger; T is the number of messages, N the cells along one side of a pad's window.
    """

    bodies: list[Body]  # the object first, then the clutter
    window: Window  # rows and columns of the image that are rendered
    exact_depth: Float64  # (h, w) along the optical axis [m], inf where there is nothing
    labels: Int32  # (h, w): 0 none, 1 table, 2 the object, 3 and on the clutter
    hits: list[Hits | None]  # of each body, flat over the window; None for a body that the window does not show
    depth: Float64  # (h, w) [m], as the camera measures it; inf where it measures nothing
    cloud: Cloud  # the object's points in the camera frame
    pixels: Int64  # (n,), pixel of each point in the flat image
    plan: GraspPlan  # result of GeoGrasp
    grasp: Grasp  # the grasp that is executed, in the camera frame
    fingers: tuple[ContactFrame, ContactFrame]  # where both fingers close, in the world
    pad_angles: Float64  # (2, 2), pitch and roll of the place of each pad that the hand turns to the object [rad]
    turn: Float64  # (3, 3), by which the hand is turned against where it was sent, in the world
    target: float  # what both fingers are commanded to reach, [N] or [m] by the scene's `control`
    axial_load_n: float  # how much more the middle finger pushes than the thumb [N]
    tangential_n: Float64  # (2, 3) [N], force of the object's weight on both fingers in the world, across their line
    postures: tuple[tuple[ContactFrame, Float64], tuple[ContactFrame, Float64]]
    # of each fingertip: where on its skin the hand aims with, and its axes as columns in the world, (3, 3)
    pads: tuple[PadWindow, PadWindow]  # where on its skin each fingertip is touched, and the window about it
    touches: tuple[ContactFrame, ContactFrame]  # the tangent frames there, in the world
    relief: Float64  # (2, N, N) [m], the object's surface behind each tangent plane, inf without a surface
    contacts: tuple[ContactSolution, ContactSolution]  # solved contacts of both fingers
    campaign_time: CampaignTime  # when in the campaign the grasp is executed
    sensors: tuple[Finger, Finger]  # the fingertips that are mounted
    readings: Float64  # (2, 2, V) at rest and in contact, ideal, not rounded; V of a BioTac SP is 25: PDC, electrodes
    times: Float64  # (T,) [s] of the messages; without a timeline two, for tare and touch, at one time
    load: Float64  # (T,), 0 without contact and 1 in full contact
    hold_row: int  # the message that is the touch; the tare is the median of those before the first load
    level: Float64  # (T, 2, 25) [counts], how far the readings have drifted in the course of the campaign
    others: Float64  # (T, 2, 4) [counts], PAC0, PAC1 (always 0), TAC and TDC of both fingers, not rounded; 0 if not simulated
    series: Float64  # (T, 2, V), with what the sensor adds
    touch: Touch  # readings in contact
    tare: Touch | None  # readings before contact; None where no tare is recorded
    elapsed_s: float  # of a live hand, the time since it was switched on [s]
    idle_rows: int  # of a live hand, how many messages are read while nothing is touched


@dataclass(frozen=True)
class Effect:
    """One step of a sample.

    Attributes:
        name: Unique name. It also names the random stream, so renaming an effect changes its numbers.
        run: Computes the effect.
        when: Field of the scene that calls for it, such as `camera.noise` (`objects.` stands for the object of the
            sample), or a function that returns the reason to run it with an object, or None.
        off: Reason why it does not run where nothing calls for it; by default the field that is absent.
        again: Whether it draws anew when the same grasp is repeated: what the hand and the sensor do, not what is there.
    """

    name: str
    run: Callable[["Job", SampleState], None]
    when: str | Callable[[SceneConfig, ObjectConfig], str | None]
    off: str = ""
    again: bool = False

    def reason(self, scene: SceneConfig, item: ObjectConfig) -> str | None:
        """Return why it runs with an object of a scene; None where nothing calls for it."""
        if callable(self.when):
            return self.when(scene, item)
        return None if _field_of(self.when, scene, item) in (None, ()) else self.when


def _field_of(path: str, scene: SceneConfig, item: ObjectConfig) -> Any:
    """Return a field of a scene, such as `camera.noise`, or of the object, such as `objects.surface`; None where a group is absent."""
    value: Any = item if path.startswith("objects.") else scene
    for name in path.removeprefix("objects.").split("."):
        value = None if value is None else getattr(value, name)
    return value


@dataclass(frozen=True, eq=False)
class Job:
    """What an effect may read besides the state."""

    scene: SceneConfig  # the scene
    item: ObjectConfig  # the object of this sample
    world: World  # what all samples of the scene share
    key: SampleKey  # which sample
    effect: Effect  # the effect that runs

    @property
    def settings(self) -> Any:
        """The field of the scene that calls for the effect."""
        return _field_of(str(self.effect.when), self.scene, self.item)

    def rng(self) -> np.random.Generator:
        """Return the effect's own stream; call it once, for each call starts it again."""
        return self.key.stream(self.effect.name, again=self.effect.again)


# Reasons of failed tries that are not named by the effect.
_REASONS: Final[dict[type[ForetouchError], str]] = {
    ContactError: "contact",
    ConvergenceError: "not_converged",
    GraspError: "no_grasp",
}


@dataclass(frozen=True)
class EffectPlan:
    """Whether an effect will run in a scene, and why."""

    name: str  # of the effect
    runs: bool  # whether it runs with any of the objects
    reason: str  # the field of the scene that calls for it, or the one whose absence leaves it out
    objects: tuple[str, ...] = ()  # the objects it runs with


@dataclass(eq=False)
class Engine:
    """Makes samples of one scene.

    Attributes:
        scene: The scene.
        effects: All effects there are, in the order in which they run.
        calls: How often each effect ran.
        seconds: How long each ran in all, by the processor time of its thread [s].
        world: What all samples share.
        chains: Of each object, the effects that run.
    """

    scene: SceneConfig
    effects: Sequence[Effect]
    calls: Counter[str] = field(default_factory=Counter)
    seconds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    world: World = field(init=False)
    chains: list[list[Effect]] = field(init=False)

    def __post_init__(self) -> None:
        self.world = World.of(self.scene)
        self.chains = [
            [effect for effect in self.effects if effect.reason(self.scene, item) is not None]
            for item in self.scene.objects
        ]

    def explain(self) -> list[EffectPlan]:
        """Return which effects will run and which will not, without running any."""
        plans = []
        for effect in self.effects:
            ran = [(item, why) for item in self.scene.objects if (why := effect.reason(self.scene, item)) is not None]
            reason = ", ".join(dict.fromkeys(why for _, why in ran)) or effect.off or f"no {effect.when}"
            plans.append(EffectPlan(effect.name, bool(ran), reason, tuple(item.name for item, _ in ran)))
        return plans

    def first_tries(self, count: int) -> Iterator[tuple[SampleKey, SampleState]]:
        """Make the first try at each of the first slots; leave out the tries that fail."""
        for slot in range(count):
            key = SampleKey(self.scene.seed, slot)
            with suppress(SimulationError):
                yield key, self.run(key)

    def run(self, key: SampleKey, **given: Any) -> SampleState:
        """Make one sample, from the keys that are given; a `SimulationError` names the `reason` of a refusal."""
        index = object_index(self.scene, key.slot)
        item, state = self.scene.objects[index], SampleState()
        vars(state).update(given)
        for effect in self.chains[index]:
            start = time.thread_time()
            try:
                effect.run(Job(self.scene, item, self.world, key, effect), state)
            except SimulationError:
                raise
            except ForetouchError as err:
                reason = _REASONS.get(type(err), effect.name)
                raise SimulationError(f"{item.name}: {effect.name}: {err}", reason) from err
            finally:
                self.calls[effect.name] += 1
                self.seconds[effect.name] += time.thread_time() - start
        return state
