# SPDX-License-Identifier: Apache-2.0
"""How hard the pads press: the object's weight, and the pressure by the level that the scene asks for."""

from functools import partial

import numpy as np

from foretouch.errors import SimulationError
from foretouch.types import Float64
from foretouch_lab.simulation.contact.grip import LEVELS, choose_level, solve_grip, weigh
from foretouch_lab.simulation.contact.pad import PadWindow, gap_field
from foretouch_lab.simulation.contact.problem import Command, ContactProblem, ElasticLayer
from foretouch_lab.simulation.effect import Effect, Job, SampleState
from foretouch_lab.simulation.effects.approach import pad_of
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.objects import POISSON, ObjectConfig

_GRAVITY_M_S2 = 9.81


def _weight(job: Job, state: SampleState) -> None:
    body = state.bodies[0]
    centre = body.position + (body.mesh.centroid * body.size) @ body.rotation.T
    thumb, middle = state.touches
    weight_n = np.array([0.0, 0.0, -(job.item.mass_kg or 0.0) * _GRAVITY_M_S2])
    state.weight = weigh(weight_n, thumb.origin, middle.origin, centre)
    state.tangential_n = -state.weight.tangential_n
    if job.scene.grasps.balanced:
        state.axial_load_n = state.weight.axial_n


def _solve(level: str, job: Job, state: SampleState) -> None:
    scene = job.scene
    pairs, balanced = zip(state.pads, state.relief, strict=True), scene.grasps.balanced
    problems = [contact_problem(job, pad, height) for pad, height in pairs]
    commands = [command_of(scene, float(target)) for target in state.targets]
    state.contacts = solve_grip(problems, commands, balanced=balanced, axial_load_n=state.axial_load_n, level=level)


def _layers_of(scene: SceneConfig, item: ObjectConfig) -> tuple[ElasticLayer, ...]:
    """The elastic layers in contact: the pad and, if it is soft, the object."""
    pad = scene.fingers.pad.layer
    if item.young_pa is None or item.thickness_m is None:
        return (pad,)
    return pad, ElasticLayer(modulus_pa=item.young_pa, poisson=POISSON, thickness_m=item.thickness_m)


def command_of(scene: SceneConfig, target: float) -> Command:
    """A finger's target as force or depth."""
    return Command(force_n=target) if scene.grasps.control == "force" else Command(depth_m=target)


def contact_problem(job: Job, window: PadWindow, behind: Float64) -> ContactProblem:
    """The gap between a pad and the surface behind its tangent plane; a `ContactError` if both exist nowhere."""
    return ContactProblem(gap_field(window.depth, -behind), pad_of(job).step_m, _layers_of(job.scene, job.item))


def _needs_level(level: str, scene: SceneConfig, item: ObjectConfig) -> str | None:
    if scene.fidelity != "auto":
        return f"fidelity: {level}" if scene.fidelity == level else None
    chosen, why = choose_level(_layers_of(scene, item))
    return f"fidelity: auto ({why})" if chosen == level else None


def _held(job: Job, state: SampleState) -> None:
    """Refuse a grasp out of which the object falls: where a tangential force exceeds Coulomb's limit."""
    across = np.linalg.norm(state.weight.tangential_n, axis=1)
    for finger, tangential_n, contact in zip(("thumb", "middle finger"), across, state.contacts, strict=True):
        if tangential_n > job.item.friction * contact.force_n:
            raise SimulationError(
                f"{job.item.name}: its weight slips through the {finger}, which presses with {contact.force_n:.2f} N",
                "falls",
            )


EFFECTS = (
    Effect(
        "weight",
        _weight,
        "gravity",
        reads=("bodies", "touches"),
        writes=("weight",),
        changes=("axial_load_n", "tangential_n"),
    ),
    *(
        Effect(
            f"contact_{level}",
            partial(_solve, level),
            partial(_needs_level, level),
            reads=("pads", "relief", "targets", "axial_load_n"),
            writes=("contacts",),
            off=f"fidelity: no object calls for {level}",
        )
        for level in LEVELS
    ),
    Effect("held", _held, "gravity", reads=("weight",), changes=("contacts",)),
)
