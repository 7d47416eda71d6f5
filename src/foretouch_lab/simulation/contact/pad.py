# SPDX-License-Identifier: Apache-2.0
"""The pad of a BioTac SP: a rigid core under a compliant layer of skin and liquid.

Frame of the fingertip, as `foretouch.tactile`: x along the finger towards its tip, -z towards the
pad. The electrodes of the core lie on an ellipsoid of revolution about x; the skin is taken as the
ellipsoid whose semi-axes are longer by the layer's thickness. The contact has its own frame: its
origin on the skin, z the outward normal, x as far along the finger as the tangent plane allows.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Self

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ContactError
from foretouch.tactile.channels import LAYER_M, skin_axes
from foretouch.types import Float64
from foretouch_lab.simulation.contact.problem import ElasticLayer

POISSON: Final = 0.316  # Poisson's ratio of the layer, as in published finite-element models of the skin
SOFT_WINDOW_M: Final = 0.02  # side of the window on a soft object


@dataclass(frozen=True, kw_only=True)
class PadConfig(Settings):
    """Shape and material of the fingertip's pad, and the grid that contacts are solved on."""

    layer_m: float = setting(LAYER_M, "Thickness of skin and liquid over the core", bounds=(1e-5, 1.0))
    modulus_pa: float = setting(
        1.552e6, "Young's modulus of the layer, as in published finite-element models of the skin", bounds=(1.0, 1e12)
    )
    window_m: float = setting(
        0.012, "Side of the square that a contact with a rigid object is solved on", bounds=(1e-4, 1.0)
    )
    cells: int = setting(24, "Number of cells along one side of that square", bounds=(3, 512))

    def grid(self) -> tuple[Float64, Float64]:
        """Return x and y, both (N, N), of the centres of the cells about the middle of the window [m]."""
        offset = (np.arange(self.cells) - (self.cells - 1) / 2.0) * self.step_m
        x, y = np.meshgrid(offset, offset)
        return x, y

    @property
    def step_m(self) -> float:
        """Side of a cell [m]."""
        return self.window_m / self.cells

    @property
    def soft(self) -> Self:
        """The same pad, its window wide enough for what sinks into a soft object."""
        return self.replace(window_m=SOFT_WINDOW_M)

    @property
    def layer(self) -> ElasticLayer:
        """Skin and liquid as one elastic layer."""
        return ElasticLayer(modulus_pa=self.modulus_pa, poisson=POISSON, thickness_m=self.layer_m)

    @property
    def skin_axes(self) -> Float64:
        """(3,) float64: semi-axes of the skin [m]."""
        return skin_axes(self.layer_m)


@dataclass(frozen=True, eq=False)
class ContactFrame:
    """The tangent frame of a pad at its contact, in the frame of the fingertip or in the world."""

    origin: Float64  # (3,) float64 [m], on the skin
    rotation: Float64  # (3, 3) float64, columns: tangent x along the finger to its tip, tangent y, outward normal

    @property
    def normal(self) -> Float64:
        """(3,) float64, unit length: outwards, the direction in which the finger closes."""
        return self.rotation[:, 2]

    def points(self, x: Float64, y: Float64, z: Float64 | float) -> Float64:
        """Return (..., 3) float64 [m] of points at (x, y) of the tangent plane, `z` along the normal."""
        return self.origin + np.stack(np.broadcast_arrays(x, y, z), axis=-1) @ self.rotation.T


@dataclass(frozen=True, eq=False)
class PadWindow:
    """The part of the pad that a contact is solved on."""

    frame: ContactFrame  # where the pad is touched
    x: Float64  # (N, N) float64 [m], cell centres in the contact frame; changes along a row
    y: Float64  # (N, N) float64 [m]; changes along a column
    depth: Float64  # (N, N) float64 [m], the undeformed skin below the tangent plane; infinite beside the pad

    @cached_property
    def points(self) -> Float64:
        """(N, N, 3) float64 [m], the cells on the skin, fingertip frame; NaN beside the pad."""
        return self.frame.points(self.x, self.y, -np.where(np.isfinite(self.depth), self.depth, np.nan))


def pad_window(config: PadConfig, direction: Float64) -> PadWindow:
    """Return the window about the place where the outward normal is `direction` (see `contact_frame`)."""
    frame = contact_frame(config, direction)
    x, y = config.grid()
    return PadWindow(frame, x, y, pad_depth(config, frame, x, y))


def pad_direction(pitch_rad: float, roll_rad: float) -> Float64:
    """Return (3,) unit vector, fingertip frame: from the middle of the pad, `pitch` towards the tip, `roll` towards +y.

    Args:
        pitch_rad: From the middle of the pad towards the tip [rad].
        roll_rad: From there towards +y [rad].
    """
    across = math.cos(pitch_rad)
    return np.array([math.sin(pitch_rad), across * math.sin(roll_rad), -across * math.cos(roll_rad)])


def contact_frame(config: PadConfig, direction: Float64) -> ContactFrame:
    """Return the place where the skin's outward normal is `direction`: where a plane from there touches first.

    On the ellipsoid Σ (p_i / a_i)² = 1 it is p = A² n / |A n|, A the diagonal of the semi-axes.

    Args:
        config: The pad.
        direction: (3,) of any length, fingertip frame.

    Raises:
        ContactError: If the direction points away from the pad (z not below 0).
    """
    normal = direction / float(np.linalg.norm(direction))
    if normal[2] >= 0.0:
        raise ContactError(
            f"direction: {normal.round(3).tolist()} points to the nail, not the pad (its z is not below 0)"
        )
    axes = config.skin_axes
    origin = axes**2 * normal / np.linalg.norm(axes * normal)
    tangent_x = np.array([1.0, 0.0, 0.0]) - normal[0] * normal  # not 0, as z is below 0
    tangent_x /= np.linalg.norm(tangent_x)
    return ContactFrame(origin, np.column_stack([tangent_x, np.cross(normal, tangent_x), normal]))


def pad_depth(config: PadConfig, frame: ContactFrame, x: Float64, y: Float64) -> Float64:
    """Return the depth of the undeformed skin below its tangent plane [m], shape of x; infinite beside the pad.

    The first meeting of the line o + x t_x + y t_y - s n with the ellipsoid, a quadratic in s.

    Args:
        config: The pad.
        frame: Tangent frame of the place that is touched first.
        x: Places along its x [m].
        y: Places along its y [m].
    """
    inverse = 1.0 / config.skin_axes
    o = frame.points(x, y, 0.0) * inverse
    n = frame.normal * inverse
    nn = float(n @ n)
    half_b = o @ n
    c = np.einsum("...i,...i->...", o, o) - 1.0  # at least 0: the tangent plane is outside
    discriminant = half_b**2 - nn * c
    # (b - root) / nn, written without the difference of near-equal numbers at the origin.
    depth = np.maximum(c, 0.0) / (half_b + np.sqrt(np.maximum(discriminant, 0.0)))
    return np.asarray(np.where(discriminant >= 0.0, depth, np.inf))


def gap_field(depth: Float64, object_height: Float64) -> Float64:
    """Return (N, N) float64 [m], distance of skin and object at first touch: least value 0, infinite where one is absent.

    Args:
        depth: (N, N) of `pad_depth` [m].
        object_height: (N, N) [m], the object's surface above the tangent plane, towards the pad; -inf without a surface.

    Raises:
        ContactError: If the two share no cell.
    """
    gap = depth - object_height
    least = float(gap.min())
    if math.isinf(least):
        raise ContactError("object_height: no cell of the window holds both pad and object")
    return gap - least
