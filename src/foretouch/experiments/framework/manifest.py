# SPDX-License-Identifier: Apache-2.0
"""The folder of a sweep: what was run on what, and each finished cell.

DIR/manifest.json      experiment, settings, data hash, and the environment of each session that worked on it
DIR/cells/<key>.json   the rows of a finished cell, whole or absent
DIR/results.csv        the table
DIR/summary.md         what a person reads of it
"""

from __future__ import annotations

import csv
import datetime as dt
import importlib.metadata
import io
import json
import os
import platform
import re
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from foretouch import __version__
from foretouch.errors import ConfigError, FileError
from foretouch.experiments.framework.executors import Outcome
from foretouch.experiments.framework.experiment import Cell, Row
from foretouch.models.card import write_text

__all__ = [
    "MANIFEST_FILE",
    "RESULTS_FILE",
    "SUMMARY_FILE",
    "environment",
    "open_folder",
    "read_cells",
    "read_results",
    "require_experiment",
    "write_cell",
    "write_manifest",
    "write_results",
]

MANIFEST_FILE: Final = "manifest.json"
RESULTS_FILE: Final = "results.csv"
SUMMARY_FILE: Final = "summary.md"

_CELLS: Final = "cells"
_KEY: Final = re.compile(r"[\w.+-]{1,200}")
_LIBRARIES: Final = ("numpy", "scipy", "scikit-learn", "torch", "ray")
_FIXED: Final = ("experiment", "settings", "data")


def environment(workers: int, address: str | None) -> dict[str, Any]:
    """Of one session: when, what code, on what machine. Names no path and no host."""
    return {
        "started": dt.datetime.now(dt.timezone.utc).isoformat(timespec="seconds"),
        "foretouch": __version__,
        "git": _git_commit(),
        "python": platform.python_version(),
        "libraries": {name: version for name in _LIBRARIES if (version := _version(name))},
        "platform": platform.platform(),
        "cpu": _cpu(),
        "cores": len(os.sched_getaffinity(0)),
        "gpu": _gpus(),
        "workers": workers,
        "executor": "processes" if address is None else "ray",
    }


def open_folder(out: Path, fixed: Mapping[str, Any], *, resume: bool, free: Sequence[str] = ()) -> dict[str, Any]:
    """Make the folder of a sweep, or check that it holds this very one.

    Args:
        out: The folder.
        fixed: What must not change: experiment, settings, data.
        resume: Go on with what stands there, if anything does.
        free: Settings that may change all the same.

    Returns:
        The manifest so far, with the settings as they are now.

    Raises:
        FileError: If it exists and `resume` is off, or holds something else.
        ConfigError: If the sweep that stands there has other settings or data; names the difference.
    """
    file = out / MANIFEST_FILE
    if not file.exists():
        if out.exists() and any(out.iterdir()) and not (resume and [p.name for p in out.iterdir()] == [_CELLS]):
            raise FileError(out, "exists already" + (f" and holds no {MANIFEST_FILE}" if resume else ""))
        (out / _CELLS).mkdir(parents=True, exist_ok=True)
        return {**fixed, "sessions": []}
    if not resume:
        raise FileError(out, "holds a sweep already; --resume goes on with it")
    manifest = _read_json(file)
    for name in _FIXED:
        _require_same(_without(manifest.get(name), free), _without(fixed[name], free), name, file)
    (out / _CELLS).mkdir(exist_ok=True)  # they are not kept with published results
    return {**manifest, **fixed}


def require_experiment(out: Path, name: str) -> None:
    """Refuse the folder of another experiment; one without a manifest may be of any.

    Raises:
        ConfigError: If it is another one's.
        FileError: If the manifest is damaged.
    """
    file = out / MANIFEST_FILE
    if file.exists() and (found := _read_json(file).get("experiment")) != name:
        raise ConfigError(f"{file}: experiment: {found!r} is not {name!r}")


def write_manifest(out: Path, manifest: Mapping[str, Any]) -> None:
    """Replace the manifest as a whole."""
    write_text(out / MANIFEST_FILE, json.dumps(manifest, indent=1, ensure_ascii=False) + "\n")


def write_cell(out: Path, outcome: Outcome) -> None:
    """Keep a finished cell."""
    cell = outcome.cell
    record = {"key": cell.key, "values": cell.values, "seconds": outcome.seconds, "rows": outcome.rows}
    write_text(_cell_file(out, cell), json.dumps(record) + "\n")


def read_cells(out: Path, cells: Iterable[Cell]) -> dict[str, list[Row]]:
    """Rows of those cells that are finished, by key, each with its cell's values.

    Raises:
        FileError: If one is damaged, or was run with other values than it now has.
    """
    found = {}
    for cell in cells:
        file = _cell_file(out, cell)
        if not file.exists():
            continue
        record = _read_json(file)
        if record.get("values") != json.loads(json.dumps(cell.values)) or "rows" not in record:
            raise FileError(file, "was run with other values than the experiment has now; begin anew")
        found[cell.key] = [{**record["values"], **row} for row in record["rows"]]
    return found


def write_results(out: Path, rows: Sequence[Row]) -> Path:
    """Write `results.csv`: an empty field is None, numbers read back as they were.

    Raises:
        FileError: If it cannot be written.
    """
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    path = out / RESULTS_FILE
    try:
        write_text(path, text.getvalue())
    except OSError as err:
        raise FileError(path, err.strerror or str(err)) from err
    return path


def read_results(path: Path) -> list[Row]:
    """Rows of `write_results`.

    Raises:
        FileError: If there is no such file.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return [{name: _parsed(text) for name, text in row.items()} for row in csv.DictReader(file)]
    except OSError as err:
        raise FileError(path, err.strerror or str(err)) from err
    except (UnicodeDecodeError, csv.Error) as err:
        raise FileError(path, str(err)) from err


def _parsed(text: str | None) -> Any:
    if not text:
        return None
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"True": True, "False": False}.get(text, text)


def _cell_file(out: Path, cell: Cell) -> Path:
    if not _KEY.fullmatch(cell.key):
        raise ConfigError(f"cell: {cell.key!r} is no name of a file")
    return out / _CELLS / f"{cell.key}.json"


def _read_json(file: Path) -> dict[str, Any]:
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as err:
        raise FileError(file, f"is unreadable: {' '.join(str(err).split())}") from err
    if not isinstance(record, dict):
        raise FileError(file, "holds no mapping")
    return record


def _without(value: Any, names: Sequence[str]) -> Any:
    return {k: v for k, v in value.items() if k not in names} if isinstance(value, dict) else value


def _require_same(old: Any, new: Any, name: str, file: Path) -> None:
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            _require_same(old.get(key), new.get(key), f"{name}.{key}", file)
    elif old != json.loads(json.dumps(new)):
        raise ConfigError(f"{file}: {name}: {old!r} is not {new!r}; a sweep resumes as it began")


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _git_commit() -> str | None:
    """Commit of the source that runs, with `+` where files were changed; None outside of a checkout."""
    here = Path(__file__).parent
    try:
        words = ["git", "-C", str(here), "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+"]
        done = subprocess.run(words, capture_output=True, text=True, timeout=10, check=True)  # noqa: S603 - fixed words
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*:\s*(.+)", info.read_text(encoding="utf-8")) if info.exists() else []
    return names[0] if names else platform.processor()


def _gpus() -> list[str]:
    """As the driver lists them, without loading a library for it."""
    files = sorted(Path("/proc/driver/nvidia/gpus").glob("*/information"))
    return [match[1] for file in files if (match := re.search(r"Model:\s*(.+)", file.read_text(encoding="utf-8")))]
