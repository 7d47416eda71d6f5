# SPDX-License-Identifier: Apache-2.0
"""The operator's actions over real DDS, by service: in the log of the dataset, undone, refused, or waiting."""

import errno
import os
import time
from pathlib import Path

import pytest
from pair_builders import level
from robot_builders import MS, accounts, outcomes, start
from std_srvs.srv import SetBool, Trigger

from foretouch.dataset.recordings.edits import read_edits
from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.ros.messages.conversions import stamp_to_msg
from foretouch_msgs.srv import LabelGrasp

pytestmark = pytest.mark.ros

SUCCESS, FAILURE = LabelGrasp.Request.SUCCESS, LabelGrasp.Request.FAILURE


def samples(path):
    return list(RecordedDataset(path))


@pytest.fixture
def edit(graph):
    def call(**fields):
        answer = graph.call(LabelGrasp, "edit_grasp", LabelGrasp.Request(**fields))
        return answer.success, answer.message

    return call


def test_grasps_are_labelled_relabelled_noted_dropped_and_undone_by_services(graph, tmp_path, edit):
    node, robot, _ = start(graph, tmp_path / "set")
    assert edit(outcome=SUCCESS) == (False, "no grasp was recorded in this session yet")
    for number in range(3):
        robot.record(f"g-{number}", number)
    assert edit(outcome=FAILURE) == (True, "can/000003: failure")
    assert edit(grasp_id="g-0", object="cup", note="tilted") == (True, "can/000001: is cup; cup/000001: note tilted")
    assert edit(grasp_id="g-1", discard=True) == (True, "can/000002: dropped")
    assert edit(grasp_id="g-1", outcome=SUCCESS) == (False, "can/000002: is dropped; undo that first")
    assert edit(grasp_id="g-7", outcome=SUCCESS)[1].startswith("grasp g-7: is not one of the recorded grasps")
    assert edit() == (False, "the request changes nothing: set object, outcome, note or discard")
    assert "is not a plain name" in edit(object="../x")[1]
    assert [(sample.id, sample.outcome, sample.note, sample.flags) for sample in samples(tmp_path / "set")] == [
        ("cup/000001", "success", "tilted", ()),
        ("can/000002", "success", "", ("discarded",)),
        ("can/000003", "failure", "", ()),
    ]
    graph.until(lambda: node.session_status().operator.grasps["can"] == {"dropped": 1, "failure": 1})
    undone = [graph.call(Trigger, "undo_edit").message for _ in range(4)]
    assert undone[0] == "can/000002: undone: dropped"
    assert undone[1] == "can/000001: undone: note tilted"
    nothing = graph.call(Trigger, "undo_edit")
    assert (nothing.success, nothing.message) == (False, "nothing to undo in this session")
    node.end()
    assert [(sample.id, sample.outcome, sample.flags) for sample in samples(tmp_path / "set")] == [
        (f"can/00000{number}", "success", ()) for number in (1, 2, 3)
    ]
    assert all(stamped.stamp_ns > 0 for stamped in read_edits(tmp_path / "set").edits)
    assert edit(outcome=SUCCESS) == (False, "nothing is being recorded")
    node.begin(str(tmp_path / "set"), "can")
    assert graph.call(Trigger, "undo_edit").message == "nothing to undo in this session"


def test_the_next_object_names_the_grasps_that_begin_after_it_and_undoing_it_renames_them(graph, tmp_path):
    node, robot, _ = start(graph, tmp_path / "set", objects=["can", "cup"])
    robot.record("g-0", 0)
    following = lambda name="": graph.call(LabelGrasp, "next_object", LabelGrasp.Request(object=name)).message  # noqa: E731
    assert following() == "on the table: cup"
    time.sleep(0.8)  # the robot stamps its grasps from 0.7 s ago on
    robot.record("g-1", 1)
    assert following("cup") == "cup is on the table already"
    assert following() == "on the table: object-1"
    graph.until(lambda: node.session_status().operator.object == "object-1")
    graph.call(Trigger, "undo_edit")
    assert graph.call(Trigger, "undo_edit").message == "on the table: can, also in the 1 grasps since"
    time.sleep(0.8)
    robot.record("g-2", 2)
    node.end()
    assert [sample.id for sample in samples(tmp_path / "set")] == ["can/000001", "can/000002", "can/000003"]
    assert RecordedDataset(tmp_path / "set").as_recorded(1).id == "cup/000002"


def test_what_is_pressed_during_a_grasp_is_for_that_grasp_and_is_told_if_it_makes_no_sample(graph, tmp_path, edit):
    node, robot, _ = start(graph, tmp_path / "set", pairing__wait_s=0.5)
    robot.record("g-0", 0)
    times = {"start": stamp_to_msg(robot.now), "contact": stamp_to_msg(robot.now + 50 * MS)}
    times["release"] = stamp_to_msg(robot.now + 2_000 * MS)  # its readings are still to come
    robot.see("g-1")
    graph.until(lambda: accounts(node.status())["grasps"].written == robot.sent["grasps"])
    robot.report("g-1", times)
    graph.until(lambda: node._session._assembler.matcher.pending)
    waits = "failure: waits for the grasp that is being recorded"
    assert edit(outcome=FAILURE) == (True, waits)
    assert edit(note="odd") == (True, "note odd: waits for the grasp that is being recorded")
    assert graph.call(Trigger, "undo_edit").message == "undone: note odd"
    graph.until(lambda: sum(outcomes(node.status()).values()) == 2)  # without readings it is rejected
    graph.until(lambda: [reply.done for reply in node.session_status().operator.replies][-1:] == [False])
    assert node.session_status().operator.replies[-1].text.startswith("not done: failure: ")
    assert edit(grasp_id="g-1", outcome=SUCCESS)[1].startswith("grasp g-1: no sample: ")
    assert [sample.outcome for sample in samples(tmp_path / "set")] == ["success"]
    robot.now += 3_000 * MS
    times = robot.grasp("g-2", 2, tell=False)
    with node._session._assembler_lock:  # before the session gets to complete it
        robot.report("g-2", times)
        time.sleep(0.3)
    graph.until(lambda: node._session._assembler.matcher.pending or node.status().samples == 2)
    edit(outcome=FAILURE)
    graph.until(lambda: node.status().samples == 2)
    graph.until(lambda: samples(tmp_path / "set")[-1].outcome == "failure")


def test_a_pause_records_nothing_counts_what_it_leaves_out_and_ends(graph, tmp_path):
    node, robot, _ = start(graph, tmp_path / "set")
    robot.record("g-0", 0)
    pause = lambda on: graph.call(SetBool, "pause_recording", SetBool.Request(data=on)).message  # noqa: E731
    assert pause(True) == "paused: nothing is recorded"
    assert pause(True) == "paused already"
    graph.until(lambda: node.reported().values["phase"] == "paused")
    written = accounts(node.status())["/rh/tactile"].written
    robot.grasp("g-1", 1)
    graph.until(lambda: sum(topic.received for topic in node.status().topics) == sum(robot.sent.values()))
    graph.until(lambda: not any(topic.waiting for topic in node.status().topics))  # what waits is not yet dropped
    assert (pause(False), pause(False)) == ("recording goes on", "is being recorded already")
    graph.until(lambda: not node.session_status().operator.paused)
    robot.record("g-2", 2)
    node.end()
    assert accounts(node.status())["/rh/tactile"].written == written + 75
    assert [sample.grasp.id for sample in samples(tmp_path / "set")] == ["g-0", "g-2"]
    (report,) = verify_dataset(tmp_path / "set")
    assert report.counts.topics["/rh/tactile"].dropped == {"paused": 75}
    for counts in report.counts.topics.values():
        assert counts.pending == 0


def test_an_action_on_a_full_disk_is_not_done_and_is_told_and_can_be_repeated_until_the_session_has_ended(
    graph, tmp_path, edit, monkeypatch
):
    node, robot, _ = start(graph, tmp_path / "set", writing__min_free_mb=0.0)
    robot.record("g-0", 0)
    real, full = os.fsync, [True]

    def fsync(fd):
        if full[0] and Path(f"/proc/self/fd/{fd}").readlink().name == "edits.jsonl":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(fd)

    monkeypatch.setattr(os, "fsync", fsync)
    done, text = edit(outcome=FAILURE)
    assert (done, text.endswith("edits.jsonl: No space left on device")) == (False, True)
    graph.until(lambda: f"not done: {text}" in [reply.text for reply in node.session_status().operator.replies])
    assert (node.recording, samples(tmp_path / "set")[0].outcome) == (True, "success")
    assert edit(outcome=SUCCESS)[0] is False
    full[0] = False
    assert edit(outcome=FAILURE) == (True, "can/000001: failure")
    assert samples(tmp_path / "set")[0].outcome == "failure"
    node._session.writer.config = node._session.writer.config.replace(min_free_mb=1e9)
    robot.feel(level(0), 30)
    graph.until(lambda: not node.recording)
    done, text = edit(outcome=SUCCESS)
    assert (done, text.startswith("nothing is being recorded: "), "disk almost full" in text) == (False, True, True)
    assert len(read_edits(tmp_path / "set").edits) == 1
