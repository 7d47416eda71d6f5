# SPDX-License-Identifier: Apache-2.0
"""Closes two spherical fingertips on an object in MuJoCo, lifts it and shakes it.

    0.0 s  tips 3 cm outside of the planned contacts move towards each other along their line, with 5 N each
    0.5 s  the first keeps its place along the line from now on; the hand rises 10 cm
    1.0 s  the hand shakes, 5 mm along x and 2.5 mm along y at 4 Hz
    1.5 s  it rests
    2.0 s  held: both tips touch the object, and the table carries less than a fifth of its weight

There is no hand: no kinematics, no palm, nothing that could meet the object but the tips, and the tips pass through the
table. How far below it they would be is part of the answer.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import mujoco
import numpy as np

from benchmarks.grasp_physics.objects import Item, Placed
from foretouch.types import Float64

FORCE_N: Final = 5.0
OUTSIDE_M: Final = 0.03  # from a planned contact to the middle of its tip, at first
LIFT_M: Final = 0.10
SHAKE_M: Final = (0.005, 0.0025)
SHAKE_HZ: Final = 4.0
CLOSED_S: Final = 0.5
LIFT_S: Final = 0.5  # after closing, as the next two: the hand rises
SHAKE_S: Final = 1.0  # shakes until then
END_S: Final = 1.5  # and rests
SPIN_M: Final = 0.005  # friction against a turn of the tip about its normal, torque over force
TABLE_SHARE: Final = 0.2  # of the weight
OPENING_M: Final = 0.10  # largest distance of the contacts
SUNK_M: Final = 0.001  # a tip may be this far below the table and count as clear of it
STEP_S: Final = 0.002
MOVED_M: Final = 0.01
TURNED_DEG: Final = 10.0
_CHECKED = 5  # steps from one check to the next while closing
_HOLD_N_M, _HOLD_NS_M = 5000.0, 60.0  # of the first tip's place, once closed

HELD: Final = "held"
INSIDE: Final = "starts inside the object"
BESIDE: Final = "closes beside the object"
OUT: Final = "squeezed out while closing"
LIFT: Final = "slips while lifted"
SHAKE: Final = "slips while shaken"
HANGS: Final = "hangs on the table"
UNSTABLE: Final = "simulation diverges"


class Verdict(NamedTuple):
    """Whether a grasp holds, whether the hand could also do it, and why not."""

    held: bool
    strict: bool  # held, tips clear of the table on their way in, contacts no farther apart than the hand opens
    reason: str


def held(
    item: Item,
    pose: Float64,
    g1: Float64,
    g2: Float64,
    tip_radius_m: float = 0.008,
    friction: float = 0.8,
    opening_m: float = OPENING_M,
) -> Verdict:
    """Return whether a grasp holds an object.

    Args:
        item: The object.
        pose: (4, 4) float64, object to world; the table is z = 0.
        g1: (3,) float64, planned contact, world [m].
        g2: (3,) float64, the other one.
        tip_radius_m: Radius of the two spherical tips [m].
        friction: Between tips and object.
        opening_m: Largest distance of the contacts [m].
    """
    return grip(item, tip_radius_m, friction).close(pose, g1, g2, opening_m)


@lru_cache(maxsize=16)
def grip(item: Item, tip_radius_m: float, friction: float) -> "Grip":
    """Return the simulated world of one object and two tips, built once."""
    return Grip(item, tip_radius_m, friction)


class Body:
    """An object, the table and what holds the object: a mount that is placed in the world, on an arm that lifts and shakes it.

    Args:
        item: The object.
        xml: The model of MuJoCo.
        neighbours: Other objects in it, and their poses.
    """

    pads: tuple[int, ...]  # shapes of both sides that hold

    def __init__(self, item: Item, xml: str, neighbours: Sequence[Placed] = ()) -> None:
        self.weight_n, self.neighbours = item.mass_kg * 9.81, neighbours
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        self.object, self.mount = self.model.body("object").id, self.model.body("mount").id
        self.table = self.model.geom("table").id
        self.of_object = self.model.geom_bodyid == self.object
        others = [self.model.body(f"neighbour{k + 1}").id for k in range(len(neighbours))]
        self.of_neighbour = np.isin(self.model.geom_bodyid, others)
        self._free = [self.model.jnt_qposadr[self.model.body_jntadr[body]] for body in (self.object, *others)]

    def reset(self, pose: Float64) -> None:
        """Put the object and its neighbours back."""
        mujoco.mj_resetData(self.model, self.data)
        for at, where in zip(self._free, (pose, *(where for _, where in self.neighbours)), strict=True):
            self.data.qpos[at : at + 3], self.data.qpos[at + 3 : at + 7] = where[:3, 3], quaternion(where[:3, :3])

    def moved(self) -> int:
        """Return how many neighbours are more than `MOVED_M` from where they stood, or turned by more than `TURNED_DEG`."""
        number = 0
        for at, (_, pose) in zip(self._free[1:], self.neighbours, strict=True):
            now = self.data.qpos[at : at + 7]
            shift = float(np.linalg.norm(now[:3] - pose[:3, 3]))
            turn = 2.0 * np.degrees(np.arccos(min(1.0, abs(float(now[3:] @ quaternion(pose[:3, :3]))))))
            number += shift > MOVED_M or turn > TURNED_DEG
        return number

    def place(self, mount: Float64) -> None:
        """Put the mount (4, 4) somewhere in the world."""
        self.model.body_pos[self.mount], self.model.body_quat[self.mount] = mount[:3, 3], quaternion(mount[:3, :3])

    def touch(self) -> dict[int, float]:
        """Return the normal force [N] on the object by the shape that touches it."""
        force, forces = np.zeros(6), dict[int, float]()
        for k in range(self.data.ncon):
            pair = self.data.contact[k].geom1, self.data.contact[k].geom2
            for mine, other in (pair, pair[::-1]):
                if self.of_object[other] and not self.of_object[mine] and self.data.contact[k].dist < 0.0:
                    mujoco.mj_contactForce(self.model, self.data, k, force)
                    forces[mine] = forces.get(mine, 0.0) + float(force[0])
        return forces

    def lift(self, time_s: float) -> None:
        """Set the arm's drives for a time after closing."""
        raised = min(1.0, time_s / LIFT_S)
        self.data.ctrl[0] = LIFT_M * raised * raised * (3.0 - 2.0 * raised)
        shaken = np.sin(2.0 * np.pi * SHAKE_HZ * (time_s - LIFT_S)) if LIFT_S <= time_s < SHAKE_S else 0.0
        self.data.ctrl[1:3] = np.multiply(SHAKE_M, shaken)

    def ending(self) -> str:
        """Return whether both sides hold the object in the end, and the table carries less than a fifth of it."""
        if not np.isfinite(self.data.qpos).all():
            return UNSTABLE
        touch = self.touch()
        if not all(pad in touch for pad in self.pads):
            return SHAKE
        return HELD if touch.get(self.table, 0.0) < TABLE_SHARE * self.weight_n else HANGS


class Grip(Body):
    """Two tips without a hand, which collide with the object alone.

    Args:
        item: The object.
        tip_radius_m: Radius of the tips [m].
        friction: Between tips and object; between table and object it is 0.6.
        neighbours: Other objects, with which the tips collide, too, and their poses.
    """

    def __init__(self, item: Item, tip_radius_m: float, friction: float, neighbours: Sequence[Placed] = ()) -> None:
        super().__init__(item, _xml(item, tip_radius_m, friction, [one for one, _ in neighbours]), neighbours)
        self.radius_m = tip_radius_m
        self.pads = tuple(self.model.geom(name).id for name in ("tip1", "tip2"))
        self._bodies = [self.model.body(name).id for name in ("tip1", "tip2")]
        self._joint = self.model.joint("close1")

    def close(self, pose: Float64, g1: Float64, g2: Float64, opening_m: float = OPENING_M) -> Verdict:
        """Close on the object from outside of two contacts, lift and shake.

        Args:
            pose: (4, 4) of the object in the world.
            g1: (3,) contact in the world [m].
            g2: (3,) the other contact [m].
            opening_m: Largest distance of the contacts [m].
        """
        if not float(np.linalg.norm(g2 - g1)) > 1e-4:
            return Verdict(False, False, BESIDE)
        self._start(pose, g1, g2)
        if self._starts_inside():
            return Verdict(False, False, INSIDE)
        clear = self._clearance()
        touched = False
        for _ in range(round(CLOSED_S / STEP_S) // _CHECKED):
            mujoco.mj_step(self.model, self.data, _CHECKED)
            touch = self.touch()
            both = all(pad in touch for pad in self.pads)
            touched |= both
        if not both:
            return Verdict(False, False, OUT if touched else BESIDE)
        faults = {"through the table": min(clear, self._clearance()) < -SUNK_M, "too wide": self._opening() > opening_m}
        reason = self._lift_and_shake()
        if reason != HELD:
            return Verdict(False, False, reason)
        faulty = [name for name, there in faults.items() if there]
        return Verdict(True, not faulty, ", ".join([HELD, *faulty]))

    def _start(self, pose: Float64, g1: Float64, g2: Float64) -> None:
        self.reset(pose)
        width = float(np.linalg.norm(g2 - g1))
        along = (g2 - g1) / width
        across = np.cross([0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0], along)
        across /= np.linalg.norm(across)
        mount = np.eye(4)
        mount[:3, :3] = np.stack([along, across, np.cross(along, across)], axis=1)
        mount[:3, 3] = (g1 + g2) / 2.0
        self.place(mount)
        for body, sign in zip(self._bodies, (-1.0, 1.0), strict=True):
            self.model.body_pos[body] = [sign * (width / 2.0 + OUTSIDE_M), 0.0, 0.0]
        self.data.ctrl[3:5] = FORCE_N
        mujoco.mj_forward(self.model, self.data)

    def _starts_inside(self) -> bool:
        contacts = (self.data.contact[i] for i in range(self.data.ncon))
        return any(c.dist < -0.001 and not {c.geom1, c.geom2}.isdisjoint(self.pads) for c in contacts)

    def _lift_and_shake(self) -> str:
        data = self.data
        place = float(data.qpos[self._joint.qposadr[0]])
        for step in range(round(END_S / STEP_S)):
            moved, speed = data.qpos[self._joint.qposadr[0]] - place, data.qvel[self._joint.dofadr[0]]
            data.ctrl[5] = -_HOLD_N_M * moved - _HOLD_NS_M * speed
            self.lift(step * STEP_S)
            mujoco.mj_step(self.model, data)
            if step % (10 * _CHECKED) == 0 and self.touch().keys().isdisjoint(self.pads):
                return LIFT if step * STEP_S < LIFT_S else SHAKE
        return self.ending()

    def _opening(self) -> float:
        """Return the distance of the contacts of both tips [m]."""
        contacts = [self.data.contact[i] for i in range(self.data.ncon)]
        first, second = (np.mean([c.pos for c in contacts if tip in {c.geom1, c.geom2}], axis=0) for tip in self.pads)
        return float(np.linalg.norm(first - second))

    def _clearance(self) -> float:
        return float(self.data.geom_xpos[list(self.pads), 2].min()) - self.radius_m


def quaternion(rotation: Float64) -> Float64:
    """Return (4,) float64, w first, of a (3, 3) rotation."""
    result = np.zeros(4)
    mujoco.mju_mat2Quat(result, np.ascontiguousarray(rotation).ravel())
    return result


ROUGH: Final = 'condim="4" friction="0.6 0.005 0.0001"'


def object_xml(item: Item, near_m: float = 0.0, neighbours: Sequence[Item] = ()) -> tuple[str, str]:
    """Return the meshes of an object and its neighbours, and table and objects as MuJoCo reads them; what is nearer than that is found, without a force."""
    near = f'gap="{near_m}"' if near_m else ""
    table = (
        f'<geom name="table" type="plane" size="2 2 .1" contype="1" conaffinity="{3 if near_m else 1}" {ROUGH} {near}/>'
    )
    bodies = [_body_xml(one, f"neighbour{k}" if k else "object", near) for k, one in enumerate((item, *neighbours))]
    meshes, solids = ("".join(texts) for texts in zip(*bodies, strict=True))
    return meshes, table + solids


def _body_xml(item: Item, name: str, near: str) -> tuple[str, str]:
    names = [f"{name}_part{i}" for i in range(len(item.parts))]
    vertices = [" ".join(f"{value:.7f}" for value in part.vertices.ravel()) for part in item.parts]
    meshes = "".join(f'<mesh name="{n}" vertex="{v}"/>' for n, v in zip(names, vertices, strict=True))
    parts = "".join(
        f'<geom type="mesh" mesh="{n}" contype="1" conaffinity="3" {ROUGH} {near} mass="0"/>' for n in names
    )
    i = item.inertia + 1e-7 * np.eye(3)  # no thinner than MuJoCo can invert
    inertia = " ".join(f"{v:.9g}" for v in (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]))
    centre = " ".join(f"{v:.9g}" for v in item.centre)
    inertial = f'<inertial pos="{centre}" mass="{item.mass_kg}" fullinertia="{inertia}"/>'
    return meshes, f'<body name="{name}"><freejoint/>{inertial}{parts}</body>'


def arm_xml(kp: float, kv: float) -> tuple[str, str, str]:
    """Return the joints of a hand that is lifted and shaken, its arm's inertia, and the drives, which come first."""
    axes = (("z", "0 0 1"), ("x", "1 0 0"), ("y", "0 1 0"))
    slides = "".join(f'<joint name="{name}" type="slide" axis="{axis}" damping="10"/>' for name, axis in axes)
    drives = "".join(f'<position joint="{name}" kp="{kp:g}" kv="{kv:g}"/>' for name, _ in axes)
    return slides, '<inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/>', drives


def _xml(item: Item, tip_radius_m: float, friction: float, neighbours: Sequence[Item]) -> str:
    """Return the model; the tips' friction counts at their contacts, and they collide with objects alone."""
    meshes, scene = object_xml(item, neighbours=neighbours)
    tip = f'type="sphere" size="{tip_radius_m}" mass="0.05" contype="2" conaffinity="0" condim="4" priority="1" friction="{friction} {SPIN_M} 0.0001"'
    tips = "".join(
        f'<body name="tip{k}" gravcomp="1"><joint name="close{k}" type="slide" axis="{axis} 0 0" damping="25"/>'
        f'<geom name="tip{k}" {tip}/></body>'
        for k, axis in ((1, 1), (2, -1))
    )
    slides, inertial, drives = arm_xml(20000.0, 300.0)
    return f"""<mujoco>
<compiler angle="radian" balanceinertia="true" boundmass="1e-6" boundinertia="1e-9"/>
<option timestep="{STEP_S}" integrator="implicitfast" cone="elliptic" impratio="10"/>
<asset>{meshes}</asset>
<worldbody>
{scene}
<body name="arm" gravcomp="1">{inertial}{slides}
<body name="mount">{tips}</body></body>
</worldbody>
<actuator>{drives}<motor joint="close1"/><motor joint="close2"/><motor joint="close1"/></actuator>
</mujoco>"""
