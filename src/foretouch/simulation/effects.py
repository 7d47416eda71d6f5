# SPDX-License-Identifier: Apache-2.0
"""What an effect is: a small unit that says what it reads, writes and changes, and what in the scene calls for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from operator import attrgetter
from typing import cast

import numpy as np

from foretouch.errors import SimulationError
from foretouch.simulation.scene import ObjectConfig, SceneConfig
from foretouch.simulation.state import SampleState
from foretouch.simulation.streams import SampleKey
from foretouch.simulation.world import World

__all__ = ["Effect", "Job", "Needed", "always", "called_for", "guarded", "keys"]

Needed = Callable[[SceneConfig, ObjectConfig], str | None]


@dataclass(frozen=True, eq=False)
class Job:
    """What an effect may know besides the state.

    Attributes:
        scene: The scene.
        item: The object of this sample.
        world: What all samples of the scene share.
        key: Which sample.
        name: Of the effect, and of its random stream.
        again: Whether the effect draws anew when a grasp is repeated.
    """

    scene: SceneConfig
    item: ObjectConfig
    world: World
    key: SampleKey
    name: str
    again: bool = False

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
        again: Whether it draws anew when the same grasp is repeated: what the hand and the sensor do, not what is there.
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
