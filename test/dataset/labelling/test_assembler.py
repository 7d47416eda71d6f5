# SPDX-License-Identifier: Apache-2.0
"""Messages in, samples or reasons out, without ROS."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pair_builders import SECOND, interval, stream

from foretouch.cloud.messages import cloud_fields, decode_objects
from foretouch.dataset.labelling.assembler import AssemblerConfig, SampleAssembler
from foretouch.dataset.labelling.buffers import SeenObjects
from foretouch.dataset.labelling.cut import PairingConfig
from foretouch.dataset.labelling.matcher import Label, RejectedGrasp
from foretouch.dataset.recordings.sample_codec import Definitions
from foretouch.errors import CloudError
from foretouch.tactile.messages.table import TactileReader, TactileReading
from foretouch.types import Cloud

STORE = Definitions().store
READER = TactileReader(lambda one: TactileReading(one.stamp_ns, one.counts, one.others))


def stamp(time_ns: int) -> SimpleNamespace:
    return SimpleNamespace(sec=time_ns // SECOND, nanosec=time_ns % SECOND)


def point(x: float, y: float, z: float) -> SimpleNamespace:
    return SimpleNamespace(x=x, y=y, z=z)


def grasp(name: str, **changes: Any) -> SimpleNamespace:
    pose = SimpleNamespace(orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0))
    fields = {"id": name, "object_id": "", "g1": point(0.1, 0, 1), "g2": point(-0.1, 0, 1), "pose": pose}
    return SimpleNamespace(**{**fields, "rotation": np.eye(3).ravel(), "score": 0.5, **changes})


class Session:
    """An assembler that has received all readings of so many grasps."""

    def __init__(self, grasps: int, **config: Any) -> None:
        self.assembler = SampleAssembler(AssemblerConfig(pairing=PairingConfig(kept_s=1e3), **config), READER)
        for reading in stream(grasps):
            self.assembler.add_tactile(reading, received_ns=reading.received_ns, now_s=0.0)

    def plan(self, number: int, *grasps: SimpleNamespace, frame_id: str = "camera") -> None:
        at = interval(number).start - SECOND // 2
        self.look(number, at)
        self.assembler.matcher.add_plan(at, frame_id, grasps or [grasp(f"g-{number}"), grasp(f"g-{number} second")])

    def look(self, number: float, at: int) -> None:
        """Add the cloud of a grasp, taken at a time [ns]."""
        rgb = np.full((5, 3), [1, 2, at % 251], np.uint8)
        message = cloud_fields(Cloud(np.full((5, 3), number + 1, np.float32), rgb, "camera", at))
        data = bytes(STORE.serialize_cdr(message, "sensor_msgs/msg/PointCloud2"))
        seen = SeenObjects.of_message(data, lambda: decode_objects(message))
        self.assembler.add("cloud", seen, received_ns=0, now_s=0.0)

    def table(
        self, number: int, coef: list[float], frame_id: str = "camera", status: int = 0, late_ns: int = 0
    ) -> None:
        """Add the message about the table under the cloud of a grasp."""
        header = SimpleNamespace(stamp=stamp(interval(number).start - SECOND // 2 + late_ns), frame_id=frame_id)
        message = SimpleNamespace(header=header, plane=SimpleNamespace(coef=np.array(coef)), status=status)
        self.assembler.add("table", message, received_ns=0, now_s=0.0)

    def report(self, number: int, name: str | None = None, *, success: bool = True, touched: bool = True) -> None:
        when = interval(number)
        times = {key: stamp(getattr(when, key) if touched else 0) for key in ("start", "contact", "release")}
        message = SimpleNamespace(grasp_id=name or f"g-{number}", success=success, **times)
        self.assembler.add("executed", message, received_ns=0, now_s=0.0)

    def results(self) -> list[Any]:
        return self.assembler.poll(10.0, ending=True)

    def reasons(self) -> list[str]:
        """Of the executed grasps."""
        return [
            result.reason if isinstance(result, RejectedGrasp) else "recorded"
            for result in self.results()
            if isinstance(result, RejectedGrasp) or result.touch is not None
        ]


def test_reasons_of_messages_that_cannot_become_samples() -> None:
    session = Session(7)
    session.plan(0, grasp("g-0"), grasp("bad", rotation=np.full(9, 2.0)))
    session.plan(1, grasp("g-1"), frame_id="base")
    session.plan(2, grasp("g-2", g2=point(0.1, 0, 1)))
    for number in (3, 4, 5):
        session.plan(number)
    at = interval(6).start - SECOND // 2
    session.look(np.nan, at)
    session.assembler.matcher.add_plan(at, "camera", [grasp("g-6")])
    for number in (0, 1, 2, 3, 5, 6):
        session.report(number)
    session.report(4, success=False, touched=False)
    results = session.results()
    note = results[0].note
    assert note.startswith("candidate bad left out: rotation: "), note
    assert [candidate.id for candidate in results[0].candidates] == []
    reasons = [getattr(result, "reason", "recorded") for result in results[1:]]
    assert reasons == ["frame_differs", "bad_grasp", "recorded", "recorded", "object_unknown", "grasp_failed"]


def test_a_failed_grasp_is_a_sample_unless_only_successes_count_and_later_plans_replace_none() -> None:
    for only, expected in ((False, ["recorded", "overlap"]), (True, ["grasp_failed", "overlap"])):
        session = Session(1, successes_only=only)
        session.plan(0)
        session.report(0, success=False)
        session.report(0, "g-0 second")
        assert session.reasons() == expected
    session = Session(1)  # grasps planned later on the same cloud do not replace those before
    session.plan(0, grasp("first"))
    session.plan(0, grasp("second"))
    session.report(0, "first")
    (one,) = session.results()
    assert one.grasp.id == "first"
    assert [other.id for other in one.candidates] == ["second"]


def test_other_clouds_become_samples_without_a_touch_at_most_one_in_a_time() -> None:
    session = Session(4, unlabelled_s=4.0)
    for number in range(4):
        session.plan(number)
    session.report(1)
    session.look(9, interval(9).start)  # without grasps
    touched, *others = session.results()
    assert touched.grasp.id == "g-1"
    assert [other.grasp.id for other in others] == ["g-0", "g-2"]  # 6 s apart
    assert all(other.touch is None for other in others)
    assert session.assembler.clouds_without_grasps == 1


@pytest.mark.parametrize("kept", [True, False])
def test_samples_keep_the_colours_of_their_points_unless_the_session_does_not_want_them(kept: bool) -> None:
    session = Session(2, unlabelled_s=0.0, colours=kept)
    for number in (0, 1):
        session.plan(number)
    session.report(1)
    samples = session.results()
    assert len(samples) == 2
    for sample in samples:
        expected = [[1, 2, sample.cloud.stamp_ns % 251]] * 5
        assert (None if sample.cloud.rgb is None else sample.cloud.rgb.tolist()) == (expected if kept else None)


def test_the_table_of_a_sample_is_that_of_a_message_with_the_stamp_and_in_the_frame_of_its_cloud() -> None:
    session = Session(6, unlabelled_s=0.0)
    down = [0.0, 0.0, -1.0, 1.2]
    told: list[dict[str, Any]] = [
        {},
        {"frame_id": "base"},
        {"status": 14},  # none was found
        {"coef": [0.0] * 4},
        {"late_ns": 1},
    ]
    for number, changes in enumerate(told):
        session.plan(number)
        session.report(number)
        session.table(number, **{"coef": down, **changes})
    session.plan(5)
    session.table(5, coef=[0.6, 0.0, -0.8, 1.0])
    *others, unlabelled = [None if one.table is None else one.table.coefficients.tolist() for one in session.results()]
    assert others == [down, None, None, None, None]
    assert unlabelled == [0.6, 0.0, -0.8, 1.0]
    with pytest.raises(CloudError, match="normal has zero length"):
        session.table(0, coef=[0.0, 0.0, 0.0, 1.0])


def test_labels_and_contacts_without_a_report() -> None:
    session = Session(0, watch_sensors=True)
    for number in (0, 1):
        session.plan(number)
    label = Label(grasp_id="g-1", object="cup", discard=True, outcome="failure")
    assert session.assembler.matcher.add_label(label, 0.0)[1] == "waits for its contact"
    for reading in stream(2):
        session.assembler.add_tactile(reading, received_ns=reading.received_ns, now_s=0.0)
    assert session.assembler.sensor_states(0.5) == {"TH": "alive", "MF": "alive", "camera": "alive"}
    (one,) = session.assembler.poll(3.0)
    assert one.outcome == "failure"  # type: ignore[union-attr]
    assert (one.object, one.flags) == ("cup", ("detected_interval", "discarded"))  # type: ignore[union-attr]
    assert set(session.assembler.sensor_states(9.0).values()) == {"no data"}


def test_readings_whose_stamps_jitter_are_waited_for() -> None:
    """A sample does not depend on when it is polled, as long as stamps jitter by less than half the guard."""
    windows = []
    for polled_always in (False, True):
        session = Session(0)
        session.plan(0)
        session.report(0)
        rng, samples = np.random.default_rng(0), []
        for reading in stream(1):
            moved = replace(reading, stamp_ns=reading.stamp_ns + int(rng.uniform(-0.04, 0.04) * SECOND))
            session.assembler.add_tactile(moved, received_ns=reading.received_ns, now_s=0.0)
            samples += session.assembler.poll(0.0) if polled_always else []
        (one,) = samples or session.assembler.poll(0.0)
        windows.append(one.series)
    np.testing.assert_array_equal(windows[0].stamps_ns, windows[1].stamps_ns)
    np.testing.assert_array_equal(windows[0].counts, windows[1].counts)
