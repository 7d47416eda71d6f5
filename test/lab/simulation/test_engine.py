# SPDX-License-Identifier: Apache-2.0
"""The order of effects, and whether each reads and writes what it declares."""

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sim_builders import CAN, EVERY_CAMERA_FAULT, EVERY_FINGER_EFFECT, SPONGE, scene

from foretouch.errors import CloudError, SimulationError
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.effects.view import FRAME_EFFECTS, PLACING
from foretouch_lab.simulation.engine import Effect, Engine, Job, SampleState
from foretouch_lab.simulation.scene import SceneConfig, load_scene
from foretouch_lab.simulation.scene.objects import ObjectConfig
from foretouch_lab.simulation.world import SampleKey

SCENES = Path(__file__).parents[3] / "config" / "scenes"
SCENE = scene()
KEYS = set(SampleState.__annotations__)
OUTPUTS = ("cloud", "grasp", "targets", "contacts", "touch", "tare")


def effect(
    name: str,
    run: Callable[[Job, SampleState], None] = lambda _job, _state: None,
    *,
    reads: str = "",
    writes: str = "",
    when: Callable[[SceneConfig, ObjectConfig], str | None] = lambda _scene, _item: "x",
) -> Effect:
    return Effect(name, run, when, tuple(reads.split()), tuple(writes.split()), off="off")


def names(effects: list[Effect], *outputs: str) -> list[str]:
    return [e.name for e in Engine(SCENE, effects, outputs).chains[0]]


def test_effects_run_in_the_order_of_their_list_where_their_result_leads_to_an_output() -> None:
    off = effect("off", reads="normals depth", writes="depth", when=lambda _scene, _item: None)
    effects = [
        effect("make", writes="depth"),
        effect("normals", writes="normals"),
        effect("change", reads="depth", writes="depth"),
        off,
        effect("apart", writes="labels"),
        effect("read", reads="depth", writes="cloud"),
    ]
    assert names(effects, "cloud") == ["make", "change", "read"]
    effects[3] = replace(off, when=effects[0].when)
    assert names(effects, "depth", "labels") == ["make", "normals", "change", "off", "apart"]
    effects[3] = off
    plans = {p.name: (p.runs, p.reason) for p in Engine(SCENE, effects, ("cloud",)).explain()}
    assert plans["make"] == (True, "x")
    assert plans["off"] == (False, "off")
    assert plans["apart"] == (False, "nothing reads it")


class Watched:
    """A state that refuses what an effect does not declare."""

    def __init__(self, state: SampleState, effect: Effect) -> None:
        self.__dict__["inner"] = state, effect

    def __getattr__(self, key: str) -> Any:
        state, effect = self.inner
        assert key in (*effect.reads, *effect.writes), f"{effect.name} reads {key}, which it does not declare"
        return getattr(state, key)

    def __setattr__(self, key: str, value: Any) -> None:
        state, effect = self.inner
        assert key in effect.writes, f"{effect.name} writes {key}, which it does not declare"
        setattr(state, key, value)


def watched(effect: Effect) -> Effect:
    """The effect, watched: also what it changes in place."""

    def run(job: Job, state: SampleState) -> None:
        before = {key: pickle.dumps(value) for key, value in vars(state).items() if key not in effect.writes}
        effect.run(job, Watched(state, effect))  # type: ignore[arg-type]
        changed = [key for key, value in before.items() if pickle.dumps(getattr(state, key)) != value]
        assert not changed, f"{effect.name} changes {changed}, which it does not declare"
        assert set(effect.writes) <= set(vars(state)), effect.name

    return replace(effect, run=run)


def made_before_read(effects: tuple[Effect, ...], config: SceneConfig, outputs: tuple[str, ...]) -> set[str]:
    """The names of effects that run; each key has been written before it is read."""
    ran = set()
    for chain in Engine(config, effects, outputs).chains:
        written: set[str] = set()
        for one in chain:
            assert set(one.reads) <= written, f"{one.name} reads {set(one.reads) - written} before it is written"
            written |= set(one.writes)
            ran.add(one.name)
        assert set(outputs) <= written
    return ran


def test_each_effect_reads_and_writes_what_it_declares() -> None:
    """With every effect, on every level of contact, and for whole images."""
    loaded = [CAN | {"mass_kg": 0.05, "colour": [200, 30, 30], "surface": {}}, SPONGE | {"mass_kg": 0.02}]
    common: dict[str, Any] = {"camera": EVERY_CAMERA_FAULT | {"width": 320, "height": 240}, "grasps": {"error": {}}}
    full = scene(*loaded, **common, clutter={}, gravity={}, fingers=EVERY_FINGER_EFFECT | {"sessions": {}})
    campaign = {"tares": "object", "warm_up": {}, "drift": [{}], "exchanges": [{"session": 1}], "days": [0, 1]}
    configs = [full, scene(CAN, SPONGE, campaign=campaign, fingers={"noise": {}})]
    configs.append(scene(fidelity="winkler", camera={"segmented": {}}))
    array = {
        "sensor": "xela_uskin_4x4",
        "timeline": {},
        **{key: {} for key in ("crosstalk", "slip", "noise", "drift", "sessions")},
    }
    configs.append(scene(*loaded, gravity={}, fingers=array))
    configs.append(scene(campaign={"warm_up": {"tdc": {}}}))
    ran = set()
    for config in configs:
        wanted = OUTPUTS if config.campaign is None else (*OUTPUTS, "campaign_time")
        wanted += ("others",) if config is full else ()
        ran |= made_before_read(EFFECTS, config, wanted)
        engine = Engine(config, [watched(one) for one in EFFECTS], wanted)
        for slot in range(6):
            try:
                engine.run(SampleKey(0, slot))
            except SimulationError as err:
                assert err.reason in {"falls", "slips", "contact"}  # noqa: PT017
    assert ran == {one.name for one in EFFECTS}
    made_before_read((*PLACING, *FRAME_EFFECTS), full, ("depth", "labels", "normals"))
    Engine(full, [watched(one) for one in (*PLACING, *FRAME_EFFECTS)], ("depth", "labels", "normals")).run(
        SampleKey(0, 0)
    )


def test_declarations_name_keys_of_the_state_that_are_made_before_they_are_read_in_every_scene() -> None:
    for one in EFFECTS:
        assert {*one.reads, *one.writes} <= KEYS, one.name
    assert len({one.name for one in EFFECTS}) == len(EFFECTS)
    for path in sorted(SCENES.glob("*.yaml")):
        made_before_read(EFFECTS, load_scene(path), OUTPUTS)


def test_calls_are_counted_also_of_failures_and_objects_have_chains_of_their_own() -> None:
    def fail(job: Job, state: SampleState) -> None:
        if job.key.slot == 3:
            raise CloudError("too thin")
        state.depth = np.zeros(1)

    soft = effect("soft", writes="relief", when=lambda _s, item: None if item.rigid else "young_pa")
    effects = [effect("may fail", fail, writes="depth"), effect("idle", writes="labels"), soft]
    engine = Engine(scene(CAN, SPONGE), effects, ("depth", "relief"))
    for slot in range(3):
        engine.run(SampleKey(0, slot))
    with pytest.raises(SimulationError, match=r"sponge: may fail: too thin") as caught:
        engine.run(SampleKey(0, 3))
    assert caught.value.reason == "may fail"
    assert {name: timing.calls for name, timing in engine.timings.items()} == {"may fail": 4, "idle": 0, "soft": 1}
    assert {p.name: p.objects for p in engine.explain()}["soft"] == ("sponge",)
