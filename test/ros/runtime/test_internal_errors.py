# SPDX-License-Identifier: Apache-2.0
"""Errors inside callbacks of live nodes: answered with a reason, counted, logged, and never the end of the process."""

import re
import signal

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.callback_groups import ReentrantCallbackGroup
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.runtime.internal_errors import InternalErrors
from foretouch.ros.runtime.subscription import InputTopic
from foretouch_msgs.srv import StartRecording

pytestmark = pytest.mark.ros

GROUP = ReentrantCallbackGroup()
REASON = "ZeroDivisionError: by zero in two lines"


def fail(*_):
    raise ZeroDivisionError("by zero\nin two lines")


def is_active(graph, name="segmentation"):
    return graph.call(GetState, f"{name}/get_state").current_state.id == State.PRIMARY_STATE_ACTIVE


def test_a_service_that_fails_answers_with_the_reason_and_the_node_goes_on(graph):
    (node,) = graph.add("segmentation")
    node.serve(Trigger, "broken", fail, GROUP)
    for count in (1, 2):
        answer = graph.call(Trigger, "broken")
        assert (answer.success, answer.message) == (False, REASON)
        assert node.internal_errors.counts()["broken"] == count
    node.serve(StartRecording, "broken_start", fail, GROUP)
    started = graph.call(StartRecording, "broken_start")
    assert (started.success, started.message) == (False, REASON)
    assert is_active(graph)


def test_timers_and_topics_that_fail_are_counted_and_reported_in_diagnostics(graph):
    (node,) = graph.add("segmentation", diagnostics_period_s=0.1)
    reports = graph.reports("segmentation")
    node.every(0.02, fail)
    node.subscribe(InputTopic("words", String), fail)
    talk = graph.talk_matched(String, "words")
    talk.publish(String(data="a"))
    graph.until(lambda: node.internal_errors.counts()["words"] == 1 and node.internal_errors.counts()["fail"] >= 3)
    graph.until(lambda: reports and "internal errors in fail" in reports[-1].message)
    graph.until(lambda: reports[-1].values.get("internal_errors.words") == "1")
    assert reports[-1].level == DiagnosticStatus.WARN


def test_a_parameter_whose_callback_fails_is_refused(graph):
    (node,) = graph.add("segmentation")
    node.add_on_set_parameters_callback(fail)
    change = ParameterMsg(name="silence_s", value=ParameterValue(type=3, double_value=7.0))
    (one,) = graph.call(
        SetParameters, "segmentation/set_parameters", SetParameters.Request(parameters=[change])
    ).results
    assert (one.successful, one.reason, node.config.silence_s) == (False, REASON, 5.0)


def test_a_cloud_whose_refusal_fails_too_is_counted_and_the_worker_goes_on(graph, scene_cloud, monkeypatch):
    (node,) = graph.add("segmentation")
    clouds = graph.talk_matched(PointCloud2, "points")
    with monkeypatch.context() as patch:
        patch.setattr(node, "_answer", fail)
        patch.setattr(node, "_refuse", fail)
        clouds.publish(cloud_to_msg(scene_cloud(stamp_ns=1)))
        graph.until(lambda: node.statistics.summary().dropped == {"failed": 1})
    clouds.publish(cloud_to_msg(scene_cloud(stamp_ns=2)))
    graph.until(lambda: node.statistics.summary().used == 1)


def test_the_log_is_one_line_and_throttled():
    lines = []
    errors = InternalErrors(lines.append)
    for _ in range(99):
        errors.guarded("solve", fail)()
    errors.guarded("other", fail)()
    assert errors.counts() == {"solve": 99, "other": 1}
    assert len(lines) == 3
    assert re.fullmatch(rf"solve: internal error 1: {REASON} \(.*test_internal_errors\.py:\d+\)", lines[0])


@pytest.mark.slow
def test_a_process_survives_what_its_executor_raises(lone_graph):
    """An answer that cannot be encoded is raised beyond the callback, in the executor."""
    process = lone_graph.start("""
import sys
from foretouch.ros import executables
from foretouch.ros.nodes.recorder import RecorderNode
from std_srvs.srv import Trigger
setup = RecorderNode._setup
def with_broken_service(self):
    setup(self)
    self.create_service(Trigger, "broken", lambda request, response: "no response")
RecorderNode._setup = with_broken_service
sys.exit(executables.run("recorder"))
""")
    client = lone_graph.probe.create_client(Trigger, "broken")
    assert client.wait_for_service(20.0)
    client.call_async(Trigger.Request())
    logged = []
    while not any("executor: internal error 1: TypeError" in line for line in logged):
        logged.append(process.stderr.readline())
        assert logged[-1], logged  # not ended
    assert is_active(lone_graph, "recorder")
    process.send_signal(signal.SIGINT)
    _, rest = process.communicate(timeout=20)
    assert process.returncode == 0
    assert "Traceback" not in "".join(logged) + rest
