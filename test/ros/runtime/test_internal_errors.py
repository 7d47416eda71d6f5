# SPDX-License-Identifier: Apache-2.0
"""Errors inside callbacks of live nodes: answered with a reason, counted, logged, and never the end of the process."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from std_msgs.msg import String
from std_srvs.srv import Trigger

from foretouch.ros.runtime.internal_errors import InternalErrors
from foretouch_msgs.srv import PredictTouch, StartRecording

pytestmark = pytest.mark.ros


def fail(*_: Any) -> Any:
    raise ZeroDivisionError("by zero\nin two lines")


async def fail_later(*_: Any) -> Any:
    fail()


def strange_parameter() -> ParameterMsg:
    """A parameter of a type that does not exist: rclpy itself would raise a ValueError."""
    return ParameterMsg(name="autostart", value=ParameterValue(type=77))


def is_active(graph: Any, name: str = "segmentation") -> bool:
    state = graph.call(GetState, f"{name}/get_state", GetState.Request()).current_state.id
    return bool(state == State.PRIMARY_STATE_ACTIVE)


@pytest.mark.parametrize("callback", [fail, fail_later])
def test_a_service_that_fails_answers_with_the_reason_and_the_node_goes_on(graph: Any, callback: Any) -> None:
    (node,) = graph.add("segmentation")
    node.create_service(Trigger, "broken", callback)
    for count in (1, 2):
        answer = graph.call(Trigger, "broken", Trigger.Request())
        assert (answer.success, answer.message) == (False, "ZeroDivisionError: by zero in two lines")
        assert node.internal_errors.counts() == {"broken": count}
    assert is_active(graph)


def test_answers_without_success_name_the_reason_in_their_own_fields(graph: Any) -> None:
    (node,) = graph.add("segmentation")
    node.create_service(PredictTouch, "broken_touch", fail)
    node.create_service(StartRecording, "broken_start", fail)
    touch = graph.call(PredictTouch, "broken_touch", PredictTouch.Request()).touch
    assert (touch.status, touch.reason) == (40, "ZeroDivisionError: by zero in two lines")
    started = graph.call(StartRecording, "broken_start", StartRecording.Request())
    assert (started.success, started.message) == (False, "ZeroDivisionError: by zero in two lines")


def test_timers_and_topics_that_fail_are_counted_and_reported_in_diagnostics(graph: Any) -> None:
    (node,) = graph.add("segmentation", diagnostics_period_s=0.1)
    reports = graph.listen(DiagnosticArray, "/diagnostics")
    node.create_timer(0.02, fail)
    node.subscribe(String, "words", fail)
    talk = graph.talk(String, "words")
    graph.matched("words")
    talk.publish(String(data="a"))
    graph.until(lambda: node.internal_errors.counts()["words"] == 1 and node.internal_errors.counts()["fail"] >= 3)

    def reported() -> bool:
        return any("internal errors in fail" in status.message for one in reports for status in one.status)

    graph.until(reported)
    status = reports[-1].status[0]
    assert status.level == DiagnosticStatus.WARN
    assert int({pair.key: pair.value for pair in status.values}["internal_errors.words"]) == 1


def test_a_parameter_of_an_unknown_type_is_refused(graph: Any) -> None:
    (node,) = graph.add("segmentation")
    request = SetParameters.Request(parameters=[strange_parameter()])
    (result,) = graph.call(SetParameters, "segmentation/set_parameters", request).results
    assert not result.successful
    assert result.reason == "autostart: type 77 is none of rcl_interfaces/ParameterType"
    together = SetParametersAtomically.Request(parameters=[strange_parameter()])
    result = graph.call(SetParametersAtomically, "segmentation/set_parameters_atomically", together).result
    assert (result.successful, result.reason) == (False, "autostart: type 77 is none of rcl_interfaces/ParameterType")
    assert not node.internal_errors.counts()  # the error is the sender's
    assert is_active(graph)


def test_a_parameter_callback_that_fails_refuses_the_change(graph: Any) -> None:
    (node,) = graph.add("segmentation")
    node.add_on_set_parameters_callback(fail)
    value = ParameterValue(type=3, double_value=7.0)
    request = SetParameters.Request(parameters=[ParameterMsg(name="silence_s", value=value)])
    (result,) = graph.call(SetParameters, "segmentation/set_parameters", request).results
    assert (result.successful, result.reason) == (False, "ZeroDivisionError: by zero in two lines")
    assert node.config.silence_s == 5.0


def test_a_node_that_cannot_stop_is_deactivated_nevertheless(graph: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (node,) = graph.add("segmentation")
    monkeypatch.setattr(type(node), "stop", fail)
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
    assert graph.call(ChangeState, "segmentation/change_state", request).success
    monkeypatch.undo()
    node.stop()
    assert node.internal_errors.counts() == {"fail": 1}


def test_a_cloud_whose_refusal_fails_too_is_counted_and_the_worker_goes_on(
    graph: Any, scene_cloud: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from sensor_msgs.msg import PointCloud2

    from foretouch.ros.messages.clouds import cloud_to_msg

    (node,) = graph.add("segmentation")
    clouds = graph.talk(PointCloud2, "points")
    graph.matched("points")
    monkeypatch.setattr(node, "answer", fail)
    monkeypatch.setattr(node, "refuse", fail)
    clouds.publish(cloud_to_msg(scene_cloud(stamp_ns=1)))
    graph.until(lambda: node.statistics.summary().dropped == {"failed": 1})
    monkeypatch.undo()
    clouds.publish(cloud_to_msg(scene_cloud(stamp_ns=2)))
    graph.until(lambda: node.statistics.summary().used == 1)


def test_the_log_is_one_line_and_throttled() -> None:
    lines: list[str] = []
    errors = InternalErrors(lines.append)
    for _ in range(100):
        errors.guarded("solve", fail)()
    errors.guarded("other", fail)()
    assert errors.counts() == {"solve": 100, "other": 1}
    assert len(lines) == 2
    pattern = r"solve: internal error 1: ZeroDivisionError: by zero in two lines \(.*test_internal_errors\.py:\d+\)"
    assert re.fullmatch(pattern, lines[0])


def test_a_process_survives_what_its_executor_raises(graph: Any, tmp_path: Path) -> None:
    """An answer that cannot be encoded is raised beyond the callback, in the executor."""
    code = """
import sys
from foretouch.ros import executables
from foretouch.ros.nodes.recorder import RecorderNode
from std_srvs.srv import Trigger
setup = RecorderNode.setup
def with_broken_service(self):
    setup(self)
    self.create_service(Trigger, "broken", lambda request, response: "no response")
RecorderNode.setup = with_broken_service
sys.exit(executables.run("recorder"))
"""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(graph.domain)}
    with subprocess.Popen([sys.executable, "-c", code], env=environment, stderr=subprocess.PIPE, text=True) as process:
        try:
            client = graph.probe.create_client(Trigger, "broken")
            assert client.wait_for_service(20.0)
            client.call_async(Trigger.Request())
            assert process.stderr is not None
            told = []
            while not any("executor: internal error 1: TypeError" in line for line in told):
                told.append(process.stderr.readline())
                assert told[-1], told  # not ended
            assert is_active(graph, "recorder")
        finally:
            process.send_signal(signal.SIGINT)
            _, rest = process.communicate(timeout=20)
    assert process.returncode == 0
    assert "Traceback" not in "".join(told) + rest
