# SPDX-License-Identifier: Apache-2.0
"""`sensor`: list, check and show."""

import json

from PIL import Image
from sensor_builders import write_sensor

from foretouch.tactile.description import load_sensor, sensor_files


def test_all_sensors_are_listed(call) -> None:
    answer = call("sensor", "list", "--json")
    assert answer.status == 0
    assert [record["name"] for record in answer.records] == list(sensor_files())
    assert "xela_uskin_4x4" in call("sensor", "list").out


def test_descriptions_are_checked_in_order(call, tmp_path) -> None:
    path = write_sensor(tmp_path)
    answer = call("sensor", "check", path, "biotac", "biotac_sp", "--json")
    assert answer.status == 1
    good, bad, packaged = answer.records
    assert (good["input"], good["status"], good["sha256"]) == (str(path), "ok", load_sensor(path).sha256)
    assert (good["taxels"], good["fingers"], good["values"]) == (6, ["left", "right"], [{"name": "p", "unit": "Pa"}])
    assert (bad["input"], bad["status"]) == ("biotac", "refused")
    assert "did you mean biotac_sp?" in bad["reason"]
    assert [one["name"] for one in packaged["scalars"]] == ["PDC", "PAC0", "PAC1", "TAC", "TDC"]
    assert call("sensor", "check", path).status == 0
    write_sensor(tmp_path, {"taxels": "taxels.csv"})
    call("sensor", "check", path).check_refused(f"foretouch: {path}: array, taxels: give exactly one of them")


def test_the_picture_shows_every_taxel(call, tmp_path) -> None:
    path = tmp_path / "taxels.png"
    answer = call("sensor", "show", "biotac_sp", "-o", path, "--json")
    assert json.loads(answer.out)["taxels"] == 24
    with Image.open(path) as image:
        assert len(image.convert("RGB").getcolors(1 << 24)) > 50
    call("sensor", "show", "biotac_sp", "-o", tmp_path / "taxels.txt").check_refused(
        "taxels.txt: the extension is not one of"
    )
    call("sensor", "show", "biotac", "-o", path).check_refused("biotac: is neither a file nor one of")
