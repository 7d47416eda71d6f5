# SPDX-License-Identifier: Apache-2.0
"""MatchedGrasp grasps to the samples that are recorded: messages decoded, the object found in its cloud. No node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2

from foretouch.dataset.pairing import BufferedCloud, MatchedGrasp, PairingError, Plan
from foretouch.dataset.pairing.cut import DETECTOR
from foretouch.dataset.recording import Outcome, SampleRecord, TouchSeries
from foretouch.dataset.samples import DISCARDED
from foretouch.errors import CloudError, GraspError
from foretouch.pipeline import ASSUMED_TABLE
from foretouch.ros.messages.clouds import objects_from_msg
from foretouch.ros.messages.conversions import grasp_from_msg
from foretouch.types import Cloud, Grasp, GraspSample

__all__ = ["SampleMaker"]


@dataclass(frozen=True, kw_only=True)
class SampleMaker:
    """Makes records of one session.

    Attributes:
        object: Label of the object on the table; `unknown` if nobody told it.
        note: Of the operator, for every sample.
        others: Names of the further tactile channels.
        flags: For every sample with a touch.
    """

    object: str
    note: str
    others: tuple[str, ...]
    flags: tuple[str, ...]

    def labelled(self, linked: MatchedGrasp[Any]) -> SampleRecord:
        """A grasp with its touch.

        Raises:
            PairingError: `bad_cloud`, `bad_grasp`, `frame_differs` or `object_unknown`.
        """
        label, cut = linked.label, linked.cut
        grasp, candidates = _grasps(linked.plan, linked.grasp.id)
        sample = GraspSample(
            id="",
            object=(label.object if label and label.object else self.object) or "unknown",
            cloud=_object_cloud(linked.cloud, linked.plan.frame_id, grasp.object_id),
            grasp=grasp,
            touch=cut.touch,
            tare=cut.tare,
            stamp_ns=linked.execution.interval.contact if linked.execution.interval else 0,
            extra={"clock_offset_s": cut.clock_ns * 1e-9},
        )
        window = cut.window
        series = TouchSeries(
            window.stamps_ns,
            window.counts,
            cut.phases,
            {name: window.others[:, k].copy() for k, name in enumerate(self.others)},
        )
        discard = (DISCARDED,) if label and label.discard else ()
        return SampleRecord(
            sample=sample,
            candidates=candidates,
            outcome=_outcome(linked),
            note="; ".join(filter(None, (self.note, label.note if label else ""))),
            series=series,
            contact_ns=cut.contact_ns,
            detector=DETECTOR if cut.contact_ns is not None else "",
            pairing_error_ns=cut.error_ns,
            flags=(*self.flags, *linked.execution.flags, *cut.flags, *discard),
        )

    def unlabelled(self, cloud: BufferedCloud, plan: Plan[Any]) -> SampleRecord:
        """A cloud with the grasps planned on it (raises as `labelled`)."""
        grasp, candidates = _grasps(plan, plan.grasps[0].id)
        sample = GraspSample(
            id="",
            object=self.object or "unknown",
            cloud=_object_cloud(cloud, plan.frame_id, grasp.object_id),
            grasp=grasp,
            stamp_ns=cloud.stamp_ns,
        )
        return SampleRecord(sample=sample, candidates=candidates, note=self.note)


def _grasps(plan: Plan[Any], wanted: str) -> tuple[Grasp, tuple[Grasp, ...]]:
    """The grasp, and the others on the same object."""
    try:
        grasps = [grasp_from_msg(message) for message in plan.grasps]
    except GraspError as err:
        raise PairingError("bad_grasp", str(err)) from err
    (grasp,) = [one for one in grasps if one.id == wanted][:1]
    return grasp, tuple(one for one in grasps if one.object_id == grasp.object_id and one.id != wanted)


def _object_cloud(kept: BufferedCloud, frame_id: str, object_id: str) -> Cloud:
    try:
        message = deserialize_message(kept.data, PointCloud2)
        found = objects_from_msg(message, ASSUMED_TABLE)
    except CloudError as err:
        raise PairingError("bad_cloud", str(err)) from err
    if message.header.frame_id != frame_id:
        raise PairingError("frame_differs", f"cloud in {message.header.frame_id!r}, grasps in {frame_id!r}")
    match = [one.cloud for one in found if one.id == object_id or (one.id == "" and len(found) == 1)]
    if len(match) != 1:
        raise PairingError("object_unknown", f"object {object_id!r} is not in the cloud of {kept.stamp_ns}")
    return match[0]


def _outcome(linked: MatchedGrasp[Any]) -> Outcome:
    """The operator's word, else the robot's."""
    if linked.label is not None and linked.label.outcome != "unknown":
        return linked.label.outcome
    success = linked.execution.success
    return "unknown" if success is None else "success" if success else "failure"
