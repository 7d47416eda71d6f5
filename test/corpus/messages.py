# SPDX-License-Identifier: Apache-2.0
"""Every kind of message and request: valid ones, and what the callbacks of the nodes do with them, without a graph; for `test_fuzz.py`.

Messages of a kind follow each other in one process, so that the state of adaptation and assembler is part of the test.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import count
from typing import Any

import numpy as np
from corpus.changes import Draw, absurd, damaged
from corpus.clouds import bar
from hypothesis import assume
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Plane

from foretouch import reading
from foretouch.cloud.messages import decode_cloud, decode_objects
from foretouch.dataset.labelling.assembler import AssemblerConfig, SampleAssembler
from foretouch.dataset.labelling.buffers import SeenObjects
from foretouch.errors import ForetouchError
from foretouch.models import load_model
from foretouch.models.history_keeper import HistoryKeeper
from foretouch.models.touch_model import place_and_size
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.clouds import cloud_to_msg, object_to_msg, objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, plane_to_msg, stamp_to_msg
from foretouch.ros.messages.placement import Placement
from foretouch.ros.messages.requests import RequestedGrasps, Targets, read_plane, read_targets
from foretouch.ros.nodes.perception import TouchPredictorConfig
from foretouch.ros.nodes.recorder import _decode_label
from foretouch.ros.runtime.processing_node import warm_up_cloud
from foretouch.ros.steps.online_adapter import OnlineAdapter
from foretouch.ros.steps.predictor import Predictor
from foretouch.tactile.messages.readers import make_reader
from foretouch.types import ASSUMED_TABLE, Cloud, Grasp
from foretouch.types.scene import Object
from foretouch_lab.ros.hand_messages import biotac_all_to_msg
from foretouch_msgs.msg import ExecutedGrasp, GraspArray
from foretouch_msgs.srv import LabelGrasp, PredictTouch

FRAME = "camera_depth_optical_frame"
NOW_NS = 1_700_000_000_000_000_000


WEIGHTS = {"predicted": 0.2, "hand": 2.0}
"""Shares of the cases: few where a case takes long."""


def named(status: Any, reason: str) -> None:
    """Check that a status other than OK has a reason."""
    assert status in (0, "ok") or reason, f"status {status} without a reason"


def finite(what: str, *values: Any) -> None:
    """Check that all numbers of an answer are finite."""
    for value in values:
        assert np.isfinite(np.asarray(value, np.float64)).all(), f"{what}: {value}"


# Valid messages.


def scene_message() -> Any:
    """A small organised cloud of a table with an object."""
    return cloud_to_msg(Cloud(warm_up_cloud().xyz[::2, ::2].copy(), None, FRAME, NOW_NS))


def object_messages() -> list[Any]:
    """An `object_cloud` with labels and pixels, one with two objects, and one without labels."""
    cloud = Cloud((bar() + np.array([0.0, 0.0, 0.6])).astype(np.float32)[::10], None, FRAME, NOW_NS)
    pixels = np.arange(cloud.size, dtype=np.int64)
    one, other = (Object.of(name, cloud, ASSUMED_TABLE, pixels=pixels, image_shape=(20, 20)) for name in ("7", "8"))
    return [objects_to_msg([one], FRAME, NOW_NS), objects_to_msg([one, other], FRAME, NOW_NS), cloud_to_msg(cloud)]


def grasp_message(name: str = "1/7/0") -> Any:
    """A grasp across the box."""
    rotation = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]).T
    return grasp_to_msg(Grasp(np.array([0.03, 0, 0.6]), np.array([-0.03, 0, 0.6]), rotation, 1.0, name, "7"))


def contacts(grasp: Any) -> list[float]:
    """Coordinates of both contacts."""
    return [grasp.g1.x, grasp.g1.y, grasp.g1.z, grasp.g2.x, grasp.g2.y, grasp.g2.z]


def grasps_message() -> Any:
    """A `GraspArray` of two grasps."""
    return GraspArray(header=header_to_msg(FRAME, NOW_NS), grasps=[grasp_message(), grasp_message("1/7/1")])


def tactile_message() -> Any:
    """A `BiotacAll`."""
    counts = np.concatenate([[2500], np.full(24, 3200)]).astype(np.int16)
    return biotac_all_to_msg({"TH": counts, "MF": counts, "FF": counts}, "rh", NOW_NS)


def executed_message() -> Any:
    """An `ExecutedGrasp`."""
    times = {name: stamp_to_msg(NOW_NS + k * 10**8) for k, name in enumerate(("start", "contact", "release"), 1)}
    return ExecutedGrasp(header=header_to_msg(FRAME, NOW_NS), grasp_id="1/7/0", success=True, **times)


def touch_request() -> Any:
    """A `PredictTouch` request with a table."""
    grasps = [grasp_message(), grasp_message("2")]
    return PredictTouch.Request(cloud=object_messages()[0], grasps=grasps, table=[Plane(coef=[0.0, 0.0, -1.0, 0.64])])


def array_request() -> Any:
    """The same with arrays, for objects of which one is named."""
    request = PredictTouch.Request(
        cloud=object_messages()[0], table=[Plane(coef=[0.0, 0.0, -1.0, 0.64])], object_id="7", id="mine"
    )
    request.contacts, request.rotations = contacts(grasp_message()) * 2, [*grasp_message().rotation] * 2
    return request


def label_request() -> Any:
    """A `LabelGrasp` request."""
    return LabelGrasp.Request(grasp_id="1/7/0", object="can", outcome=1)


# What the nodes do: functions that return valid messages, and what reads one like them.

Reader = tuple[Sequence[Any], Callable[[Any], object]]


def clouds() -> Reader:
    """Raw clouds: decoded, and one in ten segmented."""
    pipeline, numbers = Pipeline(PipelineConfig()), count()

    def read(message: Any) -> None:
        cloud = decode_cloud(message)
        place_and_size(cloud)
        if next(numbers) % 10:
            return
        scene = pipeline.segment(cloud, np.zeros(3))
        named(scene.status, scene.reason)
        finite("table", plane_to_msg(scene.table).coef)
        objects_to_msg(scene.targets, FRAME, NOW_NS)
        for object_ in scene.objects:
            object_to_msg(object_, Placement(header_to_msg(FRAME, NOW_NS)), target=True)
            finite("object", object_.centroid, *object_.bounds)

    return [scene_message(), *object_messages()], read


def check_predictions(message: Any) -> None:
    """Each prediction is finite, or has a status with a reason."""
    named(message.status, message.reason)
    for prediction in message.predictions:
        named(prediction.status, prediction.reason)
        if prediction.status == 0:
            finite("prediction", [*prediction.scalars, *prediction.values])


def check_batch(batch: Any) -> None:
    """The same of arrays."""
    named(batch.status, batch.reason)
    found = reading(batch)
    for k, (status, reason) in enumerate(zip(batch.statuses, batch.reasons, strict=True)):
        named(status, reason)
        if status == 0:
            finite("prediction", found.value[k])


def predicted() -> Reader:
    """Requests of `predict_touch`."""
    predictor, config = Predictor("default"), TouchPredictorConfig()

    def read(request: Any) -> None:
        table = read_plane(request.table[0]) if request.table else None
        found = read_targets(request.cloud, table or ASSUMED_TABLE, config.limits)
        targets = Targets(request.cloud.header, found)
        posing = config.grasp if table else None
        arrays = len(request.contacts) or len(request.rotations)
        requested = RequestedGrasps.of_arrays(request) if arrays else RequestedGrasps.of_messages(request.grasps)
        answer = predictor.answer(targets, requested, config, posing)
        (check_batch if arrays else check_predictions)(answer.reply)

    return [touch_request(), array_request()], read


class _Hand:
    """The online adapter of the predictor and the assembler of the recorder, which get the same messages."""

    def __init__(self) -> None:
        config, model = TouchPredictorConfig(), load_model()
        reader = make_reader(config.tactile)
        keeper = HistoryKeeper(model)
        self.adapter = OnlineAdapter(model, reader, keeper, lambda: config, lambda: NOW_NS, lambda _: None)
        settings = AssemblerConfig(object="can", unlabelled_s=0.0, assume_grasps=True, watch_sensors=True)
        self.assembler = SampleAssembler(settings, reader)
        self._number = 0

    def add(self, message: Any) -> None:
        """A message of any topic."""
        self._number += 1
        now_s, received_ns = self._number * 0.05, NOW_NS + self._number * 5 * 10**7
        if isinstance(message, ExecutedGrasp):
            self.adapter.add_executed(message)
            self.assembler.add("executed", message, received_ns=0, now_s=now_s)
        elif isinstance(message, GraspArray):
            cloud = object_messages()[0]
            self.adapter.add_grasps(Targets(cloud.header, decode_objects(cloud)), message.grasps)
            self.assembler.add("grasps", message, received_ns=0, now_s=now_s)
        elif isinstance(message, PointCloud2):
            self.adapter.add_grasps(Targets(message.header, decode_objects(message)), grasps_message().grasps)
            data = bytes(serialize_message(message))  # as the recorder receives it
            cloud = SeenObjects.of_message(data, lambda: decode_objects(deserialize_message(data, PointCloud2)))
            self.assembler.add("cloud", cloud, received_ns=0, now_s=now_s)
        elif isinstance(message, LabelGrasp.Request):
            self.assembler.matcher.add_label(_decode_label(message), now_s)
        else:
            self.adapter.add_tactile(message)  # counts what it cannot decode
            for one in self.assembler.add_tactile(message, received_ns=received_ns, now_s=now_s):
                finite("reading", one.counts)

    def settle(self) -> None:
        """What the nodes do between messages."""
        self.adapter.process_touches()
        for result in self.assembler.poll(self._number * 0.05, ending=self._number % 10 == 0):
            named("rejected", getattr(result, "reason", "a sample"))


def hand() -> Reader:
    """Readings, plans, clouds, reports and labels for the predictor and the recorder, after valid ones of a grasp."""
    one, numbers = _Hand(), count()
    tactile, plan, cloud, report = tactile_message(), grasps_message(), object_messages()[0], executed_message()

    def read(message: Any) -> None:
        number = next(numbers)
        if number % 20 == 0:
            for k in range(10):
                tactile.header.stamp = stamp_to_msg(NOW_NS + (number * 5 + k) * 10**7)
                one.add(tactile)
            cloud.header.stamp = plan.header.stamp = stamp_to_msg(NOW_NS + number)
            for valid in (cloud, plan, report):
                one.add(valid)
        try:
            one.add(message)
        finally:
            one.settle()

    return [tactile, plan, *object_messages(), report, label_request()], read


def changed(valid: Sequence[Any], read: Callable[[Any], object]) -> Callable[[Draw], Callable[[], object]]:
    """Absurd values in one of some messages, or for a quarter damaged bytes that the middleware deserialises."""
    # Once: bytes between the fields, which are not set, differ each time.
    kept = [(type(one), bytes(serialize_message(one))) for one in valid]
    with suppress(ForetouchError):  # what is loaded for the first one is no part of its time
        read(valid[0])

    def change(draw: Draw) -> Callable[[], object]:
        kind, data = draw(st.sampled_from(kept))
        if draw(st.integers(0, 3)):
            made = absurd(draw, deserialize_message(data, kind))
            return lambda: read(made)
        data = data[:4] + damaged(draw, data[4:])
        try:
            made = deserialize_message(data, kind)
        except Exception:  # noqa: BLE001  rclpy declares no type; the middleware drops such messages
            assume(False)
        return lambda: read(made)

    return change


KINDS: dict[str, Callable[[], Reader]] = {make.__name__: make for make in (clouds, hand, predicted)}
"""What makes valid messages of a kind and what reads them, by name."""
