# SPDX-License-Identifier: Apache-2.0
"""What the grasp book is told, and what it gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from foretouch.dataset.pairing.cloud_buffer import BufferedCloud
from foretouch.dataset.pairing.cut import Interval, TouchCut
from foretouch.dataset.recording.record import Outcome

__all__ = ["Execution", "GraspT", "Label", "MatchedGrasp", "Plan", "RejectedGrasp"]


class _HasId(Protocol):
    @property
    def id(self) -> str: ...


GraspT = TypeVar("GraspT", bound=_HasId)


@dataclass(frozen=True, kw_only=True)
class Execution:
    """What was done with a grasp.

    Attributes:
        grasp_id: Which.
        interval: When; None where it failed before it touched.
        success: Whether it held; None if nobody says.
        flags: How the interval is known: `labelled_interval`, `detected_interval`, `assumed_grasp`; none if the
            robot told it.
    """

    grasp_id: str
    interval: Interval | None
    success: bool | None = None
    flags: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Label:
    """What the operator says of a grasp.

    Attributes:
        grasp_id: Which; "" for the latest.
        object: Label of the object, "" for that of the session.
        discard: Whether the sample is not to be used.
        note: Free text.
        outcome: As the operator judges it.
        interval: Where the robot tells none; None leaves it to the robot or to the contact detector.
    """

    grasp_id: str = ""
    object: str = ""
    discard: bool = False
    note: str = ""
    outcome: Outcome = "unknown"
    interval: Interval | None = None


@dataclass(frozen=True, eq=False)
class Plan(Generic[GraspT]):
    """The grasps planned on one cloud."""

    stamp_ns: int
    frame_id: str
    grasps: tuple[GraspT, ...]


@dataclass(frozen=True, eq=False)
class MatchedGrasp(Generic[GraspT]):
    """A grasp with its plan, its cloud and its touch."""

    grasp: GraspT
    plan: Plan[GraspT]
    cloud: BufferedCloud
    cut: TouchCut
    execution: Execution
    label: Label | None


@dataclass(frozen=True, kw_only=True)
class RejectedGrasp:
    """A grasp that makes no sample, by reason and in words."""

    grasp_id: str
    reason: str
    message: str
