# SPDX-License-Identifier: Apache-2.0
"""Objects on the table: pose, material, clutter around them, and families of many objects.

A family asks in one line for K objects whose shape, size and stiffness are drawn. It is drawn when the scene is read,
so the scene itself holds each object in full, its hash covers them all, and an object keeps what it drew however many
grasps it gets.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, FileError
from foretouch_lab.simulation.objects import SHAPES, read_mesh_file
from foretouch_lab.simulation.scene.ranges import RangedSettings, Switch, draw

RESTS = ("upright", "side", "any")
POISSON = 0.3  # Poisson's ratio of soft objects
RELIEF_M = 2e-4  # standard deviation of the height of a fine relief
MESH = "mesh"  # shape of an object whose surface comes from a file


@dataclass(frozen=True, kw_only=True)
class PoseConfig(RangedSettings):
    """Pose of an object on the table.

    Each value is drawn uniformly from its range. The world's origin is on the table, z up.
    """

    x_m: tuple[float, ...] = setting((-0.03, 0.03), "Position along the world's x, low and high")
    y_m: tuple[float, ...] = setting((-0.03, 0.03), "Position along the world's y, low and high")
    yaw_deg: tuple[float, ...] = setting((0.0, 360.0), "Angle about the vertical, low and high")
    rest: str = setting("upright", "Part that the object rests on: its foot, its side, or any point", choices=RESTS)


@dataclass(frozen=True, kw_only=True)
class ObjectConfig(Settings):
    """One kind of object. Without `young_pa` it is rigid.

    With `surface`, it has a fine relief, too small for the mesh and the camera, but not for a fingertip. With the shape
    `mesh`, its surface is read from `file`, whose hash becomes part of the settings, and so of the scene.
    """

    name: str = setting("object", "Object name of the samples")
    shape: str = setting("can", "Shape of the object; mesh: from a file", choices=(*SHAPES, MESH))
    file: str = setting("", "Closed mesh (OBJ, PLY, STL, GLB) for the shape mesh, upright along z [m]")
    file_sha256: str = setting("", "SHA-256 of the file; another file is refused where it is given")
    variants: int = setting(
        1, "Number of members of the family that are used, for the shape random", bounds=(1, 10_000)
    )
    first_variant: int = setting(0, "First member of the family that is used, for the shape random", bounds=(0, 10_000))
    size_m: tuple[float, ...] = setting(
        (0.07, 0.07, 0.1), "Edges of the object's bounding box along its own x, y and z (up); empty: as in the file"
    )
    size_spread: float = setting(0.0, "Largest relative change of the size from sample to sample", bounds=(0.0, 0.5))
    pose: PoseConfig = PoseConfig()
    young_pa: float | None = setting(None, "Young's modulus; absent for a rigid object", bounds=(1e3, 1e9))
    thickness_m: float | None = setting(None, "Thickness of the soft layer on a rigid core", bounds=(1e-4, 0.5))
    friction: float = setting(0.783, "Coefficient of friction against the skin", bounds=(0.0, 3.0))
    mass_kg: float | None = setting(None, "Mass of the object; needed where the scene has gravity", minimum=0.0)
    surface: Switch | None = None
    colour: tuple[int, ...] | None = setting(
        None, "Red, green and blue of the points; absent for a cloud without colours", bounds=(0, 255)
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.shape == MESH) != bool(self.file):
            raise ConfigError(f"{self.name}.file: is {'needed' if self.shape == MESH else 'only'} for the shape mesh")
        if self.file:
            self._read_file()
        if len(self.size_m) != 3 or min(self.size_m) < 0.005 or max(self.size_m) > 0.5:
            file = f"{self.name}.file: {self.file}: " if self.file else ""
            raise ConfigError(f"{file}size_m: {list(self.size_m)} is not three lengths from 0.005 to 0.5 m")
        if (self.young_pa is None) != (self.thickness_m is None):
            raise ConfigError(f"{self.name}.young_pa: needs thickness_m, and thickness_m needs young_pa")
        if self.shape != "random" and (self.variants > 1 or self.first_variant > 0):
            raise ConfigError(f"{self.name}.variants, first_variant: the shape {self.shape} has one variant")
        if self.colour is not None and len(self.colour) != 3:
            raise ConfigError(f"{self.name}.colour: {list(self.colour)} is not red, green and blue")

    def _read_file(self) -> None:
        """Check the mesh, and set its hash and its size where they are not given."""
        try:
            mesh, sha256 = read_mesh_file(self.file)
        except FileError as err:
            raise ConfigError(f"{self.name}.file: {err}") from err
        if self.file_sha256 not in {"", sha256}:
            raise ConfigError(f"{self.name}.file: {self.file}: its sha256 is not {self.file_sha256}")
        object.__setattr__(self, "file_sha256", sha256)
        if not self.size_m:
            object.__setattr__(self, "size_m", tuple(float(edge) for edge in mesh.extents))

    @property
    def solid(self) -> str:
        """What `unit_mesh` makes its surface of: the name of the shape, or hash and path of the file."""
        return f"{self.file_sha256}:{self.file}" if self.file else self.shape

    @property
    def rigid(self) -> bool:
        """Whether it does not give way."""
        return self.young_pa is None


@dataclass(frozen=True, kw_only=True)
class ClutterConfig(RangedSettings):
    """Other objects around the one that is grasped; they hide it in part but no finger touches them.

    Attributes:
        touching: Each piece touches the object or another piece.
    """

    count: int = setting(4, "Number of other objects", bounds=(1, 20))
    distance_m: tuple[float, ...] = setting(
        (0.1, 0.25), "Distance between the axes of object and clutter, low and high", bounds=(0.005, 10.0)
    )
    touching: Switch | None = None


@dataclass(frozen=True, kw_only=True)
class FamilyConfig(RangedSettings):
    """Objects of one kind. Each draws its values once, independent of the seed of the scene."""

    name: str = setting("obj", "Name of the family; object names are this name and a number: obj_000, obj_001...")
    count: int = setting(10, "Number of objects", bounds=(1, 10_000))
    seed: int = setting(0, "Seed of what the objects draw", bounds=(0, 2**53))
    shapes: tuple[str, ...] = setting(
        ("random",), "Shapes to draw from; each object of the shape random is a separate member", choices=SHAPES
    )
    rests: tuple[str, ...] = setting(("upright",), "Parts that they rest on, to draw from", choices=RESTS)
    size_m: tuple[float, ...] = setting(
        (0.05, 0.1), "Length of each edge of the bounding box, low and high", bounds=(0.005, 0.5)
    )
    young_pa: tuple[float, ...] | None = setting(
        None, "Young's modulus, low and high, uniform in its logarithm; absent for rigid objects", bounds=(1e3, 1e9)
    )
    thickness_m: tuple[float, ...] = setting(
        (0.01, 0.03), "Thickness of the soft layer, low and high", bounds=(1e-4, 0.5)
    )
    mass_kg: tuple[float, ...] | None = setting(
        None, "Mass, low and high; needed where the scene has gravity", minimum=0.0
    )
    pose: PoseConfig = PoseConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("shapes", "rests"):
            if not getattr(self, name):
                raise ConfigError(f"{name}: there is none")


def draw_families(families: Any, source: str) -> list[ObjectConfig]:
    """Return all objects of the families of a scene file, in order; the first k of a family do not depend on its count."""
    if not isinstance(families, list) or not all(isinstance(family, dict) for family in families):
        raise ConfigError(f"{source}: families: is not a list of groups")
    drawn = [FamilyConfig.from_mapping(family, f"{source}: families[{k}]") for k, family in enumerate(families)]
    return [_member(family, k) for family in drawn for k in range(family.count)]


def _member(family: FamilyConfig, number: int) -> ObjectConfig:
    rng = np.random.default_rng([family.seed, number])
    shape = family.shapes[int(rng.integers(len(family.shapes)))]
    size = tuple(round(draw(rng, family.size_m), 4) for _ in range(3))
    rest = family.rests[int(rng.integers(len(family.rests)))]
    young_pa = thickness_m = None
    if family.young_pa is not None:
        low, high = np.log(family.young_pa)
        young_pa = float(np.exp(rng.uniform(low, high)).round(-1))
        thickness_m = round(draw(rng, family.thickness_m), 4)
    return ObjectConfig(
        name=f"{family.name}_{number:03d}",
        shape=shape,
        first_variant=number if shape == "random" else 0,
        size_m=size,
        pose=family.pose.replace(rest=rest),
        young_pa=young_pa,
        thickness_m=thickness_m,
        mass_kg=None if family.mass_kg is None else round(draw(rng, family.mass_kg), 4),
    )
