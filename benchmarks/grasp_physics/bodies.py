# SPDX-License-Identifier: Apache-2.0
"""Hands with bodies: is the way in free, and does the hand hold? See README.md.

A grasp is *reached* if the hand of its description, at the planned pose, is at least 2 mm away from the true object and the table: opened, and 4, 8 and
12 cm before. Then it closes, lifts by 10 cm and shakes as the free tips of `simulation` do.
"""

import zlib
from functools import cache, lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Final, NamedTuple
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from benchmarks.grasp_physics.objects import Item, Placed
from benchmarks.grasp_physics.simulation import (
    BESIDE,
    END_S,
    HELD,
    LIFT,
    LIFT_S,
    OUT,
    SHAKE,
    SPIN_M,
    STEP_S,
    Body,
    arm_xml,
    object_xml,
    quaternion,
)
from foretouch.grasp.hand import FINGER, PALM, THUMB, Hand, load_hand
from foretouch.types import Float64

SHADOW: Final = "shadow_thumb_middle"
FORCES_N: Final = {SHADOW: 5.0, "franka_hand": 20.0, "robotiq_2f85": 20.0}
OFF_M, OFF_DEG = 0.005, 4.0  # of a palm that is not where it should be
NEAR_M: Final = 0.002  # what is nearer to the object, or to the table, is in the way
_BACK_M: Final = (0.04, 0.08, 0.12)
_CLOSE_S, _SQUEEZE_S = 1.0, 0.4
_BEYOND_M: Final = 0.012  # behind the planned contacts, where fingers that meet nothing stop


class Take(NamedTuple):
    """What became of a grasp that a hand executes."""

    reached: bool
    held: bool
    reason: str
    moved: int  # neighbours


class Planned(NamedTuple):
    """A planned grasp in the world."""

    frame: Float64  # (4, 4) float64, the frame of the grasp, see `foretouch.grasp.hand`
    width_m: float


def take(
    item: Item,
    pose: Float64,
    planned: Planned,
    hand: str,
    friction: float = 0.8,
    off: int | None = None,
    neighbours: tuple[Placed, ...] = (),
) -> Take:
    """Return whether a hand reaches a grasp and holds the object, at its pose (4, 4), object to world; the table is z = 0.

    Args:
        item: The object.
        pose: Its pose.
        planned: The grasp.
        hand: Name of the description.
        friction: Between the fingers and the object.
        off: Draws by how much the palm is off, by `OFF_M` and `OFF_DEG`; exact without.
        neighbours: Other objects, and their poses.
    """
    body = body_of(item, hand, friction) if not neighbours else _body(item, hand, friction, neighbours)
    frame = planned.frame.copy()
    where = body.obstruction(pose, planned._replace(frame=frame))
    if where:
        return Take(False, False, where, 0)
    if off is not None:
        rng = np.random.default_rng([zlib.crc32(item.name.encode()), off])
        shift, turn = (vector / np.linalg.norm(vector) for vector in rng.standard_normal((2, 3)))
        turned, rotation = np.zeros(4), np.zeros(9)
        mujoco.mju_axisAngle2Quat(turned, turn, np.radians(OFF_DEG))
        mujoco.mju_quat2Mat(rotation, turned)
        frame[:3, :3], frame[:3, 3] = rotation.reshape(3, 3) @ frame[:3, :3], frame[:3, 3] + OFF_M * shift
    reason = body.grip(pose, planned._replace(frame=frame), FORCES_N[hand])
    return Take(True, reason == HELD, reason, body.moved())


@lru_cache(maxsize=8)
def body_of(item: Item, hand: str, friction: float) -> "HandBody":
    """Return the simulated world of an object and a hand, built once."""
    return _body(item, hand, friction, ())


def _body(item: Item, hand: str, friction: float, neighbours: tuple[Placed, ...]) -> "HandBody":
    return (ShadowBody if hand == SHADOW else JawBody)(item, load_hand(hand), friction, neighbours)


class HandBody(Body):
    """A hand on a mount that is placed in the world."""

    fingers: tuple[int, ...]  # its shapes

    def __init__(self, item: Item, hand: Hand, xml: str, neighbours: tuple[Placed, ...]) -> None:
        super().__init__(item, xml, neighbours)
        self.hand = hand

    def near(self) -> str:
        """Return the part of the hand that is too near to the object or the table, by name; "" if none is."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        for k in range(self.data.ncon):
            pair = self.data.contact[k].geom1, self.data.contact[k].geom2
            for mine, other in (pair, pair[::-1]):
                if self.of_object[mine] or self.of_neighbour[mine] or mine == self.table:
                    continue
                if self.of_object[other]:
                    return f"{self.part(mine)} meets the object"
                if self.of_neighbour[other]:
                    return f"{self.part(mine)} meets a neighbour"
                if other == self.table and self.data.contact[k].dist < (0.0 if mine in self.pads else NEAR_M):
                    return f"{self.part(mine)} meets the table"
        return ""

    def part(self, geom: int) -> str:
        """Return what a shape of the hand belongs to."""
        return "finger" if geom in self.fingers else "palm or arm"

    def obstruction(self, pose: Float64, planned: Planned) -> str:
        """Return what is in the way; "" if nothing is."""
        raise NotImplementedError

    def grip(self, pose: Float64, planned: Planned, force_n: float) -> str:
        """Close, lift and shake; return `HELD`, or what went wrong."""
        raise NotImplementedError


class JawBody(HandBody):
    """Parallel jaws made of the boxes of a description."""

    def __init__(self, item: Item, hand: Hand, friction: float, neighbours: tuple[Placed, ...]) -> None:
        at = hand.at(0.0)
        boxes = {
            part: [c for c, own in zip(at.corners, hand.parts, strict=True) if own == part]
            for part in (FINGER, THUMB, PALM)
        }
        solid = 'contype="2" conaffinity="0"'
        rough = f'mass=".05" condim="4" priority="1" friction="{friction} {SPIN_M} .0001"'
        jaws = "".join(
            f'<body name="{part}" gravcomp="1"><joint name="{part}" type="slide" axis="{axis} 0 0" damping="20"/>'
            f"{''.join(_box(f'{part}{k}', box, f'{solid} {rough}') for k, box in enumerate(boxes[part]))}</body>"
            for part, axis in ((FINGER, 1), (THUMB, -1))
        )
        palms = "".join(
            _box(f"palm{k}", corners, f'{solid} mass=".7" friction=".3 .005 .0001"')
            for k, corners in enumerate(boxes[PALM])
        )
        meshes, scene = object_xml(item, NEAR_M, [one for one, _ in neighbours])
        slides, inertial, drives = arm_xml(50000.0, 700.0)
        super().__init__(
            item,
            hand,
            f"""<mujoco><compiler angle="radian" balanceinertia="true" boundmass="1e-6" boundinertia="1e-9"/>
<option timestep="{STEP_S}" integrator="implicitfast" cone="elliptic" impratio="10"/><asset>{meshes}</asset><worldbody>{scene}
<body name="arm" gravcomp="1">{inertial}{slides}<body name="mount" gravcomp="1">{palms}{jaws}</body></body></worldbody>
<equality><joint joint1="{FINGER}" joint2="{THUMB}" polycoef="0 1 0 0 0" solref=".004 1"/></equality>
<actuator>{drives}<motor joint="{FINGER}"/><motor joint="{THUMB}"/></actuator></mujoco>""",
            neighbours,
        )
        self.pads = tuple(self.model.geom(f"{name}0").id for name in (FINGER, THUMB))
        self.fingers = tuple(
            np.flatnonzero(np.isin(self.model.geom_bodyid, [self.model.body(name).id for name in (FINGER, THUMB)]))
        )
        self._palms = [self.model.geom(f"palm{k}").id for k in range(len(boxes[PALM]))]
        self._behind_m = self.model.geom_pos[self._palms, 2] - at.tool[2, 3]
        self._slides = [self.model.joint(name).qposadr[0] for name in (FINGER, THUMB)]

    def _open(self, pose: Float64, planned: Planned, back_m: float, opened: bool) -> None:
        config = self.hand.config
        wide = min(config.opening_m + 0.004, planned.width_m + 2.0 * config.open_m) if opened else planned.width_m
        self.reset(pose)
        mount = planned.frame.copy()
        mount[:3, 3] -= back_m * mount[:3, 2]
        self.place(mount)
        self.model.geom_pos[self._palms, 2] = self._behind_m + self.hand.at(planned.width_m).tool[2, 3]
        self.data.qpos[self._slides] = -wide / 2.0

    def obstruction(self, pose: Float64, planned: Planned) -> str:
        """Return what is in the way of the opened hand and on the way in; jaws are parallel, so that they are as deep when closed."""
        for back in (0.0, *_BACK_M):
            self._open(pose, planned, back, opened=True)
            if obstacle := self.near():
                return obstacle
        return ""

    def grip(self, pose: Float64, planned: Planned, force_n: float) -> str:
        """Close both jaws with the force, lift and shake."""
        self._open(pose, planned, 0.0, opened=True)
        self.data.ctrl[3:5] = force_n
        mujoco.mj_forward(self.model, self.data)
        touched = False
        for step in range(round((_SQUEEZE_S + 0.1 + END_S) / STEP_S)):
            time = step * STEP_S - _SQUEEZE_S - 0.1
            if time >= 0.0:
                self.lift(time)
            mujoco.mj_step(self.model, self.data)
            if step % 5 == 0 and time < 0.0:
                both = all(pad in self.touch() for pad in self.pads)
                touched |= both
            if step % 50 == 0 and time > 0.0:
                touch = self.touch()
                if time < 0.1 and not both:
                    return OUT if touched else BESIDE
                if not any(pad in touch for pad in self.pads):
                    return LIFT if time < LIFT_S else SHAKE
        return self.ending()


def _box(name: str, corners: Float64, rest: str) -> str:
    """Return a box of MuJoCo from its corners (8, 3)."""
    edges = corners[[4, 2, 1]] - corners[0]
    length = np.linalg.norm(edges, axis=1)
    size = length / 2.0
    middle = corners.mean(axis=0)
    turn = quaternion((edges / length[:, None]).T)
    texts = (" ".join(f"{v:.6g}" for v in numbers) for numbers in (size, middle, turn))
    return '<geom name="{}" type="box" size="{}" pos="{}" quat="{}" {}/>'.format(name, *texts, rest)


@cache
def _shadow_files() -> tuple[str, Path]:
    """Return the hand of the MuJoCo model in the package gymnasium-robotics, without what is only seen, and the folder of its meshes."""
    package = find_spec("gymnasium_robotics")
    if package is None or package.origin is None:
        raise SystemExit("benchmarks: the Shadow Hand needs `pip install --no-deps gymnasium-robotics`")
    assets = Path(package.origin).parent / "envs" / "assets"
    tree = ET.parse(assets / "hand" / "robot.xml")
    mount = tree.getroot().find("body")
    assert mount is not None
    for parent in list(mount.iter()):
        for child in list(parent):
            name = child.get("name", "")
            if child.tag == "site" or (child.tag == "geom" and ":V_" in name):
                parent.remove(child)
            if child.tag == "body":
                child.set("gravcomp", "1")
    mount.attrib.clear()
    mount.attrib.update(name="mount", gravcomp="1")
    return ET.tostring(mount, encoding="unicode"), assets / "stls" / "hand"


_FINGER_JOINTS: Final = ("MFJ3", "MFJ2", "MFJ1", "MFJ0")  # as the model counts them, in the order of the description
_THUMB_JOINTS: Final = ("THJ4", "THJ3", "THJ2", "THJ1", "THJ0")
_TORQUES_NM: Final = (0.9, 0.9, 0.7245, 0.7245, 2.3722, 1.45, 0.99, 0.99, 0.81)  # of the model's actuators
_COUPLED: Final = 0.00805 / 0.00705  # of MFJ0 to MFJ1, as the model's tendon
_STIFF_NM, _DAMPED_NMS = 3.0, 0.06
_TIP_ENDS: Final = (0.012, 0.013)  # from the middle of a distal capsule to that of its end
_PALM_M: Final = (0.0, 0.01, 0.29)  # of the palm in the mount, wrist neutral
_SIGNS: Final = (-1, 1, 1, 1, 1, 1, 1, -1, -1)  # of the joints' angles in the model, against Shadow's URDF
_WAY: Final = 17  # postures from opened to beyond the contacts


class ShadowBody(HandBody):
    """The Shadow Hand, driven in its thumb and middle finger; the others are straight."""

    def __init__(self, item: Item, hand: Hand, friction: float, neighbours: tuple[Placed, ...]) -> None:
        mount, meshes_at = _shadow_files()
        mount = mount.replace('condim="4"', f'condim="4" priority="1" friction="{friction} {SPIN_M} 0.0001"')
        meshes, scene = object_xml(item, NEAR_M, [one for one, _ in neighbours])
        slides, inertial, drives = arm_xml(100000.0, 1500.0)
        others = "".join(
            f'<position name="{f}FJ{k}" joint="robot0:{f}FJ{k}" kp="5" kv=".2"/>' for f in "FRL" for k in range(4)
        )
        wrist = "".join(f'<position joint="robot0:WRJ{k}" kp="300" kv="10"/>' for k in (0, 1))
        super().__init__(
            item,
            hand,
            f"""<mujoco><compiler angle="radian" meshdir="{meshes_at}" balanceinertia="true" boundmass="1e-6" boundinertia="1e-9"/>
<option timestep="{STEP_S}" integrator="implicitfast" cone="elliptic" impratio="10"/>
<default><default class="robot0:asset_class"><geom friction="0.6 0.005 0.0001" condim="4"/>
<joint limited="true" damping="0.1" armature="0.001" frictionloss="0.001"/></default><default class="robot0:DC_Hand"><geom contype="2" conaffinity="0"/></default></default>
<asset><mesh name="robot0:forearm_cvx" file="forearm_electric_cvx.stl"/>{meshes}</asset><worldbody>{scene}
<body name="arm" gravcomp="1">{inertial}{slides}{mount}</body></worldbody>
<equality><joint joint1="robot0:MFJ0" joint2="robot0:MFJ1" polycoef="0 {_COUPLED} 0 0 0" solref=".004 1"/></equality>
<actuator>{drives}{wrist}{others}<position joint="robot0:LFJ4" kp="20" kv=".5"/></actuator></mujoco>""",
            neighbours,
        )
        joints = [self.model.joint(f"robot0:{name}") for name in (*_FINGER_JOINTS, *_THUMB_JOINTS)]
        self._places = np.array([int(joint.qposadr[0]) for joint in joints])
        self._speeds = np.array([int(joint.dofadr[0]) for joint in joints])
        self.pads = tuple(self.model.geom(f"robot0:C_{name}distal").id for name in ("mf", "th"))
        names = [self.model.geom(k).name for k in range(self.model.ngeom)]
        self.fingers = tuple(k for k, name in enumerate(names) if name.startswith(("robot0:C_mf", "robot0:C_th")))
        self._bodies = [int(self.model.geom_bodyid[pad]) for pad in self.pads]

    def _ends(self, data: mujoco.MjData) -> Float64:
        """Return (2, 3) float64 [m], the middles of both fingertips' ends."""
        pairs = zip(self.pads, _TIP_ENDS, strict=True)
        return np.array([data.geom_xpos[pad] + end * data.geom_xmat[pad].reshape(3, 3)[:, 2] for pad, end in pairs])

    def _angles(self, width_m: float) -> Float64:
        """Return (9,) float64 [rad], the posture at a width as the MuJoCo model counts it."""
        return self.hand.at(width_m).posture * _SIGNS

    def _mounted(self, planned: Planned) -> Float64:
        at = self.hand.at(planned.width_m)
        mount: Float64 = planned.frame @ at.tool
        mount[:3, 3] -= mount[:3, :3] @ _PALM_M
        return mount

    def obstruction(self, pose: Float64, planned: Planned) -> str:
        """Return what is in the way of the opened hand and on the way in."""
        self.reset(pose)
        mount = self._mounted(planned)
        opened = self._angles(planned.width_m + 2.0 * self.hand.config.open_m)
        for back in (0.0, *_BACK_M):
            moved = mount.copy()
            moved[:3, 3] -= back * planned.frame[:3, 2]
            self.place(moved)
            self.data.qpos[self._places] = opened
            if obstacle := self.near():
                return obstacle
        return ""

    def grip(self, pose: Float64, planned: Planned, force_n: float) -> str:
        """Move each finger in until it touches or is `_BEYOND_M` behind its contact, then let both push along the line between their tips."""
        model, data = self.model, self.data
        self.reset(pose)
        self.place(self._mounted(planned))
        widths = planned.width_m + 2.0 * np.linspace(self.hand.config.open_m, -_BEYOND_M, _WAY)
        table = np.array([self._angles(width) for width in widths.tolist()])
        at = [0.0, 0.0]
        on = [False, False]
        wanted = table[0].copy()
        data.qpos[self._places] = wanted
        mujoco.mj_forward(model, data)
        touch = self.touch()
        closed, jacobian = np.inf, np.zeros((3, model.nv))
        for step in range(round((_CLOSE_S + _SQUEEZE_S + END_S) / STEP_S) + 50):
            time = step * STEP_S
            if step % 2 == 0:
                touch = self.touch()
            if closed == np.inf:
                for side, own in ((0, slice(0, 4)), (1, slice(4, 9))):
                    on[side] |= touch.get(self.pads[side], 0.0) > 0.15
                    if not on[side]:
                        at[side] = min(_WAY - 1.0, at[side] + STEP_S * (_WAY - 1) / _CLOSE_S)
                        low = int(at[side])
                        part = at[side] - low
                        wanted[own] = (1.0 - part) * table[low, own] + part * table[min(low + 1, _WAY - 1), own]
                if all(there or place >= _WAY - 1.0 for there, place in zip(on, at, strict=True)):
                    closed = time
            lifted = time - closed - _SQUEEZE_S
            if 0.0 <= lifted < STEP_S and not all(pad in touch for pad in self.pads):
                return OUT if all(on) else BESIDE
            if lifted >= 0.0:
                self.lift(lifted)
                if step % 50 == 0 and not any(pad in touch for pad in self.pads):
                    return LIFT if lifted < LIFT_S else SHAKE
            if lifted > END_S:
                break
            torque = _STIFF_NM * (wanted - data.qpos[self._places]) - _DAMPED_NMS * data.qvel[self._speeds]
            if closed < np.inf:
                ends = self._ends(data)
                along = (
                    force_n * min(1.0, (time - closed) / 0.15) * (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
                )
                for body, end, sign in zip(self._bodies, ends, (1.0, -1.0), strict=True):
                    mujoco.mj_jac(model, data, jacobian, None, end, body)
                    torque += jacobian[:, self._speeds].T @ (sign * along)
            data.qfrc_applied[self._speeds] = np.clip(torque, -np.array(_TORQUES_NM), _TORQUES_NM)
            mujoco.mj_step(model, data)
        return self.ending()
