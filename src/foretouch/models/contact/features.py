# SPDX-License-Identifier: Apache-2.0
"""Features of an object and a grasp, the inputs of the contact model.

    cloud ─► object: position, size, slenderness ───────────────┐
    grasp ─► position, width, orientation of the hand ──────────┼─► one row for each grasp
    points around each contact ─► slope, size of the pad ───────┘

The slope of the surface at a contact is given in the frame of the finger: z in closing direction, x along the finger
(the hand's X with the sign that points away from the camera), y = z x x. On simulated objects that are not in the
training data the slopes generalise; sizes and positions identify the training object.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from foretouch.cloud.geometry.columns import centred_columns, distances, quantiles
from foretouch.errors import CloudError
from foretouch.models.novelty import OBJECT_FEATURES
from foretouch.types import Float64, Grasp

_RADII_M: Final = (0.008, 0.015, 0.03)  # from a taxel's surroundings to more than a fingertip's pad
_PAD: Final = 0.02  # about the size of a pad [m]
_FEWEST: Final = 4  # points that determine a slope
_MINIMUM_POINTS: Final = 8
_LOW_HIGH: Final = (0.01, 0.99)

_GRASP_FEATURES: Final = (
    *(f"{point}_{axis}" for point in ("g1", "g2", "mid") for axis in "xyz"),
    *(f"{point}_from_centre_{axis}" for point in ("g1", "g2") for axis in "xyz"),
    *("width", "offset", "along", "along_abs"),
    *(f"r{i}{j}" for i in range(3) for j in range(3)),
    *(f"{side}_{axis}" for side in ("low", "high", "centre") for axis in ("hand_x", "hand_y", "hand_z")),
)
_CONTACT_FEATURES: Final = (
    *("share", "pad_spread_1", "pad_spread_2", "pad_spread_3", "gap", "pad_x", "pad_y", "pad_z"),
    *(f"slope_{round(r * 1000)}mm_{axis}" for r in _RADII_M for axis in "xyz"),
)

FEATURES: Final = (
    *OBJECT_FEATURES,
    *_GRASP_FEATURES,
    *(f"{contact}_{name}" for contact in ("g1", "g2") for name in _CONTACT_FEATURES),
)
"""Names of all columns of `ContactScene.describe`."""

SLOPE_FEATURES: Final = tuple(name for name in FEATURES if "_slope_" in name)


def usable_points(xyz: np.ndarray[tuple[int, ...], np.dtype[np.floating]]) -> Float64:
    """(M, 3) float64: the finite points of a cloud; raises `CloudError` if they show no shape."""
    points = np.asarray(xyz, np.float64).reshape(-1, 3)
    if not np.isfinite(points).all():
        points = points[np.isfinite(points).all(axis=1)]
    if len(points) < _MINIMUM_POINTS:
        raise CloudError(f"cloud: {len(points)} finite points are fewer than {_MINIMUM_POINTS}")
    if (points == points[0]).all():
        raise CloudError(f"cloud: all {len(points)} finite points are in one place")
    return points


class ContactScene:
    """One object's points, prepared to describe grasps on it.

    Args:
        xyz: (N, 3) points [m], camera frame; points that are not finite are ignored.

    Attributes:
        object_features: (len(OBJECT_FEATURES),) float64, lengths in metres.

    Raises:
        CloudError: If fewer than eight points are finite, or all are at one position.
    """

    def __init__(self, xyz: np.ndarray[tuple[int, ...], np.dtype[np.floating]]) -> None:
        self._points = usable_points(xyz)
        self._centre, centred = centred_columns(self._points)
        self._centred = centred.T.copy()
        spreads, axes = _principal(self._centred)
        self._axis = axes[:, 2] * (1.0 if axes[np.abs(axes[:, 2]).argmax(), 2] >= 0.0 else -1.0)
        columns = self._points.T.copy()
        distance = distances(centred)
        self.object_features: Float64 = np.concatenate(
            [
                self._centre,
                columns.max(axis=1) - columns.min(axis=1),
                spreads,
                [distance.max(), np.log(len(self._points))],
                self._axis,
                quantiles(distance, (0.25, 0.5, 0.75)),
            ]
        )

    @cached_property
    def _along(self) -> list[float]:
        """Ends of the object along its axis, from its centre [m]."""
        return quantiles(self._centred @ self._axis, _LOW_HIGH)

    @cached_property
    def _tree(self) -> cKDTree:
        """Of all points; built only when a grasp is described."""
        return cKDTree(self._points)

    def describe(self, grasps: Sequence[Grasp]) -> Float64:
        """(K, len(FEATURES)) float64: one row for each grasp; finite for any grasp."""
        rows = [np.concatenate([self.object_features, self._grasp(grasp), *self._contacts(grasp)]) for grasp in grasps]
        return np.array(rows).reshape(len(grasps), len(FEATURES))

    def _grasp(self, grasp: Grasp) -> Float64:
        offset = grasp.midpoint - self._centre
        low, high = self._along
        along = (offset @ self._axis - low) / max(high - low, 1e-9) - 0.5
        in_hand = (self._points - grasp.midpoint) @ grasp.rotation
        return np.concatenate(
            [
                *(grasp.g1, grasp.g2, grasp.midpoint),
                *(grasp.g1 - self._centre, grasp.g2 - self._centre),
                [grasp.width_m, float(np.linalg.norm(offset)), along, abs(along)],
                grasp.rotation.reshape(-1),
                np.quantile(in_hand, _LOW_HIGH, axis=0).reshape(-1),
                in_hand.mean(axis=0),
            ]
        )

    def _contacts(self, grasp: Grasp) -> tuple[Float64, Float64]:
        along_finger = grasp.rotation[:, 0]
        if along_finger @ self._centre < 0.0:
            along_finger = -along_finger
        closing = grasp.rotation[:, 2]
        return self._contact(grasp.g1, along_finger, -closing), self._contact(grasp.g2, along_finger, closing)

    def _contact(self, contact: Float64, along_finger: Float64, closing: Float64) -> Float64:
        index = self._tree.query_ball_point(contact, max(_RADII_M))
        frame = np.stack([along_finger, np.cross(closing, along_finger), closing], axis=1)
        near = (self._points[index] - contact) @ frame
        distance = np.linalg.norm(near, axis=1)
        slopes = [_slope(near[distance < radius]) for radius in _RADII_M]
        gap = float(distance.min()) if len(near) else float(self._tree.query(contact)[0])
        pad = near[distance < _PAD]
        spreads, mean = np.zeros(3), np.zeros(3)
        if len(pad):
            mean = pad.mean(axis=0)
            spreads = _principal(pad - mean)[0]
        return np.concatenate([[len(pad) / len(self._points)], spreads, [gap], mean, *slopes])


def _slope(near: Float64) -> Float64:
    """(3,) unit normal of points in the finger's frame, against the closing direction; 0 for too few points."""
    if len(near) < _FEWEST:
        return np.zeros(3)
    _, axes = _principal(near - near.mean(axis=0))
    normal = axes[:, 0]
    return np.asarray(-normal if normal[2] > 0.0 else normal, np.float64)


def _principal(centred: Float64) -> tuple[Float64, Float64]:
    """`principal_axes` of points around their mean."""
    return principal_axes(centred.T @ centred / len(centred))


def principal_axes(covariance: Float64) -> tuple[Float64, Float64]:
    """(…, 3) standard deviations along the principal axes, ascending, and the axes as columns of (…, 3, 3)."""
    values, axes = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(values, 0.0)), axes
