# SPDX-License-Identifier: Apache-2.0
"""The formats of datasets: one line each in `FORMATS`, from which commands and readers take what is supported.

To add a format, add its line here and write one module with these functions, as far as the format has them:

- `recognise(path) -> bool`: whether a path that exists is of this format.
- `open_set(path, unfinished) -> SampleSet`: opens it, also with recordings that were cut off if `unfinished` is true.
- `export(samples, folder, result, progress, **options)`: writes samples to a folder that does not exist yet, adds to the
  counts of an `ExportResult`, and reports progress once a sample.

This module imports no reader, so that help texts do not wait for the libraries of all formats.
"""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class FormatEntry:
    """One format, described without importing its module."""

    name: str  # in options, JSON and error messages
    title: str  # in help texts; a noun phrase
    module: str  # python module with its functions
    files: tuple[str, ...] = ()  # suffixes of single files that may be of this format
    folders: tuple[str, ...] = ()  # glob patterns; a folder with a match may be of this format; none for export alone
    exported: bool = False  # whether samples can be written in this format

    def may_hold(self, path: Path) -> bool:
        """Whether the name of a file, or those in a folder, allow this format; its module decides."""
        if path.is_dir():
            return any(next(path.glob(pattern), None) is not None for pattern in self.folders)
        return path.suffix in self.files and path.is_file()


FORMATS: tuple[FormatEntry, ...] = (  # the first that recognises a path reads it
    FormatEntry("recording", "recorded dataset (MCAP)", "foretouch.dataset.recording.reader", (".mcap",), ("manifest.json",)),
    FormatEntry("store", "training store (Arrow)", "foretouch.dataset.store", (), ("manifest.json",)),
    FormatEntry("vision2tactile", "vision2tactile folders", "foretouch.dataset.vision2tactile", (), ("*",), exported=True),
    FormatEntry("lerobot", "LeRobot exports", "foretouch.dataset.lerobot", (), ("meta/info.json",), exported=True),
    FormatEntry("npz", "NumPy archives", "foretouch.dataset.npz", (), ("*/*.npz",), exported=True),
    FormatEntry("rosbag2", "ROS 2 bag", "foretouch.dataset.bag_writer", exported=True),
)  # fmt: skip


def readable_formats() -> str:
    """The formats that can be read, for help texts and error messages."""
    *others, last = [entry.title for entry in FORMATS if entry.folders]
    return f"{', '.join(others)} or {last}"
