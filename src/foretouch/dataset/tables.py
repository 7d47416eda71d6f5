# SPDX-License-Identifier: Apache-2.0
"""Tables as columns: CSV, Parquet, NPZ and HDF5 (with the extra `hdf5`), read a block of rows at a time.

Columns of a two-dimensional array of an NPZ or HDF5 file are `NAME[0]`, `NAME[1]` and so on. Rows are counted from 1, after the header.
"""

import csv
import io
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, FileError, MissingDependencyError, none_of, quoted, shown
from foretouch.files import open_regular, read_bytes
from foretouch.types import AnyArray

_BLOCK: Final = 1 << 20  # bytes of a CSV file
_ROWS: Final = 16_384  # of a block of other files
_WHOLE: Final = 100_000_000  # bytes of a file whose lines are joined, and of an array in an NPZ file
_SEPARATORS: Final = {"tab": "\t", "space": " "}
_Reader = Callable[[Path, list[str]], Iterator[dict[str, AnyArray]]]
_FAULTS: Final = (pa.ArrowException, OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile)


@dataclass(frozen=True, kw_only=True)
class TableConfig(Settings):
    """One file of a recording, and how its text is laid out."""

    file: str = setting("", "Path in the source; a word in braces stands for any name there, as in {object}/{id}.csv")
    header: bool = setting(True, "Whether the first line names the columns; otherwise they are f0, f1 and so on")
    separator: str = setting(",", "Between the values of a line", choices=(",", ";", "tab", "space"))
    skip: int = setting(0, "Lines before all others", bounds=(0, 1000))
    lines: int = setting(1, "Lines that make up one row", bounds=(1, 1000))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.file or Path(self.file).is_absolute() or ".." in Path(self.file).parts:
            raise ConfigError(f"file: {quoted(self.file)} is not a path in the source")


def expanded(columns: tuple[str, ...]) -> list[str]:
    """The names of columns with each {a..b} replaced by the numbers from a to b."""
    found = list(columns)
    while part := next((one for one in found if re.search(r"\{\d+\.\.\d+\}", one)), None):
        head, first, last, tail = re.split(r"\{(\d+)\.\.(\d+)\}", part, maxsplit=1)
        step = 1 if int(first) <= int(last) else -1
        k = found.index(part)
        found[k : k + 1] = [f"{head}{n}{tail}" for n in range(int(first), int(last) + step, step)]
    return found


def read_blocks(path: Path, table: TableConfig, wanted: Mapping[str, pa.DataType]) -> Iterator[dict[str, AnyArray]]:
    """Blocks of some columns by name, (n,) each of its type; numbers that are missing are NaN.

    Raises:
        FileError: If a column is missing or occurs twice, a cell is no number, a row is of another length, or the file is empty
            or damaged; names file, row and column.
    """
    suffix, count = path.suffix.lower(), 0
    read = _parquet if suffix == ".parquet" else _arrays if suffix in (".npz", ".h5", ".hdf5") else None
    try:
        for found in _csv(path, table, wanted) if read is None else _numbered(path, read, wanted):
            block = [one.cast(kind).to_numpy(False) for one, kind in zip(found, wanted.values(), strict=True)]
            yield dict(zip(wanted, block, strict=True))
            count += len(block[0])
    except FileError:
        raise
    except _FAULTS as err:
        raise _located(path, table, str(err)) from err
    if not count:
        raise FileError(path, "holds no rows")


def _located(path: Path, table: TableConfig, text: str) -> FileError:
    """The fault that Arrow describes, whose rows include the lines before them."""
    row, column = re.search(r"Row #(\d+)", text), re.search(r"column #(\d+)", text)
    value, sizes = re.search(r"invalid value '(.*)'", text), re.search(r"Expected (\d+) columns, got (\d+)", text)
    rule = f"{quoted(value[1])} is not a number" if value else f"cannot be read: {' '.join(text.split())}"
    where = [f"row {int(row[1]) - table.skip - table.header}"] if row else []
    where += [f"column {_header(path, table)[int(column[1])]}"] if column else []
    return FileError(
        path, f"holds {sizes[2]} values, not {sizes[1]}" if sizes else rule, field=", ".join(where) or None
    )


def _require(path: Path, names: list[str], wanted: Iterable[str]) -> None:
    for name in wanted:
        if (count := names.count(name)) != 1:
            rule = f"occurs {count} times" if count else f"is missing: {none_of(name, names)}"
            raise FileError(path, rule, field=f"column {name}")


def _header(path: Path, table: TableConfig) -> list[str]:
    """Names of the columns of a text file."""
    with open_regular(path) as file:
        lines = [line.decode("utf-8-sig", "replace").strip("\r\n") for line in islice(file, table.skip + table.lines)]
    first = lines[table.skip :]
    if not any(first):
        raise FileError(path, "is empty")
    delimiter = _SEPARATORS.get(table.separator, table.separator)
    cells = " ".join(first).split() if delimiter == " " else next(csv.reader(first, delimiter=delimiter))
    return [cell.strip() for cell in cells] if table.header else [f"f{k}" for k in range(len(cells))]


def _csv(path: Path, table: TableConfig, wanted: Mapping[str, pa.DataType]) -> Iterator[list[Any]]:
    names, joined = _header(path, table), table.lines > 1 or table.separator == "space"
    _require(path, names, wanted)
    own = [name if names.count(name) == 1 else f"{name} {k}" for k, name in enumerate(names)]  # Arrow wants each once
    with io.BytesIO(_joined(path, table)) if joined else open_regular(path) as source:
        yield from pa_csv.open_csv(
            source,
            pa_csv.ReadOptions(
                use_threads=False,
                block_size=_BLOCK,
                skip_rows=0 if joined else table.skip + table.header,
                column_names=own,
            ),
            pa_csv.ParseOptions(delimiter="," if joined else _SEPARATORS.get(table.separator, table.separator)),
            pa_csv.ConvertOptions(column_types=wanted, include_columns=list(wanted)),
        )


def _joined(path: Path, table: TableConfig) -> bytes:
    """The rows of a file with several lines for each, or with spaces between its values, as CSV."""
    lines = [line for line in read_bytes(path, _WHOLE).split(b"\n")[table.skip + table.header :] if line.strip()]
    if over := len(lines) % table.lines:
        raise FileError(path, f"ends after {over} of {table.lines} lines", field=f"row {len(lines) // table.lines + 1}")
    comma = b"," if table.separator == "space" else _SEPARATORS.get(table.separator, table.separator).encode()
    cells = [b",".join(line.split() if table.separator == "space" else line.strip().split(comma)) for line in lines]
    return b"\n".join(b",".join(cells[k : k + table.lines]) for k in range(0, len(cells), table.lines))


def _numbered(path: Path, read: _Reader, wanted: Mapping[str, pa.DataType]) -> Iterator[list[Any]]:
    """Columns, or numbers of arrays with a row for each first index: `NAME[0]`, `NAME[1]` and so on, in the order of all of a row."""
    parts = [re.fullmatch(r"(.*?)(?:\[(\d+)\])?", name, re.DOTALL).groups() for name in wanted]  # type: ignore[union-attr]  # any text
    for block in read(path, list(dict.fromkeys(base for base, _ in parts))):
        rows, found = max(len(one) for one in block.values()), []
        for name, (base, number) in zip(wanted, parts, strict=True):
            array = block[base]
            shape = array.shape
            if shape[:1] != (rows,) or len(shape) != 1 + bool(number) or (number and int(number) >= shape[1]):
                raise FileError(path, f"is of an array of shape {shape}, not {rows} rows", field=f"column {name}")
            found.append(pa.array(array[:, int(number)] if number else array))
        yield found


def _parquet(path: Path, names: list[str]) -> Iterator[dict[str, AnyArray]]:
    with open_regular(path) as file:
        table = pq.ParquetFile(file)
        _require(path, table.schema_arrow.names, names)
        for batch in table.iter_batches(_ROWS, columns=names):
            yield {name: _array_of(path, name, batch[name], len(batch)) for name in names}


def _array_of(path: Path, name: str, column: Any, rows: int) -> AnyArray:
    """(n,) values of a column, or (n, k) of one of lists, also of lists of lists; a `FileError` if these are of several lengths."""
    lists = pa.types.is_nested(column.type)
    while pa.types.is_nested(column.type):
        if len(pc.unique(pc.list_value_length(column))) > 1:
            raise FileError(path, "holds lists of several lengths", field=f"column {name}")
        column = column.flatten()
    found: AnyArray = column.to_numpy(False)
    return found.reshape(rows, -1) if lists else found


def _arrays(path: Path, names: list[str]) -> Iterator[dict[str, AnyArray]]:
    """Of NPZ and HDF5 files."""
    with _opened(path) as file:
        _require(path, list(file), names)
        arrays = {name: file[name] for name in names}
        if alone := next((name for name, one in arrays.items() if not one.shape), None):
            raise FileError(path, "is a single number", field=f"column {alone}")
        for start in range(0, max(map(len, arrays.values())), _ROWS):
            block = {name: one[start : start + _ROWS] for name, one in arrays.items()}
            yield {name: one.astype(str) if one.dtype.kind in "OS" else one for name, one in block.items()}


def _opened(path: Path) -> Any:
    if path.suffix.lower() == ".npz":
        with zipfile.ZipFile(path) as archive:
            if large := next((one for one in archive.infolist() if one.file_size > _WHOLE), None):
                raise FileError(path, f"has more than {_WHOLE} bytes: use Parquet", field=large.filename)
        return np.load(path, allow_pickle=False)
    try:
        import h5py  # type: ignore[import-untyped, import-not-found, unused-ignore]
    except ImportError as err:
        raise MissingDependencyError(f"{shown(path)}: needs h5py: pip install 'foretouch[hdf5]'") from err
    return h5py.File(path, "r")
