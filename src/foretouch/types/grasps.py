# SPDX-License-Identifier: Apache-2.0
"""Grasps: two contacts and the orientation of the hand, one or K of them as columns."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from types import NoneType
from typing import Any, ClassVar, Final, Literal, Self, overload

import numpy as np

from foretouch.errors import ForetouchError, GraspError, quoted, shown
from foretouch.types.arrays import (
    FLAGS,
    TEXT,
    Bool,
    ByValue,
    Columns,
    Float64,
    Objects,
    Rows,
    as_pose,
    column,
    numbers,
    objects,
    plain,
    require_types,
    scalar,
)
from foretouch.types.channels import NO_CHANNELS
from foretouch.types.rotations import are_absent, check_rotation, fault_texts, quaternion_xyzw, require_rotations
from foretouch.types.summary import Summarised, names_of, spread, tallied
from foretouch.types.tables import LabelledTable, Tabular, Variable, labels_of, texts

TILTS = np.radians([0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0, 60.0, -60.0, 75.0, -75.0])
"""Angles of the palm about the line from g1 to g2 [rad]: 0 is straight above, positive ones come from the side to which up x line points."""

_MIRRORED = np.abs(TILTS[:, None] + TILTS).argmin(axis=1)  # place of the negative of each angle


@dataclass(frozen=True, eq=False, repr=False)
class WayIn(Summarised, ByValue):
    """How a described hand comes to a grasp (`foretouch.grasp.hand` finds it)."""

    approach: (
        Float64  # (3,) float64, unit length, from the palm to the middle of the contacts, perpendicular to their line
    )
    thumb_at: Literal["g1", "g2"]  # the contact that the thumb takes; of a gripper, its finger on the positive side
    depth_m: float  # how far the object reaches from the line towards the palm [m]
    approaches: (
        Float64  # (2, A) float64 [m], thumb at g1 and at g2: how much further the hand could go, at each of `TILTS`
    )
    pose_of_hand: Float64  # (4, 4) float64, the tool frame of the hand's description in the cloud's frame
    posture: Float64  # (J,) float64 [rad], angles of `joints`
    joints: tuple[str, ...] = ()  # names of J joints
    hand: str = ""  # its description: a name of the package, or the path of a YAML file
    # Upper bound of the object's width between the contacts, which holds for 95 % [m]: open at least so far
    width_at_most_m: float = math.nan

    def moved(self, pose: Float64) -> Self:
        """Return the same way in another frame, in which `pose` (4, 4) is the frame of this one."""
        return replace(self, approach=pose[:3, :3] @ self.approach, pose_of_hand=pose @ self.pose_of_hand)

    def with_contacts_swapped(self) -> Self:
        """Return the same way to a grasp whose contacts have each other's names."""
        swapped = self.approaches[::-1, _MIRRORED]  # the line turns round, and with it the sign of each angle
        return replace(self, thumb_at="g1" if self.thumb_at == "g2" else "g2", approaches=swapped)


_WAY: Final = ((WayIn, NoneType), "a WayIn, as of plan(target, hand=…)")
_TYPES: Final[dict[str, tuple[Any, str]]] = {"id": TEXT, "object_id": TEXT, "way": _WAY, "flags": FLAGS}
_PLAN_TYPES: Final = {"status": TEXT, "reason": TEXT}
"""Types of fields, and what they are in words."""


@dataclass(frozen=True, eq=False, repr=False)
class Grasp(Summarised, ByValue):
    """Two contacts and the orientation of the hand (P2: g1, g2, R).

    Raises:
        GraspError: If a contact or the rotation is not finite or has a wrong shape, g1 equals g2, or the matrix is no
            rotation.
    """

    g1: Float64  # (3,) float64 [m], cloud frame
    g2: Float64  # (3,) float64 [m], cloud frame
    # (3, 3) float64, columns X, Y, Z of the hand: Z along g1 - g2, X along Z x object axis. Zero where it is not given:
    # a prediction on an object computes it
    rotation: Float64 = field(default_factory=lambda: np.zeros((3, 3)))
    score: float = float("nan")  # score of the planner, higher is better; NaN if it is undefined
    id: str = ""  # unique within a session
    object_id: str = ""  # the object for which it was planned
    way: WayIn | None = None  # how the hand comes to it; None for a grasp that was not planned for a hand
    flags: tuple[str, ...] = ()  # what speaks against it, such as `beside_unseen`

    def __post_init__(self) -> None:
        for name, shape in (("g1", (3,)), ("g2", (3,)), ("rotation", (3, 3))):
            array = numbers(getattr(self, name), name, GraspError)
            if array.shape != shape:
                raise GraspError(f"{name}: shape {array.shape} is not {shape}")
            object.__setattr__(self, name, array)
        object.__setattr__(self, "score", scalar(self.score, "score", GraspError))
        require_types(self, _TYPES, GraspError)
        if fault := contact_faults(self.g1[None], self.g2[None], self.rotation[None])[0]:
            raise GraspError(fault)
        if self.rotation.any():
            check_rotation(self.rotation)

    def _summary(self) -> tuple[str, dict[str, str]]:
        facts = [f"{1e3 * self.width_m:.0f} mm wide at {self.midpoint.round(3).tolist()} m"]
        facts += [] if math.isnan(self.score) else [f"score {self.score:.3g}"]
        facts += [] if self.rotation.any() else ["rotation not given"]
        facts += [f"on object {shown(self.object_id, 20)!r}"] if self.object_id else []
        return ", ".join([*facts, *([] if self.way is None else [shown(self.way.hand, 20)]), *self.flags]), {}

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, as `foretouch grasp --json` prints it.

        Contacts [m], rotation row by row (None where it is not given), score (None if it is undefined), and how a hand comes
        to it, if it was planned for one.
        """
        record: dict[str, Any] = {
            "g1": self.g1,
            "g2": self.g2,
            "rotation": self.rotation.reshape(9) if self.rotation.any() else None,
            "score": self.score,
            "width_m": self.width_m,
            "flags": list(self.flags),
        }
        if (way := self.way) is not None:
            record |= {
                "hand": way.hand,
                "approach": way.approach,
                "depth_m": way.depth_m,
                "width_at_most_m": way.width_at_most_m,
                "approaches": way.approaches,
                "thumb_at": way.thumb_at,
                "pose_of_hand": {
                    "position": way.pose_of_hand[:3, 3],
                    "quaternion_xyzw": quaternion_xyzw(way.pose_of_hand[:3, :3]),
                },
                "posture": dict(zip(way.joints, way.posture.tolist(), strict=True)),
            }
        return {key: plain(value) for key, value in record.items()}

    def moved(self, pose: Float64) -> Self:
        """Return the same grasp in another frame, in which `pose` (4, 4) is the frame of this one."""
        pose = as_pose(pose, GraspError)
        return replace(
            self,
            g1=pose[:3, :3] @ self.g1 + pose[:3, 3],
            g2=pose[:3, :3] @ self.g2 + pose[:3, 3],
            rotation=pose[:3, :3] @ self.rotation,
            way=None if self.way is None else self.way.moved(pose),
        )

    @property
    def is_known(self) -> bool:
        """Whether the contacts are known; False for those of `NO_GRASP`."""
        return not np.array_equal([self.g1, self.g2], [NO_GRASP.g1, NO_GRASP.g2])

    @property
    def midpoint(self) -> Float64:
        """(3,) float64 [m], the origin of the hand frame."""
        return (self.g1 + self.g2) / 2.0

    @property
    def width_m(self) -> float:
        """Distance of the contacts [m]."""
        return float(np.linalg.norm(self.g1 - self.g2))


def _all_finite(rows: Float64) -> Bool:
    """Say which of K rows (K, ...) are finite: (K,) bool."""
    return np.asarray(np.isfinite(rows).all(axis=tuple(range(1, rows.ndim))), np.bool_)


def contact_faults(g1: Float64, g2: Float64, rotation: Float64) -> list[str]:
    """Say why (K, 3) contacts and (K, 3, 3) rotations are no grasps: not finite, or both contacts at one place; else ""."""
    arrays = {"g1": g1, "g2": g2, "rotation": rotation}
    finite = {name: _all_finite(rows) for name, rows in arrays.items()}

    def text(k: int) -> str:
        if wrong := next((name for name in arrays if not finite[name][k]), ""):
            return f"{wrong}: {arrays[wrong][k].tolist()} is not finite"
        return f"g1, g2: both contacts are at {g1[k].tolist()}"

    return fault_texts((g1 != g2).any(axis=1) & finite["g1"] & finite["g2"] & finite["rotation"], text)


@dataclass(frozen=True, eq=False, repr=False)
class Grasps(Summarised, Tabular, Columns, Sequence[Grasp]):
    """K grasps on one cloud as columns, best first where they were planned.

    `grasps[k]` is a `Grasp`, and a slice or a mask selects several. `Grasps(g1, g2)` has no rotations: a prediction on an
    object of a scene, or with a table, computes them as the planner does (`predictions.grasps`); on a cloud without a table
    it refuses such grasps. Rows may hold numbers that are no grasp, such as NaN in a request: `grasps[k]` then raises a
    `GraspError`, and a touch model refuses them with a reason.

    Raises:
        GraspError: Names a column whose shape does not fit, or a matrix that is no rotation.
    """

    fault: ClassVar[type[ForetouchError]] = GraspError

    g1: Float64 = column(3)  # (K, 3) float64 [m], cloud frame
    g2: Float64 = column(3)  # (K, 3) float64 [m], cloud frame
    # (K, 3, 3) float64, columns X, Y, Z of the hand in the cloud frame; zero where it is not given
    rotation: Float64 = column(3, 3, default=0.0)
    score: Float64 = column(default=np.nan)  # (K,) float64, higher is better; NaN if it is undefined
    id: Objects = column(default="", dtype=TEXT)  # (K,) texts, unique within a session
    object_id: Objects = column(default="", dtype=TEXT)  # (K,) texts, the objects for which they were planned
    way: Objects = column(default=None, dtype=_WAY)  # (K,) `WayIn` or None: how the hand comes to each
    flags: Objects = column(
        default=(), dtype=FLAGS
    )  # (K,) tuples of texts: what speaks against each, such as `beside_unseen`
    status: str = "ok"  # of the plan: `ok`, `initial_points` or `no_grasp`
    reason: str = ""  # explanation of the status

    def __post_init__(self) -> None:
        super().__post_init__()
        require_types(self, _PLAN_TYPES, GraspError)
        require_rotations(self.rotation)

    def _summary(self) -> tuple[str, dict[str, str]]:
        absent = int(are_absent(self.rotation).sum())
        return f"{len(self)}, {self.status}", {
            "reason": self.reason,
            "object": names_of(list(dict.fromkeys(filter(None, self.object_id)))),
            "width": f"{spread(1e3 * self.width_m)} mm" if len(self) else "",
            "score": spread(self.score),
            "rotation": f"not given for {absent}, computed on an object" if absent else "",
            "hand": names_of(list(dict.fromkeys(way.hand for way in self.way if way is not None))),
            "flags": tallied(flag for own in self.flags for flag in own),
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON: `status`, `reason` and `grasps`, each as `Grasp.to_dict`; None for a row that is none."""
        faults = contact_faults(self.g1, self.g2, self.rotation)
        rows = [None if fault else self[k].to_dict() for k, fault in enumerate(faults)]
        return {"status": self.status, "reason": self.reason, "grasps": rows}

    def _table(self) -> LabelledTable:
        variables = {
            "g1": Variable(("grasp", "axis"), self.g1, "m"),
            "g2": Variable(("grasp", "axis"), self.g2, "m"),
            "rotation": Variable(("grasp", "axis", "hand_axis"), self.rotation),
            "score": Variable(("grasp",), self.score),
            "width_m": Variable(("grasp",), self.width_m, "m"),
            **{name: Variable(("grasp",), texts(getattr(self, name))) for name in ("id", "object_id")},
        }
        if any(way is not None for way in self.way):
            variables["approach"] = Variable(("grasp", "axis"), self.approach)
            variables["depth_m"] = Variable(("grasp",), self.depth_m, "m")
            variables["width_at_most_m"] = Variable(("grasp",), self.width_at_most_m, "m")
        return LabelledTable(variables, labels_of(NO_CHANNELS))

    @classmethod
    def of(cls, grasps: Sequence[Grasp]) -> "Grasps":
        """Make columns of single grasps.

        Args:
            grasps: K grasps on one cloud.

        Raises:
            GraspError: If it is not a sequence of grasps.
        """
        if isinstance(grasps, Grasps):
            return grasps
        if not isinstance(grasps, Sequence):
            raise GraspError(f"grasps: {type(grasps).__name__} is not a sequence; of one grasp pass [grasp]")
        if wrong := {type(grasp).__name__ for grasp in grasps if not isinstance(grasp, Grasp)}:
            raise GraspError(f"grasps: holds {', '.join(sorted(wrong))}, not Grasp(g1, g2, rotation)")
        if not grasps:
            return NO_GRASPS
        columns: dict[str, Any] = {}
        for name in cls.column_names():
            rows = [getattr(grasp, name) for grasp in grasps]
            if isinstance(rows[0], np.ndarray):  # concatenate() takes half the time of array() for many small arrays
                columns[name] = np.concatenate(rows).reshape(-1, *rows[0].shape)
            else:
                columns[name] = objects(rows) if name in _TYPES else rows  # which each grasp has checked
        return cls(**columns)

    @classmethod
    def unknown(cls, count: int) -> "Grasps":
        """Make rows of NaN.

        Args:
            count: K, their number.
        """
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 0:
            raise GraspError(f"count: {quoted(count)} is not a number of grasps")
        nothing = np.full((count, 3), np.nan)
        return cls(nothing, nothing, np.full((count, 3, 3), np.nan))

    @overload
    def __getitem__(self, rows: int) -> Grasp: ...
    @overload
    def __getitem__(self, rows: Rows) -> Self: ...
    def __getitem__(self, rows: int | Rows) -> Grasp | Self:
        if isinstance(rows, int | np.integer):
            row = self.place_of(rows)
            return Grasp(**{name: getattr(self, name)[row] for name in self.column_names()})
        return self.take(rows)

    def __iter__(self) -> Iterator[Grasp]:
        return (self[k] for k in range(len(self)))

    def moved(self, pose: Float64) -> Self:
        """Return the same grasps in another frame, in which `pose` (4, 4) is the frame of these."""
        pose = as_pose(pose, GraspError)
        return self.replace(
            g1=self.g1 @ pose[:3, :3].T + pose[:3, 3],
            g2=self.g2 @ pose[:3, :3].T + pose[:3, 3],
            rotation=pose[:3, :3] @ self.rotation,
            way=objects([None if way is None else way.moved(pose) for way in self.way]),
        )

    @property
    def midpoint(self) -> Float64:
        """(K, 3) float64 [m], the origins of the hand frames."""
        return (self.g1 + self.g2) / 2.0

    @property
    def width_m(self) -> Float64:
        """(K,) float64 [m], distances of the contacts."""
        return np.asarray(np.linalg.norm(self.g1 - self.g2, axis=1), np.float64)

    @property
    def approach(self) -> Float64:
        """(K, 3) float64, directions in which the hand comes, in the cloud frame; NaN for a grasp without a way in."""
        return self._of_ways("approach", np.full(3, np.nan))

    @property
    def depth_m(self) -> Float64:
        """(K,) float64 [m], how far the object reaches from the line towards the palm; NaN for a grasp without a way in."""
        return self._of_ways("depth_m", np.array(np.nan))

    @property
    def width_at_most_m(self) -> Float64:
        """(K,) float64 [m], upper bounds of the objects' widths between the contacts, which hold for 95 %; NaN for a grasp without a way in."""
        return self._of_ways("width_at_most_m", np.array(np.nan))

    @property
    def pose_of_hand(self) -> Float64:
        """(K, 4, 4) float64, what an arm is sent to: the tool frame of the hand's description; NaN for a grasp without a way in."""
        return self._of_ways("pose_of_hand", np.full((4, 4), np.nan))

    def _of_ways(self, name: str, absent: Float64) -> Float64:
        rows = [absent if way is None else getattr(way, name) for way in self.way]
        return np.asarray(rows, np.float64).reshape(len(self), *absent.shape)

    @property
    def pose(self) -> Float64:
        """(K, 4, 4) float64, poses of the hand in the cloud frame: x_cloud = pose @ x_hand, origin at the midpoint [m].

        A `GraspError` if a rotation is not given.
        """
        if (absent := are_absent(self.rotation)).any():
            rule = "is not given; a prediction on an object computes it (predictions.grasps.pose)"
            raise GraspError(f"rotation: of grasp {int(absent.argmax())} {rule}")
        poses = np.zeros((len(self), 4, 4))
        poses[:, :3, :3] = self.rotation
        poses[:, :3, 3] = self.midpoint
        poses[:, 3, 3] = 1.0
        return poses


NO_GRASPS = Grasps(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3)))
"""No grasp."""

NO_GRASP = Grasp(np.array([0.5, 0.0, 0.0]), np.array([-0.5, 0.0, 0.0]), np.eye(3)[:, [1, 2, 0]])
"""In the place of a grasp that is not known: contacts that no hand reaches."""
