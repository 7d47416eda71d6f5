# SPDX-License-Identifier: Apache-2.0
"""The training store: samples in memory-mapped Arrow IPC shards, read at random without parsing.

Layout, schema version 1::

    store/
      manifest.json       format, schema version, counts, hashes, and facts about the samples' origin
      shard-00000.arrow   Arrow IPC files, uncompressed, so that a cloud is a view of the file

One row is one sample; see `SCHEMA`. A store appears complete or not at all. Its content hash covers the samples in
order, not the files: it does not depend on how they are split into shards or on the version of Arrow.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from foretouch.checked_files import file_sha256, parse_json
from foretouch.dataset.files import read_manifest
from foretouch.dataset.record import Identity, SampleRecord
from foretouch.dataset.samples import DatasetFormat, SampleSet
from foretouch.errors import FileError, ForetouchError, shown
from foretouch.types import TOUCH_SIZE, Cloud, Grasp, GraspSample, Touch

FORMAT: Final = "foretouch-store"
SCHEMA_VERSION: Final = 1
MANIFEST: Final = "manifest.json"
SEAL: Final = "seal"

SCHEMA: Final = pa.schema(
    [
        ("id", pa.string()),
        ("object", pa.string()),
        ("stamp_ns", pa.int64()),
        ("frame_id", pa.string()),
        ("xyz", pa.list_(pa.float32())),  # n points, row by row [m]
        ("rgb", pa.list_(pa.uint8())),  # the same, or null
        ("g1", pa.list_(pa.float64(), 3)),  # [m]
        ("g2", pa.list_(pa.float64(), 3)),  # [m]
        ("rotation", pa.list_(pa.float64(), 9)),  # row-major
        ("score", pa.float64()),
        ("touch", pa.list_(pa.float64(), TOUCH_SIZE)),  # [counts], null for an unlabelled sample
        ("tare", pa.list_(pa.float64(), TOUCH_SIZE)),  # [counts], or null
        ("extra", pa.string()),  # JSON object of numbers
    ],
    metadata={"format": FORMAT, "schema_version": str(SCHEMA_VERSION)},
)

_POINTS: Final = ("xyz", "rgb")
_NULLABLE: Final = ("rgb", "touch", "tare")
_PARTS: Final[dict[str, dict[str, type]]] = {
    "shards": {"file": str, "samples": int, "sha256": str},
    "files": {"file": str, "sha256": str},
}


def is_store(path: str | Path) -> bool:
    """Whether the path is a training store."""
    return (Path(path) / MANIFEST).is_file()


class _Batch(NamedTuple):
    """The columns of one record batch by name, as views of the file where they have no nulls."""

    plain: dict[str, Sequence[Any]]  # texts and numbers
    offsets: dict[str, Any]  # of the points
    values: dict[str, Any]  # of the points, and of vectors one after the other
    valid: dict[str, Any]  # whether there is a value


class Store(Sequence[GraspSample]):
    """A training store on disk; `store[k]` reads one sample, whose cloud is a read-only view of the file.

    Opening compares manifest, shards and attached files with their hashes before anything in them is decoded; a process
    hashes each file once while it does not change.

    Raises:
        FileError: If there is none, it is of another version, or files and manifest disagree.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.manifest = _read_manifest(self.path)
        self._check_hashes()
        shards = self.manifest["shards"]
        batches = [batch for shard in shards for batch in _read_shard(self.path / shard["file"], shard["samples"])]
        self._batches = [_columns(batch) for batch in batches]
        self._starts = np.cumsum([0, *(batch.num_rows for batch in batches)])
        if len(self) != self.manifest["samples"]:
            raise FileError(self.path, f"holds {len(self)} samples, not {self.manifest['samples']}", field="samples")

    @property
    def sha256(self) -> str:
        """Content hash as the writer computed it; `verify` computes it again."""
        return str(self.manifest["sha256"])

    def __len__(self) -> int:
        return int(self._starts[-1])

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        k = index + len(self) if index < 0 else index
        if not 0 <= k < len(self):
            raise IndexError(f"{self.path}: sample {index} of {len(self)}")
        b = int(np.searchsorted(self._starts, k, side="right")) - 1
        try:
            return _sample(self._batches[b], k - int(self._starts[b]))
        except (ForetouchError, ValueError) as err:
            raise FileError(self.path, " ".join(str(err).split()), field=f"sample {k}") from err

    def verify(self) -> None:
        """Read everything and compare it with the manifest; a `FileError` names what differs."""
        _read_manifest(self.path)
        self._check_hashes()
        found = content_sha256(self)
        if found != self.sha256:
            raise FileError(self.path, f"content is {found}, not {self.sha256}", field="sha256")

    def _check_hashes(self) -> None:
        for part in [*self.manifest["shards"], *self.manifest.get("files", [])]:
            path = self.path / part["file"]
            found = file_sha256(path)  # computed once a process for a file that does not change
            if found != part["sha256"]:
                rule = f"sha256 is {found}, not {shown(part['sha256'])} as in {MANIFEST}: the file was changed"
                raise FileError(path, rule)


def sample_digest(sample: GraspSample) -> bytes:
    """SHA-256 over all values of the sample."""
    digest = hashlib.sha256()
    cloud, grasp = sample.cloud, sample.grasp
    head = [sample.id, sample.object, sample.stamp_ns, cloud.frame_id, cloud.size, dict(sorted(sample.extra.items()))]
    digest.update(json.dumps(head, separators=(",", ":")).encode())
    digest.update(np.ascontiguousarray(cloud.xyz).data)
    digest.update(b"" if cloud.rgb is None else np.ascontiguousarray(cloud.rgb).data)
    digest.update(np.concatenate([grasp.g1, grasp.g2, grasp.rotation.ravel(), [grasp.score]]).astype(np.float64).data)
    for touch in (sample.touch, sample.tare):
        digest.update(b"-" if touch is None else touch.vector().data)
    return digest.digest()


def content_sha256(samples: Iterable[GraspSample]) -> str:
    """SHA-256 over some samples in order, hexadecimal."""
    content = hashlib.sha256()
    for sample in samples:
        content.update(sample_digest(sample))
    return content.hexdigest()


def _read_manifest(path: Path) -> dict[str, Any]:
    file = path / MANIFEST
    manifest = read_manifest(file, FORMAT, SCHEMA_VERSION, SEAL)
    for name, kind in (("samples", int), ("sha256", str), ("about", dict)):
        value = manifest.get(name, {} if name == "about" else None)
        if type(value) is not kind:
            raise FileError(file, f"{shown(value)} is of type {type(value).__name__}", field=name)
    for name, wanted in _PARTS.items():
        parts = manifest.setdefault(name, [])
        if not isinstance(parts, list):
            raise FileError(file, f"{shown(parts)} is no list", field=name)
        for part in parts:
            if not isinstance(part, dict) or any(type(part.get(key)) is not kind for key, kind in wanted.items()):
                raise FileError(file, f"{shown(part)} lacks one of {', '.join(wanted)}", field=name)
            if not part["file"] or "\0" in part["file"] or Path(part["file"]).name != part["file"]:
                raise FileError(file, f"{shown(part['file'])!r} is not the name of a file in the store", field="file")
    return manifest


def _read_shard(path: Path, samples: int) -> list[Any]:
    """The record batches of a shard, whose hash was checked, after its buffers were: Arrow trusts what it maps."""
    try:
        reader = pa.ipc.open_file(pa.memory_map(str(path)))
        batches = [reader.get_batch(k) for k in range(reader.num_record_batches)]
    except (OSError, pa.ArrowInvalid) as err:
        raise FileError(path, f"cannot be read: {' '.join(str(err).split())}") from err
    if not reader.schema.equals(SCHEMA):
        raise FileError(path, "has other columns than the schema", field="schema")
    rows = sum(batch.num_rows for batch in batches)
    if rows != samples:
        raise FileError(path, f"holds {rows} samples, the manifest declares {samples}")
    for k, batch in enumerate(batches):
        _check_batch(path, batch, f"batch {k}")
    return batches


def _check_batch(path: Path, batch: Any, field: str) -> None:
    """Check offsets, texts and lengths, so that every later view lies within its buffer."""
    if batch.nbytes > 2 * path.stat().st_size:
        raise FileError(path, f"unpacks to {batch.nbytes} bytes; shards are not compressed", field=field)
    try:
        batch.validate(full=True)
    except pa.ArrowInvalid as err:
        raise FileError(path, " ".join(str(err).split()), field=field) from err
    for name in SCHEMA.names:
        if name not in _NULLABLE and batch.column(name).null_count:
            raise FileError(path, "is null in some rows", field=f"{field}: {name}")
    for name in _POINTS:
        sizes = np.diff(batch.column(name).offsets.to_numpy())
        if (sizes[batch.column(name).is_valid().to_numpy(zero_copy_only=False)] % 3).any():
            raise FileError(path, "a cloud is not a whole number of points", field=field)


def _columns(batch: Any) -> _Batch:
    column = {name: batch.column(name) for name in SCHEMA.names}
    vectors = ("g1", "g2", "rotation", "touch", "tare")
    return _Batch(
        plain={name: column[name].to_pylist() for name in ("id", "object", "frame_id", "extra", "stamp_ns", "score")},
        offsets={name: column[name].offsets.to_numpy() for name in _POINTS},
        values={name: column[name].values.to_numpy(zero_copy_only=False) for name in (*_POINTS, *vectors)},
        valid={name: column[name].is_valid().to_numpy(zero_copy_only=False) for name in _NULLABLE},
    )


def _sample(batch: _Batch, row: int) -> GraspSample:
    def _points(name: str) -> Any:
        start, end = batch.offsets[name][row : row + 2]
        return batch.values[name][start:end].reshape(-1, 3)

    def _vector(name: str, size: int) -> Any:
        return batch.values[name][row * size : (row + 1) * size]

    def _touch(name: str) -> Touch | None:
        return Touch.from_vector(_vector(name, TOUCH_SIZE)) if batch.valid[name][row] else None

    plain = {name: values[row] for name, values in batch.plain.items()}
    rgb = _points("rgb") if batch.valid["rgb"][row] else None
    rotation = _vector("rotation", 9).reshape(3, 3)
    return GraspSample(
        id=plain["id"],
        object=plain["object"],
        cloud=Cloud(_points("xyz"), rgb, plain["frame_id"], plain["stamp_ns"]),
        grasp=Grasp(_vector("g1", 3), _vector("g2", 3), rotation, plain["score"], object_id=plain["object"]),
        touch=_touch("touch"),
        tare=_touch("tare"),
        stamp_ns=plain["stamp_ns"],
        extra=_numbers(plain["extra"]),
    )


def _numbers(text: str) -> dict[str, float]:
    """The named numbers of a sample."""
    numbers = parse_json(text)
    if not isinstance(numbers, dict) or not all(type(value) in (int, float) for value in numbers.values()):
        raise ValueError(f"extra: {shown(text)} is no list of named numbers")
    return numbers


def _open_samples(path: Path, _: bool) -> SampleSet:
    store = Store(path)
    about = store.manifest.get("about", {})
    return SampleSet(
        path=path,
        kind="store",
        size=len(store),
        record=lambda k: SampleRecord(sample=store[k]),
        name=lambda k: f"{path}[{k}]",
        identity=Identity(hand=about.get("hand", {}), camera=about.get("camera", {})),
    )


DATASET_FORMAT = DatasetFormat(recognise=is_store, open=_open_samples)
