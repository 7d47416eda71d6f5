# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable

import numpy as np
import pytest
from sim_builders import CAN, SPONGE, scene

from foretouch.errors import CloudError, SimulationError
from foretouch.simulation.effect import Effect, Job, SampleState, always, keys
from foretouch.simulation.engine import Engine, explain, plan_chain
from foretouch.simulation.scene import ObjectConfig, SceneConfig
from foretouch.simulation.world import SampleKey

SCENE = scene()


def never(_scene: SceneConfig, _item: ObjectConfig) -> str | None:
    return None


def effect(
    name: str,
    run: Callable[[Job, SampleState], None] = lambda _job, _state: None,
    *,
    needed: Callable[[SceneConfig, ObjectConfig], str | None] | None = None,
    reads: str = "",
    writes: str = "",
    modifies: str = "",
) -> Effect:
    declared = [keys(*names.split()) for names in (reads, writes, modifies)]
    return Effect(name, run, needed or always("x"), "x", *declared)


def names(effects: list[Effect], *outputs: str) -> list[str]:
    return [e.name for e in plan_chain(effects, SCENE, SCENE.objects[0], outputs)]


def test_makers_run_before_changers_before_readers() -> None:
    effects = [
        effect("read", reads="depth", writes="cloud"),
        effect("first change", modifies="depth"),
        effect("second change", modifies="depth"),
        effect("make", writes="depth"),
    ]
    assert names(effects, "cloud") == ["make", "first change", "second change", "read"]


def test_only_what_the_outputs_lead_to_runs() -> None:
    effects = [
        effect("make", writes="depth"),
        effect("normals", writes="normals"),
        effect("holes", reads="normals", modifies="depth", needed=never),
        effect("apart", writes="labels"),
    ]
    assert names(effects, "depth") == ["make"]
    called_for = [*effects[:2], effect("holes", reads="normals", modifies="depth"), effects[3]]
    assert names(called_for, "depth") == ["make", "normals", "holes"]


def test_explain_tells_the_field_or_why_not() -> None:
    effects = [
        effect("make", writes="depth"),
        effect("off", modifies="depth", needed=never),
        effect("apart", writes="labels"),
    ]
    told = {p.name: (p.runs, p.reason) for p in explain(SCENE, effects, ["depth"])}
    assert told == {"make": (True, "x"), "off": (False, "x"), "apart": (False, "nothing reads it")}


def test_a_key_without_a_maker_is_named() -> None:
    with pytest.raises(SimulationError, match=r"can: no effect of this scene makes depth"):
        names([effect("read", reads="depth", writes="cloud")], "cloud")


def test_two_makers_of_one_key_are_named() -> None:
    with pytest.raises(SimulationError, match=r"depth: is made by a and by b"):
        names([effect("a", writes="depth"), effect("b", writes="depth")], "depth")


def test_a_circle_is_named() -> None:
    effects = [effect("a", reads="labels", writes="depth"), effect("b", reads="depth", writes="labels")]
    with pytest.raises(SimulationError, match=r"needs .*: a circle"):
        names(effects, "depth")


def test_a_key_that_the_state_lacks_is_refused() -> None:
    with pytest.raises(SimulationError, match=r"has no key 'depths'"):
        keys("depths")


def reading(_job: Job, state: SampleState) -> None:
    assert state.pixels is not None


def writing(_job: Job, state: SampleState) -> None:
    state.labels = np.zeros((1, 1), np.int32)


@pytest.mark.parametrize(
    ("run", "message"), [(reading, "reads pixels, which it does not"), (writing, "writes labels, which it does not")]
)
def test_an_effect_cannot_touch_what_it_does_not_declare(run: Callable[[Job, SampleState], None], message: str) -> None:
    engine = Engine(SCENE, [effect("sly", run, writes="depth")], ("depth",))
    with pytest.raises(SimulationError, match=f"sly: {message}"):
        engine.run(SampleKey(0, 0))


def test_calls_and_time_are_counted_also_of_failures() -> None:
    def fail(job: Job, state: SampleState) -> None:
        if job.key.slot == 1:
            raise CloudError("too thin")
        state.depth = np.zeros(1)

    engine = Engine(SCENE, [effect("may fail", fail, writes="depth"), effect("idle", writes="labels")], ("depth",))
    engine.run(SampleKey(0, 0))
    with pytest.raises(SimulationError, match=r"can: may fail: too thin") as caught:
        engine.run(SampleKey(0, 1))
    assert caught.value.reason == "may fail"
    assert engine.timings["may fail"].calls == 2
    assert engine.timings["idle"].calls == 0


def test_objects_take_turns_and_have_chains_of_their_own() -> None:
    both = scene(CAN, SPONGE)
    soft = effect("soft", writes="relief", needed=lambda _s, item: None if item.rigid else "young_pa")
    rigid = effect("rigid", writes="relief", needed=lambda _s, item: "rigid" if item.rigid else None)
    engine = Engine(both, [soft, rigid], ("relief",))
    for slot in range(5):
        engine.run(SampleKey(0, slot))
    assert (engine.timings["rigid"].calls, engine.timings["soft"].calls) == (3, 2)
    assert {p.name: p.objects for p in explain(both, [soft, rigid], ["relief"])} == {
        "soft": ("sponge",),
        "rigid": ("can",),
    }


def test_each_effect_has_its_own_stream() -> None:
    drawn: dict[str, float] = {}

    def draw(job: Job, _state: SampleState) -> None:
        drawn[job.name] = job.rng().random()

    alone = [effect("a", draw, writes="depth")]
    Engine(SCENE, alone, ("depth",)).run(SampleKey(0, 0))
    before = dict(drawn)
    Engine(SCENE, [effect("b", draw, writes="labels"), *alone], ("labels", "depth")).run(SampleKey(0, 0))
    assert drawn["a"] == before["a"]
    assert drawn["b"] != drawn["a"]
