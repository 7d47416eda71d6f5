# SPDX-License-Identifier: Apache-2.0
"""The clouds of one camera in their order: what stays from cloud to cloud, and what another setting ends."""

import numpy as np
from scene_builders import scene_cloud

from foretouch.models import History, load_model
from foretouch.pipeline import Pipeline, PipelineResult
from foretouch.stream import Stream, StreamConfig
from foretouch.types import Cloud, Touch

MS = 1_000_000


def clouds(count: int, number: int = 2) -> list[Cloud]:
    """The same scene seen so many times, with other noise and its own stamps."""
    rng = np.random.default_rng(5)
    still = scene_cloud(number)
    made = []
    for k in range(count):
        noisy = still.xyz * (1.0 + rng.normal(0.0, 0.0004, (*still.xyz.shape[:2], 1)))
        made.append(type(still)(noisy.astype(np.float32), None, still.frame_id, (k + 1) * 33 * MS))
    return made


def target(result: PipelineResult) -> str:
    (one,) = result.targets
    return one.target.id


def test_ids_selection_and_held_grasps_outlive_every_setting_that_has_no_part_in_them() -> None:
    stream = Stream(StreamConfig().updated({"grasp_hold": 100.0}, "test"))
    shown = clouds(8)
    first = stream.answer(shown[0])
    other = next(object_.id for object_ in first.scene.objects if object_.id != target(first))
    stream.select(other)
    before = stream.answer(shown[1])
    contacts = before.targets[0].plan.grasps.g1[0]
    for cloud, change in zip(
        shown[2:5], ({"reach.max_width_m": 0.3}, {"segmentation.crop.max_range_m": 3.0}, {}), strict=True
    ):
        stream.configure(stream.config.updated(change, "test"))
        now = stream.answer(cloud)
        assert [object_.id for object_ in now.scene.objects] == [object_.id for object_ in before.scene.objects]
        assert target(now) == other
        assert now.reason == ""
        assert (
            now.targets[0].predictions.flags[0][-1] == "selected" or "selected" in now.targets[0].predictions.flags[0]
        )
        np.testing.assert_array_equal(now.targets[0].plan.grasps.g1[0], contacts)
    stream.configure(stream.config.updated({"grasp.neighbours": 40}, "test"))  # the planner's: it plans anew
    now = stream.answer(shown[5])
    assert target(now) == other
    assert (now.targets[0].plan.grasps.g1[0] != contacts).any()
    stream.configure(stream.config.updated({"target.mode": "nearest", "target.tolerance_m": 0.05}, "test"))
    assert target(stream.answer(shown[6])) == target(first)  # another rule: it decides again


def test_a_selected_object_that_is_gone_is_forgotten_after_a_second() -> None:
    (cloud,), stream = clouds(1), Stream()
    chosen = stream.answer(cloud).scene.objects[-1]
    stream.select(chosen.id)
    xyz = cloud.xyz.reshape(-1, 3).copy()
    xyz[chosen.pixels] = np.nan  # it was taken away
    without = Cloud(xyz.reshape(cloud.xyz.shape), None, cloud.frame_id, cloud.stamp_ns)
    statuses = [stream.answer(without).status for _ in range(31)]
    assert statuses == 30 * ["no_target"] + ["ok"]
    assert stream.note == f"object {chosen.id} is gone; the rule of `target` selects again"
    assert stream.selected == ""


def test_an_answer_is_that_of_the_pipeline_with_ids_made_of_stamp_object_and_rank() -> None:
    (cloud,) = clouds(1)
    config = StreamConfig().updated({"grasp.count": 3, "target.mode": "all"}, "test")
    one, other = Stream(config).answer(cloud), Pipeline(config).run(cloud)
    assert one.status == other.status == "ok"
    assert len(one.targets) > 1
    for mine, theirs in zip(one.targets, other.targets, strict=True):
        np.testing.assert_array_equal(mine.plan.grasps.pose, theirs.plan.grasps.pose)
        np.testing.assert_array_equal(mine.predictions.value, theirs.predictions.value)
        assert mine.plan.grasps.id.tolist() == [
            f"{33 * MS}/{mine.target.id}/{rank}" for rank in range(len(mine.plan.grasps))
        ]


def test_readings_of_the_hand_are_adapted_to_from_the_next_cloud_on() -> None:
    model = load_model()
    history = History(model)
    stream, shown = Stream(history=history), clouds(2)
    before = stream.answer(shown[0]).targets[0]
    rest = model.calibration.rest
    history.touched(before.target, before.plan.grasps[0], Touch(rest + 30.0, model.sensor.channels), stamp_ns=40 * MS)
    after = stream.answer(shown[1]).targets[0]
    assert (before.predictions.reference[0], after.predictions.reference[0]) == ("none", "touches")
    assert (after.predictions.value != before.predictions.value).any()


def test_status_and_reason_of_a_result_are_those_of_the_first_grasp_where_all_are_refused() -> None:
    config = StreamConfig().updated({"reach.max_width_m": 0.001}, "test")
    result = Stream(config).answer(clouds(1)[0])
    assert result.targets[0].predictions
    assert result.status == "bad_grasp"
    assert "more than max_width_m 0.001" in result.reason
