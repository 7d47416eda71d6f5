# SPDX-License-Identifier: Apache-2.0
"""Parts that are installed for some uses only: `foretouch_lab`, of which a robot imports none unless a command or a simulated source asks for it, and ROS."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Final

from foretouch.errors import MissingDependencyError

_LABORATORY: Final = {
    "foretouch_lab": "foretouch_lab",
    "embreex": "embreex",
    "sklearn": "scikit-learn",
    "threadpoolctl": "threadpoolctl",
    "trimesh": "trimesh",
}
"""Distributions that only the laboratory needs, by the name under which they are imported."""
_OF_ROS: Final = ("rclpy", "_msgs", "_srvs", "_interfaces")  # ends of names of modules


@contextmanager
def needs_laboratory(user: str) -> Iterator[None]:
    """Report a missing library of the laboratory, or of ROS, as a `MissingDependencyError` that names how to install it."""
    try:
        yield
    except ModuleNotFoundError as err:
        cure = _cure((err.name or "").partition(".")[0])
        if not cure:
            raise
        raise MissingDependencyError(f"{user}: {cure}") from err


def _cure(module: str) -> str:
    """Say what is not installed, and how to install it; "" for a module that no optional part needs."""
    if module in _LABORATORY:
        return f"{_LABORATORY[module]} is not installed: pip install 'foretouch[lab]'"
    if module == "yourdfpy":
        return "yourdfpy is not installed: pip install 'foretouch[urdf]'"
    if module.endswith(_OF_ROS) and find_spec("rclpy") is None:
        return "ROS 2 is not installed: pip install 'foretouch[ros]', or source your installation (foretouch doctor)"
    if module == "foretouch_msgs":
        return "foretouch_msgs is not installed: pip install ./foretouch_msgs in a clone of foretouch"
    return ""
