# SPDX-License-Identifier: Apache-2.0
"""What a dataset holds so far, and what the recording protocol still asks for."""

from dataclasses import replace
from pathlib import Path

from recording_builders import record, write_dataset

from foretouch.dataset.editing import drop, relabel
from foretouch.dataset.recording.edits import Edit, EditLog, read_edits
from foretouch.ros.recorder.operator import count_outcomes, edited, suggest, summarise, summarise_dataset


def test_counts_are_by_object_and_outcome_with_the_edits_applied_and_earlier_sessions_too(tmp_path: Path) -> None:
    write_dataset(tmp_path / "set", 3)
    drop(tmp_path / "set", ["ball/000001"])
    relabel(tmp_path / "set", ["ball/000002"], "cup")
    grasps = summarise_dataset(tmp_path / "set")
    grasps["can/000004"] = summarise(replace(record(4, "can"), outcome="unknown"))
    grasps["can/000005"] = summarise(record(5, "can", labelled=False))
    log = read_edits(tmp_path / "set")
    counts = count_outcomes(edited(grasps, log).values(), ["sponge"])
    assert counts == {"sponge": {}, "ball": {"dropped": 1, "success": 1}, "cup": {"success": 1}, "can": {"unknown": 1}}
    log = EditLog(
        (*log.edits, Edit(action="outcome", ids=("can/000004",), text="failure"), Edit(action="undo", edit=1))
    )
    counts = count_outcomes(edited(grasps, log).values())
    assert (counts["can"], counts["ball"]) == ({"failure": 1}, {"success": 2})
    assert summarise_dataset(tmp_path / "nothing") == {}


def test_the_protocol_asks_for_a_tare_ten_grasps_with_a_repeat_the_next_object_and_names_few_grasps() -> None:
    plan, grasps = ("can", "cup"), []
    for number in range(1, 11):
        steps = suggest(count_outcomes(grasps, plan), "can", number - 1, tared=number > 1)
        assert any("tare: keep" in step for step in steps) == (number == 1)
        wanted = (
            f"grasp {number} of 10 on can" if number < 10 else "repeat the last grasp; leave the object where it is"
        )
        assert wanted in steps
        grasps.append(summarise(record(number, "can")))
    assert suggest(count_outcomes(grasps, plan), "can", 10, tared=True) == [
        "10 grasps on can in this visit: next object",
        "few grasps: cup 0",
    ]
    assert suggest(count_outcomes(grasps[:3]), "can", 3, tared=True) == ["grasp 4 of 10 on can"]
    dropped = [*grasps[:-1], grasps[-1]._replace(outcome="dropped")]
    assert "few grasps: can 9" in suggest(count_outcomes(dropped), "cup", 0, tared=True)
