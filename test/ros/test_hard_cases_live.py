# SPDX-License-Identifier: Apache-2.0
"""Each hard case through the running nodes over real DDS: an answer with a name or the right one, no NaN, and life goes on.

One graph gets all cases; after each of them a good cloud and a good request must be answered as before, bit for bit.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

sys.path.insert(0, str(Path(__file__).parents[1]))
from corpus.clouds import ObjectCase, SceneCase, across, ball, bar, object_cases, scene_cases
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import PointCloud2, PointField
from visualization_msgs.msg import MarkerArray

from foretouch.dataset.messages import decode_cloud
from foretouch.ros.executables import PERCEPTION
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, plane_to_msg, point_to_msg
from foretouch.ros.messages.requests import status_name
from foretouch.ros.runtime.processing_node import warm_up_cloud
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import ASSUMED_TABLE, Cloud, Grasp, Plane, Touch
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import GraspArray, ObjectArray, Status, TablePlane, TouchPrediction, TouchPredictionArray
from foretouch_msgs.srv import PredictTouch

pytestmark = [pytest.mark.ros, pytest.mark.slow]

FRAME = "camera"
OUTPUTS = {"objects": ObjectArray, "table": TablePlane, "grasps": GraspArray, "touch": TouchPredictionArray}
ANSWERED = (Status.OK, Status.INITIAL_POINTS)
_MOST_POINTS = 200_000  # a million are below
OBJECTS = [case for case in object_cases() if case.cloud.size <= _MOST_POINTS]
SCENES = [case for case in scene_cases() if case.cloud.size <= _MOST_POINTS]
FORMATS = ("<f4", ">f4", "<f8", ">f8")
each_object = pytest.mark.parametrize("case", OBJECTS, ids=[case.name for case in OBJECTS])
each_scene = pytest.mark.parametrize("case", SCENES, ids=[case.name for case in SCENES])


def cloud_msg(xyz: Any, kind: str = "<f4", *, spare: int = 0) -> PointCloud2:
    """(H, W, 3) or (N, 3) as a message of numbers of this kind, with spare bytes after each point and each row."""
    rows = xyz if xyz.ndim == 3 else xyz[None]
    size = np.dtype(kind).itemsize
    with np.errstate(over="ignore"):
        numbers = np.ascontiguousarray(rows.astype(kind)).view(np.uint8).reshape(*rows.shape[:2], 3 * size)
    step = 3 * size + spare
    data = np.full((rows.shape[0], rows.shape[1] * step + spare), 0xFF, np.uint8)
    for k in range(rows.shape[0]):
        data[k, : rows.shape[1] * step].reshape(-1, step)[:, : 3 * size] = numbers[k]
    code = PointField.FLOAT32 if size == 4 else PointField.FLOAT64
    message = PointCloud2(
        height=rows.shape[0],
        width=rows.shape[1],
        fields=[PointField(name=name, offset=i * size, datatype=code, count=1) for i, name in enumerate("xyz")],
        is_bigendian=kind[0] == ">",
        point_step=step,
        row_step=data.shape[1],
    )
    message.data.frombytes(data.tobytes())
    return message


def numbers(message: Any) -> Iterator[tuple[str, float]]:
    """Every number of a message with its name; clouds are decoded."""
    if isinstance(message, PointCloud2):
        yield "xyz", float(decode_cloud(message).xyz.sum())
        return
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        for one in value if isinstance(value, (list, tuple)) else [value]:
            if hasattr(one, "get_fields_and_field_types"):
                yield from ((f"{name}.{inner}", number) for inner, number in numbers(one))
            elif isinstance(one, float):
                yield name, one
            elif isinstance(one, np.ndarray) and one.dtype.kind == "f":
                yield name, float(one.sum())


def content(one: TouchPrediction) -> bytes:
    """All numbers of a prediction to their last bit, without stamps."""
    rows = [(i.value, i.lower, i.upper) for i in (one.pdc_th, one.pdc_mf, *one.e_th, *one.e_mf)]
    contacts = [(p.x, p.y, p.z) for p in (one.grasp.g1, one.grasp.g2)]
    return np.array([*rows, *contacts]).tobytes() + one.grasp.rotation.tobytes()


def check_numbers(message: Any) -> None:
    """No number is NaN or infinite, but for the values of a refused prediction and an undefined score."""
    if isinstance(message, TouchPredictionArray):
        for one in message.predictions:
            assert one.status == Status.OK or one.reason
            if one.status == Status.OK:
                check_numbers(one)
        return
    for name, number in numbers(message):
        assert math.isfinite(number) or name.endswith("score") or (name.startswith("grasp") and "score" in name), name


@dataclass
class Life:
    """A running graph, all that it publishes, and what it answers to a good cloud."""

    graph: Any
    heard: dict[str, list[Any]]
    talk: dict[str, Any]
    client: Any
    own: set[tuple[str, int]] = field(default_factory=set)  # messages of the test itself
    last_ns: int = 1_700_000_000_000_000_000
    good: list[bytes] = field(default_factory=list)

    def header(self) -> Any:
        self.last_ns += 1_000_000
        return header_to_msg(FRAME, self.last_ns)

    def send(self, messages: dict[str, Any]) -> dict[str, Any]:
        """Publish messages of one stamp, and wait until they are answered on `touch`; the answers of that stamp."""
        header = self.header()
        self.own |= {(topic, self.last_ns) for topic in messages}
        for topic, message in messages.items():
            message.header = header
            self.talk[topic].publish(message)
        self.graph.until(lambda: any(stamp_ns(m.header.stamp) == self.last_ns for m in self.heard["touch"][-3:]), 20.0)
        found = {}
        for topic, heard in self.heard.items():
            stamped = [m for m in heard if hasattr(m, "header") and stamp_ns(m.header.stamp) == self.last_ns]
            if stamped and topic not in messages:
                (found[topic],) = stamped
        return found

    def ask(self, cloud: PointCloud2, grasps: list[GraspMsg], plane: Plane | None) -> TouchPredictionArray:
        cloud.header = self.header()
        table = [] if plane is None else [plane_to_msg(plane)]
        request = PredictTouch.Request(cloud=cloud, grasps=grasps, table=table)
        future = self.client.call_async(request)
        self.graph.until(future.done)
        return future.result().touch

    def answer_good(self) -> list[bytes]:
        """Values for a good scene and a good request, without stamps."""
        said = self.send({"points": cloud_to_msg(warm_up_cloud())})["touch"]
        asked = self.ask(cloud_to_msg(Cloud((bar() + AWAY).astype(np.float32))), [grasp_to_msg(across())], None)
        assert said.predictions[0].status == asked.predictions[0].status == Status.OK
        return [content(one.predictions[0]) for one in (said, asked)]

    def check(self) -> None:
        """All that was published is finite, no internal error has been counted, and the good ones are answered as before."""
        for topic, heard in self.heard.items():
            for message in heard:
                if topic == "markers" or (topic, stamp_ns(message.header.stamp)) not in self.own:
                    check_numbers(message)
        assert self.answer_good() == self.good
        for node in self.graph.nodes:
            assert not node.internal_errors.counts()
            assert node.state_name == "active"
        for heard in self.heard.values():
            del heard[:]


REQUESTED = {"table 1e9 m away": "farther away than 1000 m", "grasp zero rotation": "ok"}  # nine zeros: it is computed
AWAY = np.array([0.02, -0.01, 1.2])


@pytest.fixture(scope="module")
def life(module_graph: Any) -> Iterator[Life]:
    graph = module_graph
    # A model without a tracker, whose answers after a touch depend on the time.
    nodes = graph.add(*PERCEPTION, model="contact-v1", grasp_hold=0.0, silence_s=1e6, late_after_s=0.0)
    heard = {topic: graph.listen(message, topic) for topic, message in OUTPUTS.items()}
    heard |= {
        "object_cloud": graph.listen(PointCloud2, "object_cloud"),
        "markers": graph.listen(MarkerArray, "markers"),
    }
    reports = graph.listen(DiagnosticArray, "/diagnostics")
    inputs = {"points": PointCloud2, "object_cloud": PointCloud2, "table": TablePlane, "grasps": GraspArray}
    talk = {topic: graph.talk(message, topic) for topic, message in inputs.items()}
    for topic in ("points", *heard):
        graph.matched(topic)
    client = graph.probe.create_client(PredictTouch, "predict_touch")
    assert client.wait_for_service(10.0)
    one = Life(graph, heard, talk, client)
    touched = np.concatenate([[2600.0, 1700.0], np.full(24, 3100.0), np.full(24, 3300.0)])
    cloud = Cloud((ball() + AWAY).astype(np.float32), frame_id=FRAME)  # so that each cloud is compared with it
    nodes[2]._adapter._memory.add(cloud, across(), Touch.from_vector(touched), None, 0.02)
    one.good = one.answer_good()
    yield one
    graph.until(lambda: reports)
    for status in (status for report in reports for status in report.status):
        assert not [pair.key for pair in status.values if pair.key.startswith("internal_errors")]


def named(answer: Any) -> bool:
    """Whether a refusal has a status of the list, other than an internal error, and a reason."""
    return answer.status != Status.FAILED and "status" not in status_name(answer.status) and bool(answer.reason)


def agree(status: int, reason: str, pattern: str) -> None:
    """An answer, or a refusal with a name and the expected reason."""
    if pattern == "ok":
        assert status in ANSWERED, (status_name(status), reason)
        return
    assert status not in (*ANSWERED, Status.FAILED), (status_name(status), reason)
    assert "status" not in status_name(status)
    assert re.search(pattern, reason), (status_name(status), reason)


@each_scene
def test_a_scene(life: Life, case: SceneCase) -> None:
    said = life.send({"points": cloud_msg(case.cloud.xyz)})
    touch, wanted = said["touch"], case.segmented
    if wanted == "ok":
        agree(touch.status, touch.reason, "ok")
        assert touch.predictions
    else:
        assert status_name(touch.status) == status_name(said["objects"].status) == wanted
        agree(touch.status, touch.reason, case.reason)
    life.check()


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("spare", [0, 5])
def test_a_scene_in_every_format(life: Life, kind: str, spare: int) -> None:
    image = warm_up_cloud().xyz
    said = life.send({"points": cloud_msg(image, kind, spare=spare)})["touch"].predictions[0]
    assert content(said) == life.good[0]
    touch = life.send({"points": cloud_msg(image.reshape(-1, 3), kind, spare=spare)})["touch"]
    agree(touch.status, touch.reason, "ok")
    life.check()


@pytest.mark.parametrize("kind", [">f8", "<f8"])
def test_numbers_that_no_float32_holds(life: Life, kind: str) -> None:
    image = warm_up_cloud().xyz.astype(np.float64)
    image[10, 10:14, 0] = [1e300, -1e300, 5e-324, 3e38]
    image[11, 10:14, 2] = [1e300, -1e300, 5e-324, 3e38]
    touch = life.send({"points": cloud_msg(image, kind)})["touch"]
    agree(touch.status, touch.reason, "ok")
    life.check()


def test_a_million_points(life: Life) -> None:
    scene = next(case for case in SCENES if case.segmented == "ok").cloud.xyz
    touch = life.send({"points": cloud_msg(np.tile(scene.reshape(-1, 3), (14, 1))[:1_000_000])})["touch"]
    assert touch.status in ANSWERED or touch.reason
    assert touch.status != Status.FAILED
    cloud = cloud_msg((ball(1_000_000) + AWAY).astype(np.float32))
    answer = life.ask(cloud, [grasp_to_msg(across())], ASSUMED_TABLE)
    agree(answer.status, answer.reason, "ok")
    life.check()


@each_object
def test_an_object(life: Life, case: ObjectCase) -> None:
    """On its own as `points`; with its table; and in a request, with a grasp that has an orientation and one that has none."""
    touch = life.send({"points": cloud_msg(case.cloud.xyz)})["touch"]
    assert touch.status in ANSWERED or named(touch)

    table = TablePlane(plane=plane_to_msg(case.plane), status=Status.OK)
    said = life.send({"table": table, "object_cloud": cloud_msg(case.cloud.xyz)})
    assert said["grasps"].status in ANSWERED or named(said["grasps"])
    assert said["touch"].status in ANSWERED or named(said["touch"])
    if case.planned == "ok":  # by the method `original`
        agree(said["grasps"].status, said["grasps"].reason, "ok")

    grasps = [grasp_of(case.grasp), grasp_of(case.grasp, oriented=False)]
    answer = life.ask(cloud_msg(case.cloud.xyz, FORMATS[len(case.name) % 4]), grasps, case.plane)
    oriented, *unoriented = answer.predictions or [answer]
    agree(oriented.status, oriented.reason, REQUESTED.get(case.name, pattern_of(case)))
    assert all(one.status == Status.OK or named(one) for one in unoriented)
    life.check()


@pytest.mark.parametrize(
    "case", [case for case in OBJECTS if case.name.startswith("grasp")], ids=lambda case: case.name
)
def test_grasps_of_another_planner(life: Life, case: ObjectCase) -> None:
    grasps = GraspArray(grasps=[grasp_of(case.grasp), grasp_of(across())])
    touch = life.send({"object_cloud": cloud_msg(case.cloud.xyz), "grasps": grasps})["touch"]
    hard, fine = touch.predictions
    agree(hard.status, hard.reason, pattern_of(case))
    assert fine.status == Status.OK
    life.check()


def pattern_of(case: ObjectCase) -> str:
    """Of the reason of a refused prediction, or "ok"."""
    if case.predicted == "not a rotation matrix":
        return "not a rotation|no orientation"  # of a message, where nine zeros are none
    return "ok" if case.predicted == "ok" else f"{case.predicted}|holds no finite point"


def grasp_of(grasp: Grasp, *, oriented: bool = True) -> GraspMsg:
    """A message with the grasp's matrix alone, since one that is no rotation has no quaternion; or without orientation."""
    rotation = grasp.rotation.reshape(9) if oriented else np.zeros(9)
    message = GraspMsg(g1=point_to_msg(grasp.g1), g2=point_to_msg(grasp.g2), rotation=rotation)
    message.pose.orientation.w = 0.0
    return message
