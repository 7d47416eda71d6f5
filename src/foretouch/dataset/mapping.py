# SPDX-License-Identifier: Apache-2.0
"""Samples of other people's recordings, by a map that states which columns of their tables are which channel of a described sensor.

A grasp is a file, a row, or successive rows with the same value in a column. Samples have no cloud (`foretouch.types.NO_CLOUD`). Numbers of
a series are stored as float32, which holds counts of 24 bits exactly. Rows are counted from 1.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from foretouch.config import Settings, load_yaml, setting
from foretouch.dataset.pairing.matcher import SETTLE_NS
from foretouch.dataset.record import APPROACH, HOLD, REST, Identity, Outcome, SampleRecord, TouchSeries, check_id
from foretouch.dataset.tables import TableConfig, expanded, read_blocks
from foretouch.errors import ConfigError, DatasetError, FileError, none_of, quoted, shown
from foretouch.tactile.contact_detector import RELEASE_LEVEL, contact_scores, find_contact
from foretouch.tactile.description import STAMP_UNITS, load_sensor
from foretouch.tactile.readings import rest_of
from foretouch.types import SECOND_NS, AnyArray, Float64, GraspSample, Int64, Touch

_MOST_CELLS: Final = 10_000_000  # of one grasp, which is held in memory
_NAME: Final = re.compile(r"\{([^{}]+)\}")
_Rows = dict[str, AnyArray]  # (n,) of each column by name, and the `_ROW` of each
_ROW: Final = "#"


@dataclass(frozen=True, kw_only=True)
class ColumnsConfig(Settings):
    """The columns of one channel of one finger, in the order of the taxels."""

    finger: str = setting("", "Name of the finger in the description")
    channel: str = setting("", "Name of the channel in the description")
    columns: tuple[str, ...] = setting((), "Names of columns: E{1..24} is E1 to E24, and FILE:NAME of a file beside")
    unit: str = setting("", "Unit of the columns, which must be that of the description; empty if it is not stated")


@dataclass(frozen=True, kw_only=True)
class OutcomeConfig(Settings):
    """What became of a grasp."""

    column: str = setting("", "Name of the column; empty without one")
    success: tuple[str, ...] = setting((), "Texts of a grasp that held")
    failure: tuple[str, ...] = setting((), "Texts of one that did not")


@dataclass(frozen=True, kw_only=True)
class StampsConfig(Settings):
    """When readings were taken: by a column, or at a constant rate; without both, at an unknown time."""

    column: str = setting("", "Name of the column of stamps; empty without one")
    unit: str = setting("s", "Unit of the stamps", choices=STAMP_UNITS)
    rate: str = setting("", "Readings per second, a number or a {column}", unit="Hz")
    start: str = setting("0", "Added to stamps: a unix time [s], a date and time in UTC, or a {name} of either")


@dataclass(frozen=True, kw_only=True)
class MapConfig(Settings):
    """Which columns of some tables are what; {names} stand for words of the path or for columns."""

    sensor: str = setting("", "Name of a sensor of the package, or of a description beside the map")
    table: TableConfig = TableConfig(file="{id}.csv")
    beside: tuple[TableConfig, ...] = ()
    grasp: str = setting("file", "What a grasp is: a file, a row, or successive rows with one value of this column")
    values: tuple[ColumnsConfig, ...] = ()
    others: tuple[str, ...] = setting((), "Columns of further numbers, named as in values.columns")
    object: str = setting("{object}", "Name of the object")
    id: str = setting("", "Name of the grasp among those of its object; by default a number")
    outcome: OutcomeConfig = OutcomeConfig()
    stamps: StampsConfig = StampsConfig()
    rest_rows: int = setting(0, "Readings without contact at the beginning of a grasp", bounds=(0, 100_000))
    spare_rows: int = setting(0, "Rows at the end that files beside may lack; left out and counted", bounds=(0, 100))


class MappedSource:
    """The samples of a recording by a map, and its `sensor` and `identity`.

    Args:
        source: The file, or the folder of the files.
        map_file: YAML file with the settings of a `MapConfig`.

    Raises:
        ConfigError: If the map breaks a rule, or does not fit its sensor.
    """

    def __init__(self, source: Path, map_file: Path) -> None:
        self.config = config = MapConfig.from_mapping(load_yaml(map_file), str(map_file))
        self.path, self._root, self._where = source, source if source.is_dir() else source.parent, shown(map_file)
        beside = map_file.parent / config.sensor
        self.sensor = load_sensor(beside if beside.suffix else config.sensor)
        self.identity = Identity(
            hand={"name": self.sensor.config.name, "source": map_file.stem}, camera={"name": "none"}
        )
        self._values, self._others = self._of_values(), expanded(config.others)
        in_path, stamps = _NAME.findall(config.table.file), config.stamps
        self._templates = [config.object, config.id, stamps.start, stamps.rate]
        names = [name for text in self._templates for name in _NAME.findall(text) if name not in in_path]
        names += [one for one in (config.outcome.column, config.grasp) if one not in ("", "file", "row")]
        whole = STAMP_UNITS[stamps.unit] < STAMP_UNITS["ms"]  # as float64, stamps of today have 0.2 us
        self._types = dict.fromkeys([*self._values, *self._others], pa.float64()) | dict.fromkeys(names, pa.string())
        self._types |= {stamps.column: pa.int64() if whole else pa.float64()} if stamps.column else {}
        if config.beside and config.grasp != "file":
            raise ConfigError(f"{self._where}: beside: needs `grasp: file`, not {quoted(config.grasp)}")
        if config.grasp != "row" and not (stamps.column or stamps.rate):
            raise ConfigError(f"{self._where}: stamps: a series needs a column or a rate")

    def _of_values(self) -> list[str]:
        """(D,) column of each value of a touch."""
        channels, found, where = self.sensor.channels, dict[str, list[str]](), f"{self._where}: values"
        for part in self.config.values:
            name, columns = f"{part.channel}_{part.finger}", expanded(part.columns)
            if name not in channels.modalities or name in found:
                rule = f"{name} occurs twice" if name in found else none_of(name, channels.modalities)
                raise ConfigError(f"{where}: {rule}")
            channel = channels.channel_of[name]
            if len(columns) != channel.size or part.unit not in ("", channel.unit):
                stated = f"{len(columns)} columns" + f" in {part.unit}" * bool(part.unit)
                rule = f"{stated}, and {channels.sensor} has {channel.size} values in {channel.unit}"
                raise ConfigError(f"{where}: {name}: {rule}")
            found[name] = columns
        if missing := [name for name in channels.modalities if name not in found]:
            raise ConfigError(f"{where}: no columns of {', '.join(missing)}")
        return [column for name in channels.modalities for column in found[name]]

    def records(self, left_out: Counter[str]) -> Iterator[SampleRecord]:
        """The grasps in order of the files' names; what is not imported is counted.

        Raises:
            FileError: If a file breaks a rule; names file, row, column and rule.
        """
        pattern = _NAME.sub(
            r"(?P<\1>[^/]+)", re.sub(r"[^\w{}/-]", lambda one: re.escape(one[0]), self.config.table.file)
        )
        files = sorted(self._root.glob(_NAME.sub("*", self.config.table.file))) if self.path.is_dir() else [self.path]
        if not files:
            raise FileError(self.path, f"holds no file {self.config.table.file}")
        for path in files:
            if not path.resolve().is_relative_to(self._root.resolve()):
                raise FileError(path, "is a link out of the source")
            words = re.fullmatch(pattern, path.relative_to(self._root).as_posix())
            for rows in self._grasps(path, left_out):
                yield self._record(path, words.groupdict() if words else {}, rows)

    def _grasps(self, path: Path, left_out: Counter[str]) -> Iterator[_Rows]:
        held: _Rows = {}
        for block in self._whole(path, left_out) if self.config.beside else self._blocks(path, self.config.table):
            self._require_finite(path, block)
            rows = {name: np.concatenate([held[name], part]) if held else part for name, part in block.items()}
            count, key = len(rows[_ROW]), rows.get(self.config.grasp)
            begins = [] if key is None else (np.flatnonzero(key[1:] != key[:-1]) + 1).tolist()
            begins = list(range(count + 1)) if self.config.grasp == "row" else [0, *begins]
            yield from (_part(rows, *ends) for ends in pairwise(begins))
            held = _part(rows, begins[-1], count) if begins[-1] < count else {}
            if held and len(held[_ROW]) * len(held) > _MOST_CELLS:
                rule = f"more than {_MOST_CELLS} numbers in one grasp: set `grasp` to the column that counts grasps"
                raise FileError(path, rule, field=f"row {held[_ROW][0]}")
        if held:
            yield held

    def _blocks(self, path: Path, table: TableConfig, prefix: str = "") -> Iterator[_Rows]:
        """Blocks of a file with its part of all columns; those of files beside have a prefix."""
        others = tuple(f"{one.file}:" for one in self.config.beside)
        own = [name for name in self._types if (name.startswith(prefix) if prefix else not name.startswith(others))]
        first = 1
        for block in read_blocks(path, table, {name.removeprefix(prefix): self._types[name] for name in own}):
            rows = {prefix + name: column for name, column in block.items()}
            count = len(rows[own[0]])
            yield rows | ({} if prefix else {_ROW: np.arange(first, first + count)})
            first += count

    def _whole(self, path: Path, left_out: Counter[str]) -> list[_Rows]:
        """All rows of a file, with those of the files beside; one of a single row holds for all."""
        whole: _Rows = {}
        for table in (self.config.table, *self.config.beside):
            prefix = f"{table.file}:" if whole else ""
            file, count = path.parent / table.file if whole else path, len(whole.get(_ROW, ()))
            blocks = list(self._blocks(file, table, prefix))
            part = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
            size = len(next(iter(part.values())))
            if whole and size == 1:
                part = {name: np.repeat(one, count) for name, one in part.items()}
            elif whole and not 0 <= count - size <= self.config.spare_rows:
                raise FileError(file, f"holds {size} rows, and {path.name} {count}; `spare_rows` allows for fewer")
            elif whole and size < count:
                left_out[f"rows that {table.file} lacks"] += count - size
                whole = _part(whole, 0, size)
            whole |= part
        return [whole]

    def _require_finite(self, path: Path, rows: _Rows) -> None:
        for name in (name for name, kind in self._types.items() if kind != pa.string()):
            with np.errstate(over="ignore", invalid="ignore"):
                wrong = ~np.isfinite(rows[name].astype(np.float32))
            if wrong.any():
                row = int(wrong.argmax())
                raise FileError(
                    path, f"{rows[name][row]} is not a finite number", field=f"row {rows[_ROW][row]}, column {name}"
                )

    def _record(self, path: Path, words: Mapping[str, str], rows: _Rows) -> SampleRecord:
        row = f"row {rows[_ROW][0]}"
        texts = {name: str(rows[name][0]) for name, kind in self._types.items() if kind == pa.string()} | dict(words)
        for name in texts.keys() - words.keys():
            if (rows[name] != rows[name][0]).any():
                raise FileError(path, "changes within a grasp", field=f"{row}, column {name}")
        label, name, start, rate = (_NAME.sub(lambda one: texts.get(one[1], one[0]), text) for text in self._templates)
        try:
            check_id(f"{label}/{name or '1'}", label)
            stamps, outcome = self._stamps(rows, start, rate), self._outcome(texts)
        except (DatasetError, ValueError, ZeroDivisionError) as err:
            raise FileError(path, str(err), field=row) from err
        values = np.column_stack([rows[one] for one in self._values])
        others = {one.rpartition(":")[2]: rows[one].astype(np.float32) for one in self._others}
        sample = GraspSample(id=f"{label}/{name}" if name else "", object=label, stamp_ns=int(stamps[0]))
        flags = [*self._range_flags(path, row, values), *(["stamped_by_rate"] if rate else [])]
        note = f"{path.relative_to(self._root)}, {row}"
        if self.config.grasp == "row":
            extra = {name: float(value[0]) for name, value in others.items()}
            sample = replace(sample, touch=Touch(values[0], self.sensor.channels), extra=extra)
            return SampleRecord(sample=sample, outcome=outcome, note=note, flags=tuple(flags))
        touch, tare, phases, contact_ns = self._cut(stamps, values)
        return SampleRecord(
            sample=replace(sample, touch=touch, tare=tare),
            outcome=outcome,
            note=note,
            series=TouchSeries(stamps, values.astype(np.float32), phases, others),
            contact_ns=contact_ns,
            detector="" if contact_ns is None else "contact_detector",
            flags=tuple(flags),
        )

    def _range_flags(self, path: Path, row: str, values: Float64) -> list[str]:
        """A flag, if a working sensor cannot have sent some of (n, D) values; if most of a finger, they are of another unit."""
        channels = self.sensor.channels
        outside = (values < channels.low) | (values > channels.high)
        for modality, columns in channels.modality_columns.items():
            if outside[:, columns].mean() > 0.5:
                one, channel = columns[outside[0, columns].argmax()], channels.channel_of[modality]
                rule = f"is not between {channel.low:g} and {channel.high:g} {channel.unit}, as most of {modality}: another unit?"
                raise FileError(path, f"{values[0, one]:g} {rule}", field=f"{row}, column {self._values[one]}")
        return ["out_of_range"] if outside.any() else []

    def _outcome(self, texts: Mapping[str, str]) -> Outcome:
        config, text = self.config.outcome, texts.get(self.config.outcome.column, "")
        if config.column and text not in (*config.success, *config.failure):
            raise ValueError(f"{config.column}: {none_of(text, (*config.success, *config.failure))}")
        return "unknown" if not config.column else "success" if text in config.success else "failure"

    def _stamps(self, rows: _Rows, start: str, rate: str) -> Int64:
        """(n,) stamps [ns]; a ValueError if they are none or go back."""
        config, count = self.config.stamps, len(rows[_ROW])
        try:
            begin = round(float(start) * SECOND_NS)
        except ValueError:
            begin = round(datetime.fromisoformat(start).replace(tzinfo=UTC).timestamp() * SECOND_NS)
        if not config.column:
            step = SECOND_NS / float(rate) if rate else 0.0
            return np.asarray(begin + np.rint(np.arange(count) * step).astype(np.int64))
        found = rows[config.column]
        if np.abs(found).max() * float(STAMP_UNITS[config.unit]) > 2.0**62:
            raise ValueError(f"column {config.column}: is no time in {config.unit}")
        ticks = found * STAMP_UNITS[config.unit]
        stamps: Int64 = begin + (ticks if found.dtype.kind == "i" else np.rint(ticks).astype(np.int64))
        if (back := np.flatnonzero(np.diff(stamps) < 0)).size:
            row, by = rows[_ROW][back[0] + 1], (stamps[back[0]] - stamps[back[0] + 1]) / SECOND_NS
            raise ValueError(f"column {config.column}: goes back by {by:g} s in row {row}")
        return stamps

    def _cut(self, stamps: Int64, values: Float64) -> tuple[Touch | None, Touch | None, AnyArray, int | None]:
        """Touch and tare of (n, D) readings, the phase of each, and the first contact [ns]; what is not there is None."""
        phases, rest = np.full(len(stamps), APPROACH, np.uint8), values[: self.config.rest_rows]
        phases[: len(rest)] = REST
        if not len(rest):
            return None, None, phases, None
        channels = self.sensor.channels
        tare = rest_of(np.median(rest, axis=0), channels)
        onsets = [one for one in find_contact(stamps, values, rest, channels) if one is not None]
        if not onsets:
            return None, tare, phases, None
        touching = (contact_scores(values, rest, channels) >= RELEASE_LEVEL).any(axis=1)
        held = touching & (stamps >= min(onsets) + SETTLE_NS) & (phases != REST)
        phases[held] = HOLD
        return Touch(np.median(values[held], axis=0), channels) if held.any() else None, tare, phases, min(onsets)


def _part(rows: _Rows, start: int, end: int) -> _Rows:
    return {name: column[start:end] for name, column in rows.items()}
