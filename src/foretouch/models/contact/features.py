# SPDX-License-Identifier: Apache-2.0
"""Features of an object and a grasp in the frame of the hand and of the table: independent of where the camera is, and of density.

    cloud ─► object: sizes along its principal axes, visible height ─────────┐
    grasp ─► width, place on the object, the object in the hand's frame ─────┼─► one row for each grasp
    points around each contact ─► slope, size and place of the pad's patch ──┘

All lengths and directions are in the frame of the hand (x away from the camera, z from the second contact to the
first), along the object's principal axes, or along the optical axis: where the object is in the picture, and how the
camera is rolled, changes none of them. All are means, moments, quantiles or shares of points, which thinning does not
shift; points around a contact weigh less the farther they are, so that no point enters or leaves by a step.

Heights are above the table, and `approach` and `rise` are the directions of the hand relative to its normal. Without a
table the camera is assumed to look straight down on it, as in the public recordings (`foretouch.types.ASSUMED_TABLE`).
A camera that is tilted sees other parts of an object. Its points are therefore brought to what a camera above the table
would see (`models.contact.above`). In views that the training does not have, objects are compared by the upper side alone.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from foretouch.cloud.geometry.columns import centred_columns, distances, quantiles
from foretouch.kernels import Kernel, struct
from foretouch.models.contact.above import STEEP, seen_from_above, upper_side, without_walls
from foretouch.models.novelty import principal_axes, usable_points
from foretouch.types import Float64, Grasp, Grasps, Int32, Int64, Plane

_sort_into_cells = Kernel("sort_into_cells")
_describe_contacts = Kernel("describe_contacts")

_RADII_M: Final = (0.008, 0.015, 0.03)  # from a taxel's surroundings to more than a fingertip's pad
_PAD: Final = 0.02  # about the size of a pad [m]
_FEWEST: Final = 4  # points that determine a slope
_LOW_HIGH: Final = (0.02, 0.98)
_QUARTERS: Final = (0.25, 0.5, 0.75, 0.98)
_SQUARES: Final = np.array([_PAD, *_RADII_M]) ** 2
_CELL: Final = 0.01  # edge of the cells in which points around a contact are searched [m]
_UPPER: Final = np.array([0, 1, 2, 4, 5, 8])  # of a flat (3, 3)
_SYMMETRIC: Final = np.array([0, 1, 2, 1, 3, 4, 2, 4, 5])  # a flat (3, 3) from its upper triangle
_STEP: Final = 0.002  # about the distance of points: no object is thinner [m]
_NOTHING: Final = 1e-12  # a smaller share of the points is none
_FLAT: Final = [0, 3, 10]  # of the sizes: deviation and extent along the shortest axis, and height
_FLAT_M: Final = np.array([0.003, 0.012, 0.012])  # of a flat face, by the noise of a D415 at 1.3 m

OBJECT_FEATURES: Final = (
    *(f"spread_{k}" for k in (1, 2, 3)),
    *(f"extent_{k}" for k in (1, 2, 3)),
    *(f"radius_q{round(100 * q)}" for q in _QUARTERS),
    "height",
)
"""Sizes of the object alone, by which novelty is detected in views as in training."""

UPPER_FEATURES: Final = tuple(f"upper_{name}" for name in OBJECT_FEATURES)
"""The same sizes of the upper side without its walls, by which novelty is detected in other views."""

_UNKNOWN: Final = np.zeros(len(UPPER_FEATURES))

VIEW: Final = ("tilt", "distance")
"""Angle between the line of sight and the vertical [rad], and distance of the object from the camera [m]."""

CONDITIONS: Final = (*VIEW, "spacing", *UPPER_FEATURES)
"""The view, the distance of the points from each other [m], and `UPPER_FEATURES`. No prediction depends on them."""

CHECKED: Final = (*CONDITIONS, *OBJECT_FEATURES, "width", "approach", "rise")
"""The first columns of a row, by which novelty is detected."""

_GRASP_FEATURES: Final = (
    *("width", "approach", "rise", "offset", "along", "along_y"),
    *(f"{what}_hand_{axis}" for what in ("centre", "spread") for axis in "xyz"),
    *("oblique_hand_xy", "oblique_hand_xz", "oblique_hand_yz"),
    *("g1_depth", "g2_depth"),
)
_CONTACT_FEATURES: Final = (
    *("share", "roughness", "pad_x", "pad_y", "pad_z"),
    *(f"slope_{round(r * 1000)}mm_{axis}" for r in _RADII_M for axis in "xyz"),
)

FEATURES: Final = (
    *CONDITIONS,
    *OBJECT_FEATURES,
    *_GRASP_FEATURES,
    *(f"{contact}_{name}" for contact in ("g1", "g2") for name in _CONTACT_FEATURES),
)
"""Names of all columns of `HandFrameFeatures.describe`."""


class HandFrameFeatures:
    """One object's points, prepared to describe grasps on it.

    Args:
        xyz: (N, 3) points [m], camera frame; points that are not finite are ignored.
        table: The table in that frame; None if the camera looks straight down on it.

    Attributes:
        object_features: (len(OBJECT_FEATURES),) float64, lengths in metres.
        view: (2,) float64, see `VIEW`.

    Raises:
        CloudError: If fewer than eight points are finite, or all are at one position.
    """

    def __init__(self, xyz: np.ndarray[tuple[int, ...], np.dtype[np.floating]], table: Plane | None = None) -> None:
        self._seen, self._is_turned = usable_points(xyz), table is not None
        centred = centred_columns(self._seen)
        self._points, self._turn, self.view = seen_from_above(self._seen, centred[0], table)
        self._centre, self._columns, self._covariance = centred_columns(self._points) if self._is_turned else centred
        self._centred = self._columns.T.copy()
        spreads, axes = principal_axes(self._covariance)
        self._inverse = (axes / (spreads**2 + _STEP**2)) @ axes.T
        self.object_features: Float64
        self.object_features, self._top = _sizes(self._points, self._columns, spreads, axes)
        if self.view[0] > STEEP:
            upper = without_walls(self._points)
            _, columns, covariance = centred_columns(upper)
            self.object_features, _ = _sizes(upper, columns, *principal_axes(covariance))
        _, middle, longest = self.object_features[3:6]  # extents
        self._spacing = np.sqrt(middle * longest / len(self._points))

    @cached_property
    def upper_features(self) -> Float64:
        """(len(UPPER_FEATURES),) float64 [m], where a flat face is as thick as the noise of a camera."""
        upper = upper_side(self._seen, self._turn, float(self.view[0]))
        _, columns, covariance = centred_columns(upper)
        sizes, _ = _sizes(upper, columns, *principal_axes(covariance))
        sizes[_FLAT] = np.hypot(sizes[_FLAT], _FLAT_M)
        return sizes

    @cached_property
    def _tree(self) -> cKDTree:
        """Of all points; built only when a grasp is described, and not balanced, which would take most of the time."""
        return cKDTree(self._points, leafsize=32, compact_nodes=False, balanced_tree=False)

    @cached_property
    def _powers(self) -> Float64:
        """(N, 10): 1, x, y, z, xx, xy, xz, yy, yz, zz of the points from the centre."""
        products = (self._centred[:, :, None] * self._centred[:, None, :]).reshape(-1, 9)[:, _UPPER]
        return np.column_stack([np.ones(len(products)), self._centred, products])

    @cached_property
    def _grid(self) -> tuple[Float64, Float64, Int64, Int32]:
        """The points as (3, N) sorted by cells, low corner and cells per metre, numbers of cells, starts of the cells."""
        low, high = self._columns.min(axis=1), self._columns.max(axis=1)
        edge = max(_CELL, float((high - low).max()) / 64)  # at most 64 along one axis
        grid, cells = np.append(low, 1.0 / edge), ((high - low) / edge).astype(np.int64) + 1
        starts, columns = np.empty(cells.prod() + 1, np.int32), np.empty_like(self._columns)
        _sort_into_cells(
            self._centred, len(self._centred), grid, cells, np.empty(len(self._centred), np.int32), starts, columns
        )
        return columns, grid, cells, starts

    def describe(self, grasps: Sequence[Grasp], *, surroundings: bool = True, upper: bool = True) -> Float64:
        """Return (K, len(FEATURES)) float64: one row for each grasp, the same alone and among others; finite for any grasp.

        Without `surroundings`, the columns that describe the points around each contact are 0. Without `upper`, the sizes of the upper side are 0.
        """
        if not grasps:
            return np.empty((0, len(FEATURES)))
        columns, count = Grasps.of(grasps), len(grasps)
        g1 = columns.g1
        g2 = columns.g2
        hand = columns.rotation
        if self._is_turned:
            g1, g2 = (_into(self._turn.T[None], contact) for contact in (g1, g2))
            hand = (self._turn[None, :, :, None] * hand[:, None, :, :]).sum(axis=2)
        away = np.where(hand[:, 2, :1] < 0.0, -1.0, 1.0)
        hand = np.stack([hand[:, :, 0] * away, hand[:, :, 1] * away, hand[:, :, 2]], axis=2)
        sizes = self.upper_features if upper else _UNKNOWN
        whole = np.concatenate([self.view, [self._spacing], sizes, self.object_features])
        objects = np.broadcast_to(whole, (count, len(whole)))
        second = np.stack([hand[:, :, 0], -hand[:, :, 1], -hand[:, :, 2]], axis=2)  # z is where the finger closes to
        ends, fingers = np.concatenate([g1, g2]), np.concatenate([second, hand])
        contacts = self._contacts(ends, fingers) if surroundings else np.zeros((len(ends), len(_CONTACT_FEATURES)))
        return np.hstack([objects, self._grasps(g1, g2, hand), contacts[:count], contacts[count:]])

    def _grasps(self, g1: Float64, g2: Float64, hand: Float64) -> Float64:
        """Return (K, len(_GRASP_FEATURES)) features of the grasps alone."""
        middle = (g1 + g2) / 2.0
        offset = middle - self._centre
        turned = (self._covariance[None, :, :, None] * hand[:, None, :, :]).sum(axis=2)
        spread = np.sqrt(np.maximum((hand * turned).sum(axis=1), 0.0))
        centre = _into(hand, -offset)
        # Not the principal axis itself, which turns by any angle where an object is as wide as long.
        oblique = [(hand[:, :, i] * turned[:, :, j]).sum(axis=1) for i, j in ((0, 1), (0, 2), (1, 2))]
        return np.column_stack(
            [
                np.sqrt(((g1 - g2) ** 2).sum(axis=1)),
                hand[:, 2, 0],
                hand[:, 2, 2],
                np.sqrt((offset**2).sum(axis=1)),
                np.sqrt((offset[:, :, None] * self._inverse * offset[:, None, :]).sum(axis=(1, 2))),
                centre[:, 1] / np.maximum(spread[:, 1], _STEP),
                centre,
                spread,
                *(matrix / np.trace(self._covariance) for matrix in oblique),
                g1[:, 2] - self._top,
                g2[:, 2] - self._top,
            ]
        )

    def _contacts(self, contacts: Float64, fingers: Float64) -> Float64:
        """Return (K, len(_CONTACT_FEATURES)) of (K, 3) contacts in the (K, 3, 3) frames of their fingers.

        The compiled function leaves out contacts at points that are in one plane to 1e-7 m, such as on a face at one
        step of the depth: there the features depend on rounding, and are computed by NumPy in a fixed order.
        """
        rows = np.empty((len(contacts), len(_CONTACT_FEATURES)))
        columns, grid, cells, starts = self._grid
        points = struct("Cells", sorted=columns, n=columns.shape[1], grid=grid, cells=cells, starts=starts)
        at, fingers = contacts - self._centre, np.ascontiguousarray(fingers)
        _describe_contacts(points, _SQUARES, at, fingers, len(at), rows)
        flat = np.flatnonzero(np.isnan(rows[:, 0]))
        if flat.size:
            rows[flat] = self._summed(contacts[flat], fingers[flat])
        return rows

    def _summed(self, contacts: Float64, fingers: Float64) -> Float64:
        """`_contacts` by NumPy.

        Points around a contact are summed once, in the camera's frame, however many grasps share it.
        """
        unique, back = np.unique(contacts, axis=0, return_inverse=True)
        back = back.reshape(-1)
        near = self._tree.query_ball_point(unique, max(_RADII_M), return_sorted=True)
        pad, *patches = np.array(
            [self._sums(at, neighbours) for at, neighbours in zip(unique - self._centre, near, strict=True)]
        ).swapaxes(0, 1)
        share, mean, spreads, _ = _moments(pad, unique - self._centre)
        columns = [share[back], spreads[back, 0], *_into(fingers, mean[back]).T]
        for patch in patches:
            *_, spreads, axes = _moments(patch, unique - self._centre)
            normal = _into(fingers, axes[back][:, :, 0])
            flat = 1.0 - spreads[:, 0] / np.maximum(spreads[:, 1], _NOTHING)
            # Not the normal itself, whose sign turns where it is across the finger.
            slope = (flat[back] * np.abs(normal[:, 2]))[:, None] * normal * np.where(normal[:, 2:] > 0.0, -1.0, 1.0)
            columns += list(np.where(patch[back, -1:] < _FEWEST, 0.0, slope).T)
        return np.column_stack(columns)

    def _sums(self, contact: Float64, index: list[int]) -> Float64:
        """Return (4, 11) of pad and patches: weighted shares of 1, x, y, z, xx, xy, xz, yy, yz, zz; number of points."""
        powers = self._powers[index]
        offset = powers[:, 1:4] - contact
        weight = np.maximum(1.0 - (offset * offset).sum(axis=1) / _SQUARES[:, None], 0.0)
        return np.column_stack([weight @ powers / len(self._points), np.count_nonzero(weight, axis=1)])


def _sizes(points: Float64, columns: Float64, spreads: Float64, axes: Float64) -> tuple[Float64, float]:
    """`OBJECT_FEATURES` of (N, 3) points, from their (3, N) columns from the centre, deviations and principal axes; and z of their top."""
    extents = [end - start for start, end in (quantiles(projected, _LOW_HIGH) for projected in axes.T @ columns)]
    low, high = quantiles(points[:, 2], _LOW_HIGH)
    return np.concatenate([spreads, extents, quantiles(distances(columns), _QUARTERS), [high - low]]), low


def _moments(sums: Float64, contacts: Float64) -> tuple[Float64, Float64, Float64, Float64]:
    """Compute moments of (U, 11) sums around (U, 3) contacts, both from the object's centre.

    Returns:
        (U,) weights, (U, 3) means from the contact, (U, 3) standard deviations along the principal axes, ascending, and
        (U, 3, 3) these axes as columns. Without a weight all are zero, and the axes are the axes of the frame.
    """
    total = sums[:, 0]
    scaled = sums[:, 1:10] / np.maximum(total, _NOTHING)[:, None]
    mean = scaled[:, :3]
    covariance = scaled[:, 3:][:, _SYMMETRIC].reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None, :]
    return total, np.where((total > 0.0)[:, None], mean - contacts, 0.0), *principal_axes(covariance)


def _into(frames: Float64, vectors: Float64) -> Float64:
    """Return (K, 3) vectors in the (K, 3, 3) frames, whose axes are columns; the same to the last bit for any K."""
    return np.asarray((frames * vectors[:, :, None]).sum(axis=1), np.float64)
