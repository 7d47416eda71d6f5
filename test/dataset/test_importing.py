# SPDX-License-Identifier: Apache-2.0
"""Bags with named topics become the samples that the recorder would have made of their messages."""

from pathlib import Path
from typing import Any

import depth_builders
import numpy as np
import pytest
from every_case import every_case
from recording_builders import IDENTITY
from topic_builders import NS, TURNED, Faults, write_topics

from benchmarks.random_scenes import random_scene
from foretouch.cloud.segmentation.segment import segment
from foretouch.dataset.formats import open_samples
from foretouch.dataset.importing import BagTopics, WriteResult, import_samples
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.errors import FileError
from foretouch.tactile.messages.table import TactileConfig
from foretouch.types import Cloud, Sample


def imported(tmp_path: Path, faults: Faults, **topics: Any) -> tuple[WriteResult, list[Sample]]:
    write_topics(tmp_path / "bag", faults)
    result = import_samples(tmp_path / "bag", tmp_path / "ds", identity=IDENTITY, topics=BagTopics(**topics))
    return result, list(open_samples(tmp_path / "ds").with_discarded())


def test_named_topics_become_samples_by_id_and_header_stamps_also_of_a_replay(tmp_path: Path) -> None:
    result, (touched, other) = imported(tmp_path, Faults(), object="sponge")
    assert (result.samples, result.labelled) == (2, 1)
    assert touched.grasp.id == "a"
    assert [grasp.id for grasp in touched.candidates] == ["b"]
    assert (touched.outcome, touched.object) == ("success", "sponge")
    np.testing.assert_array_equal(touched.touch["E_TH"], np.arange(24) + 2900)
    np.testing.assert_array_equal(touched.tare["E_MF"], np.arange(24) + 3000)
    assert touched.touch["PDC_MF"][0] == 1800
    assert touched.pairing_error_ns <= NS // 100
    assert touched.contact_ns == 1_700_000_003 * NS
    assert touched.series.others.keys() == {f"{c}_{f}" for c in ("PAC0", "PAC1", "TAC", "TDC") for f in ("TH", "MF")}
    assert (touched.cloud.xyz == 1).all()
    assert other.touch is None
    assert other.grasp.id == "c"
    assert [report.fault_lines() for report in verify_dataset(tmp_path / "ds")] == [[]]
    # Its grasps hold nine zeros as matrix, and are read from their quaternions.
    faults = Faults(ago_ns=86_400 * NS, late_ns=NS // 2, matrix=np.zeros((3, 3)))
    result, samples = imported(tmp_path / "replay", faults)
    assert (result.samples, result.labelled) == (2, 1)
    assert samples[0].extra["clock_offset_s"] == 0.0
    for sample in samples:
        np.testing.assert_array_equal(sample.grasp.rotation, TURNED)


def test_a_sample_holds_the_table_of_the_message_about_its_cloud(tmp_path: Path) -> None:
    table = (0.0, -0.6, -0.8, 1.1)
    result, (touched, other) = imported(tmp_path, Faults(table=table))
    assert touched.table.coefficients.tolist() == list(table)
    assert other.table is None  # four zeros say that none was found
    assert result.tables == 1
    named = import_samples(tmp_path / "bag", tmp_path / "other", topics=BagTopics(table="/nowhere"))
    assert (named.samples, named.tables) == (2, 0)


def test_what_the_recorder_rejects_is_rejected_with_its_reason(tmp_path: Path) -> None:
    def check(reason: str, faults: Faults) -> None:
        (tmp_path / reason).mkdir()
        result, samples = imported(tmp_path / reason, faults)
        assert (result.left_out[reason], result.labelled) == (1, 0)
        if reason == "no_tactile":
            assert result.left_out["unreadable /rh/tactile"] == 500
        if reason == "pairing_error":  # a cloud whose grasp was rejected becomes a sample without a touch
            assert [sample.grasp.id for sample in samples] == ["a", "c"]

    cases = [
        ("pairing_error", Faults(hole=True)),
        ("clock_offset", Faults(late_ns=NS // 2)),
        ("cloud_ambiguous", Faults(second_cloud=True)),
        ("bad_grasp", Faults(matrix=np.eye(3))),
        ("grasp_unknown", Faults(executed="stranger")),
        ("no_tactile", Faults(electrodes=19)),
    ]
    every_case(cases, check)


def test_topics_are_checked_and_fingers_chosen_by_their_names(tmp_path: Path) -> None:
    result, (touched, _) = imported(tmp_path, Faults(), tactile_config=TactileConfig(thumb="FF", middle="RF"))
    assert (result.labelled, touched.touch is None) == (1, False)  # all fingers read the same
    supported = r"/foretouch/grasps: holds foretouch_msgs/GraspArray; supported: foretouch_msgs/BiotacAll, sr_robot"
    for topics, rule in (
        (BagTopics(clouds="/nowhere"), "/nowhere: no such topic; known: /foretouch/executed_grasp"),
        (BagTopics(tactile="/foretouch/grasps"), supported),
    ):
        with pytest.raises(FileError, match=rule):
            import_samples(tmp_path / "bag", tmp_path / "other", topics=topics)


@pytest.mark.parametrize("named", [False, True])
def test_depth_images_are_segmented_and_the_object_of_a_grasp_is_the_nearest(tmp_path: Path, named: bool) -> None:
    rng = np.random.default_rng(6)
    image = random_scene(rng, 424, 240, n_objects=3).render(rng, 0.001)
    k = image.K.ravel()
    info = depth_builders.info(height=240, width=424, k=k, p=np.insert(k, [3, 6, 9], 0.0))
    topic, colours = "/camera/depth/image_raw", "/camera/color/image_raw"

    def seen(at_ns: int) -> dict[str, tuple[str, Any]]:
        info.header = head = depth_builders.header("camera", at_ns)
        message = depth_builders.image(image.depth_mm, "16UC1", header=head)
        message.data = np.frombuffer(message.data, np.uint8)
        colour = depth_builders.image(image.rgb, "rgb8", header=head, step=3 * 424)
        colour.data = np.frombuffer(colour.data, np.uint8)
        kinds = {
            topic: ("Image", message),
            colours: ("Image", colour),
            "/camera/depth/camera_info": ("CameraInfo", info),
        }  # after its first image
        return {name: (f"sensor_msgs/msg/{kind}", content) for name, (kind, content) in kinds.items()}

    write_topics(tmp_path / "bag", seen=seen)
    topics = BagTopics(**({"clouds": topic} if named else {}))
    result = import_samples(tmp_path / "bag", tmp_path / "ds", identity=IDENTITY, topics=topics)
    assert (result.samples, result.labelled, sum(result.left_out.values())) == (2, 1, 0)
    scene = segment(Cloud.from_depth(image.depth_mm, image.K))
    objects = scene.objects
    assert len(objects) == 3
    middle = np.array([0.0, 0.0, 1.0])  # of the contacts
    nearest = min(objects, key=lambda one: float(np.linalg.norm(one.cloud.xyz - middle, axis=1).min()))
    for sample in open_samples(tmp_path / "ds").with_discarded():
        np.testing.assert_array_equal(sample.cloud.xyz, nearest.cloud.xyz)
        np.testing.assert_array_equal(sample.cloud.rgb, image.rgb.reshape(-1, 3)[nearest.pixels])
        np.testing.assert_array_equal(sample.table.coefficients, scene.table.coefficients)
