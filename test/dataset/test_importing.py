# SPDX-License-Identifier: Apache-2.0
"""Bags with named topics become the samples that the recorder would have made of their messages."""

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from recording_builders import IDENTITY

from foretouch.dataset.bag_writer import BagWriter
from foretouch.dataset.importing import BagTopics, ImportResult, import_samples
from foretouch.dataset.record import SampleRecord
from foretouch.dataset.recording.verify import verify_dataset
from foretouch.dataset.samples import open_samples
from foretouch.errors import ConfigError, FileError
from foretouch.types import Cloud

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


def write_topics(path: Path, faults: Faults | None = None) -> None:
    """Two clouds; grasp "a" on the first is executed two seconds later, with 100 more counts in its hold."""
    faults = faults or Faults()
    start = 1_700_000_000 * NS
    with BagWriter(path) as writer:

        def write(topic: str, kind: str, at_ns: int, message: SimpleNamespace) -> None:
            type_name = f"foretouch_msgs/msg/{kind}"
            writer.add_topic(topic, type_name)
            data = bytes(writer.definitions.store.serialize_cdr(message, type_name))
            writer.write(topic, type_name, at_ns + faults.ago_ns, data)

        def write_cloud(xyz: np.ndarray, at_ns: int) -> None:
            cloud = Cloud(xyz.astype(np.float32), frame_id="camera", stamp_ns=at_ns)
            writer.write_cloud(cloud, "/foretouch/object_cloud", bag_time_ns=at_ns + 1 + faults.ago_ns)

        for k, names in enumerate((("a", "b"), ("c",))):
            at = start + k * NS
            write_cloud(np.full((4, 3), k), at)
            grasps = [_grasp(name, faults.matrix) for name in names]
            planned = SimpleNamespace(header=_header(at), grasps=grasps, status=0, reason="")
            write("/foretouch/grasps", "GraspArray", at + 2, planned)
        if faults.second_cloud:
            write_cloud(np.full((4, 3), 7), start)
        contact, release = start + 3 * NS, start + 4 * NS
        for k in range(500):
            at = start + k * NS // 100
            if faults.hole and contact + NS // 4 < at < contact + NS // 2:
                continue
            level = 100 if contact <= at <= release else 0
            tactiles = [_biotac(level, faults.electrodes) for _ in range(5)]
            # Received late: the time of reception must not decide which readings are cut out.
            message = SimpleNamespace(header=_header(at), tactiles=tactiles)
            write("/rh/tactile", "BiotacAll", at + faults.late_ns, message)
        executed = SimpleNamespace(
            header=_header(release), grasp_id=faults.executed, achieved=POSE, start=_stamp(start + 2 * NS),
            contact=_stamp(contact), release=_stamp(release), success=True,
        )  # fmt: skip
        write("/foretouch/executed_grasp", "ExecutedGrasp", release, executed)


def imported(tmp_path: Path, faults: Faults, **topics: Any) -> tuple[ImportResult, list[SampleRecord]]:
    write_topics(tmp_path / "bag", faults)
    result = import_samples(tmp_path / "bag", tmp_path / "ds", identity=IDENTITY, topics=BagTopics(**topics))
    return result, list(open_samples(tmp_path / "ds").records(discarded=True))


def test_named_topics_become_samples_by_id_and_header_stamps_also_of_a_replay(tmp_path: Path) -> None:
    result, (touched, other) = imported(tmp_path, Faults(), object="sponge")
    assert (result.samples, result.labelled) == (2, 1)
    assert touched.sample.grasp.id == "a"
    assert [grasp.id for grasp in touched.candidates] == ["b"]
    assert (touched.outcome, touched.sample.object) == ("success", "sponge")
    np.testing.assert_array_equal(touched.sample.touch.e_th, np.arange(24) + 2900)
    np.testing.assert_array_equal(touched.sample.tare.e_mf, np.arange(24) + 3000)
    assert touched.sample.touch.pdc_mf == 1800
    assert touched.pairing_error_ns <= NS // 100
    assert touched.contact_ns == 1_700_000_003 * NS
    assert touched.series.others.keys() == {f"{c}_{f}" for c in ("PAC0", "PAC1", "TAC", "TDC") for f in ("TH", "MF")}
    assert (touched.sample.cloud.xyz == 0).all()
    assert other.sample.touch is None
    assert other.sample.grasp.id == "c"
    assert [report.fault_lines() for report in verify_dataset(tmp_path / "ds")] == [[]]
    # Its grasps hold nine zeros as matrix, and are read from their quaternions.
    faults = Faults(ago_ns=86_400 * NS, late_ns=NS // 2, matrix=np.zeros((3, 3)))
    result, samples = imported(tmp_path / "replay", faults)
    assert (result.samples, result.labelled) == (2, 1)
    assert samples[0].sample.extra["clock_offset_s"] == 0.0
    for one in samples:
        np.testing.assert_array_equal(one.sample.grasp.rotation, TURNED)


def test_what_the_recorder_rejects_is_rejected_with_its_reason(tmp_path: Path) -> None:
    def check(reason: str, faults: Faults) -> None:
        (tmp_path / reason).mkdir()
        result, samples = imported(tmp_path / reason, faults)
        assert (result.left_out[reason], result.labelled) == (1, 0)
        if reason == "no_tactile":
            assert result.left_out["unreadable /rh/tactile"] == 500
        if reason == "pairing_error":  # a cloud whose grasp was rejected becomes a sample without a touch
            assert [one.sample.grasp.id for one in samples] == ["a", "c"]

    cases = [
        ("pairing_error", Faults(hole=True)),
        ("clock_offset", Faults(late_ns=NS // 2)),
        ("cloud_ambiguous", Faults(second_cloud=True)),
        ("bad_grasp", Faults(matrix=np.eye(3))),
        ("grasp_unknown", Faults(executed="stranger")),
        ("no_tactile", Faults(electrodes=19)),
    ]
    every_case(cases, check)


def test_topics_are_checked_and_fingers_chosen_by_their_indices(tmp_path: Path) -> None:
    result, (touched, _) = imported(tmp_path, Faults(), fingers=(0, 3))  # all fingers read the same
    assert (result.labelled, touched.sample.touch is None) == (1, False)
    with pytest.raises(ConfigError, match="'FF' is the thumb already"):
        import_samples(tmp_path / "bag", tmp_path / "other", topics=BagTopics(fingers=(0, 0)))
    supported = r"/foretouch/grasps: holds foretouch_msgs/GraspArray; supported: foretouch_msgs/BiotacAll, sr_robot"
    for topics, rule in (
        (BagTopics(clouds="/nowhere"), "/nowhere: no such topic; known: /foretouch/executed_grasp"),
        (BagTopics(tactile="/foretouch/grasps"), supported),
    ):
        with pytest.raises(FileError, match=rule):
            import_samples(tmp_path / "bag", tmp_path / "other", topics=topics)
