# SPDX-License-Identifier: Apache-2.0
"""The formats of datasets: open one, or export its samples.

To add a format, write one module with these functions, as far as the format has them, and describe it as a `FormatEntry`: one of `FORMATS`,
or an entry point of the group `foretouch.formats` in another package.

- `recognise(path) -> bool`: whether a path that exists is of this format.
- `open_set(path, unfinished) -> SampleSet`: opens it, also with recordings that were cut off if `unfinished` is true.
- `export(samples, folder, result, progress, **options)`: writes samples to a folder that does not exist yet, adds to the
  counts of an `ExportResult`, and reports progress once a sample.

A module is imported when its format is used, so that help texts do not wait for the libraries of all formats.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from foretouch.base.files import require_existing, system_errors
from foretouch.dataset.files import new_folder
from foretouch.dataset.samples import ExportResult, SampleSet
from foretouch.doors import Door, at_work, reported
from foretouch.errors import ConfigError, FileError, shown


@dataclass(frozen=True)
class FormatEntry:
    """One format, described without importing its module."""

    title: str  # in help texts; a noun phrase
    module: str  # has its functions
    files: tuple[str, ...] = ()  # suffixes of single files that may be of this format
    folders: tuple[str, ...] = ()  # glob patterns; a folder with a match may be of this format; none for export alone
    exported: bool = False  # whether samples can be written in this format

    def load(self) -> ModuleType:
        """Import the module; a `MissingDependencyError` if a library that it needs is not installed."""
        with reported(f"format {shown(self.title)}", str(self.module)):
            return import_module(self.module)

    def may_hold(self, path: Path) -> bool:
        """Return whether the name of a file, or those in a folder, allow this format; its module decides."""
        if path.is_dir():
            return any(next(path.glob(pattern), None) is not None for pattern in self.folders)
        return path.suffix in self.files and path.is_file()


_HERE: Final = "foretouch.dataset"

FORMATS: Final = Door(
    "foretouch.formats",
    "format",
    {
        "recording": FormatEntry(
            "recorded dataset (MCAP)", f"{_HERE}.recordings.reader", (".mcap",), ("manifest.json",)
        ),
        "store": FormatEntry("training store (Arrow)", f"{_HERE}.store", (), ("manifest.json",)),
        "vision2tactile": FormatEntry(
            "vision2tactile folders", f"{_HERE}.formats.vision2tactile", (), ("*",), exported=True
        ),
        "lerobot": FormatEntry("LeRobot exports", f"{_HERE}.formats.lerobot", (), ("meta/info.json",), exported=True),
        "npz": FormatEntry("NumPy archives", f"{_HERE}.formats.npz", (), ("*/*.npz",), exported=True),
        "rosbag2": FormatEntry("ROS 2 bag", f"{_HERE}.formats.rosbag2", exported=True),
    },
    FormatEntry,
)
"""The formats by name. The first that recognises a path reads it."""


def _entries() -> Iterator[FormatEntry]:
    return (entry for _, entry in FORMATS.loaded())


def exported_formats() -> list[str]:
    """Return the names of the formats that samples can be written in."""
    return [name for name, entry in FORMATS.loaded() if entry.exported]


def readable_formats() -> str:
    """Return the formats that can be read, for help texts and error messages."""
    *others, last = [entry.title for entry in _entries() if entry.folders or entry.files]
    return f"{', '.join(others)} or {last}"


def _format_of(path: Path) -> ModuleType | None:
    """Return the module of the format that a path is of."""
    for entry in _entries():
        if entry.may_hold(path):
            with at_work(f"format {shown(entry.title)}"):
                module = entry.load()
                if module.recognise(path):
                    return module
    return None


def is_sample_set(path: str | Path) -> bool:
    """Return whether the path is a dataset that `open_samples` can read."""
    return _format_of(Path(path)) is not None


def open_samples(path: str | Path, *, unfinished: bool = False) -> SampleSet:
    """Open a dataset in any readable format.

    Args:
        path: The dataset.
        unfinished: Whether recordings that were cut off are read, too, as far as they are intact.

    Raises:
        FileError: If there is no dataset, or it is damaged, cut off or of another version.
    """
    path = require_existing(path)
    module = _format_of(path)
    if module is None:
        raise FileError(path, f"is not a dataset: no {readable_formats()}")
    opened: SampleSet = module.open_set(path, unfinished)
    return opened


def export_samples(
    source: str | Path, out: str | Path, kind: str, progress: Callable[[], None] = lambda: None, **options: Any
) -> ExportResult:
    """Write the samples of a dataset in another format; reading them back gives equal numbers.

    Args:
        source: A dataset (see `open_samples`).
        out: Folder to create; must not exist.
        kind: Name of a format in `FORMATS` that is exported.
        progress: Called once a sample.
        options: Of the format: `fps` of lerobot.

    Raises:
        FileError: If `out` exists or cannot be written, or the source is damaged; nothing is left at `out` then.
        DatasetError: If a sample's id cannot be the name of a file.
    """
    module = FORMATS.load(kind).load()
    if not hasattr(module, "export"):
        raise ConfigError(f"format {shown(kind)}: {module.__name__} has no function export")
    result = ExportResult()
    with new_folder(Path(out)) as folder, system_errors(out, "cannot be written"):
        module.export(open_samples(source), folder, result, progress, **options)
    return result
