# SPDX-License-Identifier: Apache-2.0
"""How hard the pads press: the object's weight, and the pressure by the level that the scene asks for."""

from collections.abc import Callable

import numpy as np

from foretouch.errors import ContactError, SimulationError
from foretouch.simulation.contact import LEVELS, Level, choose_level, solve_grip, weigh
from foretouch.simulation.effect import Effect, Job, SampleState, called_for, keys
from foretouch.simulation.finger_contact import command_of, contact_failure, contact_problem, layers_of
from foretouch.simulation.scene import ObjectConfig, SceneConfig


def _weight(job: Job, state: SampleState) -> None:
    gravity, mass = job.scene.gravity, job.item.mass_kg
    if gravity is None or mass is None:
        return
    body = state.bodies[0]
    centre = body.position + (body.mesh.centroid * body.size) @ body.rotation.T
    thumb, middle = state.touches
    state.weight = weigh(np.array([0.0, 0.0, -mass * gravity.m_s2]), thumb.origin, middle.origin, centre)
    if job.scene.grasps.balanced:
        state.axial_load_n = state.weight.axial_n


def _solve(level: Level) -> Callable[[Job, SampleState], None]:
    def run(job: Job, state: SampleState) -> None:
        scene, item = job.scene, job.item
        try:
            grip = solve_grip(
                [
                    contact_problem(scene, item, pad, height)
                    for pad, height in zip(state.pads, state.relief, strict=True)
                ],
                [command_of(scene, float(target)) for target in state.targets],
                balanced=scene.grasps.balanced,
                axial_load_n=state.axial_load_n,
                level=level,
                config=scene.fingers.contact,
            )
        except ContactError as err:
            raise contact_failure(f"{item.name}: {err}", err) from err
        state.contacts = grip.first, grip.second

    return run


def _needed_at(level: str) -> Callable[[SceneConfig, ObjectConfig], str | None]:
    def needed(scene: SceneConfig, item: ObjectConfig) -> str | None:
        if scene.fidelity != "auto":
            return f"fidelity: {level}" if scene.fidelity == level else None
        chosen, why = choose_level(layers_of(scene, item))
        return f"fidelity: auto ({why})" if chosen == level else None

    return needed


def _held(job: Job, state: SampleState) -> None:
    """Refuse a grasp out of which the object falls."""
    forces = state.contacts[0].force_n, state.contacts[1].force_n
    slips = state.weight.slips(forces, job.item.friction)
    for finger, slipping, force in zip(("thumb", "middle finger"), slips, forces, strict=True):
        if slipping:
            raise SimulationError(
                f"{job.item.name}: its weight slips through the {finger}, which presses with {force:.2f} N", "falls"
            )


EFFECTS = (
    Effect(
        "weight",
        _weight,
        called_for("gravity"),
        off="no gravity",
        reads=keys("bodies", "touches"),
        writes=keys("weight"),
        modifies=keys("axial_load_n"),
    ),
    *(
        Effect(
            f"contact_{level}",
            _solve(level),
            _needed_at(level),
            off=f"fidelity: no object calls for {level}",
            reads=keys("pads", "relief", "targets", "axial_load_n"),
            writes=keys("contacts"),
        )
        for level in LEVELS
        if level != "auto"
    ),
    Effect("held", _held, called_for("gravity"), off="no gravity", reads=keys("weight"), modifies=keys("contacts")),
)
