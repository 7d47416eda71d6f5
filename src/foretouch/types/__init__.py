# SPDX-License-Identifier: Apache-2.0
"""Data types shared by all packages: clouds, planes, grasps, tactile readings.

All are frozen. Lengths are in metres, stamps in integer nanoseconds, tactile values in the unit of the sensor. Clouds and
everything derived from them are in the camera's optical frame (x right, y down, z forward) unless `frame_id` differs.
"""

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Self, overload

import numpy as np
import numpy.typing as npt

from foretouch.errors import CloudError, GraspError, TactileError
from foretouch.types.channels import Channels

AnyArray = npt.NDArray[Any]
Bool = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Floating = npt.NDArray[np.floating]
Index = npt.NDArray[np.intp]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]
Integer = npt.NDArray[np.integer]
UInt8 = npt.NDArray[np.uint8]
Reference = Literal["none", "tare", "touches", "history"]

SECOND_NS = 1_000_000_000
"""Nanoseconds in a second."""

SQUARABLE = (1e-145, 1e150)
"""Numbers between these have squares of full precision.

A vector with a larger or smaller one is scaled before its norm.
"""


@dataclass(frozen=True, eq=False)
class Cloud:
    """A point cloud, organised like an image or not.

    Raises:
        CloudError: If a shape or a dtype is wrong.
    """

    xyz: Float32  # (N, 3) or organised (H, W, 3), float32 [m]. All three are NaN for a pixel without depth
    rgb: UInt8 | None = None  # the same shape, uint8, or None
    frame_id: str = ""  # the frame of `xyz`
    stamp_ns: int = 0  # time of measurement [ns]

    def __post_init__(self) -> None:
        if self.xyz.ndim not in (2, 3) or self.xyz.shape[-1] != 3:
            raise CloudError(f"xyz: shape {self.xyz.shape} is neither (N, 3) nor (H, W, 3)")
        if self.xyz.dtype != np.float32:
            raise CloudError(f"xyz: dtype {self.xyz.dtype} is not float32")
        if self.rgb is not None:
            if self.rgb.shape != self.xyz.shape:
                raise CloudError(f"rgb: shape {self.rgb.shape} is not that of xyz, {self.xyz.shape}")
            if self.rgb.dtype != np.uint8:
                raise CloudError(f"rgb: dtype {self.rgb.dtype} is not uint8")

    @property
    def organised(self) -> bool:
        """Whether the points form an image."""
        return self.xyz.ndim == 3

    @property
    def size(self) -> int:
        """Number of points, including those without depth."""
        return self.xyz.size // 3

    def take(self, index: Index | Bool) -> "Cloud":
        """Selected points as an unorganised cloud, by flat indices or by a mask (N,) or (H, W)."""
        flat = np.flatnonzero(index) if index.dtype == np.bool_ else index
        rgb = None if self.rgb is None else self.rgb.reshape(-1, 3).take(flat, axis=0)
        # take() is four times as fast as indexing here.
        return Cloud(self.xyz.reshape(-1, 3).take(flat, axis=0), rgb, self.frame_id, self.stamp_ns)


@dataclass(frozen=True, eq=False)
class Plane:
    """The plane n·p + d = 0."""

    normal: Float64  # (3,) float64, unit length, towards the camera if the plane was measured
    offset: float  # d [m]

    @classmethod
    def from_coefficients(cls, coefficients: npt.ArrayLike) -> Self:
        """A plane from (a, b, c, d) of any scale.

        A `CloudError` if they or the offset are not finite or (a, b, c) is zero.
        """
        abcd = np.asarray(coefficients, dtype=np.float64)
        if abcd.shape != (4,) or not np.isfinite(abcd).all():
            raise CloudError(f"plane: {coefficients!r} is not four finite numbers")
        largest = float(np.abs(abcd[:3]).max())
        if largest == 0.0:
            raise CloudError("plane: the normal has zero length")
        with np.errstate(over="ignore"):
            if not SQUARABLE[0] < largest < SQUARABLE[1]:
                abcd = abcd / largest
            abcd = abcd / float(np.linalg.norm(abcd[:3]))
        if not np.isfinite(abcd[3]):
            raise CloudError(f"plane: the offset of {coefficients!r} is not finite")
        return cls(abcd[:3], float(abcd[3]))

    @property
    def coefficients(self) -> Float64:
        """(4,) float64: a, b, c, d."""
        return np.append(self.normal, self.offset)

    def height(self, xyz: Floating) -> Floating:
        """Signed distance of points (..., 3) from the plane [m], positive on the normal's side."""
        return xyz @ self.normal.astype(xyz.dtype) + xyz.dtype.type(self.offset)


ASSUMED_TABLE = Plane.from_coefficients([0.0, 0.0, 1.0, -1.27])
"""The table of a cloud that holds only an object: seen from straight above, as in the public recordings."""


def assumed_table(cloud: Cloud) -> Plane:
    """The table of a cloud that holds only an object: as `ASSUMED_TABLE`, but through the farthest point."""
    depths = cloud.xyz[..., 2]
    depths = depths[np.isfinite(depths)]
    return Plane(ASSUMED_TABLE.normal, -float(depths.max())) if depths.size else ASSUMED_TABLE


@dataclass(frozen=True, eq=False)
class WayIn:
    """How a described hand comes to a grasp; see `foretouch.grasp.hand`."""

    approach: Float64  # (3,) float64, unit length, from the palm to the middle of the contacts and perpendicular to their line
    thumb_at: Literal["g1", "g2"]  # the contact that the thumb takes, of a gripper its finger on the positive side
    depth_m: float  # how far the object reaches from the line towards the palm [m]
    approaches: (
        Float64  # (2, A) float64 [m], thumb at g1 and at g2: how much further the hand could go, at each of `LEANS`
    )
    pose_of_hand: Float64  # (4, 4) float64, the tool frame of the hand's description in the cloud's frame
    posture: Float64  # (J,) float64 [rad], angles of `joints`
    joints: tuple[str, ...] = ()  # names of J joints


@dataclass(frozen=True, eq=False)
class Grasp:
    """Two contacts and the orientation of the hand (P2: g1, g2, R).

    Raises:
        GraspError: If a contact or the rotation is not finite or has a wrong shape, or g1 equals g2.
    """

    g1: Float64  # (3,) float64 [m], cloud frame
    g2: Float64  # (3,) float64 [m], cloud frame
    rotation: Float64  # (3, 3) float64, columns X, Y, Z of the hand: Z along g1 - g2, X along Z x object axis
    score: float = float("nan")  # score of GeoGrasp, higher is better; NaN if it is undefined
    id: str = ""  # unique within a session
    object_id: str = ""  # the object for which it was planned
    way: WayIn | None = None  # how the hand comes to it; None for a grasp that was not planned for a hand

    def __post_init__(self) -> None:
        for name, shape in (("g1", (3,)), ("g2", (3,)), ("rotation", (3, 3))):
            value = getattr(self, name)
            if value.shape != shape:
                raise GraspError(f"{name}: shape {value.shape} is not {shape}")
            if not np.isfinite(value).all():
                raise GraspError(f"{name}: {value.tolist()} is not finite")
        if np.array_equal(self.g1, self.g2):
            raise GraspError(f"g1, g2: both contacts are at {self.g1.tolist()}")

    @classmethod
    def checked(cls, g1: Float64, g2: Float64, rotation: Float64, score: float, id: str, object_id: str) -> Self:  # noqa: A002
        """A grasp whose arrays the caller has checked for many at once, in a fifth of the time."""
        grasp = cls.__new__(cls)
        grasp.__dict__.update(g1=g1, g2=g2, rotation=rotation, score=score, id=id, object_id=object_id)
        return grasp

    @property
    def midpoint(self) -> Float64:
        """(3,) float64 [m], the origin of the hand frame."""
        return (self.g1 + self.g2) / 2.0

    @property
    def width_m(self) -> float:
        """Distance of the contacts [m]."""
        return float(np.linalg.norm(self.g1 - self.g2))


class GraspList(tuple[Grasp, ...]):  # noqa: SLOT001  it keeps what is computed
    """Grasps whose arrays are made once, however many functions need them."""

    @cached_property
    def arrays(self) -> tuple[Float64, Float64, Float64]:
        """See `stacked`; read-only."""
        if not self:
            return np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3))
        parts = ([grasp.g1 for grasp in self], [grasp.g2 for grasp in self], [grasp.rotation for grasp in self])
        # concatenate() takes half the time of array() for many small arrays.
        g1, g2, rotation = (np.concatenate(part, dtype=np.float64) for part in parts)
        for one in (g1, g2, rotation):
            one.flags.writeable = False
        return g1.reshape(-1, 3), g2.reshape(-1, 3), rotation.reshape(-1, 3, 3)


def stacked(grasps: Sequence[Grasp]) -> tuple[Float64, Float64, Float64]:
    """(K, 3) g1, (K, 3) g2 and (K, 3, 3) rotations of K grasps, float64."""
    return grasps.arrays if isinstance(grasps, GraspList) else GraspList(grasps).arrays


@dataclass(frozen=True, eq=False)
class Touch:
    """A tactile reading of both fingers, in the unit of each channel.

    Raises:
        TactileError: If the shape is wrong. Values are checked by `foretouch.tactile.touch_faults`.
    """

    values: Float64  # (D,) float64, in the order of `channels`; for the BioTac SP (50,): PDC_TH, PDC_MF, E_TH, E_MF
    channels: Channels  # what they are

    def __post_init__(self) -> None:
        if self.values.shape != (self.channels.size,):
            name = self.channels.sensor
            raise TactileError(f"touch: shape {self.values.shape} is not ({self.channels.size},) of {name}")
        if self.values.dtype != np.float64:
            object.__setattr__(self, "values", self.values.astype(np.float64))

    def __getitem__(self, modality: str) -> Float64:
        """(M,) values of a modality, such as E_TH; a `TactileError` if there is none of that name."""
        return self.values[self.channels.columns([modality])]

    def parts(self) -> dict[str, float | Float64]:
        """Values by modality: a number where it has one, else (M,) float64."""
        found = {name: self[name] for name in self.channels.modalities}
        return {name: float(part[0]) if len(part) == 1 else part for name, part in found.items()}


LATE = "late"
"""Flag of a prediction of an old cloud, or beyond the latency budget."""

UNKNOWN_FRAME = "unknown_frame"
"""Flag of the answer to a request in a frame that is not that of the graph's clouds, where no transform is known."""

REDUCED = "reduced"
"""Flag of a prediction by a cheaper form of the model, to meet the latency budget."""


@dataclass(frozen=True)
class Evidence:
    """How many readings a prediction was adapted to, and how old they are."""

    touches: int = 0  # of the same object
    touch_age_s: float | None = None  # since the last touch of the object [s]; None without, or if it is not known
    readings: int = 0  # of the hand in all, touches of any object and tares
    reading_age_s: float | None = None  # since the last of them [s]; None without, or if it is not known


@dataclass(frozen=True, eq=False)
class TouchPrediction:
    """The predicted reading of both fingertips if `grasp` were executed."""

    grasp: Grasp
    value: Touch | None  # prediction; None if `status` is not "ok"
    lower: Touch | None = None  # lower bounds of the prediction intervals; None without calibration
    upper: Touch | None = None  # upper bounds
    reference: Reference = "none"  # tactile readings to which the prediction was adapted
    # `out_of_range`, `unfamiliar`, `similar_touches`, `equal_pressure`, `late`, `reduced`, `fallback_model`, `ambiguous_target`, `unknown_frame`
    flags: tuple[str, ...] = ()
    status: Literal["ok", "bad_grasp", "refused"] = "ok"  # bad_grasp: no hand can execute it
    reason: str = ""  # why it was refused; "" if ok
    evidence: Evidence = Evidence()  # the readings behind `reference`


class TouchPredictions(Sequence[TouchPrediction]):
    """Predictions for K grasps of one call, kept as columns; each becomes an object when it is first read.

    Args:
        grasps: (K,) grasps.
        channels: Of the model, D values of a touch.
        values: (K, D) float64 predictions.
        bounds: (K, D) lower and upper bounds; None without calibration.
        flags: (K,) flags of each.
        reference: Readings to which they were adapted.
        evidence: The readings behind `reference`.
        refused: Those that hold no value, by their number.
    """

    def __init__(
        self,
        grasps: Sequence[Grasp],
        channels: Channels,
        values: Float64,
        bounds: tuple[Float64, Float64] | None,
        flags: Sequence[tuple[str, ...]],
        reference: Reference,
        evidence: Evidence,
        refused: Mapping[int, TouchPrediction],
    ) -> None:
        self.grasps, self.values, self.bounds, self.flags = grasps, values, bounds, flags
        self.channels, self.refused = channels, refused
        self._shared = {"reference": reference, "status": "ok", "reason": "", "evidence": evidence}
        self._made: list[TouchPrediction | None] = [refused.get(number) for number in range(len(grasps))]

    def flagged(self, flags: Sequence[tuple[str, ...]]) -> "TouchPredictions":
        """The same with (K,) more flags of each."""
        twin = copy(self)
        both = [old + new for old, new in zip(self.flags, flags, strict=True)]
        twin.__dict__.update(flags=both, _made=[self.refused.get(number) for number in range(len(self.grasps))])
        return twin

    def __len__(self) -> int:
        return len(self._made)

    @overload
    def __getitem__(self, index: int) -> TouchPrediction: ...
    @overload
    def __getitem__(self, index: slice) -> list[TouchPrediction]: ...
    def __getitem__(self, index: int | slice) -> TouchPrediction | list[TouchPrediction]:
        if isinstance(index, slice):
            return [self[k] for k in range(len(self))[index]]
        made = self._made[index]
        if made is None:
            k = range(len(self))[index]
            made = self._made[k] = self._build(slice(k, k + 1))[0]
        return made

    def __iter__(self) -> Iterator[TouchPrediction]:
        if None in self._made:  # all together takes a fifth of the time of one by one
            built = self._build(slice(None))
            self._made = [new if old is None else old for new, old in zip(built, self._made, strict=True)]
        return (self[k] for k in range(len(self)))

    def _build(self, part: slice) -> list[TouchPrediction]:
        values = _touches(self.values[part], self.channels)
        lower: Sequence[Touch | None] = [None] * len(values)
        upper = lower
        if self.bounds is not None:
            lower, upper = (_touches(bound[part], self.channels) for bound in self.bounds)
        built = []
        for grasp, value, low, high, flags in zip(
            self.grasps[part], values, lower, upper, self.flags[part], strict=True
        ):
            one = TouchPrediction.__new__(TouchPrediction)  # a frozen class sets each field by a call
            one.__dict__.update(self._shared, grasp=grasp, value=value, lower=low, upper=high, flags=flags)
            built.append(one)
        return built


def prediction_rows(predictions: Sequence[Any], size: int) -> Float64:
    """(3, K, D) values, lower and upper bounds of predictions of D values; NaN where there is none, as of a refusal."""
    if isinstance(predictions, TouchPredictions):
        none = np.full((len(predictions), size), np.nan)
        return np.array([predictions.values, *(predictions.bounds or (none, none))])
    ends = [[getattr(one, end, None) for one in predictions] for end in ("value", "lower", "upper")]
    nothing = np.full(size, np.nan)
    return np.array([[nothing if one is None else one.values for one in end] for end in ends])


def _touches(rows: Float64, channels: Channels) -> list[Touch]:
    """The `Touch` of each row of (K, D), in a third of the time for many."""
    made = []
    for row in rows.copy():
        one = Touch.__new__(Touch)
        one.__dict__.update(values=row, channels=channels)
        made.append(one)
    return made


NO_CLOUD = Cloud(np.empty((0, 3), np.float32))
"""The cloud of a sample that was recorded without a camera: it has no points, and the sample's grasp is not known."""

NO_GRASP = Grasp(np.array([0.5, 0.0, 0.0]), np.array([-0.5, 0.0, 0.0]), np.eye(3)[:, [1, 2, 0]])
"""In the place of a grasp that is not known: contacts that no hand reaches."""


@dataclass(frozen=True, eq=False)
class GraspSample:
    """One grasp of the dataset (P2: <C, g1, g2, R, PDC_TH, PDC_MF, E_TH, E_MF>)."""

    id: str  # `<object>/<source id>`
    object: str  # label of the object
    # By factories, since subclasses read their cloud when it is asked for, and must not find a default in the class.
    cloud: Cloud = field(default_factory=lambda: NO_CLOUD)  # the object's cloud on which the grasp was planned
    grasp: Grasp = field(default_factory=lambda: NO_GRASP)
    touch: Touch | None = None  # reading in contact; None for an unlabelled sample
    tare: Touch | None = None  # reading without contact; None if there is none
    stamp_ns: int = 0  # time of recording [ns]
    extra: Mapping[str, float] = field(default_factory=dict)  # further values of the source, by name
