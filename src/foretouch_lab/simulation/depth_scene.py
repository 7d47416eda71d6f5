# SPDX-License-Identifier: Apache-2.0
"""A simulated depth camera (D415): where it stands, what its stereo adds to exact depth, and scenes of random solids.

The world has its origin on the table top, z up. The camera frame is the optical one (x right,
y down, z forward). Scenes of household-sized solids on a table give exact depth, labels, plane, and camera effects.
"""

from dataclasses import dataclass, replace
from typing import Final, Literal, Self

import numpy as np
import numpy.typing as npt

from foretouch.errors import ConfigError
from foretouch.types import Bool, Cloud, Float32, Float64, Int32, UInt8
from foretouch_lab.simulation.solids import LYING, Primitive, about_z, footprint_m

Window = tuple[slice, slice]


def _pinhole_matrix(width: int, height: int, hfov_deg: float = 65.0) -> Float64:
    """Return (3, 3) float64 intrinsics [px] of square pixels and a centred axis.

    Args:
        width: Columns.
        height: Rows.
        hfov_deg: Horizontal field of view [deg]; by default of a D415.
    """
    # Rounded to float32 as a device stores it, so that frames sent through one stay bit-equal.
    focal = float(np.float32(width / (2.0 * np.tan(np.radians(hfov_deg) / 2.0))))
    return np.array([[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class CameraView:
    """A pinhole camera in the world."""

    width: int  # [px]
    height: int  # [px]
    matrix: Float64  # (3, 3) float64, intrinsics [px]
    eye: Float64  # (3,) float64, its optical centre in the world [m]
    R_world_camera: Float64  # (3, 3) float64, its axes as columns in the world

    @classmethod
    def towards_table(cls, width: int, height: int, distance_m: float, tilt_rad: float, hfov_deg: float = 65.0) -> Self:
        """Return a camera that looks at the origin of the world.

        Args:
            width: [px]
            height: [px]
            distance_m: From the origin [m].
            tilt_rad: Between its axis and the vertical; 0 looks straight down [rad].
            hfov_deg: Horizontal field of view [deg]; by default of a D415.
        """
        sine, cosine = np.sin(tilt_rad), np.cos(tilt_rad)
        forward = np.array([0.0, sine, -cosine])
        right = np.array([1.0, 0.0, 0.0])
        rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
        return cls(width, height, _pinhole_matrix(width, height, hfov_deg), -distance_m * forward, rotation)

    def directions(self, window: Window = (slice(None), slice(None))) -> Float64:
        """Return (h, w, 3) float64 ray of each pixel in the world, one metre deep in the camera frame."""
        x = (np.arange(self.width)[window[1]] - self.matrix[0, 2]) / self.matrix[0, 0]
        y = (np.arange(self.height)[window[0]] - self.matrix[1, 2]) / self.matrix[1, 1]
        axes = self.R_world_camera
        rays: Float64 = (x[:, None] * axes[:, 0])[None] + (y[:, None] * axes[:, 1])[:, None] + axes[:, 2]
        return rays

    def to_camera(self, points: Float64) -> Float64:
        """Return points (..., 3) of the world in the camera frame [m]."""
        return np.asarray((points - self.eye) @ self.R_world_camera, np.float64)

    def to_world(self, points: Float64) -> Float64:
        """Return points (..., 3) of the camera frame in the world [m]."""
        return np.asarray(points @ self.R_world_camera.T + self.eye, np.float64)

    def bounds(self, points: Float64) -> Float64:
        """Return (2, 2) float64 smallest and largest (column, row) of (n, 3) points; the whole line of sight if one is behind."""
        local = self.to_camera(points)
        if (local[:, 2] <= 0.0).any():
            return np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
        pixels = (local @ self.matrix.T)[:, :2] / local[:, 2:]
        return np.stack([pixels.min(axis=0), pixels.max(axis=0)])

    def window(self, points: Float64) -> Window:
        """Return the pixels that can see the convex hull of points (n, 3)."""
        (left, top), (right, bottom) = self.bounds(points)
        columns = slice(int(max(0.0, np.floor(left))), int(min(self.width, np.ceil(right) + 1.0)))
        return slice(int(max(0.0, np.floor(top))), int(min(self.height, np.ceil(bottom) + 1.0))), columns

    def table_plane(self) -> Float64:
        """Return (4,) float64 a, b, c, d of the table top in the camera frame, the normal towards the camera."""
        return np.append(self.R_world_camera[2], self.eye[2])


D415_BASELINE_M = 0.055  # distance of the imagers
FLYING_SHARE = 0.5  # of the pixels of a depth edge that lie between both sides
HOLE_SHARE = 0.01  # of the pixels that lie in random spots without depth
GRAZING_DEG = 80.0  # angle between ray and surface normal beyond which there is no depth
_MATCHING_WINDOW_PX = 9  # side of the block that stereo matching compares
_EDGE_M = 0.02  # a 3x3 window that spans more than this holds a depth edge


def add_stereo_noise(depth: Float64, noise_m: float, rng: np.random.Generator) -> Float64:
    """Add noise that grows with the square of the depth and is correlated over the matching window.

    A constant sub-pixel error s of the disparity gives sigma_z = s·z² / (f·B).

    Args:
        depth: (H, W) float64 [m], inf without a surface.
        noise_m: Standard deviation at a depth of 1 m [m].
        rng: Of the noise.

    Returns:
        (H, W) float64 [m].
    """
    from scipy.ndimage import uniform_filter

    # The mean of k x k independent values has 1/k of their deviation; wrapping keeps it so at the border.
    noise = _MATCHING_WINDOW_PX * uniform_filter(rng.standard_normal(depth.shape), _MATCHING_WINDOW_PX, mode="wrap")
    finite = np.isfinite(depth)
    return np.where(finite, depth + noise_m * np.where(finite, depth, 0.0) ** 2 * noise, np.inf)


def add_flying_pixels(depth: Float64, rng: np.random.Generator) -> Float64:
    """Give pixels on a depth edge a depth between the nearest and the farthest of their 3x3 window.

    Args:
        depth: (H, W) float64 [m], inf without a surface.
        rng: Of the mixing weights.

    Returns:
        (H, W) float64 [m].
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    finite = np.isfinite(depth)
    near = minimum_filter(depth, 3, mode="nearest")
    far = maximum_filter(np.where(finite, depth, -np.inf), 3, mode="nearest")
    edge = finite & (far - near > _EDGE_M)
    weight = rng.random(depth.shape)
    result = depth.copy()
    result[edge] = (weight * far)[edge] + ((1.0 - weight) * near)[edge]
    return result


def stereo_shadow(depth: Float64, focal_px: float, baseline_m: float = D415_BASELINE_M) -> Bool:
    """Return pixels that the second imager, to the right of the first, cannot see.

    A pixel at column u of the depth (H, W) [m] is seen there at u - f·B/z. It is hidden if a pixel to its right, hence
    of something nearer, is seen at the same place or farther left.

    Args:
        depth: (H, W) of the first imager [m].
        focal_px: Focal length [px].
        baseline_m: Distance of the second imager [m].
    """
    seen_at = np.arange(depth.shape[1]) - focal_px * baseline_m / depth
    leftmost = np.minimum.accumulate(seen_at[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(depth.shape, np.bool_)
    hidden[:, :-1] = leftmost[:, 1:] < seen_at[:, :-1]
    return hidden


TABLE: Final = 1  # label of the table; 0 is everything else
FIRST_OBJECT: Final = 2  # label of the first object
TABLE_M: Final = np.array([1.4, 1.0])  # edges of the table top about the world's origin [m]

_FLOOR_M = 0.75  # below the table top
_ATTEMPTS = 200  # places tried for one object before all are placed anew
_ROUNDS = 50
_GAP_M = 0.03  # free table between two objects
_MARGIN = 0.04  # of the image, free of objects on each side

_COLOURS = np.array(
    [[60, 60, 66], [150, 140, 125], [196, 78, 62], [70, 130, 180], [226, 172, 63], [104, 159, 98], [150, 105, 175]],
    np.float32,
)


@dataclass(frozen=True, eq=False)
class RenderedFrame:
    """One frame with its ground truth.

    Attributes:
        depth_mm: (H, W) uint16 [mm] along the optical axis, 0 without depth.
        rgb: (H, W, 3) uint8, in the same view as the depth.
        labels: (H, W) int32: 0 none or floor, 1 table, 2 and on the objects; exact, also where depth is noisy or
            absent.
        K: (3, 3) float64, intrinsics [px].
        plane: (4,) float64, the table in the camera frame, its normal towards the camera [m].
    """

    depth_mm: npt.NDArray[np.uint16]
    rgb: UInt8
    labels: Int32
    K: Float64
    plane: Float64

    def cloud(
        self, frame_id: str = "camera_depth_optical_frame", stamp_ns: int = 0, *, with_rgb: bool = False
    ) -> Cloud:
        """Return the frame as an organised cloud, NaN where there is no depth.

        Args:
            frame_id: Frame of the camera.
            stamp_ns: Time of the frame [ns].
            with_rgb: Whether the points have colours.
        """
        rgb = self.rgb if with_rgb else None
        return Cloud.from_depth(self.depth_mm, self.K, frame_id=frame_id, stamp_ns=stamp_ns, rgb=rgb)


@dataclass(frozen=True, eq=False)
class DepthScene:
    """Solids on a table above a floor, and a camera."""

    view: CameraView  # the camera
    objects: tuple[Primitive, ...]  # the solids; the k-th has the label 2 + k

    def render(
        self, rng: np.random.Generator | None = None, noise_m: float = 0.0, flying_pixels: bool = False
    ) -> RenderedFrame:
        """Render one frame; without effects it is exact to the millimetre that the depth is rounded to.

        Args:
            rng: Generator of noise and flying pixels; None leaves out both.
            noise_m: Standard deviation of the depth at 1 m, growing with its square [m].
            flying_pixels: Whether pixels on a depth edge lie between both sides.
        """
        depth, labels = self.cast()
        rgb = self._colours(depth, labels)
        if rng is not None:
            depth = add_flying_pixels(depth, rng) if flying_pixels else depth
            depth = add_stereo_noise(depth, noise_m, rng) if noise_m > 0.0 else depth
        return RenderedFrame(to_millimetres(depth), rgb, labels, self.view.matrix, self.view.table_plane())

    def cast(self) -> tuple[Float64, Int32]:
        """Return exact depth and labels.

        Returns:
            (H, W) float64 [m] along the optical axis, inf where a ray meets nothing; (H, W) int32.
        """
        rays = self.view.directions()
        table = table_depth(self.view, rays)
        labels = np.where(np.isfinite(table), TABLE, 0).astype(np.int32)
        depth = np.where(np.isfinite(table), table, -(self.view.eye[2] + _FLOOR_M) / _downwards(rays))
        for label, solid in enumerate(self.objects, FIRST_OBJECT):
            window = self.view.window(solid.corners())
            hit = solid.cast(self.view.eye, self.view.directions(window))
            nearer = hit < depth[window]
            depth[window][nearer] = hit[nearer]
            labels[window][nearer] = label
        return depth, labels

    def _colours(self, depth: Float64, labels: Int32) -> UInt8:
        """Return a colour per label, darker where the surface turns away, by the slope of the depth."""
        index = np.where(labels < FIRST_OBJECT, labels, FIRST_OBJECT + (labels - FIRST_OBJECT) % (len(_COLOURS) - 2))
        z = np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)
        slope_v, slope_u = np.gradient(z)
        steep = np.float32(self.view.matrix[0, 0]) * np.hypot(slope_u, slope_v) / np.maximum(z, np.float32(0.1))
        shade = np.float32(1.0) / np.sqrt(np.float32(1.0) + steep * steep)
        colours: Float32 = _COLOURS[index] * (0.35 + 0.65 * shade)[..., None]
        return colours.astype(np.uint8)


def random_scene(
    rng: np.random.Generator,
    width: int = 848,
    height: int = 480,
    n_objects: int = 3,
    *,
    view: Literal["any", "oblique", "top"] = "any",
    may_occlude: bool = False,
) -> DepthScene:
    """Return boxes, cans and balls that stand or lie on a table; they do not touch and are wholly inside the image.

    Args:
        rng: Generator of everything.
        width: [px]
        height: [px]
        n_objects: How many; 0 is an empty table.
        view: Straight down, oblique (30 to 55 degrees from the vertical), or drawn, one in four straight down.
        may_occlude: Whether one object may hide a part of another.

    Raises:
        ConfigError: If the objects find no place.
    """
    tilt = 0.0 if view == "top" or (view == "any" and rng.random() < 0.25) else np.radians(rng.uniform(30.0, 55.0))
    camera = CameraView.towards_table(width, height, rng.uniform(0.8, 1.2), tilt)
    for _ in range(_ROUNDS):
        placed: list[Primitive] = []
        while len(placed) < n_objects:
            solid = _find_place(rng, camera, placed, may_occlude)
            if solid is None:
                break
            placed.append(solid)
        else:
            return DepthScene(camera, tuple(placed))
    raise ConfigError(f"n_objects: {n_objects} find no place in a view of {width}x{height} pixels")


def table_depth(view: CameraView, rays: Float64) -> Float64:
    """Return the depth of the table along rays (..., 3) of a view, inf beside it [m].

    Args:
        view: The camera.
        rays: (..., 3) in the world, one metre deep.
    """
    depth = -view.eye[2] / _downwards(rays)
    at = view.eye[:2] + depth[..., None] * rays[..., :2]
    return np.where((np.abs(at) <= TABLE_M / 2.0).all(axis=-1), depth, np.inf)


def to_millimetres(depth: Float64) -> npt.NDArray[np.uint16]:
    """Round depths [m] to whole millimetres, 0 without depth or where it does not fit."""
    rounded = np.rint(depth * 1000.0)
    return np.where((rounded > 0.0) & (rounded < 65536.0), rounded, 0.0).astype(np.uint16)


def _downwards(rays: Float64) -> Float64:
    return np.minimum(rays[..., 2], -1e-9)  # looking up never meets the table


def _find_place(
    rng: np.random.Generator, view: CameraView, placed: list[Primitive], may_occlude: bool
) -> Primitive | None:
    for _ in range(_ATTEMPTS):
        solid = _random_solid(rng)
        solid = replace(solid, position=solid.position + np.append(rng.uniform(-0.5, 0.5, 2) * TABLE_M, 0.0))
        fits = _in_view(solid, view) and (np.abs(solid.position[:2]) + footprint_m(solid) < TABLE_M / 2.0).all()
        if not fits or any(_collide(solid, other) for other in placed):
            continue
        if may_occlude or not any(_overlap_in_image(solid, other, view) for other in placed):
            return solid
    return None


def _random_solid(rng: np.random.Generator) -> Primitive:
    """Return a box, a can (standing or lying) or a ball that rests on z = 0 above the origin."""
    kind = rng.integers(3)
    turn = about_z(rng.uniform(0.0, 2.0 * np.pi))
    if kind == 0:
        size = rng.uniform((0.04, 0.04, 0.04), (0.14, 0.12, 0.18))
        return Primitive("box", size, np.array([0.0, 0.0, size[2] / 2.0]), turn)
    if kind == 1:
        radius, height = rng.uniform(0.025, 0.05), rng.uniform(0.06, 0.20)
        size = np.array([2.0 * radius, 2.0 * radius, height])
        if rng.random() < 0.5:
            return Primitive("cylinder", size, np.array([0.0, 0.0, height / 2.0]), turn)
        return Primitive("cylinder", size, np.array([0.0, 0.0, radius]), turn @ LYING)
    radius = rng.uniform(0.03, 0.08)
    return Primitive("ball", np.full(3, 2.0 * radius), np.array([0.0, 0.0, radius]))


def _in_view(solid: Primitive, view: CameraView) -> bool:
    low, high = view.bounds(solid.corners())
    size = np.array([view.width, view.height], np.float64)
    return bool((low > _MARGIN * size).all() and (high < (1.0 - _MARGIN) * size).all())


def _collide(body: Primitive, other: Primitive) -> bool:
    apart = footprint_m(body) + footprint_m(other) + _GAP_M
    return float(np.linalg.norm((body.position - other.position)[:2])) < apart


def _overlap_in_image(body: Primitive, other: Primitive, view: CameraView) -> bool:
    """Return whether the rectangles around both, one pixel in a hundred apart, share a pixel."""
    (low_a, high_a), (low_b, high_b) = view.bounds(body.corners()), view.bounds(other.corners())
    gap = 0.01 * view.width
    return bool((low_a < high_b + gap).all() and (low_b < high_a + gap).all())
