# SPDX-License-Identifier: Apache-2.0
"""Tables by a map: values equal those of the file, in every format; what does not fit is named by file, row and column."""

import csv
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from numpy.testing import assert_array_equal

from foretouch.dataset.importing import import_samples
from foretouch.dataset.mapping import MapConfig
from foretouch.dataset.record import HOLD, REST, SampleRecord
from foretouch.dataset.samples import open_samples
from foretouch.dataset.sensor_check import compare_sensor
from foretouch.errors import ConfigError, FileError, ForetouchError
from foretouch.tactile.description import load_sensor
from foretouch.tactile.messages.table import TactileConfig
from foretouch.types import NO_CLOUD
from foretouch_lab.dataset.store_writer import build_store

MAPS = Path(__file__).parents[2] / "examples" / "maps"
SENSOR: dict[str, Any] = {
    "name": "pads",
    "fingers": [{"name": "A"}, {"name": "B"}],
    "array": {"rows": 1, "cols": 3, "size": [0.01, 0.01]},
    "values": [{"name": "P", "field": "p", "dtype": "uint16", "range": [0, 4000], "contact": "rise", "noise": 2.0}],
    "source": {"type": "table/Rows"},
}
MAP: dict[str, Any] = {
    "sensor": "pads.yaml",
    "table": {"file": "{object}_{id}.csv"},
    "id": "{id}",
    "values": [
        {"finger": "A", "channel": "P", "unit": "counts", "columns": ["a{0..2}"]},
        {"finger": "B", "channel": "P", "columns": ["b2", "b1", "b0"]},
    ],
    "others": ["angle"],
    "outcome": {"column": "label", "success": ["held"], "failure": ["fell"]},
    "stamps": {"column": "t", "unit": "ms", "start": "2026-11-25 10:00:00"},
    "rest_rows": 20,
}
NAMES = ["t", "a0", "a1", "a2", "b0", "b1", "b2", "angle", "label", "grasp"]
START_NS = 1_795_600_800_000_000_000  # 2026-11-25 10:00:00 UTC, by `date -u -d '2026-11-25 10:00:00' +%s`


def rows(count: int = 100, seed: int = 0, contact: int = 40) -> list[list[Any]]:
    """Readings every 10 ms, of which those from `contact` on are pressed."""
    rng = np.random.default_rng(seed)
    found: list[list[Any]] = []
    for k in range(count):
        values = 1000 + rng.integers(-3, 4, 6) + (400 if k >= contact else 0)
        found.append([10 * k, *values.tolist(), round(0.1 * k, 3), "held", k // 50])
    return found


def write_csv(path: Path, lines: list[list[Any]], names: list[str] | None = None) -> None:
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([names or NAMES, *lines])


def write_map(folder: Path, **changes: Any) -> Path:
    (folder / "pads.yaml").write_text(yaml.safe_dump(SENSOR))
    (folder / "map.yaml").write_text(yaml.safe_dump({**MAP, **changes}))
    return folder / "map.yaml"


def imported(folder: Path, source: Path, **changes: Any) -> list[SampleRecord]:
    out = folder / "ds"
    import_samples(source, out, map_file=write_map(folder, **changes))
    return list(open_samples(out).records())


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "source"
    folder.mkdir()
    write_csv(folder / "red_can_7.csv", rows())
    return folder


def test_a_file_is_a_grasp_whose_values_equal_those_in_it(tmp_path: Path, source: Path) -> None:
    (record,) = imported(tmp_path, source)
    assert record.sample.id == "red_can/7"
    assert record.outcome == "success"
    assert record.sample.cloud.size == NO_CLOUD.size == 0
    assert record.series is not None
    with (source / "red_can_7.csv").open(newline="") as file:
        raw = list(csv.DictReader(file))
    wanted = np.array([[float(one[k]) for k in ("a0", "a1", "a2", "b2", "b1", "b0")] for one in raw], np.float32)
    assert_array_equal(record.series.counts, wanted)
    assert_array_equal(record.series.others["angle"], np.array([float(one["angle"]) for one in raw], np.float32))
    assert_array_equal(record.series.stamps_ns, START_NS + 10_000_000 * np.arange(100))
    assert record.contact_ns == START_NS + 400_000_000  # of the first reading with contact
    assert set(np.flatnonzero(record.series.phases == HOLD)) == set(range(70, 100))  # 0.3 s later
    assert_array_equal(np.flatnonzero(record.series.phases == REST), np.arange(20))
    assert record.sample.touch is not None
    assert_array_equal(record.sample.touch.values, np.median(wanted[70:].astype(float), axis=0))
    assert record.sample.tare is not None
    assert_array_equal(record.sample.tare.values, np.median(wanted[:20].astype(float), axis=0))


def test_rows_or_a_column_separate_grasps_also_across_blocks(tmp_path: Path, source: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("foretouch.dataset.tables._BLOCK", 1000)
    found = imported(tmp_path, source, grasp="grasp", id="{grasp}", outcome={})
    assert [one.sample.id for one in found] == ["red_can/0", "red_can/1"]
    assert [len(one.series.stamps_ns) for one in found if one.series] == [50, 50]
    folder = tmp_path / "by_row"
    folder.mkdir()
    single = imported(folder, source, grasp="row", id="", rest_rows=0)
    assert len(single) == 100
    assert [one.sample.touch.values[0] for one in single if one.sample.touch] == [row[1] for row in rows()]
    assert single[3].sample.extra == {"angle": np.float32(0.3)}
    assert single[3].note == "red_can_7.csv, row 4"


def _parquet(path: Path, table: dict[str, Any]) -> None:
    pq.write_table(pa.table(table), path.with_suffix(".parquet"), row_group_size=30)


def _npz(path: Path, table: dict[str, Any]) -> None:
    np.savez(path.with_suffix(".npz"), **table)


def _hdf5(path: Path, table: dict[str, Any]) -> None:
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    with h5py.File(path.with_suffix(".h5"), "w") as file:
        for name, column in table.items():
            file[name] = column.astype("S") if column.dtype.kind == "U" else column


@pytest.mark.parametrize("write", [_parquet, _npz, _hdf5])
def test_other_formats_give_the_same_samples(tmp_path: Path, source: Path, write: Callable[..., None]) -> None:
    (wanted,) = imported(tmp_path, source)
    table = {name: np.array(column) for name, column in zip(NAMES, zip(*rows(), strict=True), strict=True)}
    other = tmp_path / "other"
    other.mkdir()
    write(other / "red_can_7.csv", table)
    (file,) = other.iterdir()
    folder = tmp_path / "map"
    folder.mkdir()
    (found,) = imported(folder, other, table={"file": f"{{object}}_{{id}}{file.suffix}"})
    assert found.series is not None
    assert wanted.series is not None
    assert_array_equal(found.series.counts, wanted.series.counts)
    assert_array_equal(found.series.stamps_ns, wanted.series.stamps_ns)
    assert found.outcome == "success"


def test_arrays_of_two_dimensions_are_numbered_columns(tmp_path: Path, source: Path) -> None:
    values = np.array([row[1:7] for row in rows()])
    np.savez(source / "cup_1.npz", a=values[:, :3], b=values[:, 3:], t=10 * np.arange(100))
    columns = [
        {"finger": "A", "channel": "P", "columns": ["a[{0..2}]"]},
        {"finger": "B", "channel": "P", "columns": ["b[{0..2}]"]},
    ]
    (found,) = imported(tmp_path, source, table={"file": "{object}_{id}.npz"}, values=columns, others=[], outcome={})
    assert found.series is not None
    assert_array_equal(found.series.counts, values)
    columns[1]["columns"] = ["b[{1..3}]"]
    with pytest.raises(FileError, match=r"cup_1.npz: column b\[3\]: is of an array of shape \(100, 3\)"):
        imported(tmp_path, source, table={"file": "{object}_{id}.npz"}, values=columns, others=[], outcome={})


def test_lists_in_a_column_of_parquet_are_numbered_columns_and_must_be_of_one_length(tmp_path: Path) -> None:
    """As LeRobot stores the taxels of a finger: taxels x axes in each row."""
    found = rows()
    table = {name: [line[k] for line in found] for k, name in enumerate(NAMES)}
    table["pad"] = [[[value] for value in line[1:4]] for line in found]
    source = tmp_path / "source"
    source.mkdir()
    values = [{"finger": "A", "channel": "P", "columns": ["pad[{0..2}]"]}, MAP["values"][1]]
    changes: dict[str, Any] = {"table": {"file": "{object}_{id}.parquet"}, "values": values}
    pq.write_table(pa.table(table), source / "cup_a.parquet")
    (record,) = imported(tmp_path, source, **changes)
    assert record.series is not None
    assert_array_equal(record.series.counts[:, :3], np.array([line[1:4] for line in found], np.float32))
    table["pad"] = [*table["pad"][:-2], [[1]] * 4, [[1]] * 2]
    pq.write_table(pa.table(table), source / "cup_a.parquet")
    with pytest.raises(FileError, match=r"cup_a\.parquet.*column pad.*lists of several lengths"):
        import_samples(source, tmp_path / "ds2", map_file=write_map(tmp_path, **changes))


def test_files_beside_are_joined_by_row_and_missing_rows_are_counted(tmp_path: Path, source: Path) -> None:
    write_csv(source / "robot.csv", [[k] for k in range(99)], ["joint"])
    write_csv(source / "facts.csv", [["mug", 50]], ["thing", "hz"])
    changes = {
        "table": {"file": "red_can_{id}.csv"},
        "beside": [{"file": "robot.csv"}, {"file": "facts.csv"}],
        "object": "{facts.csv:thing}",
        "others": ["robot.csv:joint"],
        "stamps": {"rate": "{facts.csv:hz}"},
    }
    with pytest.raises(FileError, match=r"robot.csv: holds 99 rows, and red_can_7.csv 100"):
        imported(tmp_path, source, **changes)
    result = import_samples(source, tmp_path / "ds", map_file=write_map(tmp_path, **changes, spare_rows=1))
    assert (result.samples, result.readings, dict(result.left_out)) == (1, 99, {"rows that robot.csv lacks": 1})
    (record,) = open_samples(tmp_path / "ds").records()
    assert record.series is not None
    assert (record.sample.object, record.flags) == ("mug", ("stamped_by_rate",))
    assert_array_equal(record.series.others["joint"], np.arange(99))
    assert_array_equal(np.diff(record.series.stamps_ns), 20_000_000)


def test_lines_that_make_one_row_are_joined(tmp_path: Path, source: Path) -> None:
    text = "-1\n" + "".join(
        f"{row[0]} {row[7]}\n{row[1]} {row[2]} {row[3]}\n{row[4]} {row[5]}  {row[6]}\n" for row in rows()
    )
    (source / "cup_1.txt").write_text(text)
    values = [
        {"finger": "A", "channel": "P", "columns": ["f{2..4}"]},
        {"finger": "B", "channel": "P", "columns": ["f{5..7}"]},
    ]
    changes: dict[str, Any] = {
        "values": values,
        "others": ["f1"],
        "outcome": {},
        "stamps": {"column": "f0", "unit": "ms"},
    }
    table = {"file": "{object}_{id}.txt", "header": False, "separator": "space", "skip": 1, "lines": 3}
    (found,) = imported(tmp_path, source, table=table, **changes)
    assert found.series is not None
    assert_array_equal(found.series.counts, [row[1:7] for row in rows()])
    (source / "cup_1.txt").write_text(text + "1 2\n")
    with pytest.raises(FileError, match=r"cup_1.txt: row 101: ends after 1 of 3 lines"):
        imported(tmp_path, source, table=table, **changes)


def _cell(row: int, name: str, value: Any) -> Callable[[list[list[Any]]], None]:
    def _set(lines: list[list[Any]]) -> None:
        lines[row - 1][NAMES.index(name)] = value

    return _set


FAULTS: dict[str, tuple[Callable[[list[list[Any]]], Any], str]] = {
    "text": (_cell(7, "a1", "1o00"), "row 7, column a1: '1o00' is not a number"),
    "empty cell": (_cell(61, "angle", ""), "row 61, column angle: nan is not a finite number"),
    "stamps": (_cell(5, "t", 25), "row 1: column t: goes back by 0.005 s in row 5"),
    "fewer taxels": (lambda lines: lines[29].pop(), "row 30: holds 9 values, not 10"),
    "label": (_cell(1, "label", "lost"), "row 1, column label: changes within a grasp"),
    "no rows": (lambda lines: lines.clear(), "holds no rows"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_faulty_file_is_refused_with_row_and_column(tmp_path: Path, source: Path, name: str) -> None:
    lines, (change, rule) = rows(), FAULTS[name]
    change(lines)
    write_csv(source / "red_can_7.csv", lines)
    with pytest.raises(FileError) as caught:
        imported(tmp_path, source)
    assert str(caught.value) == f"{source / 'red_can_7.csv'}: {rule}"
    assert not (tmp_path / "ds").exists()


def test_columns_that_are_missing_or_occur_twice_and_an_empty_file_are_refused(tmp_path: Path, source: Path) -> None:
    file = source / "red_can_7.csv"
    for names, rule in (
        ([*NAMES[:3], "a9", *NAMES[4:]], r"column a2: is missing: 'a2' is not one of t, a0.*"),
        ([*NAMES[:3], "a1", *NAMES[4:]], "column a1: occurs 2 times"),
        ([*NAMES[:7], "x", "x", "x"], "column angle: is missing"),
    ):
        write_csv(file, rows(), names)
        with pytest.raises(FileError, match=rule):
            imported(tmp_path, source)
    write_csv(file, [[*row, 1, 2] for row in rows()], [*NAMES, "", ""])  # columns that nobody names may be equal
    assert len(imported(tmp_path, source)) == 1
    file.write_text("")
    (tmp_path / "none").mkdir()
    with pytest.raises(FileError, match=r"red_can_7.csv: is empty"):
        imported(tmp_path / "none", source)


def test_other_units_are_refused_by_the_map_or_by_the_range(tmp_path: Path, source: Path) -> None:
    values = [{**MAP["values"][0], "unit": "N"}, MAP["values"][1]]
    with pytest.raises(ConfigError, match=r"map.yaml: values: P_A: 3 columns in N, and pads has 3 values in counts"):
        imported(tmp_path, source, values=values)
    write_csv(source / "red_can_7.csv", [[row[0], *(1000.0 * one for one in row[1:7]), *row[7:]] for row in rows()])
    with pytest.raises(
        FileError, match=r"row 1, column a0: .* is not between 0 and 4000 counts, as most of P_A: another unit\?"
    ):
        imported(tmp_path, source)


def test_a_single_taxel_out_of_range_is_imported_and_flagged(tmp_path: Path, source: Path) -> None:
    lines = rows()
    for row in lines:
        row[1] = 65535
    write_csv(source / "red_can_7.csv", lines)
    (record,) = imported(tmp_path, source)
    assert record.flags == ("out_of_range",)
    assert record.series is not None
    assert (record.series.counts[:, 0] == 65535).all()


def test_no_file_outside_of_the_source_is_read(tmp_path: Path, source: Path) -> None:
    for file in ("../secret.csv", "/etc/passwd", "a/../../b.csv", ""):
        with pytest.raises(ConfigError, match="is not a path in the source"):
            imported(tmp_path, source, table={"file": file})
    write_csv(tmp_path / "secret_1.csv", rows())
    (source / "cup_1.csv").symlink_to(tmp_path / "secret_1.csv")
    with pytest.raises(FileError, match=r"cup_1.csv: is a link out of the source"):
        imported(tmp_path, source)
    with pytest.raises(FileError, match="holds no file"):
        imported(tmp_path, source, table={"file": "{object}.tsv"})


def test_a_map_that_does_not_fit_the_sensor_is_refused(tmp_path: Path, source: Path) -> None:
    first, second = MAP["values"]
    for changes, rule in (
        ({"values": [first]}, "values: no columns of P_B"),
        ({"values": [first, second, second]}, "values: P_B occurs twice"),
        (
            {"values": [{**first, "columns": ["a0"]}, second]},
            "values: P_A: 1 columns in counts, and pads has 3 values in counts",
        ),
        ({"values": [{**first, "finger": "C"}, second]}, "values: 'P_C' is not one of P_A, P_B"),
        ({"stamps": {}}, "stamps: a series needs a column or a rate"),
        ({"grasp": "grasp", "beside": [{"file": "x.csv"}]}, "beside: needs `grasp: file`"),
        ({"colums": 1}, "colums: unknown setting"),
    ):
        with pytest.raises(ConfigError, match=re.escape(rule)):
            imported(tmp_path, source, **changes)


def test_a_grasp_that_does_not_fit_into_memory_is_refused(tmp_path: Path, source: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("foretouch.dataset.mapping._MOST_CELLS", 500)
    with pytest.raises(FileError, match="row 1: more than 500 numbers in one grasp: set `grasp`"):
        imported(tmp_path, source)


MEASURE = """
import sys
from pathlib import Path
from foretouch.dataset.importing import import_samples
import_samples(Path(sys.argv[1]), Path(sys.argv[2]), map_file=Path(sys.argv[3]))
# Not `ru_maxrss`, which a child inherits from the process that starts it.
print(int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) // 1024)
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_the_number_of_rows(tmp_path: Path) -> None:
    map_file = write_map(tmp_path, grasp="grasp", id="{grasp}", outcome={}, rest_rows=0)
    block = "".join(",".join(map(str, row[:9])) + ",GRASP\n" for row in rows(1000))
    used = []
    for count in (100, 1000):
        folder = tmp_path / str(count)
        folder.mkdir()
        with (folder / "cup_1.csv").open("w") as file:
            file.write(",".join(NAMES) + "\n")
            file.writelines(block.replace("GRASP", str(k)) for k in range(count))
        command = [sys.executable, "-c", MEASURE, str(folder), str(tmp_path / f"ds{count}"), str(map_file)]
        used.append(int(subprocess.run(command, capture_output=True, check=True, text=True).stdout))  # [MB]
    assert used[1] < used[0] + 60  # blocks that are read ahead; the table alone takes 72 MB
    assert used[1] < 300


def test_a_recording_of_three_fingers_is_stored_but_not_read_from_messages(tmp_path: Path, source: Path) -> None:
    three = {**SENSOR, "fingers": [{"name": name} for name in "ABC"], "grasp": ["A", "B", "C"]}
    values = [*MAP["values"], {"finger": "C", "channel": "P", "columns": ["a0", "a0", "b1"]}]
    map_file = write_map(tmp_path, values=values)
    (tmp_path / "pads.yaml").write_text(yaml.safe_dump(three))
    import_samples(source, tmp_path / "ds", map_file=map_file)
    (record,) = open_samples(tmp_path / "ds").records()
    assert record.series is not None
    assert_array_equal(record.series.counts[:, 6:], [[row[1], row[1], row[5]] for row in rows()])
    assert build_store([tmp_path / "ds"], tmp_path / "store").samples[0].labelled
    with pytest.raises(ConfigError, match="pads: grasp: A, B, C are not two fingers"):
        _ = TactileConfig(sensor=str(tmp_path / "pads.yaml")).described


def test_a_description_is_compared_with_what_was_recorded(tmp_path: Path, source: Path) -> None:
    lines = rows(400, contact=300)
    for k, row in enumerate(lines):
        row[1], row[4] = 0, 4001 if k == 350 else row[4]  # a0 is dead, b0 exceeds the range once
    for k in (1, 2):
        for row in lines[:300]:
            row[3] = 1000 + 30 * k + int(row[2] > 1000)
        write_csv(source / f"red_can_{k}.csv", lines)
    (source / "red_can_7.csv").unlink()
    imported(tmp_path, source, rest_rows=300)
    found = compare_sensor(load_sensor(tmp_path / "pads.yaml"), tmp_path / "ds")
    assert (found["grasps"], found["readings"]) == (2, 800)
    assert found["rate_hz"] == pytest.approx(100.0)
    assert found["modalities"]["P_A"]["dead"] == found["modalities"]["P_A"]["saturated"] == [0]
    assert found["modalities"]["P_B"]["outside"] == 2
    column = np.array([row[2] for row in lines[:300]])
    assert found["modalities"]["P_B"]["noise"] == pytest.approx(column.std(), rel=0.1)  # uniform whole numbers: 2.0
    assert ["A: dead", "[]", "[0]"] in found["corrections"]
    assert ["P: range", "[0.0, 4000.0]", "[0.0, 4001.0]"] in found["corrections"]


@pytest.mark.parametrize(
    "path", sorted(path for path in MAPS.glob("*.yaml") if "table:" in path.read_text()), ids=lambda path: path.stem
)
def test_the_maps_of_the_examples_are_short_and_fit_their_sensors(tmp_path: Path, path: Path) -> None:
    text = path.read_text()
    assert len(text.splitlines()) < 40
    MapConfig.from_mapping(yaml.safe_load(text), path.name)
    with pytest.raises(ForetouchError, match="holds no file"):
        import_samples(tmp_path, tmp_path / "ds", map_file=path)


PUBLIC = {  # folder below FORETOUCH_DATA: map, samples, readings and what is left out
    "biotacsp-stability-set-v2": ("biotac_sp_stability", 5831, 5831, {}),
    "tactile_prediction_flat_dataset": ("xela_uskin_flat", 75, 52645, {"rows that robot_state.csv lacks": 19}),
    "icub_grasp_dataset": ("icub_fingertips", 230, 2883, {}),
}


@pytest.mark.parametrize("folder", PUBLIC)
def test_the_public_recordings_are_imported_whole(tmp_path: Path, folder: str) -> None:
    root = Path(os.environ.get("FORETOUCH_DATA", "/nowhere")) / folder
    if not root.is_dir():
        pytest.skip(f"FORETOUCH_DATA holds no {folder}")
    name, samples, readings, left_out = PUBLIC[folder]
    result = import_samples(root, tmp_path / "ds", map_file=MAPS / f"{name}.yaml")
    assert (result.samples, result.readings, dict(result.left_out)) == (samples, readings, left_out)
    total = np.zeros(2)
    for record in open_samples(tmp_path / "ds").records():
        values = record.series.counts if record.series is not None else record.sample.touch.values[None]  # type: ignore[union-attr]
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
    return np.array([sum(one.sum() for one in parts), sum(np.square(one).sum() for one in parts)])
