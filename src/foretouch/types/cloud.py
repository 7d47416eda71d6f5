# SPDX-License-Identifier: Apache-2.0
"""Point clouds and planes."""

import math
import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from foretouch.errors import CloudError, checked, quoted, require_type, shown
from foretouch.kernels import struct
from foretouch.types.arrays import (
    AnyArray,
    Float32,
    Float64,
    Floating,
    Rows,
    UInt8,
    as_pose,
    as_rows,
    numbers,
    scalar,
    unmasked,
)
from foretouch.types.camera import CameraModel, DepthImage, as_image, check_image
from foretouch.types.summary import Summarised

SQUARABLE = (1e-145, 1e150)
"""Numbers between these have squares of full precision.

A vector with a larger or smaller one is scaled before its norm.
"""


_UNIT = 1e-3  # largest deviation of a normal's length from 1


@dataclass(frozen=True, eq=False, repr=False)
class Cloud(Summarised):
    """A point cloud, organised like an image or not.

    Raises:
        CloudError: If a shape or a type is wrong.
    """

    # (N, 3) or organised (H, W, 3) [m]; any numbers are converted to float32. All three are NaN for a pixel without depth
    xyz: Float32
    rgb: UInt8 | None = None  # the same shape, uint8, or None
    frame_id: str = ""  # the frame of `xyz`
    stamp_ns: int = 0  # time of measurement [ns]
    camera: CameraModel | None = None  # whose rays the points of the image are on; None if it is not known

    def __post_init__(self) -> None:
        _check_header(self.frame_id, self.stamp_ns)
        if type(self.xyz) is not np.ndarray or self.xyz.dtype != np.float32:
            object.__setattr__(self, "xyz", _as_float32(self.xyz))
        if self.xyz.ndim not in (2, 3) or self.xyz.shape[-1] != 3:
            raise CloudError(f"xyz: shape {self.xyz.shape} is neither (N, 3) nor (H, W, 3)")
        if self.rgb is not None:
            if type(self.rgb) is not np.ndarray:
                object.__setattr__(self, "rgb", _as_colours(self.rgb))
            if self.rgb.shape != self.xyz.shape:
                raise CloudError(f"rgb: shape {self.rgb.shape} differs from xyz, {self.xyz.shape}")
            if self.rgb.dtype != np.uint8:
                raise CloudError(f"rgb: dtype {self.rgb.dtype} is not uint8")
        if not isinstance(self.camera, CameraModel | None):
            raise CloudError(f"camera: {type(self.camera).__name__} is not a CameraModel")
        if self.camera is not None and self.camera.shape != self.xyz.shape[:-1]:
            raise CloudError(f"camera: {self.camera.shape} is not the size of the image, {self.xyz.shape[:-1]}")

    @classmethod
    @checked
    def from_depth(
        cls,
        depth: AnyArray,
        K: npt.ArrayLike | CameraModel,  # noqa: N803
        scale: float | None = None,
        distortion: npt.ArrayLike | None = None,
        *,
        frame_id: str = "",
        stamp_ns: int = 0,
        rgb: UInt8 | None = None,
    ) -> "Cloud":
        """Make the organised cloud of a depth image, which is copied: the next image may be written into the same buffer.

        Args:
            depth: (H, W) uint16, float32 or float64, distance along the optical axis. 0, NaN and infinity are no depth.
            K: (3, 3) intrinsics, or fx, fy, cx, cy [px], of the whole image; or a `CameraModel`, which holds its distortion.
            scale: Metres per unit of `depth`; by default 0.001 for uint16 (millimetres) and 1 for floats (metres).
            distortion: Coefficients of OpenCV's models in its order: k1, k2, p1, p2, k3, k4, k5, k6; None for a rectified
                image. It is undone once for a camera.
            frame_id: Optical frame of the camera.
            stamp_ns: Time of measurement [ns].
            rgb: (H, W, 3) uint8 colours of the same pixels.

        Raises:
            CloudError: If the image is no depth image, `K` is not of its size, or its unit is not plausible. The message
                names the argument.

        Warns:
            UserWarning: If `cx`, `cy` lie so far off the middle that the image may have been cropped.
        """
        image = as_image(depth)
        if not isinstance(K, CameraModel):
            height, width = check_image(image)
            K = CameraModel.of(K, width, height, distortion)  # noqa: N806
            if K.remark:
                warnings.warn(K.remark, stacklevel=3)
        elif distortion is not None:
            raise CloudError("distortion: is given twice, here and in the CameraModel")
        colours = None if rgb is None else _as_colours(rgb).copy()
        return DepthCloud.of(DepthImage(image, K, scale), colours, frame_id, stamp_ns)

    def _summary(self) -> tuple[str, dict[str, str]]:
        finite = int(np.count_nonzero(np.isfinite(self.xyz[..., 2])))
        shape = f"{self.xyz.shape[0]} x {self.xyz.shape[1]} pixels, " if self.organised else ""
        return self._titled(f"{shape}{finite:,} of {self.size:,} points finite")

    def _titled(self, points: str) -> tuple[str, dict[str, str]]:
        colours = ", colours" if self.rgb is not None else ""
        frame = f", frame {shown(self.frame_id, 30)!r}" if self.frame_id else ""
        return f"{points}{colours}{frame}", {}

    @property
    def organised(self) -> bool:
        """Whether the points form an image."""
        return self.xyz.ndim == 3

    @property
    def size(self) -> int:
        """Number of points, including those without depth."""
        return self.xyz.size // 3

    @property
    def finite(self) -> Float32:
        """(N, 3) float32 [m], the points whose coordinates are finite."""
        points = self.xyz.reshape(-1, 3)
        return points[np.isfinite(points).all(axis=1)]

    def c_depths(self, pinhole: Float64) -> Any:
        """Return the depths of an organised cloud as kernels read them (`Depths`), with the focal length and the principal point across and down (4,) [px]."""
        height, width = self.shape
        return struct("Depths", xyz=np.ascontiguousarray(self.xyz), h=height, w=width, camera=pinhole)

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W) of an image, or (N,) of a list of points."""
        return self.xyz.shape[:-1]

    def take(self, index: Rows) -> "Cloud":
        """Return selected points as an unorganised cloud.

        Args:
            index: Flat indices of points, a slice of them, or a mask (N,) or (H, W) bool.

        Raises:
            NoSuchRowError: If it is something else, or there is no such point.
        """
        if isinstance(index, np.ndarray) and index.dtype == np.bool_ and index.shape == self.shape:
            index = index.reshape(-1)
        rows = as_rows(index, self.size, type(self).__name__)
        flat = np.arange(self.size)[rows] if isinstance(rows, slice) else rows
        rgb = None if self.rgb is None else self.rgb.reshape(-1, 3).take(flat, axis=0)
        # take() is four times as fast as indexing here.
        return Cloud(self.xyz.reshape(-1, 3).take(flat, axis=0), rgb, self.frame_id, self.stamp_ns)


def require_cloud(cloud: object) -> None:
    """Refuse what is no cloud, such as an array, with a `CloudError`."""
    require_type(cloud, Cloud, "cloud", "not a Cloud, such as Cloud.from_depth(depth, K) or Cloud(xyz)", CloudError)


class DepthCloud(Cloud):
    """The cloud of a depth image, whose points are made when they are first asked for.

    Attributes:
        image: The depth image; None in a copy of the cloud with another field (`dataclasses.replace`).
    """

    image: DepthImage | None = None

    @classmethod
    def of(cls, image: DepthImage, rgb: UInt8 | None, frame_id: str, stamp_ns: int) -> Self:
        """Make the cloud of an image.

        Args:
            image: The depth image.
            rgb: (H, W, 3) colours, if there are any.
            frame_id: Frame of the camera.
            stamp_ns: Time of the image [ns].
        """
        no_points = np.broadcast_to(np.float32(np.nan), (*image.shape, 3))
        fields = vars(Cloud(no_points, rgb, frame_id, stamp_ns, image.camera))
        cloud = cls.__new__(cls)
        vars(cloud).update({name: value for name, value in fields.items() if name != "xyz"}, image=image)
        return cloud

    @cached_property
    def xyz(self) -> Float32:
        """(H, W, 3) float32 [m]."""
        assert self.image is not None  # noqa: S101  a copy has its points
        return self.image.points()

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W) of the image."""
        return super().shape if self.image is None else self.image.shape

    def c_depths(self, pinhole: Float64) -> Any:
        """As of a cloud of points, which are not made for it."""
        return super().c_depths(pinhole) if self.image is None else self.image.c_depths(pinhole)

    def _summary(self) -> tuple[str, dict[str, str]]:
        if self.image is None or "xyz" in vars(self):
            return super()._summary()
        return self._titled(f"depth image of {self.image.shape[0]} x {self.image.shape[1]} pixels")

    @property
    def organised(self) -> bool:
        """Whether the points form an image (H, W)."""
        return self.image is not None or super().organised

    @property
    def size(self) -> int:
        """Number of points, whether they have a depth or not."""
        return super().size if self.image is None else self.image.shape[0] * self.image.shape[1]


def _as_float32(xyz: Any) -> Float32:
    """Convert an array of numbers to float32; what is masked or missing is NaN, and what float32 cannot hold infinite: no points."""
    try:
        array = unmasked(xyz)
    except ValueError as err:
        raise CloudError(f"xyz: {err}") from err
    if array.dtype == object:
        array = numbers(array, "xyz", CloudError)
    if array.dtype.kind not in "fiu":
        raise CloudError(f"xyz: dtype {array.dtype} is not of numbers")
    with np.errstate(over="ignore"):
        points = array.astype(np.float32)
    if isinstance(xyz, np.ma.MaskedArray) and points.ndim:
        points[np.isnan(points).any(axis=-1)] = np.nan  # masked in one coordinate
    return points


def _as_colours(rgb: Any) -> AnyArray:
    """Return colours as an array, masked ones black; a `CloudError` if they are no array."""
    try:
        return np.asarray(np.ma.filled(rgb, 0))
    except (ValueError, TypeError) as err:
        raise CloudError(f"rgb: {shown(rgb)} is not an array of uint8") from err


def _check_header(frame_id: object, stamp_ns: object) -> None:
    if not isinstance(frame_id, str):
        raise CloudError(f"frame_id: {quoted(frame_id)} is not a text")
    if not isinstance(stamp_ns, (int, np.integer)) or not -(2**63) <= stamp_ns < 2**63:
        raise CloudError(f"stamp_ns: {quoted(stamp_ns)} is not a whole number of nanoseconds")


@dataclass(frozen=True, eq=False, repr=False)
class Plane(Summarised):
    """The plane n·p + d = 0.

    Raises:
        CloudError: If the normal is not of unit length, or the offset not finite.
    """

    normal: Float64  # (3,) float64, unit length, towards the camera if the plane was measured
    offset: float  # d [m]
    assumed: bool = False  # whether it was not seen, but follows from the camera looking straight down

    def __post_init__(self) -> None:
        normal = numbers(self.normal, "normal", CloudError)
        if normal.shape != (3,):
            raise CloudError(f"normal: shape {normal.shape} is not (3,)")
        length = math.hypot(*normal.tolist())
        offset = scalar(self.offset, "offset", CloudError)
        if not abs(length - 1.0) < _UNIT or not math.isfinite(offset):
            rule = "is not 1, or the offset is not finite; Plane.from_coefficients((a, b, c, d)) takes any length"
            raise CloudError(f"normal: length {length:g} of {normal.tolist()} with offset {self.offset!r} {rule}")
        object.__setattr__(self, "normal", normal)
        object.__setattr__(self, "offset", offset)

    def _summary(self) -> tuple[str, dict[str, str]]:
        return (
            f"normal {self.normal.round(3).tolist()}, offset {self.offset:.4g} m{', assumed' if self.assumed else ''}",
            {},
        )

    @classmethod
    def from_coefficients(cls, coefficients: npt.ArrayLike) -> Self:
        """Make a plane of the coefficients of a x + b y + c z + d = 0.

        Args:
            coefficients: a, b, c and d, of any scale.

        Raises:
            CloudError: If they or the offset are not finite, or (a, b, c) is zero.
        """
        abcd = numbers(coefficients, "plane", CloudError)
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

    @property
    def towards_camera(self) -> "Plane":
        """The same plane, its normal on the side of the origin, where the camera is."""
        return replace(self, normal=-self.normal, offset=-self.offset) if self.offset < 0.0 else self

    def moved(self, pose: Float64) -> "Plane":
        """Return the same plane in another frame, in which `pose` (4, 4) is the frame of this one."""
        pose = as_pose(pose, CloudError)
        normal = pose[:3, :3] @ self.normal
        return replace(self, normal=normal, offset=self.offset - float(normal @ pose[:3, 3]))

    def height(self, xyz: Floating) -> Floating:
        """Compute the distance of points from the plane.

        Args:
            xyz: (..., 3) floating [m], in the plane's frame.

        Returns:
            (...) [m], positive on the normal's side.
        """
        floating = isinstance(xyz, np.ndarray) and xyz.dtype.kind == "f"
        points: Floating = xyz if floating else numbers(xyz, "xyz", CloudError)
        if points.shape[-1:] != (3,):
            raise CloudError(f"xyz: shape {points.shape} is not (..., 3)")
        return points @ self.normal.astype(points.dtype) + points.dtype.type(self.offset)


ASSUMED_TABLE = Plane(np.array([0.0, 0.0, 1.0]), -1.27, assumed=True)
"""The table of a cloud that holds only an object: seen from straight above, as in the public recordings."""


def assumed_table(cloud: Cloud, up: Float64 | None = None) -> Plane:
    """Return the table of a cloud that holds only an object: as `ASSUMED_TABLE`, but through the farthest point.

    Args:
        cloud: Of the object.
        up: (3,) float64 of unit length in its frame, where it is known what is up; then through the lowest point.
    """
    points = cloud.finite.astype(np.float64)
    if not len(points):
        return ASSUMED_TABLE
    if up is not None:
        return Plane(up, -float((points @ up).min()))
    return replace(ASSUMED_TABLE, offset=-float(points[:, 2].max()))


NO_CLOUD = Cloud(np.empty((0, 3), np.float32))
"""The cloud of a sample that was recorded without a camera: it has no points, and the sample's grasp is not known."""
