# SPDX-License-Identifier: Apache-2.0
"""`foretouch hand`: lists, checks and draws descriptions of hands."""

import json
from pathlib import Path

import pytest

from foretouch.cli.main import main
from foretouch.grasp.hand import hand_files


@pytest.mark.slow
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


def _block(low: tuple[float, float, float], high: tuple[float, float, float]) -> str:
    """The OBJ of a block."""
    ends = [low, high]
    corners = [f"v {ends[a][0]} {ends[b][1]} {ends[c][2]}" for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    faces = ["f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"]
    return "\n".join([*corners, *faces])


def test_the_boxes_are_compared_with_a_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A body of the Franka Hand that is 5 mm longer than its box: the end is outside by as much, in any unit."""
    pytest.importorskip("trimesh", reason="needs the extra lab")
    picture = tmp_path / "over.png"
    for unit, scale in (("m", 1.0), ("mm", 1000.0)):
        low, high = ((-0.03, -0.1, -0.111), (0.03, 0.105, -0.046))
        text = _block(*(tuple(scale * value for value in end) for end in (low, high)))
        (tmp_path / "body.obj").write_text(text, encoding="utf-8")
        command = ["hand", "check", "franka_hand", "--mesh", str(tmp_path / "body.obj"), "--unit", unit, "--json"]
        assert main([*command, "-o", str(picture)]) == 0
        record = json.loads(capsys.readouterr().out)
        (link,) = record["links"]
        assert (link["link"], link["box"], link["part"]) == ("body", "body", "palm")
        assert record["farthest_mm"] == link["farthest_mm"] == 5.0
        assert 0.0 < link["outside"] < 0.2
    assert picture.stat().st_size > 10_000
    assert main(["hand", "check", "franka_hand", "--mesh", str(tmp_path / "body.obj")]) == 1
    assert "body.obj: spans 205 m: is it in millimetres? --unit mm" in capsys.readouterr().err


def test_the_boxes_are_compared_with_a_urdf_in_the_described_posture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One finger of the Franka Hand on its slide: inside of its boxes where the joint fits the width, else beside them."""
    pytest.importorskip("yourdfpy", reason="needs the extra urdf")
    urdf = tmp_path / "hand.urdf"
    urdf.write_text(
        """<robot name="hand"><link name="tcp"/><link name="left"><collision><origin xyz="0 0.0075 -0.0185"/><geometry>
<box size="0.018 0.015 0.05"/></geometry></collision></link><joint name="slide" type="prismatic"><parent link="tcp"/><child link="left"/>
<axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="1" velocity="1"/></joint></robot>""",
        encoding="utf-8",
    )
    command = ["hand", "check", "franka_hand", "--urdf", str(urdf), "--link", "tcp", "--width", "0.04", "--json"]
    for value, farthest_mm in (("0.02", 0.0), ("0.03", 10.0)):
        assert main([*command, "--joints", f"slide={value}"]) == 0
        assert json.loads(capsys.readouterr().out)["farthest_mm"] == farthest_mm
    assert main(command[:5]) == 1
    assert "link: 'panda_hand_tcp' is not one of tcp, left" in capsys.readouterr().err


def test_options_of_a_comparison_that_have_no_effect_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words, line in (
        (["franka_hand", "--width", "0.02", "-o", "a.png"], "--width, --out: needs --mesh or --urdf"),
        (["franka_hand", "--mesh", "a.obj", "--link", "tcp"], "--link: needs --urdf"),
        (["franka_hand", "--urdf", "a.urdf", "--unit", "mm"], "--unit: is for --mesh"),
        (["franka_hand", "robotiq_2f85", "--mesh", "a.obj"], "are compared with one description"),
        (["franka_hand", "--mesh", "a.obj", "--width", "80"], "--width: 80 is wider than any hand opens"),
        (["franka_hand", "--mesh", "nowhere.obj"], "nowhere.obj: "),
        (["two_tips", "--mesh", "nowhere.obj"], "two_tips: the description has no box to compare"),
    ):
        assert main(["hand", "check", *words]) == 1
        told = capsys.readouterr().err
        assert line in told
        assert told.count("\n") == 1
