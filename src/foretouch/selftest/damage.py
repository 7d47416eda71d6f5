# SPDX-License-Identifier: Apache-2.0
"""Damaged files: valid ones with a few changes, which readers refuse by name or read.

`benchmarks/fuzz/files.py` makes many more of them, of every kind of file, in a child process.
"""

import re
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from foretouch.errors import FileError, ForetouchError
from foretouch.selftest.case import HardCase
from foretouch.types import Cloud

_EACH = 8  # damaged files of each kind
_NUMBERS = (
    b"0",
    b"-1",
    b"1",
    b"2147483647",
    b"4294967296",
    b"1e10",
    b"nan",
    b"inf",
    b"1e400",
    b"9" * 4400,
    b"",
    b"true",
)
_WORDS = (b"null", b"[]", b"{}", b"*a", b"&a", b"!!int x", b"2026-13-45", b"\0", b"\xff", b"[" * 300, b'"\\ud800"')


def damage_cases() -> Iterator[HardCase]:
    """A few dozen damaged files; each is read or refused by a `ForetouchError`."""
    for kind, (write, read) in _KINDS.items():
        for number in range(_EACH):
            yield HardCase(f"damage: {kind} {number}", partial(_read_damaged, write, read, number))


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """One to four changes of a file."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5)) if rng.random() < 0.5 else 1):
        data = _changed(data, rng)
    return bytes(data)


def _changed(data: bytearray, rng: np.random.Generator) -> bytearray:
    size = len(data)
    at = int(rng.integers(0, size + 1))
    if rng.random() < 0.3:
        at = min(at, int(rng.integers(0, 512)))  # headers decide most
    length = int(rng.integers(1, 1 + min(64, max(size, 1))))
    way = int(rng.integers(0, 9))
    if way == 0 and size:  # a flipped bit
        data[min(at, size - 1)] ^= 1 << int(rng.integers(0, 8))
    elif way == 1:  # another byte
        data[at : at + 1] = rng.bytes(1)
    elif way == 2:  # an integer of 1 to 8 bytes
        width = int(rng.choice([1, 2, 4, 8]))
        at -= at % width if rng.random() < 0.7 else 0
        values = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1, int(rng.integers(0, 2**32)))
        value = int(rng.choice(np.array(values, object))) % 256**width
        data[at : at + width] = value.to_bytes(width, "little")[: max(size - at, 0)]
    elif way == 3:  # truncated
        del data[at:]
    elif way == 4:  # duplicated
        data[at:at] = data[at : at + length * 16]
    elif way == 5:  # inserted
        data[at:at] = rng.bytes(length)
    elif way == 6:  # removed
        del data[at : at + length]
    else:  # another number or word in a text
        pattern = rb"-?\d+(\.\d+)?" if way == 7 else rb"[A-Za-z_]+"
        found = list(re.finditer(pattern, bytes(data[:20_000])))
        if found:
            match = found[int(rng.integers(0, len(found)))]
            choices = _NUMBERS if way == 7 else _NUMBERS + _WORDS
            data[match.start() : match.end()] = choices[int(rng.integers(0, len(choices)))]
    return data


def _read_damaged(write: Callable[[Path], Path], read: Callable[[Path], object], number: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder))
        files = sorted(one for one in Path(folder).rglob("*") if one.is_file())
        file = files[number % len(files)]
        file.write_bytes(mutated(file.read_bytes(), np.random.default_rng(number)))
        try:
            read(path)
        except ForetouchError as err:
            if "\n" in str(err):
                raise FileError(file, "is refused in more than one line") from err


def _cloud(suffix: str, change: Callable[[bytes], bytes] = lambda content: content) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        from foretouch.cloud.io.files import write_cloud

        path = folder / f"cloud{suffix}"
        write_cloud(path, Cloud(np.random.default_rng(1).random((4, 6, 3), np.float32)))
        path.write_bytes(change(path.read_bytes()))
        return path

    return write


def _read_cloud(path: Path) -> object:
    from foretouch.cloud.io.files import read_cloud

    return read_cloud(path)


def _write_bag(folder: Path) -> Path:
    from foretouch.dataset.bag_writer import write_bag

    write_bag(folder / "bag", [Cloud(np.random.default_rng(1).random((24, 3), np.float32))])
    return folder / "bag"


def _read_bag(path: Path) -> object:
    from foretouch.dataset.bag import read_bag

    return list(read_bag(path))


def _write_store(folder: Path) -> Path:
    from foretouch.dataset.store_writer import StoreWriter
    from foretouch.selftest.training import made_samples

    with StoreWriter(folder / "store") as writer:
        for sample in made_samples():
            writer.write(sample)
    return folder / "store"


def _read_store(path: Path) -> object:
    """A changed store must be refused: what it holds was hashed."""
    from foretouch.dataset.store import Store, sample_digest
    from foretouch.selftest.training import made_samples

    found = [sample_digest(sample) for sample in Store(path)]
    if found != [sample_digest(sample) for sample in made_samples()]:
        raise AssertionError("changed samples are read in silence")
    return found


def _write_settings(folder: Path) -> Path:
    import yaml

    from foretouch.pipeline import PipelineConfig

    path = folder / "settings.yaml"
    path.write_text(yaml.safe_dump(PipelineConfig().to_mapping()), encoding="utf-8")
    return path


def _read_settings(path: Path) -> object:
    from foretouch.config import load_yaml
    from foretouch.pipeline import PipelineConfig

    return PipelineConfig.from_mapping(load_yaml(path), str(path))


_KINDS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], object]]] = {
    **{suffix: (_cloud(suffix), _read_cloud) for suffix in (".npy", ".npz", ".pcd", ".ply")},
    "bag": (_write_bag, _read_bag),
    "store": (_write_store, _read_store),
    "settings": (_write_settings, _read_settings),
}
