# SPDX-License-Identifier: Apache-2.0
"""What a session holds so far."""

from dataclasses import replace

from recording_builders import record

from foretouch.dataset.recording.edits import Edit, EditLog
from foretouch.ros.recorder.operator import count_outcomes, edited, summarise


def test_counts_are_by_object_and_outcome_with_the_edits_applied() -> None:
    grasps = {f"ball/00000{k}": summarise(record(k, "ball")) for k in (1, 2, 3)}
    grasps["can/000004"] = summarise(replace(record(4, "can"), outcome="unknown"))
    grasps["can/000005"] = summarise(record(5, "can", labelled=False))
    log = EditLog(
        (Edit(action="drop", ids=("ball/000001",)), Edit(action="relabel", ids=("ball/000002",), object="cup"))
    )
    counts = count_outcomes(edited(grasps, log).values(), ["sponge"])
    assert counts == {"sponge": {}, "ball": {"dropped": 1, "success": 1}, "cup": {"success": 1}, "can": {"unknown": 1}}
