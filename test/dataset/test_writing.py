# SPDX-License-Identifier: Apache-2.0
"""`foretouch.write`: arrays of any source become samples with equal numbers; stamps and missing numbers are named, and what does not fit is refused."""

import os
import runpy
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import foretouch as ft
from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.dataset.formats import open_samples
from foretouch.dataset.importing import import_samples
from foretouch.dataset.labelling.stamps import stamp_faults
from foretouch.errors import DatasetError, FileError
from foretouch.types import HOLD, REST, Sample

EXAMPLES = Path(__file__).parents[2] / "examples"
SENSOR: dict[str, Any] = {
    "name": "pads",
    "update_rate": 100,
    "fingers": [{"name": "A"}, {"name": "B"}],
    "array": {"rows": 1, "cols": 3, "size": [0.01, 0.01]},
    "values": [{"name": "P", "field": "p", "dtype": "uint16", "range": [0, 4000], "contact": "rise", "noise": 2.0}],
    "source": {"type": "table/Rows"},
}
START_S = 1_795_600_800.0  # 2026-11-25 10:00:00 UTC


@pytest.fixture
def pads(tmp_path: Path) -> Path:
    path = tmp_path / "pads.yaml"
    path.write_text(yaml.safe_dump(SENSOR))
    return path


def pressed(count: int = 100, contact: int = 40, seed: int = 0) -> Any:
    """(count, 6) readings, of which those from `contact` on are pressed."""
    rng = np.random.default_rng(seed)
    return 1000.0 + rng.integers(-3, 4, (count, 6)) + 400.0 * (np.arange(count) >= contact)[:, None]


def grasp(rows: Any = None, **changes: Any) -> dict[str, Any]:
    rows = pressed() if rows is None else rows
    given = {"object": "mug", "id": "7", "values": {"P_A": rows[:, :3], "P_B": rows[:, 3:]}, "rest": 20}
    stamps = {} if {"stamps_ns", "rate_hz"} & changes.keys() else {"stamps_s": START_S + 0.01 * np.arange(len(rows))}
    return given | stamps | changes


def written(path: Path, sensor: Path, *samples: Any, **options: Any) -> list[Sample]:
    ft.write(path, samples, sensor, **options)
    return list(open_samples(path))


def test_arrays_become_a_sample_whose_values_equal_them(tmp_path: Path, pads: Path) -> None:
    rows = pressed()
    (record,) = written(
        tmp_path / "ds", pads, grasp(rows, outcome=True, others={"angle": np.arange(100) / 8}, note="file")
    )
    assert (record.id, record.outcome, record.note, record.flags) == ("mug/7", "success", "file", ())
    assert record.series is not None
    assert_array_equal(record.series.counts, rows)
    assert_array_equal(record.series.others["angle"], np.arange(100) / 8)
    expected = round(START_S) * 10**9 + 10_000_000 * np.arange(100)
    assert np.abs(record.series.stamps_ns - expected).max() <= 128  # the digits of float64
    assert record.contact_ns == record.series.stamps_ns[40]  # the first reading with contact
    assert set(np.flatnonzero(record.series.phases == HOLD)) == set(range(70, 100))  # 0.3 s later
    assert_array_equal(np.flatnonzero(record.series.phases == REST), np.arange(20))
    assert record.touch is not None
    assert record.tare is not None
    assert_array_equal(record.touch.values, np.median(rows[70:], axis=0))
    assert_array_equal(record.tare.values, np.median(rows[:20], axis=0))


def test_a_dataset_is_written_as_it_is_and_one_reading_is_the_touch(tmp_path: Path, pads: Path) -> None:
    row = pressed(1, 0)[0]
    single = {
        "object": "mug",
        "values": {"P_A": row[:3], "P_B": row[3:]},
        "others": {"angle": 0.5},
        "outcome": "failure",
    }
    first = written(tmp_path / "a", pads, grasp(), single)
    result = ft.write(tmp_path / "b", open_samples(tmp_path / "a"))
    again = list(open_samples(tmp_path / "b"))
    assert (result.samples, result.labelled, result.readings) == (2, 2, 101)
    assert [one.id for one in again] == [one.id for one in first] == ["mug/7", "mug/000001"]
    for one, other in zip(first, again, strict=True):
        assert_array_equal(one.touch.values, other.touch.values)
        assert (one.outcome, one.contact_ns, one.extra) == (other.outcome, other.contact_ns, other.extra)
    assert_array_equal(first[1].touch.values, row)
    assert (first[1].extra, first[1].series) == ({"angle": 0.5}, None)


STAMPS: dict[str, tuple[Any, str]] = {  # a hundred readings at 100 Hz as others store them
    "six digits": ([float(f"{START_S + 0.01 * k:g}") for k in range(100)], "100 readings have the same stamp"),
    "whole seconds": (np.floor(START_S + 0.01 * np.arange(100)), "100 readings have the same stamp"),
    "float32": (
        (START_S + 0.01 * np.arange(100)).astype(np.float32),
        r"float32 holds 1\.7956e\+09 in steps of 128 s: read",
    ),
    "tenths": (np.floor(START_S * 10 + 0.1 * np.arange(100)) / 10, "10 readings have the same stamp, and 100 only 10"),
    "going back": (START_S + 0.01 * np.r_[:50, 48:-2:-1], "go back by 0.01.* s at reading 50"),
    "milliseconds": (START_S * 1e3 + 10.0 * np.arange(100), "is no time in s"),
    "text": (["a"] * 100, r"are texts, such as \['a'\]: give numbers, or dates as pandas"),
    "infinite": (np.where(np.arange(100) == 3, np.inf, START_S), "are not finite numbers"),
    "one missing": (
        np.where(np.arange(100) == 3, np.nan, START_S),
        "reading 3 has no time: it is missing; leave the reading out",
    ),
    "None": ([None] * 100, "reading 0 has no time"),
    "truth values": ([True] * 100, "are truth values"),
    "complex": (1j * np.arange(100), "are complex numbers"),
    "of different lengths": ([[0.0], [1.0, 2.0]], "inhomogeneous"),
    "beyond any time": ([10**400] * 100, "a number is too large"),
    "too few": (START_S + 0.01 * np.arange(99), r"shape \(99,\) is not \(100,\)"),
}


@pytest.mark.parametrize("name", STAMPS)
def test_stamps_that_do_not_tell_the_readings_apart_are_refused(tmp_path: Path, pads: Path, name: str) -> None:
    stamps, rule = STAMPS[name]
    with pytest.raises(DatasetError, match=rf"^sample 0 \(mug/7\): stamps_s: .*{rule}"):
        ft.write(tmp_path / "ds", [grasp(stamps_s=stamps)], pads)
    assert not (tmp_path / "ds").exists()


def test_float32_that_holds_the_time_since_the_start_and_dates_of_pandas_are_stamps(tmp_path: Path, pads: Path) -> None:
    short = (0.01 * np.arange(100)).astype(np.float32)
    dates = np.datetime64("2026-11-25T10:00:00") + np.timedelta64(10, "ms") * np.arange(100)
    first, second = written(
        tmp_path / "ds", pads, grasp(stamps_s=short, start_s=START_S), grasp(id="8", stamps_ns=dates)
    )
    assert np.abs(first.series.stamps_ns - second.series.stamps_ns).max() < 100
    assert second.series.stamps_ns[1] == round(START_S) * 10**9 + 10_000_000


def test_times_of_any_zone_and_library_are_stamps(tmp_path: Path, pads: Path) -> None:
    pd, pa = pytest.importorskip("pandas"), pytest.importorskip("pyarrow")
    start = datetime(2026, 11, 25, 10, tzinfo=UTC)
    aware = [start + timedelta(milliseconds=10 * k) for k in range(100)]
    east = [time.astimezone(timezone(timedelta(hours=9))) for time in aware]
    plain = np.array([time.replace(tzinfo=None) for time in aware], "datetime64[ns]")
    column = pd.Series(pd.to_datetime(aware, utc=True))
    cases: dict[str, Any] = {
        "of a zone": aware, "of another": east, "of UTC without a zone": [time.replace(tzinfo=None) for time in aware],
        "pandas": column, "pandas of a zone": column.dt.tz_convert("Asia/Tokyo"), "an index": pd.DatetimeIndex(column),
        "a list of Timestamps": list(column), "strings of dates": pd.to_datetime([time.isoformat() for time in aware], format="ISO8601"),
        "microseconds": plain.astype("datetime64[us]"), "arrow": pa.array(aware), "objects": np.array(aware, object),
        "masked": np.ma.masked_array(plain, np.zeros(100, bool)),
    }  # fmt: skip
    expected = round(START_S) * 10**9 + 10_000_000 * np.arange(100)
    for number, (name, times) in enumerate(cases.items()):
        stamps = written(tmp_path / f"{number}", pads, grasp(stamps_ns=times))[0].series.stamps_ns
        assert_array_equal(stamps, expected, err_msg=name)
    for number, elapsed in enumerate((plain - plain[0], column - column[0], [time - start for time in aware])):
        (sample,) = written(tmp_path / f"since {number}", pads, grasp(stamps_ns=elapsed, start_s=START_S))
        assert_array_equal(sample.series.stamps_ns, expected)
    nanoseconds = pd.Series(pd.to_datetime(expected + np.arange(100), utc=True))  # which `datetime` does not hold
    (sample,) = written(tmp_path / "ns", pads, grasp(stamps_ns=nanoseconds))
    assert_array_equal(sample.series.stamps_ns, expected + np.arange(100))


def test_times_that_are_missing_or_no_times_are_named(tmp_path: Path, pads: Path) -> None:
    pd = pytest.importorskip("pandas")
    plain = np.datetime64("2026-11-25T10", "ns") + np.timedelta64(10, "ms") * np.arange(100)
    gap = np.where(np.arange(100) == 3, np.datetime64("NaT"), plain)
    column = pd.Series(gap).dt.tz_localize("UTC")
    cases: dict[str, tuple[Any, str]] = {
        "NaT": (gap, "reading 3 has no time: it is missing"),
        "NaT of pandas": (column, "reading 3 has no time"),
        "NA of pandas": (pd.array([None if k == 3 else k for k in range(100)], "Int64"), "reading 3 has no time"),
        "masked": (np.ma.masked_array(np.arange(100) * 10**7, np.arange(100) == 3), "reading 3 has no time"),
        "texts": ([f"2026-11-25T10:00:00.{k:02}" for k in range(100)], "are texts, such as .'2026-11-25T10:00:00.00'.: give numbers"),
        "a column of texts": (pd.Series(["10:00"] * 100), "are (of type str|texts), such as .*10:00"),
        "texts and dates": ([*plain[:50].tolist(), *["x"] * 50], "are of type str|stamps_ns: "),
        "a time beyond int64": (np.full(100, np.datetime64("9999-01-01", "D")), "is no time in ns"),
        "days": ([date(2026, 11, 25)] * 100, "are of type date, such as .*: give numbers, or dates as"),
        "of other things": ([object()] * 100, "are of type object"),
    }  # fmt: skip
    for times, rule in cases.values():
        with pytest.raises(DatasetError, match=rf"^sample 0 \(mug/7\): stamps_ns: .*{rule}|{rule}"):
            ft.write(tmp_path / "ds", [grasp(stamps_ns=times)], pads)


def test_names_are_texts_or_refused(tmp_path: Path, pads: Path) -> None:
    pd = pytest.importorskip("pandas")
    names: list[tuple[Any, str]] = [
        (b"mug", "mug"), (np.bytes_(b"mug"), "mug"), (np.str_("mug"), "mug"), (np.array("mug"), "mug"), ("Ø 3", "Ø 3"),
        (3, "3"), (np.int64(3), "3"), (3.0, "3"), (np.float32(3), "3"), (pd.Series(["mug"])[0], "mug"),
    ]  # fmt: skip
    for number, (label, name) in enumerate(names):
        (sample,) = written(tmp_path / f"{number}", pads, grasp(object=label, id=label, note=None, outcome=np.nan))
        assert (sample.object, sample.id, sample.note, sample.outcome) == (name, f"{name}/{name}", "", "unknown")
    missing = [float("nan"), None, pd.NA, pd.NaT, np.float32("nan"), np.ma.masked, np.datetime64("NaT")]
    for field in ("object", "id"):
        for label in missing:
            with pytest.raises(DatasetError, match=rf"^sample 0 \(.*\): {field}: is missing \(.*\): give a text"):
                ft.write(tmp_path / "ds", [grasp(**{field: label})], pads)
        for label in (["mug"], 3.5, True, {"a": 1}, np.array(["mug", "box"]), b"\xff", object, np.inf, 10**400):
            with pytest.raises(
                DatasetError, match=rf"^sample 0 .*{field}: .* is not (a name: give a text|text in UTF-8)"
            ):
                ft.write(tmp_path / "ds", [grasp(**{field: label})], pads)
        with pytest.raises(
            DatasetError, match=rf"^sample 0 .*{field}: .* holds half of a surrogate pair, which is no text"
        ):
            ft.write(tmp_path / "ds", [grasp(**{field: "half \ud800"})], pads)
    with pytest.raises(DatasetError, match=r"hand\.serial: is missing"):
        ft.write(tmp_path / "ds", [grasp()], pads, hand={"name": "mine", "serial": np.nan})
    ft.write(tmp_path / "ds", [grasp()], pads, hand={"serial": 5}, camera={"name": b"D415"})
    assert (ft.open(tmp_path / "ds").identity.hand, ft.open(tmp_path / "ds").identity.camera) == (
        {"serial": "5"},
        {"name": "D415"},
    )


def test_what_is_masked_or_missing_is_not_measured(tmp_path: Path, pads: Path) -> None:
    pd, pa = pytest.importorskip("pandas"), pytest.importorskip("pyarrow")
    rows = pressed()
    lost = np.zeros((100, 3), bool)
    lost[::2] = True
    filled = np.where(lost, 0, rows[:, :3])
    cells = [
        [None if gone else value for value, gone in zip(*row, strict=True)]
        for row in zip(filled.tolist(), lost, strict=True)
    ]
    tables: dict[str, Any] = {
        "masked": np.ma.masked_array(filled, lost), "masked integers": np.ma.masked_array(filled.astype(np.uint16), lost),
        "NaN": np.where(lost, np.nan, filled), "None": cells, "NA of pandas": pd.DataFrame(cells).convert_dtypes(),
        "a list of masked rows": list(np.ma.masked_array(filled, lost)), "vectors in cells": pd.Series(cells),
        "vectors, some missing": pd.Series([None if gone[0] else row for row, gone in zip(filled.tolist(), lost, strict=True)]),
        "vectors of arrow": pa.array([None if gone[0] else row for row, gone in zip(filled.tolist(), lost, strict=True)]),
    }  # fmt: skip
    for number, (name, left) in enumerate(tables.items()):
        record = grasp(rows) | {"values": {"P_A": left, "P_B": rows[:, 3:]}}
        with pytest.raises(DatasetError, match=r"values: P_A\[0\] of reading 0 is nan; 50 of 100 readings"):
            ft.write(tmp_path / "ds", [record], pads)
        with pytest.warns(UserWarning, match=r"missing_numbers \(hold\): 1 samples, first mug/7: 150"):
            (sample,) = written(tmp_path / f"{number}", pads, record, missing="hold")
        assert np.abs(sample.tare["P_A"] - 1000.0).max() < 5.0, name
        assert_array_equal(sample.series.counts[1::2, :3], rows[1::2, :3])


def test_masked_others_and_tares_are_missing(tmp_path: Path, pads: Path) -> None:
    angle = np.ma.masked_array(np.arange(100.0), np.arange(100) == 3)
    with pytest.raises(DatasetError, match="others: angle of reading 3 is nan"):
        ft.write(tmp_path / "ds", [grasp(others={"angle": angle})], pads)
    tare = {"P_A": np.ma.masked_array([990.0, 0.0, 990.0], [False, True, False]), "P_B": [990, 990, 990]}
    (sample,) = written(tmp_path / "ds", pads, grasp(tare=tare))
    assert_array_equal(sample.tare.values, [990.0, np.nan, 990.0, 990.0, 990.0, 990.0])


def test_equal_stamps_gaps_and_another_rate_are_flagged_and_named(tmp_path: Path, pads: Path) -> None:
    even = 0.01 * np.arange(100)
    repeated = np.sort(np.r_[even[:90], even[:10]])
    gap = even + 0.5 * (np.arange(100) > 60)
    for name, stamps, flag, rule in (
        ("repeated", repeated, "equal_stamps", "2 readings have the same stamp, and 100 only 90 different"),
        ("gap", gap, "stamp_gaps", "1 gaps, the longest of 0.51 s"),
        ("slow", even * 4, "other_rate", "stamps of 25 Hz, and the sensor is described with 100 Hz"),
        ("unit", even * 1000, "other_rate", "0.1 Hz, and the sensor is described with 100 Hz: another unit?"),
    ):
        with pytest.warns(UserWarning, match=rf"^{flag}: 1 samples, first mug/7: .*{rule}") as caught:
            (record,) = written(tmp_path / name, pads, grasp(stamps_s=START_S + stamps))
        assert (record.flags, len(caught)) == ((flag,), 1)
    rows = np.repeat(pressed()[::2], 2, axis=0)  # a reader that stores the same reading twice
    with pytest.warns(UserWarning, match="equal_stamps"):
        written(tmp_path / "twice", pads, grasp(rows, stamps_s=START_S + np.repeat(even[::2], 2)))
    assert stamp_faults(np.arange(100) * 10_000_000, 100.0) == stamp_faults(np.arange(1), 100.0) == {}


def test_no_contact_is_named(tmp_path: Path, pads: Path) -> None:
    with pytest.warns(UserWarning, match="no_contact: 1 samples, first mug/7: none found after 20 readings"):
        (record,) = written(tmp_path / "ds", pads, grasp(pressed(contact=100)))
    assert record.touch is None


def test_a_sample_is_labelled_by_the_rules_of_the_recorder(tmp_path: Path, pads: Path) -> None:
    frozen, dead, restless, lost = pressed(), pressed(), pressed(), pressed()
    frozen[35:, 3:] = frozen[35, 3:]
    dead[:, 3:] = dead[0, 3:]
    restless[10:20] += 400
    lost[5:8], lost[30:33] = 4000, 0  # saturated in the rest, and packets that a driver stored as zeros
    alone = pressed()
    alone[:, 3:] = pressed(seed=1, contact=100)[:, 3:]
    cases = {
        "frozen": (frozen, ("no_contact_B", "frozen_B"), True),
        "dead": (dead, ("frozen_sensor",), False),
        "restless": (restless, ("restless_tare",), False),
        "alone": (alone, ("no_contact_B",), True),
        "lost": (lost, (), True),
    }
    for name, (rows, flags, has_touch) in cases.items():
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            (sample,) = written(tmp_path / name, pads, grasp(rows))
        assert (sample.flags, sample.touch is not None) == (flags, has_touch), name
        assert [str(one.message).partition(":")[0] for one in caught] == [*flags], name
        assert_array_equal(sample.series.counts, rows)
        assert sample.contact_ns == (sample.series.stamps_ns[40] if has_touch else None)
        assert set(np.flatnonzero(sample.series.phases == HOLD)) == (set(range(70, 100)) if has_touch else set())


def test_a_tare_of_ones_own_is_kept_without_a_label(tmp_path: Path, pads: Path) -> None:
    rows = pressed()
    rows[:, 3:] = rows[0, 3:]
    tare = {"P_A": np.full(3, 990.0), "P_B": np.full(3, 991.0)}
    with pytest.warns(UserWarning, match="frozen_sensor: 1 samples, first mug/7: B: the same 100 times"):
        (sample,) = written(tmp_path / "ds", pads, grasp(rows, tare=tare))
    assert_array_equal(sample.tare.values, np.repeat([990.0, 991.0], 3))


def test_missing_numbers_are_refused_held_or_masked_by_setting(tmp_path: Path, pads: Path) -> None:
    rows = pressed()
    holes = rows.copy()
    holes[[0, 30, 80], [2, 1, 5]] = np.nan, np.inf, np.nan
    with pytest.raises(DatasetError, match=r"values: P_A\[2\] of reading 0 is nan; 3 of 100 readings .*'hold'.*'mask'"):
        ft.write(tmp_path / "a", [grasp(holes)], pads)
    with pytest.warns(UserWarning, match=r"missing_numbers \(hold\): 1 samples, first mug/7: 3"):
        (held,) = written(tmp_path / "b", pads, grasp(holes), missing="hold")
    expected = rows.copy()
    expected[[0, 30, 80], [2, 1, 5]] = rows[[1, 29, 79], [2, 1, 5]]
    assert_array_equal(held.series.counts, expected)
    with pytest.warns(UserWarning, match=r"missing_numbers \(mask\)"):
        (masked,) = written(tmp_path / "c", pads, grasp(holes), missing="mask")
    expected[[0, 30, 80], [2, 1, 5]] = np.nan
    assert_array_equal(masked.series.counts, expected)
    assert held.flags == masked.flags == ("missing_numbers",)
    for one in (held, masked):
        assert_array_equal(one.touch.values, np.nanmedian(one.series.counts[70:].astype(float), axis=0))
    gone = rows.copy()
    gone[:, 4] = np.nan
    with pytest.raises(DatasetError, match=r"P_B\[1\] .* in all readings: leave it out, or declare the taxel dead"):
        ft.write(tmp_path / "d", [grasp(gone)], pads, missing="hold")
    with pytest.warns(UserWarning, match=r"missing_numbers \(mask\): 1 samples, first mug/7: 100"):
        (masked,) = written(tmp_path / "d", pads, grasp(gone), missing="mask")
    assert np.isnan(masked.touch.values).tolist() == [False] * 4 + [True, False]
    with pytest.raises(DatasetError, match=r"others: angle of reading 3 .*only taxels can be masked"):
        ft.write(
            tmp_path / "e", [grasp(others={"angle": np.where(np.arange(100) == 3, np.nan, 1.0)})], pads, missing="mask"
        )


CAN = np.stack(np.meshgrid([0.0, 0.1], [0.0, 0.07], [0.85, 0.9]), axis=-1).reshape(-1, 3)  # [m]


def held(unit: float = 1.0, away: float = 0.0) -> ft.Grasp:
    """Return a grasp across the can."""
    ends = unit * np.array([[0.05, 0.07, 0.87 + away], [0.05, 0.0, 0.87 + away]])
    return ft.Grasp(*ends, np.eye(3)[:, [2, 0, 1]])


def test_a_touch_of_no_working_sensor_and_an_object_beyond_the_limits_are_refused(tmp_path: Path, pads: Path) -> None:
    (fine,) = written(tmp_path / "a", pads, grasp(cloud=ft.Cloud(CAN), grasp=held()))
    assert fine.touch is not None
    high = replace(fine, id="", touch=replace(fine.touch, values=fine.touch.values + 1e6))
    with pytest.raises(DatasetError, match=r"sample 0 \(mug\): touch: p_a\[0\]: .* is not between 0 and 4000 counts"):
        ft.write(tmp_path / "b", [high], pads)
    large = replace(fine, id="", cloud=ft.Cloud(10.0 * CAN - [0.0, 0.0, 8.0]))
    with pytest.raises(DatasetError, match="more than max_extent_m"):
        ft.write(tmp_path / "b", [large], pads)
    assert ft.write(tmp_path / "b", [large], pads, limits=ObjectLimits(max_extent_m=2.0)).samples == 1


REFUSED: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "a finger is missing": (lambda one: one["values"].pop("P_B"), "values: P_B of pads are missing"),
    "an unknown finger": (lambda one: one["values"].update(P_C=1), "values: 'P_C' is not one of P_A, P_B"),
    "fewer taxels": (lambda one: one["values"].update(P_A=one["values"]["P_A"][:, :2]), r"P_A: shape \(100, 2\) is not"),
    "fewer readings": (lambda one: one["values"].update(P_B=one["values"]["P_B"][:99]), r"P_B: shape \(99, 3\) is not"),
    "another unit": (lambda one: one["values"].update(P_A=one["values"]["P_A"] * 1e3), "not between 0 and 4000 counts, as most of P_A"),
    "text": (lambda one: one["values"].update(P_A=[["x"] * 3] * 100), r"values: P_A: .* is not of numbers: texts"),
    "a list": (lambda one: one.update(values=np.zeros((100, 6))), "values: give a mapping of P_A, P_B"),
    "others of another length": (lambda one: one.update(others={"a": [1, 2]}), "others: a: 2 numbers are not 100 readings"),
    "an outcome": (lambda one: one.update(outcome="held"), "outcome: 'held' is not one of success, failure, unknown"),
    "a key": (lambda one: one.update(stamp=3), "got an unexpected keyword argument 'stamp'"),
    "no object": (lambda one: one.pop("object"), "missing 1 required keyword-only argument: 'object'"),
    "a slash": (lambda one: one.update(object="a/b"), "object: 'a/b' is not a plain name"),
    "no stamps": (lambda one: one.pop("stamps_s"), "stamps_ns, stamps_s, rate_hz: give one of them, not none"),
    "two stamps": (lambda one: one.update(rate_hz=50.0), "give one of them, not stamps_s and rate_hz"),
    "rest beyond the end": (lambda one: one.update(rest=9999), r"rest: 9999 readings without contact are more than all \d+"),
    "rest below 0": (lambda one: one.update(rest=-1), "rest: -1 is not a number of readings"),
    "an array as cloud": (lambda one: one.update(cloud=np.zeros((3, 3))), "cloud, grasp: are not a Cloud"),
    "a start that is no time": (lambda one: one.update(start_s=np.nan), "start_s: nan is not finite"),
    "a rate of 0": (lambda one: one.update(rate_hz=one.pop("stamps_s")[0] * 0), "rate_hz: 0.0 is not above 0"),
    "complex numbers": (lambda one: one["values"].update(P_A=one["values"]["P_A"] * 1j), "P_A: .* is not of numbers: complex numbers"),
    "a number beyond float64": (lambda one: one["values"].update(P_A=[[10**400] * 3] * 100), "P_A: .* a number is too large"),
    "rows of several lengths": (lambda one: one["values"].update(P_A=[[1.0], [1.0, 2.0]]), "P_A: .* rows of different lengths"),
    "times for numbers": (lambda one: one["values"].update(P_A=np.zeros((100, 3), "datetime64[s]")), "P_A: .* is not of numbers: times"),
    "a start that is text": (lambda one: one.update(start_s="now"), "start_s: now is not of numbers: texts"),
    "a cloud in millimetres": (lambda one: one.update(cloud=ft.Cloud(1e3 * CAN)), "cloud: xyz: the object is .* away.*is it in metres"),
    "a cloud of a scene": (lambda one: one.update(cloud=ft.Cloud(CAN * [20.0, 1.0, 1.0])), "cloud: xyz: the object extends 2 m, more than max_extent_m"),
    "a grasp in millimetres": (lambda one: one.update(cloud=ft.Cloud(CAN), grasp=held(1e3)), "grasp: g1, g2: 70 m apart"),
    "a grasp of another place": (lambda one: one.update(cloud=ft.Cloud(CAN), grasp=held(1.0, 30.0)), "grasp: g1: .* m from the object"),
    "a grasp in another frame": (lambda one: one.update(cloud=ft.Cloud(CAN), grasp=held(1.0, 0.5)), "grasp: g1: .* m from the object.*; are both in metres and in one frame"),
    "a table in millimetres": (lambda one: one.update(cloud=ft.Cloud(CAN), table=ft.Plane([0, 0, 1], -900.0)), "plane: is 900 m away"),
    "a grasp without a rotation": (lambda one: one.update(grasp=ft.Grasp([0, 0.07, 0.9], [0, 0, 0.9])), "grasp: rotation: is not given"),
    "others that are no mapping": (lambda one: one.update(others=3), "others: 3 is not a mapping"),
    "a list as outcome": (lambda one: one.update(outcome=[True]), r"outcome: \[True\] is not one of success"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_fit_is_named_and_leaves_nothing_behind(tmp_path: Path, pads: Path, name: str) -> None:
    change, rule = REFUSED[name]
    one = grasp()
    change(one)
    with pytest.raises(DatasetError, match=rf"^sample 1 .*{rule}"):
        ft.write(tmp_path / "ds", [grasp(id="first"), one], pads)
    assert not (tmp_path / "ds").exists()


@pytest.mark.parametrize("samples", [[], iter(())])
def test_no_samples_are_refused_and_make_no_dataset(tmp_path: Path, pads: Path, samples: Any) -> None:
    with pytest.raises(DatasetError, match=r"samples: there is none to write to .*ds; pass at least one"):
        ft.write(tmp_path / "ds", samples, pads)
    assert not (tmp_path / "ds").exists()


@pytest.mark.parametrize(
    ("samples", "given", "rule"),
    [
        (None, {}, "samples: NoneType is neither a dataset, such as open\\(PATH\\), nor a list"),
        ("session", {}, "sample 0: str is neither a Sample nor a mapping; pass a list of them, or a dataset"),
        ({"object": "mug"}, {}, "sample 0: str is neither a Sample nor a mapping"),
        ([{}], {"hand": "shadow"}, 'hand: shadow is not a mapping, such as {"name": "mine"}'),
    ],
)
def test_what_is_no_list_of_samples_is_named(tmp_path: Path, pads: Path, samples: Any, given: Any, rule: str) -> None:
    with pytest.raises(DatasetError, match=rule):
        ft.write(tmp_path / "ds", samples, pads, **given)
    assert not (tmp_path / "ds").exists()


def failing(error: BaseException) -> Any:
    """Two grasps, then an error of the caller's own."""
    yield from (grasp(id="1"), grasp(id="2"))
    raise error


@pytest.mark.parametrize("exists", [False, True])
def test_an_extension_is_there_as_a_whole_or_not_at_all(tmp_path: Path, pads: Path, exists: bool) -> None:
    path = tmp_path / "ds"
    if exists:
        ft.write(path, [grasp(id="0")], pads)
    before = snapshot(path)
    broken: list[tuple[Any, type[BaseException], str]] = [
        ([grasp(id="1"), grasp(id="2", rest=-1)], DatasetError, r"sample 1 \(mug/2\): rest: -1"),
        (
            [grasp(id="1"), grasp(id="1")],
            DatasetError,
            r"id mug/1 is taken: give another id, or write to another dataset",
        ),
        ([grasp(id="1"), 5], DatasetError, "sample 1: int is neither"),
        (failing(ValueError("of the caller")), ValueError, "of the caller"),
        (failing(FileNotFoundError(2, "absent", "table.csv")), FileNotFoundError, r"table\.csv"),
        (failing(KeyboardInterrupt("pressed")), KeyboardInterrupt, "pressed"),
        (failing(SystemExit(3)), SystemExit, "3"),
    ]
    for samples, kind, rule in broken:
        with pytest.raises(kind, match=rule):
            ft.write(path, samples, pads)
        assert snapshot(path) == before
    with pytest.raises(FileError, match=r"ds: disk almost full: less than 1e\+09 MB would be left: nothing was added"):
        ft.write(path, [grasp(id="1")], pads, min_free_mb=1e9)
    assert snapshot(path) == before
    corrected = written(path, pads, grasp(id="1"), grasp(id="2"), min_free_mb=0.0)
    assert [sample.id for sample in corrected] == ["mug/0"] * exists + ["mug/1", "mug/2"]


def test_a_write_that_fails_in_an_empty_folder_leaves_it_open_for_another_sensor(tmp_path: Path, pads: Path) -> None:
    (tmp_path / "ds").mkdir()
    with pytest.raises(DatasetError, match="rest: -1"):
        ft.write(tmp_path / "ds", [grasp(rest=-1)], pads, hand={"name": "wrong"})
    assert [sample.id for sample in written(tmp_path / "ds", pads, grasp())] == ["mug/7"]


def test_an_import_into_a_dataset_is_there_as_a_whole_or_not_at_all(tmp_path: Path, pads: Path) -> None:
    source, path = tmp_path / "source", tmp_path / "ds"
    ft.write(source, [grasp(id=str(k)) for k in range(3)], pads)
    ft.write(path, [grasp(id="2")], pads)  # which the last one of the source has, too
    before = snapshot(path)
    with pytest.raises(DatasetError, match="id mug/2 is taken"):
        import_samples(source, path)
    assert snapshot(path) == before


def test_the_session_of_a_writer_that_was_killed_is_removed_by_the_next(tmp_path: Path, pads: Path) -> None:
    path = tmp_path / "ds"
    ft.write(path, [grasp(id="0")], pads)
    child = os.fork()
    if not child:
        ft.write(path, failing_hard(), pads)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    assert sorted(file.name for file in path.glob("session-*")) == ["session-0001.mcap", "session-0002.mcap.part"]
    assert [sample.id for sample in open_samples(path)] == ["mug/0"]
    assert [sample.id for sample in written(path, pads, grasp(id="1"))] == ["mug/0", "mug/1"]
    assert [*path.glob("*.part")] == []


def failing_hard() -> Any:
    """One grasp, then the end of the process."""
    yield grasp(id="1")
    os._exit(9)


def snapshot(path: Path) -> dict[str, bytes]:
    """The files of a dataset; none if it does not exist, and no folder is left beside it."""
    assert not path.with_name(f".{path.name}.part").exists()
    return {file.name: file.read_bytes() for file in path.glob("*") if file.name != ".lock"}


def _csv(path: Path, columns: dict[str, Any]) -> dict[str, Any]:
    import pandas as pd

    pd.DataFrame(columns).to_csv(path, index=False)
    return dict(pd.read_csv(path))


def _parquet(path: Path, columns: dict[str, Any]) -> dict[str, Any]:
    import pandas as pd

    pd.DataFrame(columns).to_parquet(path)
    return dict(pd.read_parquet(path))


def _hdf5(path: Path, columns: dict[str, Any]) -> dict[str, Any]:
    """In groups, as robomimic and ALOHA store them."""
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    with h5py.File(path, "w") as file:
        for name, column in columns.items():
            file.create_dataset(f"data/demo_0/obs/{name}", data=column)
    with h5py.File(path) as file:
        return {name: file[f"data/demo_0/obs/{name}"][:] for name in columns}


@pytest.mark.filterwarnings("ignore:no_contact")
@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_table_gives_the_numbers_in_it(tmp_path_factory: Any, data: Any) -> None:
    """Formats, types of numbers, units of stamps, and taxels as columns or as arrays of two or three dimensions, in all combinations."""
    folder = tmp_path_factory.mktemp("table")
    (folder / "pads.yaml").write_text(yaml.safe_dump(SENSOR))
    store = data.draw(st.sampled_from([_csv, _parquet, _hdf5]))
    kind = data.draw(st.sampled_from([np.uint16, np.int32, np.float32, np.float64]))
    rows = pressed(40, 30, seed=data.draw(st.integers(0, 9))).astype(kind)
    form = data.draw(st.sampled_from(["columns", "array", "three dimensions"] if store is _hdf5 else ["columns"]))
    unit = data.draw(st.sampled_from(["ns", "s"]))
    stamps = {"ns": 1_795_600_800_000_000_000 + 10_000_000 * np.arange(40), "s": START_S + 0.01 * np.arange(40)}[unit]
    columns = {f"c{k}": rows[:, k] for k in range(6)} if form == "columns" else {"array": rows}
    if form == "three dimensions":
        columns = {"array": rows.reshape(40, 2, 3)}
    read = store(folder / "table", {"stamp": stamps, **columns})
    taxels = np.stack([read[f"c{k}"] for k in range(6)], axis=-1) if form == "columns" else read["array"].reshape(40, 6)
    (record,) = written(
        folder / "ds",
        folder / "pads.yaml",
        grasp(taxels, **{f"stamps_{unit}": read["stamp"]} | ({} if unit == "s" else {"stamps_s": None})),
    )
    assert_array_equal(record.series.counts, rows)
    assert np.abs(record.series.stamps_ns - (1_795_600_800_000_000_000 + 10_000_000 * np.arange(40))).max() < 500


@pytest.mark.parametrize(
    ("file", "rule"),
    [("meta/info.json", "is a LeRobot dataset .*import_lerobot"), ("a/b.csv", "holds tables: read them with pandas")],
)
def test_a_source_that_is_not_imported_names_what_reads_it(tmp_path: Path, file: str, rule: str) -> None:
    (tmp_path / "source" / file).parent.mkdir(parents=True)
    (tmp_path / "source" / file).write_text("{}")
    with pytest.raises(FileError, match=rule):
        import_samples(tmp_path / "source", tmp_path / "ds")


def run_example(name: str, source: Path, out: Path, monkeypatch: Any) -> list[Sample]:
    monkeypatch.setattr(sys, "argv", [name, str(source), str(out)])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    return list(open_samples(out))


def test_examples_are_short() -> None:
    for path in EXAMPLES.glob("import_*.py"):
        assert len(path.read_text().splitlines()) <= 35, path


def test_the_example_of_a_gripper_reads_a_folder_of_it(
    tmp_path: Path, monkeypatch: Any, rng: np.random.Generator
) -> None:
    """Made up in the form of OSU-RAD-Lab/Tactile_Grasp_Dataset."""
    folder = tmp_path / "Data/cube/large/soft/flat/left/10/1600000000.5"
    folder.mkdir(parents=True)
    rows = rng.integers(200, 210, (200, 14)) + 300 * (np.arange(200) >= 100)[:, None]
    names = ["time_s", *(f"{finger}{k}" for finger in "LR" for k in range(7))]
    lines = [",".join(names), *(f"{0.05 * k:.2f}," + ",".join(map(str, row)) for k, row in enumerate(rows))]
    (folder / "gripper_tactor_tactor_data.csv").write_text("\n".join(lines))
    (folder / "grasp_outcome.txt").write_text("SUCCESS\n")
    (record,) = run_example("import_osu_grasps", tmp_path, tmp_path / "ds", monkeypatch)
    assert (record.id, record.outcome) == ("cube large soft/1600000000.5", "success")
    assert_array_equal(record.series.counts, rows)
    assert record.series.stamps_ns[[0, 1]].tolist() == [1_600_000_000_500_000_000, 1_600_000_000_550_000_000]
    assert record.contact_ns == 1_600_000_005_500_000_000


def test_the_example_of_lerobot_reads_what_the_export_writes(tmp_path: Path, monkeypatch: Any) -> None:
    from recording_builders import write_grasps

    from foretouch.dataset.formats import export_samples

    write_grasps(tmp_path / "recording")
    export_samples(tmp_path / "recording", tmp_path / "exported", "lerobot")
    wanted = [record.readings for record in open_samples(tmp_path / "exported") if record.touch is not None]
    found = run_example("import_lerobot", tmp_path / "exported", tmp_path / "ds", monkeypatch)
    assert wanted
    for one, other in zip(wanted, found, strict=True):
        assert_array_equal(other.series.counts, one.counts)


PUBLIC = {  # folder below FORETOUCH_DATA: example, samples, readings
    "biotacsp-stability-set-v2": ("import_biotac_sp_stability", 5831, 5831),
    "tactile_prediction_flat_dataset": ("import_xela_uskin", 75, 52645),
    "icub_grasp_dataset": ("import_icub_fingertips", 230, 2883),
}


@pytest.mark.filterwarnings("ignore:no_contact")
@pytest.mark.parametrize("folder", PUBLIC)
def test_the_public_recordings_are_written_whole(tmp_path: Path, folder: str, monkeypatch: Any) -> None:
    root = Path(os.environ.get("FORETOUCH_DATA", "/nowhere")) / folder
    if not root.is_dir():
        pytest.skip(f"FORETOUCH_DATA holds no {folder}")
    name, samples, count = PUBLIC[folder]
    records = run_example(name, root, tmp_path / "ds", monkeypatch)
    assert (len(records), sum(1 if one.series is None else len(one.series.counts) for one in records)) == (
        samples,
        count,
    )
    total = np.zeros(2)
    for record in records:
        values = record.series.counts if record.series is not None else record.touch.values[None]  # noqa: PD011
        total += values.astype(np.float64).sum(), np.square(values.astype(np.float64)).sum()
    assert_array_equal(total, raw_sums(root, folder))


def raw_sums(root: Path, folder: str) -> Any:
    """Sum and sum of squares of all taxels, by another reader of the files; whole numbers, so in any order."""
    if folder.startswith("icub"):
        texts = [path.read_text().split("\n", 1)[1].split() for path in root.glob("iCubGraspDataset/*.txt")]
        parts = [np.array(text, float).reshape(-1, 74)[:, 14:] for text in texts]
    elif folder.startswith("biotac"):
        parts = [np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(2, 74)) for path in root.glob("*.csv")]
    else:
        parts = []
        for robot in root.glob("*/*/robot_state.csv"):
            count = sum(1 for line in robot.open() if line.strip()) - 1
            parts += [
                np.loadtxt(robot.parent / f"xela_sensor{k}.csv", delimiter=",", skiprows=1)[:count] for k in (1, 2)
            ]
    return np.array([sum(part.sum() for part in parts), sum(np.square(part).sum() for part in parts)])
