# SPDX-License-Identifier: Apache-2.0
"""Parts that are installed for some uses only: `foretouch_lab`, of which a robot imports none unless a command or a simulated source asks for it, and ROS."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from foretouch.errors import MissingDependencyError

_LABORATORY: Final = "pip install 'foretouch[lab]'"
_ROS: Final = "pip install 'foretouch[ros]', or source your installation (foretouch doctor)"
_NEEDED: Final = {
    "foretouch_lab": ("foretouch_lab", _LABORATORY),
    "embreex": ("embreex", _LABORATORY),
    "sklearn": ("scikit-learn", _LABORATORY),
    "threadpoolctl": ("threadpoolctl", _LABORATORY),
    "trimesh": ("trimesh", _LABORATORY),
    "rclpy": ("ROS 2", _ROS),
    "sensor_msgs": ("ROS 2", _ROS),
    "foretouch_msgs": ("foretouch_msgs", "pip install ./foretouch_msgs in a clone of foretouch"),
}
"""For each such module: what is not installed, and the cure."""


@contextmanager
def needs_laboratory(user: str) -> Iterator[None]:
    """Report a missing library of the laboratory, or of ROS, as a `MissingDependencyError` that names how to install it."""
    try:
        yield
    except ModuleNotFoundError as err:
        top = (err.name or "").partition(".")[0]
        if top not in _NEEDED:
            raise
        missing, cure = _NEEDED[top]
        raise MissingDependencyError(f"{user}: {missing} is not installed: {cure}") from err
