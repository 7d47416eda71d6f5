# SPDX-License-Identifier: Apache-2.0
"""Where the taxels of a sensor are: in an array, or by a CSV file with a line for each."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.base.files import read_bytes
from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, FileError, quoted
from foretouch.types import Bool, Float64, Floating, Index

COLUMNS: Final = ("index", "x", "y", "z", "nx", "ny", "nz")

MOST_TAXELS: Final = 65_536
"""Taxels of a finger."""

_BYTES: Final = 20_000_000
_AS_NEAR: Final = 1.001  # of the least distance: rounding must not decide between neighbours


@dataclass(frozen=True, eq=False)
class Layout:
    """The taxels of a finger in order of their index, in the sensor's frame."""

    positions: Float64  # (N, 3) [m]; read-only
    normals: Float64  # (N, 3), outward, of unit length; read-only

    def __post_init__(self) -> None:
        self.positions.flags.writeable = self.normals.flags.writeable = False

    @cached_property
    def to_fingertip(self) -> Float64:
        """(3, 3) rotation, p_fingertip = R @ p_sensor, to the frame of fingertips: x along the finger, -z out of the pad.

        x stays x, where the pad does not face along it, and becomes z otherwise.
        """
        facing = self.normals.mean(axis=0)
        depth = int(np.abs(facing).argmax())
        inward = np.eye(3)[depth] * (1.0 if facing[depth] < 0.0 else -1.0)
        along = np.eye(3)[2 if depth == 0 else 0]
        return np.array([along, np.cross(inward, along), inward])

    @cached_property
    def unrolled(self) -> Float64:
        """(N, 2) float64 [m]: across the pad to the right and along the finger, seen from outside; a curved pad is unrolled."""
        _, y, _ = self.to_fingertip @ self.positions.T
        normals = self.to_fingertip @ self.normals.T
        angle = np.arctan2(normals[1], -normals[2])
        if np.ptp(angle) > 1e-3:
            centred = normals[1] - normals[1].mean()
            y = angle * (centred @ y) / (centred @ centred)  # the radius
        return np.column_stack([y, self.to_fingertip[0] @ self.positions.T])

    def fill(self, values: Floating, valid: Bool) -> None:
        """Give each taxel that is not valid the mean of the nearest valid ones, in (N, ...) values, as a dead pixel of a camera has."""
        for index, nearest in _nearest_valid(self, valid.tobytes()):
            values[index] = values[nearest].mean(axis=0, dtype=np.float64)


@lru_cache(maxsize=64)
def _nearest_valid(layout: Layout, valid: bytes) -> list[tuple[int, Index]]:
    """Return the index of each taxel that is not valid, with the indices of the nearest valid ones."""
    mask = np.frombuffer(valid, np.bool_)
    usable, pairs = np.flatnonzero(mask), []
    for index in np.flatnonzero(~mask).tolist():
        distances = np.linalg.norm(layout.positions[usable] - layout.positions[index], axis=1)
        pairs.append((index, usable[distances <= _AS_NEAR * distances.min()]))
    return pairs


@dataclass(frozen=True, kw_only=True)
class ArrayConfig(Settings):
    """A flat array of equal taxels in the plane z = 0 with the normal z: rows follow each other along x, columns along y."""

    rows: int = setting(1, "Number of rows", bounds=(1, MOST_TAXELS))
    cols: int = setting(1, "Number of columns", bounds=(1, MOST_TAXELS))
    order: str = setting("row-major", "Order of the taxels in a message", choices=("row-major", "column-major"))
    size: tuple[float, ...] = setting((0.0, 0.0), "Size of a taxel along x and y", unit="m", bounds=(0.0, 1.0))
    spacing: tuple[float, ...] = setting(
        (), "To the next taxel along x and y, negative to flip; by default the size", unit="m", bounds=(-1.0, 1.0)
    )
    offset: tuple[float, ...] = setting(
        (0.0, 0.0), "The sensor's origin along x and y, from the first taxel's centre", unit="m", bounds=(-10.0, 10.0)
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_length(self, 2, "size", *(["spacing"] if self.spacing else []), "offset")
        if self.rows * self.cols > MOST_TAXELS:
            raise ConfigError(f"rows, cols: {self.rows} x {self.cols} taxels exceed {MOST_TAXELS}")
        along_x, along_y = self.spacing or self.size
        if (self.rows > 1 and not along_x) or (self.cols > 1 and not along_y):
            raise ConfigError("size, spacing: 0 m from a taxel to the next")

    def layout(self, absent: Sequence[int] = ()) -> Layout:
        """Return the taxels, in the order of a message; places of the array that are `absent` hold none.

        Raises:
            ConfigError: If there is no such place, or no taxel is left.
        """
        grid = np.indices((self.rows, self.cols)).transpose((1, 2, 0) if self.order == "row-major" else (2, 1, 0))
        positions = np.zeros((self.rows * self.cols, 3))
        positions[:, :2] = grid.reshape(-1, 2) * np.array(self.spacing or self.size) - self.offset
        if not max(absent, default=-1) < len(positions) or len(set(absent)) == len(positions):
            raise ConfigError(f"absent: of the places 0 to {len(positions) - 1} at least one must hold a taxel")
        positions = positions[present(len(positions), absent)]
        return Layout(positions, np.tile((0.0, 0.0, 1.0), (len(positions), 1)))


def present(count: int, absent: Sequence[int]) -> Index:
    """Return the places 0 to `count` - 1 that are not absent, ascending."""
    return np.setdiff1d(np.arange(count), np.array(absent, np.intp))


def require_length(settings: Settings, length: int, *names: str) -> None:
    """Refuse lists of another length by a `ConfigError`."""
    for name in names:
        if len(getattr(settings, name)) != length:
            raise ConfigError(f"{name}: {list(getattr(settings, name))} are not {length} numbers")


def read_layout(path: Path, absent: Sequence[int] = ()) -> Layout:
    """Read the taxels from a CSV file with the columns of `COLUMNS` [m]; `#` begins a comment.

    The index is the place in a message, so that those that are `absent` are left out. Normals that were rounded are made of unit length, others are as written, to the bit. A `FileError` names the file, the line and
    the rule.
    """
    text = read_bytes(path, _BYTES).decode("utf-8-sig", "replace").splitlines()
    lines = {f"line {n}": line for n, line in enumerate(text, 1) if line.strip() and not line.startswith("#")}
    if next(iter(lines.values()), None) != ",".join(COLUMNS):
        raise FileError(path, f"does not begin with the line {','.join(COLUMNS)}")
    numbered = list(lines.items())[1:]
    if not 0 < len(numbered) <= MOST_TAXELS:
        raise FileError(path, f"holds {len(numbered)} taxels, not 1 to {MOST_TAXELS}")
    table = np.array([_numbers(path, name, line) for name, line in numbered])
    index, normals = table[:, 0], table[:, 4:7]
    with np.errstate(over="ignore"):
        length = np.linalg.norm(normals, axis=1)
    again = ~np.isin(np.arange(len(index)), np.unique(index, return_index=True)[1])
    for rule, wrong in (
        (
            f"index: not each of 0 to {len(table) + len(absent) - 1} once"
            + (", without those absent" if absent else ""),
            again | ~np.isin(index, present(len(table) + len(absent), absent)),
        ),
        ("nx, ny, nz: the normal is zero; where it is unknown, state the nearest taxel's", length == 0.0),
        ("nx, ny, nz: the normal is not of unit length", np.abs(length - 1.0) > 0.01),
    ):
        if wrong.any():
            raise FileError(path, rule, field=numbered[wrong.argmax()][0])
    rounded = np.abs(length - 1.0) > 1e-9
    normals[rounded] /= length[rounded, None]
    table = table[np.argsort(index)]
    return Layout(table[:, 1:4].copy(), table[:, 4:7].copy())


def _numbers(path: Path, name: str, line: str) -> list[float]:
    try:
        values = [float(cell) for cell in line.split(",")]
    except ValueError:
        values = []
    if len(values) != len(COLUMNS) or not np.isfinite(values).all():
        raise FileError(path, f"{quoted(line)} is not {len(COLUMNS)} finite numbers", field=name)
    return values
