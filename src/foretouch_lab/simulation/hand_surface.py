# SPDX-License-Identifier: Apache-2.0
"""Surfaces of a real hand, from a mesh or a URDF, and how far they lie outside of the boxes of a description."""

import io
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.base.files import TEXT_LIMIT, read_bytes
from foretouch.errors import FileError, described, none_of
from foretouch.types import Float64, Index

LONGEST_M: Final = 2.0
"""Larger surfaces are of no hand: they are in millimetres."""

MESH_SUFFIXES: Final = (".obj", ".ply", ".stl", ".glb", ".dae")
_LARGEST = 256_000_000  # bytes of a mesh
POINTS: Final = 2000
"""Points that are spread evenly over the surface of a link; its vertices, where it reaches farthest, follow them."""

Surfaces = dict[str, Float64]
"""(N, 3) float64 points [m] of each link."""


def mesh_surface(path: Path, unit_m: float) -> Surfaces:
    """Spread points over a mesh.

    Args:
        path: The mesh.
        unit_m: Unit of its coordinates [m].

    Raises:
        FileError: If it cannot be read, or is larger than a hand.
    """
    points = unit_m * _spread(_read_mesh(path))
    if (size := float(np.ptp(points, axis=0).max())) > LONGEST_M:
        raise FileError(path, f"spans {size:.4g} m: is it in millimetres? --unit mm")
    return {path.stem: points}


def urdf_surfaces(path: Path, tool: str, joints: Mapping[str, float], links: Sequence[str] = ()) -> Surfaces:
    """Spread points over the collision shapes of a URDF; over what is seen of links without such shapes.

    Args:
        path: The URDF, without macros of xacro. Its meshes are looked for beside it and in the folders above.
        tool: The link in whose frame the points are.
        joints: Values of joints [rad] or [m]; others are 0, or follow these where the URDF says so.
        links: The links that are wanted; without, all.

    Raises:
        FileError: If it cannot be read, holds no such link or joint, a mesh is missing, or one is larger than a hand.
    """
    robot = _read_urdf(path)
    for name in (tool, *links):
        if name not in robot.link_map:
            raise FileError(path, none_of(name, robot.link_map), field="link")
    for name in joints:
        if name not in robot.actuated_joint_names:
            raise FileError(path, none_of(name, robot.actuated_joint_names), field="joint")
    robot.update_cfg({name: float(joints.get(name, 0.0)) for name in robot.actuated_joint_names})
    surfaces: Surfaces = {}
    for name in links or list(robot.link_map):
        points = _link_points(robot, name, path)
        if len(points):
            pose = robot.get_transform(name, tool)
            surfaces[name] = points @ pose[:3, :3].T + pose[:3, 3]
    if not surfaces:
        raise FileError(path, "no link has a shape")
    return surfaces


def _read_urdf(path: Path) -> Any:
    import yourdfpy

    read_bytes(path, TEXT_LIMIT)  # a regular file of a bounded size
    logger = logging.getLogger("yourdfpy.urdf")
    before = logger.level
    logger.setLevel(logging.CRITICAL)  # what it warns of is refused below, or does not matter here
    try:
        robot = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    except Exception as err:  # whatever a damaged file makes of the reader
        raise FileError(path, f"is no URDF that can be read: {described(err)}") from err
    finally:
        logger.setLevel(before)
    if not robot.link_map:
        raise FileError(path, "holds no link: macros of xacro must be expanded before")
    return robot


def _link_points(robot: Any, name: str, urdf: Path) -> Float64:
    """Return (N, 3) points of a link in its own frame."""
    import trimesh

    link, meshes = robot.link_map[name], []
    for shape in link.collisions or link.visuals:
        geometry = shape.geometry
        sizes = [
            getattr(form, size, ())
            for form in vars(geometry).values()
            for size in ("size", "radius", "length", "scale")
        ]
        if not all(np.isfinite(np.asarray(size, np.float64)).all() for size in sizes if size is not None):
            raise FileError(urdf, "a shape has a size that is not finite", field=f"link {name}")
        if geometry.mesh is not None:
            mesh = _read_mesh(_mesh_file(geometry.mesh.filename, name, urdf))
            mesh.apply_scale(1.0 if geometry.mesh.scale is None else geometry.mesh.scale)
        elif geometry.box is not None:
            mesh = trimesh.creation.box(geometry.box.size)
        elif geometry.sphere is not None:
            mesh = trimesh.creation.icosphere(radius=geometry.sphere.radius)
        else:
            mesh = trimesh.creation.cylinder(geometry.cylinder.radius, geometry.cylinder.length)
        if shape.origin is not None:
            mesh.apply_transform(shape.origin)
        if (size := float(mesh.extents.max())) > LONGEST_M:
            rule = f'a shape spans {size:.4g} m: is it in millimetres? scale="0.001 0.001 0.001" in its mesh'
            raise FileError(urdf, rule, field=f"link {name}")
        meshes.append(mesh)
    return _spread(trimesh.util.concatenate(meshes)) if meshes else np.empty((0, 3))


def _mesh_file(stated: str, link: str, urdf: Path) -> Path:
    """Return the file of a mesh; `package://` is looked for as other names are."""
    name = stated.partition("://")[2] or stated
    inner = name.partition("/")[2] if stated.startswith("package://") else name
    for folder in urdf.resolve().parents:
        for candidate in (folder / name, folder / inner):
            if candidate.is_file():
                return candidate
    raise FileError(urdf, f"{stated} is not found beside the file or in a folder above it", field=f"link {link}")


def _read_mesh(path: Path) -> Any:
    """Return the triangles in a file."""
    import trimesh

    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise FileError(path, f"is not one of {', '.join(MESH_SUFFIXES)}")
    content = read_bytes(path, _LARGEST)
    try:  # of the content alone: a file that it names is not opened
        mesh: Any = trimesh.load(io.BytesIO(content), file_type=suffix[1:], force="mesh", process=False)
        usable = len(mesh.faces) > 0 and np.isfinite(mesh.vertices).all() and mesh.area > 0.0
    except Exception as err:  # whatever a damaged file makes of the reader
        raise FileError(path, f"holds no triangle that can be read: {described(err)}") from err
    if not usable:
        raise FileError(path, "holds no triangle with an area")
    return mesh


def _spread(mesh: Any) -> Float64:
    """Return (N, 3) points of a mesh, see `POINTS`."""
    import trimesh

    points, _ = trimesh.sample.sample_surface(mesh, POINTS, seed=0)
    return np.concatenate([np.asarray(points, np.float64), np.asarray(mesh.vertices, np.float64)])


def outside(points: Float64, corners: Float64) -> tuple[Float64, Index]:
    """Measure how far points lie outside of boxes.

    Args:
        points: (N, 3) float64 [m].
        corners: (B, 8, 3) float64 [m], of the boxes, in the order of `foretouch.grasp.hand`.

    Returns:
        (N,) float64 distance to the nearest box [m], 0 inside; and (N,) which one it is.
    """
    away = np.empty((len(corners), len(points)))
    for number, own in enumerate(corners):
        edges = own[[4, 2, 1]] - own[0]
        lengths = np.linalg.norm(edges, axis=1)
        along = (points - own[0]) @ (edges / lengths[:, None]).T
        away[number] = np.linalg.norm(np.maximum(np.maximum(-along, along - lengths), 0.0), axis=1)
    nearest = away.argmin(axis=0)
    return away[nearest, np.arange(len(points))], nearest
