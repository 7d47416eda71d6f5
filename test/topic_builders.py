# SPDX-License-Identifier: Apache-2.0
"""A bag of the topics that samples are assembled from, for the tests of imports."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from foretouch.dataset.formats.rosbag2 import BagWriter
from foretouch.dataset.recordings import sample_codec
from foretouch.types import Cloud

STORED = Path(sample_codec.__file__).parent / "definitions"
NS = 1_000_000_000


def _stamp(time_ns: int) -> SimpleNamespace:
    return SimpleNamespace(sec=time_ns // NS, nanosec=time_ns % NS)


def _header(time_ns: int) -> SimpleNamespace:
    return SimpleNamespace(stamp=_stamp(time_ns), frame_id="camera")


def _point(x: float, y: float, z: float, **more: float) -> SimpleNamespace:
    return SimpleNamespace(x=x, y=y, z=z, **more)


POSE = SimpleNamespace(position=_point(0.0, 0.0, 0.0), orientation=_point(0.0, 0.0, 1.0, w=0.0))
"""Half a turn about Z."""


def _grasp(name: str, matrix: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(
        id=name, object_id="1", g1=_point(0.1, 0.0, 1.0), g2=_point(-0.1, 0.0, 1.0), pose=POSE,
        rotation=matrix.ravel(), score=0.5, status=0, reason="",
    )  # fmt: skip


def _biotac(level: int, electrodes: int) -> SimpleNamespace:
    return SimpleNamespace(
        pac0=0, pac1=0, pac=np.zeros(2, np.int16), pdc=1700 + level, tac=0, tdc=0,
        electrodes=np.arange(electrodes, dtype=np.int16) + 3000 - level,
    )  # fmt: skip


def biotac_all(at_ns: int, level: int, electrodes: int = 24) -> tuple[str, Any]:
    """A `BiotacAll` of five equal fingers, `level` counts from rest."""
    tactiles = [_biotac(level, electrodes) for _ in range(5)]
    return "foretouch_msgs/msg/BiotacAll", SimpleNamespace(header=_header(at_ns), tactiles=tactiles)


def _table(at_ns: int, coefficients: tuple[float, ...]) -> SimpleNamespace:
    empty = {name: np.empty(0, np.float32) for name in ("obstacles", "outline")}
    plane = SimpleNamespace(coef=np.array(coefficients))
    ids = np.empty(0, np.uint32)
    return SimpleNamespace(header=_header(at_ns), plane=plane, **empty, obstacle_ids=ids, status=0, reason="")


TURNED = np.diag([-1.0, -1.0, 1.0])
"""The matrix of `POSE`."""


@dataclass(frozen=True, kw_only=True)
class Faults:
    """What is different in a bag from the plain one."""

    hole: bool = False  # in the readings
    late_ns: int = NS // 5  # reception of the readings
    ago_ns: int = 0  # by this all was received later than stamped: a recorded replay
    matrix: np.ndarray = field(default_factory=lambda: TURNED)
    executed: str = "a"  # the grasp
    second_cloud: bool = False  # another one with the stamp of the first
    electrodes: int = 24
    table: tuple[float, ...] = ()  # a, b, c, d under the first cloud; () sends no message


def write_topics(
    path: Path,
    faults: Faults | None = None,
    tactile: Callable[[int, int], tuple[str, Any]] | None = None,
    definitions: Mapping[str, str] | None = None,
    seen: Callable[[int], Mapping[str, tuple[str, Any]]] | None = None,
) -> None:
    """Two clouds; grasp "a" on the first is executed two seconds later, with 100 more counts in its hold.

    `tactile` gives type and content of a tactile message by its time and level, `definitions` those of types by name, and
    `seen`, instead of the clouds, type and content of the camera's messages by their topics.
    """
    faults = faults or Faults()
    tactile = tactile or (lambda at_ns, level: biotac_all(at_ns, level, faults.electrodes))
    start = 1_700_000_000 * NS
    with BagWriter(path) as writer:
        first = {"foretouch_msgs/msg/Grasp": (STORED / "StoredGrasp.msg").read_text()}  # its fields in 0.3
        for name, text in {**first, **(definitions or {})}.items():
            writer.definitions.register(name, text)

        def write(topic: str, kind: str, at_ns: int, message: Any) -> None:
            type_name = kind if "/" in kind else f"foretouch_msgs/msg/{kind}"
            writer.add_topic(topic, type_name)
            data = bytes(writer.definitions.store.serialize_cdr(message, type_name))
            writer.write(topic, type_name, at_ns + faults.ago_ns, data)

        def write_cloud(xyz: np.ndarray, at_ns: int) -> None:
            if seen is not None:
                for topic, (kind, message) in seen(at_ns).items():
                    write(topic, kind, at_ns + 1, message)
                return
            cloud = Cloud(xyz.astype(np.float32), frame_id="camera", stamp_ns=at_ns)
            writer.write_cloud(cloud, "/foretouch/object_cloud", bag_time_ns=at_ns + 1 + faults.ago_ns)

        for k, names in enumerate((("a", "b"), ("c",))):
            at = start + k * NS
            write_cloud(np.full((4, 3), k + 1), at)  # a point at zero is none
            grasps = [_grasp(name, faults.matrix) for name in names]
            planned = SimpleNamespace(header=_header(at), grasps=grasps, status=0, reason="")
            write("/foretouch/grasps", "GraspArray", at + 2, planned)
            if faults.table:
                write("/foretouch/table", "TablePlane", at + 3, _table(at, faults.table if k == 0 else (0.0,) * 4))
        if faults.second_cloud:
            write_cloud(np.full((4, 3), 7), start)
        contact, release = start + 3 * NS, start + 4 * NS
        for k in range(500):
            at = start + k * NS // 100
            if faults.hole and contact + NS // 4 < at < contact + NS // 2:
                continue
            level = 100 if contact <= at <= release else 0
            # Received late: the time of reception must not decide which readings are cut out.
            kind, message = tactile(at, level)
            write("/rh/tactile", kind, at + faults.late_ns, message)
        executed = SimpleNamespace(
            header=_header(release), grasp_id=faults.executed, achieved=POSE, start=_stamp(start + 2 * NS),
            contact=_stamp(contact), release=_stamp(release), success=True,
        )  # fmt: skip
        write("/foretouch/executed_grasp", "ExecutedGrasp", release, executed)
