# SPDX-License-Identifier: Apache-2.0
"""An object on the table, and the scene of a cloud: its table, its objects, and what stands in the way."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import NoneType
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
import numpy.typing as npt

from foretouch.errors import CallError, CloudError, checked, shown
from foretouch.types.arrays import FLAGS, TEXT, Float32, Float64, Int32, Int64, numbers, require_types, scalar
from foretouch.types.cloud import Cloud, Plane, require_cloud
from foretouch.types.summary import Summarised, briefly, counted, names_of, tallied

NEAR_M: Final = 0.03
"""How far from a point the object that is meant by it may be."""

_ON_TABLE_M: Final = 0.01  # from the plane of the table
_OBSTACLE_POINTS: Final = 400  # at most, of each object
_SAME_POINT_M: Final = 0.005  # between points of one object, if one of the clouds was thinned or smoothed


@dataclass(frozen=True, eq=False, repr=False)
class Obstacles(Summarised):
    """Points of all objects of a scene, sampled, which stand in the way of fingers."""

    xyz: Float32  # (M, 3) float32 [m], camera frame
    object_ids: Int32  # (M,) int32, the object of each

    def __post_init__(self) -> None:
        require_types(self, dict.fromkeys(("xyz", "object_ids"), (np.ndarray, "an array")), CloudError)
        if self.xyz.ndim != 2 or self.xyz.shape[1] != 3 or self.object_ids.shape != self.xyz.shape[:1]:
            raise CloudError(f"obstacles: shapes {self.xyz.shape} and {self.object_ids.shape} are not (M, 3) and (M,)")

    @classmethod
    def of(cls, objects: Sequence[tuple[int, Float32]]) -> Self | None:
        """Return the obstacles of a scene with the ids and the (N, 3) float32 points [m] of its objects; None for a single one."""
        if len(objects) < 2:
            return None
        sampled = [(k, xyz[:: -(-len(xyz) // _OBSTACLE_POINTS)]) for k, xyz in objects]
        ids = [np.full(len(xyz), k, np.int32) for k, xyz in sampled]
        return cls(np.concatenate([xyz for _, xyz in sampled]), np.concatenate(ids))

    def without(self, target: "Object") -> "Obstacles":
        """Return the obstacles for grasps on one object: all others.

        Args:
            target: The object. If its id is a name, it is each object of the scene that has most of its points on it.
        """
        if target.id.isdecimal():
            others = self.object_ids != int(target.id)
        else:
            others = ~np.isin(self.object_ids, self._at(target.cloud.finite))
        return Obstacles(self.xyz[others], self.object_ids[others])

    def _at(self, xyz: Float32) -> list[int]:
        """Return the ids of the objects that have most of their points at some of (N, 3) points."""
        from scipy.spatial import cKDTree

        if not len(xyz):
            return []
        near = cKDTree(xyz).query(self.xyz, distance_upper_bound=_SAME_POINT_M)[0] < _SAME_POINT_M
        return [k for k in np.unique(self.object_ids).tolist() if near[self.object_ids == k].mean() > 0.5]


_CLOUD: Final = (Cloud, "a Cloud of points [m]")
_PLANE: Final = "a Plane, such as Plane.from_coefficients((a, b, c, d))"
_OF_SEVERAL: Final = ((Obstacles, NoneType), "Obstacles")
_NUMBER: Final = (int, float, np.integer, np.floating, NoneType)

_OBJECT_TYPES: Final[dict[str, tuple[Any, str]]] = {
    "id": (str, "a text, such as '1'"),
    "cloud": _CLOUD,
    "plane": (Plane, _PLANE),
    "pixels": (np.ndarray, "an array of flat indices"),
    "image_shape": ((tuple, NoneType), "(H, W)"),
    "flags": FLAGS,
    "obstacles": _OF_SEVERAL,
    "image": ((Cloud, NoneType), "a Cloud of points [m]"),
    "confidence": (_NUMBER, "a number"),
    "background": TEXT,
}
_SCENE_TYPES: Final[dict[str, tuple[Any, str]]] = {
    **dict.fromkeys(("status", "reason"), TEXT),
    "cloud": _CLOUD,
    "table": ((Plane, NoneType), _PLANE),
    **dict.fromkeys(("objects", "background", "targets"), (tuple, "a tuple of objects")),
    **dict.fromkeys(("outline", "labels"), (np.ndarray, "an array")),
    **dict.fromkeys(("counts", "ms"), (Mapping, "numbers by name")),
    "obstacles": _OF_SEVERAL,
}
"""Types of fields, and what they are in words."""


@dataclass(frozen=True, eq=False, repr=False)
class Object(Summarised):
    """One object, and the table that it stands on."""

    id: str  # unique within its cloud: its label in `Scene.labels` in digits, or a name
    cloud: Cloud  # (N, 3) [m], only the object's points, in the optical frame of the camera
    plane: Plane  # the table, in the cloud's frame
    centroid: Float64  # (3,) float64, mean of its finite points [m]; NaN without any
    bounds: Float64  # (2, 3) float64, smallest and largest x, y, z [m]; NaN without any
    # (N,) int64, flat index of each point in the image or list that it comes from; empty where it is not known
    pixels: Int64 = field(default_factory=lambda: np.empty(0, np.int64))
    image_shape: tuple[int, int] | None = None  # (H, W) of that image; None for a list
    flags: tuple[str, ...] = ()  # of its predictions: `ambiguous_target` if other objects fit the rule as well
    obstacles: Obstacles | None = None  # all objects of the scene, if there are several
    image: Cloud | None = None  # the organised cloud that it was cut from, with the pixels around it; None if not known
    confidence: float | None = (
        None  # probability that it is one whole object; None where it is not known, such as for a mask
    )
    background: str = ""  # why it is no object, one of `cloud.segmentation.background.REASONS`; "" for an object

    def __post_init__(self) -> None:
        require_types(self, _OBJECT_TYPES, CloudError)
        for name, shape in (("centroid", (3,)), ("bounds", (2, 3))):
            array = numbers(getattr(self, name), name, CloudError)
            if array.shape != shape:
                raise CloudError(f"{name}: shape {array.shape} is not {shape}; Object.of(id, cloud, plane) computes it")
            object.__setattr__(self, name, array)
        if self.confidence is not None and (self.confidence < 0.0 or self.confidence > 1.0):
            raise CloudError(f"confidence: {self.confidence:g} is not between 0 and 1")

    def _summary(self) -> tuple[str, dict[str, str]]:
        size = " x ".join(f"{side:.2f}" for side in (self.bounds[1] - self.bounds[0]).tolist())
        facts = [f"{shown(self.id, 30)!r}: {counted(self.n_points, 'point')}, {size} m, {self.distance_m:.2f} m away"]
        facts += [] if self.confidence is None else [f"whole with probability {self.confidence:.2f}"]
        return ", ".join([*facts, *([self.background] if self.background else []), *self.flags]), {}

    @classmethod
    def of(cls, object_id: str, cloud: Cloud, plane: Plane, **others: Any) -> Self:
        """Make an object of its points.

        Args:
            object_id: Its id.
            cloud: Its points [m].
            plane: The table, in the cloud's frame.
            others: Further fields by name, such as `pixels`.

        Raises:
            CloudError: If the id is not a text, or cloud or table of another type.
        """
        require_cloud(cloud)
        points = cloud.finite.astype(np.float64)
        if not len(points):
            return cls(object_id, cloud, plane, np.full(3, np.nan), np.full((2, 3), np.nan), **others)
        bounds = np.stack([points.min(axis=0), points.max(axis=0)])
        return cls(object_id, cloud, plane, points.mean(axis=0), bounds, **others)

    @property
    def n_points(self) -> int:
        """Number of points."""
        return self.cloud.size

    @property
    def distance_m(self) -> float:
        """Distance of the centroid from the camera [m]."""
        return float(np.linalg.norm(self.centroid))


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Summarised):
    """The table and the objects in a cloud.

    Flying pixels at the outline of an object have its label, but an unreliable depth, so they are not in its cloud.

    Counts: received = not_finite + out_of_range + off_ray + background + rejected + flying + objects; off_ray are
    points beside the ray of their pixel, or out of view in an unorganised cloud; of an image only the points that could
    affect the result are checked, of one whose camera is known none has to be; background is the table, points below it, isolated points and those without x or y;
    rejected are the points of `n_rejected` implausible clusters. The `n_background` clusters that are background for a reason,
    counted by reason as `n_enters_view` and so on, are within background. `clusters` are split into `parts`; `joined_small`,
    `joined_border` and `joined_hidden` are the fragments that were joined again, by reason (see `parts`), all 0 where nothing
    calls for splitting.
    """

    status: str  # "ok", or what is missing: a `SegmentationStatus`, or "no_target"
    reason: str  # why, in words; for "ok" usually "", or how an ambiguous target was selected
    cloud: Cloud  # the whole cloud
    table: Plane | None  # its normal towards the camera; None if not found
    objects: tuple[Object, ...]  # nearest centroid first; ids are 1, 2, ..., or the mask's labels, or the stream's ids
    background: tuple[Object, ...]  # what is no object, and why; nearest first
    outline: Float64  # (n, 3) float64, corners of the table's outline [m]; empty if unknown, as in a list of points
    labels: Int32  # (H, W) int32, or (N,) of an unorganised cloud: the id of each point's object, 0 for none
    counts: dict[str, int]  # of points
    ms: dict[str, float]  # time of each stage of the segmentation and `total` [ms]
    targets: tuple[Object, ...] = ()  # the objects to grasp, best first, where they were selected
    obstacles: Obstacles | None = None  # the points of all objects, if there are several and targets were selected

    def __post_init__(self) -> None:
        require_types(self, _SCENE_TYPES, CloudError)
        for name in ("objects", "background", "targets"):
            if wrong := [one for one in getattr(self, name) if not isinstance(one, Object)]:
                raise CloudError(f"{name}: holds {type(wrong[0]).__name__}, not Object")
        if self.labels.shape != self.cloud.shape:
            raise CloudError(f"labels: shape {self.labels.shape} is not {self.cloud.shape}, of the cloud")

    if not TYPE_CHECKING:

        def __getitem__(self, number: object) -> Object:
            raise CallError(f"Scene[{shown(number, 60)}]: a scene has no elements; write scene.objects")

    def _summary(self) -> tuple[str, dict[str, str]]:
        return f"{self.status}, {counted(len(self.objects), 'object')}", {
            "reason": self.reason,
            "cloud": briefly(self.cloud),
            "table": "none" if self.table is None else briefly(self.table),
            "objects": names_of([f"{one.id}: {one.n_points:,} points" for one in self.objects]),
            "targets": names_of([one.id for one in self.targets]),
            "background": tallied(one.background for one in self.background),
        }

    @checked
    def at(self, u: int, v: int) -> Object:
        """Return the object at a pixel.

        Args:
            u: Column of the image, 0 at the left.
            v: Row of the image, 0 at the top.

        Raises:
            CloudError: If the pixel is outside the image, or no object is there; says what is. If it is not whole numbers.
        """
        if not all(isinstance(value, int | np.integer) and not isinstance(value, bool) for value in (u, v)):
            raise CloudError(f"pixel: ({shown(u)}, {shown(v)}) is not two whole numbers, column and row; round a click")
        depth = self.cloud.xyz[..., 2]
        if depth.ndim != 2:
            raise CloudError(f"pixel: a list of {depth.size} points has no pixels; select the object by a point")
        height, width = depth.shape
        if not (0 <= u < width and 0 <= v < height):
            raise CloudError(
                f"pixel: ({u}, {v}) is outside of the image, whose columns end at {width - 1}, rows at {height - 1}"
            )
        known = {object_.id: object_ for object_ in self.objects}
        if (name := str(self.labels[v, u])) in known:
            return known[name]
        xyz = self.cloud.xyz[v, u].astype(np.float64)
        where = "no object"
        if not np.isfinite(xyz).all():
            where = "a pixel without depth"
        elif self.table is not None and abs(self.table.height(xyz)) < _ON_TABLE_M:
            where = "the table"
        raise CloudError(f"pixel: ({u}, {v}) is {where}; the objects are {', '.join(known) or 'none'}")

    @checked
    def near(self, point: npt.ArrayLike, tolerance_m: float = NEAR_M) -> Object:
        """Return the object with the point that is nearest to a position.

        Args:
            point: (3,) [m], in the cloud's frame.
            tolerance_m: Largest distance of the nearest point [m].

        Raises:
            CloudError: If no object is so near, or the position is not three finite numbers.
        """
        position, tolerance_m = numbers(point, "point", CloudError), scalar(tolerance_m, "tolerance_m", CloudError)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise CloudError(f"point: {shown(point)} is not three finite numbers [m]")
        away = [
            float(np.linalg.norm(object_.cloud.xyz.astype(np.float64) - position, axis=1).min())
            for object_ in self.objects
        ]
        if not away or not min(away) <= tolerance_m:
            nearest = f"; the nearest is {min(away):.3f} m away" if away else ""
            at = ", ".join(f"{value:g}" for value in position.tolist())
            raise CloudError(f"point: no object within {tolerance_m:g} m of ({at}){nearest}")
        return self.objects[int(np.argmin(away))]
