# SPDX-License-Identifier: Apache-2.0
"""The statuses of the core, which are words, and those of the messages, which are numbers."""

from __future__ import annotations

from foretouch.errors import ForetouchError
from foretouch_msgs.msg import Status

__all__ = ["RefusalError", "status_code", "status_name"]

_CODES: dict[str, int] = {
    "ok": Status.OK,
    "initial_points": Status.INITIAL_POINTS,
    "bad_request": Status.BAD_REQUEST,
    "bad_cloud": Status.BAD_CLOUD,
    "empty_cloud": Status.EMPTY_CLOUD,
    "too_few_points": Status.TOO_FEW_POINTS,
    "unknown_frame": Status.UNKNOWN_FRAME,
    "no_plane": Status.NO_PLANE,
    "no_object": Status.NO_OBJECT,
    "no_target": Status.NO_TARGET,
    "no_grasp": Status.NO_GRASP,
    "bad_grasp": Status.BAD_GRASP,
    "bad_plane": Status.BAD_PLANE,
    "refused": Status.REFUSED,
    "no_model": Status.NO_MODEL,
    "failed": Status.FAILED,
}
_NAMES = {code: name for name, code in _CODES.items()}


def status_code(name: str) -> int:
    """The number of `foretouch_msgs/Status` for a status of the core; FAILED for one that has none."""
    return _CODES.get(name, Status.FAILED)


def status_name(code: int) -> str:
    """The reverse of `status_code`, for logs and diagnostics."""
    return _NAMES.get(code, f"status {code}")


class RefusalError(ForetouchError):
    """There is nothing to say of an input.

    Args:
        status: Of `foretouch_msgs/Status`, not OK.
        reason: In words.
    """

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status
        self.reason = reason
