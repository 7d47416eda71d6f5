# SPDX-License-Identifier: Apache-2.0
"""The contact problem and its solution, shared by all levels of fidelity.

Two bodies meet across a gap. Each is a stack-free elastic layer bonded to a rigid base: the skin on the
core of the fingertip and, if it is soft, the object. Only normal, frictionless contact is solved; strains
are taken as small.
"""

import math
from dataclasses import dataclass

import numpy as np

from foretouch.errors import ContactError
from foretouch.types import Float64

MAX_STRAIN = 0.95  # deepest compression of a layer over its thickness
_LEAST, _MOST = 1e-30, 1e30  # N, m or Pa: far beyond any contact, and their squares and quotients are normal numbers


@dataclass(frozen=True, kw_only=True)
class ElasticLayer:
    """An isotropic elastic layer, bonded to a rigid base.

    Raises:
        ContactError: If a value has no physical meaning.
    """

    modulus_pa: float  # Young's modulus E [Pa]
    poisson: float  # Poisson's ratio ν, 0 to 0.5
    thickness_m: float = math.inf  # h [m]; infinite for a half-space

    def __post_init__(self) -> None:
        if not _LEAST <= self.modulus_pa <= _MOST:
            raise ContactError(f"modulus_pa: {self.modulus_pa} is not between {_LEAST:g} and {_MOST:g} Pa")
        if not 0.0 <= self.poisson <= 0.5:
            raise ContactError(f"poisson: {self.poisson} is not between 0 and 0.5")
        if not self.thickness_m > 0.0:
            raise ContactError(f"thickness_m: {self.thickness_m} is not positive")

    @property
    def plane_modulus_pa(self) -> float:
        """E / (1 - ν²) [Pa], the modulus of a half-space in contact (Johnson 1985, eq. 4.5)."""
        return self.modulus_pa / (1.0 - self.poisson**2)


@dataclass(frozen=True, kw_only=True)
class Command:
    """The command of a finger: either a force or a depth.

    Raises:
        ContactError: If neither or both are given, one is not finite, too small or too large to compute with, or the
            force is negative.
    """

    force_n: float | None = None  # normal force, at least 0 [N]
    depth_m: float | None = None  # approach of the bodies beyond first touch [m]; none or negative is no contact

    def __post_init__(self) -> None:
        if (self.force_n is None) == (self.depth_m is None):
            raise ContactError("command: give force_n or depth_m, one of them")
        name, value = ("force_n", self.force_n) if self.force_n is not None else ("depth_m", self.depth_m)
        if not math.isfinite(float(value or 0.0)):
            raise ContactError(f"{name}: {value} is not finite")
        if self.force_n is not None and self.force_n < 0.0:
            raise ContactError(f"force_n: {self.force_n} is negative")
        if not self.idle and not _LEAST <= float(value or 0.0) <= _MOST:
            raise ContactError(f"{name}: {value} is neither 0 nor between {_LEAST:g} and {_MOST:g}")

    @property
    def idle(self) -> bool:
        """Whether it asks for no contact at all."""
        return self.force_n == 0.0 if self.depth_m is None else self.depth_m <= 0.0


@dataclass(frozen=True, eq=False)
class ContactProblem:
    """Two surfaces on a square grid, at first touch.

    Attributes:
        gap: (N, N) float64 [m], distance of the undeformed surfaces, its least value 0; infinite where one of
            them is absent. Row i runs along the tangent y, column j along the tangent x.
        step_m: Side of a cell [m].
        layers: The compliant bodies, the pad's first.

    Raises:
        ContactError: If a shape or value is another, or nowhere do both surfaces exist.
    """

    gap: Float64
    step_m: float
    layers: tuple[ElasticLayer, ...]

    def __post_init__(self) -> None:
        if self.gap.ndim != 2 or self.gap.shape[0] != self.gap.shape[1] or self.gap.size == 0:
            raise ContactError(f"gap: shape {self.gap.shape} is not (N, N)")
        if not (math.isfinite(self.step_m) and self.step_m > 0.0):
            raise ContactError(f"step_m: {self.step_m} is not positive and finite")
        if not self.layers:
            raise ContactError("layers: none is compliant, and two rigid bodies have no pressure field")
        least = float(self.gap.min())
        if not math.isfinite(least):
            fault = "holds NaN" if math.isnan(least) else "nowhere in the window do both surfaces exist"
            raise ContactError(f"gap: {fault}")
        if abs(least) > 1e-12:
            raise ContactError(f"gap: its least value is {least:g} m, not 0")

    @property
    def cell_m2(self) -> float:
        """Area of a cell [m²]."""
        return self.step_m**2

    @property
    def contact_modulus_pa(self) -> float:
        """E* with 1/E* = Σ (1 - ν²)/E (Johnson 1985, eq. 4.5) [Pa]."""
        return 1.0 / sum(1.0 / layer.plane_modulus_pa for layer in self.layers)


@dataclass(frozen=True, eq=False)
class ContactSolution:
    """A solved contact."""

    pressure: Float64  # (N, N) float64, at least 0 [Pa]
    displacement: Float64  # (L, N, N) float64 [m], how far each layer's surface is pushed in
    force_n: float  # Σ pressure · cell [N]
    area_m2: float  # area under pressure [m²]
    depth_m: float  # approach of the bodies beyond first touch [m]


def no_contact(problem: ContactProblem, depth_m: float = 0.0) -> ContactSolution:
    """The solution where nothing presses."""
    shape = problem.gap.shape
    return ContactSolution(np.zeros(shape), np.zeros((len(problem.layers), *shape)), 0.0, 0.0, min(depth_m, 0.0))


def refuse_overload(problem: ContactProblem, displacement: Float64, depth_m: float) -> None:
    """Refuse a solution that is deeper than the window is wide, or presses a layer through its base.

    Raises:
        ContactError: Names the depth, or the layer and its strain, and the limit.
    """
    for k, layer in enumerate(problem.layers):
        strain = float(displacement[k].max()) / layer.thickness_m
        if strain > MAX_STRAIN:
            raise ContactError(
                f"layers[{k}]: compressed by {strain:.3g} of its {layer.thickness_m * 1e3:.3g} mm, "
                f"more than max_strain {MAX_STRAIN:g}: press less or make it stiffer"
            )
    side = problem.gap.shape[0] * problem.step_m
    if not depth_m <= side:
        raise ContactError(f"depth: {depth_m:.3g} m is more than the {side:.3g} m window is wide: press less")
