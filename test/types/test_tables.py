# SPDX-License-Identifier: Apache-2.0
"""Predictions, grasps and samples as plain data, tables and labelled arrays."""

import json
from pathlib import Path

import numpy as np
import pytest
from recording_builders import write_grasps

import foretouch as ft
from foretouch.errors import MissingDependencyError
from foretouch.types.channels import Channels

TABLE = Path(__file__).parents[2] / "examples" / "data" / "table.npz"


@pytest.fixture(scope="module")
def touch() -> ft.Predictions:
    """Predictions of four grasps, of which the second is none."""
    target = ft.segment(ft.read_cloud(TABLE)).objects[0]
    grasps = ft.plan(target, count=4)
    g1 = grasps.g1.copy()
    g1[1] = np.nan
    return ft.load_model().predict(target, grasps.replace(g1=g1))


@pytest.fixture
def samples(tmp_path: Path) -> ft.SampleSet:
    write_grasps(tmp_path / "session")
    return ft.open(tmp_path / "session")


def test_plain_data_is_json_and_holds_the_numbers(touch: ft.Predictions, samples: ft.SampleSet) -> None:
    data = json.loads(json.dumps(touch.to_dict(), allow_nan=False))
    assert data["sensor"] == "biotac_sp"
    first, none = data["predictions"][:2]
    assert first["E_TH"]["lower"] == touch["E_TH"].lower[0].tolist()
    assert first["PDC_MF"]["value"] == touch["PDC_MF"].value[0, 0]
    assert first["grasp"]["g1"] == touch.grasps.g1[0].tolist()
    assert (none["grasp"], none["E_TH"]["value"], none["status"]) == (None, None, "bad_grasp")
    grasps = json.loads(json.dumps(touch.grasps.to_dict(), allow_nan=False))
    assert [one is None for one in grasps["grasps"]] == [False, True, False, False]
    assert touch[0].to_dict() == touch.to_dict()["predictions"][0]
    kept = json.loads(json.dumps(samples.to_dict(), allow_nan=False))["samples"]
    assert [one["id"] for one in kept] == [sample.id for sample in samples]
    labelled = next(sample for sample in samples if sample.touch is not None)
    own = next(one for one in kept if one["id"] == labelled.id)
    assert own["touch"]["E_MF"] == labelled.touch["E_MF"].tolist()
    assert own["grasp"]["rotation"] == labelled.grasp.rotation.ravel().tolist()


def test_a_table_has_a_row_for_each_grasp_and_a_column_for_each_number(
    touch: ft.Predictions, samples: ft.SampleSet
) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed")
    table = touch.to_pandas()
    assert len(table) == 4
    np.testing.assert_array_equal(table["E_MF_24_upper"], touch["E"].upper[:, 1, 23])
    np.testing.assert_array_equal(table["PDC_TH_value"], touch["PDC"].value[:, 0])
    np.testing.assert_array_equal(table["rotation_x_Z"], touch.grasps.rotation[:, 0, 2])
    assert table["status"].tolist() == touch.status.tolist()
    assert table.attrs["sensor"] == "biotac_sp"
    grasps = touch.grasps.to_pandas()
    np.testing.assert_array_equal(grasps["g2_z"], touch.grasps.g2[:, 2])
    arrays, kept = samples.to_arrays(), samples.to_pandas()
    np.testing.assert_array_equal(kept["E_TH_3"], arrays["E"][:, 0, 2])
    assert kept["object"].tolist() == arrays["object"].tolist()
    assert len(touch[:0].to_pandas()) == 0


def test_a_dataset_of_xarray_has_names_and_units(touch: ft.Predictions, samples: ft.SampleSet) -> None:
    pytest.importorskip("xarray", reason="xarray is not installed")
    data = touch.to_xarray()
    lower = data["E"].sel(finger="MF", taxel=24, end="lower")
    np.testing.assert_array_equal(lower, touch["E"].lower[:, 1, 23])
    np.testing.assert_array_equal(data["PDC"].sel(end="value"), touch["PDC"].value)
    assert (data["E"].attrs["units"], data["g1"].attrs["units"]) == ("counts", "m")
    np.testing.assert_array_equal(touch.grasps.to_xarray()["g1"].sel(axis="y"), touch.grasps.g1[:, 1])
    kept = samples.to_xarray()
    np.testing.assert_array_equal(kept["E"].transpose("sample", "finger", "taxel"), samples.to_arrays()["E"])


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_without_the_package_one_line_says_what_to_install(
    touch: ft.Predictions, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(MissingDependencyError, match=rf"to_{package}: .*pip install 'foretouch\[tables\]'"):
        getattr(touch, f"to_{package}")()


def test_a_reading_is_made_of_named_parts() -> None:
    channels = ft.load_model().sensor.channels
    electrodes = np.arange(48.0).reshape(2, 24)
    named = ft.Touch.of(channels, E_MF=electrodes[1], PDC_MF=7, E_TH=electrodes[0], PDC_TH=[5])
    np.testing.assert_array_equal(named.values, [5, 7, *range(48)])
    np.testing.assert_array_equal(ft.Touch.of(channels, PDC=[5, 7], E=electrodes).values, named.values)
    cases = {
        "F": ({"F": 1}, "channel: 'F' is not one of PDC, E, PDC_TH"),
        "missing": ({"PDC_TH": 1, "E": electrodes}, "touch: PDC_MF of biotac_sp is missing"),
        "shape": ({"E_TH": [1.0, 2.0]}, r"E_TH: shape \(2,\) is not \(24,\)"),
        "turned": ({"E": electrodes.T}, r"E: shape \(24, 2\) is not \(2, 24\)"),
        "twice": ({"PDC": [1, 2], "PDC_TH": 1}, "PDC_TH: is given twice"),
        "text": ({"PDC_TH": "high"}, "PDC_TH: high is not of numbers"),
    }
    for parts, message in cases.values():
        with pytest.raises(ft.ForetouchError, match=message):
            ft.Touch.of(channels, **parts)
    assert isinstance(channels, Channels)
