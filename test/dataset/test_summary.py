# SPDX-License-Identifier: Apache-2.0
"""What a dataset holds so far, and what the recording protocol still asks for."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from recording_builders import record, write_dataset

from foretouch.dataset.editing import drop, relabel
from foretouch.dataset.recording.edits import Edit, EditLog, read_edits
from foretouch.dataset.summary import count_outcomes, edited, suggest, summarise, summarise_dataset
from foretouch.types import Cloud, Grasp

GRID = np.stack(np.meshgrid(np.linspace(-0.05, 0.05, 21), np.linspace(-0.1, 0.1, 21), [0.8]), -1).reshape(-1, 3)
CLOUD = Cloud(GRID.astype(np.float32), None, "camera", 1)


def grasp(x: float, y: float, width: float, name: str = "g") -> Grasp:
    half = np.array([width / 2.0, 0.0, 0.0])
    middle = np.array([x, y, 0.8])
    return Grasp(middle + half, middle - half, np.eye(3), 1.0, name, "1")


def sample(number: int, name: str, *grasps: Grasp, day: int = 0, labelled: bool = True, **changes: Any) -> Any:
    made = record(number, name, labelled=labelled)
    grasps = grasps or (grasp(0.0, 0.0, 0.045),)
    own = replace(made.sample, cloud=CLOUD, grasp=grasps[0], stamp_ns=(20_000 + day) * 86_400 * 10**9 + 43_200 * 10**9)
    return replace(made, sample=own, candidates=tuple(grasps[1:]), **changes)


def test_counts_are_by_object_and_outcome_with_the_edits_applied_and_earlier_sessions_too(tmp_path: Path) -> None:
    write_dataset(tmp_path / "set", 3)
    drop(tmp_path / "set", ["ball/000001"])
    relabel(tmp_path / "set", ["ball/000002"], "cup")
    grasps = summarise_dataset(tmp_path / "set")
    grasps["can/000004"] = summarise(sample(4, "can", outcome="unknown"))
    grasps["can/000005"] = summarise(sample(5, "can", labelled=False))
    log = read_edits(tmp_path / "set")
    counts = count_outcomes(edited(grasps, log).values(), ["sponge"])
    assert counts == {"sponge": {}, "ball": {"dropped": 1, "success": 1}, "cup": {"success": 1}, "can": {"unknown": 1}}
    log = EditLog(
        (*log.edits, Edit(action="outcome", ids=("can/000004",), text="failure"), Edit(action="undo", edit=1))
    )
    counts = count_outcomes(edited(grasps, log).values())
    assert (counts["can"], counts["ball"]) == ({"failure": 1}, {"success": 2})
    assert summarise_dataset(tmp_path / "nothing") == {}


def test_the_protocol_asks_for_a_tare_ten_grasps_with_a_repeat_the_next_object_and_another_day() -> None:
    plan, grasps = ("can", "cup"), []
    for number in range(1, 11):
        steps = suggest(grasps, plan, "can", number - 1, tared=number > 1)
        assert any("tare: keep" in step for step in steps) == (number == 1)
        wanted = (
            f"grasp {number} of 10 on can" if number < 10 else "repeat the last grasp; leave the object where it is"
        )
        assert wanted in steps
        grasps.append(summarise(sample(number, "can")))
    assert suggest(grasps, plan, "can", 10, tared=True) == [
        "10 grasps on can in this visit: next object",
        "few grasps: cup 0",
    ]
    assert suggest(grasps[:3], (), "can", 3, tared=True) == ["grasp 4 of 10 on can"]
    grasps += [summarise(sample(number, "cup")) for number in range(11, 21)]
    assert "again on another day: can, cup" in suggest(grasps, plan, "cup", 0, tared=True)
    grasps.append(summarise(sample(21, "can", day=1)))
    assert "again on another day: cup" in suggest(grasps, plan, "cup", 0, tared=True)
    dropped = [*grasps[:-1], grasps[-1]._replace(outcome="dropped")]
    assert "again on another day: can, cup" in suggest(dropped, plan, "cup", 0, tared=True)


def test_widths_and_places_that_were_planned_but_not_touched_are_named_as_the_camera_sees_them() -> None:
    others = (grasp(0.0, 0.09, 0.045), grasp(-0.045, 0.0, 0.045), grasp(0.0, 0.0, 0.072))
    grasps = [summarise(sample(1, "can", grasp(0.0, -0.09, 0.045), *others))]
    wanted = "planned on can, not touched yet: 70–80 mm, bottom, left, middle"
    assert wanted in suggest(grasps, (), "can", 0, tared=True)
    grasps.append(summarise(sample(2, "can", grasp(0.0, 0.0, 0.072))))
    grasps.append(summarise(sample(3, "can", grasp(0.0, 0.09, 0.045), labelled=False)))
    assert "planned on can, not touched yet: bottom, left" in suggest(grasps, (), "can", 0, tared=True)
