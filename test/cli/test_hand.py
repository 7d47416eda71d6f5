# SPDX-License-Identifier: Apache-2.0
"""`foretouch hand`: lists, checks and draws descriptions of hands."""

import json
from pathlib import Path

import pytest

from foretouch.cli.main import main
from foretouch.grasp.hand import hand_files


def test_list_check_and_show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hand", "list", "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [record["name"] for record in records] == list(hand_files())
    franka = next(record for record in records if record["name"] == "franka_hand")
    assert franka["depth_m"] == [0.046, 0.046]
    assert franka["tool"] == "panda_hand_tcp"
    wrong = tmp_path / "mine.yaml"
    wrong.write_text("name: mine\nopening_m: 0\n", encoding="utf-8")
    assert main(["hand", "check", "franka_hand", str(wrong)]) == 1
    told = capsys.readouterr()
    assert "opening_m: 0.0 is below 0.005" in told.err
    assert "mine.yaml" in told.err
    picture = tmp_path / "hand.png"
    assert main(["hand", "show", "shadow_thumb_middle", "-o", str(picture)]) == 0
    assert picture.stat().st_size > 10_000
