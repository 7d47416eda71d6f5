# SPDX-License-Identifier: Apache-2.0
"""Descriptions of sensors: those of the package, places of taxels by hand, the hash, and everything that is refused."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case, every_refusal
from numpy.testing import assert_allclose, assert_array_equal
from sensor_builders import SMALL, TAXELS, write_sensor

from foretouch.errors import ConfigError, FileError
from foretouch.tactile import BIOTAC_SP, ELECTRODES, FULL_SCALE, MODALITIES
from foretouch.tactile.description import SensorConfig, load_sensor, sensor_files, sensor_of
from foretouch.tactile.messages.biotac import FINGER_ORDER, FINGERS, OTHERS

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "config" / "sensors"


def test_the_sensors_of_the_package_are_found_by_name() -> None:
    assert {path.stem for path in CONFIG.glob("*.yaml")} == set(sensor_files())

    def check(name: str) -> None:
        sensor = load_sensor(name)
        assert sensor.config.name == name
        assert sensor.config.summary
        assert_allclose(np.linalg.norm(sensor.layout.normals, axis=1), 1.0, atol=1e-12)
        assert load_sensor(CONFIG / f"{name}.yaml").sha256 == sensor.sha256
        assert SensorConfig.from_mapping(sensor.config.to_mapping()) == sensor.config

    every_case(sensor_files(), lambda path: check(path.stem))
    assert len({load_sensor(name).sha256 for name in sensor_files()}) == len(sensor_files())


def test_biotac_sp_is_described_as_the_messages_and_the_counts_are() -> None:
    sensor = load_sensor("biotac_sp")
    config = sensor.config
    assert (sensor.size, config.values[0].limits) == (ELECTRODES, (1.0, FULL_SCALE))
    assert tuple(finger.name for finger in config.fingers) == FINGER_ORDER
    assert tuple(finger.name for finger in config.chosen_fingers()) == FINGERS
    assert {channel.name for channel in config.scalars} == {"PDC", *OTHERS}
    modalities = [f"{one.name}_{finger}" for one in (config.scalars[0], config.values[0]) for finger in FINGERS]
    assert tuple(modalities) == MODALITIES
    fields = re.findall(r"^int16(?:\[\])? (\w+)", (ROOT / "foretouch_msgs/msg/Biotac.msg").read_text(), re.MULTILINE)
    assert {channel.field for channel in (*config.values, *config.scalars)} == {*fields} - {"pac"}


def test_electrodes_are_those_in_common_use_to_the_bit() -> None:
    """Computed as before they stood in a file; results and the hashes of simulated data depend on these bits."""
    left = np.array(
        [(9.82, -3.98, -2.77), (8.10, -3.07, -5.21), (2.22, -7.16, -3.27), (2.13, -5.12, -5.99), (-0.47, -2.41, -7.62),
         (-2.33, -7.24, -3.06), (-3.47, -4.75, -6.03), (-5.68, -1.82, -6.88), (-8.15, -3.25, -5.07),
         (-10.08, -3.85, -2.54)]
    )  # fmt: skip
    middle = np.array([(6.57, 0.0, -6.41), (4.32, -1.85, -6.97), (4.32, 1.85, -6.97), (1.91, 0.0, -7.57)])
    expected = np.concatenate([left, left * (1.0, -1.0, 1.0), middle]) / 1000.0
    radial = expected * (0.0, 1.0, 1.0)
    assert BIOTAC_SP.layout.positions.tobytes() == expected.tobytes()
    assert BIOTAC_SP.layout.normals.tobytes() == (radial / np.linalg.norm(radial, axis=1, keepdims=True)).tobytes()


def test_arrays_as_urdf_tactile_places_them(tmp_path) -> None:
    layout = load_sensor(write_sensor(tmp_path)).layout  # row-major, spaced by the size
    assert_allclose(layout.positions[:, :2], [[0.004 * r, 0.002 * c] for r in range(2) for c in range(3)])
    assert_array_equal(layout.normals, np.tile([0.0, 0.0, 1.0], (6, 1)))
    array = {"rows": 2, "cols": 3, "order": "column-major", "spacing": [-0.01, 0.005], "offset": [0.001, 0.002]}
    layout = load_sensor(write_sensor(tmp_path, {"array": array})).layout
    assert_allclose(layout.positions[:, 0], [-0.01 * r - 0.001 for _ in range(3) for r in range(2)])
    assert_allclose(layout.positions[:, 1], [0.005 * c - 0.002 for c in range(3) for _ in range(2)])


def test_taxels_of_a_file_are_in_order_of_their_index(tmp_path) -> None:
    changes: dict[str, Any] = {"array": None, "taxels": "taxels.csv"}
    layout = load_sensor(write_sensor(tmp_path, changes)).layout
    assert_array_equal(layout.positions[:, 0], [0.0, 0.001])
    assert_array_equal(layout.normals[0], [0.0, 0.6, 0.8])
    rounded = TAXELS.replace("0,0.6,0.8", "0.577,0.577,0.577")
    assert_allclose(load_sensor(write_sensor(tmp_path, changes, rounded)).layout.normals[0], np.full(3, 3**-0.5))
    marked = load_sensor(write_sensor(tmp_path, changes, "\ufeff" + TAXELS)).layout  # as spreadsheets write UTF-8
    assert_array_equal(marked.positions, layout.positions)


def test_the_hash_is_that_of_what_the_numbers_mean(tmp_path) -> None:
    changes = {"array": None, "taxels": "taxels.csv"}
    path = write_sensor(tmp_path, changes)
    first = load_sensor(path).sha256
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    assert load_sensor(write_sensor(moved, changes, "# a comment\n" + TAXELS)).sha256 == first
    assert load_sensor(write_sensor(moved, {**changes, "group": "", "scalars": []})).sha256 == first  # the defaults
    finger = {**SMALL["fingers"][0], "dead": [1], "xyz": [0.1, 0.0, 0.0]}
    for mounted in ({"update_rate": 50.0}, {"fingers": [finger, SMALL["fingers"][1]]}):
        assert load_sensor(write_sensor(moved, {**changes, **mounted})).sha256 == first
    others: list[tuple[dict[str, Any], str]] = [
        ({**changes, "values": [{**SMALL["values"][0], "contact": "rise"}]}, TAXELS),
        (changes, TAXELS.replace("0.001", "0.0010000001")),
        (changes, TAXELS.replace("0.6,0.8", "0.8,0.6")),
    ]
    assert len({first, *(load_sensor(write_sensor(moved, *other)).sha256 for other in others)}) == len(others) + 1


def test_settings_that_break_a_rule_are_named(tmp_path) -> None:
    value = SMALL["values"][0]
    finger = SMALL["fingers"][0]
    array = SMALL["array"]
    cases: list[tuple[str, dict[str, Any]]] = [
        ("name: '4x4' is not a letter", {"name": "4x4"}),
        ("array, taxels: give exactly one", {"taxels": "taxels.csv"}),
        (r"taxels: '\.\./taxels.csv' is not a valid file name beside", {"array": None, "taxels": "../taxels.csv"}),
        ("fingers: there is none", {"fingers": None}),
        ("fingers: left occurs twice", {"fingers": [finger, finger]}),
        ("values: none changes in contact", {"values": [{**value, "contact": "none"}]}),
        ("values, scalars: p occurs twice", {"scalars": [value]}),
        (r"values\[0\].field: is empty", {"values": [{**value, "field": ""}]}),
        (r"values\[0\].unit: 'newton' is not one of counts", {"values": [{**value, "unit": "newton"}]}),
        (r"values\[0\].range: .* is not \[low, high\] within \[0.0, 255.0\]",
         {"values": [{**value, "dtype": "uint8", "range": [0, 256]}]}),
        (r"values\[0\].saturation: .* within \[0.0, 9.0\]",
         {"values": [{**value, "range": [0, 9], "saturation": [0, 10]}]}),
        (r"values\[0\].contct: unknown setting.*did you mean contact", {"values": [{**value, "contct": "rise"}]}),
        (r"fingers\[0\].xyz: .* are not 3 numbers", {"fingers": [{**finger, "xyz": [0.0, 1.0]}]}),
        ("dead: left has no taxel 6", {"fingers": [{**finger, "dead": [6]}]}),
        ("grasp: .* are not 2 numbers", {"grasp": ["left"]}),
        ("fingers: 'lefd' is not one of left, right; did you mean left", {"grasp": ["lefd", "right"]}),
        ("array.size, spacing: 0 m from a taxel", {"array": {"rows": 2, "cols": 1}}),
        (r"pad: taxel 1 at \(0, 0.002, 0\) m is outside; 4 taxels", {"pad": [0, 0, 0, 0.004, 0.001, 0.001]}),
        (r"array.size\[0\]: 4.0 is above 1.0 m", {"array": {**array, "size": [4, 2]}}),  # in millimetres
        ("source.type: 'SensStream' is not a type", {"source": {"type": "SensStream"}}),
        ("source.invalid: 'T' is not one of", {"source": {"type": "a/B", "invalid": ["T"]}}),
    ]  # fmt: skip

    def refuse(changes: dict[str, Any]) -> None:
        with pytest.raises(ConfigError) as err:
            load_sensor(write_sensor(tmp_path, changes))
        assert str(err.value).startswith(f"{tmp_path / 'small.yaml'}: ")
        raise err.value

    every_refusal(ConfigError, cases, refuse)


def test_taxels_that_break_a_rule_are_named_by_their_line(tmp_path) -> None:
    head = "index,x,y,z,nx,ny,nz"
    cases = (
        ("does not begin with the line index,x", ""),
        ("holds 0 taxels", f"{head}\n"),
        ("line 2: '0,0,0,0,0,1' is not 7 finite numbers", f"{head}\n0,0,0,0,0,1\n"),
        ("line 2: .* is not 7 finite numbers", f"{head}\n0,nan,0,0,0,0,1\n"),
        ("line 2: nx, ny, nz: the normal is zero; where it is unknown, state that", f"{head}\n0,0,0,0,0,0,0\n"),
        ("line 2: nx, ny, nz: .* not of unit length", f"{head}\n0,0,0,0,1e300,0,1e300\n"),
        ("line 3: index: not each of 0 to 1 once", f"{head}\n0,0,0,0,0,0,1\n0,1,0,0,0,0,1\n"),
        ("line 2: index: not each", f"{head}\n0.5,0,0,0,0,0,1\n"),
    )

    def refuse(text: str) -> None:
        with pytest.raises(FileError) as err:
            load_sensor(write_sensor(tmp_path, {"array": None, "taxels": "taxels.csv"}, text))
        assert str(tmp_path / "taxels.csv") in str(err.value)
        raise err.value

    every_refusal(FileError, cases, refuse)


def test_more_fingers_or_channels_than_any_hand_has_are_refused_unread() -> None:
    for name in ("fingers", "values", "scalars"):
        stated = BIOTAC_SP.to_mapping() | {name: [{"name": "not read"}] * 100_000}
        with pytest.raises(ConfigError, match=f"card: {name}: holds 100000, more than 1000"):
            sensor_of(stated, "card")


def test_what_is_no_description_is_refused(tmp_path) -> None:
    (tmp_path / "taxels.yaml").mkdir()
    cases = (
        ("biotac: is neither a file nor one of biotac_sp, .*did you mean biotac_sp", "biotac"),
        ("absent.yaml: No such file", tmp_path / "absent.yaml"),
        ("taxels.yaml: .*folder", tmp_path / "taxels.yaml"),
    )
    every_refusal(ConfigError, cases, load_sensor)
    path = write_sensor(tmp_path, {"array": None, "taxels": "absent.csv"})
    with pytest.raises(FileError, match=r"absent\.csv: No such file"):
        load_sensor(path)


def test_a_description_in_a_manifest_is_checked_as_a_file_is() -> None:
    one = load_sensor("shadow_mst").to_mapping()
    points, normals, _ = one["taxels"]
    cases = (
        ("taxels: positions, normals and null are expected", {**one, "taxels": [[[10**400, 0, 0]], normals, None]}),
        ("taxels: positions, normals and null are expected", {**one, "taxels": [points, normals]}),
        ("taxels: 0 are not 1 to", {**one, "taxels": [[], [], None]}),
        ("taxels: 70000 are not 1 to", {**one, "taxels": [[[0, 0, 0]] * 70_000, [[0, 0, 1]] * 70_000, None]}),
        ("taxels: are not finite, or the normals not", {**one, "taxels": [points, [[0, 0, 0], *normals[1:]], None]}),
        ("taxels: are not finite", {**one, "taxels": [[[math.nan, 0, 0], *points[1:]], normals, None]}),
        ("pad: taxel 0 at .* is outside", {**one, "taxels": [[[1e300, 0, 0], *points[1:]], normals, None]}),
        ("dead: FF has no taxel 99", {**one, "fingers": [{"name": "FF", "dead": [99]}, *one["fingers"][1:]]}),
        ("fingers: there is one", {**one, "fingers": [{"name": "TH"}], "grasp": []}),
    )
    every_refusal(
        ConfigError, [(f"where: {rule}", case) for rule, case in cases], lambda case: sensor_of(case, "where")
    )


def test_columns_of_fingers_are_where_the_modalities_are_and_dead_taxels_are_not_valid() -> None:
    def check(name):
        sensor = load_sensor(name)
        channels, taken = sensor.channels, np.concatenate([sensor.scalar_columns.ravel(), sensor.taxel_columns.ravel()])
        np.testing.assert_array_equal(np.sort(taken), np.arange(channels.size))
        for f, finger in enumerate(channels.fingers):
            for s, channel in enumerate(sensor.scalar_channels):
                assert [sensor.scalar_columns[f, s]] == channels.columns([f"{channel.name}_{finger}"]).tolist()
            for c, channel in enumerate(sensor.taxel_channels):
                assert sensor.taxel_columns[f, :, c].tolist() == channels.columns([f"{channel.name}_{finger}"]).tolist()
        assert sensor.valid.shape == (len(channels.fingers), sensor.size)
        assert sensor.valid.all()

    every_case(sensor_files(), check)
    one = load_sensor("shadow_mst").to_mapping()
    one["fingers"] = [{**finger, "dead": [2]} if finger["name"] == "TH" else finger for finger in one["fingers"]]
    assert np.argwhere(~sensor_of(one, "").valid).tolist() == [[0, 2]]
