# SPDX-License-Identifier: Apache-2.0
"""The recorder's services: start and stop a recording, label a grasp."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import CallbackGroup

from foretouch.dataset.pairing import Interval, Label
from foretouch.dataset.recording import Outcome
from foretouch.dataset.recording.record import check_name
from foretouch.errors import ConfigError, ForetouchError
from foretouch.ros.conversions import stamp_ns
from foretouch_msgs.srv import LabelGrasp, StartRecording, StopRecording

if TYPE_CHECKING:
    from foretouch.ros.recorder_node import RecorderNode

__all__ = ["RecorderServices"]

_OUTCOMES: tuple[Outcome, ...] = ("unknown", "success", "failure")


class RecorderServices:
    """Offers the services until `destroy`.

    Args:
        node: The recorder.
        group: That the services run in.
    """

    def __init__(self, node: RecorderNode, group: CallbackGroup) -> None:
        self._node = node
        self._services: list[Any] = [
            node.create_service(kind, name, answer, callback_group=group)
            for kind, name, answer in (
                (StartRecording, "start_recording", self._start),
                (StopRecording, "stop_recording", self._stop),
                (LabelGrasp, "label_grasp", self._label),
            )
        ]

    def destroy(self) -> None:
        """Offer them no more."""
        for service in self._services:
            self._node.destroy_service(service)

    def _start(self, request: Any, response: Any) -> Any:
        try:
            if self._node.state_name != "active":
                raise ConfigError(f"the recorder is {self._node.state_name}")
            response.path = str(self._node.begin(request.path, request.object, request.note))
            response.success = True
        except ForetouchError as err:
            response.message = str(err)
        return response

    def _stop(self, _request: Any, response: Any) -> Any:
        if not self._node.in_session:
            response.message = self._node.reason or "nothing is being recorded"
            return response
        view = self._node.end()
        response.path, response.samples, response.message = self._node.path, view.samples, view.error
        response.success = not view.error
        return response

    def _label(self, request: Any, response: Any) -> Any:
        try:
            response.grasp_id, response.message = self._node.label(_label(request))
            response.success = True
        except ForetouchError as err:
            response.grasp_id, response.message = request.grasp_id, str(err)
        return response


def _label(request: Any) -> Label:
    """The request in the core's words.

    Raises:
        ConfigError: If the outcome is no known one.
        DatasetError: If the label of the object is no plain name.
    """
    if request.outcome >= len(_OUTCOMES):
        raise ConfigError(f"outcome: {request.outcome} is none of UNKNOWN, SUCCESS, FAILURE")
    if request.object:
        check_name(request.object, "object")
    start, contact, release = (stamp_ns(time) for time in (request.start, request.contact, request.release))
    return Label(
        grasp_id=request.grasp_id,
        object=request.object,
        discard=request.discard,
        note=request.note,
        outcome=_OUTCOMES[request.outcome],
        interval=Interval(start=start, contact=contact, release=release) if contact or release else None,
    )
