# SPDX-License-Identifier: Apache-2.0
"""Structured fuzzing of every message and request: what the callbacks of the nodes do with each, without a graph.

Every case is a valid message with one to four absurd values, or whose serialised bytes are damaged. A child process
converts it as the nodes do; `live.py` sends such messages to the live graph.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import mmap
import os
import re
import resource
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from absurd import change, pick
from files import COLUMNS, LINE, MEMORY, SECONDS, mutated, write_table

PATIENCE_S = 15.0  # of CPU time for one case, until the child is killed; the first one includes the imports
STILL_S = 600.0  # of wall time, for a case that waits for something
DAMAGED = 0.25  # share of the cases whose bytes are damaged
FRAME = "camera_depth_optical_frame"
NOW_NS = 1_700_000_000_000_000_000
_PROGRESS = struct.Struct("<q")


@dataclass
class Kind:
    """One kind of message.

    Attributes:
        valid: Valid messages; classes of rclpy, or plain objects with the fields of a type that is not installed.
        read: Does what the nodes do with one; returns nothing.
        weight: Part of the cases, relative to other kinds: few where a case takes long.
    """

    valid: Sequence[Any]
    read: Callable[[Any], object]
    weight: float = 1.0


class NotFiniteError(ArithmeticError):
    """An answer without a refusal holds a number that is not finite."""


class UnnamedError(ValueError):
    """An answer with neither content nor a reason."""


def finite(what: str, *values: Any) -> None:
    """Check that all numbers of an answer are finite."""
    for value in values:
        if not np.isfinite(np.asarray(value, np.float64)).all():
            raise NotFiniteError(f"{what}: {value}")


# --- valid messages ---------------------------------------------------------------------------------------------


def box_cloud(points: int = 300) -> Any:
    """An object cloud: a box of 6 x 4 x 8 cm."""
    from foretouch.types import Cloud

    rng = np.random.default_rng(3)
    xyz = rng.uniform(-0.5, 0.5, (points, 3))
    axis = rng.integers(0, 3, points)
    xyz[np.arange(points), axis] = np.sign(xyz[np.arange(points), axis]) * 0.5
    return Cloud((xyz * [0.06, 0.04, 0.08] + [0.0, 0.0, 0.6]).astype(np.float32), None, FRAME, NOW_NS)


def scene_message() -> Any:
    """A small organised cloud of a table with an object."""
    from foretouch.ros.messages.clouds import cloud_to_msg
    from foretouch.ros.runtime.processing_node import warm_up_cloud
    from foretouch.types import Cloud

    cloud = warm_up_cloud()
    return cloud_to_msg(Cloud(cloud.xyz[::2, ::2].copy(), None, FRAME, NOW_NS))


def object_messages() -> list[Any]:
    """An `object_cloud` with labels and pixels, one with two objects, and one without labels."""
    from foretouch.pipeline import FoundObject
    from foretouch.ros.messages.clouds import cloud_to_msg, objects_to_msg
    from foretouch.types import ASSUMED_TABLE

    cloud = box_cloud()
    pixels = np.arange(cloud.size, dtype=np.int64)
    imaged = FoundObject("7", cloud, ASSUMED_TABLE, pixels, (20, 20))
    other = FoundObject("8", cloud, ASSUMED_TABLE, pixels, (20, 20))
    return [
        objects_to_msg([imaged], FRAME, NOW_NS),
        objects_to_msg([imaged, other], FRAME, NOW_NS),
        cloud_to_msg(cloud),
    ]


def grasp_message(name: str = "1/7/0") -> Any:
    """A grasp across the box."""
    from foretouch.ros.messages.conversions import grasp_to_msg
    from foretouch.types import Grasp

    rotation = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]).T
    return grasp_to_msg(Grasp(np.array([0.03, 0, 0.6]), np.array([-0.03, 0, 0.6]), rotation, 1.0, name, "7"))


def grasps_message() -> Any:
    """A `GraspArray` of two grasps."""
    from foretouch.ros.messages.conversions import header_to_msg
    from foretouch_msgs.msg import GraspArray

    return GraspArray(header=header_to_msg(FRAME, NOW_NS), grasps=[grasp_message(), grasp_message("1/7/1")])


def table_message() -> Any:
    """A `TablePlane`."""
    from shape_msgs.msg import Plane

    from foretouch.ros.messages.conversions import header_to_msg
    from foretouch_msgs.msg import TablePlane

    return TablePlane(header=header_to_msg(FRAME, NOW_NS), plane=Plane(coef=[0.0, 0.0, -1.0, 0.64]))


def tactile_message() -> Any:
    """A `BiotacAll`."""
    from foretouch.ros.messages.tactile import biotac_all_to_msg

    counts = np.concatenate([[2500], np.full(24, 3200)]).astype(np.int16)
    return biotac_all_to_msg({"TH": counts, "MF": counts, "FF": counts}, "rh", NOW_NS)


def executed_message() -> Any:
    """An `ExecutedGrasp`."""
    from foretouch.ros.messages.conversions import header_to_msg, stamp_to_msg
    from foretouch_msgs.msg import ExecutedGrasp

    times = {name: stamp_to_msg(NOW_NS + k * 10**8) for k, name in enumerate(("start", "contact", "release"), 1)}
    return ExecutedGrasp(header=header_to_msg(FRAME, NOW_NS), grasp_id="1/7/0", success=True, **times)


def touch_request() -> Any:
    """A `PredictTouch` request with a table."""
    from foretouch_msgs.srv import PredictTouch

    return PredictTouch.Request(
        cloud=object_messages()[0], grasps=[grasp_message(), grasp_message("2")], table=[table_message().plane]
    )


def sample_goal() -> Any:
    """A `SampleGrasps` goal with a cloud."""
    from foretouch_msgs.action import SampleGrasps

    return SampleGrasps.Goal(cloud=object_messages()[0], table=[table_message().plane], count=2, cost="pressure")


def label_request() -> Any:
    """A `LabelGrasp` request."""
    from foretouch_msgs.srv import LabelGrasp

    return LabelGrasp.Request(grasp_id="1/7/0", object="can", outcome=1)


# --- what the nodes do ------------------------------------------------------------------------------------------


def clouds() -> Kind:
    """Raw clouds: decode, and check what follows."""
    from foretouch.models.hand_history import Extent
    from foretouch.ros.messages.requests import read_cloud

    def read(message: Any) -> None:
        cloud = read_cloud(message)
        Extent.of(cloud)

    return Kind([scene_message(), *object_messages()], read)


def segmented() -> Kind:
    """Raw clouds through segmentation and the messages of its answer."""
    from foretouch.pipeline import Pipeline, PipelineConfig
    from foretouch.ros.messages.clouds import object_to_msg, objects_to_msg
    from foretouch.ros.messages.conversions import plane_to_msg
    from foretouch.ros.messages.requests import read_cloud

    pipeline = Pipeline(PipelineConfig())

    def read(message: Any) -> None:
        scene = pipeline.segment(read_cloud(message), np.zeros(3))
        if scene.status != "ok" and not scene.reason:
            raise UnnamedError(f"{scene.status} without a reason")
        finite("table", plane_to_msg(scene.segmentation.plane).coef)
        objects_to_msg(scene.targets, FRAME, NOW_NS)
        for one in scene.segmentation.objects:
            object_to_msg(one, target=True)
            finite("object", one.centroid, *one.bounds)

    return Kind([scene_message()], read, 0.1)


def object_clouds() -> Kind:
    """Object clouds."""
    from foretouch.cloud.geometry.limits import ObjectLimits
    from foretouch.models.hand_history import Extent
    from foretouch.ros.messages.requests import read_targets
    from foretouch.types import ASSUMED_TABLE

    def read(message: Any) -> None:
        for target in read_targets(message, ASSUMED_TABLE, ObjectLimits()):
            Extent.of(target.cloud)

    return Kind(object_messages(), read)


def planned() -> Kind:
    """Object clouds and a table through GeoGrasp, both methods."""
    from foretouch.cloud.geometry.limits import ObjectLimits
    from foretouch.grasp import GeoGraspConfig, GraspHold
    from foretouch.pipeline import Pipeline, PipelineConfig
    from foretouch.ros.messages.requests import plan_targets, read_table, read_targets

    pipelines = [Pipeline(PipelineConfig(grasp=GeoGraspConfig(method=method))) for method in ("original", "stable")]
    held, tables, calls = GraspHold(0.005), table_message(), iter(range(10**9))

    def read(message: Any) -> None:
        plane = read_table(tables, tables.header)
        number = next(calls)
        targets = read_targets(message, plane, ObjectLimits())[:3]
        hold = held if number % 2 else None
        answer = plan_targets(pipelines[number % 2], targets, message.header, "", hold, 1.0)
        if answer.status > 1 and not answer.reason:
            raise UnnamedError(f"status {answer.status} without a reason")
        for one in answer.grasps:
            finite("grasp", [one.g1.x, one.g1.y, one.g1.z, one.g2.x, one.g2.y, one.g2.z], one.rotation)

    return Kind(object_messages(), read, 0.05)


def tables() -> Kind:
    """Tables."""
    from foretouch.ros.messages.requests import read_table

    valid = table_message()

    def read(message: Any) -> None:
        plane = read_table(message, valid.header)
        finite("plane", plane.coefficients)

    return Kind([valid], read)


def grasps() -> Kind:
    """Grasps, as the hand, the assembler and the predictor decode them."""
    from foretouch.dataset.messages import decode_grasp, has_orientation

    def read(message: Any) -> None:
        for one in message.grasps:
            has_orientation(one)
            grasp = decode_grasp(one)
            finite("grasp", grasp.g1, grasp.g2, grasp.rotation)

    return Kind([grasps_message()], read)


def check_predictions(message: Any) -> None:
    """Each prediction is finite, or has a status with a reason."""
    if message.status and not message.reason:
        raise UnnamedError(f"status {message.status} without a reason")
    for one in message.predictions:
        if one.status == 0:
            rows = (one.pdc_th, one.pdc_mf, *one.e_th, *one.e_mf)
            finite("prediction", [row.value for row in rows])
        elif not one.reason:
            raise UnnamedError(f"status {one.status} without a reason")


def _predictor() -> Any:
    from foretouch.ros.touch.predictor import Predictor

    return Predictor("default")


def predicted() -> Kind:
    """Requests of `predict_touch`."""
    from foretouch.ros.messages.requests import read_plane, read_targets
    from foretouch.ros.touch.config import TouchPredictorConfig
    from foretouch.types import ASSUMED_TABLE

    predictor, config = _predictor(), TouchPredictorConfig()

    def read(request: Any) -> None:
        table = read_plane(request.table[0]) if request.table else None
        targets = read_targets(request.cloud, table or ASSUMED_TABLE, config.limits)
        posing = config.grasp if table else None
        message = predictor.array(targets, request.grasps, request.cloud.header, config, posing)
        check_predictions(predictor.finish(message, 1.0, 0.5).message)

    return Kind([touch_request()], read, 0.1)


def sampled() -> Kind:
    """Goals of `sample_grasps`."""
    from foretouch.ros.touch.config import TouchPredictorConfig
    from foretouch.ros.touch.grasp_actions import sample_grasps

    predictor, config = _predictor(), TouchPredictorConfig()

    def predict(target: Any, grasps: Any, header: Any) -> Any:
        return predictor.array([target], grasps, header, config).message.predictions

    def read(goal: Any) -> None:
        result = sample_grasps(goal, None, config, predict, lambda _: None, lambda: False)
        for one in result.predictions:
            check_predictions(SimpleNamespace(status=0, reason="", predictions=[one]))

    return Kind([sample_goal()], read, 0.05)


def _adapter(type_name: str) -> tuple[Any, Any]:
    """The online adapter of the predictor and the assembler of the recorder, for a tactile type."""
    from foretouch.dataset.pairing import AssemblerConfig, SampleAssembler
    from foretouch.models import load_model
    from foretouch.ros.touch.config import TouchPredictorConfig
    from foretouch.ros.touch.history_keeper import HistoryKeeper
    from foretouch.ros.touch.online_adapter import OnlineAdapter
    from foretouch.tactile.messages import TactileConfig, make_reader

    config = TouchPredictorConfig(tactile=TactileConfig(type=type_name))
    reader = make_reader(config.tactile)
    model = load_model("default")
    adapter = OnlineAdapter(model, reader, HistoryKeeper(model), lambda: config, lambda: NOW_NS, lambda _: None)
    settings = AssemblerConfig(object="can", unlabelled_s=0.0, assume_grasps=True, watch_sensors=True)
    return adapter, SampleAssembler(settings, reader)


def _tactile(type_name: str, valid: Sequence[Any]) -> Kind:
    from foretouch.errors import TactileError

    adapter, assembler = _adapter(type_name)
    clock = iter(range(10**9))

    def read(message: Any) -> None:
        adapter.add_tactile(message)  # counts what it cannot decode
        number = next(clock)
        try:
            accepted = assembler.add_tactile(message, received_ns=NOW_NS + number * 10**7, now_s=number * 0.01)
        finally:
            if number % 50 == 0:
                adapter.process_touches()
                assembler.poll(number * 0.01)
        for one in accepted:
            finite("reading", one.counts)
        if int(adapter.notes()["touches"]) > 10_000:
            raise TactileError("too many touches")

    return Kind(valid, read)


def biotac_all() -> Kind:
    """`BiotacAll`, of `foretouch_msgs` and of `sr_robot_msgs`."""
    return _tactile("foretouch_msgs/BiotacAll", [tactile_message()])


def biotac_csv() -> Kind:
    """Lines of `biotac_sp_ros`."""
    from std_msgs.msg import String

    line = ",".join(["12.5", *["3000"] * (3 * 54)])
    kind = _tactile("std_msgs/String", [String(data=line)])
    numbers = ("nan", "inf", "1e400", "", "-1", "x", "9" * 400, "1_0", "\u0663", "0x10", " 5 ")

    def read(message: Any) -> object:
        if len(message.data) < 10:  # an absurd string instead of a line: change one number of a line
            rng = np.random.default_rng(len(message.data))
            words = line.split(",")
            words[int(rng.integers(0, len(words)))] = pick(numbers, rng)
            kind.read(String(data=",".join(words)))
        return kind.read(message)

    return Kind(kind.valid, read)


def tactile_state() -> Kind:
    """`tactile_msgs/TactileState`; its package is not on PyPI, so that plain objects stand for its messages."""
    stamp = SimpleNamespace(sec=1_700_000_000, nanosec=0)
    sensors = [SimpleNamespace(name=name, values=[2500.0, *[3200.0] * 24]) for name in ("TH", "MF", "FF")]
    return _tactile(
        "tactile_msgs/TactileState",
        [SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id="rh"), sensors=sensors)],
    )


def executed() -> Kind:
    """Reports of executed grasps, for the predictor and the recorder, between readings, clouds and plans."""
    from rclpy.serialization import serialize_message

    from foretouch.dataset.pairing import SerializedCloud
    from foretouch.ros.messages.conversions import stamp_to_msg

    adapter, assembler = _adapter("foretouch_msgs/BiotacAll")
    clock, tactile, plan, cloud = iter(range(10**9)), tactile_message(), grasps_message(), object_messages()[0]

    def read(message: Any) -> None:
        number = next(clock)
        now_s = number * 0.05
        if number % 20 == 0:
            for k in range(10):
                tactile.header.stamp = stamp_to_msg(NOW_NS + (number * 5 + k) * 10**7)
                adapter.add_tactile(tactile)
                assembler.add_tactile(tactile, received_ns=NOW_NS + number * 10**7, now_s=now_s)
            cloud.header.stamp = plan.header.stamp = stamp_to_msg(NOW_NS + number)
            adapter.add_grasps(cloud, plan.grasps)
            data = bytes(serialize_message(cloud))
            assembler.add("cloud", SerializedCloud(data, lambda: cloud), received_ns=0, now_s=now_s)
            assembler.add("grasps", plan, received_ns=0, now_s=now_s)
        adapter.add_executed(message)
        assembler.add("executed", message, received_ns=0, now_s=now_s)
        adapter.process_touches()
        for result in assembler.poll(now_s):
            if not getattr(result, "reason", "x"):
                raise UnnamedError("rejected without a reason")

    return Kind([executed_message()], read)


def plans() -> Kind:
    """Clouds with plans, as the recorder and the predictor keep them until a grasp is reported."""
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import PointCloud2

    from foretouch.dataset.pairing import SerializedCloud
    from foretouch_msgs.msg import ExecutedGrasp

    adapter, assembler = _adapter("foretouch_msgs/BiotacAll")
    clock, cloud, tactile, report = iter(range(10**9)), object_messages()[0], tactile_message(), executed_message()
    data = bytes(serialize_message(cloud))
    adapter.add_tactile(tactile)

    def read(message: Any) -> None:
        number = next(clock)
        now_s = number * 0.05
        adapter.add_grasps(cloud, message.grasps)
        sent = SerializedCloud(data, lambda: deserialize_message(data, PointCloud2))
        assembler.add("cloud", sent, received_ns=0, now_s=now_s)
        assembler.add("grasps", message, received_ns=0, now_s=now_s)
        name = message.grasps[0].id if message.grasps else ""
        executed = ExecutedGrasp(header=report.header, grasp_id=name, success=True, contact=report.contact)
        adapter.add_executed(executed)
        assembler.add("executed", executed, received_ns=0, now_s=now_s)
        adapter.process_touches()
        assembler.poll(now_s, ending=number % 10 == 0)

    return Kind([grasps_message()], read, 0.3)


def recorded_clouds() -> Kind:
    """Serialised clouds as the recorder receives them."""
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import PointCloud2

    from foretouch.dataset.pairing import SerializedCloud

    _, assembler = _adapter("foretouch_msgs/BiotacAll")
    clock, plan = iter(range(10**9)), grasps_message()

    def read(message: Any) -> None:
        number = next(clock)
        data = bytes(serialize_message(message))
        plan.header = message.header
        sent = SerializedCloud(data, lambda: deserialize_message(data, PointCloud2))
        assembler.add("cloud", sent, received_ns=0, now_s=number * 0.05)
        assembler.add("grasps", plan, received_ns=0, now_s=number * 0.05)
        assembler.poll(number * 0.05, ending=number % 10 == 0)

    return Kind(object_messages(), read, 0.3)


def touches() -> Kind:
    """Predictions as `foretouch run` and the pictures read them."""
    from rich.console import Console

    from foretouch.cli.answers import answer_record
    from foretouch.cli.live import live_panel
    from foretouch.cli.output import print_json
    from foretouch.ros.messages.conversions import header_to_msg, prediction_to_msg
    from foretouch.ros.nodes.monitor import View
    from foretouch.types import Grasp, Touch, TouchPrediction
    from foretouch_msgs.msg import TouchPredictionArray

    grasp = Grasp(np.array([0.03, 0, 0.6]), np.array([-0.03, 0, 0.6]), np.eye(3), 1.0, "1", "7")
    touch = Touch.from_vector(np.full(50, 2000.0))
    prediction = TouchPrediction(grasp=grasp, value=touch, lower=touch, upper=touch)
    header = header_to_msg(FRAME, NOW_NS)
    valid = TouchPredictionArray(header=header, predictions=[prediction_to_msg(prediction, grasp_message(), header)])

    console, calls = Console(file=sys.stderr), iter(range(10**9))

    def read(message: Any) -> None:
        print_json(answer_record(message))
        if next(calls) % 10 == 0:  # drawing takes long
            console.print(live_panel(View(last=message), "fuzz"))

    return Kind([valid], read)


def labels() -> Kind:
    """Requests of `label_grasp`."""
    from foretouch.ros.nodes.recorder import _decode_label

    _, assembler = _adapter("foretouch_msgs/BiotacAll")
    calls = iter(range(10**9))

    def read(request: Any) -> None:
        number = next(calls)
        assembler.add("executed", executed_message(), received_ns=0, now_s=number * 0.1)
        assembler.label(_decode_label(request), number * 0.1)
        assembler.poll(number * 0.1)

    return Kind([label_request()], read)


def _settings(name: str) -> Kind:
    """Changes of the parameters of one node, and what it makes of them."""
    from importlib import import_module

    from rcl_interfaces.msg import ParameterType, ParameterValue
    from rclpy.parameter import parameter_value_to_python

    from foretouch.config import Settings
    from foretouch.errors import ConfigError

    module, config_name = {
        "segmentation": ("foretouch.ros.nodes.segmentation", "SegmentationNodeConfig"),
        "grasp": ("foretouch.ros.nodes.grasp", "GraspNodeConfig"),
        "touch_predictor": ("foretouch.ros.touch.config", "TouchPredictorConfig"),
        "recorder": ("foretouch.ros.nodes.recorder", "RecorderConfig"),
        "camera": ("foretouch.ros.nodes.camera", "CameraNodeConfig"),
        "hand": ("foretouch.ros.nodes.hand", "HandConfig"),
    }[name]
    config: Settings = getattr(import_module(module), config_name)()
    flat = config.to_mapping()
    names = _flattened(flat)
    calls = iter(range(10**9))

    def read(value: Any) -> None:
        if value.type > ParameterType.PARAMETER_STRING_ARRAY:
            raise ConfigError(f"type: {value.type} is unknown")  # `GuardedCallbacks` refuses it before rclpy reads it
        given = parameter_value_to_python(value)
        key = names[next(calls) % len(names)]
        changed = type(config).from_mapping({**flat, key: given})
        repr(changed)
        json.dumps(changed.to_mapping())

    types = [ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=1.0)]
    types.append(ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=5))
    types.append(ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="all"))
    types.append(ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True))
    types.append(ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[1.0, 2.0, 3.0]))
    types.append(ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=["a", "b"]))
    return Kind(types, read, 0.3)


def _flattened(mapping: dict[str, Any], prefix: str = "") -> list[str]:
    names = []
    for key, value in mapping.items():
        names += _flattened(value, f"{prefix}{key}.") if isinstance(value, dict) else [f"{prefix}{key}"]
    return names


KINDS: dict[str, Callable[[], Kind]] = {
    "PointCloud2": clouds,
    "PointCloud2 segmented": segmented,
    "object_cloud": object_clouds,
    "object_cloud planned": planned,
    "TablePlane": tables,
    "GraspArray": grasps,
    "GraspArray assembled": plans,
    "object_cloud recorded": recorded_clouds,
    "BiotacAll": biotac_all,
    "std_msgs String": biotac_csv,
    "TactileState": tactile_state,
    "ExecutedGrasp": executed,
    "TouchPredictionArray": touches,
    "predict_touch": predicted,
    "sample_grasps": sampled,
    "label_grasp": labels,
    **{f"parameters of {name}": lambda name=name: _settings(name) for name in (
        "segmentation", "grasp", "touch_predictor", "recorder", "camera", "hand"
    )},
}  # fmt: skip


# --- the child --------------------------------------------------------------------------------------------------


def messages_of(kind: Kind, seed: int, number: int, index: int) -> Any:
    """The message of a case; None if its damaged bytes cannot be deserialised, which the middleware refuses."""
    from rclpy.serialization import deserialize_message, serialize_message

    rng = np.random.default_rng([seed, index, number])
    valid = pick(kind.valid, rng)
    if not hasattr(valid, "get_fields_and_field_types"):
        import copy

        return change(copy.deepcopy(valid), rng)
    _, data = _SERIALISED.setdefault(id(valid), (valid, bytes(serialize_message(valid))))
    if rng.random() < DAMAGED:
        head, body = data[:4], mutated(data[4:], rng)
        try:
            return deserialize_message(head + body, type(valid))
        except Exception:  # noqa: BLE001  rclpy declares no type
            return None
    return change(deserialize_message(data, type(valid)), rng)


_SERIALISED: dict[int, tuple[Any, bytes]] = {}
"""By id, with the message itself: its id would be given to another one after it."""


def read_case(kind: Kind, seed: int, number: int, index: int) -> tuple[str, str, float]:
    """Convert the message of one case: outcome, detail of a fault, and CPU time [s]."""
    from foretouch.errors import ForetouchError

    outcome, detail = "read", ""
    message = messages_of(kind, seed, number, index)
    began = time.process_time()
    try:
        if message is None:
            outcome = "refused"
        else:
            kind.read(message)
    except ForetouchError as err:
        text = str(err)
        clear = text and "\n" not in text and len(text) < LINE
        outcome, detail = ("refused", "") if clear else ("uncaught", f"unclear: {text[:200]!r}")
    except BaseException as err:  # noqa: BLE001  whatever is not ForetouchError is what is searched for
        outcome, detail = "uncaught", f"{type(err).__name__}: {str(err)[:200]} at {_place(err)}"
    return outcome, detail, time.process_time() - began


def serve(name: str, cases: int, seed: int, first: int, progress: Path) -> None:
    """Read the cases of one kind; prints a line of JSON for each fault, and the counts at the end."""
    import warnings

    warnings.simplefilter("ignore")
    answers, sys.stdout = sys.stdout, sys.stderr
    index, kind = list(KINDS).index(name), KINDS[name]()
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + MEMORY, mapped + MEMORY))
    counts: Counter[str] = Counter()
    slowest = 0.0
    with progress.open("r+b") as file:
        shared = mmap.mmap(file.fileno(), _PROGRESS.size)
        for number in range(first, cases):
            shared[:] = _PROGRESS.pack(number)
            outcome, detail, seconds = read_case(kind, seed, number, index)
            slowest = max(slowest, seconds)
            if outcome in ("read", "refused") and seconds > SECONDS and number > first:
                outcome, detail = "slow", f"{seconds:.2f} s"
            counts[outcome] += 1
            if detail:
                print(json.dumps({"number": number, "outcome": outcome, "detail": detail}), file=answers, flush=True)
            if number % 5000 == 4999:
                gc.collect()
    print(json.dumps({"counts": counts, "slowest": slowest}), file=answers, flush=True)


def _place(err: BaseException) -> str:
    trace = err.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "?" if trace is None else f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"


# --- the parent -------------------------------------------------------------------------------------------------


def run(name: str, cases: int, seed: int) -> tuple[dict[str, Any], list[str]]:
    """Read cases of one kind in child processes; a row of the table, and a line for each fault."""
    counts: Counter[str] = Counter()
    faults: list[str] = []
    slowest, first = 0.0, 0
    with tempfile.NamedTemporaryFile(prefix="foretouch-fuzz-") as progress, tempfile.TemporaryFile("w+") as answers:
        while first < cases:
            answers.seek(0)
            answers.truncate()
            Path(progress.name).write_bytes(_PROGRESS.pack(first))
            ended = _child(name, cases, seed, first, progress.name, answers)
            answers.seek(0)
            for line in answers:
                answer = json.loads(line)
                if "counts" in answer:
                    counts.update(answer["counts"])
                    slowest = max(slowest, answer["slowest"])
                else:
                    faults.append(f"{name} {seed} {answer['number']}: {answer['outcome']}: {answer['detail']}")
            if ended == "":
                break
            (number,) = _PROGRESS.unpack(Path(progress.name).read_bytes())
            outcome = "slow" if ended == "hang" else "signal"
            counts[outcome] += 1
            counts["read"] += number - first  # those before it, without their outcomes
            faults.append(f"{name} {seed} {number}: {outcome}: {ended}")
            first = number + 1
    row = {"kind": name, "cases": cases, **{column: counts[column] for column in COLUMNS[2:-1]}}
    return {**row, "slowest_ms": round(slowest * 1e3, 1)}, faults


def _child(name: str, cases: int, seed: int, first: int, progress: str, answers: Any) -> str:
    """Run a child to its end; "" if it has read all cases, `hang`, or its exit status."""
    words = [sys.executable, __file__, "--serve", name, "--cases", str(cases), "--seed", str(seed)]
    process = subprocess.Popen(
        [*words, "--first", str(first), "--progress", progress], stdout=answers, stderr=subprocess.DEVNULL
    )
    at, since, used = -1, time.monotonic(), 0.0
    while process.poll() is None:
        time.sleep(0.2)
        (number,) = _PROGRESS.unpack(Path(progress).read_bytes())
        if number != at:
            at, since, used = number, time.monotonic(), _cpu_s(process.pid)
        elif _cpu_s(process.pid) - used > PATIENCE_S or time.monotonic() - since > STILL_S:
            process.kill()
            process.wait()
            return "hang"
    return "" if process.returncode == 0 else f"exit status {process.returncode}"


def _cpu_s(pid: int) -> float:
    """CPU time that a process has used [s]."""
    try:
        times = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(times[11]) + int(times[12])) / os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Run all kinds; the exit status is 1 if a case broke a rule."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=5000, help="messages in all (default 5000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, action="append", help="only this kind; may be repeated")
    parser.add_argument("--out", type=Path, help="write the table as CSV")
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    parser.add_argument("--first", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--progress", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        serve(options.serve, options.cases, options.seed, options.first, options.progress)
        return 0
    kinds = options.kind or list(KINDS)
    weights = {name: KINDS[name]().weight for name in kinds}
    rows, failed = [], False
    print("  ".join(COLUMNS))
    for name in kinds:
        cases = max(1, math.ceil(options.cases * weights[name] / sum(weights.values())))
        row, faults = run(name, cases, options.seed)
        rows.append(row)
        print("  ".join(str(row[column]) for column in COLUMNS), flush=True)
        places = Counter(re.sub(r"^.*? \d+ \d+: ", "", fault) for fault in faults)
        for fault in faults[:5]:
            print(f"  {fault}", flush=True)
        for text, count in places.most_common(8) if len(faults) > 5 else ():
            print(f"  {count} x {text}", flush=True)
        failed |= bool(faults)
    if options.out:
        write_table(options.out, rows)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
