# SPDX-License-Identifier: Apache-2.0
"""How the weight of a held object is shared by two fingers: statics of a rigid body on two points.

With a the unit vector from g1 to g2, L their distance, w the weight (a force vector) and c the centre of
mass, the forces of the fingers on the object balance w, and their moments balance (c - m) x w about the
midpoint m:

    along a:    F1 - F2 + w·a = 0, hence the second finger carries w·a more than the first;
    across a:   T1 + T2 = -w_t and (L/2) a x (T2 - T1) = -[(c - m) x w]_t, the rule of the lever and the
                couple of an object that hangs beside the line;
    about a:    a·((c - m) x w) is left to the torsional friction of the pads and only told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foretouch.errors import ContactError
from foretouch.types import Float64

__all__ = ["HeldWeight", "weigh"]


@dataclass(frozen=True, eq=False)
class HeldWeight:
    """What the object's weight asks of the fingers.

    Attributes:
        axial_n: How much more the second finger pushes than the first [N].
        tangential_n: (2, 3) float64, force of each finger on the object across the line of the contacts [N].
        torsion_nm: Moment about that line that friction must hold [N m].
    """

    axial_n: float
    tangential_n: Float64
    torsion_nm: float

    def slips(self, forces_n: tuple[float, float], friction: float) -> tuple[bool, bool]:
        """Whether each finger's tangential force exceeds Coulomb's limit at its normal force."""
        t1, t2 = np.linalg.norm(self.tangential_n, axis=1)
        return bool(t1 > friction * forces_n[0]), bool(t2 > friction * forces_n[1])


def weigh(weight_n: Float64, g1: Float64, g2: Float64, centre: Float64) -> HeldWeight:
    """Share the weight of an object between two contacts.

    Args:
        weight_n: (3,) float64, the weight as a vector, downwards [N].
        g1: (3,) float64, first contact [m], the same frame.
        g2: (3,) float64, second contact [m].
        centre: (3,) float64, centre of mass [m].

    Raises:
        ContactError: If the contacts coincide or a value is not finite.
    """
    span = g2 - g1
    length = float(np.linalg.norm(span))
    if not (np.isfinite([*weight_n, *g1, *g2, *centre]).all() and length > 0.0):
        raise ContactError("statics: contacts coincide or a value is not finite")
    axis = span / length
    moment = np.cross(centre - (g1 + g2) / 2.0, weight_n)
    across = weight_n - (weight_n @ axis) * axis
    # a x D = -M_t / (L/2) has the solution D = -(M_t x a) / (L/2) across a, as (M x a) crossed by a gives M_t back.
    couple = -np.cross(moment, axis) / (length / 2.0)
    tangential = np.stack([(-across - couple) / 2.0, (-across + couple) / 2.0])
    return HeldWeight(float(weight_n @ axis), tangential, float(moment @ axis))
