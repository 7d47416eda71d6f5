# SPDX-License-Identifier: Apache-2.0
"""What the nodes use of tf2_ros, which no wheel of PyPI holds: a buffer with fixed and moving transforms."""

import time
import types
from typing import Any, ClassVar

import numpy as np
from geometry_msgs.msg import TransformStamped
from scipy.spatial.transform import Rotation, Slerp

NAME = "tf2_ros"


class TransformException(Exception):  # noqa: N818  the name that tf2 has
    """The base class of tf2's errors."""


class Buffer:
    """By frames, two transforms with their stamps, shared by all buffers as all listeners hear the same topic."""

    known: ClassVar[dict[tuple[str, str], list[tuple[int, np.ndarray, np.ndarray]]]] = {}

    def lookup_transform(self, target_frame: str, source_frame: str, time_: Any, timeout: Any) -> TransformStamped:
        """The transform from source to target at a time, interpolated; waits as tf2 does, by polling."""
        end = time.monotonic() + timeout.nanoseconds * 1e-9
        while True:
            try:
                return self._now(target_frame, source_frame, time_.nanoseconds)
            except TransformException:
                if time.monotonic() >= end:
                    raise
                time.sleep(0.02)

    def _now(self, target: str, source: str, nanoseconds: int) -> TransformStamped:
        found = self.known.get((target, source))
        if found is None:
            raise TransformException(f'"{target}" passed to lookupTransform argument target_frame does not exist. ')
        (begin, *first), (end, *second) = found
        if not begin <= nanoseconds <= end:
            raise TransformException("Lookup would require extrapolation into the future.")
        share, positions, quaternions = (nanoseconds - begin) / (end - begin), *zip(first, second, strict=True)
        position = positions[0] + share * (positions[1] - positions[0])
        rotation = Slerp([0.0, 1.0], Rotation.from_quat(quaternions))(share)
        message = TransformStamped()
        t, q = message.transform.translation, message.transform.rotation
        t.x, t.y, t.z = map(float, position)
        q.x, q.y, q.z, q.w = map(float, rotation.as_quat())
        return message


class TransformListener:
    """Ends as tf2's does."""

    def __init__(self, buffer: Buffer, node: Any) -> None:
        self.buffer, self.node = buffer, node

    def unregister(self) -> None:
        """Nothing was registered."""


def module() -> types.ModuleType:
    """A module of this interface with no transforms."""
    made = types.ModuleType(NAME)
    Buffer.known = {}
    made.__dict__.update(Buffer=Buffer, TransformListener=TransformListener, TransformException=TransformException)
    return made
