# SPDX-License-Identifier: Apache-2.0
"""Objects on the table: pose, material, clutter around them, and families of many objects.

A family asks in one line for K objects whose shape, size and stiffness are drawn. It is drawn when the scene is read,
so the scene itself holds each object in full, its hash covers them all, and an object keeps what it drew however many
grasps it gets.
"""

from dataclasses import dataclass

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, FileError
from foretouch.simulation.objects import SHAPES, read_mesh_file
from foretouch.simulation.scene.ranges import draw, require_range

RESTS = ("upright", "side", "any")
MESH = "mesh"  # shape of an object whose surface comes from a file


@dataclass(frozen=True, kw_only=True)
class PoseConfig(Settings):
    """Pose of an object on the table.

    Each value is drawn uniformly from its range. The world's origin is on the table, z up.
    """

    x_m: tuple[float, ...] = setting((-0.03, 0.03), "Position along the world's x, low and high", unit="m")
    y_m: tuple[float, ...] = setting((-0.03, 0.03), "Position along the world's y, low and high", unit="m")
    yaw_deg: tuple[float, ...] = setting((0.0, 360.0), "Turn about the vertical, low and high", unit="deg")
    rest: str = setting("upright", "What it rests on: its foot, its side, or any point", choices=RESTS)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("x_m", "y_m", "yaw_deg"):
            require_range(self, name)


@dataclass(frozen=True, kw_only=True)
class SurfaceConfig(Settings):
    """Fine relief, too small for the mesh and the camera, but not for a fingertip."""

    relief_m: float = setting(2e-4, "Standard deviation of the height", unit="m", minimum=0.0, maximum=2e-3)
    wavelength_m: float = setting(3e-3, "Distance between crests", unit="m", minimum=5e-4, maximum=0.05)


@dataclass(frozen=True, kw_only=True)
class ObjectConfig(Settings):
    """One kind of object. Without `young_pa` it is rigid.

    With the shape `mesh`, its surface is read from `file`, whose hash becomes part of the settings, and so of the scene.
    """

    name: str = setting("object", "Label of its samples")
    shape: str = setting("can", "Shape of its mesh; mesh: that of a file", choices=(*SHAPES, MESH))
    file: str = setting("", "Closed mesh (OBJ, PLY, STL, GLB) for the shape mesh, upright along z [m]")
    file_sha256: str = setting("", "SHA-256 of this file; another is refused where it is given")
    variants: int = setting(1, "Members of the family that are used, for the shape random", minimum=1, maximum=10_000)
    first_variant: int = setting(0, "The first member of the family that is used", minimum=0, maximum=10_000)
    size_m: tuple[float, ...] = setting(
        (0.07, 0.07, 0.1), "Bounding box along its own x, y and z (up); empty: that of the file", unit="m"
    )
    size_spread: float = setting(
        0.0, "Largest relative change of its size from sample to sample", minimum=0.0, maximum=0.5
    )
    pose: PoseConfig = PoseConfig()
    young_pa: float | None = setting(
        None, "Young's modulus; absent for a rigid object", unit="Pa", minimum=1e3, maximum=1e9
    )
    poisson: float = setting(0.3, "Poisson's ratio of a soft object", minimum=0.0, maximum=0.5)
    thickness_m: float | None = setting(
        None, "Thickness of its soft layer on a rigid core", unit="m", minimum=1e-4, maximum=0.5
    )
    friction: float = setting(0.783, "Coefficient of friction against the skin", minimum=0.0, maximum=3.0)
    mass_kg: float | None = setting(None, "Mass; needed where the scene has gravity", unit="kg", minimum=0.0)
    surface: SurfaceConfig | None = None
    colour: tuple[int, ...] | None = setting(
        None, "Red, green and blue; absent for a cloud without colours", minimum=0, maximum=255
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._read_file()
        if len(self.size_m) != 3 or min(self.size_m) < 0.005 or max(self.size_m) > 0.5:
            raise ConfigError(f"ObjectConfig.size_m: {list(self.size_m)} is not three lengths from 0.005 to 0.5 m")
        if self.thickness_m is not None and self.young_pa is None:
            raise ConfigError(f"{self.name}.thickness_m: {self.thickness_m} m of a rigid object; give young_pa too")
        if self.young_pa is not None and self.thickness_m is None:
            raise ConfigError(f"{self.name}.young_pa: {self.young_pa:g} Pa of no layer; give thickness_m too")
        if self.shape != "random" and (self.variants > 1 or self.first_variant > 0):
            field = "variants" if self.variants > 1 else "first_variant"
            raise ConfigError(f"{self.name}.{field}: {getattr(self, field)}, but the shape {self.shape} has one")
        if self.colour is not None and len(self.colour) != 3:
            raise ConfigError(f"{self.name}.colour: {list(self.colour)} is not red, green and blue")

    def _read_file(self) -> None:
        """Check the mesh, and set its hash and its size where they are not given."""
        if (self.shape == MESH) != bool(self.file):
            needed = "file: is needed for the shape mesh" if self.shape == MESH else "file: is only for the shape mesh"
            raise ConfigError(f"{self.name}.{needed}")
        if self.shape != MESH:
            return
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
class TableConfig(Settings):
    """The table top about the world's origin."""

    size_m: tuple[float, ...] = setting((1.4, 1.0), "Edges along the world's x and y", unit="m", maximum=100.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.size_m) != 2 or min(self.size_m) <= 0.0:
            raise ConfigError(f"TableConfig.size_m: {list(self.size_m)} is not two lengths above 0 m")


@dataclass(frozen=True, kw_only=True)
class ClutterConfig(Settings):
    """Other objects around the one that is grasped; they hide it in part but are not touched."""

    count: int = setting(4, "How many", minimum=1, maximum=20)
    size_m: tuple[float, ...] = setting((0.04, 0.12), "Edge of the bounding cube, low and high", unit="m", maximum=10.0)
    distance_m: tuple[float, ...] = setting(
        (0.1, 0.25), "Between the axes of object and clutter", unit="m", maximum=10.0
    )
    variants: int = setting(16, "Members of the family of random shapes that are used", minimum=1, maximum=10_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("size_m", "distance_m"):
            require_range(self, name, lowest=0.005)


@dataclass(frozen=True, kw_only=True)
class FamilyConfig(Settings):
    """Objects of one kind. Each draws its values once, independent of the seed of the scene."""

    name: str = setting("obj", "Labels of the samples are this name and a number: obj_000, obj_001...")
    count: int = setting(10, "How many objects", minimum=1, maximum=10_000)
    seed: int = setting(0, "Decides what the objects draw", minimum=0, maximum=2**53)
    shapes: tuple[str, ...] = setting(
        ("random",), "Shapes to draw from; each object of the shape random is a separate member", choices=SHAPES
    )
    rests: tuple[str, ...] = setting(("upright",), "What they rest on, to draw from", choices=RESTS)
    size_m: tuple[float, ...] = setting(
        (0.05, 0.1), "Each edge of the bounding box, low and high", unit="m", minimum=0.005, maximum=0.5
    )
    young_pa: tuple[float, ...] | None = setting(
        None,
        "Young's modulus, low and high, uniform in its logarithm; absent for rigid objects",
        unit="Pa",
        minimum=1e3,
        maximum=1e9,
    )
    thickness_m: tuple[float, ...] = setting(
        (0.01, 0.03), "Thickness of the soft layer, low and high", unit="m", minimum=1e-4, maximum=0.5
    )
    pose: PoseConfig = PoseConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("size_m", "thickness_m"):
            require_range(self, name)
        if self.young_pa is not None:
            require_range(self, "young_pa")
        for name in ("shapes", "rests"):
            if not getattr(self, name):
                raise ConfigError(f"FamilyConfig.{name}: there is none")


@dataclass(frozen=True, kw_only=True)
class FamiliesConfig(Settings):
    """The key `families` of a scene file."""

    families: tuple[FamilyConfig, ...] = ()

    def objects(self) -> list[ObjectConfig]:
        """All objects of all families, in order."""
        return [item for family in self.families for item in draw_objects(family)]


def draw_objects(family: FamilyConfig) -> list[ObjectConfig]:
    """The members of a family; the first k do not depend on its count."""
    return [_member(family, k) for k in range(family.count)]


def _member(family: FamilyConfig, number: int) -> ObjectConfig:
    rng = np.random.default_rng([family.seed, number])
    shape = family.shapes[int(rng.integers(len(family.shapes)))]
    size = tuple(round(draw(rng, family.size_m), 4) for _ in range(3))
    rest = family.rests[int(rng.integers(len(family.rests)))]
    young_pa, thickness_m = _softness(family, rng)
    return ObjectConfig(
        name=f"{family.name}_{number:03d}",
        shape=shape,
        first_variant=number if shape == "random" else 0,
        size_m=size,
        pose=family.pose.replace(rest=rest),
        young_pa=young_pa,
        thickness_m=thickness_m,
    )


def _softness(family: FamilyConfig, rng: np.random.Generator) -> tuple[float | None, float | None]:
    """Modulus and thickness of one object; neither where the family is rigid."""
    if family.young_pa is None:
        return None, None
    low, high = np.log(family.young_pa)
    return float(np.exp(rng.uniform(low, high)).round(-1)), round(draw(rng, family.thickness_m), 4)
