# SPDX-License-Identifier: Apache-2.0
"""What a dataset holds so far."""

from dataclasses import replace
from pathlib import Path

from recording_builders import record, write_dataset

from foretouch.dataset.editing import drop, relabel
from foretouch.dataset.recording.edits import Edit, EditLog, read_edits
from foretouch.ros.recorder.operator import count_outcomes, edited, summarise, summarise_dataset


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
