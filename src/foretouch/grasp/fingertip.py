# SPDX-License-Identifier: Apache-2.0
"""The orientation in which a fingertip is drawn at a contact."""

import numpy as np

from foretouch.grasp.pose import PARALLEL_SINE
from foretouch.types import Float64, Grasp

_LEAST_M = 1e-12  # from the midpoint to a contact; shorter vectors have no certain direction


def fingertip_rotation(grasp: Grasp, contact: Float64) -> Float64:
    """Orientation in which a fingertip is drawn: its pad faces the other contact, its tip points away from the camera.

    The true orientation depends on the hand; P2's data hold contacts only.

    Args:
        grasp: The grasp.
        contact: (3,) float64, its g1 or g2 [m].

    Returns:
        (3, 3) float64, columns x (along the finger), y, z (away from the pad) in the cloud's frame.
    """
    z = contact - grasp.midpoint
    if np.linalg.norm(z) < _LEAST_M:  # a hand that is closed
        z = grasp.rotation[:, 2] if np.array_equal(contact, grasp.g1) else -grasp.rotation[:, 2]
    z = z / np.linalg.norm(z)
    across = grasp.rotation - np.outer(z, z @ grasp.rotation)  # the hand's axes, each without its part along z
    x = across[:, 0] if np.linalg.norm(across[:, 0]) > PARALLEL_SINE else across[:, 1]
    x = x / np.linalg.norm(x)
    if x @ grasp.midpoint < 0.0:  # the camera is at the origin
        x = -x
    return np.column_stack([x, np.cross(z, x), z])
