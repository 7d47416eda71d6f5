# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from sim_builders import CAN, SPONGE, run, scene

from foretouch.errors import ConvergenceError, SimulationError
from foretouch_lab.simulation.contact import grip
from foretouch_lab.simulation.simulate import Simulation, explain_scene


def level(*objects: dict[str, object], **groups: object) -> set[str]:
    return {p.name for p in explain_scene(scene(*objects, **groups)) if p.runs and p.name.startswith("contact_")}


def test_the_level_follows_the_object_and_a_solver_that_fails_is_counted_apart(monkeypatch) -> None:
    assert level(CAN) == {"contact_winkler"}
    assert level(SPONGE) == {"contact_layer"}
    assert level(CAN, SPONGE) == {"contact_winkler", "contact_layer"}
    assert level(CAN, SPONGE, fidelity="layer") == {"contact_layer"}

    def fail(*_: object) -> None:
        raise ConvergenceError("elastic layer: no convergence")

    monkeypatch.setitem(grip._SOLVERS, "layer", fail)
    with pytest.raises(SimulationError, match=r"sponge: contact_layer: elastic layer: no convergence") as caught:
        run(scene(SPONGE), "contacts")
    assert caught.value.reason == "not_converged"


def test_fingers_press_as_commanded_by_force_by_depth_and_each_by_itself() -> None:
    for item in (CAN, SPONGE):
        config = scene(item, grasps={"thumb": {"force_n": [1.5, 3.0]}, "insertion_m": 0.01})
        for slot in range(4):
            state = run(config, "contacts", "targets", slot=slot)
            assert [contact.force_n for contact in state.contacts] == pytest.approx([state.targets[0]] * 2, rel=1e-3)
    config = scene(grasps={"control": "depth", "thumb": {"depth_m": [0.0002, 0.0003]}, "insertion_m": 0.01})
    state = run(config, "contacts", "targets")
    thumb, middle = state.contacts
    assert thumb.depth_m + middle.depth_m == pytest.approx(state.targets.sum(), rel=1e-4)
    assert thumb.force_n == pytest.approx(middle.force_n, rel=1e-3)
    grasps = {"balanced": False, "middle": {"force_n": [0.5, 0.5]}, "thumb": {"force_n": [2, 2]}, "insertion_m": 0.01}
    state = run(scene(grasps=grasps), "contacts")
    assert [contact.force_n for contact in state.contacts] == pytest.approx([2.0, 0.5], rel=1e-3)


def test_weight_loads_one_finger_more_and_too_much_of_it_falls() -> None:
    state = run(
        scene(CAN | {"mass_kg": 0.05}, gravity={}, grasps={"insertion_m": 0.01}),
        "contacts",
        "axial_load_n",
        "tangential_n",
    )
    difference = state.contacts[1].force_n - state.contacts[0].force_n
    assert difference == pytest.approx(state.axial_load_n, abs=2e-3)
    across = np.linalg.norm(state.tangential_n.sum(axis=0))
    assert np.hypot(across, state.axial_load_n) == pytest.approx(0.05 * 9.81, rel=1e-6)
    config = scene(CAN | {"mass_kg": 2.0}, gravity={}, max_attempts=1)
    with pytest.raises(SimulationError, match=r"its weight slips through|opens a grip") as caught:
        list(Simulation(config).samples(1))
    assert caught.value.reason in {"falls", "contact"}
