# SPDX-License-Identifier: Apache-2.0
import hashlib
from operator import attrgetter
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from sim_builders import CAN, EVERY_CAMERA_FAULT, EVERY_FINGER_EFFECT, SPONGE, made, run, scene

from foretouch.dataset.store import sample_digest
from foretouch.errors import SimulationError
from foretouch.tactile import touch_faults
from foretouch.types import Sample
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.simulate import Simulation, explain_scene
from foretouch_lab.simulation.world import SampleKey

FULL = {
    "camera": EVERY_CAMERA_FAULT,
    "clutter": {},
    "grasps": {"slide": True, "error": {}, "thumb": {"force_n": [1.5, 3.0]}},
    "gravity": {},
    "fingers": EVERY_FINGER_EFFECT,
}
LOADED = [CAN | {"mass_kg": 0.05, "colour": [200, 30, 30], "surface": {}}, SPONGE | {"mass_kg": 0.02}]


def digest(samples: list[Sample]) -> str:
    content = hashlib.sha256()
    for sample in samples:
        content.update(sample_digest(sample))
    return content.hexdigest()


def test_samples_are_whole_and_come_in_order_with_their_objects_in_turn() -> None:
    samples = made(scene(CAN, SPONGE), 3)
    assert [s.id for s in samples] == ["can/000000", "sponge/000001", "can/000002"]
    assert [s.extra["slot"] for s in samples] == [0, 1, 2]
    for sample in samples:
        assert touch_faults(sample.touch) == touch_faults(sample.tare) == ()
        assert sample.touch["PDC_TH"][0] > sample.tare["PDC_TH"][0]  # pressure rises
        assert (sample.tare["E_TH"] - sample.touch["E_TH"]).max() > 20  # and electrodes fall
        assert sample.extra["force_th_n"] == pytest.approx(sample.extra["target_th"], rel=1e-3)
        assert sample.extra["force_th_n"] == pytest.approx(sample.extra["force_mf_n"], rel=1e-3)


@pytest.mark.slow
def test_the_same_samples_on_one_worker_and_on_two_and_in_a_longer_run() -> None:
    config = scene(*LOADED, **FULL)
    single, spread = Simulation(config), Simulation(config)
    first, second = list(single.samples(34, 1)), list(spread.samples(34, 2))
    assert digest(first) == digest(second)
    assert digest(first[:3]) == digest(made(config, 3))
    assert single.failures_by_reason == spread.failures_by_reason
    assert single.calls == spread.calls
    assert digest(made(config.replace(seed=1), 3)) != digest(first[:3])


def test_an_effect_that_is_off_costs_no_call_and_one_that_is_on_is_named_with_its_objects() -> None:
    simulation = Simulation(scene())
    list(simulation.samples(2))
    always = {"object", "window", "render", "cloud", "grasp", "fingers", "targets", "posture", "first_touch", "relief"}
    always |= {"contact", "sensors", "fingertip", "moments", "counts"}
    assert simulation.calls == dict.fromkeys(always, 2)
    plans = {
        plan.name: plan for plan in explain_scene(scene(CAN, SPONGE | {"colour": [1, 2, 3]}, camera={"holes": {}}))
    }
    assert (plans["colour"].runs, plans["colour"].reason, plans["colour"].objects) == (
        True, "objects.colour", ("sponge",),
    )  # fmt: skip
    assert (plans["holes"].reason, plans["creep"].reason) == ("camera.holes", "no fingers.creep")
    assert plans["tares"].reason == "each grasp has a tare"


CLOUD = ("cloud.xyz", "grasp.g1", "grasp.g2")


def test_switching_an_effect_leaves_the_other_outputs_alone() -> None:
    cases: list[tuple[dict[str, Any], tuple[str, ...]]] = [
        ({"fingers": {"noise": {}}}, (*CLOUD, "target", "readings")),
        ({"fingers": {"drift": {}}}, (*CLOUD, "target", "readings")),
        ({"fingers": {"timeline": {}}}, (*CLOUD, "touch.values", "target")),
        ({"grasps": {"error": {}}}, CLOUD),
        ({"objects": [CAN | {"colour": [9, 9, 9]}]}, (*CLOUD, "touch.values", "depth", "target")),
        ({"objects": [CAN | {"surface": {}}]}, (*CLOUD, "depth", "target")),
        ({"gravity": {}, "objects": [CAN | {"mass_kg": 0.05}]}, (*CLOUD, "depth", "relief", "target")),
        ({"clutter": {"distance_m": [0.22, 0.25]}}, (*CLOUD, "touch.values", "target")),
        ({"camera": {"z_step_m": 0.001}}, ("exact_depth", "labels", "target")),
    ]

    def check(groups: dict[str, Any], kept: tuple[str, ...]) -> None:
        plain, changed = run(scene()), run(SceneConfig.from_mapping({"objects": [CAN], **groups}))
        for name in kept:
            first, second = attrgetter(name)(plain), attrgetter(name)(changed)
            np.testing.assert_array_equal(first, second, err_msg=name)

    every_case(cases, check)


def test_a_failure_is_counted_fails_again_when_replayed_and_ends_the_run_by_name() -> None:
    above = {"geograsp": {"method": "original"}}  # meets a lying can above its middle
    config = scene(CAN | {"friction": 0.35, "pose": {"rest": "any"}}, grasps=above, max_attempts=100)
    simulation = Simulation(config)
    samples = list(simulation.samples(3))
    assert len(samples) == 3
    assert set(simulation.failures_by_reason) <= {"slips", "misses", "no_grasp", "contact"}
    assert simulation.failures_by_reason["slips"] > 0
    failure, last = simulation.failures[0], samples[-1]
    with pytest.raises(SimulationError, match="slope") as caught:
        Engine(config, EFFECTS).run(failure.key)
    assert str(caught.value) == failure.message
    key = SampleKey(config.seed, int(last.extra["slot"]), int(last.extra["attempt"]))
    again = Engine(config, EFFECTS).run(key)
    np.testing.assert_array_equal(again.touch["E_TH"], last.touch["E_TH"])  # type: ignore[union-attr]
    simulation = Simulation(scene(CAN | {"friction": 0.0, "pose": {"rest": "any"}}, grasps=above, max_attempts=3))
    with pytest.raises(SimulationError, match=r"slot 0: given up after 3 attempts \(3 slips\); the last: can: the"):
        list(simulation.samples(2))
    assert simulation.failures_by_reason == {"slips": 3}
    long = CAN | {"size_m": [0.12, 0.3, 0.1], "shape": "box", "pose": {"rest": "upright"}}
    with pytest.raises(SimulationError, match=r"2 too_wide.*the hand opens 0.1 m"):
        list(Simulation(scene(long, grasps=above | {"max_width_m": 0.1}, max_attempts=2)).samples(1))


def test_a_repeated_grasp_differs_by_hand_and_sensor_only() -> None:
    config = scene(camera=EVERY_CAMERA_FAULT, grasps={"error": {}}, fingers={"noise": {}})
    first, again = run(config), run(config, repeat=1)
    np.testing.assert_array_equal(first.cloud.xyz, again.cloud.xyz)
    np.testing.assert_array_equal(first.grasp.g1, again.grasp.g1)
    assert again.target == pytest.approx(first.target, rel=0.5)
    assert again.target != first.target
    assert not np.array_equal(first.touch["E_TH"], again.touch["E_TH"])
    assert not np.array_equal(first.fingers[0].origin, again.fingers[0].origin)


def test_a_stream_is_seeded_by_scene_name_slot_and_attempt() -> None:
    digest = hashlib.sha256(b"noise").digest()[:16]
    words = np.frombuffer(digest, "<u4").tolist()
    expected = np.random.Generator(np.random.PCG64(np.random.SeedSequence((5, *words, 7, 2)))).random(4)
    np.testing.assert_array_equal(SampleKey(5, 7, 2).stream("noise").random(4), expected)
    keys = [SampleKey(0, 0), SampleKey(1, 0), SampleKey(0, 1), SampleKey(0, 0, 1)]
    assert len({key.stream(name).random() for key in keys for name in ("noise", "holes", "noise ")}) == 12
