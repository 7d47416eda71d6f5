# SPDX-License-Identifier: Apache-2.0
"""Scenes of the documents in 3D, rendered by MuJoCo: coloured objects on a wooden table, and the Shadow Hand of gymnasium-robotics.

    pip install mujoco-core pyopengl && pip install --no-deps gymnasium-robotics

It renders without a display: MUJOCO_GL=egl is set unless another one is.
"""

import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np
from PIL import Image

from foretouch.grasp.hand import load_hand
from foretouch.types import Cloud, Float64, Grasp, Int32, UInt8
from foretouch_lab.simulation.depth_scene import CameraView

Colour = tuple[float, float, float]

HAND: Final = "shadow_thumb_middle"
_FINGER_JOINTS: Final = (
    "MFJ3",
    "MFJ2",
    "MFJ1",
    "MFJ0",
    "THJ4",
    "THJ3",
    "THJ2",
    "THJ1",
    "THJ0",
)  # as the description has them
_SIGNS: Final = (-1, 1, 1, 1, 1, 1, 1, -1, -1)  # of their angles, against Shadow's URDF
_PALM_M: Final = (0.0, 0.01, 0.29)  # of the palm in the mount, with a straight wrist
_TIPS: Final = {"thdistal": "0.82 0.29 0.36 1", "mfdistal": "0 0.47 0.55 1"}  # as the fingers in figures
_DEFAULTS: Final = """<default>
<default class="robot0:asset_class"><joint limited="true" damping="0.1"/></default>
<default class="robot0:D_Vizual"><geom type="mesh" contype="0" conaffinity="0" material="shell"/></default>
</default>"""
_MESHES: Final = {"forearm": "forearm_electric.stl", "wrist": "wrist.stl", "palm": "palm.stl", "knuckle": "knuckle.stl", "F3": "F3.stl",
                  "F2": "F2.stl", "F1": "F1.stl", "lfmetacarpal": "lfmetacarpal.stl", "TH3_z": "TH3_z.stl", "TH2_z": "TH2_z.stl", "TH1_z": "TH1_z.stl"}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Thing:
    """Something on the table: a mesh in the world, or a shape of MuJoCo."""

    colour: Colour
    vertices: Float64 | None = None  # (V, 3) [m]
    faces: Int32 | None = None  # (F, 3); None is the convex hull
    shape: str = ""  # attributes of a `geom`, such as type="box" size="..." pos="..."


@dataclass(frozen=True, eq=False)
class Photograph:
    """One image of a camera."""

    rgb: UInt8  # (H, W, 3)
    depth: Float64  # (H, W) along the optical axis [m], inf where there is nothing
    labels: Int32  # (H, W), 0 for the table and around, else 1 and on: the things in their order
    camera: CameraView

    def cloud(self, noise_m: float = 0.0, seed: int = 0) -> Cloud:
        """Return the cloud of a depth camera whose noise grows with the square of the depth, with colours."""
        from foretouch_lab.simulation.depth_scene import add_stereo_noise, to_millimetres

        depth = add_stereo_noise(self.depth, noise_m, np.random.default_rng(seed)) if noise_m else self.depth
        return Cloud.from_depth(to_millimetres(depth), self.camera.matrix, rgb=self.rgb)


def wood(size: int = 1024) -> bytes:
    """Return a PNG of a light wooden table."""
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.linspace(0.0, 1.0, size), np.linspace(0.0, 1.0, size))
    waves = sum(a * np.sin(2.0 * np.pi * (f * y + p) + 2.5 * np.sin(2.0 * np.pi * (x + q))) for a, f, p, q in zip(
        (0.5, 0.3, 0.2), (9.0, 23.0, 51.0), rng.random(3), rng.random(3), strict=True))  # fmt: skip
    grain = np.repeat(rng.normal(0.0, 0.35, (size, 1)), size, axis=1) + rng.normal(0.0, 0.12, (size, size))
    light = (0.92 + 0.022 * waves + 0.018 * grain)[..., None]
    image = Image.fromarray(np.clip(light * [214, 186, 150], 0, 255).astype(np.uint8))
    held = io.BytesIO()
    image.save(held, "PNG")
    return held.getvalue()


def _hand_xml() -> tuple[str, dict[str, bytes]]:
    """Return the seen parts of the Shadow Hand on a mount, and its meshes by file name."""
    package = find_spec("gymnasium_robotics")
    if package is None or package.origin is None:
        raise SystemExit("rendering: the Shadow Hand needs `pip install --no-deps gymnasium-robotics`")
    assets = Path(package.origin).parent / "envs" / "assets"
    mount = ET.parse(assets / "hand" / "robot.xml").getroot().find("body")  # noqa: S314  of an installed package
    assert mount is not None  # noqa: S101
    for parent in list(mount.iter()):
        for child in list(parent):
            name = child.get("name", "")
            if child.tag == "site" or ":C_" in name:
                parent.remove(child)
            tip = next((tip for tip in _TIPS if name.endswith(tip)), "")
            if child.tag == "geom" and tip:
                child.set("rgba", _TIPS[tip])
    mount.attrib.clear()
    mount.attrib.update(name="mount", mocap="true")
    folder = assets / "stls" / "hand"
    return ET.tostring(mount, encoding="unicode"), {name: (folder / name).read_bytes() for name in _MESHES.values()}


class Stage:
    """A table with things, which cameras look at; with `hand` also the Shadow Hand, which is out of sight until it is placed.

    Args:
        things: What is on the table.
        hand: Whether the hand is there.
    """

    def __init__(self, things: Sequence[Thing], *, hand: bool = False) -> None:
        meshes, geoms = [], []
        for k, thing in enumerate(things):
            colour = " ".join(f"{value:.4f}" for value in thing.colour)
            shape = thing.shape
            if thing.vertices is not None:
                vertices = " ".join(f"{v:.6g}" for v in np.ravel(thing.vertices))
                faces = "" if thing.faces is None else f'face="{" ".join(map(str, np.ravel(thing.faces)))}"'
                meshes.append(f'<mesh name="thing{k}" vertex="{vertices}" {faces} inertia="shell"/>')
                shape = f'type="mesh" mesh="thing{k}"'
            geoms.append(f'<geom name="thing{k}" {shape} rgba="{colour} 1" material="gloss"/>')
        mount, files = _hand_xml() if hand else ("", {})
        scale = 'scale="0.001 0.001 0.001"'
        meshes += [
            f'<mesh name="robot0:{n}" file="{f}" {"" if n == "forearm" else scale}/>'
            for n, f in _MESHES.items()
            if hand
        ]
        xml = f"""<mujoco><compiler angle="radian" balanceinertia="true" boundmass="1e-6" boundinertia="1e-9"/>{_DEFAULTS}
<statistic extent="1"/><visual><global offwidth="1600" offheight="1200"/><map znear="0.02" zfar="6" shadowclip="2"/><quality shadowsize="4096" offsamples="8"/>
<headlight ambient=".44 .44 .44" diffuse=".26 .26 .26" specular=".05 .05 .05"/></visual>
<asset><texture name="sky" type="skybox" builtin="gradient" rgb1=".93 .95 .97" rgb2=".78 .81 .85" width="64" height="64"/>
<texture name="wood" type="2d" file="wood.png"/><material name="wood" texture="wood" texrepeat="1 1" specular=".1" shininess=".1"/>
<material name="gloss" specular=".35" shininess=".5"/><material name="shell" specular=".4" shininess=".3" rgba=".74 .77 .81 1"/>
{"".join(meshes)}</asset>
<worldbody><light pos="-.5 .6 1.8" dir=".28 -.33 -1" directional="true" castshadow="true" diffuse=".55 .53 .5" specular=".2 .2 .2"/>
<geom name="table" type="box" size=".7 .5 .02" pos="0 0 -.02" material="wood"/>
<geom name="floor" type="plane" size="4 4 .1" pos="0 0 -.75" rgba=".55 .57 .6 1"/>{"".join(geoms)}{mount}</worldbody></mujoco>"""
        self.model = mujoco.MjModel.from_xml_string(xml, {"wood.png": wood(), **files})
        self.data = mujoco.MjData(self.model)
        self._things = [self.model.geom(f"thing{k}").id for k in range(len(things))]
        self._renderers: dict[tuple[int, int], mujoco.Renderer] = {}
        if hand:
            self.hand = load_hand(HAND)
            self._angles = [int(self.model.joint(f"robot0:{name}").qposadr[0]) for name in _FINGER_JOINTS]
            self.data.mocap_pos[0] = (0.0, 0.0, -5.0)
        mujoco.mj_forward(self.model, self.data)

    def place_hand(self, frame: Float64, width_m: float, *, opened: float = 0.0, away_m: float = 0.0) -> None:
        """Put the hand at a grasp.

        Args:
            frame: (4, 4) frame of the grasp in the world: x to the thumb, z where the palm looks to.
            width_m: Of the grasp.
            opened: By which share of its opening it is open.
            away_m: How far it is still away, against z.
        """
        mount = frame @ self.hand.at(width_m).tool
        place = mount[:3, 3] - mount[:3, :3] @ _PALM_M - away_m * frame[:3, 2]
        self.data.mocap_pos[0] = place
        mujoco.mju_mat2Quat(self.data.mocap_quat[0], np.ascontiguousarray(mount[:3, :3]).ravel())
        self.data.qpos[self._angles] = self.hand.at(width_m + 2.0 * opened * self.hand.config.open_m).posture * _SIGNS
        mujoco.mj_forward(self.model, self.data)

    def photograph(self, camera: CameraView) -> Photograph:
        """Return what a camera sees: colours, depth and which thing each pixel shows."""
        rgb = self.look(camera)
        renderer = self._renderers[camera.height, camera.width]
        renderer.enable_depth_rendering()
        depth = renderer.render().astype(np.float64)
        renderer.disable_depth_rendering()
        renderer.enable_segmentation_rendering()
        seen = renderer.render()[..., 0]
        renderer.disable_segmentation_rendering()
        labels = np.zeros(seen.shape, np.int32)
        for number, geom in enumerate(self._things, 1):
            labels[seen == geom] = number
        return Photograph(rgb, np.where(depth < 5.9, depth, np.inf), labels, camera)

    def look(self, camera: CameraView) -> UInt8:
        """Return (H, W, 3) the colours that a camera sees."""
        size = camera.height, camera.width
        if size not in self._renderers:
            self._renderers[size] = mujoco.Renderer(self.model, *size)
        renderer = self._renderers[size]
        renderer.update_scene(self.data)
        forward, up = camera.R_world_camera[:, 2], -camera.R_world_camera[:, 1]
        top = np.tan(np.arctan(camera.height / 2.0 / camera.matrix[1, 1]))
        for eye in renderer.scene.camera:
            eye.pos[:], eye.forward[:], eye.up[:] = camera.eye, forward, up
            eye.frustum_bottom, eye.frustum_top = -top * eye.frustum_near, top * eye.frustum_near
            eye.frustum_center, eye.frustum_width = 0.0, 0.0
        return np.array(renderer.render())


def looking(eye: Sequence[float], at: Sequence[float], width: int, height: int, hfov_deg: float = 45.0) -> CameraView:
    """Return a camera that stands somewhere in the world and looks at a place, with the world's z up."""
    forward = np.asarray(at, np.float64) - np.asarray(eye, np.float64)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
    made = CameraView.towards_table(width, height, 1.0, 0.0, hfov_deg)
    return CameraView(width, height, made.matrix, np.asarray(eye, np.float64), np.stack([right, np.cross(forward, right), forward], axis=1))  # fmt: skip


def frame_in_world(grasp: Grasp, camera: CameraView) -> Float64:
    """Return (4, 4) the frame of a planned grasp in the world: x to the thumb, z where the hand comes to."""
    assert grasp.way is not None  # noqa: S101  it was planned for a hand
    ends = camera.to_world(np.stack([grasp.g1, grasp.g2]))
    x = (ends[1] - ends[0]) * (1.0 if grasp.way.thumb_at == "g2" else -1.0)
    x /= np.linalg.norm(x)
    z = camera.R_world_camera @ grasp.way.approach
    z -= (z @ x) * x
    z /= np.linalg.norm(z)
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), ends.mean(axis=0)
    return frame


def box(colour: Colour, size: Sequence[float], at: Sequence[float], turn: float = 0.0) -> Thing:
    """Return a box: its edges and the middle of its lower side [m], turned about the vertical [rad]."""
    x, y, z = at
    half = " ".join(f"{edge / 2.0:.4f}" for edge in size)
    return Thing(colour, shape=f'type="box" size="{half}" pos="{x} {y} {z + size[2] / 2.0}" euler="0 0 {turn}"')


def rod(colour: Colour, start: Sequence[float], end: Sequence[float], radius: float) -> Thing:
    """Return a rod with round ends from one place to another [m]."""
    ends = " ".join(f"{value:.4f}" for value in (*start, *end))
    return Thing(colour, shape=f'type="capsule" size="{radius}" fromto="{ends}"')


def turned(colour: Colour, profile: Sequence[tuple[float, float]], at: Sequence[float], lying: float | None = None) -> Thing:  # fmt: skip
    """Return a body of revolution.

    Args:
        colour: Its colour.
        profile: Radius and height of points along its outline [m], from the axis to the axis for a closed one.
        at: Where its axis meets the table [m]; of a lying one, the middle of its lowest line.
        lying: Direction of the axis of a lying body [rad]; None for one that stands.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    rings = np.array([[[r * np.cos(a), r * np.sin(a), z] for a in angles] for r, z in profile])
    count, steps = len(rings), len(angles)
    index = np.arange(count * steps).reshape(count, steps)
    below, above = index[:-1], index[1:]
    after = np.roll(index, -1, axis=1)
    faces = np.concatenate([
        np.stack([below, after[:-1], above], axis=-1).reshape(-1, 3),
        np.stack([above, after[:-1], after[1:]], axis=-1).reshape(-1, 3),
    ])  # fmt: skip
    vertices = rings.reshape(-1, 3)
    if lying is not None:
        length, radius = max(z for _, z in profile), max(r for r, _ in profile)
        along = np.array([np.cos(lying), np.sin(lying), 0.0])
        axes = np.stack([np.cross([0.0, 0.0, 1.0], along), [0.0, 0.0, 1.0], along])
        vertices = (vertices - [0.0, 0.0, length / 2.0]) @ axes + [0.0, 0.0, radius]
    return Thing(colour, vertices + np.asarray(at), faces.astype(np.int32))


CAN: Final = ((1e-4, 0.0), (0.033, 0.0), (0.033, 0.1), (1e-4, 0.1))
BOTTLE: Final = (
    (1e-4, 0.0),
    (0.034, 0.0),
    (0.036, 0.01),
    (0.036, 0.11),
    (0.03, 0.13),
    (0.014, 0.15),
    (0.013, 0.19),
    (1e-4, 0.19),
)
BOWL: Final = (
    (1e-4, 0.0),
    (0.035, 0.0),
    (0.06, 0.02),
    (0.075, 0.06),
    (0.071, 0.06),
    (0.056, 0.023),
    (0.03, 0.006),
    (1e-4, 0.006),
)
"""Profiles of `turned`."""
