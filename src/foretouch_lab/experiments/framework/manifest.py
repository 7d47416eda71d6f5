# SPDX-License-Identifier: Apache-2.0
"""Read and write the folder of a sweep.

DIR/manifest.json      experiment, settings, hash of the data, and the environment of each session that ran cells
DIR/cells/<key>.json   rows of one finished cell; written as a whole or not at all
DIR/results.csv        table of all rows
DIR/summary.md         how the results were made, and tables for a reader

To publish results, leave out manifest and cells: `summary.md` states what a reader needs of them, and keeps it when it
is drawn again.
"""

import csv
import datetime as dt
import io
import json
import platform
import re
import shlex
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from typing import Any, Final

from foretouch import __version__
from foretouch.base.files import TEXT_LIMIT, read_bytes, read_json, require_schema, system_errors, write_text
from foretouch.config import flattened
from foretouch.errors import ConfigError, FileError
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch_lab.experiments.framework.timing import cpu_name

MANIFEST_FILE: Final = "manifest.json"
RESULTS_FILE: Final = "results.csv"
SUMMARY_FILE: Final = "summary.md"

_CELLS: Final = "cells"
_KEY: Final = re.compile(r"[\w.+-]{1,200}")


def environment(workers: int, address: str | None) -> dict[str, Any]:
    """Return time, code version and machine of one session; contains no path and no host name."""
    return {
        "started": dt.datetime.now(dt.timezone.utc).isoformat(timespec="seconds"),
        "foretouch": __version__,
        "git": _git_commit(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": cpu_name(),
        "workers": workers,
        "executor": "processes" if address is None else "ray",
    }


def open_folder(out: Path, fixed: Mapping[str, Any], resumable: Sequence[str] = ()) -> dict[str, Any]:
    """Create the folder of a sweep, or check that it contains this sweep.

    Args:
        out: The folder.
        fixed: Experiment, settings and data, which must not change.
        resumable: Settings that may change nevertheless.

    Returns:
        The manifest so far, with the current settings.

    Raises:
        FileError: If the folder contains something else.
        ConfigError: If its sweep has other settings or data; names the difference.
    """
    file, cells = out / MANIFEST_FILE, out / _CELLS
    manifest: dict[str, Any] = {"sessions": []}
    if cells.is_symlink():
        raise FileError(cells, "is a link, and nothing is written through links")
    with system_errors(out):
        if file.exists():
            manifest = require_schema(file, read_json(file), {"sessions": list})
            _require_same({name: manifest.get(name) for name in fixed}, fixed, file, resumable)
        elif out.exists() and {path.name for path in out.iterdir()} - {_CELLS}:
            raise FileError(out, f"already exists and contains no {MANIFEST_FILE}")
        cells.mkdir(parents=True, exist_ok=True)
    return {**manifest, **fixed}


def require_experiment(out: Path, name: str) -> None:
    """Raise `ConfigError` for the folder of another experiment; one without a manifest is accepted."""
    file = out / MANIFEST_FILE
    if file.exists() and (written := require_schema(file, read_json(file), dict).get("experiment")) != name:
        raise ConfigError(f"{file}: experiment: {written!r} is not {name!r}")


def write_manifest(out: Path, manifest: Mapping[str, Any]) -> None:
    """Replace the manifest atomically."""
    write_text(out / MANIFEST_FILE, json.dumps(manifest, indent=1, ensure_ascii=False) + "\n")


def write_cell(out: Path, cell: Cell, rows: Sequence[Row], seconds: float) -> None:
    """Store the rows of a finished cell, which took some processor time [s]."""
    record = {"key": cell.key, "values": cell.values, "seconds": seconds, "rows": rows}
    write_text(_cell_file(out, cell), json.dumps(record) + "\n")


def read_cells(out: Path, cells: Iterable[Cell]) -> dict[str, list[Row]]:
    """Return rows of the finished cells by key, each with its cell's values.

    Raises:
        FileError: If a file is damaged, or its cell was run with other values.
    """
    rows_of = {}
    for cell in cells:
        file = _cell_file(out, cell)
        if not file.exists():
            continue
        record = require_schema(file, read_json(file), {"values?": dict, "rows?": [dict]})
        if record.get("values") != json.loads(json.dumps(cell.values)) or "rows" not in record:
            raise FileError(file, "was run with other values than the experiment has now; start a new sweep")
        rows_of[cell.key] = [{**record["values"], **row} for row in record["rows"]]
    return rows_of


def cell_seconds(out: Path) -> dict[str, float]:
    """Return the processor time of each finished cell of a folder by its key [s]; a `FileError` if a file is damaged."""
    files = sorted((out / _CELLS).glob("*.json"))
    records = [require_schema(file, read_json(file), {"key": str, "seconds": float}) for file in files]
    return {record["key"]: record["seconds"] for record in records}


def read_settings(out: Path) -> dict[str, Any]:
    """Return the settings of the sweep in a folder; a `FileError` if its manifest is damaged."""
    file = out / MANIFEST_FILE
    return dict(require_schema(file, read_json(file), {"settings": dict})["settings"])


def write_results(out: Path, rows: Sequence[Row], name: str = RESULTS_FILE) -> list[Row]:
    """Write a table: None is an empty field, and fractions have five significant digits.

    Returns:
        The rows as `read_results` reads them.

    Raises:
        FileError: If it cannot be written.
    """
    rounded = [{k: float(f"{v:.5g}") if isinstance(v, float) else v for k, v in row.items()} for row in rows]
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rounded)
    write_text(out / name, text.getvalue())
    return rounded


def read_results(path: Path) -> list[Row]:
    """Return rows that `write_results` wrote; a `FileError` if the file cannot be read."""
    try:
        text = io.StringIO(read_bytes(path, TEXT_LIMIT).decode("utf-8"), newline="")
        header, *rows = [row for row in csv.reader(text, strict=True) if row] or [[]]
        if any(len(row) != len(header) for row in rows):
            raise csv.Error("a row has another number of fields than the first")
        return [dict(zip(header, map(_parsed, row), strict=True)) for row in rows]
    except (UnicodeDecodeError, csv.Error) as err:
        raise FileError(path, str(err)) from err


def write_summary(
    out: Path, experiment: Experiment, tables: Sequence[Table], origin: Sequence[str] | None = None
) -> None:
    """Write `summary.md`: the question, how the results were made and which cells they lack, tables and their notes.

    Args:
        out: Folder of the sweep.
        experiment: The experiment.
        tables: Its tables.
        origin: Lines on how the results were made (see `origin_of`); by default those that were written before.

    Raises:
        FileError: If it cannot be written.
    """
    file = out / SUMMARY_FILE
    if origin is None:
        before = read_bytes(file, TEXT_LIMIT).decode("utf-8").splitlines()[2:] if file.exists() else []
        origin = list(takewhile(lambda line: not line.startswith("## "), before))
    lines = [f"# {experiment.question}", "", *origin]
    for table in tables:
        lines += [f"## {table.title}", ""]
        if table.rows:
            header = [list(table.columns), ["---", *["---:"] * (len(table.columns) - 1)]]
            lines += [*(f"| {' | '.join(row)} |".replace("\n", "<br>") for row in [*header, *table.rows]), ""]
        if table.notes:
            lines += [*(f"- {note}" for note in table.notes), ""]
    write_text(file, "\n".join(lines[:-1]) + "\n")


def origin_of(manifest: Mapping[str, Any], experiment: Experiment, path: Path | None = None) -> list[str]:
    """Return lines on the command, version, data (`--data PATH`; None: the usual ones) and missing cells of a sweep."""
    session, cells = manifest["sessions"][-1], manifest["cells"]
    version = f"foretouch {session['foretouch']} ({str(session['git'])[:7]}), {session['started'][:10]}"
    data = f"{session['cpu']}; sha256 of the data `{manifest['data']['sha256'][:16]}`"
    lines = [f"`{_command(manifest, experiment, path)}`; {version}, {data}", ""]
    if cells["finished"] != cells["all"]:
        finished = f"**{cells['finished']} of {cells['all']} cells are finished.**"
        lines += [f"{finished} The tables contain these alone.", ""]
    return lines


def _command(manifest: Mapping[str, Any], experiment: Experiment, path: Path | None) -> str:
    """Return the command of a sweep with its data and the settings that differ from its preset."""
    preset = manifest["preset"]
    base = experiment.resolve(preset, {}) if preset in experiment.presets else experiment.settings()
    usual = flattened(json.loads(json.dumps(base.to_mapping())))
    changed = {name: value for name, value in flattened(manifest["settings"]).items() if value != usual.get(name)}
    texts = {k: v if isinstance(v, str) else json.dumps(v, separators=(",", ":")) for k, v in changed.items()}
    overrides = [shlex.quote(f"{name}={text}") for name, text in texts.items()]
    options = ([f"--preset {preset}"] if preset else []) + (
        [] if path is None else [f"--data {shlex.quote(str(path))}"]
    )
    return " ".join([experiment.command, *options, *overrides])


def _parsed(text: str | None) -> Any:
    if text in (None, "", "True", "False"):
        return text == "True" if text else None
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return text


def _cell_file(out: Path, cell: Cell) -> Path:
    if not _KEY.fullmatch(cell.key):
        raise ConfigError(f"cell: {cell.key!r} is not a valid file name")
    return out / _CELLS / f"{cell.key}.json"


def _require_same(old: Mapping[str, Any], new: Mapping[str, Any], file: Path, resumable: Sequence[str]) -> None:
    before, now = flattened(old), flattened(json.loads(json.dumps(new)))
    for name in sorted({*before, *now}):
        if before.get(name) != now.get(name) and not set(name.split(".")[1:2]) & set(resumable):
            raise ConfigError(
                f"{file}: {name}: {before.get(name)!r} is not {now.get(name)!r}; a sweep is resumed with the settings and data "
                "that it started with"
            )


def _git_commit() -> str | None:
    """Return the commit of the running source, with `+` if files were changed; None outside of a checkout."""
    words = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+"]
    with suppress(OSError, subprocess.SubprocessError):
        done = subprocess.run(words, capture_output=True, text=True, timeout=10, check=True)  # noqa: S603 - fixed words
        return done.stdout.strip() or None
    return None
